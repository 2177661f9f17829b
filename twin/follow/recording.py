"""A followed run as a Rerun recording, written while the run goes on."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import rerun as rr

from planning.errors import OutputError
from planning.tasks.task import GONE
from planning.transforms import Array
from scheduling.graph.task_edges import with_barriers
from scheduling.graph.temporal_plan_graph import NodeHandling, TemporalPlanGraph
from twin.durations.model import Nanoseconds
from twin.follow.follow import RunListener
from twin.follow.forecast import Forecast
from twin.follow.state import FollowedRun, ForbiddenEvent
from twin.recorders.rerun import layout as layout
from twin.recorders.rerun.bodies import (
    draw_fixtures,
    draw_later,
    draw_object,
    draw_robot,
    move_robot,
    place_object,
    unseen,
)
from twin.recorders.rerun.event_rows import EventBacklog, PlanWords
from twin.recorders.rerun.lanes import RobotNames, draw_lane
from twin.recorders.rerun.layout import entity_path
from twin.run.activities import (
    FAILED,
    IDLE,
    RETRYING,
    STALLED,
    STOPPED,
    WAITING,
    plan_colours,
)
from twin.run.events import Event, EventLogError, Policy
from twin.run.gantt import team_colours
from twin.run.trajectory import Placement, Trajectory
from twin.run.viewer import TIMELINE, live_viewer

_STATES = {
    "waiting": WAITING,
    "stalled": STALLED,
    "stopped": STOPPED,
    "retried": RETRYING,
    "failed": FAILED,
    "finished": IDLE,
}
_QUANTILES = {"P50": (0.5, (47, 111, 178)), "P90": (0.9, (206, 54, 48))}


class LiveRecording(RunListener):
    """Keeps a followed run: motion, objects, events, forecasts, what should not have happened.

    A robot is shown to have moved once it has completed a node.
    """

    def __init__(
        self,
        tpg: TemporalPlanGraph,
        path: Path | None,
        *,
        name: str = "run",
        view: bool = False,
        policy: Policy = "asynchronous",
    ) -> None:
        """Begin a recording.

        Args:
            tpg: what is executed.
            path: of the ``.rrd`` file; None keeps none.
            name: of the recording.
            view: show it in a viewer while it grows.
            policy: how nodes are released.

        Raises:
            OutputError: the file cannot be written.
            ViewerError: there is no viewer, or no display for it.
        """
        self._tpg = tpg
        self._policy = policy
        self._words = PlanWords(with_barriers(tpg) if policy == "synchronous" else tpg)
        self._chain = {chain.robot: k for k, chain in enumerate(tpg.chains)}
        self._handlings: dict[tuple[str, int, int], NodeHandling] = {
            (item.object, item.robot, item.node): item for item in tpg.handlings
        }
        self._objects = {item.name: item for item in tpg.cell.objects}
        self._rec = rr.RecordingStream(
            "assembly-twin", recording_id=f"follow-{name}", make_default=False
        )
        self._rec.set_log_time_enabled(False)
        self._connect(path, view=view)
        self._begin()

    def close(self, run: FollowedRun) -> None:
        """Show all there is, and finish the file."""
        self._now_ns = run.now_ns
        self._flush(ended=True)
        self._rec.flush()
        self._rec.disconnect()

    def event(self, event: Event, run: FollowedRun) -> None:
        """Keep an event and what it says about motion and objects."""
        self._now_ns = run.now_ns
        waits = self._waits(event, run)
        self._events.take(event, waits or event.detail or WAITING)
        chain = self._chain.get(event.robot)
        if chain is None:
            return
        if event.kind == "completed":
            self._moved(chain, run)
        elif event.kind in ("attached", "detached"):
            self._handled(chain, event)
        state = waits or self._state(event)
        if state and self._lane_state.get(event.robot) != state:
            self._lane_state[event.robot] = state
            self._rec.set_time(TIMELINE, duration=np.timedelta64(event.t_ns, "ns"))
            self._rec.log(self._lanes[event.robot], rr.StateChange(state=state))

    def violation(self, violation: ForbiddenEvent) -> None:
        """Keep what should not have happened, as an error among the events."""
        self._rec.set_time(TIMELINE, duration=np.timedelta64(violation.t_ns, "ns"))
        self._rec.log(
            f"{layout.EVENTS}/forbidden",
            rr.TextLog(f"forbidden: {violation.text}", level="ERROR"),
        )

    def unreadable(self, number: int, error: EventLogError) -> None:
        """Keep which line is no event, as a warning among the events."""
        self._rec.log(
            f"{layout.EVENTS}/unreadable",
            rr.TextLog(f"line {number} is no event: {error}", level="WARN"),
        )

    def forecast(self, forecast: Forecast, run: FollowedRun) -> None:
        """Keep a forecast."""
        self._rec.set_time(TIMELINE, duration=np.timedelta64(forecast.t_ns, "ns"))
        for name, (p, _) in _QUANTILES.items():
            value = forecast.quantile(p)
            if not math.isnan(value):
                self._rec.log(entity_path(layout.FORECAST, name), rr.Scalars(value))
        self._flush()

    def waiting(self, run: FollowedRun, silent_s: float) -> None:
        """Show all there is so far."""
        self._flush()

    def _connect(self, path: Path | None, *, view: bool) -> None:
        sinks: list[rr.FileSink | rr.GrpcSink] = []
        try:
            if path is not None:
                path.parent.mkdir(parents=True, exist_ok=True)
                path.write_bytes(b"")
                sinks.append(rr.FileSink(path))
            if view:
                sinks.append(rr.GrpcSink(live_viewer()))
            self._rec.set_sinks(
                *sinks, default_blueprint=layout.follow_layout(self._tpg)
            )
        except OSError as error:
            raise OutputError(f"{path}: cannot be written: {error}") from error

    def _begin(self) -> None:
        """Draw the cell as it is before the run."""
        tpg, rec = self._tpg, self._rec
        draw_fixtures(rec, tpg.cell)
        self._now_ns = 0
        self._events = EventBacklog()
        self._lane_state: dict[str, str] = {}
        self._lanes = {
            chain.robot: draw_lane(
                rec, chain.robot, dict(self._words.lane(k)), plan_colours(tpg)
            )
            for k, chain in enumerate(tpg.chains)
        }
        colours = team_colours([robot.name for robot in tpg.cell.robots])
        self._names = RobotNames(rec, list(colours))
        self._trees = {}
        self._rows: dict[str, list[tuple[Nanoseconds, Array]]] = {}
        for robot in tpg.cell.robots:
            chain = self._chain.get(robot.name)
            q = robot.home if chain is None else tpg.chains[chain].start
            self._trees[robot.name] = draw_robot(rec, robot, colours[robot.name])
            self._rows[robot.name] = [(np.array([0]), q[None])]
        self._drawn: set[str] = set()
        self._placed: set[str] = set()
        self._shown = {chain.robot: 0 for chain in tpg.chains}
        leaving = {h.object for h in tpg.handlings if h.holder == GONE}
        for item in tpg.cell.objects:
            if item.later or item.name in leaving:
                draw_later(rec, item, (0,), (not item.later,))
            else:
                draw_object(rec, item)
            place_object(rec, item.name, [unseen(item)])
        for name, (_, colour) in _QUANTILES.items():
            rec.log(
                entity_path(layout.FORECAST, name),
                rr.SeriesLines(names=[name], colors=[colour]),
                static=True,
            )
        self._flush()

    def _state(self, event: Event) -> str:
        """Return the state of a robot's lane from an event on, empty for no change."""
        if event.kind in ("started", "resumed"):
            return self._words.task(event.task)
        state = _STATES.get(event.kind, "")
        return self._words.state(state, event.task) if state else ""

    def _waits(self, event: Event, run: FollowedRun) -> str:
        """Return what a robot waits for that says it waits, in words; else nothing."""
        if event.kind != "waiting":
            return ""
        chain = self._chain.get(event.robot)
        if chain is None or self._policy == "open-loop":
            return ""
        return self._words.wait(
            chain, event.node, lambda k, n: bool(run.robots[k].end_ns[n] >= 0)
        )

    def _moved(self, k: int, run: FollowedRun) -> None:
        """Keep the motion of the nodes that a robot has completed."""
        chain, robot = self._tpg.chains[k], run.robots[k]
        if chain.robot not in self._rows:
            return  # a machine, which is not drawn
        rows = self._rows[chain.robot]
        for node in range(self._shown[chain.robot], robot.completed):
            end = int(robot.end_ns[node])
            # The clock of a whole node: where in it the robot stood is not told apart.
            start = min(int(robot.start_ns[node] + robot.stood_ns[node]), end)
            own = slice(int(chain.first[node]), int(chain.first[node + 1]))
            passed = np.rint(chain.fraction[own] * (end - start)).astype(np.int64)
            q = np.vstack([rows[-1][1][-1:], chain.waypoints[own]])
            rows.append((np.concatenate([[start], start + passed]), q))
        self._shown[chain.robot] = robot.completed

    def _handled(self, k: int, event: Event) -> None:
        """Hang an object on what holds it now."""
        item = self._handlings.get((event.object, k, event.node))
        if item is None:
            return
        thing = self._objects[event.object]
        if item.holder == GONE:
            draw_later(self._rec, thing, (event.t_ns,), (False,))
            return
        if thing.later and item.holder is None and event.object not in self._drawn:
            draw_later(self._rec, thing, (event.t_ns,), (True,))
        self._drawn.add(event.object)
        placement = Placement(event.t_ns, item.object, item.holder, item.pose)
        place_object(self._rec, item.object, [placement])
        self._names.take(placement)

    def _flush(self, *, ended: bool = False) -> None:
        """Send what has been collected, besides waits that may still become long ones."""
        self._events.send(self._rec, self._words, self._now_ns, ended=ended)
        self._names.send()
        for robot in self._tpg.cell.robots:
            rows = self._rows[robot.name]
            if len(rows) == 1 and robot.name in self._placed:
                continue
            self._placed.add(robot.name)
            t_ns = np.maximum.accumulate(np.concatenate([t for t, _ in rows]))
            q = np.vstack([q for _, q in rows])
            motion = Trajectory(robot.name, t_ns, q, np.full(len(t_ns), -1))
            move_robot(self._rec, self._trees[robot.name], robot, motion)
            self._rows[robot.name] = [(t_ns[-1:], q[-1:])]
