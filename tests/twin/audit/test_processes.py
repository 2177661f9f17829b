"""The audit sees processes that were done where they belong, however short they were."""

from __future__ import annotations

from contextlib import closing
from dataclasses import replace

import numpy as np
import pytest

from planning.tasks.task import Task
from planning.transforms import Transform, translation
from scheduling.graph.temporal_plan_graph import TemporalPlanGraph
from tests.twin.audit.audit_cell import (
    TOP,
    HandWrittenRun,
    reach,
    two_arm_cell,
)
from twin.audit.case import AuditCase
from twin.audit.motion.executed import Recording, RobotRows
from twin.audit.processes import process_violations
from twin.audit.wanted import Wanted, WantedProcess
from twin.audit.worlds.engines import open_world

HIGH = TOP + 0.1


def said(place: Transform, *, passed: bool = True) -> list[str]:
    """What the audit says of a process of 0 s, done where ``left`` is at 2 s of its way and back.

    Args:
        place: where it is wanted.
        passed: whether the run goes on behind it.
    """
    cell = two_arm_cell()
    there = reach(cell, "left", 0.42, 0.0, HIGH)
    home = cell.robot("left").home
    run = HandWrittenRun(cell)
    run.move("left", [0.0, 2.0, 2.0, 4.0], np.stack([home, there, there, home]))
    plan: TemporalPlanGraph = run.tpg()
    kinds = ("transit", "snap", "transit")
    tasks = tuple(
        Task(k, "left", kind, 1, kind, plan.chains[0].waypoints[k : k + 1])
        for k, kind in enumerate(kinds)
    )
    chain = replace(plan.chains[0], task=np.arange(3))
    plan = replace(plan, tasks=tasks, chains=(chain,))
    # Within limits times rise: what takes no time has no row.
    kept = [0, 1, 3] if passed else [0, 1]
    t, q = run.motions["left"]
    rows = {"left": RobotRows(t[kept], q[kept], np.array(kept) - 1)}
    still = cell.robot("right").home[None]
    rows["right"] = RobotRows(np.zeros(1), still, np.full(1, -1))
    snap = WantedProcess("snap in", "snap", None, place, (np.eye(4),))
    recording, wanted = Recording(rows, (), 4.0), Wanted(processes=(snap,))
    with closing(open_world(cell)) as world:
        found = process_violations(AuditCase(world, plan, recording, wanted))
        return [violation.detail for violation in found]


@pytest.mark.parametrize(
    ("place", "words"),
    [
        (translation(0.42, 0.0, HIGH), []),
        (
            translation(0.45, 0.0, HIGH),
            ["its tool comes no nearer than 30.00 mm to its place"],
        ),
    ],
)
def test_what_takes_no_time_is_done_where_it_is_passed(
    place: Transform, words: list[str]
) -> None:
    assert said(place) == words


def test_what_is_not_come_to_is_not_done() -> None:
    assert said(translation(0.42, 0.0, HIGH), passed=False) == ["was not done"]
