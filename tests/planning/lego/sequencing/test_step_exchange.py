"""Exchanged steps: every order that stands, no other one, and the candidates of a fresh search."""

from collections.abc import Iterator
from dataclasses import replace
from itertools import permutations
from pathlib import Path

import pytest

from planning.errors import InfeasibleStepError
from planning.lego.bricks.assembly import LegoAssembly
from planning.lego.insertion.rules import SequencingRules
from planning.lego.sequencing.sequencing import sequence_structure
from planning.lego.sequencing.stable_steps import movable_work, stable_steps
from planning.lego.skills.candidates import LegoCandidates, find_candidates
from planning.tasks.assignment import AssignmentProblem, TaskPlan
from planning.tasks.highs_solver import assign_steps
from planning.tasks.work import AssemblyWork
from scheduling.ordering.improvement import exchange_steps, move_step
from tests.twin.planning.facing_arms import FACING_ARMS
from tests.twin.written import loaded
from twin.planning.build_workcell import build_workcell
from twin.planning.lego import build_lego
from twin.scenario.sections.lego import LegoSection

STEPS = """\
  stock:
    - {name: left_a, brick: 2x4, at: [2, 30, 1]}
    - {name: left_b, brick: 2x4, at: [6, 30, 1]}
    - {name: left_c, brick: 2x4, at: [6, 20, 1]}
    - {name: right_a, brick: 2x4, at: [44, 30, 1]}
    - {name: right_b, brick: 2x4, at: [40, 30, 1]}
    - {name: left_d, brick: 2x6, at: [2, 20, 1]}
    - {name: right_d, brick: 2x6, at: [44, 20, 1]}
  steps:
    - {brick: 2x4, at: [23, 15, 1]}
    - {brick: 2x4, at: [23, 19, 1]}
    - {brick: 2x6, at: [23, 16, 2]}
    - {brick: 2x4, at: [23, 29, 1]}
    - {brick: 2x4, at: [23, 29, 2]}
"""
"""A brick across two others, and a column apart."""

RULES = SequencingRules()


@pytest.fixture(scope="module")
def candidates(tmp_path_factory: pytest.TempPathFactory) -> LegoCandidates:
    scenario = loaded(tmp_path_factory.mktemp("five"), FACING_ARMS + STEPS)
    cell = build_workcell(scenario, Path())
    assert isinstance(scenario.assembly, LegoSection)
    assembly = stable_steps(build_lego(scenario.assembly), RULES)
    return find_candidates(cell, assembly)


def _orders(work: AssemblyWork) -> dict[tuple[int, ...], AssemblyWork]:
    """Return the works of all orders that exchanges lead to."""
    found, fresh = {work.order: work}, [work]
    while fresh:
        now = fresh.pop()
        for at in range(1, len(now.order)):
            other = now.exchanged(at)
            if other is not None and other.order not in found:
                found[other.order] = other
                fresh.append(other)
    return found


def _buildable(assembly: LegoAssembly) -> Iterator[tuple[int, ...]]:
    """Yield the orders in which nothing is under another brick too late, and all stands."""
    steps = assembly.steps
    for order in permutations(range(1, len(steps) + 1)):
        moved = tuple(steps[k - 1] for k in order)
        covered = [s.studs for s in moved]
        late = any(
            covered[a] & covered[b] and moved[a].cell.level > moved[b].cell.level
            for b in range(len(moved))
            for a in range(b)
        )
        try:
            if not late:
                stable_steps(replace(assembly, steps=moved), RULES)
                yield order
        except InfeasibleStepError:
            continue


def _ways(problem: AssignmentProblem) -> set[object]:
    goes = {
        (problem.primaries[p], problem.supports[s])
        for step, own in problem.primaries_of.items()
        for p in own
        for s in problem.supports_of.get(step, [])
        if problem.compatible(p, s)
    }
    return {*problem.primaries, *problem.supports, *goes}


def test_exchanges_lead_to_every_order_that_can_be_built(
    candidates: LegoCandidates,
) -> None:
    orders = _orders(movable_work(candidates, RULES))
    assert set(orders) == set(_buildable(candidates.world.assembly))
    assert len(orders) == 2 * 10  # 1 and 2 before 3; 4 before 5


@pytest.mark.nightly
def test_candidates_are_those_of_a_fresh_search(candidates: LegoCandidates) -> None:
    for order, work in _orders(movable_work(candidates, RULES)).items():
        fresh = find_candidates(candidates.world.cell, work.assembly)
        assert _ways(work.problem) == _ways(fresh.problem), order
        assert work.problem.steps == fresh.problem.steps
        assert work.problem.needs_support == fresh.problem.needs_support


def test_a_sequence_that_was_found_stays_one(candidates: LegoCandidates) -> None:
    """In every order the structure stands and bears the presses, whatever way each brick takes."""
    world = candidates.world
    structure = world.assembly.structure
    found = sequence_structure(structure, rules=RULES)
    assembly = replace(world.assembly, steps=found.steps)
    names = [item.name for item in found.sequence]
    work = movable_work(find_candidates(world.cell, assembly), RULES, names)
    orders = _orders(work)
    assert len(orders) == 2 * 10
    bricks = {item.name: (item.brick, item.cell) for item in structure}
    for order, other in orders.items():
        assert stable_steps(other.assembly, RULES) is not None
        assert [(s.brick, s.cell) for s in other.assembly.steps] == [
            bricks[names[k - 1]] for k in order
        ]


def test_work_in_its_order_has_no_other(candidates: LegoCandidates) -> None:
    work = movable_work(candidates, RULES)
    assert len(_orders(work)) > 1
    assert len(_orders(work.in_this_order())) == 1


def _objects(plan: TaskPlan) -> list[str]:
    return sorted(choice.object for choice in plan.choices)


def test_a_plan_keeps_its_choices_in_another_order(candidates: LegoCandidates) -> None:
    work = movable_work(candidates, RULES)
    plan = assign_steps(work.problem)
    moved = move_step(work, plan, 4, -2)
    assert moved is not None
    assert moved[0].order == (1, 4, 2, 3, 5)
    assert _objects(moved[1]) == _objects(plan)
    for place, step in enumerate(moved[0].order, start=1):
        assert moved[1][place].step == place
        assert moved[1][place].robot == plan[step].robot
        assert moved[1][place].primary in moved[0].problem.primaries
    assert exchange_steps(work, plan, 2) is None
    assert exchange_steps(work, plan, 5) is None
    # As far as it goes: step 3 stays behind step 2.
    assert move_step(*moved, 4, -3) is None
