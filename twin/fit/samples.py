"""Samples of measured durations from tables or event logs, grouped by skill, robot or type of object."""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np

from planning.errors import RequestError, ScenarioError
from planning.tasks.task import TaskKind
from planning.transforms import Array, read_only_copy
from scheduling.graph.temporal_plan_graph import TemporalPlanGraph
from twin.activities.progress import RobotProgress
from twin.checks.usual_range import usual_duration
from twin.document.section import NAME
from twin.durations.nanoseconds import NANOSECONDS
from twin.durations.timing_files import (
    UNITS,
    Columns,
    column_unit,
    csv_rows,
    read_durations,
    split_unit,
)
from twin.runs.events import Event, EventLogError, read_log
from twin.runs.folder import EVENTS, require_recorded_hashes
from twin.trial.plan_result import plan_of_run

LABELS = ("skill", "robot", "object")
"""Columns that define groups."""

FEWEST = 10
"""Least number of durations in a sample, enough to tell distributions apart."""

DURATION = "duration_s"
"""Default column of durations."""

_STAMPS = (
    ("start", "end"),
    ("start_s", "end_s"),
    ("start_time", "end_time"),
    ("started", "completed"),
)
"""Pairs of columns with begin and end times that are read if there is no column of durations."""

_Rows = Iterator[tuple[tuple[str, ...], float]]


class LoggedSkill(NamedTuple):
    """An executed skill: name, robot, type of object ("" for none), duration."""

    skill: str
    robot: str
    object: str
    seconds: float


def is_log(path: Path) -> bool:
    """Return whether a path is that of a run's folder or event log."""
    return path.is_dir() or path.suffix == ".jsonl"


def logged_skills(path: Path) -> list[LoggedSkill]:
    """Return the skills of a run, as ``skills_in_log`` does.

    Args:
        path: the log, or the folder of the run; the plan is next to the log.

    Raises:
        OutputError: log or plan cannot be read.
        EventLogError, RequestError: as by skills_in_log.
    """
    log = path / EVENTS if path.is_dir() else path
    if log.name == EVENTS:
        require_recorded_hashes(log.parent, (EVENTS,))
    return skills_in_log(log, plan_of_run(log.parent))


def skills_in_log(log: Path, tpg: TemporalPlanGraph) -> list[LoggedSkill]:
    """Return the executed skills of a run in the order of completion.

    The duration of a skill is the sum over its nodes from start to completion, without standstills of its robot
    (stalls, breakdowns, stops) and without failed attempts. These are drawn separately, so they are not counted
    twice.

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
        if left[task] == 0 and about.kind not in (TaskKind.TRANSIT, TaskKind.STRAIGHT):
            kind = "" if about.object is None else kinds.get(about.object, "")
            seconds = total_ns[task] / NANOSECONDS
            found.append(LoggedSkill(about.kind, about.robot, kind, seconds))
    return found


def _busy_nodes(log: Path, tpg: TemporalPlanGraph) -> Iterator[tuple[int, int]]:
    """Yield task and duration of each completed skill node [ns]."""
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
        return Event.parse(line)
    except EventLogError as error:
        raise error.with_message(f"{log}:{number}: {error.message}") from error


@dataclass(frozen=True)
class FitSample:
    """A sample of measured durations.

    Attributes:
        labels: skill, robot and object, as far as known.
        values_s: the durations in the order of the files, shape (n,) [s].
    """

    labels: Mapping[str, str]
    values_s: Array

    @property
    def name(self) -> str:
        """Name of the group, valid as a file name."""
        text = "-".join(self.labels.values()) or "durations"
        return "".join(c if c.isalnum() or c in "._-" else "_" for c in text)


def read_samples(
    paths: Sequence[Path],
    *,
    columns: Columns | None = None,
    by: Sequence[str] = (),
    skill: str | None = None,
    unit: str | None = None,
) -> tuple[tuple[FitSample, ...], dict[str, int]]:
    """Read measured durations, group by group.

    Args:
        paths: CSV files with a header line, or event logs of runs: all of one kind.
        columns: column of durations in CSV files, or the two columns of begin and end times; by default
            ``duration_s``, the same with another unit, or two columns with usual names of such times.
        by: columns whose values make the groups, names from LABELS; in logs always by skill.
        skill: skill of all rows if no column gives it; by default the name of the file if that is a skill.
        unit: unit of columns in CSV files without a unit in their names.

    Returns:
        The samples in the order in which the groups first occur; and, for event logs, the groups with too few
        durations, with their numbers.

    Raises:
        ScenarioError: as by read_durations; or an unknown group column, an unknown skill, a
            group for a robot or an object without a skill, or a group of too few durations.
        TwinError: as by logged_skills.
    """
    for name in by:
        if name not in LABELS:
            raise ScenarioError(f"cannot group by {name!r}", choices=LABELS)
    if skill is not None and not _is_skill(skill):
        raise ScenarioError(
            f"{skill!r} cannot be the name of a skill", choices=TaskKind.SKILLS
        )
    logs = [is_log(path) for path in paths]
    if any(logs) and not all(logs):
        raise ScenarioError("give CSV files or event logs, not both at once")
    if any(logs) and unit is not None:
        raise ScenarioError("event logs have one unit: --unit is for CSV files")
    keys = tuple(dict.fromkeys(("skill", *by) if any(logs) else by))
    if not any(logs):
        skill = skill or _skill_of_names(paths)
    if keys and "skill" not in keys and skill is None:
        raise ScenarioError(
            f"{paths[0]}: of which skill are these? Say --skill, or --by skill",
            choices=TaskKind.SKILLS,
        )
    groups: dict[tuple[str, ...], list[float]] = {}
    for path in paths:
        for labels, value in (
            _logged(path, keys, skill)
            if any(logs)
            else read_durations(path, columns or _columns_of(path), keys, unit)
        ):
            groups.setdefault(labels, []).append(value)
    left_out = {}
    if any(logs):
        few = {k: len(values) for k, values in groups.items() if len(values) < FEWEST}
        if len(few) < len(groups):
            left_out = {", ".join(filter(None, k)): count for k, count in few.items()}
            groups = {k: values for k, values in groups.items() if k not in few}
        if not groups:
            raise ScenarioError(f"{paths[0]}: no skill was completed")
    samples = tuple(
        _sample(paths[0], dict(zip(keys, labels, strict=True)), skill, values)
        for labels, values in groups.items()
    )
    return samples, left_out


def _is_skill(name: str) -> bool:
    """Return whether a name is that of a packaged skill, or may be a process of a scenario."""
    return re.fullmatch(NAME, name) is not None and name not in (
        TaskKind.TRANSIT,
        TaskKind.STRAIGHT,
    )


def _skill_of_names(paths: Sequence[Path]) -> str | None:
    """Return the skill that all files are named after, None without one."""
    names = {path.stem for path in paths}
    return names.pop() if len(names) == 1 and names <= set(TaskKind.SKILLS) else None


def _columns_of(path: Path) -> Columns:
    """Return the columns that are read by default."""
    names = csv_rows(path).fieldnames or ()
    durations = [name for name in names if split_unit(name)[0] == "duration"]
    stamps = [pair for pair in _STAMPS if set(pair) <= set(names)]
    if DURATION in names or not (durations or stamps):
        return DURATION
    return durations[0] if durations else stamps[0]


def unit_notes(
    paths: Sequence[Path],
    samples: Sequence[FitSample],
    columns: Columns | None,
    unit: str | None,
) -> Iterator[str]:
    """Yield notes on the units of CSV files, and on implausible durations.

    Args:
        paths: paths of the files; logs have no notes.
        samples: read from them.
        columns, unit: as for read_samples.
    """
    choices = f"--unit says which ({', '.join(UNITS)})"
    for path in (path for path in paths if not is_log(path)):
        wanted, reader = columns or _columns_of(path), csv_rows(path)
        known = column_unit(path, wanted, reader.fieldnames or (), unit)
        first = wanted if isinstance(wanted, str) else wanted[0]
        if known is None and ":" not in (next(reader)[first] or ""):
            yield f"{path}: {first!r} has no unit in its name and is read in s: {choices}"
        elif known not in (None, "s"):
            yield f"{path}: {first!r} is read in {known}"
    for sample in samples:
        usual = usual_duration([v for k, v in sample.labels.items() if k == "skill"])
        if words := usual.words(float(np.median(sample.values_s))):
            yield f"warning: {sample.name}: the median, {words}: is the unit right? {choices}"


def _logged(path: Path, keys: Sequence[str], skill: str | None) -> _Rows:
    for entry in logged_skills(path):
        labels = {"skill": entry.skill, "robot": entry.robot, "object": entry.object}
        # A skill without an object, such as a support, has no label to group by object.
        known = all(labels[key] for key in keys)
        if known and skill in (None, entry.skill):
            yield tuple(labels[key] for key in keys), entry.seconds


def _sample(
    path: Path, labels: dict[str, str], skill: str | None, values: list[float]
) -> FitSample:
    if "skill" not in labels and skill is not None:
        labels = {"skill": skill, **labels}
    where = (
        f"{path}: {', '.join(f'{k} {v!r}' for k, v in labels.items()) or 'the file'}"
    )
    if "skill" in labels and not _is_skill(labels["skill"]):
        raise ScenarioError(f"{where} is no skill", choices=TaskKind.SKILLS)
    for name, label in labels.items():
        if not label:
            raise ScenarioError(f"{path}: a row has no {name}")
    if len(values) < FEWEST:
        raise ScenarioError(
            f"{where} has {len(values)} durations; at least {FEWEST} are needed to tell"
            " distributions apart"
        )
    ordered = {name: labels[name] for name in LABELS if name in labels}
    return FitSample(ordered, read_only_copy(values))


def unused_labels(
    paths: Sequence[Path], by: Sequence[str]
) -> dict[str, tuple[str, ...]]:
    """Return the values of columns by which samples could be grouped but are not."""
    rows = [row for path in paths for row in csv_rows(path)]
    out = {}
    for name in LABELS:
        values = tuple(dict.fromkeys(row.get(name) or "" for row in rows))
        if name not in by and len(values) > 1:
            out[name] = values
    return out
