"""Export of joint motions for robot controllers as CSV, with one file per robot and one row per trajectory point."""

from __future__ import annotations

import csv
from collections.abc import Iterator, Mapping
from io import StringIO
from itertools import groupby

from planning.tasks.task import Handling
from twin.durations.nanoseconds import NANOSECONDS
from twin.exports.segments import (
    CONTROLLER_RATE_HZ,
    CONTROLLER_RATES_HZ,
    Segment,
    SegmentHandling,
    require_rate,
    segments,
)
from twin.trial.run_result import RunResult


def joint_csv_files(
    run: RunResult, *, rate_hz: float = CONTROLLER_RATE_HZ
) -> Mapping[str, bytes]:
    """Return ``joints_<robot>.csv`` for every robot with work; see ``joint_trajectory_files``."""
    require_rate(rate_hz, CONTROLLER_RATES_HZ)
    out = {}
    for robot, own in groupby(segments(run, rate_hz), lambda segment: segment.robot):
        smooth = robot in run.smooth_motions
        text = StringIO(newline="")
        writer = csv.writer(text)
        writer.writerow(_header(run, robot, smooth))
        for segment in own:
            writer.writerows(_rows(segment, smooth))
        out[f"joints_{robot}.csv"] = text.getvalue().encode()
    return out


def _header(run: RunResult, robot: str, smooth: bool) -> list[str]:
    """Return the names of the columns; speeds and accelerations only where they are known."""
    model = run.tpg.cell.robot(robot).model
    units = ["m" if slides else "rad" for slides in model.chain.prismatic]
    found = ["segment", "time_from_start [s]"]
    for letter, per in zip("qva" if smooth else "q", ("", "/s", "/s^2"), strict=False):
        found += [
            f"{letter} {name} [{unit}{per}]"
            for name, unit in zip(model.joint_names, units, strict=True)
        ]
    return [*found, "after", "handlings"]


def _rows(segment: Segment, smooth: bool) -> Iterator[list[object]]:
    after = "; ".join(f"{item.segment} ({item.cause})" for item in segment.after)
    handlings = "; ".join(_said(item) for item in segment.handlings)
    empty = [""] * segment.q.shape[1] * (2 * smooth)
    for k, t_ns in enumerate(segment.t_ns.tolist()):
        rates: list[object] = list(empty)
        if segment.v is not None and segment.a is not None:
            rates = [*segment.v[k].tolist(), *segment.a[k].tolist()]
        said = [after, handlings] if k == 0 else ["", ""]
        yield [segment.id, t_ns / NANOSECONDS, *segment.q[k].tolist(), *rates, *said]


def _said(item: SegmentHandling) -> str:
    """Return a transferred object, its new holder and the time [s]."""
    to = {None: "at rest", Handling.GONE: "gone"}.get(item.holder, f"to {item.holder}")
    return f"{item.object} {to} at {item.t_ns / NANOSECONDS:g} s"
