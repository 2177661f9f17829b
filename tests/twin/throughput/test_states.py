"""Time of robots and machines by state, against a look at every instant."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from planning.tasks.task import Task, TaskKind
from scheduling.graph.temporal_plan_graph import MOTION_CONFLICT, TemporalPlanGraph
from tests.twin.drawn_runs import VARIED
from tests.twin.simulated import simulate
from tests.twin.throughput.queues import Service, line_tpg
from tests.twin.twin_toys import random_tpg
from twin.durations.bounded import Fixed, Uniform
from twin.runs.execution_record import ExecutionRecord
from twin.throughput.states import (
    STATES,
    State,
    run_worker_times,
    worker_chains,
    worker_times,
)
from twin.uncertainty.disturbances import (
    Breakdowns,
    Disturbances,
    EmergencyStop,
    SkillFailure,
    Stalls,
)
from twin.uncertainty.stop_times import draw_stops
from twin.uncertainty.working_hours import Calendar, PlannedStop, Shift

SECOND = 10**9
OF_STOP = {
    "off-shift": State.OFF_SHIFT,
    "planned": State.PLANNED,
    "breakdown": State.DOWN,
    "emergency": State.STOPPED,
}
KINDS = (
    *("arrive", "leave", "pick", "place-down", "transit", "leave-tool", "glue"),
    TaskKind.CHANGEOVER,
)
CLOCK = Disturbances(
    breakdowns=Breakdowns(
        mtbf=Uniform(low_s=2, high_s=9), mttr=Fixed(value_s=1.5), clock="run"
    ),
    planned_stops=(PlannedStop(at_s=1, duration_s=0.7, every_s=4),),
    emergency_stops=(EmergencyStop(at_s=2.2, duration_s=2.0),),
    calendar=Calendar(
        begins="Mon 06:00",
        shifts=(
            Shift(days=("Mon",), start="05:00", end="06:00", who=("robot_1",)),
            Shift(days=("Mon",), start="06:01", end="08:00", who=("robot_1",)),
        ),
    ),
)


def varied_kinds(tpg: TemporalPlanGraph, seed: int) -> TemporalPlanGraph:
    """Return a graph with tasks of all kinds, and dependencies besides conflicts."""
    rng = np.random.default_rng(seed)
    tasks = tuple(
        replace(task, kind=str(rng.choice(KINDS)), object=f"x{rng.integers(2)}")
        for task in tpg.tasks
    )
    cause = rng.integers(0, 2, len(tpg.edges)).astype(np.uint8)
    return replace(tpg, tasks=tasks, cause=cause)


def oracle(
    tpg: TemporalPlanGraph, run: ExecutionRecord, chain: int, own: Disturbances
) -> dict[State, int]:
    """Return the time of a robot in each state, looked at between all changes [ns]."""
    stops = (draw_stops(tpg, own, seed=run.seed) or ())[chain : chain + 1]
    known = stops[0].until(run.makespan_ns) if stops else []
    changes = {0, run.makespan_ns, *np.concatenate([*run.start_ns, *run.end_ns])}
    changes |= {t for s in known for t in (s.start_ns, s.end_ns)}
    times = sorted(int(t) for t in changes if t <= run.makespan_ns)
    found = dict.fromkeys(STATES, 0)
    tools = {t.object for t in tpg.tasks if t.kind == TaskKind.LEAVE_TOOL}
    start, end = run.start_ns[chain], run.end_ns[chain]

    def task(node: int) -> Task:
        return tpg.task_at(chain, node)

    def sets_up(node: int) -> bool:
        if task(node).object in tools or task(node).kind == "change-over":
            return True
        last = node == len(start) - 1
        return not last and task(node).kind == "transit" and sets_up(node + 1)

    for a, b in zip(times, times[1:], strict=False):
        codes = [s.code for s in known if s.start_ns <= a < s.end_ns]
        under_way = np.flatnonzero((start <= a) & (end > a))
        ahead = np.flatnonzero(start > a)
        state = State.IDLE
        if codes:
            state = next(OF_STOP[code] for code in OF_STOP if code in codes)
        elif len(under_way):
            state = State.SETUP if sets_up(int(under_way[0])) else State.WORKING
        elif len(ahead):
            waits = []
            for (k, m, c, n), cause in zip(tpg.edges, tpg.cause, strict=True):
                if (c, n) == (chain, ahead[0]):
                    kind = tpg.task_at(k, m).kind
                    why = State.STARVED
                    if cause == MOTION_CONFLICT or kind in ("pick", "leave"):
                        why = State.BLOCKED
                    elif kind == "arrive":
                        why = State.WAITING
                    elif kind == "change-over":
                        why = State.SETUP
                    waits.append((-run.end_ns[k][m], STATES.index(why)))
            if waits and -min(waits)[0] > a:
                state = STATES[min(waits)[1]]
        found[state] += b - a
    return found


@settings(max_examples=12, deadline=None)
@given(st.integers(0, 1000), st.booleans())
def test_each_instant_is_in_one_state(seed: int, stops: bool) -> None:
    tpg = varied_kinds(random_tpg(seed, tasks=12, edges=14), seed)
    own = CLOCK if stops else Disturbances()
    run = simulate(tpg, VARIED, seed=seed, disturbances=own)
    found = run_worker_times(tpg, run)
    for place, k in enumerate(worker_chains(tpg)):
        expected = list(oracle(tpg, run, k, own).values())
        assert found.state_ns[place, :, 0].tolist() == expected
    if not stops:  # as many replications at once
        start, end = (
            np.concatenate(own)[:, None].repeat(2, axis=1)
            for own in (run.start_ns, run.end_ns)
        )
        again = worker_times(tpg, start, end, ())
        assert np.array_equal(again.state_ns, found.state_ns.repeat(2, axis=2))


def test_standstills_within_nodes_are_down_or_stopped_and_attempts_are_work() -> None:
    tpg = line_tpg({"arm": [Service("glue", k, (), None, 10.0) for k in (1, 2)]})
    failing = SkillFailure(probability=0.5, retries=20, retry=Fixed(value_s=3.0))
    own = Disturbances(
        stalls=Stalls(count_per_robot=1, duration_s=(4.0, 4.0)),
        breakdowns=Breakdowns(mtbf=Fixed(value_s=9), mttr=Fixed(value_s=6)),
        failures={"glue": failing},
    )
    run = simulate(tpg, seed=2, disturbances=own)
    assert run.outcome == "completed"
    causes = [stand.cause for stand in run.standstills[0]]
    assert set(causes) == {"stall", "breakdown", "retry"}
    found = run_worker_times(tpg, run)
    spent = dict(zip(STATES, found.state_ns[0, :, 0].tolist(), strict=True))
    assert spent[State.DOWN] == causes.count("breakdown") * 6 * SECOND
    assert spent[State.STOPPED] == 4 * SECOND
    assert spent[State.WORKING] == (20 + 3 * causes.count("retry")) * SECOND
    factors = found.shares_and_factors(np.full(1, 0.5))
    work = spent[State.WORKING] / run.makespan_ns
    assert factors["availability"][0, 0] == pytest.approx(work)
    assert factors["performance"][0, 0] == pytest.approx(
        20 * SECOND / spent[State.WORKING]
    )
    assert factors["oee"][0, 0] == pytest.approx(0.5 * 20 * SECOND / run.makespan_ns)


def test_hours_off_shift_and_planned_stops_are_no_planned_busy_time() -> None:
    tpg = line_tpg({"arm": [Service("glue", 1, (), None, 10.0)]})
    stop = PlannedStop(at_s=5, duration_s=30)
    run = simulate(tpg, disturbances=Disturbances(planned_stops=(stop,)))
    factors = run_worker_times(tpg, run).shares_and_factors(np.ones(1))
    assert factors[State.PLANNED][0, 0] == pytest.approx(0.75)
    assert factors["oee"][0, 0] == 1.0


def test_a_machine_is_blocked_until_its_part_was_picked() -> None:
    """The mill works 5 s; the arm comes 3 s later, picks for 1 s, and brings the next part after 2 s."""
    mill = [
        Service("mill", k + 1, (("arm", 2 * k),), f"part.{k + 1}", 5.0) for k in (0, 1)
    ]
    arm = [
        Service("place-down", 1, (), "part.1", 1.0),
        Service("pick", 1, (("mill", 0), ("other", 0)), "part.1", 1.0),
        Service("place-down", 2, (), "part.2", 2.0),
    ]
    other = [Service("glue", 1, (), None, 9.0)]
    tpg = line_tpg({"arm": arm, "mill": mill, "other": other}, machines=("mill",))
    found = run_worker_times(tpg, simulate(tpg))
    place = [tpg.chains[k].robot for k in worker_chains(tpg)].index("mill")
    spent = dict(zip(STATES, found.state_ns[place, :, 0] / SECOND, strict=True))
    assert spent[State.WORKING] == 10.0
    assert spent[State.STARVED] == 1.0 + 2.0
    assert spent[State.BLOCKED] == 4.0
    assert sum(spent.values()) == 17.0
