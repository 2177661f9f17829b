"""Entries of the open benchmark: what plans a task, and hands its plan in as anybody would."""

import json
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from itertools import groupby
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.open.free_space import FreeSpace
from benchmarks.open.planners import (
    PathFinder,
    installed,
    klampt_path,
    ompl_path,
    path_found,
)
from planning.errors import TwinError
from twin.audits.motion.executed import ReplayedRun
from twin.exports.open_plan import open_plan_of
from twin.judge.delays import nominal_spans
from twin.judge.judge import JudgedPlan
from twin.judge.open_plan import OpenPlan
from twin.judge.open_plan_execution import planned_spans
from twin.planning.build_workcell import build_workcell
from twin.planning.pipeline import default_shortcuts, motion_settings
from twin.runs import policies
from twin.scenario.sections.kind import assembly_kind
from twin.studies.plans import require_no_machines
from twin.trial.loaded_scenario import LoadedScenario
from twin.trial.planning import plan_scenario

Document = dict[str, Any]


class CannotEnterError(TwinError):
    """A planner cannot do a task, and says why."""


@dataclass(frozen=True)
class Entry:
    """A planner.

    Attributes:
        name: in tables; the file of its plan is named after it.
        make: returns its plan of a task.
        needs: Python package that it is of; None for what comes with this program.
    """

    name: str
    make: Callable[[LoadedScenario], Document]
    needs: str | None = None

    @property
    def possible(self) -> bool:
        """Whether its package is installed."""
        return self.needs is None or installed(self.needs)


def own_plan(task: LoadedScenario, policy: str) -> Document:
    """Return the plan of this program for one of its policies.

    Raises:
        CannotEnterError: the task is not planned for this policy.
    """
    scenario, named = task.sections, policies.NAMED_POLICIES[policy]
    if assembly_kind(scenario.assembly).space_time and named.plan != policies.IN_TURNS:
        raise CannotEnterError(
            "planned in space and time at once, there is no such plan"
        )
    begun = time.process_time()
    budget = default_shortcuts(scenario)
    try:
        if named.plan in (policies.IN_SLOTS, policies.SLOTS_SHORTENED):
            require_no_machines(scenario)
        planned = plan_scenario(task, wanted=(named.plan,), candidates=budget)
    except TwinError as error:
        raise CannotEnterError(str(error)) from error
    spent = time.process_time() - begun
    document = open_plan_of(planned, named.release)
    document["planner"] = f"assembly-twin, {policy}"
    document["planning_cpu_s"] = round(spent, 2)
    return document


def by_the_clock(task: LoadedScenario, margin: float) -> Document:
    """Return the asynchronous plan with a margin on all times, in which nobody waits for anybody."""
    document = own_plan(task, policies.ASYNCHRONOUS)
    document["planner"] = f"assembly-twin, fixed clock with {100 * margin:.0f} % margin"
    document["execution"] = "clock"
    slower = 1.0 + margin
    for motion in _motions(document):
        motion.pop("after", None)
        motion["t_s"] = [t * slower for t in motion["t_s"]]
        for event in motion.get("events", ()):
            event["t_s"] *= slower
        for name, by in (("v", slower), ("a", slower**2)):
            if name in motion:
                motion[name] = [[x / by for x in row] for row in motion[name]]
    return document


def one_at_a_time(task: LoadedScenario, finder: PathFinder, planner: str) -> Document:
    """Return a plan in turns whose moves a planner of others has found.

    Who does what in which order, and the paths of skills, are given, as in APEX-MR; all moves
    between them are planned anew, one robot at a time while the others stand.

    Args:
        task: what is planned.
        finder: finds paths.
        planner: its name.

    Raises:
        CannotEnterError: robots keep to limits of acceleration, for which it has no times, or a
            move for which it finds no path.
    """
    if (
        task.sections.speed_model == "limits"
        or assembly_kind(task.sections.assembly).space_time
    ):
        raise CannotEnterError(
            "paths are timed by joint speeds, and robots move in turns"
        )
    document = own_plan(task, policies.SEQUENTIAL)
    plan = OpenPlan.model_validate_json(json.dumps(document))
    case = JudgedPlan(plan, Path(f"{task.name}.json"), task)
    cell = case.world.cell
    run = ReplayedRun(cell, case.executed(planned_spans(plan)).recording)
    speeds = motion_settings(
        task.sections, build_workcell(task.sections, task.folder), task.folder
    ).speeds
    space = FreeSpace(cell)
    spent = 0.0
    moves = sorted(_moves(document), key=lambda own: own[2][0]["t_s"][0])
    for number, (robot, listed, group) in enumerate(moves):
        rows = np.array([row for motion in group for row in motion["q"]])
        begin = group[0]["t_s"][0]
        stands = {
            name: own.at(np.array([begin]))[0] for name, own in run.robots.items()
        }
        places = {
            name: (stay.holder, stay.pose) for name, stay in run.at(begin).items()
        }
        model = cell.robot(robot).model
        clock = time.process_time()
        ends = rows[0], rows[-1]
        space.begin(robot, stands, places, ends)
        bounds = model.lower, model.upper
        path = path_found(finder, space, *ends, bounds, number)
        spent += time.process_time() - clock
        if path is None:
            raise CannotEnterError(f"no path for {group[0].get('task')!r}")
        _replace(listed, group, path, speeds[robot].times_along(path))
    document["planner"] = planner
    document["planning_cpu_s"] = round(spent, 2)
    return _as_soon_as_may_be(document)


def _moves(document: Document) -> Iterator[tuple[str, list[Any], list[Any]]]:
    """Yield the plain moves of robots: whose, all of its motions, and those that are one move."""
    for name, robot in document["robots"].items():
        motions = robot["motions"]
        for _, own in groupby(list(motions), lambda m: m.get("task", m["id"])):
            group = list(own)
            if not any("skill" in m or "events" in m for m in group):
                yield name, motions, group


def _replace(listed: list[Any], group: list[Any], path: Any, times: Any) -> None:
    """Put a path in the place of a move; what waited for any of it waits for the whole."""
    last = group[-1]
    at = listed.index(group[0])
    after = [other for motion in group for other in motion.get("after", ())]
    whole = {
        "id": last["id"],
        "t_s": (group[0]["t_s"][0] + np.asarray(times)).tolist(),
        "q": np.asarray(path).tolist(),
        "after": after,
        "task": last.get("task", last["id"]),
        "replaces": [motion["id"] for motion in group],
    }
    listed[at : at + len(group)] = [whole]


def _as_soon_as_may_be(document: Document) -> Document:
    """Return a plan with the times at which each motion may begin."""
    whole = {
        old: motion["id"]
        for motion in _motions(document)
        for old in motion.pop("replaces", ())
    }
    for motion in _motions(document):
        after = dict.fromkeys(whole.get(o, o) for o in motion.get("after", ()))
        motion["after"] = [other for other in after if other != motion["id"]]
    for some in _lists(document):
        end = 0.0
        for motion in some:  # in order at least, for the reader
            _shift(motion, max(end, motion["t_s"][0]))
            end = motion["t_s"][-1]
    spans = nominal_spans(OpenPlan.model_validate_json(json.dumps(document)))
    for motion in _motions(document):
        _shift(motion, spans[motion["id"]].begin)
    return document


def _shift(motion: Document, begin: float) -> None:
    by = begin - motion["t_s"][0]
    motion["t_s"] = [t + by for t in motion["t_s"]]
    for event in motion.get("events", ()):
        t = event["t_s"] + by
        event["t_s"] = min(max(t, motion["t_s"][0]), motion["t_s"][-1])


def _lists(document: Document) -> Iterator[list[Any]]:
    yield from (robot["motions"] for robot in document["robots"].values())
    yield from document.get("machines", {}).values()


def _motions(document: Document) -> Iterator[Document]:
    for some in _lists(document):
        yield from some


OMPL, KLAMPT = "OMPL RRT-Connect, in turns", "Klampt SBL, in turns"

ENTRIES: tuple[Entry, ...] = (
    *(
        Entry(name, partial(own_plan, policy=name))
        for name in (
            policies.SEQUENTIAL,
            policies.SYNCHRONOUS,
            policies.SYNCHRONOUS_TPG,
            policies.ASYNCHRONOUS,
            policies.ASYNCHRONOUS_SHORTCUTS,
        )
    ),
    Entry("fixed clock", partial(by_the_clock, margin=0.0)),
    Entry("fixed clock, 25 % margin", partial(by_the_clock, margin=0.25)),
    Entry(OMPL, partial(one_at_a_time, finder=ompl_path, planner=OMPL), "ompl"),
    Entry(KLAMPT, partial(one_at_a_time, finder=klampt_path, planner=KLAMPT), "klampt"),
)
"""Those that are planned here; plans of others are files beside theirs."""
