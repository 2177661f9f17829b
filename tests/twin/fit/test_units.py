"""Units of measured durations: from names of columns, from an option, and contradictions."""

from pathlib import Path

import numpy as np
import pytest

from planning.errors import ScenarioError
from tests.twin import program
from twin.durations.measured import Empirical, MeasuredTimes
from twin.durations.timing_files import read_durations, split_unit
from twin.fit.samples import read_samples

SECONDS = {"ns": 1e-9, "us": 1e-6, "ms": 1e-3, "s": 1.0, "min": 60.0, "h": 3600.0}
TIMES = np.random.default_rng(1).gamma(20.0, 0.2, 12)


def table(path: Path, column: str, values: np.typing.ArrayLike) -> Path:
    lines = (f"pick,{value!r}" for value in np.asarray(values).tolist())
    path.write_text("\n".join((f"skill,{column}", *lines)) + "\n", encoding="utf-8")
    return path


@pytest.mark.parametrize(
    ("name", "stem", "unit"),
    [
        ("cycle_time_ms", "cycle_time", "ms"),
        ("cycle time [ms]", "cycle time", "ms"),
        ("Cycle Time (Min)", "cycle time", "min"),
        ("cycleTimeMs", "cycle_time", "ms"),
        ("t/h", "t", "h"),
        ("dauer [µs]", "dauer", "us"),
        ("time-seconds", "time", "s"),
        ("seconds", "", "s"),
        ("stamp.ns", "stamp", "ns"),
        ("duration", "duration", None),
        ("items", "items", None),
        ("rooms", "rooms", None),
        ("length_mm", "length_mm", None),
        ("MS", "", "ms"),
        ("robots", "robots", None),
        ("", "", None),
    ],
)
def test_names_end_with_units(name: str, stem: str, unit: str | None) -> None:
    assert split_unit(name) == (stem, unit)


@pytest.mark.parametrize("unit", SECONDS)
@pytest.mark.parametrize("form", ["took_{}", "took [{}]", "took"])
def test_all_units_give_the_same_seconds(tmp_path: Path, unit: str, form: str) -> None:
    column = form.format(unit)
    path = table(tmp_path / "t.csv", column, TIMES / SECONDS[unit])
    given = unit if form == "took" else None
    found = [value for _, value in read_durations(path, column, unit=given)]
    assert found == pytest.approx(TIMES.tolist(), rel=1e-12)
    assert read_durations(path, column, unit=unit) == read_durations(
        path, column, unit=given
    )
    model = Empirical.model_validate({"csv": "t.csv", "column": column, "unit": given})
    located = model.located(tmp_path)
    assert isinstance(located, MeasuredTimes)
    assert located.values_s == pytest.approx(np.sort(TIMES))
    if given is None:
        other = "min" if unit == "ms" else "ms"
        with pytest.raises(ScenarioError, match=f"'{other}'.*'{unit}'"):
            read_durations(path, column, unit=other)


def test_stamps_have_units_and_times_of_day_have_their_own(tmp_path: Path) -> None:
    path = tmp_path / "t.csv"
    path.write_text("start_ms,end_ms,end_s,from,to\n1500,4000,4,09:00,x\n")
    assert read_durations(path, ("start_ms", "end_ms")) == [((), 2.5)]
    with pytest.raises(ScenarioError, match=r"says 'ms'.*says 's'"):
        read_durations(path, ("start_ms", "end_s"))
    path.write_text("start_s,end_s\n2026-01-01T09:00:00,2026-01-01T09:00:07\n")
    assert read_durations(path, ("start_s", "end_s")) == [((), 7.0)]


def test_a_minimum_beside_a_maximum_has_no_unit(tmp_path: Path) -> None:
    path = tmp_path / "t.csv"
    path.write_text("Time_min,time_max\n2,3\n")
    assert read_durations(path, "Time_min") == [((), 2.0)]
    assert read_durations(path, "Time_min", unit="ms") == [((), 0.002)]
    path.write_text("Time_min\n2\n")
    assert read_durations(path, "Time_min") == [((), 120.0)]


def test_a_duration_in_any_unit_is_found_without_its_name(tmp_path: Path) -> None:
    for column, factor in (("duration_ms", 1e3), ("Duration [min]", 1 / 60)):
        path = table(tmp_path / "t.csv", column, TIMES * factor)
        ((sample,), _) = read_samples([path], by=("skill",))
        assert sample.values_s == pytest.approx(TIMES)


@pytest.mark.parametrize(
    ("column", "factor", "options", "says", "code"),
    [
        ("took_ms", 1e3, (), ["'took_ms' is read in ms"], 0),
        ("took_s", 1.0, (), [], 0),
        ("took", 1.0, (), ["has no unit", "read in s", "--unit"], 0),
        ("took", 1e3, (), ["warning: pick", "what is usual", "--unit"], 0),
        ("took", 1e3, ("--unit", "ms"), ["read in ms"], 0),
        ("took_h", 1.0, (), ["warning: pick", "what is usual", "--unit"], 0),
        ("took_ms", 0.1, (), ["warning: pick", "what is usual", "--unit"], 0),
        ("took_ms", 1e3, ("--unit", "s"), ["which unit", "'s'", "'ms'"], 2),
        ("took", 1.0, ("--unit", "days"), ["'days'", "valid: s, ms"], 2),
    ],
)
def test_fit_says_what_it_reads(
    tmp_path: Path,
    column: str,
    factor: float,
    options: tuple[str, ...],
    says: list[str],
    code: int,
) -> None:
    # A median of 4 s: in milliseconds some 4000.
    path = table(tmp_path / "t.csv", column, TIMES * factor)
    out = tmp_path / "out"
    done = program.invoke(
        *("fit", path, "--column", column, "--by", "skill", "--resamples", "19"),
        *("--json", "--out", out, *options),
        code=code,
    )
    for words in says:
        assert words in done.stderr
    if not says:
        assert "unit" not in done.stderr
    assert out.exists() == (code == 0)


def test_logs_have_no_unit_to_say(tmp_path: Path) -> None:
    with pytest.raises(ScenarioError, match="--unit"):
        read_samples([tmp_path], unit="ms")
