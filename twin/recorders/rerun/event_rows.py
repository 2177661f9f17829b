"""Event rows of a recording: each as a sentence for people, and as columns for programs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
import pyarrow as pa
import rerun as rr

from twin.durations import NANOSECONDS
from twin.recorders.rerun import layout as layout
from twin.recorders.rerun.time_and_pose import time_column
from twin.recorders.rerun.words import PlanWords
from twin.run.events import Event

LONG_WAIT_NS = NANOSECONDS // 2
"""A shorter wait is no warning [ns]: robots that pass each other wait so all the time."""

_QUIET, _SHOWN, _WARNING, _ERROR = "DEBUG", "INFO", "WARN", "ERROR"
_LEVELS = {
    "released": _QUIET,
    "stalled": _WARNING,
    "retried": _WARNING,
    "failed": _ERROR,
    "stopped": _ERROR,
}


class Wait(NamedTuple):
    """Words for an event that tells of a wait.

    Attributes:
        words: what for.
        long: whether it lasts long.
    """

    words: str
    long: bool


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


def log_events(
    rec: rr.RecordingStream,
    words: PlanWords,
    events: Sequence[Event],
    waits: Mapping[int, Wait],
) -> None:
    """Keep event rows, as text for people and as columns for programs.

    Args:
        rec: the recording.
        words: for the plan.
        events: what happened, in order.
        waits: what to say of those of kind ``waiting``, by their place in ``events``.
    """
    if not events:
        return
    sentences = [_sentence(words, event) for event in events]
    levels = [_level(words, event) for event in events]
    for place, wait in waits.items():
        sentences[place] = f"{events[place].robot} {wait.words}"
        levels[place] = _WARNING if wait.long else _QUIET
    rec.send_columns(
        layout.EVENTS,
        indexes=[time_column([event.t_ns for event in events])],
        columns=[
            *rr.TextLog.columns(text=sentences, level=levels),
            *rr.AnyValues.columns(
                robot=_column([event.robot for event in events]),
                kind=_column([event.kind for event in events]),
                task=_column([event.task for event in events]),
                node=_column([event.node for event in events]),
                object=_column([event.object for event in events]),
                detail=_column([event.detail for event in events]),
            ),
        ],
    )


def _column(values: Sequence[str] | Sequence[int]) -> pa.Array:
    """Return one value a row, as Rerun makes it of any sequence, in a tenth of the time."""
    rows = np.arange(len(values) + 1, dtype=np.int32)
    return pa.ListArray.from_arrays(rows, pa.array(values))


def _level(words: PlanWords, event: Event) -> str:
    """Return the level of an event: single nodes of a motion are too many to show."""
    if event.kind in ("started", "completed"):
        return _SHOWN if words.is_skill(event.task) else _QUIET
    return _LEVELS.get(event.kind, _SHOWN)


def _sentence(words: PlanWords, event: Event) -> str:
    if not event.robot:
        return f"run {event.kind}: {event.detail}"
    if event.detail == f"to {event.robot}":
        return f"{event.robot} holds {event.object}"
    if event.kind in ("attached", "detached"):
        return f"{event.robot}: {event.object} {event.detail}"
    said = f"{event.robot} {event.kind} {words.task(event.task)}".rstrip()
    return f"{said}: {event.detail}" if event.detail else said


class EventBacklog:
    """Events of a run that goes on, kept back until it is known which waits become long ones."""

    def __init__(self) -> None:
        """Begin without any."""
        self._events: list[tuple[Event, str]] = []

    def take(self, event: Event, waits: str) -> None:
        """Take note of an event and, where it tells of a wait, what for in words."""
        self._events.append((event, waits))

    def send(
        self, rec: rr.RecordingStream, words: PlanWords, now_ns: int, *, ended: bool
    ) -> None:
        """Write what is known at a time [ns], all there is once the run has ended."""
        long = long_waits([event for event, _ in self._events], now_ns)
        unknown = {k for k, known in long.items() if known is None and not ended}
        told = [k for k in range(len(self._events)) if k not in unknown]
        waits = {
            place: Wait(self._events[k][1], bool(long[k]))
            for place, k in enumerate(told)
            if k in long
        }
        log_events(rec, words, [self._events[k][0] for k in told], waits)
        self._events = [self._events[k] for k in sorted(unknown)]
