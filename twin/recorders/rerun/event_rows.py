"""Event rows of a recording: each as a sentence for people, and as columns for programs.

Words for what robots do and wait for: each task with its part and step, waits with whom.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence

import numpy as np
import pyarrow as pa
import rerun as rr

from planning.tasks.task import CLOSE, OPEN, TRANSIT, Task
from scheduling.graph.temporal_plan_graph import TemporalPlanGraph
from twin.durations.model import NANOSECONDS
from twin.recorders.rerun import layout as layout
from twin.recorders.rerun.layout import time_column
from twin.run.activities import HOLDING, IDLE, RETRYING, TOLD, WAITING, part_names
from twin.run.events import Event

_VERBS = {
    RETRYING: "tries again",
    HOLDING: "stays",
    CLOSE: "tool closes",
    OPEN: "tool opens",
}


class PlanWords:
    """Says what the tasks of a plan are, and which tasks of others a node waits for."""

    def __init__(self, tpg: TemporalPlanGraph) -> None:
        """Speak of a plan.

        Args:
            tpg: the plan; with the barriers of its slots where these are waited for.
        """
        self._tpg = tpg
        self._steps = max((task.step for task in tpg.tasks), default=0)
        self._part = part_names(tpg)
        self._sources: dict[tuple[int, int], list[tuple[int, int]]] = {}
        for before, source, after, target in tpg.edges.tolist():
            self._sources.setdefault((after, target), []).append((before, source))
        self._tasks = [self._describe(task) for task in tpg.tasks]

    def task(self, task: int) -> str:
        """Return what a task is about: what is done, with which part, in which step.

        There is nothing to be said of a task that the plan does not have.
        """
        return self._tasks[task] if 0 <= task < len(self._tasks) else ""

    def is_skill(self, task: int) -> bool:
        """Tell whether the plan has a task and it is more than a transit."""
        return 0 <= task < len(self._tasks) and self._tpg.tasks[task].kind != TRANSIT

    def state(self, state: str, task: int) -> str:
        """Return what a robot does in a state of its lane, a wait apart."""
        words = self.task(task)
        if not words or state == IDLE:
            return state
        return f"{_VERBS.get(state, state)}: {words}" if state in TOLD else words

    def wait(self, chain: int, node: int, complete: Callable[[int, int], bool]) -> str:
        """Return whom a node waits for, and for what of theirs; empty when it is nobody.

        Args:
            chain: whose node.
            node: that waits.
            complete: tells whether a node of a chain is complete.
        """
        left = [
            source
            for source in self._sources.get((chain, node), ())
            if not complete(*source)
        ]
        if not left:
            return ""
        chain, last = left[-1]
        more = any(other != chain for other, _ in left)
        return self._wait(*self._owner(chain, last), more=more)

    def lane(self, chain: int) -> Iterator[tuple[str, str]]:
        """Yield everything that the lane of a robot may say, each with its state."""
        yield IDLE, IDLE
        yield WAITING, WAITING
        for task in dict.fromkeys(self._tpg.chains[chain].task.tolist()):
            yield self._tasks[task], self._tpg.tasks[task].kind
            for state in sorted(TOLD):
                yield self.state(state, task), state
        waited = {
            self._owner(*source)
            for (own, _), sources in self._sources.items()
            if own == chain
            for source in sources
        }
        for robot, task in sorted(waited):
            for more in (False, True):
                yield self._wait(robot, task, more=more), WAITING

    def _owner(self, chain: int, node: int) -> tuple[int, int]:
        return chain, int(self._tpg.chains[chain].task[node])

    def _wait(self, chain: int, task: int, *, more: bool) -> str:
        others = " and others" if more else ""
        robot = self._tpg.chains[chain].robot
        return f"waits for {robot}{others}: {self._tasks[task]}"

    def _describe(self, task: Task) -> str:
        words = task.label.removesuffix(f" step {task.step}")
        part = self._part[task.index]
        if part != f"step {task.step}":
            if task.kind == TRANSIT and task.object and words == f"to {part}":
                words = f"{part} to its place"
            elif part not in words:
                words += f" {'after' if words == 'HOME' else 'for'} {part}"
        return f"{words} (step {task.step}/{self._steps})"


LONG_WAIT_NS = NANOSECONDS // 2
"""A shorter wait is no warning [ns]: robots that pass each other wait so all the time."""

_QUIET, _SHOWN, _WARNING, _ERROR = "DEBUG", "INFO", "WARN", "ERROR"
_LEVELS = {
    "released": _QUIET,
    "stalled": _WARNING,
    "retried": _WARNING,
    "window_broken": _WARNING,
    "failed": _ERROR,
    "replanned": _WARNING,
    "stopped": _ERROR,
}


def long_waits(events: Sequence[Event], end_ns: int) -> dict[int, bool | None]:
    """Return of each event that tells of a wait, by its place, whether that is a long one.

    Args:
        events: of a run, or a part of it.
        end_ns: until when all is known [ns]; a wait that is short until then is None.
    """
    found: dict[int, bool | None] = {}
    waiting: dict[str, list[int]] = {}
    for k, event in enumerate(events):
        if event.kind == "waiting":
            waiting.setdefault(event.robot, []).append(k)
        elif event.kind == "started":
            for place in waiting.pop(event.robot, ()):
                found[place] = event.t_ns - events[place].t_ns >= LONG_WAIT_NS
    for places in waiting.values():
        for place in places:
            found[place] = end_ns - events[place].t_ns >= LONG_WAIT_NS or None
    return found


class EventBacklog:
    """Event rows, as text for people and as columns for programs.

    Those of a run that goes on are kept back until it is known which waits become long ones.
    """

    def __init__(self) -> None:
        """Begin without any."""
        self._events: list[tuple[Event, str]] = []
        self._held = set[str]()

    def take(self, event: Event, waits: str) -> None:
        """Take note of an event and, where it tells of a wait, what for in words."""
        self._events.append((event, waits))

    def send(
        self, rec: rr.RecordingStream, words: PlanWords, now_ns: int, *, ended: bool
    ) -> None:
        """Write what is known at a time [ns], all there is once the run has ended."""
        long = long_waits([event for event, _ in self._events], now_ns)
        later = {k for k, known in long.items() if known is None and not ended}
        events, sentences, levels = [], [], []
        for k, (event, waits) in enumerate(self._events):
            if k in later:
                continue
            events.append(event)
            if k in long:
                sentences.append(f"{event.robot} {waits}")
                levels.append(_WARNING if long[k] else _QUIET)
            else:
                taken = self._takes(event)
                sentences.append(_sentence(words, event, taken=taken))
                levels.append(_level(words, event))
        self._events = [self._events[k] for k in sorted(later)]
        if not events:
            return
        keys = ("robot", "kind", "task", "node", "object", "detail")
        values = {
            key: _column([getattr(event, key) for event in events]) for key in keys
        }
        rec.send_columns(
            layout.EVENTS,
            indexes=[time_column([event.t_ns for event in events])],
            columns=[
                *rr.TextLog.columns(text=sentences, level=levels),
                *rr.AnyValues.columns(**values),
            ],
        )

    def _takes(self, event: Event) -> bool:
        """Keep who holds what; return whether a robot takes what nobody held."""
        if event.kind == "detached":
            self._held.discard(event.object)
        if event.kind != "attached" or event.object in self._held:
            return False
        self._held.add(event.object)
        return True


def _column(values: Sequence[str] | Sequence[int]) -> pa.Array:
    """Return one value a row, as Rerun makes it of any sequence, in a tenth of the time."""
    rows = np.arange(len(values) + 1, dtype=np.int32)
    return pa.ListArray.from_arrays(rows, pa.array(values))


def _level(words: PlanWords, event: Event) -> str:
    """Return the level of an event: single nodes of a motion are too many to show."""
    if event.kind in ("started", "completed"):
        return _SHOWN if words.is_skill(event.task) else _QUIET
    return _LEVELS.get(event.kind, _SHOWN)


def _sentence(words: PlanWords, event: Event, *, taken: bool) -> str:
    if not event.robot:
        return f"run {event.kind}: {event.detail}"
    if taken:
        return f"{event.robot} holds {event.object}"
    if event.kind in ("attached", "detached"):
        return f"{event.robot}: {event.object} {event.detail}"
    said = f"{event.robot} {event.kind} {words.task(event.task)}".rstrip()
    return f"{said}: {event.detail}" if event.detail else said
