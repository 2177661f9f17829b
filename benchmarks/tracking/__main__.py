"""How well controllers follow exported trajectories, with limits of acceleration and without.

    python -m benchmarks.tracking                     # all cases, a minute of each
    python -m benchmarks.tracking cliff boat --seconds 20

Runs ``twin run`` and ``twin export -f joint-trajectory`` for each scenario, within limits and without;
then PyBullet's dynamics follow the exported file. Nothing of the planner is used from there on: the
plant knows the robots' URDF files, where they stand, what parts weigh, and the file.
Runs are kept in benchmarks/.measured as long as the program stays the same.

Writes benchmarks/results/tracking.json after every case, tracking.md and the picture of that.
"""

import argparse
import json
import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.tracking.cases import CASES, KEPT, ROOT, WITHIN, Case
from benchmarks.tracking.controller import (
    PERIOD_S,
    ComputedTorque,
    Controller,
    JointByJoint,
)
from benchmarks.tracking.described_robot import DescribedRobot, described_robots
from benchmarks.tracking.exported_motion import ExportedMotion, read_exported_motion
from benchmarks.tracking.following import (
    FOLLOWING_ERROR,
    Followed,
    follow,
    least_distances,
)
from benchmarks.tracking.plant import Flaws
from benchmarks.tracking.report import SPACING_S, draw_errors, report
from planning.transforms import Array
from twin.host.guard import write_json

RESULTS = ROOT / "benchmarks" / "results"
PICTURE = ROOT / "docs" / "images" / "tracking.png"
HEAVIER = 0.1
FRICTION = 0.1
"""Dry friction as a share of the torque that a joint needs at most, all as described."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Measure some cases, or all."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n", 1)[0])
    names = [case.name for case in CASES]
    parser.add_argument("cases", nargs="*", metavar="CASE", help=", ".join(names))
    parser.add_argument("--seconds", type=float, default=60.0, help="of each motion")
    options = parser.parse_args(arguments)
    chosen = options.cases or names
    if unknown := set(chosen) - set(names):
        parser.error(f"no case {sorted(unknown)[0]!r}: choose from {', '.join(names)}")
    for case in CASES:
        if case.name in chosen:
            _keep(case, *measure(case, options.seconds))
            sys.stdout.write(f"{case.name}: done\n")
            sys.stdout.flush()
    return 0


def _keep(case: Case, found: dict[str, Any], errors: dict[str, list[float]]) -> None:
    """Add what was measured to the results, in the order of CASES."""
    target, series = RESULTS / "tracking.json", KEPT / "errors.json"
    rows, kept = (
        json.loads(path.read_text(encoding="utf-8")) if path.exists() else {}
        for path in (target, series)
    )
    rows[case.name], kept[case.name] = found, errors
    rows = {known.name: rows[known.name] for known in CASES if known.name in rows}
    write_json(target, rows)
    write_json(series, kept)
    (RESULTS / "tracking.md").write_text(report(rows), encoding="utf-8")
    draw_errors(PICTURE, rows, kept)


def measure(
    case: Case, seconds: float
) -> tuple[dict[str, Any], dict[str, list[float]]]:
    """Return the figures of a case and its errors over time, within limits and without.

    Args:
        case: what is followed.
        seconds: of its motions, from the beginning.
    """
    friction: tuple[Array, ...] = ()
    found: dict[str, Any] = {}
    errors: dict[str, list[float]] = {}
    for key, speed_model in (("within", WITHIN), ("free", case.free)):
        folder = case.folder(speed_model)
        whole = read_exported_motion(_exported(folder))
        motion = replace(whole, end_s=min(whole.end_s, seconds))
        robots = described_robots(folder)
        exact = follow(robots, motion)
        friction = friction or _friction(robots, exact)
        flawed = Flaws(HEAVIER, friction)
        found[key] = {
            "end_s": whole.end_s,
            "followed_s": motion.end_s,
            "exact": _figures(robots, exact),
            "flawed": _again(robots, motion, flawed, ComputedTorque),
            "distances_m": least_distances(robots, exact),
        }
        errors[key] = _errors(exact)
        if motion.within_limits:
            alone = _again(robots, motion, Flaws(), JointByJoint)
            found[key]["joint_by_joint"] = alone
    return found, errors


def _exported(folder: Path) -> Path:
    return folder / "exports" / "joint_trajectories.json"


def _friction(
    robots: Sequence[DescribedRobot], followed: Sequence[Followed]
) -> tuple[Array, ...]:
    """Return the dry friction of joints, from what they need where all is as described."""
    return tuple(
        FRICTION * np.minimum(np.max(own.torque, axis=0), robot.effort)
        for robot, own in zip(robots, followed, strict=True)
    )


def _again(
    robots: Sequence[DescribedRobot],
    motion: ExportedMotion,
    flaws: Flaws,
    controller: type[Controller],
) -> dict[str, Any]:
    return _figures(robots, follow(robots, motion, flaws, controller))


def _figures(
    robots: Sequence[DescribedRobot],
    followed: Sequence[Followed],
) -> dict[str, Any]:
    """Return largest and usual errors, torques, and when a robot was lost [rad, m, s]."""
    turning, sliding = [0.0], [0.0]
    for robot, own in zip(robots, followed, strict=True):
        worst = np.max(own.error, axis=0)
        slides = np.array(robot.sliding)
        turning += worst[~slides].tolist()
        sliding += worst[slides].tolist()
    worst_now = np.max([np.max(own.error, axis=1) for own in followed], axis=0)
    lost = bool(worst_now[-1] >= FOLLOWING_ERROR)
    return {
        "error_rad": max(turning),
        "error_m": max(sliding) if any(any(r.sliding) for r in robots) else None,
        "rms": float(np.sqrt(np.mean(worst_now**2))),
        "torque": max(
            float(np.max(own.torque / robot.effort))
            for robot, own in zip(robots, followed, strict=True)
        ),
        "lost_s": len(worst_now) * PERIOD_S if lost else None,
    }


def _errors(followed: Sequence[Followed]) -> list[float]:
    """Return the largest error of any joint in every SPACING_S [rad or m]."""
    worst = np.max([np.max(own.error, axis=1) for own in followed], axis=0)
    starts = np.arange(0, len(worst), round(SPACING_S / PERIOD_S))
    return [round(value, 9) for value in np.maximum.reduceat(worst, starts).tolist()]


if __name__ == "__main__":
    sys.exit(main())
