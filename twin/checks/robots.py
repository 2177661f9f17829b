"""Checks of robots: collisions at the home configuration, overlaps of bases, speeds, efforts and skill durations."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator
from dataclasses import replace
from itertools import product
from typing import get_args

import numpy as np

from planning.cell.workcell import CellObject, PlacedRobot, Workcell, WorldState
from planning.geometry.exact import hull_distance_at, resting_solid
from planning.geometry.robot_bodies import robot_bodies
from planning.geometry.scene_checker import SceneChecker
from planning.kinematics.kinematics import inverse_kinematics, joint_poses_of
from planning.timing.torque import (
    ArmDynamics,
    HandPayload,
    describe_weak_joint,
    explain_unchecked_efforts,
)
from planning.transforms import Array, from_rpy
from twin.checks.finding import (
    CheckContext,
    Finding,
    Findings,
    format_millimetres,
)
from twin.durations.measured import Packaged
from twin.durations.model import DurationModel, PackagedSkill
from twin.uncertainty.skill_durations import SkillDurations

_SUNK = 0.005
"""Largest depth of a base in its support [m]."""

_ASIDE = 0.25
"""Distance from a place at which a waiting tool does not obstruct it [m]."""

_NOWHERE = np.zeros(0)

_HOME_KEYS = ("home_deg", "home_rad_or_m", "parked", "home", "base")


def check_homes(subject: CheckContext) -> Findings:
    """Yield robots in collision or beyond a joint limit at HOME."""
    cell = subject.cell
    state = cell.start_state()
    seen: set[frozenset[str]] = set()
    for robot in cell.robots:
        at = subject.robot_at(robot.name, *_HOME_KEYS)
        model = robot.model
        for k, name in enumerate(model.joint_names):
            if not model.lower[k] - 1e-6 <= robot.home[k] <= model.upper[k] + 1e-6:
                yield Finding(
                    at,
                    f"HOME of {robot.name}: joint {name} is at {robot.home[k]:.3f}, its limits are"
                    f" {model.lower[k]:.3f} and {model.upper[k]:.3f} (rad or m)",
                    # A revolute joint may be off by a turn; a mobile base may not.
                    error=bool(model.chain.prismatic[k]),
                )
        contact = SceneChecker(cell, robot.name, state).contact(robot.home)
        if contact is None:
            continue
        pair = frozenset((_owner(contact.first), _owner(contact.second)))
        if pair not in seen:
            yield Finding(
                at,
                f"{robot.name} cannot stand at HOME: {contact};"
                f" {_apart(subject, pair) or _remedy(subject, robot, state)}",
                error=True,
            )
        seen.add(pair)


def _apart(subject: CheckContext, owners: frozenset[str]) -> str | None:
    """Return a remedy for arms of one description with different bases; None for anything else."""
    files = {r.name: r.model for r in subject.scenario.cell.robots if r.name in owners}
    if len(files) < 2 or len(set(files.values())) > 1:
        return None
    one, other = (subject.built.robot(name) for name in files)
    if not set(one.model.joint_names).isdisjoint(other.model.joint_names):
        return None
    return f"{one.name} and {other.name} are arms of one description: give both the same base"


def _remedy(subject: CheckContext, robot: PlacedRobot, state: WorldState) -> str:
    """Return a remedy for a HOME in collision, with a free HOME if none is given."""
    if not _at_zero(robot, robot.model.dof):
        return "move its base or change its HOME"
    words = "its joints are at zero, as no HOME is given"
    goals = tuple(subject.checks.goals().values())
    first: list[int] | None = None
    for home, tool in _free_homes(subject.cell, robot, state):
        distances = [float(np.linalg.norm(tool[:2] - goal[:2, 3])) for goal in goals]
        if min(distances, default=np.inf) > _ASIDE:
            return f"{words}: home_deg: {home} would be free"
        first = first or home
    if first is None:
        return f"{words}: give home_deg or home_rad_or_m"
    return f"{words}: home_deg: {first} would be free, but in the way above places of parts"


def _at_zero(robot: PlacedRobot, dof: int) -> bool:
    """Return whether a robot has the default HOME of a description without one."""
    model = robot.model
    zero = np.clip(0.0, model.lower, model.upper)
    return model.dof == dof and bool(np.all(robot.home == zero))


def _free_homes(
    cell: Workcell, robot: PlacedRobot, state: WorldState
) -> Iterator[tuple[list[int], Array]]:
    """Yield collision-free HOMEs in whole degrees, tool down, with the tool's position.

    First in front of an arm, then on either side of it; elbow up first.
    """
    model = robot.model
    if np.any(model.chain.prismatic):
        return
    frame = "tool" if "tool" in model.frames else "flange"
    reach = float(np.linalg.norm(model.chain.placement[1:, :3, 3], axis=1).sum())
    for side, share, height, quarter in product(
        (0.0, 1.0, -1.0), (0.45, 0.35), (0.3, 0.45), range(4)
    ):
        turned = from_rpy((0.0, 0.0, 0.0), (0.0, 0.0, 0.5 * np.pi * side))
        place = from_rpy(
            (share * reach, 0.0, height * reach),
            (np.pi, 0.0, 0.5 * np.pi * quarter),
        )
        at = robot.base @ turned @ place
        found = inverse_kinematics(robot, frame, at, robot.home)
        for q in sorted(found, key=lambda q: -_height(robot, q)):
            degrees = np.rint(np.rad2deg(q))
            home = np.deg2rad(degrees)
            if np.any((home < model.lower) | (home > model.upper)):
                continue
            # Other robots without a HOME will stand alike.
            alike = {
                other.name: home for other in cell.robots if _at_zero(other, model.dof)
            }
            there = replace(state, configurations={**state.configurations, **alike})
            if SceneChecker(cell, robot.name, there).contact(home) is None:
                yield [int(value) for value in degrees], at[:3, 3]


def _height(robot: PlacedRobot, q: Array) -> float:
    """Return the mean height of an arm's joints [m]: elbow-up is preferred."""
    return float(np.mean([pose[2, 3] for pose in joint_poses_of(robot, q)]))


def check_bases(subject: CheckContext) -> Findings:
    """Yield bases deep inside a fixture of the file."""
    cell = subject.cell
    fixtures = [item for item in cell.fixtures if item.name in subject.own_fixtures]
    for robot in cell.robots:
        deepest: dict[str, float] = defaultdict(float)
        for solid in robot_bodies(robot).solids:
            if solid.joint >= 0:
                continue
            for item in fixtures:
                for piece in item.shape.pieces:
                    box = resting_solid(item.name, piece, item.pose)
                    gap = hull_distance_at(solid, robot.home, box, _NOWHERE)
                    deepest[item.name] = min(deepest[item.name], gap)
        # Some descriptions draw a base as balls that reach below the plane it stands on.
        lowest = [p.body.vertices[:, 2].min() for p in robot.model.parts if p.joint < 0]
        own = max(0.0, -min(lowest, default=0.0))
        for name, found in deepest.items():
            gap = min(0.0, found + own)
            if gap < -_SUNK:
                yield Finding(
                    subject.robot_at(robot.name, "base"),
                    f"the base of {robot.name} is {format_millimetres(-gap)} deep in {name}: right if it is"
                    " bolted into a cut-out, a mistake if it stands on it",
                )


def check_speeds(subject: CheckContext) -> Findings:
    """Yield a planning speed beyond the joint limits, which then set the times."""
    planning = subject.scenario.planning
    if subject.scenario.speed_model != "l1" or subject.kind.space_time:
        return
    speed = planning.l1_rad_s
    slow: dict[str, tuple[float, list[str]]] = {}
    for robot in subject.cell.robots:
        model = robot.model
        k = int(np.argmin(model.velocity))
        if speed > model.velocity[k] * (1.0 + 1e-9):
            limit = float(model.velocity[k])
            words = f"{model.name}: {limit:.3g} rad/s or m/s at {model.joint_names[k]}"
            slow.setdefault(words, (limit, []))[1].append(robot.name)
    if slow:
        least = min(limit for limit, _ in slow.values())
        listing = "; ".join(
            f"{words} ({', '.join(names)})" for words, (_, names) in slow.items()
        )
        yield Finding(
            ("planning", "speed_rad_s"),
            f"speed_rad_s {speed:g} is {speed / least:.2f} times what a joint can do ({listing}): where one"
            " joint has most of the way, its limit sets the time and not this speed, and the joint is at"
            " full speed throughout; use speed_model joint to plan by the limits, or at most"
            f" speed_rad_s {least:.3g}",
        )


def _owner(entity: str) -> str:
    return entity.partition(":")[0].partition("/")[0]


def check_efforts(subject: CheckContext) -> Findings:
    """Yield robots whose effort limits are implausibly low, or too low for their parts.

    Only for plans within limits, in which efforts count.
    """
    if subject.scenario.speed_model != "limits":
        return
    parts = subject.checks.placed()
    for robot in subject.cell.robots:
        drives, at = robot.model.drives, subject.robot_at(robot.name, "limits", "model")
        if weak := describe_weak_joint(robot):
            yield Finding(
                at,
                f"efforts of {robot.name} ({robot.model.name}) are not kept to: {weak}; give"
                " limits.effort, or a description with its masses",
            )
        if drives is None or explain_unchecked_efforts(robot) is not None:
            continue
        light = [part for part in parts if part.mass <= drives.spare]
        heaviest = max(light, key=lambda part: part.mass, default=None)
        if heaviest is not None and (words := _cannot_hold(robot, heaviest)):
            yield Finding(at, words)


def _cannot_hold(robot: PlacedRobot, part: CellObject) -> str | None:
    """Return a text on a joint that cannot hold a part at HOME; None if all can."""
    model, drives = robot.model, robot.model.drives
    assert drives is not None
    tool = model.frames.get("tool", np.eye(4))
    held = HandPayload(part.mass, part.shape, tool)
    weight = np.abs(ArmDynamics(robot, model, [held]).gravity(robot.home))
    over = weight > drives.effort
    if not over.any():
        return None
    k = int(np.argmax(over))
    unit = "N" if model.chain.prismatic[k] else "N m"
    return (
        f"{robot.name} cannot hold {part.name} ({part.mass:g} kg) at HOME: {model.joint_names[k]} would"
        f" have to exert {weight[k]:.3g} {unit}, and its effort is {drives.effort[k]:g} {unit}"
    )


def check_standing_times(subject: CheckContext) -> Findings:
    """Yield a warning if no task takes any time."""
    execution = subject.scenario.execution
    every: tuple[str, ...] = get_args(PackagedSkill)
    used = [*(subject.checks.skills or every)]
    used += subject.scenario.processes
    given = [execution.skills.get(name) for name in used]
    given += [item.duration for item in execution.skill_overrides if item.skill in used]
    models = [item for item in given if isinstance(item, DurationModel)]
    known = [item.located(subject.folder).mean for item in models]
    if subject.cell.objects and len(known) == len(given) and not any(known):
        yield Finding(
            ("execution", "skills"),
            f"all that is done takes 0 s ({', '.join(used)}): no fingers close and no tool turns in no time, so"
            " this is a bound of what can be, and no forecast; give execution.skills durations",
        )


def check_skill_times(subject: CheckContext) -> Findings:
    """Yield skills that use LEGO's packaged times in a scenario without LEGO."""
    execution = subject.scenario.execution
    models = {k: v for k, v in execution.skills.items() if isinstance(v, DurationModel)}
    durations = SkillDurations(models, execution.skill_overrides)
    robots = [robot.name for robot in subject.scenario.cell.robots]
    kinds = dict.fromkeys(item.kind for item in subject.cell.objects if not item.fixed)
    packaged: dict[str, float] = {}
    takers: dict[str, None] = {}
    for skill in subject.checks.skills:
        for robot, kind in product(robots, kinds):
            duration = durations.model_of(skill, robot, kind)
            if isinstance(duration, Packaged):
                packaged[skill] = duration.mean
                takers[robot] = None
    if packaged:
        means = ", ".join(f"{skill} {mean:.2f} s" for skill, mean in packaged.items())
        who = f", by {', '.join(takers)}" if len(takers) < len(robots) else ""
        yield Finding(
            ("execution", "skills"),
            f"these skills take the packaged times of a LEGO tool with force control ({means} in the"
            f" mean{who}), and this is no LEGO: give execution.skills your own (twin fit makes them"
            " from measured times)",
        )
