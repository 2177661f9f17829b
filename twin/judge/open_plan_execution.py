"""Execution of an open plan, the file format of ``twin judge``, at given motion times.

The result is a recording like that of a simulated run, so that the audit can check it.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from planning.cell.workcell import PlacedRobot
from planning.tasks.task import Handling
from planning.transforms import Array, Transform, inverse
from twin.audits.case import Violation
from twin.audits.expectations import ChangedTool
from twin.audits.motion.executed import ObjectRow, Recording, RobotRows
from twin.audits.worlds.world import AuditWorld
from twin.judge.open_plan import OpenEvent, OpenMotion, OpenPlan
from twin.judge.open_plan_graph import joint_columns, motion_configurations

_SAME_JOINT = 1e-6
"""Joint values that differ by less are the same, as files round them [rad or m]."""

_SAME_TIME_S = 1e-9
"""Times that differ by less are the same, as files round them [s]."""

_JUMP_S = 1e-6
"""Assumed duration of a jump between two motions, so that the path in between is checked [s]."""


@dataclass(frozen=True)
class MotionSpan:
    """Interval in which a motion is executed.

    Attributes:
        begin: when the motion begins [s].
        factor: executed duration over planned duration.
    """

    begin: float
    factor: float = 1.0

    def at(self, motion: OpenMotion, t: float) -> float:
        """Map a planned time to its execution time [s]."""
        return self.begin + (t - motion.t_s[0]) * self.factor

    def end(self, motion: OpenMotion) -> float:
        """Return when the motion is over [s]."""
        return self.at(motion, motion.t_s[-1])


def planned_spans(plan: OpenPlan) -> dict[str, MotionSpan]:
    """Return the planned span of each motion, by id."""
    return {motion.id: MotionSpan(motion.t_s[0]) for _, _, motion in plan.placed()}


def makespan_s(plan: OpenPlan, spans: Mapping[str, MotionSpan]) -> float:
    """Return when the last motion is over [s]."""
    return max(
        (spans[motion.id].end(motion) for _, _, motion in plan.placed()), default=0.0
    )


@dataclass(frozen=True, eq=False)
class Transfer:
    """Transfer of an object in an execution.

    Attributes:
        t: its time [s].
        owner: robot or machine whose motion makes the transfer.
        motion: that motion.
        event: its entry in the file.
        before: holder before it, None at rest.
        now: holder after it, None at rest.
        pose: pose in the world just before the transfer.
        rests: pose in the world afterwards; None when a robot holds it.
    """

    t: float
    owner: str
    motion: OpenMotion
    event: OpenEvent
    before: str | None
    now: str | None
    pose: Transform
    rests: Transform | None


@dataclass(frozen=True, eq=False)
class OpenPlanExecution:
    """Execution of an open plan.

    Attributes:
        recording: input of the audit.
        changes: transfers of objects, by time.
        violations: impossible motions and transfers: jumps between motions, and taking with a full tool or
            giving with an empty one.
    """

    recording: Recording
    changes: tuple[Transfer, ...]
    violations: tuple[Violation, ...]


def build_open_plan_execution(
    plan: OpenPlan,
    world: AuditWorld,
    tools: tuple[ChangedTool, ...],
    spans: Mapping[str, MotionSpan],
) -> OpenPlanExecution:
    """Return the execution of a plan.

    Args:
        plan: the plan, which fits the cell.
        world: computes flange poses.
        tools: exchangeable tools.
        spans: when each motion is executed, by id; those of a robot do not overlap.
    """
    found: list[Violation] = []
    robots = {}
    end = makespan_s(plan, spans)
    for robot in world.cell.robots:
        robots[robot.name] = _robot_rows(plan, robot, spans, end, found)
    tracker = _ObjectTracker(world, robots, tools)
    events = sorted(
        (
            (spans[motion.id].at(motion, event.t_s), event.verb == "take", name, k, n)
            for name, some in plan.motions.items()
            for k, motion in enumerate(some)
            for n, event in enumerate(motion.events)
        ),
    )
    for t, _, name, k, n in events:
        motion = plan.motions[name][k]
        tracker.change(t, name, motion, motion.events[n])
    recording = Recording(robots, tuple(tracker.rows), end)
    return OpenPlanExecution(
        recording, tuple(tracker.changes), (*found, *tracker.violations)
    )


def _robot_rows(
    plan: OpenPlan,
    robot: PlacedRobot,
    spans: Mapping[str, MotionSpan],
    end: float,
    found: list[Violation],
) -> RobotRows:
    """Return the rows of a robot until the end [s]; it stands between its motions and after them."""
    own = plan.motions.get(robot.name, ())
    if not own:
        return RobotRows(np.zeros(1), robot.home[None, :], np.full(1, -1))
    columns = joint_columns(plan, robot)
    stands = motion_configurations(own[0], columns)[0]
    if np.max(np.abs(stands - robot.home)) > _SAME_JOINT:
        found.append(_jump(robot, 0.0, robot.home, stands, "its HOME", own[0].id))
    table = _RowTable(stands)
    for k, motion in enumerate(own):
        span, rows = spans[motion.id], motion_configurations(motion, columns)
        times = span.begin + (np.array(motion.t_s) - motion.t_s[0]) * span.factor
        table.stand_until(float(times[0]))
        if np.max(np.abs(rows[0] - table.q[-1])) > _SAME_JOINT:
            name = own[k - 1].id if k else "its HOME"
            words = table.q[-1], rows[0], name, motion.id
            found.append(_jump(robot, float(times[0]), *words))
            times = np.maximum(times, table.t[-1] + _JUMP_S)
        v = _rates(motion.v, columns, span.factor, rows)
        table.add(times, rows, v, _rates(motion.a, columns, span.factor**2, rows), k)
    table.stand_until(end)
    return table.rows(smooth=any(motion.v is not None for motion in own))


class _RowTable:
    """Collects rows of a robot, from rest at time 0.

    A row with the time and configuration of the previous one replaces its speeds and accelerations: where a
    motion continues another one, those of the later motion count.
    """

    def __init__(self, q: Array) -> None:
        still = np.zeros_like(q)
        self.t, self.q, self.node = [0.0], [q], [-1]
        self.v, self.a = [still], [still]

    def stand_until(self, t: float) -> None:
        """Add a standstill until a time [s], outside nodes."""
        if t > self.t[-1] + _SAME_TIME_S:
            still = np.zeros((1, len(self.q[0])))
            self.add(np.array([t]), self.q[-1][None], still, still, -1)

    def add(self, t: Array, q: Array, v: Array, a: Array, node: int) -> None:
        """Add the rows of a node."""
        for k, at in enumerate(np.maximum(t, self.t[-1]).tolist()):
            again = (
                at <= self.t[-1] + _SAME_TIME_S
                and np.max(np.abs(q[k] - self.q[-1])) <= _SAME_JOINT
            )
            if again:
                self.v[-1], self.a[-1] = v[k], a[k]
                continue
            self.t.append(at)
            self.q.append(q[k])
            self.v.append(v[k])
            self.a.append(a[k])
            self.node.append(node)

    def rows(self, *, smooth: bool) -> RobotRows:
        """Return the rows, with or without speeds and accelerations."""
        rates = [np.array(self.v), np.array(self.a)] if smooth else []
        return RobotRows(
            np.array(self.t), np.array(self.q), np.array(self.node), *rates
        )


def _rates(
    values: tuple[tuple[float, ...], ...] | None,
    columns: list[int],
    divisor: float,
    configurations: Array,
) -> Array:
    if values is None:
        return np.zeros_like(configurations)
    return np.asarray(np.array(values)[:, columns] / divisor)


def _jump(
    robot: PlacedRobot, t: float, q: Array, to: Array, first: str, then: str
) -> Violation:
    joint = int(np.argmax(np.abs(to - q)))
    name = robot.model.joint_names[joint]
    unit = "m" if robot.model.chain.prismatic[joint] else "rad"
    words = f"{then} begins {abs(to[joint] - q[joint]):.6g} {unit} away from the end of"
    words = f"{words} {first}"
    return Violation(t, t, robot.name, name, 0.0, words, "jump")


@dataclass(eq=False)
class _ObjectLocation:
    holder: str | None
    pose: Transform


@dataclass(eq=False)
class _ObjectTracker:
    """Locations of all objects, updated by transfers.

    Attributes:
        world: computes flange poses.
        robots: rows of each robot.
        tools: exchangeable tools; a robot may hold one and an object.
    """

    world: AuditWorld
    robots: Mapping[str, RobotRows]
    tools: tuple[ChangedTool, ...]
    rows: list[ObjectRow] = field(default_factory=list)
    changes: list[Transfer] = field(default_factory=list)
    violations: list[Violation] = field(default_factory=list)

    def __post_init__(self) -> None:
        self._numbers = {r.name: k for k, r in enumerate(self.world.cell.robots)}
        self._places = {
            item.name: _ObjectLocation(None, item.start)
            for item in self.world.cell.objects
            if not item.later
        }
        for tool in self.tools:
            if tool.first:
                self._places[tool.name] = _ObjectLocation(tool.robot, tool.mount)
                self.rows.append(ObjectRow(0.0, tool.name, tool.robot, tool.mount))

    def change(self, t: float, name: str, motion: OpenMotion, event: OpenEvent) -> None:
        """Apply an event."""
        verb, thing = event.verb, event.object
        place = self._places.get(thing)
        wrong = "" if place is None else self._fault(name, event, place)
        if place is None and verb != "appear":
            wrong = "is not there"
        elif place is not None and verb == "appear":
            wrong = "is there already"
        if wrong:
            words = f"{verb} {thing} in {motion.id}: {wrong}"
            self.violations.append(Violation(t, t, name, thing, 0.0, words, "hand"))
        if (place is None) != (verb == "appear"):
            return
        start = self.world.cell.object(thing).start
        world = start if place is None else self._world_pose(place, t)
        holder = {"take": name, "give": event.to, "leave": Handling.GONE}.get(verb)
        hand = None if holder in (None, Handling.GONE) else self._flange(str(holder), t)
        pose = world if hand is None else np.asarray(inverse(hand) @ world)
        if event.pose is not None:
            pose = event.pose.transform()
        before = None if place is None else place.holder
        rests = None if holder is not None else pose
        self.changes.append(
            Transfer(t, name, motion, event, before, holder, world, rests)
        )
        self.rows.append(ObjectRow(t, thing, holder, pose))
        if holder == Handling.GONE:
            del self._places[thing]
        else:
            self._places[thing] = _ObjectLocation(holder, pose)

    def _fault(self, name: str, event: OpenEvent, place: _ObjectLocation) -> str:
        """Return what is wrong with an event, empty if valid."""
        if event.verb in ("put", "give") and place.holder != name:
            return (
                f"is in the hand of {place.holder}" if place.holder else "is in no hand"
            )
        taker = {"take": name, "give": event.to}.get(event.verb)
        if taker is None:
            return ""
        if place.holder == taker:
            return f"is in the hand of {taker} already"
        racked = {tool.name for tool in self.tools}
        full = [
            other
            for other, at in self._places.items()
            if at.holder == taker and (other in racked) == (event.object in racked)
        ]
        return f"{taker} has {full[0]} in its hand" if full else ""

    def _world_pose(self, place: _ObjectLocation, t: float) -> Transform:
        if place.holder is None:
            return place.pose
        return np.asarray(self._flange(place.holder, t) @ place.pose)

    def _flange(self, robot: str, t: float) -> Transform:
        q = self.robots[robot].at(np.array([t]))
        return np.asarray(self.world.flange_poses(self._numbers[robot], q)[0])
