"""Operation of a cell: execution with replanning, until every step is done or infeasible."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from functools import partial
from types import MappingProxyType
from typing import Any, TypeVar

import numpy as np

from planning.errors import RequestError
from scheduling.build_tpg import connect_nodes
from scheduling.conflicts.derived_tpg import DerivedTpg
from scheduling.graph.dispatcher import Dispatcher
from scheduling.graph.plan_files import plan_sha256
from scheduling.graph.temporal_plan_graph import TemporalPlanGraph
from scheduling.motion_times import is_driven, with_full_speed_times
from scheduling.planned_motions import PlannedMotions
from scheduling.rolling.cut import world_state_after
from scheduling.rolling.supply import remove_idle_chains, supply_waits, with_supply
from twin.durations.nanoseconds import NANOSECONDS
from twin.engine.driven_robots import DrivenRobots
from twin.engine.ending import Ending
from twin.engine.execution import Execution, Ports
from twin.engine.execution_model import ExecutionModel
from twin.engine.model_holds import with_model_holds
from twin.engine.simulated_robots import SimulatedRobots
from twin.operations.commitment import CutPolicy, PlanRevision
from twin.operations.person import AnswerCallback, Ask, Person
from twin.operations.planner import Planner
from twin.operations.recovery import Recovery
from twin.operations.replanner import Keep, RollingReplanner
from twin.operations.supply import LateSupply
from twin.recorders.observers import Observers, Recorder
from twin.registry import RECOVERIES
from twin.runs.execution_record import ExecutionRecord
from twin.scenario.sections.execution import AskSection, StepWindowSection
from twin.scenario.sections.kind import AssemblyKind
from twin.scenario.sections.scenario import Scenario
from twin.uncertainty.disturbances import MachineBreakdowns
from twin.uncertainty.draws import TaskName
from twin.uncertainty.node_times import NodeTimes, NodeTimeSampler

T = TypeVar("T")


@dataclass(frozen=True)
class Operation:
    """Result of an operation.

    Attributes:
        tpg: graph of all executed nodes, and of the rest of the last plan.
        record: outcome and times of the execution.
        versions: plan revisions, in order.
        given_up: abandoned steps, by number, with the reason.
        dropped: cancelled steps that were not done, likewise.
        out: robots out of service.
        asks: questions to a person, and the answers.
        scrapped: wanted products that are incomplete, where there are several.
        reworked: products of which processes were done again, from 1.
        partial: whether there are steps of the scenario that were not done, or a robot that is out holds something.
        ended: why the execution ended before its plan was complete; None where no such cause is known.
        window: steps planned at a time; None for all.
        rush_after: how many products were begun before each one of a rush order that came in.
    """

    tpg: TemporalPlanGraph
    record: ExecutionRecord
    versions: tuple[PlanRevision, ...]
    given_up: Mapping[int, str]
    dropped: Mapping[int, str]
    out: frozenset[str]
    asks: tuple[Ask, ...] = ()
    scrapped: tuple[int, ...] = ()
    reworked: tuple[int, ...] = field(default=(), kw_only=True)
    partial: bool = False
    ended: Ending | None = None
    window: StepWindowSection | None = None
    rush_after: tuple[int, ...] = field(default=(), kw_only=True)

    @property
    def finished(self) -> bool:
        """Whether all steps of the scenario are done and all objects at their goals."""
        return self.record.outcome == "completed" and not self.partial

    @property
    def planning_s(self) -> tuple[float, ...]:
        """Processor time of planning each revision [s]."""
        return tuple(version.cpu_s for version in self.versions)

    def content(self) -> dict[str, Any]:
        """Return the entries of ``summary.json``."""
        return {
            "whole": self.finished,
            "versions": [
                {
                    "sha256": plan_sha256(version.tpg),
                    "cause": version.cause,
                    "cpu_s": round(version.cpu_s, 3),
                }
                for version in self.versions
            ],
            "given_up": {str(step): why for step, why in sorted(self.given_up.items())},
            "dropped": {str(step): why for step, why in sorted(self.dropped.items())},
            "asked": [
                {"step": ask.step, "question": ask.words, "answer": ask.answer}
                for ask in self.asks
            ],
            **({"window": self.window.model_dump()} if self.window else {}),
            **({"scrapped": list(self.scrapped)} if self.scrapped else {}),
            **({"reworked": list(self.reworked)} if self.reworked else {}),
            **({"rush_after": list(self.rush_after)} if self.rush_after else {}),
            **({"ended": asdict(self.ended)} if self.ended else {}),
        }


def operate(
    scenario: Scenario,
    motions: PlannedMotions,
    tpg: TemporalPlanGraph,
    model: ExecutionModel,
    *,
    seed: int,
    replication: int = 0,
    recorders: Sequence[Recorder] = (),
    halting: bool = False,
    answer: AnswerCallback | None = None,
    held: TemporalPlanGraph | None = None,
    ports: Ports | None = None,
    keep: Keep | None = None,
) -> Operation:
    """Execute a plan, and replan after failures.

    Args:
        scenario: scenario with failures and recovery.
        motions: base motions of the plan.
        tpg: the plan.
        model: how it is executed.
        seed, replication: name the random draws.
        recorders: receive every event, then are closed.
        halting: baseline: all robots stop after the current task during replanning, and go HOME first.
        answer: answers for the person, in place of drawn ones; a person is then asked even if the
            scenario has none.
        held: the plan with edges that hold back tasks for time windows, where known.
        ports: robots and audience, where the run is not a simulation.
        keep: keeps each graph that takes the place of another one, and the first one if parts are late.

    Raises:
        RequestError: this kind of assembly, or this policy, cannot be replanned.
    """
    require_rolling(scenario)
    # With failures of the model itself, such as a peg that may miss its hole.
    fails = dict(model.disturbances.failures)
    execution = scenario.execution.changed(failures=fails)
    scenario = scenario.changed(execution=execution)

    def draw(
        graph: TemporalPlanGraph, names: Mapping[int, TaskName] = MappingProxyType({})
    ) -> NodeTimes:
        sampler = NodeTimeSampler(
            with_full_speed_times(graph), model.durations, model.disturbances, names
        )
        return sampler.sample(seed=seed, replication=replication)

    late = scenario.execution.late
    require_picked(motions, [item.part for item in late])
    first, plan = len(tpg.chains), tpg
    tpg = _with_late_deliveries(tpg, [item.part for item in late])
    if late and keep is not None:
        keep(1, tpg)
    asked = scenario.execution.recovery.ask or (AskSection() if answer else None)
    person = Person(asked, seed, replication, answer)
    planner: Planner[Any]
    if scenario.assembly.kind in RECOVERIES:
        recovery = RECOVERIES.load(scenario.assembly.kind)
        planner = recovery(scenario, motions, tpg, draw, person, steps=not halting)
    else:
        planner = Recovery(scenario, motions, tpg, draw, person)
        if halting:
            planner.cuts = ((CutPolicy(evade=True),),)

    def hold(graph: TemporalPlanGraph) -> TemporalPlanGraph:
        return held if held and graph is plan else with_model_holds(graph, model)

    replanning = partial(
        RollingReplanner,
        planner=planner,
        hold=hold,
        far=not (scenario.execution.may_be_replanned() or scenario.kind.rush_s()),
        halting=halting,
        keep=keep,
    )
    ports = ports or Ports(DrivenRobots if is_driven(tpg) else SimulatedRobots)
    ports = replace(ports, supply=LateSupply, replanner=replanning)
    observers = Observers(recorders)
    cell = Execution(
        tpg, draw(tpg), Dispatcher(tpg), model.messages, ports, observers=observers
    )
    replanner, supply, robots = cell.replanner, cell.supply, cell.robots
    assert isinstance(replanner, RollingReplanner)
    assert isinstance(supply, LateSupply)
    for outage in scenario.execution.outages:
        replanner.outage(outage.robot, round(outage.at_s * NANOSECONDS))
    for change in scenario.execution.changes:
        replanner.order(change.drop, change.more, 0, round(change.at_s * NANOSECONDS))
    for at_s in scenario.kind.rush_s():
        replanner.order((), 0, 1, round(at_s * NANOSECONDS))
    for k, item in enumerate(late):
        supply.schedule(first + k, round(item.at_s * NANOSECONDS))
    outcome = cell.execute()
    idle = (k for k, chain in enumerate(cell.tpg.chains) if not len(chain))
    unused = {*supply.arriving, *idle}

    def used(rows: Iterable[T]) -> tuple[T, ...]:
        return tuple(row for k, row in enumerate(rows) if k not in unused)

    executed, times = remove_idle_chains(cell.tpg, unused), robots.node_times()
    ledger = replanner.state.ledger
    given_up = {**planner.never_begun(replanner.state), **ledger.given_up}
    undone = given_up.keys() | ledger.dropped.keys()
    rush_after = replanner.planner.rush_after(replanner.state)
    kind = scenario.kind.written_out().with_rush(rush_after)
    scrapped = _products_of(ledger.given_up, kind)
    reworked = _products_of(ledger.reworked, kind) or ({1} if ledger.reworked else ())
    executed = with_products(executed, kind, undone)
    last = world_state_after(executed, [len(chain) for chain in executed.chains])
    in_hand = any(at.holder in replanner.out for at in last.attachments.values())
    ends = [max(own, default=0) for own in cell.end]
    makespan = cell.now_ns if outcome == "aborted" else max([0, *ends])
    ended = [] if cell.ended is None else [cell.ended.words]
    reasons = [f"step {k} is given up: {w}" for k, w in sorted(given_up.items())]
    record = ExecutionRecord(
        outcome=outcome,
        policy=model.policy,
        seed=seed,
        replication=replication,
        duration_ns=used(times.motion),
        stood_ns=used(times.stood),
        start_ns=used(np.array(own, dtype=np.int64) for own in cell.start),
        end_ns=used(np.array(own, dtype=np.int64) for own in cell.end),
        makespan_ns=makespan,
        standstills=used(times.standstills),
        stops_ns=used(times.stopped_until(makespan)),
        stopped_by_code_ns=used(times.stopped_by_code(makespan)),
        failed_nodes=(-1,) * len(executed.chains),
        failure="; ".join([*ended, *reasons] if outcome != "completed" else []),
        raised_skills=times.raised,
        commands=used(robots.commands()),
        speed_override=used(times.speed_override),
        measured=robots.measured(),
    )
    return Operation(
        executed,
        record,
        tuple(replanner.versions),
        given_up,
        ledger.dropped,
        replanner.out,
        ledger.asks,
        tuple(sorted(scrapped)),
        bool(undone) or kind.wanted_steps() < kind.steps() or in_hand,
        cell.ended,
        scenario.execution.step_window,
        reworked=tuple(sorted(reworked)),
        rush_after=rush_after,
    )


def _products_of(steps: Iterable[int], kind: AssemblyKind) -> set[int]:
    """Return the products of some steps, from 1; empty for one product."""
    return set() if kind.products() == 1 else set(map(kind.product_of, steps))


def with_products(
    executed: TemporalPlanGraph, kind: AssemblyKind, undone: Collection[int]
) -> TemporalPlanGraph:
    """Return a graph with the product of each task, 0 for products of which steps are not done."""
    if kind.products() == 1:
        return executed
    left = _products_of(undone, kind)
    numbers = [_products_of([task.step], kind).pop() for task in executed.tasks]
    whole = np.array([0 if n in left else n for n in numbers], dtype=np.int64)
    return replace(executed, products=whole)


def require_picked(motions: PlannedMotions, late: Sequence[str]) -> None:
    """Refuse late parts that no robot picks, or that support others.

    Raises:
        RequestError: names the part.
    """
    if motions.work is None:
        if late:
            raise RequestError(f"{late[0]} is late: parts of a construction may not be")
        return
    primaries = motions.work.problem.primaries
    picked = {item.object for item in primaries}
    for name in late:
        if name not in picked:
            words = f"{name} is late, and no step picks it: only what is picked is waited for"
            raise RequestError(words, choices=tuple(sorted(picked)))
        above = sorted(
            {q for item in primaries if item.object == name for q in item.after}
        )
        if above:
            words = (
                f"{name} is late, and {above[0]} stands on it or before it at the start"
            )
            raise RequestError(words)


def _with_late_deliveries(
    tpg: TemporalPlanGraph, late: Sequence[str]
) -> TemporalPlanGraph:
    """Return a graph with late parts, each delivered by a machine of its own."""
    if not late:
        return tpg
    first = len(tpg.tasks)
    for k, name in enumerate(late, start=1):
        item = tpg.cell.object(name)
        tpg = with_supply(tpg, f"supply{k}", item, label=f"bring {name}")
    waits = supply_waits(tpg.tasks[:first], tpg.tasks[first:])
    more = np.concatenate([tpg.dependencies.reshape(-1, 2), waits])
    tpg = replace(tpg, dependencies=more)
    return connect_nodes(DerivedTpg(tpg), (tpg.edges, tpg.cause))


def require_rolling(scenario: Scenario) -> None:
    """Refuse scenarios that cannot be replanned during execution.

    Raises:
        RequestError: replanning is impossible; the message says why.
    """
    if (policy := scenario.execution.policy) != "asynchronous":
        raise RequestError(
            f"policy {policy!r}: only asynchronous execution can be replanned",
            choices=("asynchronous",),
        )
    execution = scenario.execution
    breaks: dict[str, MachineBreakdowns | None]
    breaks = {"breakdowns": execution.breakdowns}
    breaks |= {f"machines.{k}": own.breakdowns for k, own in execution.machines.items()}
    for key, own in breaks.items():
        if own is not None and own.mtbf is not None and own.clock == "busy":
            # A new plan would begin the time between failures again.
            raise RequestError(
                f"execution.{key}: an mtbf that is a distribution counts busy time of one plan; with replanning it is"
                " counted by the clock of the run",
                choices=("clock: run", "mtbf_s"),
            )
