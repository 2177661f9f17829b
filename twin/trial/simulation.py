"""How a plan is executed: durations, policy, messages, disturbances; what is known before and after.

Worst-case delays: one robot never finishes a node while all others go on.

Every type-2 edge makes a robot wait for a node of another one. If that node is never complete,
the others run until nothing moves, and the cell stands still in a state that no nominal run
passes through. The audit looks at each of these states.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from planning.errors import ScenarioError
from scheduling.graph.dispatcher import Dispatcher
from scheduling.graph.plan_files import plan_sha256
from scheduling.graph.task_edges import idle_robots
from scheduling.graph.temporal_plan_graph import TemporalPlanGraph
from scheduling.pace import overloads
from scheduling.verification.graph_structure import find_precedence
from twin.audit.audit import Auditor
from twin.audit.case import Violation
from twin.audit.motion.executed import ObjectRow, Recording, RobotRows
from twin.audit.worlds.engines import Engine, engine_and_version, engine_named
from twin.durations.measured import packaged_timings
from twin.engine.bulk.bulk_engine import held_back
from twin.engine.engine import Simulator
from twin.engine.execution_model import ExecutionModel, Messages
from twin.host.progress import Report, report_nothing
from twin.planning.idle_robots import IdleRobot
from twin.planning.place_misses import place_misses
from twin.recorders.observers import Recorder
from twin.run.events import DeadlockError, ExecutionRecord, Policy
from twin.run.policies import SHORTENED
from twin.run.summary import Preparation, summarise
from twin.run.windows import window_doubts
from twin.scenario.manifest import MANIFEST, load_scenario, manifest_base, read_manifest
from twin.scenario.sections.kind import assembly_kind
from twin.scenario.sections.scenario import Scenario
from twin.trial.plan_result import PlanResult
from twin.uncertainty.skill_durations import SkillDurations
from twin.uncertainty.speed_override import unreached_speeds


def scenario_execution(
    scenario: Scenario,
    base: Path = Path(),
    *,
    policy: Policy | None = None,
    antithetic: bool = False,
) -> ExecutionModel:
    """Return the execution model of a scenario.

    Args:
        scenario: durations, disturbances, messages and policy are taken from it.
        base: where relative paths of the scenario start.
        policy: in place of the scenario's.
        antithetic: draw replications in mirrored pairs, see SkillDurations.

    Raises:
        ScenarioError: a file of measured times cannot be read.
    """
    execution = scenario.execution
    robots = tuple(robot.name for robot in scenario.cell.robots)
    disturbances = execution.disturbances(robots, base)
    misses = place_misses(scenario, base)
    return ExecutionModel(
        durations=skill_durations(scenario, base, antithetic=antithetic),
        policy=policy or execution.policy,
        messages=Messages.of_seconds(
            execution.queue_depth, execution.report_s, execution.release_s
        ),
        disturbances=disturbances.with_misses("place-down", misses),
        hold=execution.windows.hold,
    )


def doubts_about_stalls(scenario: Scenario, tpg: TemporalPlanGraph) -> tuple[str, ...]:
    """Return what is said of stalls that are asked for and cannot all happen.

    A robot or machine stalls at most once a node, so that more stalls than nodes are not executed.
    """
    found = []
    for chain in tpg.chains:
        own, who = scenario.execution.stalls, "robot"
        if tpg.cell.is_machine(chain.robot):
            own, who = scenario.execution.of_machine(chain.robot).stalls, "machine"
        if own.count_per_robot > len(chain):
            found.append(
                f"stalls.count_per_robot is {own.count_per_robot}, but {who} {chain.robot!r} has"
                f" {len(chain)} nodes and stalls once at each of them"
            )
    return tuple(found)


def doubts_about_windows(
    scenario: Scenario, tpg: TemporalPlanGraph, base: Path
) -> tuple[str, ...]:
    """Return which windows of time a plan does not keep at nominal times, and by how much."""
    if not any(window.most is not None for window in tpg.windows):
        return ()
    model = scenario_execution(scenario, base)
    held = held_back(tpg, model)
    nominal = ExecutionModel(SkillDurations({}), model.policy, model.messages)
    try:
        run = Simulator(held, nominal).run(seed=scenario.seed)
    except DeadlockError:
        return ()
    return tuple(window_doubts(tpg, run, held=held is not tpg))


def _unreached_speeds(plan: PlanResult) -> tuple[str, ...]:
    """Return which speed factors the limits of robots do not allow; see ``unreached_speeds``."""
    case = plan.scenario
    disturbances = case.sections.execution.disturbances(case.robots, case.folder)
    return unreached_speeds(plan.tpg, disturbances, case.sections.seed)


def followed_execution(
    folder: Path, tpg: TemporalPlanGraph, scenario: Path | None = None
) -> tuple[str, ExecutionModel]:
    """Return the execution model of a followed run, and the name of its scenario.

    Args:
        folder: of the plan; its manifest says, where there is one.
        tpg: the plan.
        scenario: scenario file that says it instead.

    Raises:
        InvalidScenarioError: the scenario file is not valid.
        ScenarioError: it is for other robots.
        OutputError: the manifest is damaged.
    """
    if scenario is not None:
        found, base = load_scenario(scenario), scenario.parent
    elif (folder / MANIFEST).exists():
        found, content = read_manifest(folder, "run to follow")
        base = manifest_base(folder, content)
    else:
        return folder.name, ExecutionModel(SkillDurations(packaged_timings()))
    names = tuple(robot.name for robot in found.cell.robots)
    planned = tuple(robot.name for robot in tpg.cell.robots)
    if names != planned:
        raise ScenarioError(
            f"the plan in {folder} is for robots {', '.join(planned)}, scenario"
            f" {found.name!r} for {', '.join(names)}"
        )
    return found.name, scenario_execution(found, base)


def skill_durations(
    scenario: Scenario, folder: Path = Path(), *, antithetic: bool = False
) -> SkillDurations:
    """Return the durations of all skills, with the exceptions for robots and objects.

    Args:
        scenario: a checked scenario.
        folder: where relative paths in it start, that of its file.
        antithetic: draw replications in mirrored pairs, see SkillDurations.

    Raises:
        ScenarioError: a file of measured times cannot be read.
    """
    execution = scenario.execution
    machines, tools = (
        [item.located(folder) for item in given]
        for given in (
            assembly_kind(scenario.assembly).machine_durations(),
            scenario.tool_durations,
        )
    )
    return SkillDurations(
        execution.skill_models(folder),
        (*tools, *execution.skill_exceptions(folder), *machines),
        antithetic,
        {key: model.located(folder) for key, model in scenario.actuations.items()},
    )


def execute(
    scenario: Scenario,
    tpg: TemporalPlanGraph,
    base: Path,
    policy: Policy | None = None,
    *,
    recorders: tuple[Recorder, ...] = (),
) -> ExecutionRecord:
    """Execute a plan once, with the draws that the scenario's seed names.

    Args:
        scenario: seed, durations and disturbances are taken from it.
        tpg: the plan.
        base: where relative paths of the scenario start.
        policy: how nodes are released; by default as the scenario says.
        recorders: told of every event.

    Raises:
        DeadlockError: no robot could go on.
    """
    model = scenario_execution(scenario, base, policy=policy)
    held = held_back(tpg, model)
    return Simulator(held, model).run(seed=scenario.seed, recorders=recorders)


def prepare(
    plan: PlanResult,
    *,
    recording: bool = False,
    audit: bool | Engine = False,
    operated: bool = False,
) -> Preparation:
    """Return what is known before a run.

    Args:
        plan: what is to be executed.
        recording: whether ``run.rrd`` is wanted.
        audit: whether the audit is to check what was executed; an engine says with what.
        operated: whether what fails is planned anew.
    """
    known = {own.robot: own for own in plan.idle}
    idle = [known.get(k, IdleRobot(k, "unknown")) for k in idle_robots(plan.tpg)]
    # Of a plan of first steps, later ones may be for it.
    windowed = operated and plan.scenario.sections.execution.window is not None
    return Preparation(
        operated=operated,
        recording=recording,
        audit=audit,
        planning_s=dict(plan.planning_s),
        makespan_sequential_s=_makespan_s(plan, plan.turns or plan.tpg, "sequential"),
        plan_sha256=plan_sha256(plan.tpg),
        warnings=(
            *plan.warnings,
            *doubts_about_stalls(plan.scenario.sections, plan.tpg),
            *doubts_about_windows(
                plan.scenario.sections, plan.tpg, plan.scenario.folder
            ),
            *overloads(plan.tpg),
            *_unreached_speeds(plan),
            *(own.message for own in idle if not windowed),
        ),
        checks_off=plan.scenario.sections.checks_off,
        fits=plan.fits,
        idle={own.robot: own.content() for own in idle},
        plan=plan.name,
        turns_sha256=None if plan.turns is None else plan_sha256(plan.turns),
        load_bound_s=plan.load_bound_s,
        # What is left of the plan in turns beside one in slots does not say what waits for what.
        makespan_asynchronous_s=None
        if plan.turns is None or plan.name != SHORTENED
        else _makespan_s(plan, plan.turns, "asynchronous"),
    )


def _makespan_s(
    plan: PlanResult, tpg: TemporalPlanGraph, policy: Policy
) -> float | None:
    """Return the makespan of a plan under a policy [s], None where that comes to no end."""
    case = plan.scenario
    try:
        baseline = execute(case.sections, tpg, case.folder, policy)
    except DeadlockError:
        return None
    return baseline.makespan_s if baseline.outcome == "completed" else None


def figures(
    plan: PlanResult,
    record: ExecutionRecord,
    about: Preparation,
    audit: Mapping[str, Any] | None = None,
) -> dict[str, Any]:
    """Return the figures of a run that has come to its end, with the keys of ``summary.json``.

    Args:
        plan: what was executed.
        record: how it was executed.
        about: what was known before.
        audit: what the audit found, None where there was none.
    """
    scenario = plan.scenario.sections
    due = assembly_kind(scenario.assembly).due()
    return summarise(plan.tpg, record, scenario.name, about, audit, *due)


STOPPING = "robots that stop"
"""Name of the stage for progress displays."""


@dataclass(frozen=True)
class StandingState:
    """The cell after one robot stopped and all others went as far as they may.

    Attributes:
        robot: name of the robot that stopped.
        node: the node that it never completes.
        at_end: True when it stands at the end of that node, False when at its start.
        completed: per chain, how many of its nodes are complete.
    """

    robot: str
    node: int
    at_end: bool
    completed: tuple[int, ...]


@dataclass(frozen=True)
class AdversaryReport:
    """Result of the audit of all standing states.

    Attributes:
        states: how many were looked at.
        min_distance_m: least distance of any two robots in them [m].
        violations: each with the state it was seen in; empty when all is well.
        engine: what distances were measured with, and its version.
    """

    states: int
    min_distance_m: float
    violations: tuple[tuple[StandingState, Violation], ...]
    engine: str


def standing_states(tpg: TemporalPlanGraph) -> Iterator[StandingState]:
    """Yield two states for the source of every type-2 edge: stopped at its start and its end."""
    precedence = find_precedence(tpg)
    for chain, node in sorted({(a, u) for a, u, _, _ in tpg.edges.tolist()}):
        if precedence is None:  # a cycle: some nodes are never complete
            completed = run_until_still(tpg, chain, node)
        else:
            completed = tuple(
                node if k == chain else precedence.not_after(chain, node, k)
                for k in range(len(tpg.chains))
            )
        for at_end in (False, True):
            yield StandingState(tpg.chains[chain].robot, node, at_end, completed)


def run_until_still(tpg: TemporalPlanGraph, frozen: int, node: int) -> tuple[int, ...]:
    """Return the number of nodes of each chain that complete if one node never does.

    Args:
        tpg: the graph.
        frozen: chain of the node.
        node: the node that is never complete.
    """
    dispatcher = Dispatcher(tpg)
    ready = dispatcher.ready()
    while ready:
        chain, index = ready.pop()
        if (chain, index) != (frozen, node):
            ready += dispatcher.complete(chain, index)
    return tuple(dispatcher.completed(k) for k in range(len(tpg.chains)))


def standing_recording(tpg: TemporalPlanGraph, state: StandingState) -> Recording:
    """Return a standing state as one second in which nothing moves."""
    robots = {}
    chains, counts = tpg.chain_index, _begun(tpg, state)
    for placed in tpg.cell.robots:
        if placed.name not in chains:
            q, nodes = placed.home, [-1, -1]
        else:
            count = counts[chains[placed.name]]
            chain = tpg.chains[chains[placed.name]]
            q = chain.stands_at(count)
            nodes = [max(count - 1, 0), min(count, len(chain) - 1)]
        rows = RobotRows(np.array([0.0, 1.0]), np.stack([q, q]), np.array(nodes))
        robots[placed.name] = rows
    objects = tuple(
        ObjectRow(0.0, h.object, h.holder, h.pose)
        for h in tpg.handlings
        if h.node < counts[h.robot] or tpg.holds_before(h)
    )
    return Recording(robots, objects, 1.0)


def _begun(tpg: TemporalPlanGraph, state: StandingState) -> tuple[int, ...]:
    """Return at the end of how many of its nodes each chain stands."""
    counts = list(state.completed)
    counts[tpg.chain_index[state.robot]] += state.at_end
    return tuple(counts)


def audit_standing_states(
    tpg: TemporalPlanGraph,
    progress: Report = report_nothing,
    engine: Engine | None = None,
) -> AdversaryReport:
    """Stop every robot wherever another waits for it, and audit what then stands.

    Args:
        tpg: the plan.
        progress: told of the states looked at so far and their number.
        engine: to measure with; by default PyBullet where it is installed, else coal.

    Raises:
        RequestError: the engine is not installed.
    """
    states = list(standing_states(tpg))
    least, found = math.inf, []
    chosen = engine_named(engine)
    known: dict[tuple[int, ...], tuple[Violation, ...]] = {}
    with Auditor(tpg, chosen) as auditor:
        for k, state in enumerate(states):
            counts = _begun(tpg, state)
            if counts not in known:  # the same may come of many stops
                report = auditor.audit(
                    standing_recording(tpg, state), within=least, ordered=False
                )
                least, known[counts] = report.min_distance_m, report.violations
            found += [(state, violation) for violation in known[counts]]
            progress(STOPPING, k + 1, len(states))
    return AdversaryReport(len(states), least, tuple(found), engine_and_version(chosen))
