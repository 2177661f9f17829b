"""Live recording of a run in progress for the Rerun viewer."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import rerun as rr

from planning.errors import OutputError
from planning.tasks.task import Handling
from planning.transforms import Array
from scheduling.graph.barriers import with_barriers
from scheduling.graph.temporal_plan_graph import NodeHandling
from twin.activities.activities import FAILED, IDLE, RETRYING, WAITING
from twin.activities.progress import STALLED, STOPPED
from twin.drawing.lane_colours import plan_colours
from twin.drawing.team_colours import team_colours
from twin.durations.nanoseconds import Nanoseconds
from twin.follow.drift import Drift
from twin.follow.follow import News, Silence, UnreadableLine
from twin.follow.forecast import Forecast
from twin.follow.state import FollowedRun, ForbiddenEvent
from twin.rerun import entities
from twin.rerun import layout as layout
from twin.rerun.bodies import (
    RobotNames,
    draw_fixtures,
    draw_object,
    draw_robot,
    draw_temporary_object,
    hidden_placement,
    move_robot,
    place_object,
)
from twin.rerun.entities import entity_path
from twin.rerun.event_rows import EventBacklog
from twin.rerun.plan_descriptions import PlanDescriptions
from twin.rerun.recorder import draw_lane
from twin.rerun.viewer import TIMELINE
from twin.runs.events import Event
from twin.runs.trajectory import Placement, Trajectory

_STATES = {
    "waiting": WAITING,
    "stalled": STALLED,
    "stopped": STOPPED,
    "retried": RETRYING,
    "failed": FAILED,
    "finished": IDLE,
}
_QUANTILES = {"P50": (0.5, (47, 111, 178)), "P90": (0.9, (206, 54, 48))}


class LiveRecording:
    """Records a followed run: motion, objects, events, forecasts, violations.

    A robot is shown to have moved once it has completed a node.
    """

    def __init__(
        self,
        run: FollowedRun,
        path: Path | None,
        *,
        name: str = "run",
        viewer: str | None = None,
    ) -> None:
        """Begin a recording.

        Args:
            run: that is followed.
            path: of the ``.rrd`` file; None keeps none.
            name: of the recording.
            viewer: address of one that shows it while it grows.

        Raises:
            OutputError: the file cannot be written.
        """
        self._run = run
        self._speak_of_plan()
        self._rec = rr.RecordingStream(
            "assembly-twin", recording_id=f"follow-{name}", make_default=False
        )
        self._rec.set_log_time_enabled(False)
        self._connect(path, viewer)
        self._begin()

    def _speak_of_plan(self) -> None:
        """Take tasks, nodes and objects from the current plan."""
        tpg = self._tpg = self._run.tpg
        in_slots = self._run.policy == "synchronous"
        self._words = PlanDescriptions(with_barriers(tpg) if in_slots else tpg)
        self._chain = {chain.robot: k for k, chain in enumerate(tpg.chains)}
        self._handlings: dict[tuple[str, int, int], NodeHandling] = {
            (item.object, item.robot, item.node): item for item in tpg.handlings
        }
        self._objects = {item.name: item for item in tpg.cell.objects}

    def _take_version(self) -> None:
        """Continue with a plan revision, and draw its additions to the cell."""
        known = self._objects.keys()
        self._speak_of_plan()
        for chain in self._tpg.chains:
            self._shown.setdefault(chain.robot, 0)
        self._draw_lanes()
        for item in self._tpg.cell.objects:
            if item.name not in known:
                draw_temporary_object(self._rec, item, (0,), (False,))
                place_object(self._rec, item.name, [hidden_placement(item)])

    def _draw_lanes(self) -> None:
        self._lanes = {
            chain.robot: draw_lane(
                self._rec,
                chain.robot,
                dict(self._words.lane(k)),
                plan_colours(self._tpg),
            )
            for k, chain in enumerate(self._tpg.chains)
        }

    def __call__(self, news: News) -> None:
        """Record news; buffered rows are written at a forecast or a silence."""
        match news:
            case Event():
                self._keep(news)
            case ForbiddenEvent():
                self._at(news.t_ns)
                self._say("forbidden", f"forbidden: {news.text}", "ERROR")
            case UnreadableLine():
                text = f"line {news.number} is no event: {news.error}"
                self._say("unreadable", text, "WARN")
            case Forecast():
                self._at(news.t_ns)
                for name, (p, _) in _QUANTILES.items():
                    value = news.quantile(p)
                    if not math.isnan(value):
                        entity = entity_path(entities.FORECAST, name)
                        self._rec.log(entity, rr.Scalars(value))
                self._flush()
            case Drift():
                self._say("drift", f"drift: {news.words}", "WARN")
            case Silence():
                self._flush()
            case FollowedRun():
                self._flush(ended=True)
                self._rec.flush()
                self._rec.disconnect()

    def _at(self, t_ns: int) -> None:
        """Set the time of following rows [ns]."""
        self._rec.set_time(TIMELINE, duration=np.timedelta64(t_ns, "ns"))

    def _say(self, name: str, text: str, level: str) -> None:
        """Record a sentence among the events."""
        self._rec.log(f"{entities.EVENTS}/{name}", rr.TextLog(text, level=level))

    def _keep(self, event: Event) -> None:
        """Record an event with its motion and objects."""
        if event.kind == "replanned" and self._tpg is not self._run.tpg:
            self._take_version()
        waits = self._waits(event)
        self._events.take(event, waits or event.detail or WAITING)
        chain = self._chain.get(event.robot)
        if chain is None:
            return
        if event.kind == "completed":
            self._moved(chain)
        elif event.kind in ("attached", "detached"):
            self._handled(chain, event)
        state = waits or self._state(event)
        if state and self._lane_state.get(event.robot) != state:
            self._lane_state[event.robot] = state
            self._at(event.t_ns)
            self._rec.log(self._lanes[event.robot], rr.StateChange(state=state))

    def _connect(self, path: Path | None, viewer: str | None) -> None:
        sinks: list[rr.FileSink | rr.GrpcSink] = []
        try:
            if path is not None:
                path.parent.mkdir(parents=True, exist_ok=True)
                path.write_bytes(b"")
                sinks.append(rr.FileSink(path))
            if viewer is not None:
                sinks.append(rr.GrpcSink(viewer))
            self._rec.set_sinks(
                *sinks, default_blueprint=layout.follow_layout(self._tpg)
            )
        except OSError as error:
            raise OutputError(f"{path}: cannot be written: {error}") from error

    def _begin(self) -> None:
        """Draw the cell before the run."""
        tpg, rec = self._tpg, self._rec
        draw_fixtures(rec, tpg.cell)
        self._events = EventBacklog()
        self._lane_state: dict[str, str] = {}
        self._draw_lanes()
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
        leaving = {h.object for h in tpg.handlings if h.holder == Handling.GONE}
        for item in tpg.cell.objects:
            if item.later or item.name in leaving:
                draw_temporary_object(rec, item, (0,), (not item.later,))
            else:
                draw_object(rec, item)
            place_object(rec, item.name, [hidden_placement(item)])
        for name, (_, colour) in _QUANTILES.items():
            rec.log(
                entity_path(entities.FORECAST, name),
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

    def _waits(self, event: Event) -> str:
        """Return the cause of a wait event as text; empty for other events."""
        chain = self._chain.get(event.robot)
        waits = event.kind == "waiting" and self._run.policy != "open-loop"
        if chain is None or not waits:
            return ""
        robots = self._run.robots
        return self._words.wait(
            chain, event.node, lambda k, n: bool(robots[k].end_ns[n] >= 0)
        )

    def _moved(self, k: int) -> None:
        """Record the motion of a robot's completed nodes."""
        chain, robot = self._tpg.chains[k], self._run.robots[k]
        if chain.robot not in self._rows:
            return  # a machine, which is not drawn
        rows = self._rows[chain.robot]
        for node in range(self._shown[chain.robot], robot.completed):
            end = int(robot.end_ns[node])
            # Standstills are spread over the whole node.
            start = min(int(robot.start_ns[node] + robot.stood_ns[node]), end)
            own = slice(int(chain.first[node]), int(chain.first[node + 1]))
            passed = np.rint(chain.fraction[own] * (end - start)).astype(np.int64)
            q = np.vstack([rows[-1][1][-1:], chain.waypoints[own]])
            rows.append((np.concatenate([[start], start + passed]), q))
        self._shown[chain.robot] = robot.completed

    def _handled(self, k: int, event: Event) -> None:
        """Attach an object to its parent."""
        item = self._handlings.get((event.object, k, event.node))
        if item is None:
            return
        thing = self._objects[event.object]
        if item.holder == Handling.GONE:
            draw_temporary_object(self._rec, thing, (event.t_ns,), (False,))
            return
        if thing.later and item.holder is None and event.object not in self._drawn:
            draw_temporary_object(self._rec, thing, (event.t_ns,), (True,))
        self._drawn.add(event.object)
        placement = Placement(event.t_ns, item.object, item.holder, item.pose)
        place_object(self._rec, item.object, [placement])
        self._names.take(placement)

    def _flush(self, *, ended: bool = False) -> None:
        """Send the buffered rows, except waits of unknown length."""
        self._events.send(self._rec, self._words, self._run.now_ns, ended=ended)
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
