"""A short live run in a thread of its own, with somebody beside it."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any

from twin.drivers.simulated_arm import SimulatedArm
from twin.engine.execution import Ports
from twin.live.driver_end import DriverEnd, LocalWire
from twin.live.link import Link
from twin.live.remote_robots import RemoteRobots
from twin.operations.operation import Operation, operate
from twin.page.attended import Attendance
from twin.page.panel import Panel, Shown, ShownRobot
from twin.recorders.observers import MemoryRecorder
from twin.runs.events import Event
from twin.trial.plan_result import PlanResult
from twin.trial.simulation import scenario_execution
from twin.uncertainty.disturbances import Disturbances

LONGEST_S = 240.0
ASKS = {"recovery.again": 0, "recovery.ask": {"answer_s": 1.0}}
"""Values of a scenario that asks before anything is given up."""


@dataclass
class Beside:
    """A run, what is shared with it, and what was told in it."""

    plan: PlanResult
    pace: float = 40.0
    arms: Mapping[str, SimulatedArm] = field(default_factory=dict)
    values: Mapping[str, Any] = field(default_factory=dict)
    written: list[int] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.panel = Panel(steps=4)
        self._memory = MemoryRecorder()
        self._done: list[Operation | Exception] = []
        self._thread = threading.Thread(target=self._run, daemon=True)

    @property
    def events(self) -> list[Event]:
        return self._memory.events

    def begin(self) -> Beside:
        self._thread.start()
        self.until(lambda shown: shown.t_s > 0)
        return self

    def done(self) -> Operation:
        self._thread.join(timeout=LONGEST_S)
        (done,) = self._done
        if isinstance(done, Exception):
            raise done
        return done

    def until(self, true: Callable[[Shown], bool]) -> Shown:
        """Wait until what is shown is so."""
        begin = time.monotonic()
        while time.monotonic() - begin < LONGEST_S:
            shown = self.panel.shown
            if shown is not None and true(shown):
                return shown
            assert self._thread.is_alive(), self._done
            time.sleep(0.01)
        raise AssertionError(self.panel.shown)

    def _run(self) -> None:
        try:
            self._done.append(self._operated())
        except Exception as error:
            self._done.append(error)

    def _operated(self) -> Operation:
        links, wires = {}, {}
        for robot in self.plan.tpg.cell.robots:
            arm = self.arms.get(robot.name) or SimulatedArm(pace=self.pace)
            wires[robot.name] = LocalWire(DriverEnd(arm, robot.name, 1), 0.002)
            links[robot.name] = Link("run", robot.name, robot.home, 10.0, ahead_s=None)
        values = {"recovery.planning_s": 0.0, **self.values}
        case = self.plan.scenario.varied(values)
        model = scenario_execution(case.sections, case.folder)
        return operate(
            case.sections,
            self.plan.motions,
            self.plan.tpg,
            replace(model, disturbances=Disturbances()),
            seed=0,
            recorders=(self._memory,),
            answer=self.panel.answer,
            ports=Ports(
                partial(
                    RemoteRobots,
                    links=links,
                    wires=wires,
                    written=lambda: self.written.append(len(self.events)),
                    out_s=120.0,
                    pace=self.pace,
                ),
                audience=partial(Attendance, panel=self.panel),
            ),
        )


def robot(shown: Shown, name: str) -> ShownRobot:
    (found,) = (own for own in shown.robots if own.name == name)
    return found


def failing_first_pick(pace: float) -> SimulatedArm:
    """Return an arm whose first pick fails."""
    failed: list[int] = []

    def fails(node: Any) -> bool:
        if node.kind == "pick" and not failed:
            failed.append(node.node)
            return True
        return False

    return SimulatedArm(pace=pace, fails=fails)
