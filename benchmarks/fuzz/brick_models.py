"""Mutated brick lists and models of LDraw, and the commands that read them."""

import random
from pathlib import Path

from benchmarks.fuzz.mutation import mutate_bytes
from benchmarks.fuzz.worker import Case, Command

_MODEL = Path("scenarios/lego/gate.mpd")

_LIST = "\n".join(
    f"{'2x4' if z % 2 else '4x2'} ({x},{y},{z})"
    for z in range(4)
    for x, y in ((0, 0), (0, 4))
)

_WORDS = (
    *("nan", "inf", "-1", "0", "1e308", "9" * 20, "0x2FFFFFF", "16", "-0", "1_0", "+5"),
    *("0 FILE", "0 NOFILE", "(", ",", "x", "\x00", "\ufeff", "\r", "\n", "\u2028", "\u0663"),
    *("pillar.ldr", "gate.ldr", "3005.dat", "3001p01.dat", '"', "-24", "20", "7.5"),
)  # fmt: skip


def model_target(folder: Path, seed: int) -> Case:
    """Mutate a brick list or a model of LDraw: words, lines and bytes."""
    sources = {
        "ldraw": _MODEL.read_text(encoding="utf-8"),
        "bricks": _LIST,
    }

    def prepare(case: int) -> list[Command]:
        rng = random.Random(f"{seed}/{case}")
        kind = rng.choice(sorted(sources))
        text = sources[kind]
        for _ in range(rng.choice((1, 1, 2, 5))):
            text = _changed(text, rng)
        content = text.encode("utf-8", "replace")
        if rng.random() < 0.2:
            content = mutate_bytes(content, rng)
        file = folder / "model.txt"
        file.write_bytes(content)
        return [("import", kind, str(file), "-o", str(folder / "model.yaml"))]

    return prepare


def _changed(text: str, rng: random.Random) -> str:
    if rng.random() < 0.3:
        lines = text.split("\n")
        lines.insert(rng.randrange(len(lines) + 1), rng.choice(lines))
        del lines[rng.randrange(len(lines))]
        return "\n".join(lines)
    words = text.split(" ")
    words[rng.randrange(len(words))] = rng.choice((*_WORDS, *words))
    return " ".join(words)
