"""What is mutated, and the commands that read it."""

import json
import random
import shutil
from collections.abc import Callable
from hashlib import sha256
from io import BytesIO
from pathlib import Path

import numpy as np
import yaml

from benchmarks.fuzz.brick_models import model_target
from benchmarks.fuzz.mutation import mutate_array, mutate_bytes, mutate_document
from benchmarks.fuzz.worker import Case, Command

SCENARIOS = Path("scenarios")


def scenario_target(folder: Path, seed: int) -> Case:
    """Mutate the shipped scenarios, and validate them."""
    return _scenarios(folder, seed, "validate")


def cell_target(folder: Path, seed: int) -> Case:
    """Mutate the shipped scenarios, and check the cells of those that are still valid."""
    return _scenarios(folder, seed, "check")


def _scenarios(folder: Path, seed: int, command: str) -> Case:
    """Mutate the shipped scenarios: values for the greater part, and bytes."""
    sources = sorted(SCENARIOS.glob("*/*.yaml"))
    texts = [path.read_bytes() for path in sources]
    documents = [yaml.safe_load(text) for text in texts]

    def prepare(case: int) -> list[Command]:
        rng = random.Random(f"{seed}/{case}")
        k = rng.randrange(len(sources))
        path = folder / "scenario.yaml"
        if rng.random() < 0.25:
            path.write_bytes(mutate_bytes(texts[k], rng))
        else:
            changed = mutate_document(documents[k], rng)
            path.write_text(_yaml(changed), encoding="utf-8", errors="replace")
        return [(command, str(path))]

    return prepare


def plan_target(folder: Path, seed: int) -> Case:
    """Mutate a saved plan, with the hash of its arrays made good."""
    scenario = _two_arms(folder)
    source = _run_of(scenario, folder / "source")
    document = json.loads((source / "plan.json").read_text())
    with np.load(source / "plan.npz") as archive:
        arrays = {name: archive[name] for name in archive.files}

    def prepare(case: int) -> list[Command]:
        rng = random.Random(f"{seed}/{case}")
        plan, out = _emptied(folder / "plan"), folder / "out"
        shutil.rmtree(out, ignore_errors=True)
        changed, numbers = document, dict(arrays)
        if rng.random() < 0.6:
            for _ in range(rng.randint(1, 2)):
                name = rng.choice(sorted(numbers))
                numbers[name] = mutate_array(numbers[name], rng)
        else:
            changed = mutate_document(document, rng, 2)
        buffer = BytesIO()
        np.savez_compressed(buffer, allow_pickle=False, **numbers)
        content = buffer.getvalue()
        if isinstance(changed, dict) and rng.random() < 0.95:
            changed = {**changed, "arrays_sha256": sha256(content).hexdigest()}
        text = json.dumps(changed).encode("utf-8", "surrogatepass")
        if rng.random() < 0.1:
            text = mutate_bytes(text, rng)
        (plan / "plan.npz").write_bytes(content)
        (plan / "plan.json").write_bytes(text)
        quick = ("--no-audit", "--no-recording", "-q")
        return [
            ("verify", "--no-adversary", "-q", str(plan)),
            ("run", str(scenario), "--plan", str(plan), "--out", str(out), *quick),
        ]

    return prepare


def log_target(folder: Path, seed: int) -> Case:
    """Mutate an event log: it is followed, fitted to, and a run is resumed from it."""
    source = _run_of(SCENARIOS / "multi_arm/multi_goal.yaml", folder / "source")
    lines = (source / "events.jsonl").read_bytes().splitlines(keepends=True)

    def prepare(case: int) -> list[Command]:
        rng = random.Random(f"{seed}/{case}")
        run = _copied(source, folder / "run")
        (run / "summary.json").unlink()
        changed = list(lines)
        for _ in range(rng.randint(1, 3)):
            k = rng.randrange(len(changed))
            if rng.random() < 0.5:
                row = mutate_document(json.loads(lines[k % len(lines)]), rng)
                changed[k] = json.dumps(row).encode() + b"\n"
            elif rng.random() < 0.5:
                changed[k] = mutate_bytes(changed[k], rng)
            else:
                changed[k:k] = [rng.choice(changed)]
        log = run / "events.jsonl"
        log.write_bytes(b"".join(changed))
        return [
            ("follow", str(run), str(log), "--once", "--samples", "2", "--every", "30"),
            ("resume", str(run), "-q"),
        ]

    return prepare


def block_target(folder: Path, seed: int) -> Case:
    """Mutate the blocks of a study that is then gone on with."""
    from twin.cli import app

    source = folder / "source"
    scenario = SCENARIOS / "multi_arm/rearrangement.yaml"
    request = (
        "study",
        str(scenario),
        "-n",
        "20",
        # Pictures of every policy would take most of the time.
        "--policy",
        "asynchronous",
        "--workers",
        "0",
        "--audit-sample",
        "0",
        "-q",
    )
    app([*request, "--out", str(source)], standalone_mode=False)

    def prepare(case: int) -> list[Command]:
        rng = random.Random(f"{seed}/{case}")
        study = _copied(source, folder / "study")
        block = rng.choice(sorted((study / "blocks").glob("*.npz")))
        if rng.random() < 0.5:
            block.write_bytes(mutate_bytes(block.read_bytes(), rng))
        elif rng.random() < 0.3:
            shutil.copy(
                block, block.with_name(rng.choice(("0-0-9.npz", "9-9-9.npz", "x.npz")))
            )
        else:
            with np.load(block) as archive:
                arrays = {name: archive[name] for name in archive.files}
            name = rng.choice(sorted(arrays))
            arrays[name] = mutate_array(arrays[name], rng)
            np.savez_compressed(block, allow_pickle=False, **arrays)
        return [("study", "--resume", str(study), "--workers", "0", "-q")]

    return prepare


def urdf_target(folder: Path, seed: int) -> Case:
    """Mutate the description of an arm of primitives in a scenario that names it."""
    text = _urdf()
    numbers = (
        "nan",
        "inf",
        "-1 0 1e300",
        "1e300",
        "0",
        "-1",
        "1e-300",
        "",
        "x",
        "0 0",
        "9" * 400,
    )
    document = yaml.safe_load((SCENARIOS / "multi_arm/multi_goal.yaml").read_text())
    document["cell"]["robots"][0]["model"] = "arm.urdf"

    def prepare(case: int) -> list[Command]:
        rng = random.Random(f"{seed}/{case}")
        changed = text
        for _ in range(rng.randint(1, 3)):
            if rng.random() < 0.7:
                parts = changed.split('"')
                k = rng.randrange(1, max(len(parts) - 1, 2), 2)
                parts[min(k, len(parts) - 1)] = rng.choice(numbers)
                changed = '"'.join(parts)
            else:
                changed = mutate_bytes(changed.encode(), rng, 1).decode("latin-1")
        (folder / "arm.urdf").write_text(changed, encoding="latin-1", errors="replace")
        scenario = folder / "scenario.yaml"
        scenario.write_text(_yaml(document))
        return [("validate", str(scenario))]

    return prepare


def csv_target(folder: Path, seed: int) -> Case:
    """Mutate a table of measured durations that is fitted."""
    rows = [f"{k},pick,{2.0 + 0.37 * ((k * 7919) % 11):.3f}" for k in range(40)]

    def prepare(case: int) -> list[Command]:
        rng = random.Random(f"{seed}/{case}")
        changed = ["trial,skill,duration_s", *rows]
        for _ in range(rng.randint(1, 3)):
            k = rng.randrange(len(changed))
            cells = changed[k].split(",")
            cells[rng.randrange(len(cells))] = str(
                rng.choice(
                    (
                        "nan",
                        "-1",
                        "1e999",
                        "",
                        '"',
                        "x" * 300,
                        "0",
                        "1e308",
                        "\x00",
                        ";",
                    )
                )
            )
            changed[k] = ",".join(cells)
        content = "\n".join(changed).encode()
        if rng.random() < 0.4:
            content = mutate_bytes(content, rng)
        path = folder / "pick.csv"
        path.write_bytes(content)
        return [
            ("fit", str(path), "--resamples", "19", "--out", str(folder / "fit"), "-q")
        ]

    return prepare


def task_target(folder: Path, seed: int) -> Case:
    """Mutate a published task: its steps, its places, its environment."""
    from benchmarks.fuzz.task_files import write_task

    source = write_task(folder / "source")
    names = sorted(
        path.relative_to(source) for path in source.rglob("*") if path.is_file()
    )

    def prepare(case: int) -> list[Command]:
        rng = random.Random(f"{seed}/{case}")
        task = _copied(source, folder / "task")
        path = task / rng.choice(names)
        if path.suffix == ".json" and rng.random() < 0.7:
            changed = mutate_document(json.loads(path.read_text()), rng)
            path.write_text(json.dumps(changed))
        else:
            path.write_bytes(mutate_bytes(path.read_bytes(), rng))
        return [
            (
                "import",
                "apex-mr",
                str(task),
                "--task",
                "tower",
                "-o",
                str(folder / "o.yaml"),
            )
        ]

    return prepare


def open_plan_target(folder: Path, seed: int) -> Case:
    """Mutate the plan that the reference writes out by hand, and judge it."""
    page = Path("docs/reference/formats.md").read_text(encoding="utf-8")
    scenario = page.split("<!-- file: yard.yaml -->\n```yaml\n")[1].split("```")[0]
    (folder / "yard.yaml").write_text(scenario, encoding="utf-8")
    plan = '{\n  "format"' + page.split('```json\n{\n  "format"')[1].split("```")[0]

    def prepare(case: int) -> list[Command]:
        rng = random.Random(f"{seed}/{case}")
        file = folder / "plan.json"
        if rng.random() < 0.3:
            file.write_bytes(mutate_bytes(plan.encode(), rng))
        else:
            text = json.dumps(mutate_document(json.loads(plan), rng))
            file.write_text(text, encoding="utf-8", errors="replace")
        return [("judge", str(file), "--seeds", "1", "-q")]

    return prepare


Target = Callable[[Path, int], Case]
TARGETS: dict[str, tuple[Target, int]] = {
    "scenarios": (scenario_target, 20_000),
    "cells": (cell_target, 3_000),
    "plans": (plan_target, 2_000),
    "logs": (log_target, 2_000),
    "blocks": (block_target, 500),
    "urdfs": (urdf_target, 300),
    "csvs": (csv_target, 300),
    "tasks": (task_target, 300),
    "models": (model_target, 2_000),
    "open plans": (open_plan_target, 2_000),
}
"""Targets by name, and how many cases a full run has."""


def _yaml(value: object) -> str:
    return yaml.safe_dump(value, sort_keys=False, allow_unicode=True)


def _copied(source: Path, folder: Path) -> Path:
    shutil.rmtree(folder, ignore_errors=True)
    shutil.copytree(source, folder)
    return folder


def _emptied(folder: Path) -> Path:
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    return folder


def _two_arms(folder: Path) -> Path:
    """Write a scenario of two arms and a few goals, whose proof takes a second."""
    document = yaml.safe_load((SCENARIOS / "multi_arm/multi_goal.yaml").read_text())
    document["cell"]["robots"] = document["cell"]["robots"][:2]
    names = [robot["name"] for robot in document["cell"]["robots"]]
    moves = [m for m in document["assembly"]["moves"] if m["robot"] in names]
    document["assembly"]["moves"] = moves[:4]
    path = folder / "two.yaml"
    path.write_text(_yaml(document))
    return path


def _run_of(scenario: Path, out: Path) -> Path:
    from twin.cli import app

    quick = ("--no-audit", "--no-recording", "-q")
    app(["run", str(scenario), "--out", str(out), *quick], standalone_mode=False)
    return out


def _urdf() -> str:
    """Return an arm of six revolute joints whose links are boxes, cylinders and spheres."""
    shapes = (
        '<box size="0.1 0.1 0.3"/>',
        '<cylinder radius="0.05" length="0.3"/>',
        '<sphere radius="0.06"/>',
    )
    parts = ['<robot name="arm">', '<link name="l0"/>']
    for k in range(1, 7):
        axis = ("0 0 1", "0 1 0")[k % 2]
        parts.append(
            f'<link name="l{k}"><collision><origin xyz="0 0 0.15" rpy="0 0 0"/>'
            f"<geometry>{shapes[k % 3]}</geometry></collision></link>"
            f'<joint name="j{k}" type="revolute"><parent link="l{k - 1}"/><child link="l{k}"/>'
            f'<origin xyz="0 0 0.3" rpy="0 0 0"/><axis xyz="{axis}"/>'
            '<limit lower="-2.9" upper="2.9" effort="100" velocity="2"/></joint>'
        )
    return "\n".join([*parts, "</robot>"])
