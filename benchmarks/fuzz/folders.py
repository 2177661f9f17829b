"""Folders of results as somebody else may have made them: damaged by one kind of mutation a case.

Case k of a folder has the kind ``KINDS[k % len(KINDS)]``, and files drawn by its number. Sums that
belong to what was changed are made good in most cases, so that what lies behind them is reached.
"""

import io
import json
import os
import pickle
import random
import re
import shutil
import warnings
import zipfile
from collections.abc import Callable
from functools import partial
from hashlib import sha256
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np

from benchmarks.fuzz.mutation import mutate_array, mutate_bytes, mutate_document
from benchmarks.fuzz.worker import Case, Command

MUTATED = "mutated"
"""File in the folder of a target that has the name of the file that the last case mutated."""

CANARY = "canary"
"""File in the folder of a target that only code from a mutated file would write."""

Mutation = Callable[[Path, random.Random, Path], None]
"""Changes a file; the last argument is a folder outside of the results."""


class Payload:
    """What writes the canary when it is unpickled."""

    def __init__(self, place: Path) -> None:
        self._place = str(place)

    def __reduce__(self) -> tuple[Any, ...]:
        return _touch, (self._place,)


def _touch(place: str) -> None:
    Path(place).touch()


def _truncate(path: Path, rng: random.Random, outside: Path) -> None:
    path.write_bytes(path.read_bytes()[: rng.randrange(path.stat().st_size)])


def _flip(path: Path, rng: random.Random, outside: Path) -> None:
    path.write_bytes(mutate_bytes(path.read_bytes(), rng))


def _swap(path: Path, rng: random.Random, outside: Path) -> None:
    others = sorted(p for p in path.parent.iterdir() if p.is_file() and p != path)
    if others:
        shutil.copy(rng.choice(others), path)


def _missing(path: Path, rng: random.Random, outside: Path) -> None:
    path.unlink()


def _symlink(path: Path, rng: random.Random, outside: Path) -> None:
    moved = outside / path.name
    shutil.move(path, moved)
    path.symlink_to(moved)


def _linked_folder(path: Path, rng: random.Random, outside: Path) -> None:
    """Replace the folder of the file, if that is one within the results, by a link."""
    if path.parent.name == "copy":
        _symlink(path, rng, outside)
    else:
        moved = outside / path.parent.name
        shutil.move(path.parent, moved)
        path.parent.symlink_to(moved)


def _directory(path: Path, rng: random.Random, outside: Path) -> None:
    path.unlink()
    path.mkdir()


def _fifo(path: Path, rng: random.Random, outside: Path) -> None:
    path.unlink()
    os.mkfifo(path)


def _device(path: Path, rng: random.Random, outside: Path) -> None:
    path.unlink()
    path.symlink_to("/dev/zero")


def _huge(path: Path, rng: random.Random, outside: Path) -> None:
    """Make it a file of 20 GiB that takes no room on the disk."""
    os.truncate(path, 20 << 30)


def _pickled(path: Path, rng: random.Random, outside: Path) -> None:
    payload = Payload(outside.parent / CANARY)
    if path.suffix == ".npz" and rng.random() < 0.7:
        with np.load(path) as archive:
            arrays = {name: archive[name] for name in archive.files}
        arrays[rng.choice(sorted(arrays))] = np.array([payload], dtype=object)
        np.savez(path, allow_pickle=True, **arrays)
    else:
        path.write_bytes(pickle.dumps(payload))


def _bomb(path: Path, rng: random.Random, outside: Path) -> None:
    """Write what takes far more room in memory than on the disk."""
    if path.suffix == ".npz":
        with np.load(path) as archive:
            name = rng.choice(sorted(archive.files))
            shape = (1 << rng.choice((27, 34, 62)),)
        member = io.BytesIO()
        header = {"descr": "<f8", "fortran_order": False, "shape": shape}
        np.lib.format.write_array_header_1_0(member, header)
        with (
            zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as written,
            written.open(f"{name}.npy", "w") as entry,
        ):
            entry.write(member.getvalue())
            for _ in range(64 if shape[0] == 1 << 27 else 1):
                entry.write(b"\0" * (1 << 20))
    else:
        path.write_bytes(rng.choice((b"[" + b"{}," * (8 << 20), b"\n" * (16 << 20))))


def _table(path: Path, rng: random.Random, outside: Path) -> None:
    """Write another table, or one of very many rows that takes little room; other files as arrays."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    if path.suffix != ".parquet":
        _array(path, rng, outside)
        return
    if rng.random() < 0.5:
        table = pa.table({"t_s": np.zeros(60_000_000, dtype=np.int8)})
    else:
        table = pq.read_table(path)
        k = rng.randrange(table.num_columns)
        column = rng.choice((pa.nulls(len(table)), pa.array(["x"] * len(table))))
        table = table.set_column(k, table.column_names[k], column)
    pq.write_table(table, path)


def _array(path: Path, rng: random.Random, outside: Path) -> None:
    if path.suffix != ".npz":
        _values(path, rng, outside)
        return
    with np.load(path) as archive:
        arrays = {name: archive[name] for name in archive.files}
    name = rng.choice(sorted(arrays))
    arrays[name] = mutate_array(arrays[name], rng)
    np.savez_compressed(path, allow_pickle=False, **arrays)


def _values(path: Path, rng: random.Random, outside: Path) -> None:
    """Change values of a JSON document, or of a line of one; of other files, bytes."""
    if path.suffix == ".json":
        path.write_text(json.dumps(mutate_document(json.loads(path.read_text()), rng)))
    elif path.suffix == ".jsonl":
        lines = path.read_text().splitlines()
        k = rng.randrange(len(lines))
        lines[k] = json.dumps(mutate_document(json.loads(lines[k]), rng))
        path.write_text("\n".join(lines) + "\n")
    else:
        _flip(path, rng, outside)


def _repeated(path: Path, rng: random.Random, outside: Path) -> None:
    """Give a key, a line or a member of an archive twice."""
    content = path.read_bytes()
    if path.suffix == ".npz":
        with warnings.catch_warnings(), zipfile.ZipFile(path, "a") as archive:
            warnings.simplefilter("ignore")  # that the name is there already
            name = rng.choice(archive.namelist())
            archive.writestr(name, archive.read(name))
    elif path.suffix == ".jsonl":
        lines = content.splitlines(keepends=True)
        lines.insert(rng.randrange(len(lines)), rng.choice(lines))
        path.write_bytes(b"".join(lines))
    else:
        keys = list(re.finditer(rb'"(\w+)": ', content))
        if keys:
            at = rng.choice(keys)
            path.write_bytes(
                content[: at.start()] + at[0] + b"1, " + content[at.start() :]
            )


def _text(path: Path, rng: random.Random, outside: Path) -> None:
    """Replace a text of a document by one that is too long, nested too deeply, or leads elsewhere."""
    content = path.read_bytes()
    found: list[re.Match[bytes] | None] = [*re.finditer(rb'"[^"\\\n]*"(?!:)', content)]
    at = rng.choice(found or [None])
    text = rng.choice((
        *(b"../" * 8 + b"tmp/x", b"/etc/passwd", b"..", b"a\\u0000b", b"x" * (4 << 20)),
        *(str(outside / "x.urdf").encode(), b"package://os/x.urdf", b"\\u001b[31m"),
    ))  # fmt: skip
    new = rng.choice((b'"' + text + b'"', b"[" * 50_000 + b"]" * 50_000))
    if at is not None and path.suffix != ".npz":
        path.write_bytes(content[: at.start()] + new + content[at.end() :])
    else:
        _flip(path, rng, outside)


KINDS: dict[str, Mutation] = {
    "truncated": _truncate,
    "values": _values,
    "array": _array,
    "symbolic link": _symlink,
    "fifo": _fifo,
    "pickle": _pickled,
    "text": _text,
    "bomb": _bomb,
    "repeated": _repeated,
    "device": _device,
    "table": _table,
    "directory": _directory,
    "huge": _huge,
    "missing": _missing,
    "swapped": _swap,
    "flipped": _flip,
    "linked folder": _linked_folder,
}
"""Kinds of mutations by name; those that are tried by day first."""


def _made_good(folder: Path) -> None:
    """Make sums fit what the files of a folder hold now, where they are files of this kind still."""
    for plan in folder.rglob("plan.json"):
        _edit(plan, partial(_with_arrays_sum, plan.with_suffix(".npz")))
    for manifest in folder.rglob("manifest.json"):
        _edit(manifest, _with_scenario_sum)
    for summary in folder.rglob("summary.json"):
        _edit(
            summary, lambda c: c | {"files": {n: _sum(folder / n) for n in c["files"]}}
        )


def _edit(path: Path, change: Callable[[dict[str, Any]], dict[str, Any]]) -> None:
    try:
        if path.is_file() and path.stat().st_size < 1 << 22:
            path.write_text(json.dumps(change(json.loads(path.read_text()))))
    except (ValueError, KeyError, TypeError, OSError, RecursionError, AttributeError):
        return


def _with_arrays_sum(arrays: Path, content: dict[str, Any]) -> dict[str, Any]:
    return content | {"arrays_sha256": _sum(arrays)}


def _with_scenario_sum(content: dict[str, Any]) -> dict[str, Any]:
    text = json.dumps(content["scenario"], sort_keys=True, separators=(",", ":"))
    return content | {"scenario_sha256": sha256(text.encode()).hexdigest()}


def _sum(path: Path) -> str:
    if not path.is_file() or path.stat().st_size > 1 << 26:
        raise OSError
    return sha256(path.read_bytes()).hexdigest()


def folder_target(
    folder: Path, seed: int, source: Path, commands: Callable[[Path], list[Command]],
    suffixes: tuple[str, ...] = (".json", ".jsonl", ".npz", ".parquet"),
) -> Case:  # fmt: skip
    """Mutate a file of a folder of results.

    Args:
        folder: for the mutated copies.
        seed: of the mutations.
        source: the folder as it was written.
        commands: that read a copy.
        suffixes: of the files that are mutated.
    """
    names = sorted(
        path.relative_to(source)
        for path in source.rglob("*")
        if path.suffix in suffixes and path.stat().st_size
    )

    def prepare(case: int) -> list[Command]:
        rng = random.Random(f"{seed}/{case}")
        copy, outside = folder / "copy", folder / "outside"
        for place in (copy, outside):
            shutil.rmtree(place, ignore_errors=True)
        shutil.copytree(source, copy)
        outside.mkdir()
        kind = list(KINDS)[case % len(KINDS)]
        path = copy / rng.choice(names)
        KINDS[kind](path, rng, outside)
        named = path.parent if kind == "linked folder" and path.parent != copy else path
        (folder / MUTATED).write_text(named.name, encoding="utf-8")
        if rng.random() < 0.8:
            _made_good(copy)
        return commands(copy)

    return prepare


QUIET = ("--no-audit", "--no-recording", "-q")


def _sliders(folder: Path, more: str = "") -> Path:
    """Write a scenario of two sliders, whose plan takes no time."""
    from tests.twin.explorations.sliders import slider_file

    return slider_file(folder, more)


def _app(*arguments: object) -> None:
    from twin.cli import app

    app([str(a) for a in arguments], standalone_mode=False)


def run_folders(folder: Path, seed: int) -> Case:
    """Mutate the folder of a run that was killed before its summary was written."""
    source = folder / "source"
    _app("run", _sliders(folder), "--out", source, *QUIET)

    def commands(copy: Path) -> list[Command]:
        events, out = str(copy / "events.jsonl"), str(copy.parent / "exported")
        return [
            ("follow", str(copy), events, "--once", "--samples", "2", "--every", "30"),
            ("export", str(copy), "--format", "csv", "--out", out),
            ("resume", str(copy), "-q"),
        ]

    (source / "summary.json").unlink()  # as a run that was killed
    return folder_target(folder, seed, source, commands)


def operate_folders(folder: Path, seed: int) -> Case:
    """Mutate the folder of an operation that planned anew."""
    source = folder / "source"
    file = _sliders(folder)
    _app("operate", file, "--out", source, *QUIET)
    return folder_target(
        folder,
        seed,
        source,
        lambda copy: [
            ("verify", "--no-adversary", "-q", str(copy)),
            ("resume", str(copy), "-q"),
        ],
    )


def plan_folders(folder: Path, seed: int) -> Case:
    """Mutate the folder of a plan, which is verified and executed."""
    source, scenario = folder / "source", _sliders(folder)
    _app("plan", scenario, "--out", source, "-q")
    out = str(folder / "out")

    def commands(copy: Path) -> list[Command]:
        shutil.rmtree(out, ignore_errors=True)
        return [
            ("verify", "--no-adversary", "-q", str(copy)),
            ("run", str(scenario), "--plan", str(copy), "--out", out, *QUIET),
        ]

    return folder_target(folder, seed, source, commands)


def study_folders(folder: Path, seed: int) -> Case:
    """Mutate the folder of a study that is then gone on with."""
    import twin.studies.api as home

    source = folder / "source"
    few = ("-n", "20", "--policy", "asynchronous", "--workers", "0")
    more = ("--audit-sample", "1", "-q", "--out", source)
    with patch.object(home, "write_report"):
        _app("study", _sliders(folder), *few, *more)

    def commands(copy: Path) -> list[Command]:
        # In the process of the worker: pictures would take most of the time.
        patch.object(home, "write_report").start()
        return [("study", "--resume", str(copy), "--workers", "0", "-q")]

    return folder_target(folder, seed, source, commands)


def exploration_folders(folder: Path, seed: int) -> Case:
    """Mutate the folder of an exploration that is then gone on with, in this process."""
    import twin.explorations.api as home
    from tests.twin.explorations.bench import Bench
    from tests.twin.explorations.sliders import EXPLORE

    class OwnProcess(Bench):
        """Evaluates designs in this process."""

        def close(self) -> None:
            """Do nothing."""

    def crew(setting: Any, workers: int, limit_s: float) -> OwnProcess:
        return OwnProcess(setting)

    own: dict[str, Any] = {"Crew": crew, "write_report": lambda *_: None}
    source, copied = folder / "source", folder / "design.yaml"
    jitter = "execution: {jitter: {kind: uniform, low_s: 0, high_s: 0.02}}\n"
    file = _sliders(folder, jitter + EXPLORE)
    with patch.multiple(home, **own):
        _app("explore", file, "--designs", "4", "--workers", "1", "-q", "--out", source)

    def commands(copy: Path) -> list[Command]:
        patch.multiple(home, **own).start()  # in the process of the worker
        copied.unlink(missing_ok=True)
        return [
            ("init", str(copied), "--from", f"{copy}#1"),
            ("explore", "--resume", str(copy), "--workers", "1", "-q"),
        ]

    return folder_target(folder, seed, source, commands)


def judge_folders(folder: Path, seed: int) -> Case:
    """Mutate an open plan and the scenario beside it."""
    page = Path("docs/reference/formats.md").read_text(encoding="utf-8")
    scenario = page.split("<!-- file: yard.yaml -->\n```yaml\n")[1].split("```")[0]
    plan = '{\n  "format"' + page.split('```json\n{\n  "format"')[1].split("```")[0]
    source = folder / "source"
    source.mkdir()
    (source / "yard.yaml").write_text(scenario, encoding="utf-8")
    (source / "plan.json").write_text(plan, encoding="utf-8")
    return folder_target(
        folder,
        seed,
        source,
        lambda copy: [("judge", str(copy / "plan.json"), "--seeds", "1", "-q")],
        (".json", ".yaml"),
    )


FOLDERS: dict[str, Callable[[Path, int], Case]] = {
    "run folders": run_folders,
    "operate folders": operate_folders,
    "plan folders": plan_folders,
    "study folders": study_folders,
    "exploration folders": exploration_folders,
    "judge folders": judge_folders,
}
"""Targets by name."""
