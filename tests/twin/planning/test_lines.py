"""Sources and products of a scenario: written out, planned, executed, and proved as a whole."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from planning.errors import ScenarioError
from planning.tasks.task import TaskKind
from scheduling.conflicts.derived_tpg import DerivedTpg
from scheduling.graph.rollout import earliest_times
from scheduling.graph.temporal_plan_graph import TemporalPlanGraph
from scheduling.invariant import check_invariant
from tests.assembly_section import assembly_section
from tests.planted import rows
from tests.twin.written import loaded, refusal
from twin.audits.expectations import scenario_expectations
from twin.document.validation import InvalidScenarioError
from twin.kinds.parts.line import write_out_line
from twin.kinds.parts.ordered_places import source_places
from twin.kinds.parts.section import PartsSection
from twin.reading.scenario_file import load_scenario
from twin.scenario.sections.kind import assembly_kind
from twin.scenario.sections.scenario import Scenario
from twin.studies.comparison import require_comparable
from twin.throughput.throughput import line_summary, product_nodes
from twin.trial.planning import plan_scenario
from twin.trial.simulation import execute

KITTING = Path("scenarios/assembly/kitting.yaml")


def scenario(tmp_path: Path, **assembly: Any) -> Scenario:
    """Return the kitting line with other keys of its assembly."""
    document = yaml.safe_load(KITTING.read_text())
    for key, value in assembly.items():
        if key == "source":
            document["assembly"]["sources"] |= value
        else:
            document["assembly"][key] = value
    document["planning"]["shortcut_candidates"] = 300
    return loaded(tmp_path, yaml.safe_dump(document))


def planned(own: Scenario, folder: Path) -> TemporalPlanGraph:
    """Return the plan of a line, proved as a whole."""
    tpg = plan_scenario(own, folder).tpg
    check_invariant(DerivedTpg(tpg))
    return tpg


def test_the_shipped_line_is_written_out_as_one_product() -> None:
    found = load_scenario(KITTING)
    line = write_out_line(found.assembly)  # type: ignore[arg-type]
    assert (line.period, line.products) == (1, 200)
    assert line.machines() == ("belt", "belt.end", "bolts", "nuts", "seals", "outfeed")
    names = {item.name for item in assembly_kind(found.assembly).objects()}
    assert names == {
        f"{p}.{k}" for p in ("carrier", "bolt", "nut", "seal") for k in (1, 2)
    }
    there = {i.name for i in assembly_kind(found.assembly).objects() if not i.later}
    assert there == {"carrier.1", "bolt.1", "nut.1", "seal.1"}
    wanted = scenario_expectations(found)
    assert wanted.places == ()


def test_few_products_go_through_both_engines_and_all_proofs(tmp_path: Path) -> None:
    own = scenario(tmp_path, products={"count": 6, "leave_s": 1.0, "due": [30.0] * 6})
    tpg = planned(own, tmp_path)
    run = execute(own, tpg, tmp_path)
    figures = line_summary(tpg, run, *assembly_kind(own.assembly).due())
    assert figures is not None
    assert figures["products"] == 6
    nodes = product_nodes(tpg)
    assert nodes is not None
    end = nodes.end(np.concatenate(run.end_ns)) / 1e9
    assert figures["due"]["late"] == np.count_nonzero(end > 30.0)
    assert np.all(np.diff(end) > 0)


def test_a_tray_and_a_pallet_repeat_when_both_are_as_they_were(tmp_path: Path) -> None:
    tray = {
        "kind": "tray",
        "pose": {"xyz_m": [-0.35, -0.37, 0.075]},
        "grid": {"counts": [1, 2], "pitch_m": [0.05, 0.06]},
        "refill_s": 3.0,
    }
    own = scenario(tmp_path, source={"bolts": tray}, products={"count": 13})
    line = write_out_line(own.assembly)  # type: ignore[arg-type]
    assert line.period == 2
    tpg = planned(own, tmp_path)
    tasks = tpg.tasks
    exchanges = [t for t in tasks if t.kind == TaskKind.PRESENT and t.robot == "bolts"]
    # Thirteen bolts from trays of two: full ones come six times.
    assert [len(t.handlings) for t in exchanges] == [2] * 6
    picks = [t for t in tasks if t.kind == "pick" and str(t.object).startswith("bolt.")]
    assert [t.object for t in picks] == [f"bolt.{k}" for k in range(1, 14)]
    starts = [tpg.cell.object(str(t.object)).start for t in picks]
    assert np.allclose(starts[0], starts[2])
    assert not np.allclose(starts[0], starts[1])


def test_a_stack_is_taken_from_above(tmp_path: Path) -> None:
    stack = {
        "kind": "stack",
        "pose": {"xyz_m": [-0.35, -0.33, 0.135]},
        "count": 3,
        "pitch_m": 0.03,
    }
    own = scenario(tmp_path, source={"bolts": stack}, products={"count": 3})
    assembly = assembly_section(own, PartsSection)
    places = source_places(assembly, assembly.parts[1])
    heights = [at[2, 3] for at in places.poses]
    assert np.allclose(heights, [0.135, 0.105, 0.075])
    line = write_out_line(assembly)
    assert line.period == line.products
    assert not line.supply.refills.keys() & {"bolt.1", "bolt.2", "bolt.3"}
    planned(own, tmp_path)


def test_products_stay_on_a_pallet_that_is_not_full(tmp_path: Path) -> None:
    own = scenario(
        tmp_path,
        products={"count": 2, "places": {"counts": [1, 3], "pitch_m": [0.0, 0.06]}},
    )
    line = write_out_line(own.assembly)  # type: ignore[arg-type]
    assert (line.period, line.supply.leaves) == (2, {})
    wanted = scenario_expectations(own)
    assert {place.object for place in wanted.places} >= {"seal.1", "seal.2"}


def test_a_slow_conveyor_sets_the_pace(tmp_path: Path) -> None:
    pose = {"xyz_m": [-0.3, 0.2, 0.075], "rpy_deg": [0, 0, 90]}
    belt = {"kind": "conveyor", "pose": pose, "every_s": 60.0}
    own = scenario(tmp_path, source={"belt": belt}, products={"count": 8})
    tpg = planned(own, tmp_path)
    (chain,) = (
        k
        for k, c in enumerate(tpg.chains)
        if tpg.tasks[c.task[0]].kind == TaskKind.LEAVE
    )
    ends = earliest_times(tpg).end[chain]
    assert np.allclose(np.diff(ends)[1:], 60.0)


def test_sources_alone_need_no_products(tmp_path: Path) -> None:
    document = yaml.safe_load(KITTING.read_text())
    del document["assembly"]["products"]
    for part in document["assembly"]["parts"]:
        if part["name"] == "nut":
            part["source"] = "bolts"
    del document["assembly"]["sources"]["nuts"]
    tpg = planned(loaded(tmp_path, yaml.safe_dump(document)), tmp_path)
    assert not len(tpg.products)
    # The nut comes first in the steps, the bolt when it was taken.
    assert not tpg.cell.object("nut").later
    assert tpg.cell.object("bolt").later


@pytest.mark.parametrize(
    ("change", "message"),
    rows(r"""
change                                       | says
{steps: [carrier, nut, bolt]}                | no step places seal
{sources: {}}                                | there is no source
{order: find}                                | in the order of the steps
{products: {count: 3, due: [1.0]}}           | 1 due times for 3 products
{products: {count: 3, leave_s: 1.0, leave: {kind: fixed, value_s: 2}}} | give leave_s or leave, not both
"""),
)
def test_what_cannot_be_is_said(tmp_path: Path, change: str, message: str) -> None:
    with pytest.raises(InvalidScenarioError, match=message):
        scenario(tmp_path, **yaml.safe_load(change))


def test_a_part_that_lies_there_once_makes_one_product(tmp_path: Path) -> None:
    document = yaml.safe_load(KITTING.read_text())
    part = document["assembly"]["parts"][1]
    part["start"] = {"xyz_m": [-0.35, -0.33, 0.075]}
    del part["source"], document["assembly"]["sources"]["bolts"]
    said = str(refusal(tmp_path, yaml.safe_dump(document)))
    assert "is needed for every product" in said


def test_lines_have_no_slots(tmp_path: Path) -> None:
    own = scenario(tmp_path)
    with pytest.raises(ScenarioError, match="no plan in slots"):
        require_comparable(own)
