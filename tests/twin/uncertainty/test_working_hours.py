"""Calendars, planned stops, and breakdowns with any distribution."""

from math import factorial

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.twin.twin_toys import two_robot_tpg
from twin.durations.bounded import Fixed, Uniform
from twin.uncertainty.disturbances import Breakdowns, Disturbances
from twin.uncertainty.repair_crew import CrewSource, RepairCrew
from twin.uncertainty.stop import Stop
from twin.uncertainty.stop_times import (
    NEVER,
    PeriodicSource,
    Stops,
    StopSource,
    draw_stops,
)
from twin.uncertainty.working_hours import (
    DAYS,
    WEEK_S,
    Calendar,
    Day,
    PlannedStop,
    Shift,
)

HOUR = 3600.0
NS = 10**9
TIMES = st.integers(0, 23).map(lambda h: f"{h:02}:30")
SHIFTS = st.builds(
    lambda days, start, end: (days, start, end),
    st.lists(st.sampled_from(DAYS), min_size=1, unique=True).map(tuple),
    TIMES,
    TIMES,
).filter(lambda shift: shift[1] != shift[2])


@settings(max_examples=40, deadline=None)
@given(st.lists(SHIFTS, min_size=1, max_size=4), st.sampled_from(DAYS), TIMES)
def test_off_shift_is_whatever_no_shift_covers(
    shifts: list[tuple[tuple[Day, ...], str, str]], day: str, time: str
) -> None:
    """Oracle: each quarter of an hour of a week, looked up in all shifts."""
    sections = tuple(Shift(days=d, start=a, end=b) for d, a, b in shifts)
    calendar = Calendar(begins=f"{day} {time}", shifts=sections)
    begins = DAYS.index(day) * 24 + int(time[:2]) + 0.5

    def works(hours: float) -> bool:
        at = (begins + hours) % 168
        for days, start, end in shifts:
            first, last = int(start[:2]) + 0.5, int(end[:2]) + 0.5
            length = (last - first) % 24
            for own in days:
                since = (at - DAYS.index(own) * 24 - first) % 168
                if since < length:
                    return True
        return False

    off = calendar.off_shift("left")
    source = PeriodicSource(off, WEEK_S, ("off-shift", ""), before=True)
    stops = Stops([], [source] if off else [])
    for hours in np.arange(0.125, 400.0, 2.75):
        t = int(hours * 3600 * NS)
        assert (stops.after(t) == t) == works(hours)


def test_who_is_named_by_no_shift_works_all_the_time() -> None:
    shift = Shift(days=("Mon",), start="06:00", end="14:00", who=("left",))
    calendar = Calendar(begins="Mon 06:00", shifts=(shift,))
    assert calendar.off_shift("right") == []
    assert calendar.off_shift("left") == [(8 * HOUR, WEEK_S)]


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 3), st.integers(0, 5000), st.booleans())
def test_edges_of_several_sources_are_found_in_order(
    seed: int, at: int, fixed: bool
) -> None:
    """Each begin and end of a stop is found, however far the sources are known."""

    def fresh() -> Stops:
        breaks = Breakdowns(
            mtbf=Uniform(low_s=5, high_s=40), mttr=Fixed(value_s=7), clock="run"
        )
        sources: list[StopSource] = [
            CrewSource(RepairCrew(1, {"left": breaks}, seed, 0), "left"),
            PeriodicSource([(3.0, 5.0), (50.0, 55.0)], 100.0, ("planned", "")),
        ]
        return Stops(
            [Stop(3000 * NS, 3001 * NS, "planned", "")] if fixed else [], sources
        )

    known = fresh()
    known.after(10_000 * NS)
    t = at * NS
    edges = {e for s in known.until(9000 * NS) for e in (s.start_ns, s.end_ns)}
    assert fresh().next_edge(t) == min(e for e in edges if e > t)
    start, end = fresh().stop_after(t)
    spans = known.intervals(9000 * NS)
    assert (start, end) == next(span for span in spans if span[1] > t)


def test_availability_by_the_clock_is_that_of_the_renewal_theorem() -> None:
    breaks = Breakdowns(
        mtbf=Uniform(low_s=10, high_s=50),
        mttr=Uniform(low_s=0, high_s=20),
        clock="run",
    )
    until = 200_000 * NS
    stops = Stops([], [CrewSource(RepairCrew(1, {"left": breaks}, 1, 0), "left")])
    down = stops.stopped_between(0, until) / until
    assert down == pytest.approx(10 / 40, rel=0.02)
    assert stops.next_edge(until) < NEVER


def test_planned_stops_and_shifts_are_those_of_each_robot() -> None:
    tpg = two_robot_tpg([])
    first, second = (chain.robot for chain in tpg.chains)
    shift = Shift(days=("Mon",), start="06:00", end="06:10")
    own = Disturbances(
        planned_stops=(
            PlannedStop(at_s=10, duration_s=5, who=(first,)),
            PlannedStop(at_s=100, duration_s=1, every_s=50),
        ),
        calendar=Calendar(begins="Mon 06:00", shifts=(shift,)),
    )
    stops = draw_stops(tpg, own, seed=0)
    assert stops is not None
    one, other = (found.intervals(200 * NS) for found in stops)
    assert other == ((100 * NS, 101 * NS), (150 * NS, 151 * NS)), second
    assert one == ((10 * NS, 15 * NS), *other)
    # At the end of the week it is Monday again, and a planned stop of 1 s begins.
    assert stops[0].after(700 * NS) == int(WEEK_S + 1) * NS


def test_a_crew_that_is_large_enough_changes_nothing() -> None:
    breaks = Breakdowns(mtbf_s=20, mttr_s=8, clock="run")
    names = ("left", "right", "mill")
    crew = RepairCrew(3, dict.fromkeys(names, breaks), 2, 5)
    for name in names:
        alone = Stops([], [CrewSource(RepairCrew(1, {name: breaks}, 2, 5), name)])
        shared = Stops([], [CrewSource(crew, name)])
        assert shared.intervals(5000 * NS) == alone.intervals(5000 * NS)


def test_machine_interference_agrees_with_its_formula() -> None:
    """Machine repair model M/M/1//3: the mean number of machines that are down."""
    breaks = Breakdowns(mtbf_s=30, mttr_s=20, clock="run")
    names = ("one", "two", "three")
    crew = RepairCrew(1, dict.fromkeys(names, breaks), 7, 0)
    until = 300_000 * NS
    down = [
        Stops([], [CrewSource(crew, name)]).stopped_between(0, until) / until
        for name in names
    ]
    ratio = 20.0 / 30.0
    weights = [ratio**k * factorial(3) / factorial(3 - k) for k in range(4)]
    expected = sum(k * w for k, w in enumerate(weights)) / sum(weights)
    assert sum(down) == pytest.approx(expected, rel=0.02)
