"""What it is worth that parts are alike: makespans against each part with a goal of its own.

    python -m benchmarks.alike [--seeds 2]

A magazine of twelve pins, as shipped, and a crib of twenty bars that lie in racks on either side of it. Each is
planned as it is; with part 1 for goal 1, part 2 for goal 2 and so on; and with parts named so by somebody
who takes one from either side by turns. Writes benchmarks/results/alike.md; what was measured is kept in
benchmarks/.measured/.
"""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Iterator
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import yaml

import twin
from benchmarks.machine import date_line, load_line, machine_line
from benchmarks.store import Row, RowStore
from scheduling.verification.verify import verify_plan
from twin.planning.part_assembly.alike import with_named_parts
from twin.scenario.manifest import load_scenario
from twin.scenario.sections.parts import PartsSection

ROOT = Path(__file__).parents[1]
MAGAZINE = ROOT / "scenarios" / "assembly" / "magazine.yaml"
WAYS = ("alike", "one by one", "one by one, from either side by turns")


def main() -> int:
    """Measure what is not in the store, and write the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", type=int, default=2, metavar="N")
    options = parser.parse_args()
    store = RowStore(ROOT / "benchmarks" / ".measured" / "alike", ROOT)
    rows = []
    for name in ("magazine", "crib"):
        for way in WAYS:
            for seed in range(options.seeds):
                key = f"{name}-{WAYS.index(way)}-{seed}"
                row = store.load(key) or store.save(key, measure(name, way, seed))
                sys.stderr.write(f"{key}: {row['makespan_s']:.2f} s\n")
                rows.append(row)
    target = ROOT / "benchmarks" / "results" / "alike.md"
    target.write_text("\n".join(table(rows, options.seeds)) + "\n", "utf-8")
    return 0


def crib() -> dict[str, Any]:
    """Return the scenario of a crib: ten layers of two bars across each other, from four racks of five."""
    document = yaml.safe_load(MAGAZINE.read_text(encoding="utf-8"))
    rack = {"counts": [1, 5], "pitch_m": [0.1, 0.06]}
    goals = [
        {
            "xyz_m": [
                -0.07 * (k % 2),
                -0.07 * (1 - k % 2),
                round(0.012 + 0.024 * k, 3),
            ],
            "rpy_deg": [0, 0, 90 * (k % 2)],
            "grid": {"counts": [1, 2], "pitch_m": [0.1, 0.14 * (-1) ** k]},
        }
        for k in range(10)
    ]
    bar = {
        "name": "bar",
        "size_m": [0.2, 0.024, 0.024],
        "mass_kg": 0.08,
        "count": 20,
        "starts": [
            {"xyz_m": [x, y, 0.012], "grid": rack}
            for x in (-0.4, 0.4)
            for y in (-0.45, 0.21)
        ],
        "goals": goals,
    }
    document |= {"name": "crib", "description": "Two arms build a crib of twenty bars."}
    document["assembly"] |= {"parts": [bar], "steps": ["bar"]}
    fixtures = document["cell"]["fixtures"]
    document["cell"]["fixtures"] = [f for f in fixtures if f["name"] == "table"]
    return document  # type: ignore[no-any-return]


def named(document: dict[str, Any], section: PartsSection, *, by_turns: bool) -> None:
    """Give every part an entry of its own in a scenario, and goals in their order, or from side to side."""
    parts = [
        part.model_dump(exclude_defaults=True, mode="json")
        for part in with_named_parts(section).parts
    ]
    if by_turns:
        sides: list[list[Any]] = [[], []]
        for part in parts:
            sides[part["start"]["xyz_m"][0] > 0].append(part["start"])
        for k, part in enumerate(parts):
            part["start"] = sides[k % 2][k // 2]
    document["assembly"]["parts"] = parts
    document["assembly"]["steps"] = [part["name"] for part in parts]


def measure(name: str, way: str, seed: int) -> Row:
    """Return makespan, waits and bounds of a run, with what audit and verification say."""
    before = os.getloadavg()[0]
    document = crib()
    if name == "magazine":
        document = yaml.safe_load(MAGAZINE.read_text(encoding="utf-8"))
    document["seed"] = seed
    with TemporaryDirectory() as place:
        file = Path(place) / "own.yaml"
        file.write_text(yaml.safe_dump(document), "utf-8")
        if way != "alike":
            section = load_scenario(file).assembly
            assert isinstance(section, PartsSection)
            named(document, section, by_turns=way == WAYS[2])
            file.write_text(yaml.safe_dump(document), "utf-8")
        run = twin.run(file, out=Path(place) / "run", recording=False)
        told, problems = run.summary, verify_plan(run.plan.tpg).problems
    kept = (
        "makespan_s",
        "makespan_sequential_s",
        "load_bound_s",
        "wait_s",
        "planning_s",
    )
    audit = told["audit"]["violations"]
    return {key: told[key] for key in kept} | {
        "name": name,
        "way": way,
        "clean": not audit and not problems,
        "load": (before, os.getloadavg()[0]),
    }


def table(rows: list[Row], seeds: int) -> list[str]:
    """Return the report, as lines of Markdown."""
    commits = ", ".join(sorted({row["commit"] for row in rows}))
    loads = load_line([tuple(row["load"]) for row in rows])
    return [
        "# Parts that are alike",
        "",
        f"{date_line()}, {machine_line()}, commit {commits}; {loads}. Made by"
        f" `python -m benchmarks.alike --seeds {seeds}`.",
        "",
        "A magazine of twelve pins (`scenarios/assembly/magazine.yaml`), and a crib of twenty bars from racks on",
        "either side of it; two arms. Alike: the integer program chooses which part comes to which goal. One by one:",
        "part 1 for goal 1, part 2 for goal 2, ...; and so with parts numbered from either side by turns, as somebody",
        "would who thinks of both arms. Makespans with shortcuts at nominal durations; idle is the share of that for",
        "which the arm that waits most waits. The bound of load is that of the parts as they are shared out.",
        "Means over the seeds.",
        "",
        "| cell | parts | one task at a time [s] | makespan [s] | idle | bound of load [s] | who does what [s] | audit, `twin verify` |",
        "|---|---|---:|---:|---:|---:|---:|---|",
        *_lines(rows),
    ]


def _lines(rows: list[Row]) -> Iterator[str]:
    for name, way in dict.fromkeys((row["name"], row["way"]) for row in rows):
        own = [row for row in rows if (row["name"], row["way"]) == (name, way)]

        def mean(key: str, own: list[Row] = own) -> float:
            return sum(float(row[key]) for row in own) / len(own)

        idle = sum(max(r["wait_s"].values()) / r["makespan_s"] for r in own) / len(own)
        chosen = sum(r["planning_s"]["assignment"] for r in own) / len(own)
        good = "clean, safe" if all(row["clean"] for row in own) else "**problems**"
        yield (
            f"| {name} | {way} | {mean('makespan_sequential_s'):.1f} | **{mean('makespan_s'):.1f}** "
            f"| {100 * idle:.0f} % | {mean('load_bound_s'):.1f} | {chosen:.1f} | {good} |"
        )


if __name__ == "__main__":
    sys.exit(main())
