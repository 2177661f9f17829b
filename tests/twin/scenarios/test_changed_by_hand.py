"""Plans of shipped scenarios that were changed by hand are not called safe."""

from __future__ import annotations

from dataclasses import replace

import pytest

from planning.transforms import Transform, translation
from scheduling.graph.plan_files import load_plan
from scheduling.graph.temporal_plan_graph import TemporalPlanGraph
from scheduling.verification.verify import verify_plan
from tests.shipped_runs import ShippedRuns


def with_part_moved(tpg: TemporalPlanGraph, k: int, by: Transform) -> TemporalPlanGraph:
    """Move what changes hands in the k-th handling, in the task as in the node."""
    h = tpg.handlings[k]
    pose = h.pose @ by
    index = int(tpg.chains[h.robot].task[h.node])
    handlings, tasks = list(tpg.handlings), list(tpg.tasks)
    handlings[k] = replace(h, pose=pose)
    said = tuple(
        replace(s, pose=pose) if (s.object, s.holder) == (h.object, h.holder) else s
        for s in tasks[index].handlings
    )
    tasks[index] = replace(tasks[index], handlings=said)
    return replace(tpg, handlings=tuple(handlings), tasks=tuple(tasks))


@pytest.mark.parametrize(
    ("name", "robots", "kinds"),
    [
        ("lego/cliff", None, ["pick", "place-down", "place-up", "handover"]),
        pytest.param(
            *("assembly/taskboard", None, ["pick", "place-down"]),
            marks=pytest.mark.nightly,
        ),
        ("multi_arm/tray", None, ["pick", "place-down"]),
        ("construction/tower", 2, ["pick", "place-down"]),
    ],
)
def test_parts_that_are_moved_as_they_change_hands_are_found(
    shipped: ShippedRuns, name: str, robots: int | None, kinds: list[str]
) -> None:
    tpg = load_plan(shipped(name, robots).trial.folder)
    kind = [
        tpg.tasks[int(tpg.chains[h.robot].task[h.node])].kind for h in tpg.handlings
    ]
    for wanted in kinds:
        own = [k for k, found in enumerate(kind) if found == wanted]
        for k in sorted({own[0], own[-1]}):
            moved = with_part_moved(tpg, k, translation(0.0, 0.02, 0.0))
            (problem,) = verify_plan(moved, limit=1).problems
            assert problem.kind == "jump"
            assert "20.00 mm away from where" in problem.message
