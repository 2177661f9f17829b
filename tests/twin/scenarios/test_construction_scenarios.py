"""Constructions in scenario files: what the shipped ones describe, and what cannot be."""

import time
from itertools import pairwise, permutations
from pathlib import Path
from typing import Any

import networkx as nx
import numpy as np
import pytest
from typer.testing import CliRunner

from benchmarks.construction.fine_check.check import check_construction
from planning.construction import planner
from planning.construction.motion_plan_export import motion_plan
from planning.construction.planner import ConstructionPlan, plan_construction
from planning.construction.problem.problem import ConstructionProblem, SkillSeconds
from planning.construction.problem.reach_bounds import reach_bounds
from planning.construction.problem.settings import RrtSettings
from planning.errors import RobotModelError, ScenarioError
from planning.motion.sequential import MotionSettings
from scheduling.graph.plan_files import load_plan
from scheduling.verification.verify import verify_plan
from tests.planted import rows
from tests.twin.written import loaded, written
from twin.audits import part_holding
from twin.audits.audit import audit_run
from twin.audits.expectations import scenario_expectations
from twin.audits.motion.executed import read_recording
from twin.cli import app
from twin.durations.measured import packaged_timings
from twin.host.progress import StageWatch
from twin.kinds.construction.kind import ConstructionKind
from twin.planning.build_workcell import build_workcell
from twin.planning.pipeline import motion_settings
from twin.reading.scenario_file import load_scenario
from twin.scenario.sections.kind import assembly_kind
from twin.trial.planning import plan_scenario

FOLDER = Path(__file__).parents[3] / "scenarios" / "construction"

OWN = """
version: 1
name: steps
cell:
  team: {model: mobile-manipulator, count: 2, name: mover, ring: {radius_m: 4.0, start_deg: 90}}
assembly:
  kind: construction
  parts:
    - {name: low, size_m: [0.4, 0.3, 0.2], goal: {xyz_m: [0, 0, 0.1]}, mass_kg: 8}
    - name: high
      size_m: [0.4, 0.3, 0.2]
      goal: {xyz_m: [0.1, 0, 0.3], rpy_deg: [0, 0, 30]}
      start: {xyz_m: [2, 1, 0.15], rpy_deg: [90, 0, 0]}
      faces: [+y, +z]
      insertion: [0, 0, -2]
      colour: [10, 20, 30]
  supply: {layout: rows, first_m: [2.5, 0], columns: 2, pitch_m: [0.8, 0.6]}
"""


def problem_of(path: Path) -> ConstructionProblem:
    scenario = load_scenario(path)
    kind = assembly_kind(scenario.assembly)
    assert isinstance(kind, ConstructionKind)
    seconds = {"pick": 1.0, "place-down": 2.0, "handover": 3.0}
    settings = MotionSettings({}, {}, 0.05, seconds, seed=7)
    return kind.problem(build_workcell(scenario), settings)


@pytest.mark.parametrize(
    ("name", "parts", "robots"),
    [
        ("tower", 15, 5),
        ("wall", 36, 5),
        ("well", 52, 5),
        ("pavilion", 113, 5),
        ("handover", 15, 4),
        ("gatehouse", 31, 6),
        ("relay", 4, 3),
    ],
)
def test_shipped_constructions_can_be_built(name: str, parts: int, robots: int) -> None:
    problem = problem_of(FOLDER / f"{name}.yaml")
    assert len(problem.parts) == len(problem.cell.objects) == parts
    assert len(problem.team) == robots
    assert [item.mass > 0.0 for item in problem.cell.objects] == [True] * parts


def test_a_scenario_says_that_the_rrt_finds_all_paths(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    text = "\nassembly:\n  kind: construction\n  model: {name: tower, levels: 1}\n"
    text = OWN[: OWN.index("\nassembly:")] + text
    found: list[tuple[int, int]] = []

    def planned(*args: Any, **given: Any) -> ConstructionPlan:
        effort = args[1].subproblem.rrt
        found.append((effort.direct, effort.checks))
        return plan_construction(*args, **given)

    monkeypatch.setattr(planner, "plan_construction", planned)
    for more in ("", "planning: {paths: rrt}\n"):
        scenario = loaded(tmp_path, text + more)
        cell = build_workcell(scenario)
        kind = assembly_kind(scenario.assembly)
        kind.plan(cell, motion_settings(scenario, cell, tmp_path), StageWatch())
    usual = RrtSettings()
    assert found == [(usual.direct, usual.checks), (0, 0)]
    move = "{robot: mover1, to: {xyz_m: [1, 0, 0.5]}}"
    goals = f"assembly: {{kind: goals, moves: [{move}]}}\nplanning: {{paths: rrt}}\n"
    text = OWN[: OWN.index("assembly:")] + goals
    with pytest.raises(ScenarioError, match=r"planning.paths.*kind 'goals'"):
        loaded(tmp_path, text)


@pytest.mark.nightly
@pytest.mark.parametrize(
    ("name", "seed"), [("relay", 230), ("relay", 3), ("handover", 7), ("tower", 7)]
)
def test_plans_of_other_seeds_pass_their_own_check(name: str, seed: int) -> None:
    """Stands that begin a rounding error after a cell of time are in these of the relay."""
    scenario = load_scenario(FOLDER / f"{name}.yaml").changed(seed=seed)
    tpg = plan_scenario(scenario, FOLDER).tpg
    assert verify_plan(tpg, limit=1).problems == ()


def test_everybody_of_the_mixed_team_is_needed() -> None:
    problem = problem_of(FOLDER / "gatehouse.yaml")
    bounds = reach_bounds(problem)
    arms, movers = ("arm1", "arm2"), ("mover1", "mover2", "mover3")
    alone = {
        name: bounds.able_alone(problem.part(name))
        for name in ("footing_ne", "drum1_ne", "drum5_ne", "lintel_n", "rafter3")
    }
    assert list(alone.values()) == [arms, arms + movers, movers, ("crane",), ()]
    assert bounds.chain(problem.part("rafter3")) == ("arm1", "crane")


KEPT = """\
    - {name: post, size_m: [0.3, 0.3, 0.4], goal: {xyz_m: [0, 0, 0.2]}, mass_kg: 5}
    - {name: beam, size_m: [0.7, 0.2, 0.1], goal: {xyz_m: [0.22, 0, 0.45]}, mass_kg: 1}
    - {name: weight, size_m: [0.2, 0.2, 0.2], goal: {xyz_m: [-0.05, 0, 0.6]}, mass_kg: 9}
"""
"""A beam that falls off its post unless a weight lies on its other end."""


def test_a_run_in_which_a_part_is_kept_hold_of_stands_because_of_that(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    head, parts, _ = OWN.partition("  parts:\n")
    scenario = loaded(tmp_path, head + parts + KEPT)
    file, folder = written(tmp_path, head + parts + KEPT), tmp_path / "run"
    result = CliRunner().invoke(app, ["run", str(file), "--out", str(folder)])
    assert result.exit_code == 0, result.output
    wanted = scenario_expectations(scenario)
    assert audit_run(folder, wanted=wanted).violations == ()
    monkeypatch.setattr(part_holding, "_held_in_place", lambda _case: {})
    (fall,) = audit_run(folder, wanted=wanted).violations
    assert (fall.kind, fall.first) == ("balance", "beam")
    case = read_recording(folder, load_plan(folder).cell).objects
    put = {row.object: row.t for row in case if row.holder is None and row.t > 0.0}
    assert (fall.t_start, fall.t_end) == (put["beam"], put["weight"])


def test_a_part_goes_over_three_where_fewer_cannot_bring_it(tmp_path: Path) -> None:
    lines = (FOLDER / "relay.yaml").read_text().splitlines()
    one = [line for line in lines if not any(f"beam{k}" in line for k in (2, 3, 4))]
    problem = problem_of(written(tmp_path, "\n".join(one)))
    bounds, (beam,) = reach_bounds(problem), problem.parts
    row = ("left", "middle", "right")
    assert bounds.chain(beam) == row
    # Of all ways through the team no other one passes the bounds.
    ways = [w for n in (1, 2, 3) for w in permutations(problem.team, n)]
    assert [w for w in ways if bounds.may_bring(beam, w)] == [row]
    plan = plan_construction(problem)
    work = sorted(plan.building.work, key=lambda w: w.start)
    assert [(w.kind, w.robot, w.holder) for w in work] == [
        ("pick", "left", "left"),
        ("handover", "left", "middle"),
        ("handover", "middle", "right"),
        ("place-down", "right", None),
    ]
    assert check_construction(plan).faults == ()
    motions = motion_plan(problem, plan.building)
    after: nx.DiGraph[int] = nx.DiGraph(motions.dependencies.tolist())
    for robot in problem.team:
        after.add_edges_from(
            pairwise(t.index for t in motions.tasks if t.robot == robot)
        )
    skills = [task.index for task in motions.tasks if task.handlings]
    assert all(nx.has_path(after, a, b) for a, b in pairwise(skills))


def test_own_parts_are_taken_as_they_are_written(tmp_path: Path) -> None:
    problem = problem_of(written(tmp_path, OWN))
    assert problem.team == ("mover1", "mover2")
    assert np.allclose(problem.cell.robot("mover1").home[:3], (0.0, 4.0, -np.pi / 2))
    assert np.allclose(problem.cell.robot("mover2").home[:3], (0.0, -4.0, np.pi / 2))
    low, high = (problem.cell.object(part.name) for part in problem.parts)
    assert np.allclose(low.start[:3, 3], (2.5, -0.4, 0.1))
    assert np.allclose(high.start[:3, 3], (2.0, 1.0, 0.15))
    assert (high.colour, low.mass) == ((10, 20, 30), 8.0)
    half = 0.5 * high.size
    assert [grip.touch[:3, 3].tolist() for grip in problem.part("high").grips] == [
        [0.0, half[1], 0.0],
        [0.0, 0.0, half[2]],
    ]
    assert np.allclose(problem.part("high").insertion, (0.0, 0.0, -1.0))
    assert problem.graph.carriers["high"] == {"low"}
    assert (problem.seed, problem.seconds) == (7, SkillSeconds(1.0, 2.0, 3.0))


def test_what_is_joined_may_stand_over_an_edge(tmp_path: Path) -> None:
    over = "[0.1, 0, 0.3]", "[0.24, 0, 0.3]"
    glued = "  supply:", "  joined: [[high, low], [low, ground]]\n  supply:"
    problem = problem_of(written(tmp_path, OWN, over, glued))
    assert problem.balance.needs("high", {"low": 1.0}) == frozenset({"low"})
    unlooked = "  supply:", "  balance: {check: false}\n  supply:"
    assert problem_of(written(tmp_path, OWN, over, unlooked)).statics is None


def test_exceptions_hold_for_a_robot_and_for_a_type_of_parts(tmp_path: Path) -> None:
    text = OWN + (
        "execution:\n  skill_overrides:\n"
        "    - {skill: pick, robot: mover1, duration: {kind: fixed, value_s: 11}}\n"
        "    - {skill: place-down, object: 0.4 x 0.3 x 0.2, duration: {kind: fixed, value_s: 12}}\n"
    )
    scenario = loaded(tmp_path, text)
    cell = build_workcell(scenario)
    kind = assembly_kind(scenario.assembly)
    assert isinstance(kind, ConstructionKind)
    settings = motion_settings(scenario, cell, tmp_path)
    problem = kind.problem(cell, settings)
    low = problem.part("low")
    means = {name: model.mean for name, model in packaged_timings().items()}
    assert problem.seconds_of("pick", "mover1", low) == 11
    assert problem.seconds_of("pick", "mover2", low) == means["pick"]
    assert problem.seconds_of("place-down", "mover2", low) == 12
    assert problem.seconds_of("handover", "mover1", low) == means["handover"]
    motions = kind.plan(cell, settings, StageWatch()).motion_plan
    for task, motion in zip(motions.tasks, motions.motions, strict=True):
        least = {"pick": 11 if task.robot == "mover1" else means["pick"]}
        least["place-down"] = 12
        taken = motion.time[-1] - motion.time[0]
        assert taken >= least.get(task.kind, 0) - 1e-9


def test_where_all_parts_have_a_start_nothing_is_laid_out(tmp_path: Path) -> None:
    first = "[0, 0, 0.1]}", "[0, 0, 0.1]}, start: {xyz_m: [-2, 1, 0.1]}"
    near = "  supply: {", "  supply: {near: true, "
    problem = problem_of(written(tmp_path, OWN, first, near))
    assert np.allclose(problem.cell.object("low").start[:3, 3], (-2.0, 1.0, 0.1))


def test_pads_are_at_a_frame_where_a_part_has_room(tmp_path: Path) -> None:
    for frame, words in (
        ("flange", "cannot hold a part at its frame 'flan"),
        ("pad", r"no frame 'pad' \(valid: flange, tool"),
    ):
        grips = "  supply:", f"  grips: {{frame: {frame}}}\n  supply:"
        with pytest.raises(RobotModelError, match=words):
            problem_of(written(tmp_path, OWN, grips))


def test_shortcuts_keep_the_speeds_of_joints(tmp_path: Path) -> None:
    scenario = loaded(tmp_path, OWN)
    cell = build_workcell(scenario)
    for robot in cell.robots:
        speed = motion_settings(scenario, cell, tmp_path).speeds[robot.name]
        ahead = np.zeros(robot.model.dof)
        ahead[0] = 1.0
        least = 1.0 / float(robot.model.velocity[0])
        assert speed.duration(np.zeros_like(ahead), ahead) == pytest.approx(least)


HANDOVER = (FOLDER / "handover.yaml").read_text()
CRANE = "".join(HANDOVER.partition("  robots:\n")[1:]).partition("  team:\n")[0]

HANGING = """\
    - {name: post1, size_m: [0.3, 0.3, 0.8], goal: {xyz_m: [2, 0, 0.4]}, mass_kg: 9}
    - {name: post2, size_m: [0.3, 0.3, 0.8], goal: {xyz_m: [3.2, 0, 0.4]}, mass_kg: 9}
    - {name: lintel, size_m: [1.6, 0.3, 0.2], goal: {xyz_m: [2.6, 0, 0.9]}, mass_kg: 12}
    - {name: lamp, size_m: [0.1, 0.1, 0.1], goal: {xyz_m: [2.6, 0, 0.75]}, mass_kg: 1}
"""
"""A lamp below a lintel on two posts."""

BESIDE = """\
    - {name: next, size_m: [0.4, 0.3, 0.2], goal: {xyz_m: [0, 0.31, 0.1]}, mass_kg: 8}
"""
"""A part 10 mm beside ``low``."""

# What is changed in a shipped or in the own file, and what `twin run` says in the end.
BAD_INPUT = rows(r"""
file     | old           | new                                      | says
OWN      | [2, 1, 0.15]  | [20, 1, 0.15]                            | high cannot be picked: none of mover1, mover2 reaches it where it lies
OWN      | [0, 0, 0.1]}  | [0, 0, 0.1]}, faces: [-z]                | low cannot be placed: none of mover1, mover2 reaches its place
OWN      | [0.1, 0, 0.3] | [0.1, 0, 0.5]                            | nothing connects high to the ground
OWN      | [0, 0, 0.1]   | [0, 0, 0.15]                             | low and high would overlap by 50 mm where they belong
OWN      | "  supply:"   | "  grips: {offsets_m: [0.3]}\n  supply:" | no pad can touch low: all offsets (0.3 m) lie beyond the edges of its faces +z
OWN      | [0, 0, 0.1]}  | [0, 0, 0.1]}, insertion: [1, 0, 0]       | low goes into its place along (1.00, 0.00, 0.00), from 0.1 m away, where it touches ground
OWN      | [2, 1, 0.15]  | [2.5, -0.4, 0.15]                        | low and high overlap by
OWN      | [2, 1, 0.15]  | [0, 4, 0.15]                             | mover1 cannot stand at HOME: mover1/arm
OWN      | [0.1, 0, 0.3] | [0.24, 0, 0.3]                           | high would not stand once high is in place, after all that can come before: no forces between it and low keep it in balance (friction 0.4, gravity tilted by 1 degrees); join it to what is there (joined: [[low, high]])
OWN      | "  supply:"   | "  joined: [[low, lower]]\n  supply:"     | unknown part or fixture 'lower'
OWN      | "  supply:"   | "  joined: [[low, low]]\n  supply:"       | low cannot be joined to itself
OWN      | "  supply:"   | "  joined: all\n  supply:"                | assembly.joined
OWN      | "count: 2,"   | "count: 2, limits: {payload_kg: 7},"     | low is too heavy for everyone: mover1: it may carry
OWN      | "  supply:"   | HANGING                                  | lintel, lamp cannot be placed in any order
NARROW   | "  supply:"   | BESIDE                                   | next and low lie 10.0 mm apart where they belong, and a part in hand keeps 20.0 mm
HANDOVER | CRANE         | ""                                       | beam13 cannot be placed: none of arm1, arm2, arm3 reaches its place
HANDOVER | [0.0, 0.25, -0.25] | [0.0]                               | the team cannot build beam13, beam14, beam15: arm1, arm2, arm3 can pick beam13, only crane can place it, and no handover between them was found
""")
TEXTS = {
    "OWN": OWN,
    "NARROW": OWN.replace("  team:", "  clearance: {robot_object_m: 0.02}\n  team:"),
    "HANDOVER": HANDOVER,
    "CRANE": CRANE,
    "HANGING": HANGING + "  supply:",
    "BESIDE": BESIDE + "  supply:",
}
"""What stands in the table for texts of several lines."""


@pytest.fixture(scope="module")
def compiled() -> None:
    """What the checks need is compiled: nobody waits for that twice."""
    problem_of(FOLDER / "handover.yaml")


@pytest.mark.parametrize(("text", "old", "new", "words"), BAD_INPUT)
@pytest.mark.usefixtures("compiled")
def test_bad_input_ends_a_run_with_names_within_seconds(
    text: str, old: str, new: str, words: str, tmp_path: Path
) -> None:
    change = TEXTS.get(old, old), TEXTS.get(new, new)
    file = written(tmp_path, TEXTS[text], change)
    begin = time.process_time()
    result = CliRunner().invoke(app, ["run", str(file)])
    assert time.process_time() - begin < 10.0
    assert result.exit_code != 0
    assert words in " ".join(result.output.split())
    assert "Traceback" not in result.output


def test_more_robots_than_there_are_is_refused() -> None:
    file = FOLDER.parent / "lego" / "cliff.yaml"
    result = CliRunner().invoke(app, ["run", str(file), "--robots", "3"])
    assert result.exit_code == 2
    assert "--robots 3: the cell has 2 robots and no team" in result.output


def test_a_model_whose_joints_leave_nothing_of_a_part_is_refused(
    tmp_path: Path,
) -> None:
    text = (FOLDER / "pavilion.yaml").read_text()
    wide = "joint_m: 0.012", "joint_m: 0.4"
    with pytest.raises(
        ScenarioError, match=r"cassette\d+_\d+ would measure .* the joint"
    ):
        loaded(tmp_path, text, wide)
