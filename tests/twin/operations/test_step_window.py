"""An assembly of which some steps at a time are planned while robots work."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from planning.errors import RequestError
from planning.lego.skills.candidates import (
    LazyBrickCandidates,
    find_candidates,
)
from planning.parts.candidates import LazyCandidates
from planning.parts.candidates import find_candidates as find_parts
from planning.tasks.assignment import AssignmentProblem
from planning.transforms import Indices
from scheduling.build_tpg import connect_nodes
from scheduling.conflicts.derived_tpg import DerivedTpg
from scheduling.graph.temporal_plan_graph import Causes, TemporalPlanGraph
from scheduling.invariant import check_invariant
from scheduling.rolling import extension
from tests.twin.operations.operated import (
    STACK,
    lost,
    operated,
    placed,
    require_own_contacts,
    require_resumed,
    require_safe,
    summary_of,
    tasks_of,
)
from tests.twin.program import invoke
from twin.kinds.lego.kind import build_lego
from twin.kinds.lego.section import LegoSection
from twin.kinds.parts.built import assembly_of
from twin.kinds.parts.kind import PartKind
from twin.operations.api import operate
from twin.planning.build_workcell import build_workcell
from twin.runs.summary import summary_rows
from twin.scenario.sections.kind import assembly_kind
from twin.trial.loaded_scenario import LoadedScenario, load
from twin.trial.plan_result import PlanResult
from twin.trial.planning import plan_scenario

ASSEMBLY = Path(__file__).parents[3] / "scenarios" / "assembly"
KITS = 5
Planned = Callable[[int, int], PlanResult]


@pytest.fixture(scope="module")
def stack_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    file = tmp_path_factory.mktemp("window") / "stack.yaml"
    file.write_text(STACK)
    return file


@pytest.fixture(scope="module")
def planned(stack_file: Path) -> Planned:
    @cache
    def plan(steps: int, least: int) -> PlanResult:
        window = {"steps": steps, "least": least}
        return plan_scenario(load(stack_file).varied({"window": window}), keep=True)

    return plan


@pytest.mark.nightly
@settings(max_examples=8, deadline=None)
@given(
    window=st.sampled_from([(1, 0), (1, 1), (2, 0), (2, 2), (3, 1)]),
    seed=st.integers(0, 2**32 - 1),
    chance=st.sampled_from([0.0, 0.25]),
)
def test_every_step_is_done_once_whatever_the_window(
    planned: Planned, window: tuple[int, int], seed: int, chance: float
) -> None:
    plan = planned(*window)
    assert len(plan.motions.task_plan.choices) == min(window[0], window[1] + 1)
    done, _ = operated(plan, seed, **lost(chance))
    check_invariant(DerivedTpg(done.tpg))
    assert all((own >= 0).all() for own in (*done.record.start_ns, *done.record.end_ns))
    assert sorted([*placed(done), *done.given_up]) == [1, 2, 3, 4]
    if not chance:
        assert done.record.outcome == "completed"
        require_safe(done.tpg)


@pytest.mark.parametrize("seed", [1, pytest.param(2, marks=pytest.mark.nightly)])
def test_executed_nodes_are_searched_once(
    planned: Planned, monkeypatch: pytest.MonkeyPatch, seed: int
) -> None:
    """A search of all nodes finds the same graph."""
    extended, skipped = 0, 0

    def compared(
        nodes: DerivedTpg,
        known: tuple[Indices, Causes],
        searched: Sequence[int],
        earlier: Sequence[int],
    ) -> TemporalPlanGraph:
        nonlocal extended, skipped
        found = connect_nodes(nodes, known, searched, earlier)
        slow = connect_nodes(DerivedTpg(nodes.tpg), known)
        assert np.array_equal(found.edges, slow.edges)
        assert np.array_equal(found.cause, slow.cause)
        extended, skipped = extended + 1, skipped + sum(searched)
        return found

    monkeypatch.setattr(extension, "connect_nodes", compared)
    done, _ = operated(planned(2, 0), seed, **lost(0.25))
    require_safe(done.tpg)
    assert extended > 1
    assert skipped > 0


def test_nothing_is_put_where_it_would_rest_on_a_step_that_is_given_up(
    planned: Planned,
) -> None:
    """Though nobody has looked at it when the step is given up."""
    never = {"probability": 1.0, "retries": 0}
    done, _ = operated(
        planned(1, 0), 0, **{"failures.place-down": never, "recovery.again": 0}
    )
    assert sorted(done.given_up) == [1, 2, 3, 4]
    whys = [done.given_up[step] for step in (2, 3, 4)]
    assert all(why.startswith("it rests on step ") for why in whys)
    assert not tasks_of(done, "place-down")


@pytest.mark.nightly
def test_steps_after_one_that_nobody_can_do_are_given_up(planned: Planned) -> None:
    """All that is picked is lost, so that there is no brick for the next step of the window."""
    loses = {"probability": 1.0, "retries": 0, "loses": 1.0}
    done, _ = operated(planned(1, 1), 0, **{"failures.pick": loses})
    assert sorted(done.given_up) == [1, 2, 3, 4]
    assert not tasks_of(done, "place-down")


def test_what_is_not_wanted_when_its_turn_comes_is_not_done(planned: Planned) -> None:
    change = {"at_s": 0.0, "drop": [4]}
    done, _ = operated(planned(1, 0), 0, changes=[change])
    assert list(done.dropped) == [4]
    assert done.record.outcome == "completed"
    assert placed(done) == [1, 2, 3]


def test_candidates_are_those_of_all_steps_at_once(stack_file: Path) -> None:
    case = load(stack_file)
    section = case.sections.assembly
    assert isinstance(section, LegoSection)
    cell, assembly = build_workcell(case.sections, case.folder), build_lego(section)
    whole = find_candidates(cell, assembly).problem
    lazy = LazyBrickCandidates(cell, assembly)
    for count in (1, 3, 4):
        known = lazy.first(count)

    assert told(known.problem) == told(whole)


@pytest.mark.nightly
@pytest.mark.parametrize("kits", [0, KITS])
def test_it_is_resumed_after_a_kill(
    stack_file: Path, kits: int, tmp_path: Path
) -> None:
    run, file = tmp_path / "run", ASSEMBLY / "kitting.yaml" if kits else stack_file
    said = ["--set", "window={steps: 2, least: 1}", "--failures", "0.3"]
    if kits:
        said += ["--set", f"assembly.products.count={kits}"]
    options = ("--no-recording", "--no-audit", "--quiet", "--out", str(run))
    invoke("operate", str(file), *said, *options)
    assert "come next" in require_resumed(run)
    # All that was executed one after another, not what the first window takes.
    summary = summary_of(run)
    assert summary["makespan_sequential_s"] > summary["makespan_s"]


@pytest.fixture(scope="module")
def line() -> LoadedScenario:
    """Five kits of four steps each, from a conveyor and three feeders."""
    return load(ASSEMBLY / "kitting.yaml").varied({"assembly.products.count": KITS})


def test_products_are_looked_at_one_after_another(line: LoadedScenario) -> None:
    kind = assembly_kind(line.sections.assembly).written_out()
    assert isinstance(kind, PartKind)
    cell, assembly = build_workcell(line.sections, line.folder, kind), kind.line
    whole = find_parts(cell, assembly_of(assembly))
    ahead = LazyCandidates(cell, assembly_of(assembly))
    for count in (4, 12, 8, 4 * KITS):
        some = ahead.first(count).problem.of_first(count)
        assert told(some) == told(whole.problem.of_first(count))


def told(problem: AssignmentProblem) -> tuple[object, ...]:
    """Return what a problem is made of, whatever the numbers of its candidates."""
    clashes = {
        (problem.primaries[p], problem.supports[s]) for p, s in problem.incompatible
    }
    return problem.steps, problem.primaries, problem.supports, clashes


@pytest.mark.parametrize(
    ("chance", "seed"),
    [(0.0, 0), *(pytest.param(0.15, k, marks=pytest.mark.nightly) for k in range(6))],
)
def test_whole_products_of_a_line_are_planned_at_a_time(
    line: LoadedScenario, chance: float, seed: int
) -> None:
    plan = plan_scenario(line.varied({"window": {"steps": 6, "least": 2}}), keep=True)
    assert len(plan.motions.task_plan.choices) == 4
    done, events = operated(plan, seed, **lost(chance))
    check_invariant(DerivedTpg(done.tpg))
    require_own_contacts(done.tpg)
    require_safe(done.tpg)
    placed = {t.step for t in done.tpg.tasks if t.kind == "place-down"}
    assert placed | done.given_up.keys() == set(range(1, 4 * KITS + 1))
    if not chance:
        assert not done.given_up
        told = " ".join(e.detail for e in events if e.kind == "replanned")
        comes = re.findall(r"steps (\d+) to (\d+) come next", told)
        assert comes == [("5", "12"), ("13", "20")]


@pytest.mark.nightly
@pytest.mark.parametrize("seed", [0, 1, 4, 7])
def test_spare_products_come_into_the_window_when_others_are_lost(
    line: LoadedScenario, seed: int
) -> None:
    products = {"count": 3, "spare": 4, "leave_s": 1.0}
    window = {"steps": 4, "least": 2}
    some = line.varied({"assembly.products": products, "window": window})
    done, _ = operated(plan_scenario(some, keep=True), seed, **lost(0.15))
    require_safe(done.tpg)
    assert done.record.outcome == "completed"
    placed = {t.step for t in done.tpg.tasks if t.kind == "place-down"}
    whole = placed - {k for n in done.scrapped for k in range(4 * n - 3, 4 * n + 1)}
    assert len(whole) == 4 * 3


@pytest.mark.nightly
def test_an_order_of_products_ends_where_nobody_can_make_the_next_ones() -> None:
    """The cart is out before the products that come into the window are begun."""
    products = {"count": 4, "spare": 1, "leave_s": 1.0}
    window = {"steps": 5, "least": 2}
    case = load(ASSEMBLY / "machine_tending.yaml")
    plan = plan_scenario(
        case.varied({"assembly.products": products, "window": window}), keep=True
    )
    outages = [{"robot": "cart", "at_s": 56.92}]
    done, _ = operated(plan, 249228, **lost(0.3), outages=outages)
    assert done.record.outcome == "failed"
    require_safe(done.tpg)


@pytest.mark.parametrize("name", ["magazine", "truss"])
def test_other_kinds_are_looked_at_as_a_whole(name: str) -> None:
    case = load(ASSEMBLY / f"{name}.yaml").varied({"window": {"steps": 2}})
    with pytest.raises(RequestError, match="only steps of a LEGO assembly, and prod"):
        plan_scenario(case, keep=True)


@pytest.mark.parametrize(
    ("said", "used"), [(None, {"steps": 8, "least": 3}), ("all", None)]
)
def test_a_large_assembly_of_bricks_is_planned_some_steps_at_a_time(
    said: str | None,
    used: dict[str, int] | None,
    stack_file: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("twin.kinds.lego.kind._MOST_AT_ONCE", 1)
    done = operate(
        load(stack_file).varied({"window": said}),
        out=tmp_path / "run",
        recording=False,
        audit=False,
    )
    assert done.outcome == "completed"
    assert done.summary["operation"].get("window") == used
    rows = [row for row in summary_rows(done.summary) if row[0] == "planned at a time"]
    assert len(rows) == (used is not None)
