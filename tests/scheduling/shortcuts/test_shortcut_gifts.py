"""Shortcuts keep clear of what a robot that stands has just been given."""

from __future__ import annotations

import numpy as np
import pytest

from planning.errors import PlanInvariantError
from planning.motion.speed import L1Speed
from scheduling.build_tpg import build_tpg
from scheduling.conflicts.derived_tpg import DerivedTpg
from scheduling.conflicts.object_spans import Rest
from scheduling.graph.temporal_plan_graph import TemporalPlanGraph
from scheduling.invariant import check_invariant
from scheduling.shortcuts import replacement_check as shortcut_check
from scheduling.shortcuts.shortcutting import Board
from tests.shipped_runs import ShippedRuns


@pytest.fixture(scope="module")
def cliff(shipped: ShippedRuns) -> TemporalPlanGraph:
    return build_tpg(shipped("lego/cliff").planned.motions.motion_plan)


def the_gift(tpg: TemporalPlanGraph) -> Rest:
    rests = DerivedTpg(tpg).history.rests
    (gift,) = [rest for rest in rests if rest.holder is not None]
    return gift


def take_detours(tpg: TemporalPlanGraph) -> int:
    """Offer quick ways back by where the giver held the brick; return how many were taken."""
    gift = the_gift(tpg)
    assert gift.after is not None
    giver, given = gift.after
    chain = tpg.chains[giver]
    reference = chain.waypoints[chain.first[given] : chain.first[given + 1]]
    taken = 0
    for halfway in reference[:-1]:
        for last in range(given + 3, given + 12):
            board = Board(tpg, {c.robot: L1Speed(20.0) for c in tpg.chains}, 0.05)
            which = next(
                k
                for k, span in enumerate(board.spans)
                if span.chain == giver and span.first <= given + 1 <= span.last
            )
            ends = chain.first[given + 1] - 1, chain.first[last + 1] - 1
            path = np.array(
                [chain.waypoints[ends[0]], halfway, chain.waypoints[ends[1]]]
            )
            if board.try_candidate(which, given + 1, last, path):
                check_invariant(DerivedTpg(board.graph.tpg))
                taken += 1
    return taken


def test_no_way_back_is_taken_through_what_was_given(
    cliff: TemporalPlanGraph, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert take_detours(cliff) > 0
    # Who does not look at the brick takes one that is not safe.
    monkeypatch.setattr(shortcut_check, "_gifts_stay_clear", lambda *_: True)
    with pytest.raises(PlanInvariantError, match="in a standing robot's hand"):
        take_detours(cliff)
