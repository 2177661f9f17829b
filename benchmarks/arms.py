"""The same bricks put together by two, three and four arms around one plate.

    python -m benchmarks.arms [--of ring towers cliff] [--arms 2 3 4] [--everybody] [--write FOLDER]

The ring is of 56 bricks in four layers that bond, the towers are four of twelve bricks each, and every arm has
a feeding station of its own. The cliff is the shipped one: its bricks are those of two arms. With
``--everybody`` work is shared out among all arms, whether that is shorter or not. Printed are, by number of arms, the makespan, what the busiest arm has to do at least, the joint distance of the
assignment, how many steps each arm got, and processor seconds. With ``--write`` the scenarios are kept.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
from collections import Counter
from itertools import product
from pathlib import Path
from typing import Any

import yaml

import twin
import twin.trial.planning as planning

_ARMS = (
    ("left", (0.0, 0.0), 0, (3, 17)),
    ("right", (0.88, 0.0), 180, (43, 17)),
    ("front", (0.44, -0.44), 90, (17, 3)),
    ("back", (0.44, 0.44), -90, (17, 43)),
)
"""Name, base [m], heading [degrees], and the cell of the station, of each arm."""

_FROM, _WIDE, _LAYERS = 16, 16, 4
"""First stud and width of the ring on the plate, and how many layers it has."""


_CLIFF = Path(__file__).parents[1] / "scenarios" / "lego" / "cliff.yaml"


def arms_scenario(of: str, arms: int) -> dict[str, Any]:
    """Return the scenario of the ring, the towers or the cliff for so many arms."""
    chosen = _ARMS[:arms]
    robots = [
        {
            "name": name,
            "model": "gp4",
            "base": {"xyz_m": [*base, 0.9246], "rpy_deg": [0, 0, heading]},
        }
        for name, base, heading, _ in chosen
    ]
    stations = [
        {
            "name": f"{name}_station",
            "brick": "2x4",
            "at": [*at, 1],
            "turned": name in ("front", "back"),
            "station": True,
        }
        for name, _, _, at in chosen
    ]
    table = {
        "name": "table",
        "size_m": [0.6, 0.6, 0.02],
        "pose": {"xyz_m": [0.44, 0, 1.1045]},
    }
    if of == "cliff":
        found: dict[str, Any] = yaml.safe_load(_CLIFF.read_text(encoding="utf-8"))
        cell = {"robots": robots, "fixtures": [table]}
        return {**found, "name": f"cliff_{arms}", "cell": cell}
    ring = [_layer(z % 2 == 0) for z in range(_LAYERS)]
    return {
        "version": 1,
        "name": f"{of}_{arms}",
        "seed": 0,
        "cell": {"robots": robots, "fixtures": [table]},
        "assembly": {
            "kind": "lego",
            "plate": {"pose": {"xyz_m": [0.44, 0, 1.1145]}, "studs": [48, 48]},
            "structure": {
                "origin": [_FROM, _FROM],
                "layers": ring if of == "ring" else [_four_bricks()] * 12,
            },
            "stock": stations,
        },
    }


def _layer(along_x: bool) -> str:
    """Return the drawing of a layer, whose long sides lie along x or along y."""
    rows = [["."] * _WIDE for _ in range(_WIDE)]
    letters = iter("ABCDEFGHIJKLMN")
    for side in (0, _WIDE - 2):
        for first in range(0, _WIDE, 4):
            letter = next(letters)
            for k in range(8):
                rows[side + k // 4][first + k % 4] = letter
    for side in (0, _WIDE - 2):
        for first in range(2, _WIDE - 2, 4):
            letter = next(letters)
            for k in range(8):
                rows[first + k % 4][side + k // 4] = letter
    if not along_x:
        rows = [list(column) for column in zip(*rows, strict=True)]
    return "".join("".join(row) + "\n" for row in rows)


def _four_bricks() -> str:
    """Return the drawing of a layer of four towers, one near each corner."""
    rows = [["."] * _WIDE for _ in range(_WIDE)]
    for letter, (x, y) in zip(
        "ABCD", ((3, 3), (11, 3), (3, 11), (11, 11)), strict=True
    ):
        for k in range(8):
            rows[y + k // 4][x - 1 + k % 4] = letter
    return "".join("".join(row) + "\n" for row in rows)


def main() -> None:
    """Plan, execute and print a row for every number of arms."""
    parser = argparse.ArgumentParser(description=__doc__)
    kinds = ["ring", "towers", "cliff"]
    parser.add_argument("--of", nargs="+", default=kinds, choices=kinds)
    parser.add_argument("--everybody", action="store_true")
    parser.add_argument("--arms", type=int, nargs="+", default=[2, 3, 4])
    parser.add_argument("--write", type=Path)
    args = parser.parse_args()
    if args.everybody:
        setattr(planning, "chooses_crew", lambda _: False)  # noqa: B010 - to compare
    sys.stdout.write(
        "| structure | arms | makespan [s] | busiest arm [s] | cost [rad] | steps | CPU s |\n"
        "|---|---:|---:|---:|---:|---|---:|\n"
    )
    with tempfile.TemporaryDirectory() as folder:
        for of, arms in product(args.of, args.arms):
            path = (args.write or Path(folder)) / f"{of}_{arms}.yaml"
            path.write_text(yaml.safe_dump(arms_scenario(of, arms), sort_keys=False))
            start = time.process_time()
            plan = twin.plan(twin.load(path))
            took = time.process_time() - start
            run = twin.simulate(plan)
            tasks = plan.motions.task_plan.choices
            steps = Counter(choice.robot for choice in tasks)
            shares = ", ".join(f"{name} {count}" for name, count in steps.items())
            cost = sum(choice.cost for choice in tasks)
            bound = plan.load_bound_s or 0.0
            sys.stdout.write(
                f"| {of} | {arms} | {run.makespan_s:.1f} | {bound:.1f} | {cost:.1f} | {shares} |"
                f" {took:.1f} |\n"
            )
            sys.stdout.flush()


if __name__ == "__main__":
    main()
