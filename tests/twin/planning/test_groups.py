"""Groups of products that batches interleave: each planned once, as if all products had been planned together."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path

import networkx as nx
import numpy as np
import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st

from planning.cell.differences import cell_differences
from planning.motion.motion_plan import MotionPlan
from planning.tasks.task import Task, TaskKind
from planning.tasks.task_graph import task_graph
from planning.transforms import Indices
from scheduling.build_tpg import connect_nodes
from scheduling.conflicts.derived_tpg import DerivedTpg
from scheduling.graph.temporal_plan_graph import TemporalPlanGraph
from scheduling.invariant import check_invariant
from tests.assembly_section import assembly_section
from tests.twin.scenarios.ovens import OVEN
from tests.twin.written import checked, loaded, written
from twin.host.progress import StageWatch
from twin.kinds.parts.section import PartsSection
from twin.kinds.parts.units import distinct_products, line_units
from twin.planning.build_workcell import build_workcell
from twin.planning.pipeline import plan_motions
from twin.trial.planning import plan_scenario

MIX = Path(__file__).parents[3] / "scenarios" / "lines" / "mix.yaml"
UNNAMED = (
    TaskKind.TRANSIT,
    TaskKind.STRAIGHT,
    TaskKind.TAKE_TOOL,
    TaskKind.LEAVE_TOOL,
)
"""Tasks at whose places those of units differ: each unit ends at HOME with the tools that it began with."""

TRAY = "{kind: tray, pose: {xyz_m: [-0.35, -0.33, 0.015]}, grid: {counts: [1, 3], pitch_m: [0, 0.07]}, refill_s: 2.0}"


def ovens(
    order: list[str],
    count: int,
    places: int = 2,
    batches: Sequence[int] = (),
    **products: object,
) -> str:
    """Return an oven that bakes some of the products, which come from a tray of three places."""
    document = yaml.safe_load(OVEN)
    parts = document["assembly"]
    parts["sources"]["blanks"] = yaml.safe_load(TRAY)
    parts["machines"]["oven"]["batches"] = list(batches)
    load, bake, _ = parts["steps"]
    load["variants"] = bake["variants"] = ["baked"]
    load["at"]["grid"] = {"counts": [places, 1], "pitch_m": [0.08 / (places - 1), 0]}
    parts["parts"][0]["size_m"] = [0.025, 0.025, 0.03]
    variants: dict[str, object] = {name: {} for name in order}
    own = {"count": count, "variants": variants, "order": order, **products}
    parts["products"] |= own
    document["planning"]["shortcut_candidates"] = 0
    return yaml.safe_dump(document)


def waits(tasks: tuple[Task, ...], pairs: Indices) -> set[tuple[str, str]]:
    """Return which task waits for which others, by names, without motions and tools."""
    names = [
        f"{task.robot}: {task.kind} {task.object} {task.step}"
        if task.kind not in UNNAMED
        else ""
        for task in tasks
    ]
    graph: nx.DiGraph[int] = nx.DiGraph(task_graph(tasks, pairs).edges)
    closure = nx.transitive_closure_dag(graph).edges
    return {(names[a], names[b]) for a, b in closure if names[a] and names[b]}


def require_same(tpg: TemporalPlanGraph, every: MotionPlan) -> None:
    """Require that units wait as all products that are planned together, and have the edges of all nodes built."""
    assert waits(tpg.tasks, tpg.dependencies) == waits(every.tasks, every.dependencies)
    slow = connect_nodes(DerivedTpg(tpg))
    assert np.array_equal(tpg.edges, slow.edges)
    assert np.array_equal(tpg.cause, slow.cause)
    check_invariant(DerivedTpg(tpg))


def test_groups_planned_once_are_as_if_all_were_planned(tmp_path: Path) -> None:
    """A tray is exchanged within a batch, places alternate, and the last batch is smaller."""
    order = ["baked", "plain", "baked", "baked"]
    own = loaded(tmp_path, ovens(order, 10, in_progress=5))
    units = own.kind.units()
    assert [unit.line.period for unit in units] == [3, 2, 1, 2]  # type: ignore[attr-defined]
    tpg = plan_scenario(own, tmp_path).tpg
    require_same(tpg, plan_motions(own, tmp_path, StageWatch(), whole=True).motion_plan)


@pytest.mark.nightly
@settings(max_examples=12, deadline=None)
@given(
    order=st.lists(st.sampled_from(["baked", "plain"]), max_size=3),
    count=st.integers(3, 9),
    places=st.integers(2, 3),
    bound=st.sampled_from([None, 5, 6]),
    batches=st.lists(st.integers(1, 2), max_size=3),
)
def test_any_groups_are_as_if_all_were_planned(
    order: list[str],
    count: int,
    places: int,
    bound: int | None,
    batches: list[int],
    tmp_path_factory: pytest.TempPathFactory,
) -> None:
    folder = tmp_path_factory.mktemp("ovens")
    text = ovens(["baked", *order], count, places, batches, in_progress=bound)
    own = loaded(folder, text)
    every = plan_motions(own, folder, StageWatch(), whole=True).motion_plan
    require_same(plan_scenario(own, folder).tpg, every)


@pytest.mark.nightly
@pytest.mark.parametrize("count", [12, 14])
def test_a_mix_is_as_if_all_products_were_planned(count: int, tmp_path: Path) -> None:
    text = MIX.read_text("utf-8").replace("count: 8", f"count: {count}")
    text = text.replace("speed_rad_s: 2.0", "shortcut_candidates: 0")
    own = loaded(tmp_path, text)
    assert len(own.kind.units()) > 2
    every = plan_motions(own, tmp_path, StageWatch(), whole=True).motion_plan
    tpg = plan_scenario(own, tmp_path).tpg
    require_same(tpg, every)
    # A plan that is saved is used for a cell with the same objects in the same order.
    assert list(cell_differences(tpg.cell, build_workcell(own, tmp_path))) == []


@settings(max_examples=15, deadline=None)
@given(
    order=st.lists(st.sampled_from(["baked", "plain"]), min_size=1, max_size=5),
    count=st.integers(1, 40),
    places=st.integers(2, 3),
    batches=st.lists(st.integers(1, 2), max_size=20),
)
def test_a_group_begins_with_what_the_ones_before_left(
    order: list[str], count: int, places: int, batches: list[int]
) -> None:
    """Names and poses of all parts are followed through the groups, step by step."""
    document = yaml.safe_load(ovens(order, count, places, batches))["assembly"]
    section = PartsSection.model_validate_json(json.dumps(document))
    found = line_units(section.model_dump_json())
    line = found.line
    there = {
        part.name: part.start
        for part in line.section.parts
        if part.name not in line.later
    }
    goals = {part.name: part.goal for part in line.section.parts}
    starts = {part.name: part.start for part in line.section.parts}
    done = products = 0
    for number, names in zip(found.order, found.names, strict=True):
        unit = found.units[number]
        own = {names[part.name]: part for part in unit.section.parts}
        begin = {k: x.start for k, x in own.items() if x.name not in unit.later}
        assert begin == there
        for k, step in enumerate(unit.section.steps, start=1):
            written_out = line.section.steps[done + k - 1]
            assert names.get(step.place or "", None) == written_out.place
            if k in unit.jobs:
                together = tuple(names[part] for part in unit.jobs[k].parts)
                assert together == line.jobs[done + k].parts
            assert (step.at and step.at.pose) == (
                written_out.at and written_out.at.pose
            )
            assert unit.origins[k - 1][0] + products == line.origins[done + k - 1][0]
            if written_out.place and not written_out.at:
                there[written_out.place] = goals[written_out.place]
            came = line.supply.refills.get(done + k)
            assert (
                [names[x] for x, _ in unit.supply.refills[k].parts]
                == [x for x, _ in came.parts]
                if came
                else k not in unit.supply.refills
            )
            there |= {x: starts[x] for x, _ in came.parts} if came else {}
            left = line.supply.leaves.get(done + k)
            for gone, _ in left.parts if left else ():
                del there[gone]
        done, products = done + len(unit.section.steps), products + unit.period
    assert (done, products) == (len(line.section.steps), count)


def test_of_equal_products_the_first_ones_are_checked(tmp_path: Path) -> None:
    """The farthest place of a tray is found among the first products."""
    found = []
    for count in (9, 60):
        text = ovens(["baked", "plain"], count).replace("- 0.07\n", "- 0.9\n")
        own = loaded(tmp_path, text)
        line = distinct_products(assembly_section(own, PartsSection).model_dump_json())
        assert line.products < 20
        found.append([x.message for x in checked(written(tmp_path, text)).findings])
    assert found[0] == found[1]
    assert any("place 3" in message for message in found[0]), found[0]
