"""The tables of a robot's motions hold what the segments in JSON hold."""

from __future__ import annotations

import csv
import json
from io import StringIO
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from planning.errors import OutputError
from tests.twin.driven_toys import driven_tpg
from tests.twin.exports.exported_runs import exported, toy_run
from twin.trial.run_result import RunResult

Rows = list[dict[str, str]]


@pytest.fixture(params=["limits", "full speed"])
def run(request: pytest.FixtureRequest, tmp_path: Path) -> RunResult:
    smooth = request.param == "limits"
    tpg = driven_tpg(8, tasks=10, edges=20) if smooth else None
    return toy_run(tmp_path, 8, tpg=tpg)[0]


def tables_of(run: RunResult, rate_hz: float | None = None) -> dict[str, Rows]:
    files = exported(run, "joint-csv", rate_hz=rate_hz)
    return {
        name.removeprefix("joints_").removesuffix(".csv"): list(
            csv.DictReader(StringIO(data.decode(), newline=""))
        )
        for name, data in files.items()
    }


def segments_of(run: RunResult, rate_hz: float | None = None) -> list[dict[str, Any]]:
    files = exported(run, "joint-trajectory", rate_hz=rate_hz)
    found: list[dict[str, Any]] = json.loads(files["joint_trajectories.json"])
    return found["segments"]  # type: ignore[call-overload,no-any-return]


def numbers(rows: Rows, letter: str) -> list[list[float]]:
    names = [name for name in rows[0] if name.startswith(f"{letter} ")]
    return [[float(row[name]) for name in names if row[name]] for row in rows]


@pytest.mark.parametrize("rate_hz", [None, 125.0])
def test_rows_are_the_points_of_segments(rate_hz: float | None, run: RunResult) -> None:
    tables = tables_of(run, rate_hz)
    assert set(tables) == {chain.robot for chain in run.tpg.chains}
    done = 0
    for segment in segments_of(run, rate_hz):
        rows = [r for r in tables[segment["robot"]] if r["segment"] == segment["id"]]
        points = segment["joint_trajectory"]["points"]
        stamps = [p["time_from_start"] for p in points]
        assert [float(r["time_from_start [s]"]) for r in rows] == pytest.approx(
            [t["sec"] + t["nanosec"] * 1e-9 for t in stamps], abs=1e-12
        )
        for letter, key in zip(
            "qva", ("positions", "velocities", "accelerations"), strict=True
        ):
            assert numbers(rows, letter) == [p[key] for p in points]
        done += len(rows)
    assert done == sum(map(len, tables.values()))


def test_columns_name_joints_and_units(run: RunResult) -> None:
    smooth = bool(run.smooth_motions)
    for robot, rows in tables_of(run).items():
        model = run.tpg.cell.robot(robot).model
        names = list(rows[0])
        assert names[:2] == ["segment", "time_from_start [s]"]
        assert names[-2:] == ["after", "handlings"]
        units = {"q": "", "v": "/s", "a": "/s^2"}
        wanted = [
            f"{letter} {joint} [{'m' if slides else 'rad'}{per}]"
            for letter, per in units.items()
            if smooth or letter == "q"
            for joint, slides in zip(
                model.joint_names, model.chain.prismatic, strict=True
            )
        ]
        assert names[2:-2] == wanted


def test_the_first_row_of_a_segment_says_what_it_waits_for(run: RunResult) -> None:
    tables = tables_of(run)
    causes = set()
    for segment in segments_of(run):
        rows = [r for r in tables[segment["robot"]] if r["segment"] == segment["id"]]
        said = [
            part.removesuffix(")").split(" (")
            for part in rows[0]["after"].split("; ")
            if part
        ]
        assert said == [[a["segment"], a["cause"]] for a in segment["after"]]
        causes |= {cause for _, cause in said}
        assert len(rows[0]["handlings"].split("; ")) == max(
            len(segment["handlings"]), 1
        )
        for item in segment["handlings"]:
            t = (
                item["time_from_start"]["sec"]
                + item["time_from_start"]["nanosec"] * 1e-9
            )
            whom = f"to {item['holder']}" if item["holder"] else "at rest"
            assert f"{item['object']} {whom} at {t:g} s" in rows[0]["handlings"]
        assert all(not row["after"] and not row["handlings"] for row in rows[1:])
    assert causes == {"same robot", "motion conflict"}


def test_speeds_are_known_where_robots_keep_to_limits(run: RunResult) -> None:
    smooth = bool(run.smooth_motions)
    for rows in tables_of(run).values():
        speeds = numbers(rows, "v")
        assert smooth == bool(speeds and speeds[0])
        assert not smooth or np.max(np.abs(np.array(speeds))) > 0.1


def test_a_rate_that_controllers_do_not_take_is_refused(run: RunResult) -> None:
    with pytest.raises(OutputError, match="50 is not from 125 to 1000"):
        exported(run, "joint-csv", rate_hz=50.0)
