"""A plan executed by arms in franky-sim through a session, as ``twin operate --drivers`` does it."""

from __future__ import annotations

import threading
import time
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from benchmarks.live.scene import OPENING, Scene
from planning.cell.workcell import PlacedRobot
from planning.transforms import Array, Transform
from scheduling.graph.temporal_plan_graph import TemporalPlanGraph
from twin.drivers.driver import ClearedNode, Driver, DriverState, ToolOrder
from twin.drivers.drivers_file import AnyDriver, DriversSection, FrankaArm
from twin.durations.nanoseconds import NANOSECONDS, Nanoseconds
from twin.live.executor import LiveExecutor
from twin.live.measured_log import MEASURED, MeasuredLog
from twin.live.session import Session
from twin.runs.execution_record import ExecutionRecord
from twin.runs.tracking import TrackingError, tracking_errors
from twin.trial.plan_result import PlanResult
from twin.trial.run_plan import run_plan_to_folder
from twin.trial.run_result import RunResult

_LOOK_S = 0.1
"""Time between looks at the simulator's clock [s]."""


class OneAfterAnother:
    """A driver that is sent one trajectory after another: of a task, once the robot stands at its start.

    Args:
        driver: that executes them.
    """

    def __init__(self, driver: Driver) -> None:
        self._driver, self._waiting = driver, list[ClearedNode]()
        self._sent = 0

    def begin(self, start: Array, done: int) -> None:
        """Be told where the plan has it stand; see Driver."""
        self._sent = done
        self._driver.begin(start, done)

    def take(self, nodes: list[ClearedNode]) -> None:
        """Keep nodes until it is their turn; see Driver."""
        self._waiting += nodes

    def state(self) -> DriverState:
        """Return how far it is, and send what comes next where it stands; see Driver."""
        state = self._driver.state()
        if self._waiting and state.done == self._sent and state.mode == "standing":
            task = self._waiting[0].task
            own = [node for node in self._waiting if node.task == task]
            del self._waiting[: len(own)]
            self._sent += len(own)
            self._driver.take(own)
        return state

    def act(self, order: ToolOrder) -> None:
        """Close or open the tool; see Driver."""
        self._driver.act(order)

    def hold(self, held: bool) -> None:
        """Stand as soon as it can, or go on; see Driver."""
        self._driver.hold(held)

    def leave(self) -> None:
        """Stand, and let go of the robot; see Driver."""
        self._driver.leave()


@dataclass(frozen=True)
class StopAndGo(Session):
    """A session whose drivers are sent one trajectory after another."""

    def driver(self, robot: PlacedRobot) -> Driver:
        """Return who moves a robot; see Session."""
        return OneAfterAnother(super().driver(robot))


@dataclass
class SimulatedTime:
    """Keeps looking at the clock of a simulator, which may be slower than that on the wall.

    Attributes:
        scene: that is simulated.
    """

    scene: Scene
    _seen: list[tuple[float, float]] = field(default_factory=list)
    _over: threading.Event = field(default_factory=threading.Event)

    def __enter__(self) -> SimulatedTime:
        self._thread = threading.Thread(target=self._look, daemon=True)
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._over.set()
        self._thread.join()

    def _look(self) -> None:
        while not self._over.wait(_LOOK_S):
            before = time.monotonic()
            seconds = self.scene.look().seconds
            self._seen.append((0.5 * (before + time.monotonic()), seconds))

    def at(self, wall_s: Array) -> Array:
        """Return what it showed at times of the clock on the wall, same shape [s]."""
        wall, simulated = np.array(self._seen).T
        return np.asarray(np.interp(wall_s, wall, simulated))


@dataclass(frozen=True, eq=False)
class Driven:
    """What came of a plan that was driven.

    Attributes:
        run: as it was written.
        poses: of the objects at the end.
        start_s, end_s: of the nodes of each chain by the simulator's clock, since the run began [s].
        wall_s: makespan by the clock on the wall [s].
        off: how far each robot was from its path.
    """

    run: RunResult
    poses: dict[str, Transform]
    start_s: tuple[Array, ...]
    end_s: tuple[Array, ...]
    wall_s: float
    off: dict[str, TrackingError]

    @property
    def makespan_s(self) -> float:
        """By the simulator's clock [s]."""
        return float(max(own.max(initial=0.0) for own in self.end_s))


def drive(plan: PlanResult, folder: Path, *, stop_and_go: bool = False) -> Driven:
    """Execute a plan in a simulator of its own, into a folder.

    Args:
        plan: made to be operated.
        folder: of the run.
        stop_and_go: send one trajectory after another.
    """
    tpg = plan.tpg
    starts = {robot.name: robot.home for robot in tpg.cell.robots}
    starts |= {chain.robot: chain.start for chain in tpg.chains}
    width = float(np.median([item.size[1] for item in tpg.cell.objects]))
    with Scene(tpg.cell, starts) as scene:
        arms: dict[str, AnyDriver] = {
            # Simulated fingers are springs of 1 N/mm each.
            name: FrankaArm(
                kind="franka",
                address=address,
                width_m=width,
                opening_m=OPENING,
                goal_m=0.0,
                realtime=False,
            )
            for name, address in scene.addresses.items()
        }
        kind = StopAndGo if stop_and_go else Session
        session = kind(folder.name, DriversSection(robots=arms))
        folder.mkdir(parents=True)
        with SimulatedTime(scene) as clock:
            run = run_plan_to_folder(
                plan, folder, recording=False, executor=LiveExecutor(session)
            )
            time.sleep(1.0)
        poses = scene.look().poses
    record = run.record
    assert record is not None
    began = MeasuredLog(folder / MEASURED).begin_s()
    assert began is not None
    return Driven(
        run,
        poses,
        _simulated(clock, began, record.start_ns),
        _simulated(clock, began, record.end_ns),
        record.makespan_s,
        tracking_errors(run.tpg, record.measured),
    )


def _simulated(
    clock: SimulatedTime, began_s: float, times: tuple[Nanoseconds, ...]
) -> tuple[Array, ...]:
    zero = clock.at(np.array([began_s]))
    return tuple(clock.at(began_s + own / NANOSECONDS) - zero for own in times)


def latencies_s(tpg: TemporalPlanGraph, record: ExecutionRecord) -> Array:
    """Return how long robots stood after what they waited for was complete, each time that they did [s].

    Args:
        tpg: what was executed.
        record: how.
    """
    ready: dict[tuple[int, int], int] = {}
    for r, u, k, v in tpg.edges.tolist():
        ready[k, v] = max(ready.get((k, v), 0), int(record.end_ns[r][u]))
    found = []
    for (k, v), known in ready.items():
        own = int(record.end_ns[k][v - 1]) if v else 0
        if known > own:
            found.append((int(record.start_ns[k][v]) - known) / NANOSECONDS)
    return np.array(found)
