"""Rounds of placements: the best of a few tries, against all tries written out."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from planning.construction.planner import Round, Rounds
from planning.construction.problem.problem import Part, SearchSettings
from planning.construction.subproblem import Solution
from planning.construction.world.fixed_world import Building, nothing_built
from tests.planning.construction.toy_sites import toy_part, toy_problem

PARTS = 7
PROBLEM = toy_problem(
    tuple(
        toy_part(f"p{k}", (0.2, 0.1, 0.1), (float(k), 0.0, 0.1)) for k in range(PARTS)
    ),
    3,
)


class Told:
    """Places parts in their order, with losses from a table; NaN where it cannot.

    Args:
        losses: by step and turn, shape (parts, turns) [s].
    """

    problem = PROBLEM

    def __init__(self, losses: np.ndarray) -> None:
        self.losses = losses
        self.spent = 0
        self.spent_again = 0

    def next_parts(self, building: Building) -> list[Part]:
        return list(PROBLEM.parts[len(building.placed) :])

    def place_next(
        self, building: Building, parts: list[Part], turn: int, most_loss: float
    ) -> Solution | None:
        self.spent += 1
        self.spent_again += turn > 0
        loss = float(self.losses[len(building.placed), turn])
        if not loss < most_loss:
            return None
        placed = {**building.placed, parts[0].name: 1.0 + len(building.placed)}
        return Solution(replace(building, placed=placed), 0.0, loss)


def planned(told: Told, search: SearchSettings) -> list[Round]:
    """All rounds, up to one in which a part could not be placed."""
    rounds, now, out = Rounds(told, search), nothing_built(PROBLEM), []
    while len(now.placed) < PARTS:
        out.append(rounds.next(now))
        if out[-1].stuck is not None:
            break
        now = out[-1].states[-1]
    return out


def losses_of(seed: int, turns: int) -> np.ndarray:
    rng = np.random.default_rng(seed)
    losses = rng.uniform(0.0, 10.0, (PARTS, turns))
    losses[rng.random(losses.shape) < 0.15] = np.nan
    return losses


@given(st.integers(0, 2**31), st.integers(1, 4), st.floats(0.0, 8.0))
@settings(max_examples=200, deadline=None)
def test_a_round_is_the_best_of_its_tries(
    seed: int, tries: int, acceptable: float
) -> None:
    losses = losses_of(seed, tries)
    search = SearchSettings(
        round=5, tries=tries, acceptable_loss_s=acceptable, again=1e9
    )
    first = 0
    # Three robots make rounds of three; the last one takes what is left.
    for found, size in zip(planned(Told(losses), search), (3, 4), strict=False):
        steps = slice(first, first + size)
        totals = losses[steps].sum(axis=0)  # NaN where a part cannot be placed
        if np.isnan(totals[0]):
            assert found.stuck == PROBLEM.parts[first + len(found.states)]
            assert np.isnan(losses[first + len(found.states), 0])
            return
        best = totals[0]
        for total in totals[1:]:
            if best <= acceptable * size:
                break
            best = min(best, total) if not np.isnan(total) else best
        assert found.stuck is None
        assert len(found.states) == size
        np.testing.assert_allclose(found.lost, best)
        first += size
    assert first == PARTS


@given(st.integers(0, 2**31), st.floats(0.0, 6.0))
@settings(max_examples=100, deadline=None)
def test_no_more_is_spent_on_tries_than_allowed(seed: int, again: float) -> None:
    told = Told(np.nan_to_num(losses_of(seed, 4), nan=5.0))
    search = SearchSettings(round=5, tries=4, acceptable_loss_s=0.0, again=again)
    planned(told, search)
    # The try with which the allowance ends may overdraw it, by less than a round.
    assert told.spent_again < again * PARTS / 3 + 4
    assert told.spent_again > 0 or again == 0.0


def test_robots_with_nothing_left_to_do_lose_time() -> None:
    stand = np.array([0.0, 4.0])
    home = np.tile(PROBLEM.cell.robots[0].home, (2, 1))
    start = nothing_built(PROBLEM).moved(PROBLEM.team[0], stand, home)
    told = Told(np.zeros((PARTS, 1)))
    rounds = Rounds(told, SearchSettings(tries=1))
    first = rounds.next(start)
    assert first.lost == 0.0
    last = rounds.next(first.states[-1])
    assert last.lost == 8.0  # two robots have been free since 0 s, one since 4 s
