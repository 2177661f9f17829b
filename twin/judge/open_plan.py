"""Open plans: a JSON file format for plans of robot teams, independent of the planner.

A plan contains trajectories of all robots, the transfers of objects, and the order between motions. See "Open plan" in
docs/reference/formats.md.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator, Mapping
from contextlib import suppress
from functools import cached_property
from itertools import islice
from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field, ValidationError, model_validator

from planning.bounds import FASTEST, LONGEST_S
from planning.files import read_file
from planning.json_files import parse_json
from twin.document.section import Section, Several
from twin.document.validation import (
    FileProblem,
    InvalidScenarioError,
    Problems,
    key_label,
    schema_problems,
    unknown_name,
)
from twin.document.yaml_text import KeyPath, Mark, YamlDocument, read_yaml
from twin.scenario.sections.shapes import PoseSection

FORMAT: Literal["assembly-twin open plan"] = "assembly-twin open plan"
VERSION: Literal[1] = 1

Seconds = Annotated[float, Field(ge=0, le=LONGEST_S)]
_Joint = Annotated[float, Field(ge=-100, le=100)]
_Rate = Annotated[float, Field(ge=-FASTEST, le=FASTEST)]
_Name = Annotated[str, Field(min_length=1, max_length=200)]

VERBS = ("take", "put", "give", "appear", "leave")
"""Names of events of objects."""

_MOST_ERRORS, _MOST_PROBLEMS = 1000, 100
"""Largest numbers of schema errors and of other problems that are listed."""

_MOST_COMPARED = 1000
"""Most ids that an unknown one is compared with."""

_QUOTED = 400_000
"""File size in characters up to which problems get line numbers, by a second, slow reading."""


class OpenEvent(Section):
    """An object changes hands: exactly one of ``take``, ``put``, ``give``, ``appear`` and ``leave``.

    Attributes:
        t_s: when, within the motion [s].
        take: object that the robot has in its hand from then on, whoever had it.
        put: object that lies in the world from then on.
        give: object that another robot has from then on.
        to: that robot; with ``give`` only.
        appear: object that lies where the scenario has it from then on, as the next part of a feeder.
        leave: object that is out of the cell from then on.
        pose: of the object's frame from then on: in the flange frame of who holds it, or in the world.
            Without it the object stays where it is.
    """

    t_s: Seconds
    take: _Name | None = None
    put: _Name | None = None
    give: _Name | None = None
    to: _Name | None = None
    appear: _Name | None = None
    leave: _Name | None = None
    pose: PoseSection | None = None

    @model_validator(mode="after")
    def _one_verb(self) -> OpenEvent:
        given = [verb for verb in VERBS if getattr(self, verb) is not None]
        if len(given) != 1:
            said = " and ".join(given) or "nothing"
            raise ValueError(f"give exactly one of {', '.join(VERBS)}, not {said}")
        if (self.to is None) == (self.give is not None):
            raise ValueError("give and to belong together: the object, and who gets it")
        return self

    @property
    def verb(self) -> str:
        """The verb of the event."""
        return next(verb for verb in VERBS if getattr(self, verb) is not None)

    @property
    def object(self) -> str:
        """Name of the object."""
        return str(getattr(self, self.verb))


class OpenMotion(Section):
    """A piece of motion of a robot, or of the work of a machine.

    Attributes:
        id: unique in the file; others name it in ``after``.
        t_s: times of the rows, non-decreasing; a machine has two, when its work begins and ends [s].
        q: joint values of each row, in the order of ``joints``; robots only [rad or m].
        v: joint speeds of each row: the motion between two rows is then the cubic in time that has q and v of
            both; without it a straight line.
        a: joint accelerations of each row, with ``v`` only.
        task: work that it belongs to, with motions beside it that have the same; its own by default.
        skill: what kind of work that is, such as ``pick``; nothing for a plain move.
        object: that it is about.
        touches: objects and fixtures that the tool is meant to touch in it.
        events: what changes hands in it.
        after: ids of motions of others that must be over before it begins.
    """

    id: _Name
    t_s: Annotated[Several[Seconds], Field(fail_fast=True)]
    q: Annotated[tuple[Several[_Joint], ...], Field(fail_fast=True)] = ()
    v: Annotated[tuple[Several[_Rate], ...], Field(fail_fast=True)] | None = None
    a: Annotated[tuple[Several[_Rate], ...], Field(fail_fast=True)] | None = None
    task: _Name | None = None
    skill: _Name | None = None
    object: _Name | None = None
    touches: tuple[_Name, ...] = ()
    events: tuple[OpenEvent, ...] = ()
    after: tuple[_Name, ...] = ()


class OpenRobot(Section):
    """A robot of the scenario.

    Attributes:
        joints: their names, in the order in which motions give their values.
        motions: in order.
    """

    joints: Several[_Name]
    motions: Annotated[tuple[OpenMotion, ...], Field(fail_fast=True)] = ()


class OpenPlan(Section):
    """A plan.

    Attributes:
        format, version: always the same.
        scenario: its task: the name of a scenario that comes with the program, or the path of a file
            seen from this one.
        planner: who made it.
        planning_cpu_s: processor time that took [s].
        execution: ``waits``, where each motion begins as soon as the one before it and those in ``after`` are
            over, or ``clock``, where robots follow the times of the plan and nobody waits. By default
            ``waits`` where any motion has ``after``, or only one robot moves.
        robots: by name; those that are not named stand still.
        machines: work of what brings parts, works at them and takes them away, by name.
    """

    format: Literal["assembly-twin open plan"]
    version: Literal[1]
    scenario: _Name | None = None
    planner: str = ""
    planning_cpu_s: Seconds | None = None
    execution: Literal["waits", "clock"] | None = None
    robots: dict[_Name, OpenRobot]
    machines: dict[_Name, tuple[OpenMotion, ...]] = Field(default_factory=dict)

    @cached_property
    def motions(self) -> Mapping[str, tuple[OpenMotion, ...]]:
        """The motions of each robot and machine that has any."""
        own = {name: robot.motions for name, robot in self.robots.items()}
        return {name: some for name, some in {**own, **self.machines}.items() if some}

    @property
    def waits(self) -> bool:
        """Whether motions wait for each other, and not for times of the clock."""
        if self.execution is not None:
            return self.execution == "waits"
        every = [motion for some in self.motions.values() for motion in some]
        return len(self.motions) < 2 or any(motion.after for motion in every)

    def placed(self) -> Iterator[tuple[KeyPath, str, OpenMotion]]:
        """Yield every motion with its path in the file and the name of its robot or machine."""
        for name, robot in self.robots.items():
            for k, motion in enumerate(robot.motions):
                yield ("robots", name, "motions", k), name, motion
        for name, some in self.machines.items():
            for k, motion in enumerate(some):
                yield ("machines", name, k), name, motion


def read_open_plan(path: Path) -> OpenPlan:
    """Read an open plan, and check it as far as possible without its scenario.

    Raises:
        InvalidScenarioError: with all problems, each with its position in the file.
    """
    try:
        text = read_file(path).decode("utf-8")
    except (OSError, UnicodeDecodeError) as error:
        problem = FileProblem(Mark(1, 1), f"cannot be read: {error}")
        raise InvalidScenarioError(path, [problem]) from error
    try:
        parse_json(text)
    except json.JSONDecodeError as error:
        problem = FileProblem(Mark(error.lineno, error.colno), f"no JSON: {error.msg}")
        lines = text.splitlines() if len(text) <= _QUOTED else []
        raise InvalidScenarioError(path, [problem], lines) from error
    except ValueError as error:
        problem = FileProblem(Mark(1, 1), f"no JSON of this kind: {error}")
        raise InvalidScenarioError(path, [problem]) from error
    try:
        plan = OpenPlan.model_validate_json(text)
    except ValidationError as error:
        if error.error_count() > _MOST_ERRORS:
            words = f"{error.error_count()} values are not those of an open plan"
            raise InvalidScenarioError(path, [FileProblem(Mark(1, 1), words)]) from None
        errors = error.errors(include_url=False)
        document = _document(path, text, [one["loc"] for one in errors])
        schema = OpenPlan.model_json_schema()
        found = schema_problems(document, schema, errors)
        raise InvalidScenarioError(path, found, document.lines) from None
    require_no_faults(path, _problems(plan))
    return plan


def require_no_faults(path: Path, problems: Problems) -> None:
    """Refuse a file with faults.

    Raises:
        InvalidScenarioError: with the first problems.
    """
    found = list(islice(problems, _MOST_PROBLEMS))
    if found:
        text = read_file(path).decode("utf-8")
        document = _document(path, text, [at for at, _ in found])
        said = [document.problem(at, key_label(at) + words) for at, words in found]
        raise InvalidScenarioError(path, said, document.lines)


def _document(path: Path, text: str, places: Iterable[KeyPath]) -> YamlDocument:
    """Return the file with the positions of values; of a large file only the given places, without lines."""
    if len(text) <= _QUOTED:  # JSON is YAML, too
        document = read_yaml(path, text)
        if document.data is not None and not document.problems:
            return document
    data = parse_json(text)
    values: dict[KeyPath, Mark] = {(): Mark(1, 1)}
    for place in places:
        value = data
        with suppress(LookupError, TypeError):
            for k, key in enumerate(place, start=1):
                value = value[key]
                values[place[:k]] = Mark(1, 1)
    return YamlDocument(path, (), data, values=values)


def _problems(plan: OpenPlan) -> Problems:
    """Yield inconsistencies of the plan: lengths of rows, times, and ids."""
    for name in plan.machines.keys() & plan.robots.keys():
        yield ("machines", name, "[key]"), "is the name of a robot, too"
    ids: dict[str, str] = {}
    for at, name, motion in plan.placed():
        if motion.id in ids:
            yield (*at, "id"), f"{motion.id!r} is the id of another motion, too"
        ids[motion.id] = name
    last: dict[str, float] = {}
    before: dict[str, OpenMotion] = {}
    closed: set[tuple[str, str]] = set()
    for at, name, motion in plan.placed():
        yield from _motion_problems(plan, at, motion)
        if motion.t_s[0] < last.get(name, 0.0):
            words = (
                f"begins at {motion.t_s[0]:g} s, before the motion before it is over"
            )
            yield (*at, "t_s", 0), f"{words} at {last[name]:g} s"
        last[name] = motion.t_s[-1]
        for k, other in enumerate(motion.after):
            if other not in ids:
                yield (
                    (*at, "after", k),
                    unknown_name("motion", other, _similar_ids(other, ids)),
                )
            elif ids[other] == name and other == motion.id:
                yield (*at, "after", k), f"{other!r} waits for itself"
        earlier = before.get(name)
        if motion.task is not None and (earlier is None or earlier.task != motion.task):
            if (name, motion.task) in closed:
                words = "motions of one task are to follow one another"
                yield (*at, "task"), f"{motion.task!r} was over before: {words}"
            closed.add((name, motion.task))
        elif motion.task is not None and earlier is not None:
            same = (earlier.skill, earlier.object) == (motion.skill, motion.object)
            if not same:
                words = "has another skill or object than the motion before it"
                yield (*at, "task"), f"of task {motion.task!r}, {words}"
        before[name] = motion


def _motion_problems(plan: OpenPlan, at: KeyPath, motion: OpenMotion) -> Problems:
    """Yield inconsistencies within a motion."""
    times, rows = motion.t_s, len(motion.t_s)
    for k in range(1, rows):
        if times[k] < times[k - 1]:
            yield (*at, "t_s", k), f"{times[k]:g} s comes before {times[k - 1]:g} s"
    for k, event in enumerate(motion.events):
        if not times[0] <= event.t_s <= times[-1]:
            span = f"from {times[0]:g} s to {times[-1]:g} s"
            words = f"{event.t_s:g} s is not within its motion, {span}"
            yield (*at, "events", k, "t_s"), words
    if at[0] == "machines":
        if motion.q or motion.v or motion.a or motion.touches:
            yield at, "a machine has no q, v, a and touches"
        return
    dof = len(plan.robots[str(at[1])].joints)
    if motion.a is not None and motion.v is None:
        yield (*at, "a"), "accelerations without speeds: give v, too"
    for name in ("q", "v", "a"):
        values = getattr(motion, name)
        if values is None:
            continue
        if len(values) != rows:
            yield (*at, name), f"has {len(values)} rows, and t_s has {rows}"
        for k, row in enumerate(values):
            if len(row) != dof:
                words = f"has {len(row)} values, and the robot has {dof} joints"
                yield (*at, name, k), words


def _similar_ids(name: str, known: Mapping[str, str]) -> list[str]:
    """Return the known ids most similar to a name."""
    import difflib

    some = list(islice(known, _MOST_COMPARED))
    return difflib.get_close_matches(name, some, n=5, cutoff=0.0)
