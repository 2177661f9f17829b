"""Trays and pallets with layers, parts from several sources, and who exchanges what is empty or full."""

import json
import re
from dataclasses import replace
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from planning.parts.assembly import PartAssembly
from planning.tasks.task import TaskKind
from scheduling.build_tpg import build_tpg, connect_nodes
from scheduling.conflicts.derived_tpg import DerivedTpg
from scheduling.graph.rollout import earliest_times
from scheduling.invariant import check_invariant
from scheduling.planned_motions import PlannedMotions
from scheduling.sequences.copies import copies_in_sequence
from scheduling.sequences.sequence import SequenceNodes
from scheduling.sequences.splice import splice_plans
from tests.assembly_section import assembly_section
from tests.twin.operations.operated import operated_by_program
from tests.twin.program import invoke
from tests.twin.written import checked, loaded, refusal, written
from twin.host.progress import StageWatch
from twin.kinds.parts.line import write_out_line
from twin.kinds.parts.ordered_parts import OrderedParts
from twin.kinds.parts.pattern import line_pattern
from twin.kinds.parts.section import PartsSection
from twin.kinds.parts.sources import GridSection
from twin.planning.build_workcell import build_workcell
from twin.planning.pipeline import plan_motions
from twin.reading.scenario_file import load_scenario

CELL = """\
version: 1
name: layers
cell:
  tools:
    cup: {shapes: [{cylinder: {radius_m: 0.009, length_m: 0.07}, pose: {xyz_m: [0, 0, 0.035]}}], tcp: {xyz_m: [0, 0, 0.07]}, suction: true}
  robots:
    - {name: arm, model: ur5e, tool: cup, base: {xyz_m: [-0.45, 0, 0]}}
  fixtures:
    - {name: table, size_m: [1.6, 1.4, 0.04], pose: {xyz_m: [0, 0, -0.02]}}
assembly:
  kind: assembly
  sources:
    left: {kind: tray, pose: {xyz_m: [0, 0.3, 0.02]}, grid: {counts: [1, 1, 2], pitch_m: [0, 0, 0.04]}, refill_s: 20, refill_by: agv}
    right: {kind: tray, pose: {xyz_m: [0, 0.15, 0.02]}, grid: {counts: [1, 1, 2], pitch_m: [0, 0, 0.04]}, refill_s: 20, refill_by: agv}
  parts:
    - {name: plug, size_m: [0.03, 0.03, 0.04], mass_kg: 0.1, source: [left, right], goal: {xyz_m: [0.05, -0.25, 0.02]}}
  steps: [plug]
  products: {count: 23, places: {counts: [1, 1, 2], pitch_m: [0, 0, 0.04]}, leave_s: 5, leave_by: agv}
  grips: {suction: true, positions: 1}
  approach_m: 0.1
  leave_m: 0.1
planning: {speed_model: joint, shortcut_candidates: 20}
execution:
  skills: {pick: {kind: fixed, value_s: 1}, place-down: {kind: fixed, value_s: 1}}
  machines: {agv: {breakdowns: {mtbf_s: 60, mttr_s: 20}}}
  planned_stops: [{at_s: 30, duration_s: 10, who: [agv]}]
"""
"""A pallet of two layers is filled from two trays of two layers, and one vehicle exchanges all three."""

LEFT = "[1, 1, 2], pitch_m: [0, 0, 0.04]}, refill_s: 20"
PALLET = "places: {counts: [1, 1, 2], pitch_m: [0, 0, 0.04]}"

COUNTS = st.one_of(
    st.tuples(*[st.integers(1, 4)] * 2), st.tuples(*[st.integers(1, 4)] * 3)
)
PITCHES = st.sampled_from([0.04, 0.1, 0.25])


@settings(max_examples=60, deadline=None)
@given(
    data=st.data(), counts=COUNTS, order=st.sampled_from(["rows", "columns", "drawn"])
)
def test_places_are_distinct_and_the_top_layer_is_emptied_first(
    data: st.DataObject, counts: tuple[int, ...], order: Any
) -> None:
    pitch = [data.draw(PITCHES) for _ in counts]
    nx, ny, nz = (*counts, 1)[:3]
    if order == "drawn":
        order = tuple(data.draw(st.permutations(range(1, nx * ny * nz + 1))))
    grid = GridSection(counts=counts, pitch_m=tuple(pitch), order=order)
    points = np.array([at[:3, 3] for at in grid.by_number()])
    cells = [(i, j, k) for k, j, i in product(range(nz), range(ny), range(nx))]
    assert np.allclose(points, np.array(cells) * [*pitch, 0.0][:3])
    emptied, filled = grid.numbers(emptied=True), grid.numbers()
    assert sorted(emptied) == sorted(filled) == list(range(len(cells)))
    if isinstance(order, tuple):
        assert emptied == filled == [k - 1 for k in order]
        return
    axes = (1, 0) if order == "rows" else (0, 1)
    inside = [tuple(cells[k][axis] for axis in axes) for k in filled]
    assert [
        (cells[k][2], *own) for k, own in zip(filled, inside, strict=True)
    ] == sorted((cell[2], *(cell[axis] for axis in axes)) for cell in cells)
    layers = [filled[k : k + nx * ny] for k in range(0, len(filled), nx * ny)]
    assert emptied == [k for layer in reversed(layers) for k in layer]


@settings(max_examples=40, deadline=None)
@given(
    counts=st.tuples(*[st.integers(1, 3)] * 3),
    axis=st.integers(0, 2),
    sign=st.sampled_from([-1.0, 1.0]),
    tool=st.integers(0, 2),
)
def test_nothing_is_in_the_way_of_what_comes_next(
    counts: tuple[int, int, int], axis: int, sign: float, tool: int
) -> None:
    """Boxes are moved out straight, and the hand comes from behind: no box that is left is there."""
    grid = GridSection(counts=counts, pitch_m=(0.1, 0.1, 0.1), order="clear")
    points = np.array([at[:3, 3] for at in grid.by_number()])
    out, hand = sign * np.eye(3)[axis], np.eye(3)[tool]
    left = grid.numbers(np.eye(4), (out, hand), emptied=True)
    in_hand = [k for k in left if np.isclose(points[k] @ out, (points @ out).max())]
    for way, order in ((out, left), (hand, in_hand)):
        for turn, number in enumerate(order):
            apart = points[order[turn + 1 :]] - points[number]
            along = apart @ way
            beside = np.linalg.norm(apart - along[:, None] * way, axis=1)
            assert not np.any((along > 0.01) & (beside < 0.09))


def test_one_vehicle_serves_two_trays_and_a_pallet(tmp_path: Path) -> None:
    """It does one thing after another, stands while it is broken, and all proofs hold."""
    file, out = written(tmp_path, CELL), tmp_path / "out"
    invoke("run", file, "--no-recording", "--out", out)
    summary = json.loads((out / "summary.json").read_text())
    assert summary["audit"]["violations"] == []
    invoke("verify", out, code=0)


@pytest.mark.parametrize("products", [16, 17, 19, 22])
def test_copies_of_a_shared_vehicle_are_the_graph_of_all(
    products: int, motions: PlannedMotions, tmp_path: Path
) -> None:
    """Also where a tray is not needed any more, and a pallet leaves after it would have come."""
    tpg = build_tpg(motions.motion_plan)
    line = write_out_line(assembly_section(loaded(tmp_path, CELL), PartsSection))
    pattern = line_pattern(line, motions.motion_plan.tasks)
    assert pattern.period == 4
    pattern = replace(pattern, products=products)
    sequence = copies_in_sequence(tpg, pattern)
    quick = splice_plans(sequence)
    slow = connect_nodes(DerivedTpg(SequenceNodes(sequence).graph()))
    assert np.array_equal(quick.edges, slow.edges)
    check_invariant(DerivedTpg(quick))
    (agv,) = (c for c in quick.chains if quick.tasks[c.task[0]].robot == "agv")
    done = [quick.tasks[k] for k in agv.task]
    assert len(done) == sum(t.robot == "agv" for t in quick.tasks)
    (k,) = (k for k, chain in enumerate(quick.chains) if chain is agv)
    times = earliest_times(quick)
    assert np.all(times.start[k][1:] >= times.end[k][:-1] - 1e-9)
    # Trays are taken turn by turn, each from its top layer, and come when they are empty.
    picks = [t.object for t in quick.tasks if t.kind == "pick"]
    assert picks == [f"plug.{n}" for n in range(1, products + 1)]
    starts = [quick.cell.object(str(name)).start[1:3, 3] for name in picks]
    places = [(0.3, 0.06), (0.3, 0.02), (0.15, 0.06), (0.15, 0.02)]
    assert np.allclose(starts, [places[n % 4] for n in range(products)])
    came = [len(t.handlings) for t in done if t.kind == TaskKind.PRESENT]
    gone = [len(t.handlings) for t in done if t.kind == TaskKind.LEAVE]
    assert came == [2] * (2 * ((products - 1) // 4))
    assert gone == [2] * (products // 2)


@pytest.fixture(scope="module")
def motions(tmp_path_factory: pytest.TempPathFactory) -> PlannedMotions:
    folder = tmp_path_factory.mktemp("layers")
    return plan_motions(loaded(folder, CELL), folder, StageWatch())


def test_what_lies_on_others_comes_with_all_below(tmp_path: Path) -> None:
    """Of five parts the last comes in a tray of two layers, and lies on another one."""
    own = loaded(tmp_path, CELL, ("count: 23", "count: 5"))
    line = write_out_line(assembly_section(own, PartsSection), whole=True)
    lying = {part.name: part.start.xyz_m for part in line.section.parts if part.start}
    assert lying["plug.5"] == pytest.approx((0.0, 0.3, 0.06))
    assert lying["plug.6"] == pytest.approx((0.0, 0.3, 0.02))
    assert [(k, r.machine, len(r.parts)) for k, r in line.supply.refills.items()] == [
        (2, "agv", 2)
    ]
    assert len(line.supply.leaves) == 2
    (under,) = (p for p in line.section.parts if p.name == "plug.6")
    assert under.goal is None


def test_single_assemblies_take_alike_parts_from_several_sources(
    tmp_path: Path,
) -> None:
    goals = (
        "goals: {xyz_m: [0.05, -0.25, 0.02], grid: {counts: [5, 1], pitch_m: [0.1, 0]}}"
    )
    text = "".join(line for line in CELL.splitlines(True) if "products:" not in line)
    own = loaded(tmp_path, text, ("goal: {xyz_m: [0.05, -0.25, 0.02]}", goals))
    line = write_out_line(assembly_section(own, PartsSection))
    refills = {k: [n for n, _ in r.parts] for k, r in line.supply.refills.items()}
    assert refills == {2: ["plug.5", "plug.1.2"]}
    assert line.places["plug.3"] == "place 2 in layer 2 of right"


@pytest.mark.parametrize(
    ("change", "key", "words"),
    [
        ((LEFT, LEFT.replace("0.04", "0.05")), "parts.0.source", "hangs in the air at the start.*plug.1: place 2 in layer 2 of left"),
        ((LEFT, LEFT.replace("0.04", "0.03")), "parts.0.source", "overlap by 10.*plug.2: place 1 in layer 1 of left"),
        ((PALLET, PALLET.replace("0.04", "0.05")), "parts.0.goal", "left in the air.*plug.2: place 2 in layer 2 of products.places"),
        ((PALLET, PALLET[:-1] + ", order: [2, 1]}"), "parts.0.goal", "plug.1 would be left in the air.*plug.1: place 2 in layer 2"),
        (("[0, 0.15, 0.02]", "[0.79, 0.15, 0.02]"), "parts.0.source", "no robot reaches plug.3.*plug.3: place 2 in layer 2 of right"),
    ],
)  # fmt: skip
def test_what_is_wrong_is_said_with_its_place(
    change: tuple[str, str], key: str, words: str, tmp_path: Path
) -> None:
    found = checked(written(tmp_path, CELL, change)).findings
    keys = [
        ".".join(map(str, own.at)) for own in found if re.search(words, own.message)
    ]
    assert keys == [f"assembly.{key}"], [own.message for own in found]


REFUSED: dict[str, tuple[tuple[str, str], str]] = {
    "layers below one": ((LEFT, LEFT.replace("1, 2]", "1, -2]")), "must be at least 1, not -2"),
    "four directions": ((LEFT, LEFT.replace("1, 2]", "1, 2, 2]")), "at most 3"),
    "one direction": (("[0.05, -0.25, 0.02]}}", "[0.05, -0.25, 0.02], grid: {counts: [2], pitch_m: [1]}}}"), "grid"),
    "huge counts": ((LEFT, LEFT.replace("1, 1, 2]", "100, 100, 2]")), "20000 places: there may be 10000"),
    "no height": ((LEFT, LEFT.replace("0.04", "0")), "2 places along z need a pitch_m, not 0"),
    "in one column": ((LEFT, LEFT.replace("1, 1, 2]", "2, 1, 2]")), "2 places along x need a pitch_m, not 0"),
    "downwards": ((PALLET, PALLET.replace("0.04", "-0.04")), "pitch_m along z must be positive"),
    "a height alone": ((LEFT, LEFT.replace("1, 1, 2]", "1, 2]")), "counts has 2 entries, and pitch_m 3"),
    "twice the same": ((PALLET, PALLET[:-1] + ", order: [1, 1]}"), "order must have every number from 1 to 2 once"),
    "one too many": ((PALLET, PALLET[:-1] + ", order: [1, 2, 3]}"), "order must have every number from 1 to 2 once"),
    "an unknown order": ((PALLET, PALLET[:-1] + ", order: snake}"), "rows, columns, clear"),
    "clear ways of goals": (("[0.05, -0.25, 0.02]}}", "[0.05, -0.25, 0.02]}, goals: {xyz_m: [0, 0, 0], grid: {counts: [1, 1], pitch_m: [1, 1], order: clear}}}"), "order clear is of trays and pallets"),
    "an unknown source": (("[left, right]", "[left, rigth]"), "did you mean 'right'"),
    "a source twice": (("[left, right]", "[left, left]"), "left is named twice: name each source once"),
    "a source of two": (("  steps:", "    - {name: peg, size_m: [0.03, 0.03, 0.04], source: right, goal: {xyz_m: [0.1, 0, 0.02]}}\n  steps:"), "what shares right must name the same sources"),
    "no source": (("[left, right]", "[]"), "at least 1"),
    "two times": (("refill_s: 20, refill_by: agv}\n    right", "refill_s: 9, refill_by: agv}\n    right"), "for left, of the same parts, agv takes another time: give both one"),
    "a robot": (("leave_by: agv", "leave_by: arm"), "the name 'arm' is that of a robot"),
    "a source as a vehicle": (("leave_by: agv", "leave_by: left"), "the name 'left' of the outfeed of products is already taken"),
    "a tray breaks down": (("machines: {agv:", "machines: {left:"), "unknown machine 'left' .valid: agv"),
}  # fmt: skip


@pytest.mark.parametrize("what", REFUSED)
def test_what_cannot_be_is_refused(what: str, tmp_path: Path) -> None:
    change, words = REFUSED[what]
    said = str(refusal(tmp_path, CELL, change))
    assert re.search(words, said), said
    assert "own.yaml:" in said


def test_an_order_of_layers_is_found_for_alike_parts(tmp_path: Path) -> None:
    """Any part may come to any goal: the layers at the start do not order those at the goals."""
    grid = "grid: {counts: [1, 2, 2], pitch_m: [0, -0.1, 0.04]}"
    lie = f"starts: {{xyz_m: [0, 0.3, 0.02], {grid}}}, goals: {{xyz_m: [0, -0.2, 0.02], {grid}}}"
    part = (
        f"  parts: [{{name: plug, size_m: [0.03, 0.03, 0.04], {lie}}}]\n  order: find\n"
    )
    text = CELL[: CELL.index("  sources:")] + part + CELL[CELL.index("  grips:") :]
    file = written(tmp_path, text[: text.index("  machines:")])
    own = load_scenario(file)
    section = assembly_section(own, PartsSection)
    line = write_out_line(section)
    parts = OrderedParts(build_workcell(own, tmp_path), section, line)
    assert isinstance(parts.found, PartAssembly), parts.found
    heights = [parts.found.goals[step.part][2, 3] for step in parts.found.steps]  # type: ignore[union-attr]
    assert np.allclose(heights, [0.02, 0.02, 0.06, 0.06])


SHELF = """\
version: 1
name: shelf
cell:
  tools:
    cup: {shapes: [{cylinder: {radius_m: 0.009, length_m: 0.2}, pose: {xyz_m: [0, 0, 0.1]}}], tcp: {xyz_m: [0, 0, 0.2]}, suction: true}
  robots:
    - {name: arm, model: ur5e, tool: cup, base: {xyz_m: [-0.45, 0, 0]}}
  fixtures:
    - {name: table, size_m: [1.6, 1.4, 0.04], pose: {xyz_m: [0, 0, -0.02]}}
    - {name: shelf, size_m: [0.4, 0.3, 0.2], pose: {xyz_m: [0.3, 0.3, 0.1]}}
    - {name: bench, size_m: [0.4, 0.2, 0.2], pose: {xyz_m: [0.2, -0.25, 0.1]}}
assembly:
  kind: assembly
  sources:
    rack: {kind: tray, pose: {xyz_m: [0.24, 0.22, 0.23]}, grid: {counts: [2, 2], pitch_m: [-0.1, 0.1], order: clear}, refill_s: 5}
  parts:
    - {name: plug, size_m: [0.04, 0.04, 0.06], mass_kg: 0.1, source: rack, take_out: [-1, 0, 0], goal: {xyz_m: [0.05, -0.25, 0.23]}, insert: [1, 0, 0], grips: {directions: [[1, 0, 0]]}}
  steps: [plug]
  products: {count: 6, places: {counts: [2, 1], pitch_m: [0.1, 0], order: clear}}
  grips: {suction: true, positions: 1}
  approach_m: 0.2
  leave_m: 0.2
planning: {speed_model: joint, shortcut_candidates: 20}
execution:
  skills: {pick: {kind: fixed, value_s: 1}, place-down: {kind: fixed, value_s: 1}}
"""
"""A shelf is emptied from its front, and another one filled from its back."""


@pytest.mark.nightly
@pytest.mark.parametrize(
    ("change", "words"),
    [
        (("clear", "clear"), ""),
        (("0.1], order: clear", "0.1], order: rows"), "no grip on plug.1 has room"),
        (("0], order: clear", "0], order: rows"), "step 2 .* no robot"),
    ],
)
def test_only_clear_orders_of_a_shelf_are_planned(
    change: tuple[str, str], words: str, tmp_path: Path
) -> None:
    file, out = written(tmp_path, SHELF, change), tmp_path / "out"
    told = invoke("run", file, "--no-recording", "--out", out, code=2 if words else 0)
    assert re.search(words, told.output)
    if not words:
        invoke("verify", out, code=0)


@pytest.mark.nightly
@pytest.mark.parametrize("seed", range(6))
def test_operations_with_layers_are_clean(seed: int, tmp_path: Path) -> None:
    spare = ("count: 23", "count: 7, spare: 3")
    fails = "  failures: {place-down: {probability: 0.2, retries: 0, loses: 0.5}}\n"
    file = written(
        tmp_path, CELL + fails, spare, ("name: layers", f"name: layers\nseed: {seed}")
    )
    operated_by_program(file, tmp_path / "out", code=None)
