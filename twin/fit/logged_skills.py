"""Durations of skills in the event log of a run."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

from planning.errors import RequestError
from planning.tasks.task import STRAIGHT, TRANSIT
from scheduling.graph.temporal_plan_graph import TemporalPlanGraph
from twin.durations.model import NANOSECONDS
from twin.run.activities import RobotProgress
from twin.run.events import Event, EventLogError, parse_event, read_log
from twin.run.folder import EVENTS, require_as_written
from twin.trial.plan_result import plan_of_run


class LoggedSkill(NamedTuple):
    """A skill that was done: which, by whom, to a type of objects ("" for none), for how long."""

    skill: str
    robot: str
    object: str
    seconds: float


def is_log(path: Path) -> bool:
    """Tell whether a path is that of a run's folder or event log."""
    return path.is_dir() or path.suffix == ".jsonl"


def logged_skills(path: Path) -> list[LoggedSkill]:
    """Return the skills of a run, as ``skills_in_log`` does.

    Args:
        path: the log, or the folder of the run; the plan is beside the log.

    Raises:
        OutputError: log or plan cannot be read.
        EventLogError, RequestError: as by skills_in_log.
    """
    log = path / EVENTS if path.is_dir() else path
    if log.name == EVENTS:
        require_as_written(log.parent, (EVENTS,))
    return skills_in_log(log, plan_of_run(log.parent))


def skills_in_log(log: Path, tpg: TemporalPlanGraph) -> list[LoggedSkill]:
    """Return the skills that were done in a run, in the order in which they were completed.

    A skill took from the start of each of its nodes to its completion, without the time for
    which its robot stood still meanwhile (stalls, breakdowns, stops) and without attempts that
    failed. So what is fitted and then drawn again is not counted twice.

    Args:
        log: events of the run.
        tpg: its plan.

    Raises:
        OutputError: the log cannot be read.
        EventLogError: a line of the log is no event; the message names it.
        RequestError: the log is not of that plan.
    """
    kinds = {item.name: item.kind for item in tpg.cell.objects}
    left: dict[int, int] = defaultdict(int)
    for chain in tpg.chains:
        for task in chain.task[chain.skill].tolist():
            left[task] += 1
    total_ns: dict[int, int] = defaultdict(int)
    found = []
    for task, busy_ns in _busy_nodes(log, tpg):
        if left.get(task, 0) == 0:
            continue
        total_ns[task] += busy_ns
        left[task] -= 1
        about = tpg.tasks[task]
        if left[task] == 0 and about.kind not in (TRANSIT, STRAIGHT):
            kind = "" if about.object is None else kinds.get(about.object, "")
            seconds = total_ns[task] / NANOSECONDS
            found.append(LoggedSkill(about.kind, about.robot, kind, seconds))
    return found


def _busy_nodes(log: Path, tpg: TemporalPlanGraph) -> Iterator[tuple[int, int]]:
    """Yield the task of each skill node that was completed, and how long it took [ns]."""
    chains = {chain.robot: chain for chain in tpg.chains}
    robots = {name: RobotProgress(name, len(chain)) for name, chain in chains.items()}
    for number, line in enumerate(read_log(log), start=1):
        event = _event(log, number, line)
        robot, node = event.robot, event.node
        nothing = robot not in chains or event.kind in ("started", "completed")
        if node < 0 and nothing:
            continue
        if robot not in chains or node >= len(chains[robot]):
            raise RequestError(f"{log}:{number}: the plan beside it has no such node")
        now, chain = robots[robot], chains[robot]
        done = event.kind == "completed" and now.under_way == node
        now.take(event)
        if done and chain.skill[node]:
            yield int(chain.task[node]), int(now.took_ns[node])


def _event(log: Path, number: int, line: str) -> Event:
    try:
        return parse_event(line)
    except EventLogError as error:
        raise EventLogError(f"{log}:{number}: {error.message}") from error
