"""Driver of Franka Robotics arms (FR3, Panda), with libfranka through the Python package ``franky-control``.

A straight segment in joint space is one motion that starts and ends at rest, timed by Ruckig. Its joint limits are
in proportion to the joint displacements, so the path stays straight. If further nodes on the same line are released
during the motion, the motion is extended before the robot brakes. At a corner the robot stops, and continues when the
measured distance to the corner is within a given path tolerance. The thread of libfranka executes the motions,
at most to the end of the last released node, even if the dispatcher fails. If this process ends, the robot
controller stops the robot. Installation: extra ``franka``.
"""

from __future__ import annotations

import atexit
import threading
import time
from collections import deque
from typing import Any

import numpy as np

from planning.cell.motion_limits import MotionLimits
from planning.cell.workcell import PlacedRobot
from planning.transforms import Array
from twin.drivers.driver import ClearedNode, DriverState, Mode, Sample, ToolOrder
from twin.drivers.drivers_file import FrankaArm
from twin.drivers.franka_hand import FrankaError, FrankaHand, HandGrip
from twin.drivers.legs import ClearedPath
from twin.host.extras import extra_module

_LEAST_SHARE = 0.01
"""Least limit of a joint, as a share of that of the joint with the largest displacement."""

_POLL_S = 0.01
"""Polling period of the robot's state [s]."""

_EXTEND_S = 0.08
"""Time before the begin of braking at which a motion is extended [s]."""

_SETTLE_S = 5.0
"""Longest time in which a robot settles at its target [s]."""

_MOST_SAMPLES = 5000
"""Largest number of buffered samples."""

_CLOCK_GAIN, _LATE_S = 0.1, 0.2
"""Share of the clock offset corrected at each reading, and its maximum [s]."""

_REST_SPEED = 2e-3
"""Speed below which joints count as at rest [rad/s]."""

_SETTLED_COUNT = 5
"""Number of consecutive states near the target with which a robot has settled."""


class FrankaDriver:
    """A Franka robot with its hand, moved by a thread of its own.

    Args:
        address: of the robot's controller, name or number.
        limits: joint limits of the plan.
        grip: grip of the hand.
        corner: largest deviation of a joint where a corner is cut [rad].
        settle: joint tolerance before tool actions, and at the last cleared node [rad].
        stray: largest distance of the robot from its path at the begin [rad].
        realtime: whether this computer has a real-time kernel, which real robots ask for.

    Raises:
        FrankaError: the package is not installed, or the robot does not answer.
    """

    def __init__(
        self,
        address: str,
        limits: MotionLimits,
        *,
        grip: HandGrip | None = None,
        corner: float = 0.005,
        settle: float = 0.002,
        stray: float = 0.01,
        realtime: bool = True,
    ) -> None:
        self._franky = extra_module(
            "franky",
            package="franky-control",
            extra="franka",
            needs="a Franka robot",
            error=FrankaError,
        )
        config = self._franky.RealtimeConfig
        try:
            self._robot = self._franky.Robot(
                address, realtime_config=config.Enforce if realtime else config.Ignore
            )
            self._hand = FrankaHand(
                self._franky.Gripper(address),
                grip or HandGrip(),
                self._franky.CommandException,
            )
        except Exception as error:
            raise FrankaError(f"no robot at {address!r}: {error}") from error
        self._address = address
        self._corner, self._settle, self._stray = corner, settle, stray
        self._limits = tuple(
            (limit, np.minimum(given, np.array(limit.max)))
            for limit, given in (
                (self._robot.joint_velocity_limit, limits.velocity),
                (self._robot.joint_acceleration_limit, limits.acceleration),
                (self._robot.joint_jerk_limit, limits.jerk),
            )
        )
        self._lock = threading.Lock()
        state = self._robot.state
        self._q, self._dq = np.array(state.q), np.array(state.dq)
        self._path = ClearedPath(self._q, 0)
        self._off, self._words = 0.0, ""
        self._mode: Mode = "standing"
        self._failed, self._failing = -1, -1
        self._held = self._left = False
        self._done = self._begun = 0
        # The current leg, if its end is not -1: length, speed and acceleration along it.
        self._at, self._end = 0, -1
        self._unit, self._speed, self._rate = np.zeros(7), 0.0, 1.0
        self._stopping = self._stands = self._entering = False
        self._since, self._near = 0.0, 0
        self._clock_s = self._robot_s = 0.0
        # Action of the hand for another robot, and whether it is in progress or done.
        self._order: ToolOrder | None = None
        self._ordered, self._acted = False, ""
        self._samples: deque[Sample] = deque(maxlen=_MOST_SAMPLES)
        self._thread: threading.Thread | None = None
        atexit.register(self._close)

    def begin(self, start: Array, done: int) -> None:
        """Start at the planned configuration, and start to monitor the robot.

        A robot elsewhere enters its path at the nearest point, once it has nodes.
        """
        with self._lock:
            self._path = ClearedPath(start, done)
            self._done = self._begun = done
            self._at, self._end = 0, -1
            self._entering = bool(np.abs(self._q - start).max() > self._stray)
        if self._thread is None:
            self._thread = threading.Thread(
                target=self._run, name=f"franka {self._address}", daemon=True
            )
            self._thread.start()

    def take(self, nodes: list[ClearedNode]) -> None:
        """Append cleared nodes."""
        with self._lock:
            if not nodes or self._failing >= 0:
                return  # nodes after a failed skill are not executed
            for node in nodes:
                self._path.add(node)
            if self._failed >= 0:
                self._failed, self._words = -1, ""

    def state(self) -> DriverState:
        """Return the state of the robot."""
        with self._lock:
            off, self._off = self._off, 0.0
            samples = tuple(self._samples)
            # The last one is repeated, so that every report has a sample, and all times are of one clock.
            self._samples = deque(samples[-1:], maxlen=_MOST_SAMPLES)
            return DriverState(
                self._begun,
                self._done,
                self._mode,
                self._q.copy(),
                self._dq.copy(),
                off,
                self._failed,
                self._words,
                samples,
                self._acted,
            )

    def act(self, order: ToolOrder) -> None:
        """Close or open the hand once the robot stands at the end of its cleared nodes; see Driver."""
        with self._lock:
            self._order = order

    def hold(self, held: bool) -> None:
        """Stop as soon as possible, on the path, or continue."""
        with self._lock:
            self._held = held

    def leave(self) -> None:
        """Stop and release the robot."""
        with self._lock:
            self._left = self._held = True

    def _close(self) -> None:
        """Release the robot and wait for it: libfranka's threads must end before the interpreter."""
        self.leave()
        if self._thread is not None:
            self._thread.join(_SETTLE_S)

    def _run(self) -> None:
        """Monitor and move the robot until it is released."""
        self._work()
        del self._hand, self._robot
        atexit.unregister(self._close)

    def _work(self) -> None:
        while True:
            try:
                state = self._robot.state
                with self._lock:
                    self._record(state)
                    if self._mode != "fault":
                        self._step(state)
                        self._mode = self._current_mode()
                    at_s = self._time_of(state)
                    self._samples.append(Sample(at_s, self._q, self._begun, self._done))
                    standing = self._end < 0 and not self._hand.is_at_work
                    if self._left and (standing or self._mode == "fault"):
                        return
            except Exception as error:  # any error of libfranka
                with self._lock:
                    self._mode, self._words = "fault", str(error)
                    if self._left:
                        return
            time.sleep(_POLL_S)

    def _time_of(self, state: Any) -> float:
        """Return the measurement time of a state by this computer's clock.

        Time differences come from the robot's clock. This computer reads a state late, so its clock
        only corrects drift.
        """
        robot_s, now_s = state.time.to_sec(), time.monotonic()
        guess = self._clock_s + robot_s - self._robot_s
        late = now_s - guess
        at_s = guess + _CLOCK_GAIN * late if 0.0 <= late < _LATE_S else now_s
        self._clock_s, self._robot_s = max(at_s, self._clock_s), robot_s
        return self._clock_s

    def _current_mode(self) -> Mode:
        if self._hand.is_at_work:
            return "moving"
        if self._held and (self._end < 0 or self._stands):
            return "held"
        return "standing" if self._end < 0 else "moving"

    def _record(self, state: Any) -> None:
        """Record a measurement."""
        self._q, self._dq = np.array(state.q), np.array(state.dq)
        end = self._at if self._end < 0 else self._end
        if not self._entering:
            self._off = max(self._off, self._path.deviation(self._at, end, self._q))
        modes = self._franky.RobotMode
        if state.robot_mode in (modes.Reflex, modes.UserStopped):
            self._mode = "fault"
            said = state.last_motion_errors or state.current_errors
            self._words = f"{state.robot_mode.name}: {said}"

    def _step(self, state: Any) -> None:
        """Continue the current leg or action, or begin the next one."""
        if self._end >= 0:
            self._follow(state)
        elif self._hand.is_at_work:
            self._act()
        elif self._failing >= 0 and self._at + 1 == len(self._path.points):
            self._failed, self._failing = self._failing, -1
            self._done = self._begun = self._failed + 1
        if self._end >= 0 or self._hand.is_at_work or self._held:
            return
        if self._order is not None and self._at + 1 == len(self._path.points):
            self._ordered = True
            self._hand.begin(self._order.act)
            return
        if self._at + 1 < len(self._path.points):
            if self._entering:
                self._at, off = self._path.nearest_segment(self._q)
                if off > self._stray:
                    raise FrankaError(f"it stands {off:.3f} rad from its path")
                self._passed(self._at)
                self._entering = False
            self._begin_next()

    def _begin_next(self) -> None:
        """Begin the next leg or action."""
        following = self._path.points[self._at + 1]
        if self._failing < 0:
            self._begun = max(self._begun, self._path.points[self._at].done + 1)
        self._since = time.monotonic()
        if following.stands:
            self._hand.begin(following.act, following.seconds)
            return
        self._end = self._path.leg_end(self._at)
        leg = self._path.points[self._end].q - self._path.points[self._at].q
        longest = float(np.abs(leg).max())
        self._unit = leg / longest
        share = np.maximum(np.abs(self._unit), _LEAST_SHARE)
        (speeds, speed), (rates, rate), (jerks, jerk) = self._limits
        self._speed = float(np.min(speed / share))
        self._rate = float(np.min(rate / share))
        speeds.set(share * self._speed)
        rates.set(share * self._rate)
        # Jerk is not scaled: accelerations build up within milliseconds, and an error of the acceleration
        # that the robot reports at the begin vanishes as fast.
        jerks.set(jerk)
        self._move_to_end()

    def _move_to_end(self) -> None:
        """Move to the end of the leg, at most at the planned speed."""
        top = self._path.top_speed(self._at, self._end)
        slower = min(1.0, top / self._speed)
        factor = self._franky.RelativeDynamicsFactor(slower, 1.0, 1.0)
        motion = self._franky.JointMotion(
            self._path.points[self._end].q, relative_dynamics_factor=factor
        )
        self._robot.move(motion, asynchronous=True)
        self._stopping = self._stands = False
        self._near = 0

    def _follow(self, state: Any) -> None:
        """Track the progress on the leg, and extend the motion where possible."""
        points, end = self._path.points, self._end
        square = float(self._unit @ self._unit)
        between = self._path.configurations(self._at, end)[1:-1]
        for k in np.flatnonzero((between - self._q) @ self._unit <= 0.0).tolist():
            self._passed(self._at + 1 + k)
        if self._held and not self._stopping:
            self._robot.move(self._franky.JointStopMotion(), asynchronous=True)
            self._stopping = True
        elif self._stopping:
            self._stands = self._robot.join_motion(0.0)
            if not self._stands:
                return
            if self._left:
                self._end = -1
            elif not self._held:
                self._move_to_end()
                self._since = time.monotonic()
        else:
            left = (points[end].q - np.array(state.q_d)) @ self._unit / square
            speed = max(0.0, float(np.array(state.dq_d) @ self._unit) / square)
            brake = speed * speed / (2.0 * self._rate) + _EXTEND_S * speed
            longer = self._path.leg_end(self._at, end)
            if longer > end and left <= brake + 1e-3:
                self._end = longer
                self._move_to_end()
            elif not self._robot.join_motion(0.0):
                self._since = time.monotonic()
            elif self._is_near_leg_end() and np.abs(state.dq_d).max() <= _REST_SPEED:
                self._passed(end)
                self._at, self._end = end, -1
            elif time.monotonic() - self._since > _SETTLE_S:
                off = np.abs(self._q - points[end].q).max()
                raise FrankaError(f"it stands {off:.4f} rad from where it was sent")

    def _is_near_leg_end(self) -> bool:
        """Return whether the robot is near enough to the end of the leg to continue."""
        off = float(np.abs(self._q - self._path.points[self._end].q).max())
        turn = self._path.turn_sine(self._at, self._end)
        if turn < 1.0 and off * turn <= self._corner:
            return True
        self._near = self._near + 1 if off <= self._settle else 0
        return self._near >= _SETTLED_COUNT

    def _passed(self, k: int) -> None:
        """Record that the robot has passed or reached a point."""
        if self._failing >= 0:
            return  # no tool action on the way back
        self._done = max(self._done, self._path.points[k].done)
        self._begun = max(self._begun, self._done + (k < self._end))

    def _act(self) -> None:
        """Check whether the tool action is complete."""
        if (good := self._hand.ended()) is None:
            return
        if self._ordered:
            assert self._order is not None
            if not good:
                width = 1000 * self._hand.width
                raise FrankaError(
                    f"the hand did not {self._order.act} at {self._order.object}: it is {width:.1f} mm open"
                )
            self._acted, self._order, self._ordered = self._order.name, None, False
            return
        point = self._path.points[self._at + 1]
        if self._failing >= 0 and good:
            self._path, self._at = self._path.path_back(self._at + 1), 0
        elif good:
            self._at += 1
            self._passed(self._at)
        elif point.act == "close" and self._failing < 0:
            # Open again, and go back to where the skill began.
            self._failing = point.first
            self._words = f"the hand closed to {1000 * self._hand.width:.1f} mm"
            self._hand.begin("open")
        else:
            raise FrankaError("the hand does not open")


def franka_driver(arm: FrankaArm, robot: PlacedRobot) -> FrankaDriver:
    """Return the driver of a Franka robot of a drivers file.

    Raises:
        FrankaError: the plan has no limits for it, or it cannot be reached.
    """
    if robot.limits is None or robot.model.dof != 7:
        raise FrankaError(
            f"{robot.name} cannot be a Franka robot: it needs 7 joints and 'speed_model: limits'"
        )
    grip = HandGrip(
        arm.width_m, arm.within_m, arm.opening_m, arm.force_n, arm.speed_m_s, arm.goal_m
    )
    return FrankaDriver(arm.address, robot.limits, grip=grip, realtime=arm.realtime)
