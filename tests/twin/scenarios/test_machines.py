"""Machines work at parts without a robot: nothing is taken before they are done, in both engines."""

import copy
import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st

from planning.errors import InfeasibleStepError, PlanInvariantError
from scheduling.conflicts.derived_tpg import DerivedTpg
from scheduling.graph.plan_files import load_plan
from scheduling.graph.temporal_plan_graph import TemporalPlanGraph
from scheduling.invariant import check_invariant
from scheduling.verification.verify import verify_plan
from tests.planted import rows
from tests.twin.drawn_runs import sample_node_times
from tests.twin.scenarios.executed import executed
from tests.twin.simulated import run_bulk, simulate
from tests.twin.written import loaded
from twin.audits.audit import audit_run
from twin.audits.expectations import scenario_expectations
from twin.audits.run_auditor import audit_execution
from twin.bulk.bulk_engine import BulkEngine
from twin.checks.finding import CheckContext
from twin.checks.reach import check_reach
from twin.document.validation import InvalidScenarioError
from twin.durations.bounded import Fixed, Uniform
from twin.durations.nanoseconds import NANOSECONDS
from twin.engine.execution_model import ExecutionModel
from twin.kinds.parts.checks.places import check_goals
from twin.runs.summary import summarize_run
from twin.scenario.sections.scenario import Scenario
from twin.studies.replications.block_results import task_groups
from twin.studies.replications.experiment import Block
from twin.studies.replications.timing_graph import timing_graph
from twin.studies.replications.workload import Engines, Workload
from twin.trial.plan_result import PlanResult
from twin.trial.planning import plan_scenario
from twin.trial.run_result import RunResult
from twin.trial.simulation import execute, skill_durations
from twin.uncertainty.disturbances import (
    Disturbances,
    MachineBreakdowns,
    MachineDisturbances,
    SkillFailure,
    Stalls,
)
from twin.uncertainty.skill_durations import SkillDurations

NEST = {"fixture": "vise", "frame": "nest", "pose": {"xyz_m": [0, 0, 0.015]}}
CELL: dict[str, Any] = yaml.safe_load("""\
version: 1
name: tending
cell:
  robots:
    - {name: left, model: panda, base: {xyz_m: [-0.6, 0, 0]}}
    - {name: right, model: panda, base: {xyz_m: [0.6, 0, 0], rpy_deg: [0, 0, 180]}}
  fixtures:
    - {name: table, size_m: [1.8, 1.3, 0.04], pose: {xyz_m: [0, 0, -0.02]}}
    - name: vise
      size_m: [0.1, 0.1, 0.04]
      pose: {xyz_m: [0, 0.2, 0.02]}
      frames: {nest: {xyz_m: [0, 0, 0.02]}}
assembly:
  kind: assembly
  sources:
    blanks:
      kind: feeder
      pose: {xyz_m: [-0.35, -0.33, 0.015]}
      refill: {kind: fixed, value_s: 2.0}
  machines: {mill: {door: {size_m: [0.3, 0.01, 0.3], pose: {xyz_m: [0, 0.1, 0.2]}}}}
  processes:
    milling: {duration: {kind: uniform, low_s: 5.0, high_s: 60.0}, machine: mill}
    cooling: {duration: {kind: uniform, low_s: 1.0, high_s: 30.0}, unattended: true}
  parts:
    - {name: blank, size_m: [0.03, 0.03, 0.03], source: blanks, goal: {xyz_m: [0.4, 0, 0.015]}}
  steps:
    - {place: blank, at: {fixture: vise, frame: nest, pose: {xyz_m: [0, 0, 0.015]}}, robots: [left]}
    - {process: milling, at: {part: blank}, name: milled}
    - {place: blank, robots: [right]}
    - {process: cooling, at: {part: blank}, name: cold, after: [milled]}
  products: {count: 5, leave_s: 1.0}
  grips: {opening_m: 0.04, positions: 1}
planning: {speed_rad_s: 2.0, shortcut_candidates: 200}
execution:
  skills: {pick: {kind: fixed, value_s: 1.0}, place-down: {kind: fixed, value_s: 1.0}}
""")

STEPS: list[Any] = CELL["assembly"]["steps"]
CURING = {"curing": {"duration": {"kind": "fixed", "value_s": 50}, "unattended": True}}
MILLING = {"milling": CELL["assembly"]["processes"]["milling"]}


def box(
    name: str, start: list[float], goal: list[float], size: float = 0.03
) -> dict[str, Any]:
    """Return a part, square and 30 mm wide, of some length [m]."""
    return {
        "name": name,
        "size_m": [size, 0.03, 0.03],
        "start": {"xyz_m": start},
        "goal": {"xyz_m": goal},
    }


ALONE: dict[str, Any] = {"sources": None, "products": None, "machines": None}
"""No line, and no machine."""


def scenario(folder: Path, **assembly: Any) -> Scenario:
    """Return the cell with other keys of its assembly; None takes one away."""
    document = copy.deepcopy(CELL)
    for key, value in assembly.items():
        if value is None:
            del document["assembly"][key]
        else:
            document["assembly"][key] = value
    return loaded(folder, yaml.safe_dump(document))


def said(text: str) -> Any:
    """Return keys of an assembly as they stand in a file."""
    return yaml.safe_load(text.replace("NEST", json.dumps(NEST)))


def say_late(folder: Path, machine: str, seconds: float) -> None:
    """Let a log say that a machine was done later than it was."""
    log = folder / "events.jsonl"
    events = [json.loads(line) for line in log.read_text().splitlines()]
    for event in events:
        if event.get("robot") == machine and event["kind"] == "completed":
            event["t_s"] += seconds
    log.write_text("".join(json.dumps(event) + "\n" for event in events))


def mill_down(
    breakdowns: MachineBreakdowns | None, stalls: Stalls | None = None
) -> Disturbances:
    stalls = stalls or Stalls()
    mill = MachineDisturbances(breakdowns=breakdowns, stalls=stalls)
    return Disturbances(machines={"mill": mill})


def tried(own: Scenario, folder: Path) -> RunResult:
    """Return a trial of a scenario whose audit found nothing."""
    return executed(own, plan_scenario(own).tpg, folder)


@pytest.fixture(scope="module")
def line(tmp_path_factory: pytest.TempPathFactory) -> TemporalPlanGraph:
    """The plan of five products, proved as a whole."""
    folder = tmp_path_factory.mktemp("line")
    tpg = plan_scenario(scenario(folder), folder).tpg
    check_invariant(DerivedTpg(tpg))
    return tpg


@pytest.fixture(scope="module")
def times(tmp_path_factory: pytest.TempPathFactory) -> SkillDurations:
    """Durations of that line."""
    folder = tmp_path_factory.mktemp("times")
    return skill_durations(scenario(folder), folder)


def ordered_tasks(tpg: TemporalPlanGraph) -> list[tuple[int, int]]:
    """Return by hand what must be over before what begins, as pairs of tasks."""
    own = {(t.kind, t.object, t.robot): t.index for t in tpg.tasks}
    pairs = []
    for k in range(1, 6):
        blank = f"blank.{k}"
        loaded = own["place-down", blank, "left"]
        milled = own["milling", blank, "mill"]
        taken = own["pick", blank, "right"]
        placed = own["place-down", blank, "right"]
        (cold,) = (
            t.index for t in tpg.tasks if (t.kind, t.object) == ("cooling", blank)
        )
        pairs += [(loaded, milled), (milled, taken), (placed, cold)]
        if k > 1:
            # The nest is empty again, and at the place of products none is left.
            before = f"blank.{k - 1}"
            pairs.append((own["pick", before, "right"], loaded))
            pairs.append((own["place-down", before, "right"], placed))
    leave = [t.index for t in tpg.tasks if t.kind == "leave"]
    cooled = [t.index for t in tpg.tasks if t.kind == "cooling"]
    pairs += list(zip(cooled, leave, strict=True))
    return pairs


def test_the_line_has_its_machines(line: TemporalPlanGraph) -> None:
    names = {line.chains[k].robot for k in line.machine_chains()}
    assert names == {"blanks", "mill", "cooling", "outfeed"}
    assert {line.chains[k].robot for k in line.working_machines()} == {
        "mill",
        "cooling",
    }
    doors = [item for item in line.cell.objects if item.kind == "door"]
    assert [door.name for door in doors] == [f"mill.door.{k}" for k in range(1, 6)]
    assert all(door.later for door in doors)


@settings(max_examples=25, deadline=None)
@given(
    seed=st.integers(0, 10**6),
    low=st.floats(0.0, 20.0),
    wide=st.floats(0.0, 100.0),
    mtbf=st.floats(5.0, 100.0),
    stalls=st.sampled_from([0.0, 60.0]),
)
def test_nothing_is_taken_before_the_machine_is_done(
    line: TemporalPlanGraph,
    times: SkillDurations,
    seed: int,
    low: float,
    wide: float,
    mtbf: float,
    stalls: float,
) -> None:
    drawn = Uniform(low_s=low, high_s=low + wide)
    durations = SkillDurations(
        {**times.models, "milling": drawn, "cooling": drawn}, times.overrides
    )
    breakdowns = MachineBreakdowns(mtbf_s=mtbf, mttr_s=20.0)
    down = mill_down(breakdowns, Stalls(rate_per_h=stalls))
    bulk = BulkEngine(line, ExecutionModel(durations, disturbances=down))
    found = run_bulk(bulk, seed=seed, replications=[0, 1])
    groups = task_groups(bulk.contraction.tpg)
    for r in range(2):
        run = simulate(line, durations, seed=seed, replication=r, disturbances=down)
        assert run.makespan_ns == int(found.makespan_ns[r])
        first, last = {}, {}
        for chain, start, end in zip(
            line.chains, run.start_ns, run.end_ns, strict=True
        ):
            for task in np.unique(chain.task).tolist():
                own = chain.task == task
                first[task], last[task] = int(start[own].min()), int(end[own].max())
        side = {
            task: (int(found.start_ns[a, r]), int(found.end_ns[b, r]))
            for task, a, b in zip(
                groups.task.tolist(), groups.first, groups.last, strict=True
            )
        }
        for before, after in ordered_tasks(line):
            assert last[before] <= first[after]
            assert side[before][1] <= side[after][0]


def test_the_machine_sets_the_pace_as_by_hand(
    line: TemporalPlanGraph, times: SkillDurations
) -> None:
    slow = {**times.models, "milling": Fixed(value_s=100.0)}
    run = simulate(line, SkillDurations(slow, times.overrides), seed=0)
    (mill,) = (k for k, c in enumerate(line.chains) if c.robot == "mill")
    begun = run.start_ns[mill] / NANOSECONDS
    assert np.allclose((run.end_ns[mill] - run.start_ns[mill]) / NANOSECONDS, 100.0)
    # What is between two parts: taken out, loaded. Both arms are at work for some seconds.
    pauses = np.diff(begun) - 100.0
    assert np.allclose(pauses[1:], pauses[1], atol=1e-6)
    assert 2.0 < pauses[1] < 15.0


@pytest.fixture(scope="module")
def one_product(tmp_path_factory: pytest.TempPathFactory) -> PlanResult:
    """One robot after the other around one machine: everything is in one line."""
    folder = tmp_path_factory.mktemp("one")
    own = scenario(folder, products={"count": 1}, steps=STEPS[:3], processes=MILLING)
    return plan_scenario(own, folder, bound=True)


def test_a_breakdown_lengthens_as_by_hand(one_product: PlanResult) -> None:
    tpg = one_product.tpg
    durations = skill_durations(one_product.scenario.sections)
    (mill,) = (k for k, c in enumerate(tpg.chains) if c.robot == "mill")
    broken = 0
    for replication in range(20):
        plain = simulate(tpg, durations, seed=3, replication=replication)
        for clock in ("busy", "run"):
            down = mill_down(MachineBreakdowns(mtbf_s=20.0, mttr_s=10.0, clock=clock))
            run = simulate(
                tpg, durations, seed=3, replication=replication, disturbances=down
            )
            late = run.makespan_ns - plain.makespan_ns
            if clock == "busy":
                drawn = sample_node_times(
                    tpg, durations, down, seed=3, replication=replication
                )
                stood = [e.duration_ns for own in drawn.standstills for e in own]
                assert late == sum(stood)
                broken += len(stood)
            else:
                begun = int(plain.start_ns[mill][0])
                left, now = int(plain.duration_ns[mill][0]), begun
                for start, end in run.stops_ns[mill]:
                    if end <= begun or start >= now + left:
                        continue
                    left -= max(start - now, 0)
                    now = end
                assert late == now + left - int(plain.end_ns[mill][0])
            # Robots never break down here.
            others = [k for k in range(len(tpg.chains)) if k != mill]
            assert not any(run.stood_ns[k].any() or run.stops_ns[k] for k in others)
    assert broken > 10


def test_robots_that_break_down_leave_machines_alone(one_product: PlanResult) -> None:
    tpg = one_product.tpg
    durations = skill_durations(one_product.scenario.sections)
    down = Disturbances(stalls=Stalls(count_per_robot=2))
    run = simulate(tpg, durations, seed=0, disturbances=down)
    stood = {c.robot: run.stood_ns[k].sum() for k, c in enumerate(tpg.chains)}
    assert stood["mill"] == 0
    assert min(stood["left"], stood["right"]) > 0


def test_nobody_passes_through_a_door_that_is_shut(tmp_path: Path) -> None:
    """The right arm puts something down in the room of the mill's door, but not while it is shut."""
    peg = box("peg", [0.25, -0.2, 0.015], [0.25, 0.28, 0.015])
    blank = {
        **CELL["assembly"]["parts"][0],
        "start": {"xyz_m": [-0.35, -0.33, 0.015]},
        "goal": {"xyz_m": [-0.35, 0.2, 0.015]},
    }
    del blank["source"]
    zone = {"size_m": [0.4, 0.5, 0.4], "pose": {"xyz_m": [0.1, 0.25, 0.25]}}
    steps = """
      - {place: blank, at: NEST, robots: [left], name: loaded}
      - {process: milling, at: {part: blank}}
      - {place: blank, robots: [left]}
      - {place: peg, robots: [right], after: [loaded]}
    """
    line = {**ALONE, "processes": MILLING, "parts": [blank, peg], "steps": said(steps)}
    found = {}
    for door in (None, zone):
        mill = {} if door is None else {"door": door}
        own = scenario(tmp_path, **{**line, "machines": {"mill": mill}})
        trial = tried(own, tmp_path / f"run{door is None}")
        of_the_mill = ("mill", "started"), ("mill", "completed")
        begun, done, put = (
            next(e.t_ns for e in trial.history if (e.robot, e.kind) == what)
            for what in (*of_the_mill, ("right", "detached"))
        )
        found[door is None] = begun < put < done
    assert found == {True: True, False: False}
    # Both proofs find out if nobody waited.
    tpg = load_plan(tmp_path / "runFalse")
    ends = {tpg.chain_index["mill"], tpg.chain_index["right"]}
    kept = [set(edge[[0, 2]].tolist()) != ends for edge in tpg.edges]
    careless = replace(tpg, edges=tpg.edges[kept], cause=tpg.cause[kept])
    assert verify_plan(tpg).problems == ()
    problems = verify_plan(careless).problems
    assert any("mill.door at rest overlap" in item.message for item in problems)
    with pytest.raises(PlanInvariantError, match=r"'mill'.*'right'"):
        check_invariant(DerivedTpg(careless))


def test_a_robot_whose_home_is_in_a_door_is_refused(tmp_path: Path) -> None:
    door = {"size_m": [0.6, 0.6, 0.2], "pose": {"xyz_m": [-0.3, 0, 0.6]}}
    own = scenario(tmp_path, machines={"mill": {"door": door}})
    with pytest.raises(InfeasibleStepError, match="left stands in the door of mill"):
        plan_scenario(own, tmp_path)


def test_the_audit_holds_machines_to_the_scenario(tmp_path: Path) -> None:
    own = scenario(tmp_path, products={"count": 2})
    tried(own, tmp_path / "run")

    def violations() -> list[str]:
        report = audit_execution(own, tmp_path / "run", ordered=True, finished=True)
        return [v.detail for v in report.violations if v.kind == "process"]

    assert violations() == []
    say_late(tmp_path / "run", "mill", 5.0)
    found = violations()
    assert sum("lies there from" in words for words in found) == 2
    assert sum("begins before milled" in words for words in found) <= 2
    wanted = scenario_expectations(own)
    assert [(rest.part, rest.process) for rest in wanted.rests][:3] == [
        ("blank.1", None),
        ("blank.1", "milling"),
        ("blank.1", "cooling"),
    ]


def test_what_is_unattended_goes_on_side_by_side(tmp_path: Path) -> None:
    parts = [
        box(name, [-0.35, y, 0.015], [-0.2, y, 0.015])
        for name, y in (("one", -0.2), ("two", 0.2))
    ]
    steps = """
      - one
      - {process: curing, at: {part: one}}
      - two
      - {process: curing, at: {part: two}}
    """
    line = {**ALONE, "processes": CURING, "parts": parts, "steps": said(steps)}
    own = scenario(tmp_path, **line)
    tpg = plan_scenario(own, tmp_path).tpg
    chains = {tpg.chains[k].robot for k in tpg.machine_chains()}
    assert chains == {"curing.1", "curing.2"}
    run = execute(own, tpg, tmp_path)
    # One arm places both, one after another; both cure from then on.
    assert 50.0 < run.makespan_s < 70.0


@pytest.mark.parametrize(
    ("assembly", "message"),
    rows(r"""
assembly                                     | says
{machines: null}                             | there is no machine 'mill': give machines one
{machines: {mill: {}, oven: {}}}             | no process is done by oven
{steps: [{place: blank, at: NEST, robots: [left]}]} | no step puts it in its place
{steps: [blank, {place: blank, at: NEST, name: back}]} | blank is already placed in step 1
{steps: [{process: milling, at: {fixture: vise}}, blank]} | milling is done at a part
{steps: [{process: milling, at: {part: blank}, robots: [left]}, blank]} | no robot does milling: leave robots out
{steps: [{place: blank, at: {part: blank}}, blank]} | put down at a fixture or in the world
{processes: {milling: {duration: {kind: fixed, value_s: 9}, machine: mill, tool: driver}}} | tool is of a robot, and no robot does this
"""),
)
def test_what_cannot_be_is_said(tmp_path: Path, assembly: str, message: str) -> None:
    with pytest.raises(InvalidScenarioError, match=message):
        scenario(tmp_path, **said(assembly))


def test_disturbed_machines_are_there(tmp_path: Path) -> None:
    document = copy.deepcopy(CELL)
    document["execution"]["machines"] = {"outfeed": {"stalls": {"rate_per_h": 1}}}
    loaded(tmp_path, yaml.safe_dump(document))
    document["execution"]["machines"]["mil"] = {}
    with pytest.raises(InvalidScenarioError, match=r"machine 'mil'.*mill"):
        loaded(tmp_path, yaml.safe_dump(document))


@pytest.mark.parametrize(
    ("steps", "message"),
    rows(r"""
steps                                        | says
[{place: post, at: {pose: {xyz_m: [0, -0.2, 0.3]}}}, post] | would leave it in the air
[{place: post, at: {fixture: table, pose: {xyz_m: [-0.2, 0.1, 0.035]}}}, cap, post] | cap was put to it where it lies
"""),
)
def test_what_is_put_down_on_its_way_stands_alone(
    tmp_path: Path, steps: str, message: str
) -> None:
    post = box("post", [-0.35, -0.2, 0.015], [-0.2, -0.2, 0.015])
    cap = box("cap", [-0.35, 0.2, 0.015], [-0.2, 0.1, 0.045])
    line = {**ALONE, "processes": None, "parts": [post, cap], "steps": said(steps)}
    own = scenario(tmp_path, **line)
    with pytest.raises(InfeasibleStepError, match=message):
        plan_scenario(own, tmp_path)


@pytest.mark.parametrize(
    ("xyz", "messages"),
    [
        ([0, 0.2, 0.055], []),
        (
            [0, 0.2, 0.5],
            ["blank.1 would be left in the air: at (0, 0.2, 0.5) it touches"],
        ),
        (
            [1.7, 0.6, 0.015],
            [
                "blank.1 would be left in the air: at (1.7, 0.6, 0.015) it touches",
                "no robot reaches blank.1: (1.7, 0.6, 0.015), at (1.70",
                "no robot that may do it (right) reaches blank.1: where it lies, at (1.70",
            ],
        ),
    ],
)
def test_stops_are_looked_at_before_planning(
    tmp_path: Path, xyz: list[float], messages: list[str]
) -> None:
    steps = [{"place": "blank", "at": {"pose": {"xyz_m": xyz}}}, *STEPS[1:]]
    subject = CheckContext(scenario(tmp_path, steps=steps), tmp_path)
    found = [*check_goals(subject), *check_reach(subject)]
    # It is said of every product that is written out: one.
    assert len(found) == len(messages)
    for item, message in zip(found, messages, strict=True):
        assert item.message.startswith(message)
        assert item.at == ("assembly", "steps", 0, "at")


def test_machines_count_for_the_bound_of_the_makespan(one_product: PlanResult) -> None:
    # The mill takes 32.5 s in the mean, between what the arms do.
    assert one_product.makespan_bound_s is not None
    assert 32.5 < one_product.makespan_bound_s <= one_product.makespan_s


def test_run_and_study_say_how_busy_machines_are(
    line: TemporalPlanGraph, times: SkillDurations
) -> None:
    down = mill_down(None, Stalls(count_per_robot=2))
    model = ExecutionModel(times, disturbances=down)
    (mill,) = (k for k, c in enumerate(line.chains) if c.robot == "mill")
    for reasons in ((), ("asked for",)):
        load = Workload(timing_graph(line), model, 7, reasons)
        rows = Engines(load).compute(Block(0, 0, 3)).rows
        assert rows.robots == ("left", "right", "mill", "cooling")
        for r in range(3):
            run = simulate(line, times, seed=7, replication=r, disturbances=down)
            busy = int((run.end_ns[mill] - run.start_ns[mill]).sum())
            stood = int(run.stood_ns[mill].sum())
            assert stood > 0
            assert rows.busy_ns[2, r] == busy
            own = summarize_run(line, run, scenario="tending")["machines"]["mill"]
            assert own["busy_s"] == pytest.approx(busy / NANOSECONDS)
            assert own["down_s"] == pytest.approx(stood / NANOSECONDS)
            share = busy / run.makespan_ns
            assert own["utilisation"] == pytest.approx(share)
            # Waits are of robots alone: what a machine waits for is no loss.
            assert rows.waited_ns[:, r].sum() == sum(
                run.wait_ns(k)
                for k in range(len(line.chains))
                if k not in line.machine_chains()
            )


def test_attempts_of_a_machine_may_fail(one_product: PlanResult) -> None:
    tpg = one_product.tpg
    durations = skill_durations(one_product.scenario.sections)
    failing = Disturbances(
        failures={"milling": SkillFailure(probability=1.0, retries=1)}
    )
    run = simulate(tpg, durations, seed=0, disturbances=failing)
    assert run.outcome == "failed"
    assert "milling blank.1) of mill" in str(run.failure)


def test_a_robot_keeps_hold_of_what_has_not_cured(tmp_path: Path) -> None:
    document = copy.deepcopy(CELL)
    wall = {"size_m": [0.02, 0.2, 0.3], "pose": {"xyz_m": [0, 0, 0.15]}}
    document["cell"]["fixtures"].append({"name": "wall", **wall})
    document["assembly"] = said("""
      kind: assembly
      processes: {curing: {duration: {kind: fixed, value_s: 30}, unattended: true}}
      steps: [bracket, {process: curing, at: {part: bracket}, name: cured}]
      joined: [{parts: [bracket, wall], by: cured}]
      grips: {opening_m: 0.04, positions: 3}
    """)
    bracket = box("bracket", [-0.3, 0.3, 0.015], [-0.0615, 0, 0.15], 0.1)
    document["assembly"]["parts"] = [bracket]
    own = loaded(tmp_path, yaml.safe_dump(document))
    trial = tried(own, tmp_path / "run")
    assert trial.summary["wait_s"]["left"] == pytest.approx(30.0)
    # A log in which it cures for a second longer: then the bracket was let go of too early.
    say_late(tmp_path / "run", "curing", 1.0)
    wanted = scenario_expectations(own)
    found = audit_run(tmp_path / "run", wanted=wanted, ordered=False).violations
    (v,) = (v for v in found if v.kind == "support")
    assert (v.first, v.second) == ("bracket", "left")
    # Its fingers take 0.4 s to open, and hold until then.
    assert v.t_end - v.t_start == pytest.approx(1.0 - 0.4, abs=0.01)


def test_an_order_that_is_found_waits_for_what_cures(tmp_path: Path) -> None:
    base = box("base", [-0.35, -0.25, 0.015], [-0.2, 0, 0.015], 0.1)
    lid = box("lid", [-0.35, 0.25, 0.015], [-0.2, 0, 0.045])
    steps = """
      - {place: lid, after: [cured]}
      - {process: curing, at: {part: base}, name: cured}
      - base
    """
    line = {**ALONE, "processes": CURING, "parts": [base, lid], "steps": said(steps)}
    trial = tried(scenario(tmp_path, **line, order="find"), tmp_path / "run")
    known = {(e.robot, e.kind): e.t_ns for e in trial.history}
    known |= {(e.object, e.kind): e.t_ns for e in trial.history}
    cured, put = known["curing", "completed"], known["lid", "detached"]
    assert put > cured >= 50 * NANOSECONDS
