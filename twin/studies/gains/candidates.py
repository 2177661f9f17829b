"""Candidate interventions on a plan: those with the most time on critical paths, chosen before any is tried."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from planning.tasks.task import Task, TaskKind
from scheduling.graph.temporal_plan_graph import MOTION_CONFLICT, TASK_DEPENDENCY
from twin.bulk.max_plus import Completions
from twin.durations.nanoseconds import Nanoseconds
from twin.engine.execution_model import ExecutionModel
from twin.studies.gains.replays import Intervention, Replay
from twin.uncertainty.chain_draws import Cause

WAIT_NAMES = {
    MOTION_CONFLICT: "all waits for the way to be free",
    TASK_DEPENDENCY: "all waits for another robot's task",
}
_STANDS: dict[Cause, str] = {
    "stall": "stalls",
    "breakdown": "breakdowns",
    "retry": "failed attempts",
}
_EVERYONE = "all robots"
_SKILL_NAMES = {
    TaskKind.TRANSIT: "every motion",
    TaskKind.STRAIGHT: "every straight way",
}

Scored = Iterator[tuple[float, Intervention]]


class CandidateLimits(NamedTuple):
    """Limits of the number of candidates of each kind.

    Attributes:
        tasks, skills, waits: number of candidates of each.
        robots: number of robots whose whole work, or whose standstills of one cause, are candidates.
    """

    tasks: int
    skills: int
    waits: int
    robots: int

    @property
    def most_interventions(self) -> int:
        """Maximum number of candidates of all kinds."""
        groups = self.robots + self.skills + 3 * (self.robots + 1)
        return self.tasks + self.waits + groups + 5


def candidates(
    replay: Replay,
    found: Completions,
    model: ExecutionModel,
    most: CandidateLimits,
) -> list[Intervention]:
    """Return the candidate interventions, by kind.

    The mean time of an intervention on the critical path over the replications is an upper bound of its
    reduction of the mean makespan; candidates are chosen by that time.
    """
    work = np.where(found.critical, replay.work_ns, 0).mean(axis=1)
    interventions = _best(_tasks(replay, work), most.tasks)
    interventions += _best(_robots(replay, work), most.robots)
    interventions += _best(_skills(replay, work), most.skills)
    if replay.eases_waits:
        interventions += _best(_waits(replay, found), most.waits)
        for cause, name in WAIT_NAMES.items():
            edges = np.flatnonzero(replay.graph.cause == cause)
            if found.critical_edge[edges].any():
                interventions.append(Intervention("wait", name, edges=edges))
    for stand in _STANDS:
        stands = list(_standstills(replay, found, stand))
        # With a single robot its standstills are the same as those of all robots.
        interventions += _best(iter(stands[:1]), 1)
        interventions += _best(iter(stands[1:]), most.robots) if len(stands) > 2 else []
    interventions += _others(model)
    return interventions


def task_names(tasks: Sequence[Task]) -> list[str]:
    """Return names of tasks, numbered where ambiguous."""
    names = [f"{task.label} ({task.robot}, step {task.step})" for task in tasks]
    times = Counter(names)
    return [
        name if times[name] == 1 else f"{name[:-1]}, task {index})"
        for index, name in enumerate(names)
    ]


def _best(scored: Scored, most: int) -> list[Intervention]:
    """Return the interventions with the longest critical time, without those that never were critical."""
    ordered = sorted(
        (
            (score, k, intervention)
            for k, (score, intervention) in enumerate(scored)
            if score > 0
        ),
        key=lambda entry: (-entry[0], entry[1]),
    )
    return [intervention for _, _, intervention in ordered[:most]]


def _tasks(replay: Replay, work: Nanoseconds) -> Scored:
    task = np.concatenate([chain.task for chain in replay.tpg.chains])
    names = task_names(replay.tpg.tasks)
    for index in np.unique(task).tolist():
        rows = np.flatnonzero(task == index)
        robot = replay.tpg.tasks[index].robot
        intervention = Intervention("task", names[index], robot, index, rows)
        yield float(work[rows].sum()), intervention


def _skills(replay: Replay, work: Nanoseconds) -> Scored:
    task = np.concatenate([chain.task for chain in replay.tpg.chains])
    kind = np.array([item.kind for item in replay.tpg.tasks])[task]
    names = dict.fromkeys(
        item.kind for item in replay.tpg.tasks if item.kind != TaskKind.TRANSIT
    )
    for skill in (*names, TaskKind.TRANSIT):
        rows = np.flatnonzero(kind == skill)
        name = _SKILL_NAMES.get(skill, f"every {skill}")
        yield float(work[rows].sum()), Intervention("skill", name, rows=rows)


def _robots(replay: Replay, work: Nanoseconds) -> Scored:
    for robot, rows in _rows_of_robots(replay):
        name = f"all tasks of {robot}"
        yield float(work[rows].sum()), Intervention("robot", name, robot, rows=rows)


def _waits(replay: Replay, found: Completions) -> Scored:
    """Yield avoidable waits of one task for another."""
    graph = replay.graph
    tasks = np.concatenate([chain.task for chain in replay.tpg.chains])
    target = np.repeat(np.arange(len(tasks)), np.diff(graph.edge_first))
    since = np.where(
        (target > graph.first[graph.chain[target]])[:, None],
        found.end_ns[target - 1],
        0,
    )
    waited = np.maximum(found.end_ns[graph.source] - since, 0)
    critical = np.where(found.critical_edge, waited, 0).mean(axis=1)
    pairs: dict[tuple[int, int], list[int]] = {}
    for edge in np.flatnonzero(np.isin(graph.cause, list(WAIT_NAMES))).tolist():
        pair = int(tasks[graph.source[edge]]), int(tasks[target[edge]])
        pairs.setdefault(pair, []).append(edge)
    names = task_names(replay.tpg.tasks)
    for (first, then), edges in sorted(pairs.items()):
        name = f"{names[then]} waits for {names[first]}"
        robot = replay.tpg.tasks[then].robot
        own = np.array(edges, dtype=np.int64)
        yield (
            float(critical[own].sum()),
            Intervention("wait", name, robot, then, edges=own),
        )


def _standstills(replay: Replay, found: Completions, cause: Cause) -> Scored:
    """Yield the standstills of a cause of all robots, then of each."""
    stood_ns = replay.times.stood_ns(cause)
    stood = np.where(found.critical, stood_ns, 0).mean(axis=1)
    every = ("", np.arange(len(stood)))
    for robot, rows in (every, *_rows_of_robots(replay)):
        name = f"{_STANDS[cause]} of {robot or _EVERYONE}"
        intervention = Intervention("stall", name, robot, None, rows, (cause,))
        yield float(stood[rows].sum()), intervention


def _rows_of_robots(replay: Replay) -> Iterator[tuple[str, Nanoseconds]]:
    first = replay.graph.first.tolist()
    for k, chain in enumerate(replay.tpg.chains):
        yield chain.robot, np.arange(first[k], first[k + 1])


def _others(model: ExecutionModel) -> list[Intervention]:
    """Return interventions without nodes: stops and messages."""
    interventions = []
    own = model.disturbances
    if own.breakdowns is not None and own.breakdowns.clock == "run":
        interventions.append(
            Intervention("stall", "breakdowns by the clock", stops="breakdowns")
        )
    if own.emergency_stops:
        interventions.append(
            Intervention("stall", "emergency stops", stops="emergency stops")
        )
    if not model.messages.instant and model.policy != "open-loop":
        interventions.append(
            Intervention("message", "messages on their way", messages=True)
        )
    return interventions
