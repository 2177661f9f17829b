"""Shortened replications against the event engine, and against longest paths by hand."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from planning.tasks.task import TaskKind
from scheduling.graph.dispatcher import Dispatcher
from scheduling.graph.temporal_plan_graph import TemporalPlanGraph
from tests.twin.studies.study_toys import toy_workload
from twin.bulk.max_plus import PrecedenceArrays
from twin.durations.bounded import Uniform
from twin.durations.nanoseconds import Nanoseconds
from twin.engine.engine import Simulator
from twin.engine.execution import Execution, Ports
from twin.engine.execution_model import Messages
from twin.engine.simulated_robots import SimulatedRobots
from twin.runs.execution_record import Policy
from twin.studies.gains.candidates import CandidateLimits, candidates
from twin.studies.gains.replays import (
    Intervention,
    Replay,
    makespans_with_eased_waits,
    needs_event_engine,
)
from twin.studies.replications.experiment import Block
from twin.studies.replications.workload import Engines, Workload
from twin.uncertainty.disturbances import (
    Breakdowns,
    Disturbances,
    EmergencyStop,
    SkillFailure,
    Stalls,
)
from twin.uncertainty.node_times import NodeTimeSampler

LATE = ("latency_s is 0.3: messages take time",)
BUSY = Disturbances(
    jitter=Uniform(low_s=0.0, high_s=0.2),
    stalls=Stalls(rate_per_h=300.0, duration=Uniform(low_s=1.0, high_s=9.0)),
    breakdowns=Breakdowns(mtbf_s=40.0, mttr_s=8.0),
    failures={"pick": SkillFailure(probability=0.3, retries=1)},
)
NUMBERS = np.arange(12)
MANY = CandidateLimits(tasks=20, skills=7, waits=12, robots=8)


def interventions(load: Workload, replay: Replay) -> list[Intervention]:
    return candidates(replay, replay.base(), load.execution, MANY)


def require_equal(quick: Replay, events: Replay, intervention: Intervention) -> None:
    """Both give the same nanoseconds, however much of what a lever is of is gone."""
    for share in (0.0, 0.2, 1.0):
        found, expected = (
            own.makespans_ns(intervention, share) for own in (quick, events)
        )
        assert np.array_equal(found, expected), (intervention.name, share)


@pytest.mark.parametrize("policy", ["asynchronous", "sequential"])
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_paths_give_the_nanoseconds_of_the_event_engine(
    seed: int, policy: Policy
) -> None:
    load = toy_workload(seed, policy=policy, disturbances=BUSY)
    paths, events = Replay(load, NUMBERS), Replay(load, NUMBERS, by_events=True)
    assert np.array_equal(paths.numbers, events.numbers)
    kinds = set()
    for intervention in interventions(load, paths):
        if intervention.kind == "wait":
            continue
        kinds.add((intervention.kind, *intervention.causes))
        require_equal(paths, events, intervention)
    assert kinds >= {("task",), ("robot",), ("stall", "stall"), ("stall", "breakdown")}
    assert np.array_equal(paths.base().makespan_ns, events.base().makespan_ns)


@pytest.mark.parametrize("policy", ["asynchronous", "sequential"])
def test_messages_give_the_nanoseconds_of_the_event_engine(policy: Policy) -> None:
    load = toy_workload(2, policy=policy, reasons=LATE, disturbances=BUSY)
    late = replace(load.execution, messages=Messages.of_seconds(3, 0.3, 0.1))
    load = replace(load, execution=late)
    quick, events = Replay(load, NUMBERS), Replay(load, NUMBERS, by_events=True)
    assert not needs_event_engine(load)
    found = interventions(load, quick)
    assert {intervention.kind for intervention in found} == {
        *("task", "skill", "robot", "stall", "message")
    }
    for intervention in found:
        require_equal(quick, events, intervention)


@pytest.mark.parametrize("policy", ["asynchronous", "sequential"])
def test_a_task_that_is_gone_is_gone_node_by_node(policy: Policy) -> None:
    """The event engine executes every node; the nodes of one task take no time."""
    load = toy_workload(3, policy=policy)
    replay = Replay(load, NUMBERS)
    sampler = NodeTimeSampler(
        load.tpg, load.execution.durations, load.execution.disturbances
    )
    tasks = [
        intervention
        for intervention in interventions(load, replay)
        if intervention.kind == "task"
    ]
    assert len(tasks) > 5
    for intervention in tasks:
        found = replay.makespans_ns(intervention, 1.0)
        for number in NUMBERS.tolist():
            times = sampler.sample(seed=load.seed, replication=number)
            for chain, motion in zip(load.tpg.chains, times.motion, strict=True):
                motion[chain.task == intervention.task] = 0
            execution = Execution(
                load.tpg,
                times,
                Dispatcher(load.tpg),
                Messages(),
                Ports(SimulatedRobots),
                sequential=policy == "sequential",
            )
            assert execution.execute() == "completed"
            assert found[number] == _work_done(load.tpg, execution)


def test_a_wait_that_is_gone_is_an_edge_that_is_gone() -> None:
    for seed in range(1, 6):
        load = toy_workload(seed)
        replay = Replay(load, NUMBERS)
        waits = [
            intervention
            for intervention in interventions(load, replay)
            if intervention.kind == "wait" and intervention.robot
        ]
        for intervention in waits:
            tpg, graph = replay.tpg, replay.graph
            target = np.repeat(np.arange(len(graph.order)), np.diff(graph.edge_first))
            gone = {(graph.source[e], target[e]) for e in intervention.edges}
            first = graph.first
            keep = [
                (first[k] + n, first[j] + m) not in gone
                for k, n, j, m in tpg.edges.tolist()
            ]
            cut = replace(tpg, edges=tpg.edges[keep], cause=tpg.cause[keep])
            for number in NUMBERS.tolist():
                busy = replay.times.busy_ns[:, number]
                assert replay.makespans_ns(intervention, 1.0)[number] == _executed(
                    cut, busy
                )


def test_what_robots_do_after_their_last_work_gains_nothing() -> None:
    """Going HOME at the very end is part of the makespan, and not worth fixing."""
    seen = 0
    for seed in range(1, 6):
        load = toy_workload(seed)
        replay = Replay(load, NUMBERS)
        base = replay.base()
        every = np.concatenate([chain.task for chain in replay.tpg.chains])
        tried = {
            intervention.task
            for intervention in interventions(load, replay)
            if intervention.kind == "task"
        }
        for chain in load.tpg.chains:
            task = int(chain.task[-1])
            if load.tpg.tasks[task].kind != TaskKind.TRANSIT:
                continue
            rows = np.flatnonzero(every == task)
            home = Intervention("task", "HOME", chain.robot, task, rows)
            needed = np.isin(replay.graph.source, rows).any()
            if needed:
                continue
            seen += 1
            assert replay.work_ns[rows].sum() > 0
            assert np.array_equal(replay.makespans_ns(home, 1.0), base.makespan_ns)
            assert task not in tried
    assert seen >= 2


def _work_done(tpg: TemporalPlanGraph, execution: Execution) -> int:
    """Return when the last node of a task that is no transit ends."""
    return max(
        end[node]
        for chain, end in zip(tpg.chains, execution.end, strict=True)
        for node, task in enumerate(chain.task.tolist())
        if tpg.tasks[task].kind != TaskKind.TRANSIT
    )


def _executed(tpg: TemporalPlanGraph, busy: Nanoseconds) -> int:
    """Return when the work of a graph is done whose nodes take given times, by the event engine."""
    from twin.uncertainty.node_times import NodeTimes

    own = tuple(np.split(busy, np.cumsum([len(c) for c in tpg.chains])[:-1]))
    zeros = tuple(np.zeros_like(row) for row in own)
    times = NodeTimes(zeros, own, ((),) * len(own), (-1,) * len(own))
    execution = Execution(
        tpg, times, Dispatcher(tpg), Messages(), Ports(SimulatedRobots)
    )
    execution.execute()
    return _work_done(tpg, execution)


def _by_hand(
    graph: PrecedenceArrays, busy: list[int], eased: set[int], share: float
) -> int:
    """Return a makespan with waits eased, node by node from the definition."""

    @cache
    def end(n: int) -> int:
        free = int(graph.not_before[n])
        if n > graph.first[graph.chain[n]]:
            free = max(free, end(n - 1))
        edges = range(graph.edge_first[n], graph.edge_first[n + 1])
        free = max([free, *(end(graph.source[e]) for e in edges if e not in eased)])
        full = max([free, *(end(graph.source[e]) for e in edges if e in eased)])
        return free + round((1 - share) * (full - free)) + busy[n]

    return max(end(n) for n in graph.last.tolist() if n >= 0)


@pytest.mark.parametrize("share", [0.0, 0.2, 0.5, 1.0])
def test_eased_waits_are_what_they_are_by_hand(share: float) -> None:
    load = toy_workload(4)
    replay = Replay(load, NUMBERS)
    edges = np.arange(0, len(replay.graph.source), 2)
    found = makespans_with_eased_waits(replay.graph, replay.times.busy_ns, edges, share)
    eased = set(edges.tolist())
    by_hand = [
        _by_hand(replay.graph, busy, eased, share)
        for busy in replay.times.busy_ns.T.tolist()
    ]
    assert found.tolist() == by_hand


def test_replays_begin_with_the_makespans_of_the_study() -> None:
    clock = Disturbances(
        emergency_stops=(EmergencyStop(robot="robot_1", at_s=5.0, duration_s=20.0),),
        breakdowns=Breakdowns(mtbf_s=30.0, mttr_s=5.0, clock="run"),
    )
    for load in (
        toy_workload(1, disturbances=BUSY),
        toy_workload(1, disturbances=clock, reasons=("stops by the clock",)),
    ):
        rows = Engines(load).compute(Block(0, 0, len(NUMBERS))).rows
        replay = Replay(load, NUMBERS)
        kept = replay.numbers
        ends = replay.base().end_ns.max(axis=0)
        assert np.array_equal(ends, rows.makespan_ns[kept])
        done = rows.replication[rows.outcome == "completed"]
        assert np.array_equal(kept, done)
    found = {
        intervention.name: intervention for intervention in interventions(load, replay)
    }
    base = replay.base().makespan_ns
    for name in ("breakdowns by the clock", "emergency stops"):
        gone = replay.makespans_ns(found[name], 1.0)
        assert np.all(gone <= base)
        assert np.any(gone < base)
        assert np.array_equal(replay.makespans_ns(found[name], 0.0), base)


def test_no_lever_gains_more_than_it_takes_on_the_critical_path() -> None:
    load = toy_workload(2, disturbances=BUSY)
    replay = Replay(load, np.arange(200))
    found = replay.base()
    work = np.where(found.critical, replay.work_ns, 0)
    for intervention in interventions(load, replay):
        if intervention.kind in ("task", "skill", "robot"):
            fall = found.makespan_ns - replay.makespans_ns(intervention, 1.0)
            assert np.all(fall >= 0)
            assert np.all(fall <= work[intervention.rows].sum(axis=0))


def test_what_was_shortened_is_whole_again() -> None:
    load = toy_workload(2, disturbances=BUSY)
    replay = Replay(load, NUMBERS)
    before = replay.times.busy_ns.copy()
    for intervention in interventions(load, replay):
        replay.makespans_ns(intervention, 0.2)
    assert np.array_equal(replay.times.busy_ns, before)
    assert np.all(replay.work_ns >= 0)
    number = int(replay.numbers[0])
    run = Simulator(load.tpg, load.execution).run(seed=load.seed, replication=number)
    work = sum(int(row.sum()) for row in run.duration_ns)
    assert replay.work_ns[:, 0].sum() == work
