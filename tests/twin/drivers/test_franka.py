"""The driver of Franka robots, against a robot that goes straight at once, and against franky-sim."""

import re
import sys
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from enum import Enum
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from planning.cell.motion_limits import MotionLimits
from planning.cell.workcell import PlacedRobot, Workcell
from planning.robots.registry import robot_model
from planning.transforms import Array, identity
from twin.document.validation import InvalidScenarioError
from twin.drivers.driver import ClearedNode, DriverState, ToolOrder
from twin.drivers.drivers_file import FrankaArm, read_drivers
from twin.drivers.franka import FrankaDriver, franka_driver
from twin.drivers.franka_hand import FrankaError, HandGrip

pytestmark = pytest.mark.timeout(300)

LIMITS = MotionLimits(np.full(7, 4.0), np.full(7, 60.0), np.full(7, 5000.0))
ONE = np.array([1.0, 0.5, 0.0, -0.5, 0.0, 0.0, 0.25])


class Mode(Enum):
    Idle, Move, Reflex, UserStopped = range(4)


@dataclass
class Limit:
    max: Array
    value: Array = field(default_factory=lambda: np.zeros(7))

    def set(self, value: Array) -> None:
        assert (value <= self.max + 1e-12).all()
        self.value = value


class Robot:
    """Goes straight to its target, with the speed of its limits, by the clock."""

    def __init__(self, address: str, realtime_config: str) -> None:
        self.joint_velocity_limit = Limit(np.full(7, 4.0))
        self.joint_acceleration_limit = Limit(np.full(7, 60.0))
        self.joint_jerk_limit = Limit(np.full(7, 5000.0))
        self.q, self.target = np.zeros(7), np.zeros(7)
        self.at = time.monotonic()
        self.motions: list[Array] = []
        self.breaks = self.reflex = False

    def _advance(self) -> Array:
        if self.breaks:
            raise RuntimeError("communication_constraints_violation")
        now = time.monotonic()
        passed, self.at = now - self.at, now
        way = self.target - self.q
        share = np.max(np.abs(way) / np.maximum(self.joint_velocity_limit.value, 1e-9))
        if share <= passed:
            self.q = self.target
            return np.zeros(7)
        self.q = self.q + way * (passed / share)
        return np.asarray(way / share)

    @property
    def state(self) -> Any:
        speed = self._advance()
        mode = Mode.Reflex if self.reflex else Mode.Idle
        return SimpleNamespace(
            q=self.q,
            dq=speed,
            q_d=self.q,
            dq_d=speed,
            time=SimpleNamespace(to_sec=lambda at=self.at: at),
            robot_mode=mode,
            last_motion_errors="cartesian_reflex",
            current_errors="",
        )

    def move(self, motion: Array, asynchronous: bool) -> None:
        assert asynchronous
        self._advance()
        self.target = self.q if motion is None else motion
        self.motions.append(self.target)

    def join_motion(self, timeout: float) -> bool:
        self._advance()
        return bool((self.q == self.target).all())


class CommandError(Exception):
    """What libfranka raises where a command has failed."""


class Hand:
    """Closes on nothing as often as it is told."""

    def __init__(self, address: str) -> None:
        self.misses, self.width = 0, 0.06
        self.raises = self.stuck = False
        self.acts: list[str] = []

    def _future(self, good: bool) -> Any:
        def get() -> bool:
            if self.raises and not good:
                raise CommandError("libfranka gripper: Command failed!")
            return good

        return SimpleNamespace(wait=lambda _: True, get=get)

    def grasp_async(
        self, width: float, speed: float, force: float, inner: float, outer: float
    ) -> Any:
        self.acts.append("close")
        self.width = 0.0 if self.misses else 0.039
        self.misses -= 1
        return self._future(width - inner <= self.width <= width + outer)

    def move_async(self, width: float, speed: float) -> Any:
        self.acts.append("open")
        self.width = width
        return self._future(not self.stuck)


FRANKY = SimpleNamespace(
    Robot=Robot,
    Gripper=Hand,
    CommandException=CommandError,
    RobotMode=Mode,
    RealtimeConfig=SimpleNamespace(Enforce="enforce", Ignore="ignore"),
    RelativeDynamicsFactor=lambda *factors: factors,
    JointMotion=lambda q, relative_dynamics_factor: q,
    JointStopMotion=lambda: None,
)


@pytest.fixture
def driver(monkeypatch: pytest.MonkeyPatch) -> Iterator[FrankaDriver]:
    monkeypatch.setitem(sys.modules, "franky", FRANKY)
    found = FrankaDriver("robot", LIMITS, grip=HandGrip(goal=0.0))
    yield found
    found._close()


def node(
    number: int, *ways: float, task: int = 0, act: str = "", seconds: float = 0.1
) -> ClearedNode:
    points = np.array([way * ONE for way in ways])
    times: Array = seconds * np.arange(1.0, len(ways) + 1)
    return ClearedNode(number, task, "skill", "", points, times, act)


def when(
    driver: FrankaDriver, holds: Callable[[DriverState], bool], within_s: float = 100.0
) -> list[DriverState]:
    """Return all states until one of which something holds."""
    seen = []
    until = time.monotonic() + within_s
    while time.monotonic() < until:
        seen.append(driver.state())
        if holds(seen[-1]):
            return seen
        time.sleep(0.005)
    raise AssertionError(seen[-1])


def robot(driver: FrankaDriver) -> Robot:
    found: Robot = driver._robot
    return found


def hand(driver: FrankaDriver) -> Hand:
    found: Hand = driver._hand._gripper
    return found


def test_it_stands_at_the_end_of_what_it_is_cleared_for(driver: FrankaDriver) -> None:
    driver.begin(np.zeros(7), 0)
    driver.take([node(0, 0.3), node(1, 0.6)])
    seen = when(driver, lambda s: s.done == 2 and s.mode == "standing")
    assert all(s.begun - s.done in (0, 1) for s in seen)
    np.testing.assert_allclose(seen[-1].q, 0.6 * ONE)
    assert len(robot(driver).motions) == 1
    samples = [own for s in seen for own in s.samples]
    assert [s.at_s for s in samples] == sorted(s.at_s for s in samples)
    assert {s.done for s in samples} == {0, 1, 2}


def test_a_motion_becomes_longer_while_it_runs(driver: FrankaDriver) -> None:
    driver.begin(np.zeros(7), 0)
    driver.take([node(0, 1.0, seconds=2.0)])
    when(driver, lambda s: s.q[0] > 0.1)
    driver.take([node(1, 2.0, seconds=2.0)])
    seen = when(driver, lambda s: s.done == 2)
    assert len(robot(driver).motions) == 2
    between = [s for s in seen if 0.9 < s.q[0] < 1.1]
    assert between
    assert all(s.dq[0] > 0.2 for s in between)


def test_no_motion_is_faster_than_planned(driver: FrankaDriver) -> None:
    driver.begin(np.zeros(7), 0)
    factors: list[Any] = []

    def joint_motion(q: Any, relative_dynamics_factor: Any) -> Any:
        factors.append(relative_dynamics_factor)
        return q

    driver._franky = SimpleNamespace(**{**vars(FRANKY), "JointMotion": joint_motion})
    driver.take([node(0, 1.0, seconds=1.0), node(1, 1.5, seconds=1.0)])
    when(driver, lambda s: s.done == 2)
    assert factors == [(pytest.approx(0.25), 1.0, 1.0)]


@pytest.mark.parametrize("raises", [False, True])
def test_a_grasp_of_nothing_fails_its_skill_and_leads_back(
    driver: FrankaDriver, raises: bool
) -> None:
    hand(driver).misses, hand(driver).raises = 1, raises
    driver.begin(np.zeros(7), 0)
    skill = [
        node(1, 0.3, 0.5, task=1),
        node(2, 0.5, task=1, act="close"),
        node(3, 0.2, task=1),
    ]
    driver.take([node(0, 0.2), *skill])
    seen = when(driver, lambda s: s.failed >= 0)
    assert (seen[-1].failed, seen[-1].done, seen[-1].begun) == (1, 2, 2)
    assert "closed to 0.0 mm" in seen[-1].words
    np.testing.assert_allclose(seen[-1].q, 0.2 * ONE, atol=0.002)
    assert hand(driver).acts == ["close", "open"]
    # The same once more, as nodes after the one that counts as done.
    again = [
        node(k + 1, *(w for w in ways), task=1, act=act)
        for k, ways, act in (
            (1, (0.3, 0.5), ""),
            (2, (0.5,), "close"),
            (3, (0.2,), ""),
        )
    ]
    driver.take(again)
    seen = when(driver, lambda s: s.done == 5 and s.mode == "standing")
    assert seen[-1].failed == -1
    assert hand(driver).acts == ["close", "open", "close"]


def test_what_comes_while_it_goes_back_is_not_done(driver: FrankaDriver) -> None:
    hand(driver).misses = 1
    driver.begin(np.zeros(7), 0)
    driver.take([node(0, 1.0, task=1), node(1, 1.0, task=1, act="close")])
    when(driver, lambda s: hand(driver).acts == ["close", "open"])
    driver.take([node(2, 2.0)])
    seen = when(driver, lambda s: s.failed >= 0)
    time.sleep(0.1)
    assert seen[-1].failed == 0
    np.testing.assert_allclose(driver.state().q, 0.0, atol=0.002)


def test_a_hand_that_does_not_open_is_a_fault(driver: FrankaDriver) -> None:
    hand(driver).stuck = True
    driver.begin(np.zeros(7), 0)
    driver.take([node(0, 0.2), node(1, 0.2, act="open")])
    state = when(driver, lambda s: s.mode == "fault")[-1]
    assert (state.done, state.words) == (1, "the hand does not open")


def test_it_is_held_on_its_path_and_goes_on(driver: FrankaDriver) -> None:
    driver.begin(np.zeros(7), 0)
    driver.take([node(0, 2.0, seconds=4.0)])
    when(driver, lambda s: s.q[0] > 0.3)
    driver.hold(True)
    stood = when(driver, lambda s: s.mode == "held")[-1].q
    time.sleep(0.1)
    np.testing.assert_array_equal(driver.state().q, stood)
    assert 0.3 < stood[0] < 1.9
    driver.hold(False)
    assert when(driver, lambda s: s.done == 1)[-1].off < 1e-9


def test_faults_are_told_in_words(driver: FrankaDriver) -> None:
    driver.begin(np.zeros(7), 0)
    robot(driver).reflex = True
    assert "cartesian_reflex" in when(driver, lambda s: s.mode == "fault")[-1].words


def test_an_error_of_libfranka_is_a_fault(driver: FrankaDriver) -> None:
    driver.begin(np.zeros(7), 0)
    driver.take([node(0, 2.0)])
    robot(driver).breaks = True
    state = when(driver, lambda s: s.mode == "fault")[-1]
    assert state.words == "communication_constraints_violation"
    assert state.done == 0


def test_one_that_is_started_anew_takes_up_its_path(driver: FrankaDriver) -> None:
    robot(driver).q = robot(driver).target = 0.7 * ONE
    driver._q = 0.7 * ONE
    driver.begin(np.zeros(7), 3)
    driver.take([node(3, 0.5), node(4, 1.0)])
    seen = when(driver, lambda s: s.done == 5)
    assert {s.done for s in seen} <= {3, 4, 5}
    assert min(s.q[0] for s in seen) >= 0.7
    assert max(s.off for s in seen) < 1e-9


def test_one_that_stands_elsewhere_does_not_move(driver: FrankaDriver) -> None:
    driver._q = robot(driver).q = robot(driver).target = np.full(7, 0.5)
    driver.begin(np.zeros(7), 0)
    driver.take([node(0, 0.5)])
    state = when(driver, lambda s: s.mode == "fault")[-1]
    assert "from its path" in state.words
    assert robot(driver).motions == []


def test_two_robots_have_a_thread_each(driver: FrankaDriver) -> None:
    other = FrankaDriver("other", LIMITS)
    for each in (driver, other):
        each.begin(np.zeros(7), 0)
        each.take([node(0, 0.5)])
    for each in (driver, other):
        when(each, lambda s: s.done == 1)
    names = {thread.name for thread in threading.enumerate()}
    assert {"franka robot", "franka other"} <= names
    other._close()
    assert "franka other" not in {t.name for t in threading.enumerate()}


def test_a_hand_closes_for_another_robot_once_its_own_stands(
    driver: FrankaDriver,
) -> None:
    driver.begin(np.zeros(7), 0)
    driver.take([node(0, 0.2)])
    driver.act(ToolOrder("left:4", "close", 0.8, "bar"))
    seen = when(driver, lambda s: s.acted == "left:4")
    assert all(s.done == 1 for s in seen if s.acted)
    assert hand(driver).acts == ["close"]
    driver.take([node(1, 0.0)])
    assert when(driver, lambda s: s.done == 2)[-1].acted == "left:4"
    assert hand(driver).acts == ["close"]


def test_a_hand_that_takes_nothing_from_another_robot_is_a_fault(
    driver: FrankaDriver,
) -> None:
    driver.begin(np.zeros(7), 0)
    hand(driver).misses = 1
    driver.act(ToolOrder("left:4", "close", 0.8, "bar"))
    words = when(driver, lambda s: s.mode == "fault")[-1].words
    assert words == "the hand did not close at bar: it is 0.0 mm open"


def test_a_missing_package_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "franky", None)
    with pytest.raises(FrankaError, match=r"assembly-twin\[franka\]"):
        FrankaDriver("robot", LIMITS)


def test_a_drivers_file_names_a_franka_robot(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setitem(sys.modules, "franky", FRANKY)
    file = tmp_path / "drivers.yaml"
    file.write_text(
        "robots: {arm: {kind: franka, address: fr3.local, width_m: 0.05, goal_m: 0}}"
    )
    chosen = read_drivers(file, ("arm",)).driver_of("arm")
    assert isinstance(chosen, FrankaArm)
    model = robot_model("fr3")
    arm = PlacedRobot(
        "arm", model, identity(), model.home, limits=MotionLimits.of(model)
    )
    driver = franka_driver(chosen, arm)
    assert driver._hand.grip == HandGrip(width=0.05, goal=0.0)
    np.testing.assert_array_equal(driver._limits[0][1], np.minimum(model.velocity, 4.0))
    driver._close()
    with pytest.raises(FrankaError, match="speed_model: limits"):
        franka_driver(chosen, replace(arm, limits=None))
    file.write_text("robots: {arm: {kind: franka}}")
    with pytest.raises(InvalidScenarioError, match="address"):
        read_drivers(file, ("arm",))


def node_to(
    number: int, q: Array, seconds: float, task: int = 0, act: str = ""
) -> ClearedNode:
    return ClearedNode(number, task, "", "", q[None], np.array([seconds]), act)


@pytest.mark.nightly
def test_an_arm_of_franky_sim_keeps_to_a_path_that_becomes_longer() -> None:
    pytest.importorskip("franky")
    pytest.importorskip("franky_sim")
    from benchmarks.live.scene import Scene

    model = robot_model("fr3")
    arm = PlacedRobot("arm", model, identity(), model.home)
    limits = MotionLimits(np.full(7, 0.8), np.full(7, 2.0), np.full(7, 5000.0))
    way = np.array([0.6, 0.2, -0.3, 0.2, 0.2, 0.1, 0.4])
    nodes = [node_to(k, model.home + (k + 1) / 10 * way, 0.08) for k in range(10)]
    corner = model.home + way + np.array([0.0, -0.2, 0.1, 0.2, 0.0, 0.1, 0.0])
    nodes.append(node_to(10, corner, 0.3))
    with Scene(Workcell((arm,), (), ()), {"arm": model.home}) as scene:
        driver = FrankaDriver(
            scene.addresses["arm"], limits, grip=HandGrip(goal=0.0), realtime=False
        )
        driver.begin(model.home, 0)
        driver.take(nodes[:5])
        given, seen = 5, [driver.state()]
        until = time.monotonic() + 200.0
        while time.monotonic() < until and seen[-1].done < len(nodes):
            time.sleep(0.005)
            seen.append(driver.state())
            # Two ahead, so that the motion is made longer time and again.
            if given < len(nodes) and seen[-1].done >= given - 3:
                driver.take([nodes[given]])
                given += 1
        last = seen[-1]
        # Held on the way back, it stands on the line; then the hand closes on nothing.
        driver.take(
            [node_to(11, model.home, 1.0), node_to(12, model.home + 0.1, 1.0, 1)]
        )
        driver.take([node_to(13, model.home + 0.1, 0.5, 1, "close")])
        when(driver, lambda s: np.abs(s.q - corner).max() > 0.2, 100.0)
        driver.hold(True)
        seen += when(driver, lambda s: s.mode == "held", 100.0)
        time.sleep(0.5)
        stood = driver.state()
        driver.hold(False)
        failed = when(driver, lambda s: s.failed >= 0, 100.0)
        driver._close()
    assert last.done == len(nodes), last
    assert max(s.off for s in seen + failed) < 0.005
    np.testing.assert_allclose(last.q, corner, atol=0.003)
    assert (stood.mode, stood.done) == ("held", 11)
    assert np.abs(stood.q - model.home).max() > 0.1
    assert (failed[-1].failed, failed[-1].done) == (12, 13), failed[-1]
    np.testing.assert_allclose(failed[-1].q, model.home, atol=0.003)
    assert re.fullmatch(r"the hand closed to [0-3]\.\d mm", failed[-1].words)
    samples = [own for s in seen for own in s.samples]
    times = [s.at_s for s in samples]
    assert times == sorted(times)
    assert [s.done for s in samples] == sorted(s.done for s in samples)
