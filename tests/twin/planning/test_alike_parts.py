"""Parts that are alike in scenario files: written out, refused with numbers, planned, and judged by the audit."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from planning.tasks.task import TaskKind
from planning.transforms import rotation
from tests.planted import rows
from tests.shipped_runs import SCENARIOS
from tests.twin.audits.audit_cell import HandWrittenRun, brick, two_arm_cell
from tests.twin.scenarios.cells import cell, panda
from tests.twin.written import checked, loaded, refusal, written
from twin.audits.audit import audit_run
from twin.audits.expectations import Expectations, Place, scenario_expectations
from twin.kinds.parts.alike import alike_parts, listed_steps, with_named_parts
from twin.kinds.parts.built import assembly_of
from twin.kinds.parts.line import write_out_line
from twin.kinds.parts.section import PartSection, PartsSection
from twin.kinds.parts.sources import GridSection, PlacesSection
from twin.reading.scenario_file import load_scenario
from twin.trial.planning import plan_scenario

SCENARIO = cell(
    "pegs",
    (panda("west", -0.5), panda("east", 0.5)),
    """\
  kind: assembly
  grips: {positions: 1}
  parts:
    - {name: base, size_m: [0.3, 0.1, 0.02], start: {xyz_m: [0, 0.3, 0.0105]}}
    - name: peg
      size_m: [0.03, 0.03, 0.06]
      count: 5
      starts:
        - {xyz_m: [-0.2, -0.3, 0.0305], grid: {counts: [2, 2], pitch_m: [0.1, 0.1]}}
        - {xyz_m: [0.2, -0.3, 0.0305]}
      goals: {xyz_m: [-0.1, 0.3, 0.051], grid: {counts: [3, 1], pitch_m: [0.1, 0.1]}}
    - {name: lid, size_m: [0.03, 0.2, 0.02], start: {xyz_m: [0.3, 0.1, 0.0105]}, goal: {xyz_m: [0, 0.3, 0.0915]}}
  joined: [[peg, base]]
  steps:
    - {place: peg, name: pegs}
    - {place: lid, after: [pegs]}
""",
)

WRONG = rows(r"""
old                                    | new                                                     | says
count: 5                               | count: 2                                                | 3 goals of peg need 3 parts, and there are 2
count: 5                               | count: 6                                                | 6 peg need 6 places to lie at, and starts has 5
counts: [3, 1]                         | counts: [3, 2]                                          | 6 goals of peg need 6 parts, and there are 5
counts: [3, 1]                         | counts: [0, 1]                                          | must be at least 1, not 0
count: 5                               | count: 0                                                | must be at least 1, not 0
"      starts:\n"                      | "      start: {xyz_m: [0, 0, 0]}\n      starts:\n"      | give start or starts, not both
"      goals: "                        | "      goal: "                                          | grid
name: lid                              | name: peg                                               | the name 'peg' of a part is already taken by a part at
name: lid                              | name: peg.3                                             | the name 'peg.3' of a part is already taken by a part at
place: peg, name                       | place: pog, name                                        | unknown part 'pog'; did you mean
place: peg, name                       | place: peg.1, name                                      | unknown part 'peg.1'
place: peg, name                       | place: peg, at: {pose: {xyz_m: [0, 0, 0]}}, name        | leave at out
place: lid, after                      | place: lid, hold: peg, after                            | ambiguous which is meant
after: [pegs]                          | after: [peg]                                            | unknown step 'peg'
"[[peg, base]]"                        | "[[peg, peg]]"                                          | cannot be joined to itself
"[[peg, base]]"                        | "[{parts: [peg, base], by: pegs}]"                      | leave by out
"start: {xyz_m: [0, 0.3, 0.0105]}}"    | "count: 3}"                                             | where does it come from?
"start: {xyz_m: [0, 0.3, 0.0105]}}"    | "count: 3, start: {xyz_m: [0, 0.3, 0.0105]}}"           | start is of one part, and this says of several
""")


@pytest.mark.parametrize(("old", "new", "says"), WRONG)
def test_what_cannot_be_is_refused(
    tmp_path: Path, old: str, new: str, says: str
) -> None:
    assert says in str(refusal(tmp_path, SCENARIO, (old, new)))


def section(folder: Path, *changes: tuple[str, str]) -> PartsSection:
    found = loaded(folder, SCENARIO, *changes).assembly
    assert isinstance(found, PartsSection)
    return found


def test_parts_have_names_and_goals_have_steps(tmp_path: Path) -> None:
    own = with_named_parts(section(tmp_path))
    pegs = [part for part in own.parts if part.name.startswith("peg")]
    assert [part.name for part in pegs] == [f"peg.{k}" for k in range(1, 6)]
    assert [part.goal and part.goal.xyz_m[0] for part in pegs] == pytest.approx(
        [-0.1, 0.0, 0.1, None, None]
    )
    starts = [part.start.xyz_m[:2] for part in pegs if part.start is not None]
    np.testing.assert_allclose(
        starts, [(-0.2, -0.3), (-0.1, -0.3), (-0.2, -0.2), (-0.1, -0.2), (0.2, -0.3)]
    )
    names = [step.name for step in own.steps]
    assert names == ["pegs-goal-1", "pegs-goal-2", "pegs-goal-3", None]
    assert own.steps[-1].after == tuple(names[:3])
    assert [item.parts for item in own.joined] == [
        (f"peg.{k}", "base") for k in (1, 2, 3)
    ]
    assert listed_steps(section(tmp_path)) == (0, 0, 0, 1)
    assert with_named_parts(own) is own
    assert assembly_of(write_out_line(section(tmp_path))).alike == (
        tuple(f"peg.{k}" for k in range(1, 6)),
    )


GRIDS = st.builds(
    lambda n, m, x: PlacesSection(
        xyz_m=(x, 0.0, 0.0), grid=GridSection(counts=(n, m), pitch_m=(0.1, -0.2))
    ),
    st.integers(1, 4),
    st.integers(1, 4),
    st.floats(-1, 1),
)
PLACES = st.lists(
    st.one_of(GRIDS, st.just(PlacesSection(xyz_m=(0.0, 1.0, 0.0)))),
    min_size=1,
    max_size=3,
).map(tuple)


@given(starts=PLACES, goals=PLACES, count=st.none() | st.integers(1, 40))
def test_counts_add_up_or_are_refused(
    starts: tuple[PlacesSection, ...],
    goals: tuple[PlacesSection, ...],
    count: int | None,
) -> None:
    from twin.kinds.parts.alike import find_alike_problems

    part = PartSection(
        name="rod", size_m=(0.1, 0.1, 0.1), count=count, starts=starts, goals=goals
    )
    own = PartsSection.model_validate(
        {"kind": "assembly", "parts": (part,), "steps": ("rod",)}
    )
    lying = sum(len(place.places()) for place in starts)
    wanted = sum(len(place.places()) for place in goals)
    there = count or lying
    problems = [words for _, words in find_alike_problems(own)]
    assert bool(problems) == (there > lying or there < wanted)
    if there > lying:
        assert f"{there} rod need {there} places" in problems[0]
        assert f"has {lying}" in problems[0]
        return
    if there < wanted:
        assert f"{wanted} goals" in problems[0]
        assert f"there are {there}" in problems[0]
        return
    named = with_named_parts(own)
    (kind,) = alike_parts(own)
    assert [p.name for p in named.parts] == list(kind.names)
    assert len(set(kind.names)) == there
    assert [bool(p.goal) for p in named.parts] == [k < wanted for k in range(there)]
    assert [step.place for step in named.steps] == list(kind.with_goals)
    assert len({step.name for step in named.steps}) == wanted


def test_pegs_are_planned_with_spares_left_where_they_lie(tmp_path: Path) -> None:
    file = written(tmp_path, SCENARIO)
    scenario = loaded(tmp_path, SCENARIO)
    assert checked(file).errors == ()
    tpg = plan_scenario(scenario, tmp_path).tpg
    placed = [task.object for task in tpg.tasks if task.kind == "place-down"]
    assert len(placed) == 4
    assert len(set(placed)) == 4
    assert placed[-1] == "lid"
    assert {str(name).rpartition(".")[0] for name in placed[:3]} == {"peg"}
    ends = {h.object: h.pose for t in tpg.tasks for h in t.handlings if not h.holder}
    own = sorted(round(float(ends[str(name)][0, 3]), 6) for name in placed[:3])
    assert own == [-0.1, 0.0, 0.1]
    movable = {item.name for item in tpg.cell.objects if not item.fixed}
    assert movable == {*(f"peg.{k}" for k in range(1, 6)), "lid"}


APART = cell(
    "apart",
    (panda("west", -0.5), panda("east", 0.5)),
    """\
  kind: assembly
  grips: {positions: 1}
  parts:
    - name: block
      size_m: [0.04, 0.04, 0.04]
      starts: [{xyz_m: [0.75, -0.2, 0.0205]}, {xyz_m: [-0.75, -0.2, 0.0205]}]
      goals: [{xyz_m: [-0.75, 0.2, 0.0205]}, {xyz_m: [0.75, 0.2, 0.0205]}]
  order: find
""",
)


def test_a_check_asks_for_no_certain_part_in_a_goal(tmp_path: Path) -> None:
    """West reaches the first goal and the second part alone, east the others."""
    assert checked(written(tmp_path, APART)).findings == ()
    plan = plan_scenario(loaded(tmp_path, APART), tmp_path)
    placed = [(t.robot, t.object) for t in plan.tpg.tasks if t.kind == "place-down"]
    assert sorted(placed) == [("east", "block.1"), ("west", "block.2")]
    far = ("{xyz_m: [-0.75, 0.2, 0.0205]}", "{xyz_m: [0, 0.67, 0.0205]}")
    report = checked(written(tmp_path, APART, far))
    found = [(item.at, item.message) for item in report.findings]
    (said,) = [words for at, words in found if at == ("assembly", "parts", 0, "goals")]
    assert "no robot reaches block.1: its place, at (0.00, 0.67, 0.02) m" in said


def test_a_source_gives_parts_of_a_kind_one_after_another(tmp_path: Path) -> None:
    """Three bolts from one feeder fill the three goals of every kit, in their order."""
    text = (SCENARIOS / "assembly" / "kitting.yaml").read_text()
    goal = "goal: {xyz_m: [-0.06, 0, 0.085]}"
    goals = "goals: [{xyz_m: [-0.075, 0, 0.085]}, {xyz_m: [-0.035, 0, 0.085]}]"
    own = loaded(tmp_path, text, (goal, goals), ("count: 200", "count: 3"))
    tpg = plan_scenario(own, tmp_path).tpg
    bolts = [
        t.object for t in tpg.tasks if t.kind == "pick" and "bolt" in str(t.object)
    ]
    assert bolts == [f"bolt.{k}.{product}" for product in (1, 2, 3) for k in (1, 2)]
    assert (
        sum(t.kind == TaskKind.PRESENT and t.robot == "bolts" for t in tpg.tasks) >= 5
    )
    said = str(refusal(tmp_path, text, (goal, goals + "\n      count: 3")))
    assert "3 bolt have 2 goals: leave count out" in said


def test_what_is_said_of_a_kind_goes_for_its_parts_in_every_product(
    tmp_path: Path,
) -> None:
    """The names of a part, from its own to that in the file: bolt.2.3, bolt.2, bolt."""
    text = (SCENARIOS / "assembly" / "kitting.yaml").read_text()
    goal = "goal: {xyz_m: [-0.06, 0, 0.085]}\n      mass_kg: 0.1"
    goals = "goals: [{xyz_m: [-0.075, 0, 0.085]}, {xyz_m: [-0.035, 0, 0.085]}]\n      mass_kg: 4"
    fails = (
        "  skills:\n",
        "  failures: {place-down: {probability: 0, parts: {bolt: 0.25}}}\n  skills:\n",
    )
    joined = ("  steps: [", "  joined: [[bolt, carrier]]\n  steps: [")
    file = written(tmp_path, text, (goal, goals), fails, joined)
    own = load_scenario(file)
    failure = own.execution.failures["place-down"]
    assert [failure.of("left", n) for n in ("bolt.2.3", "bolt.2", "nut.1")] == [
        0.25,
        0.25,
        0.0,
    ]
    said = [item.message for item in checked(file).errors]
    assert [words.partition(",")[0] for words in said] == [
        "bolt.1.1 weighs 4 kg",
        "bolt.1.2 weighs 4 kg",
    ]


def test_the_audit_is_told_what_would_do(tmp_path: Path) -> None:
    scenario = loaded(tmp_path, SCENARIO)
    wanted = scenario_expectations(scenario)
    assert [place.words for place in wanted.places[:3]] == [
        f"goal {k} of peg" for k in (1, 2, 3)
    ]
    pegs = frozenset(f"peg.{k}" for k in range(1, 6))
    assert {place.any_of for place in wanted.places[:3]} == {pegs}
    assert {frozenset((name, "base")) for name in pegs} == wanted.joined.keys()


GOALS = ((0.36, -0.1), (0.36, 0.0), (0.36, 0.1))
PEGS = ("peg.1", "peg.2", "peg.3", "peg.4")

ENDS = rows("""
ends                                   | says
peg.1 0, peg.2 1, peg.3 2              | nothing
peg.3 0, peg.4 1, peg.1 2              | nothing
peg.3 0, peg.4 1                       | goal 2: is up to
peg.3 0, peg.4 1, peg.1 1              | goal 2: is up to
peg.3 0, peg.4 1, other 2              | goal 2: is up to
peg.3 0, peg.4 1, other 2              | other at start: ends elsewhere
peg.1 0, peg.2 1, peg.3 2, peg.4 aside | peg.4 at start: ends elsewhere
peg.1 0, peg.2 1, peg.3 turned         | goal 2: is up to
""")


@pytest.mark.parametrize(("ends", "says"), ENDS)
def test_any_of_a_kind_fills_a_goal_and_nothing_else_does(
    tmp_path: Path, ends: str, says: str
) -> None:
    """Things are put where they end at once: only what is said of places counts here."""
    at = {str(k): brick("any", *goal).start for k, goal in enumerate(GOALS)}
    at |= {
        "aside": brick("any", 0.4, 0.15).start,
        "turned": at["2"] @ rotation("z", np.pi),
    }
    things = [
        brick(name, 0.5, 0.06 * k - 0.12) for k, name in enumerate((*PEGS, "other"))
    ]
    run = HandWrittenRun(two_arm_cell(things))
    run.stand("left", 2.0)
    for entry in ends.split(", "):
        name, _, where = entry.partition(" ")
        run.put(1.0, name, None, at[where])
    wanted = Expectations(
        tuple(
            Place(f"goal {k}", at[str(k)], "peg", any_of=frozenset(PEGS))
            for k in range(len(GOALS))
        )
    )
    report = audit_run(run.write(tmp_path), wanted=wanted)
    found = [v for v in report.violations if v.kind == "place"]
    said = [f"{v.first} at {v.second}: {v.detail}" for v in found]
    if says == "nothing":
        assert said == []
    else:
        assert any(says in words for words in said), said
