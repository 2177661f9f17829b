from collections import Counter
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pydantic import ValidationError

from planning.errors import RequestError
from planning.tasks.task import TaskKind
from scheduling.graph.temporal_plan_graph import TemporalPlanGraph
from tests.twin.drawn_runs import TPGS, VARIED, sample, sample_node_times, uniform
from tests.twin.simulated import simulate
from tests.twin.twin_toys import random_tpg
from twin.durations.bounded import Fixed, Uniform
from twin.durations.nanoseconds import to_nanoseconds
from twin.uncertainty.chain_draws import choose_distinct
from twin.uncertainty.contraction import contract
from twin.uncertainty.disturbances import (
    Breakdowns,
    Disturbances,
    EmergencyStop,
    SkillFailure,
    Speed,
    Stalls,
    UniformFactor,
)
from twin.uncertainty.node_times import NodeTimes, NodeTimeSampler
from twin.uncertainty.skill_durations import SkillDurations

TPG = random_tpg(16, tasks=20)
SLOWED = Speed(robots={"robot_0": UniformFactor(kind="uniform", low=0.5, high=1.0)})
EVERYTHING = Disturbances(
    speed=SLOWED,
    jitter=Uniform(low_s=0.0, high_s=0.1),
    stalls=Stalls(
        count_per_robot=2, rate_per_h=600.0, duration=Uniform(low_s=1.0, high_s=2.0)
    ),
    breakdowns=Breakdowns(mtbf_s=10.0, mttr_s=5.0),
    failures={
        "pick": SkillFailure(probability=0.5, retries=3),
        "handover": SkillFailure(probability=0.9, retries=1),
    },
)


def times(disturbances: Disturbances, replication: int = 0, seed: int = 1) -> NodeTimes:
    return sample_node_times(
        TPG, VARIED, disturbances, seed=seed, replication=replication
    )


def test_nothing_disturbs_unless_asked_for() -> None:
    plain = sample(VARIED, TPG, seed=1)
    for found in (times(Disturbances()), sample_node_times(TPG, VARIED, seed=1)):
        assert all(map(np.array_equal, found.motion, plain))
        assert not any(stall.any() for stall in found.stood)
        assert found.failed == (-1, -1)


def test_stall_is_the_sum_of_standstills() -> None:
    found = times(EVERYTHING)
    for stall, stands in zip(found.stood, found.standstills, strict=True):
        total = np.zeros(len(stall), dtype=np.int64)
        for entry in stands:
            total[entry.node] += entry.duration_ns
        assert np.array_equal(total, stall)
        assert [e.node for e in stands] == sorted(e.node for e in stands)
    causes = {e.cause for stands in found.standstills for e in stands}
    assert causes == {"stall", "breakdown", "retry"}


def test_a_speed_factor_is_drawn_once_a_transit_and_divides_its_nodes() -> None:
    found = times(Disturbances(speed=SLOWED))
    plain = sample(VARIED, TPG, seed=1)
    chain = TPG.chains[0]
    for node in np.flatnonzero(~chain.skill).tolist():
        task = int(chain.task[node])
        u = uniform(1, 0, "robot_0", task, "transit", "speed")
        expected = round(chain.duration[node] / (0.5 + 0.5 * u) * 1e9)
        assert found.motion[0][node] == expected
    assert np.array_equal(found.motion[0][chain.skill], plain[0][chain.skill])
    assert np.array_equal(found.motion[1], plain[1])


def test_jitter_lengthens_every_node_by_its_own_draw() -> None:
    found = times(Disturbances(jitter=Uniform(low_s=0.1, high_s=0.2)))
    plain = sample(VARIED, TPG, seed=1)
    joined = np.concatenate(found.motion) - np.concatenate(plain)
    assert joined.min() >= 1e8
    assert joined.max() <= 2e8
    assert len(np.unique(joined)) == len(joined)


def test_every_robot_stalls_as_often_as_asked_and_within_bounds() -> None:
    counted = Disturbances(stalls=Stalls(count_per_robot=3, duration_s=(1.0, 20.0)))
    for chain, stood in zip(TPG.chains, times(counted).stood, strict=True):
        assert len(stood) == len(chain)
        hit = stood[stood > 0]
        assert len(hit) == 3
        assert np.all((hit >= 1e9) & (hit <= 20e9))
    often = Disturbances(stalls=Stalls(count_per_robot=5000, duration_s=(1.0, 2.0)))
    # A robot with few nodes stalls at all of them.
    assert all(np.all(stood > 0) for stood in times(often).stood)


def test_counted_stalls_fall_on_all_nodes_alike() -> None:
    tpg = random_tpg(2, tasks=4)
    stalls = Disturbances(stalls=Stalls(count_per_robot=2))
    sampler = NodeTimeSampler(tpg, SkillDurations({}), stalls)
    runs = (sampler.sample(seed=0, replication=r) for r in range(2000))
    counts = np.sum([run.stood[0] > 0 for run in runs], axis=0)
    expected = 2000 * 2 / len(tpg.chains[0])
    assert np.all(np.abs(counts - expected) < 5 * np.sqrt(expected))


def test_stalls_come_at_their_rate() -> None:
    """Counts of a Poisson process: mean and variance are rate times busy time."""
    rate = Disturbances(stalls=Stalls(rate_per_h=360.0, duration=Fixed(value_s=1.0)))
    runs = [times(rate, replication) for replication in range(400)]
    counts = np.array([len(run.standstills[0]) for run in runs])
    busy_h = np.mean([run.motion[0].sum() for run in runs]) / 3600e9
    expected = 360.0 * busy_h
    assert abs(counts.mean() - expected) < 4 * np.sqrt(expected / 400)
    assert counts.var() == pytest.approx(expected, rel=0.3)
    longer = np.zeros(2)
    for run in runs:  # a node that takes longer is hit more often
        short = run.motion[0] < np.median(run.motion[0])
        hit = np.array([entry.node for entry in run.standstills[0]], dtype=int)
        longer += [np.sum(short[hit]), np.sum(~short[hit])]
    assert longer[1] > 3 * longer[0]


def test_breakdowns_take_exponential_times_and_hit_only_whom_they_may() -> None:
    broken = Disturbances(
        breakdowns=Breakdowns(mtbf_s=20.0, mttr_s=7.0, robots=("robot_1",))
    )
    runs = [times(broken, replication) for replication in range(300)]
    assert all(not run.standstills[0] for run in runs)
    repairs = [e.duration_ns / 1e9 for run in runs for e in run.standstills[1]]
    assert len(repairs) > 200
    assert np.mean(repairs) == pytest.approx(7.0, rel=0.2)
    assert np.std(repairs) == pytest.approx(7.0, rel=0.3)
    by_clock = Disturbances(breakdowns=Breakdowns(mtbf_s=20.0, mttr_s=7.0, clock="run"))
    assert not any(times(by_clock).standstills)
    assert by_clock.at_absolute_times
    assert not broken.at_absolute_times


def test_attempts_fail_as_often_as_they_should_and_then_for_good() -> None:
    failing = Disturbances(
        failures={
            "pick": SkillFailure(probability=0.3, retries=1, retry=Fixed(value_s=2.5))
        }
    )
    picks = [
        k
        for k, chain in enumerate(TPG.chains)
        for t in set(chain.task.tolist())
        if TPG.tasks[t].kind == "pick"
    ]
    runs = [times(failing, replication) for replication in range(500)]
    first, both = 0, 0
    for run in runs:
        for stands in run.standstills:
            nodes = [entry.node for entry in stands]
            assert all(entry.duration_ns == 2_500_000_000 for entry in stands)
            first += len(set(nodes))
            both += len(nodes) - len(set(nodes))
        for failed, stands in zip(run.failed, run.standstills, strict=True):
            nodes = [entry.node for entry in stands]
            twice = [node for node in nodes if nodes.count(node) == 2]
            assert failed == min(twice, default=-1)
    n = 500 * len(picks)
    assert picks
    assert abs(first / n - 0.3) < 4 * np.sqrt(0.3 * 0.7 / n)
    assert abs(both / n - 0.09) < 4 * np.sqrt(0.09 * 0.91 / n)


def test_a_part_fails_more_often_than_others_with_the_robots_it_is_said_of() -> None:
    own = SkillFailure(
        probability=0.1,
        retries=0,
        parts={"peg": 0.5, "robot_0/peg": 0.2, "nut.x": 0.3},
    )
    assert own.of("robot_1", "peg") == pytest.approx(1.0 - 0.9 * 0.5)
    assert own.of("robot_0", "peg.12") == pytest.approx(1.0 - 0.9 * 0.8)
    assert own.of("robot_0", "nut.x") == pytest.approx(1.0 - 0.9 * 0.7)
    for other in ("nut", "pegs", None):
        assert own.of("robot_0", other) == 0.1
    picks = [task.index for task in TPG.tasks if task.kind == "pick"]
    chosen, *others = picks
    tasks = [
        replace(task, object="peg" if task.index == chosen else "nut")
        for task in TPG.tasks
    ]
    tpg, robot = replace(TPG, tasks=tuple(tasks)), TPG.tasks[chosen].robot
    failing = Disturbances().with_misses("pick", {f"{robot}/peg": 0.4})
    runs = (
        sample_node_times(tpg, VARIED, failing, seed=1, replication=replication)
        for replication in range(300)
    )
    failed = Counter(
        int(chain.task[node])
        for run in runs
        for chain, stands in zip(tpg.chains, run.standstills, strict=True)
        for node in {entry.node for entry in stands}
    )
    assert others
    assert set(failed) == {chosen}
    assert abs(failed[chosen] / 300 - 0.4) < 4 * np.sqrt(0.4 * 0.6 / 300)


def test_what_is_said_of_a_part_goes_before_what_follows_from_repeatability() -> None:
    said = SkillFailure(probability=0.0, retries=5, parts={"peg": 0.5})
    both = Disturbances(failures={"place-down": said}).with_misses(
        "place-down", {"arm/peg": 0.1, "arm/nut": 0.2}
    )
    own = both.failures["place-down"]
    assert own.retries == 5
    assert own.parts == {"arm/nut": 0.2, "peg": 0.5}
    assert Disturbances().with_misses("place-down", {}) == Disturbances()


def test_a_failed_attempt_takes_as_long_as_the_skill_unless_said() -> None:
    run = times(
        Disturbances(failures={"pick": SkillFailure(probability=1.0, retries=2)})
    )
    for k, stands in enumerate(run.standstills):
        for entry in stands:
            assert entry.duration_ns == run.motion[k][entry.node]


def test_any_attempt_may_lose_the_object_the_last_one_too() -> None:
    def failing(loses: float = 0.0) -> Disturbances:
        item = SkillFailure(probability=1.0, retries=1, loses=loses)
        return Disturbances(failures={"pick": item})

    lost = Counter[tuple[int, bool]]()
    for replication in range(200):
        run = times(failing(loses=0.5), replication)
        for k, node in enumerate(run.failed):
            if node >= 0:
                attempts = [e.node for e in run.standstills[k]].count(node)
                lost[attempts, k in run.lost] += 1
    # The first attempt loses it, or else the second, or neither does.
    whole = sum(lost.values())
    assert set(lost) == {(1, True), (2, True), (2, False)}
    assert abs(lost[1, True] / whole - 0.5) < 0.1
    assert abs(lost[2, True] / whole - 0.25) < 0.1
    assert times(failing()).lost == frozenset()


def test_draws_do_not_depend_on_other_disturbances() -> None:
    """Common random numbers: one more disturbance leaves the others as they are."""
    both = times(EVERYTHING)
    less = {"jitter": None, "speed": Speed(), "stalls": Stalls(count_per_robot=2)}
    alone = times(EVERYTHING.model_copy(update=less))
    for first, second in zip(both.standstills, alone.standstills, strict=True):
        retried = [[e.node for e in s if e.cause == "retry"] for s in (first, second)]
        assert retried[0] == retried[1]
    again = times(EVERYTHING)
    assert all(map(np.array_equal, both.motion, again.motion))
    assert both.standstills == again.standstills
    for other in (times(EVERYTHING, replication=1), times(EVERYTHING, seed=2)):
        assert both.standstills != other.standstills


@pytest.mark.parametrize(
    "make",
    [
        lambda: Stalls(count_per_robot=-1, duration_s=(1.0, 2.0)),
        lambda: Stalls(count_per_robot=1, duration_s=(-1.0, 2.0)),
        lambda: Stalls(count_per_robot=1, duration_s=(3.0, 2.0)),
        lambda: Stalls(rate_per_h=-1.0, duration=Fixed(value_s=1.0)),
        lambda: Breakdowns(mtbf_s=0.0, mttr_s=1.0),
        lambda: Breakdowns(mtbf_s=1.0, mttr_s=-1.0),
        lambda: SkillFailure(probability=1.5),
        lambda: SkillFailure(probability=0.5, retries=-1),
        lambda: EmergencyStop(robot=None, at_s=-1.0, duration_s=1.0),
        lambda: EmergencyStop(robot=None, at_s=1.0, duration_s=0.0),
    ],
)
def test_impossible_disturbances_are_refused(make: object) -> None:
    with pytest.raises(ValidationError):
        make()  # type: ignore[operator]


# Many replications at once, and against a sampler that is slow and obvious


@settings(max_examples=25, deadline=None)
@given(TPGS, st.integers(0, 100))
def test_segments_of_many_replications_are_the_sums_of_each(
    tpg: TemporalPlanGraph, seed: int
) -> None:
    sampler = NodeTimeSampler(tpg, VARIED, EVERYTHING)
    contraction = contract(tpg)
    numbers = [4, 0, 17, 5]
    bulk = sampler.sample_segments(contraction, seed=seed, replications=numbers)
    for column, replication in enumerate(numbers):
        one = sampler.sample(seed=seed, replication=replication)
        busy = [m + s for m, s in zip(one.motion, one.stood, strict=True)]
        sums = np.concatenate(contraction.sums(busy))
        assert np.array_equal(bulk.busy_ns[:, column], sums)
        assert bulk.fails[column] == any(node >= 0 for node in one.failed)


def test_pieces_of_replications_make_no_difference(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    sampler = NodeTimeSampler(TPG, VARIED, EVERYTHING)
    contraction = contract(TPG)
    whole = sampler.sample_segments(contraction, seed=3, replications=range(25))
    monkeypatch.setattr(
        "twin.uncertainty.node_times._MOST_VALUES", 7 * len(TPG.chains[0])
    )
    pieces = sampler.sample_segments(contraction, seed=3, replications=range(25))
    assert np.array_equal(whole.busy_ns, pieces.busy_ns)
    assert np.array_equal(whole.fails, pieces.fails)


def standstills_of_chain(
    k: int, motion: list[int], replication: int
) -> list[tuple[int, str, int]]:
    """Rate stalls, breakdowns and failed attempts, one draw after the other."""
    chain, found = TPG.chains[k], []

    def draw(task: int, purpose: str, index: int) -> float:
        kind = TPG.tasks[task].kind
        return uniform(1, replication, chain.robot, task, kind, purpose, index)

    for task in dict.fromkeys(chain.task.tolist()):
        nodes = np.flatnonzero(chain.task == task).tolist()
        for cause, mean_s in (("stall", 6.0), ("breakdown", 10.0)):
            clock, index = 0.0, 0
            while True:
                clock -= mean_s * 1e9 * np.log(draw(task, f"{cause}-gap", index))
                if clock >= sum(motion[n] for n in nodes):
                    break
                u = draw(task, f"{cause}-duration", index)
                seconds = 1.0 + u if cause == "stall" else -5.0 * np.log1p(-u)
                node = next(
                    n for n in nodes if clock < sum(motion[m] for m in nodes if m <= n)
                )
                found.append((node, cause, round(seconds * 1e9)))
                index += 1
        limit = {"pick": (0.5, 3), "handover": (0.9, 1)}.get(TPG.tasks[task].kind)
        if limit:
            node = next(n for n in nodes if chain.skill[n])
            for attempt in range(limit[1] + 1):
                if draw(task, "failure", attempt) >= limit[0]:
                    break
                cost = sum(motion[n] for n in nodes if chain.skill[n])
                found.append((node, "retry", cost))
    return found


@pytest.mark.parametrize("replication", range(6))
def test_standstills_are_those_of_a_slow_sampler(replication: int) -> None:
    stalls = EVERYTHING.stalls.model_copy(update={"count_per_robot": 0})
    quiet = EVERYTHING.model_copy(update={"stalls": stalls})
    run = times(quiet, replication)
    for k, stands in enumerate(run.standstills):
        slow = standstills_of_chain(k, run.motion[k].tolist(), replication)
        fast = [(e.node, e.cause, e.duration_ns) for e in stands]
        assert sorted(fast) == sorted(slow)


@given(st.integers(1, 12), st.data())
def test_choices_are_distinct_and_those_of_floyds_algorithm(
    n: int, data: st.DataObject
) -> None:
    count = data.draw(st.integers(0, n))
    u = np.array(
        data.draw(
            st.lists(st.floats(0.001, 0.999), min_size=3 * count, max_size=3 * count)
        )
    ).reshape(count, 3)
    found = choose_distinct(n, u)
    for column in range(3):
        chosen: list[int] = []
        for k in range(count):
            last = n - count + k
            pick = min(int(u[k, column] * (last + 1)), last)
            chosen.append(last if pick in chosen else pick)
        assert found[:, column].tolist() == chosen
        assert len(set(chosen)) == count


@pytest.mark.parametrize(
    "disturbances",
    [
        Disturbances(breakdowns=Breakdowns(mtbf_s=0.1, mttr_s=1e6)),
        Disturbances(breakdowns=Breakdowns(mtbf_s=0.1, mttr_s=1e6, clock="run")),
    ],
)
def test_a_run_longer_than_any_is_refused(disturbances: Disturbances) -> None:
    """Its times would not fit into 64 bits of nanoseconds."""
    tpg = random_tpg(3, tasks=4)
    slow = SkillDurations({kind: Fixed(value_s=3e2) for kind in TaskKind.SKILLS})
    with pytest.raises(RequestError, match="longer than 2e"):
        simulate(tpg, slow, disturbances=disturbances)


def test_durations_beyond_all_bounds_stay_numbers() -> None:
    assert to_nanoseconds([1e300, np.inf, 1.5]).tolist() == [9e18, 9e18, 1_500_000_000]
