"""When motions happen under delays: the longest path through all that is waited for, and never sooner than planned."""

from __future__ import annotations

from typing import Any

import networkx as nx
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from twin.exports.open_plan import circular_waits
from twin.judge.delays import (
    CircularWaitsError,
    DelayModel,
    delayed_spans,
    nominal_spans,
)
from twin.judge.open_plan import FORMAT, OpenMotion, OpenPlan


def content_of(
    lengths: list[list[int]],
    after: list[tuple[int, int]],
    at_speed: frozenset[int] = frozenset(),
) -> dict[str, Any]:
    """Return a plan of robots with motions of some seconds, and waits between them by number.

    Those at speed do not come to rest at their ends, but for the last of a robot.
    """
    robots: dict[str, Any] = {}
    number = 0
    for k, own in enumerate(lengths):
        motions: list[dict[str, Any]] = []
        t = 0.0
        for seconds in own:
            waits = tuple(f"m{a}" for a, b in after if b == number)
            motion = {
                "id": f"m{number}",
                "t_s": (t, t + seconds),
                "q": ((0.0,), (0.0,)),
                "after": waits,
            }
            if at_speed:
                last = float(number in at_speed and len(motions) < len(own) - 1)
                motion["v"] = ((0.0,), (last,))
            motions.append(motion)
            t, number = t + seconds, number + 1
        robots[f"r{k}"] = {"joints": ("j",), "motions": tuple(motions)}
    return {"format": FORMAT, "version": 1, "execution": "waits", "robots": robots}


def plan_of(lengths: list[list[int]], after: list[tuple[int, int]]) -> OpenPlan:
    """Return such a plan, read."""
    return OpenPlan.model_validate(content_of(lengths, after))


def longest(plan: OpenPlan) -> dict[str, float] | None:
    """Return when each motion ends by the longest path to it, None where waits go in a circle."""
    graph: nx.DiGraph[str] = nx.DiGraph()
    seconds = {m.id: m.t_s[1] - m.t_s[0] for _, _, m in plan.placed()}
    graph.add_nodes_from(seconds)
    for some in plan.motions.values():
        for k, motion in enumerate(some):
            before = [*motion.after, *([some[k - 1].id] if k else [])]
            graph.add_edges_from((other, motion.id) for other in before)
    if not nx.is_directed_acyclic_graph(graph):
        return None
    ends: dict[str, float] = {}
    for name in nx.topological_sort(graph):
        begin = max((ends[other] for other in graph.predecessors(name)), default=0.0)
        ends[name] = begin + seconds[name]
    return ends


def _no_skill(_name: str, _motion: OpenMotion, _u: float) -> None:
    return None


Waits = tuple[list[list[int]], list[tuple[int, int]]]


@st.composite
def waiting(draw: st.DrawFn) -> Waits:
    lengths = draw(
        st.lists(
            st.lists(st.integers(0, 9), min_size=1, max_size=4), min_size=1, max_size=4
        )
    )
    last = sum(map(len, lengths)) - 1
    pair = st.tuples(st.integers(0, last), st.integers(0, last))
    some = draw(st.lists(pair.filter(lambda p: p[0] != p[1]), max_size=6))
    return lengths, some


@st.composite
def plans_with_waits(draw: st.DrawFn) -> OpenPlan:
    return plan_of(*draw(waiting()))


@settings(max_examples=150)
@given(plans_with_waits())
def test_motions_happen_as_soon_as_all_that_they_wait_for_is_over(
    plan: OpenPlan,
) -> None:
    ends = longest(plan)
    if ends is None:
        with pytest.raises(CircularWaitsError, match="no motion can begin"):
            nominal_spans(plan)
        return
    spans = nominal_spans(plan)
    assert {m.id: spans[m.id].end(m) for _, _, m in plan.placed()} == ends


@settings(max_examples=60)
@given(plans_with_waits(), st.integers(0, 10_000))
def test_nothing_is_sooner_than_planned_and_luck_is_the_same_again(
    plan: OpenPlan, seed: int
) -> None:
    ends = longest(plan)
    if ends is None:
        return
    spans = delayed_spans(plan, _no_skill, seed)
    assert spans == delayed_spans(plan, _no_skill, seed)
    for _, _, motion in plan.placed():
        assert spans[motion.id].end(motion) >= ends[motion.id] - 1e-9
        assert 1.0 <= spans[motion.id].factor <= 1.1
    calm = DelayModel(slower=1.0, stalls_per_h=0.0)
    assert delayed_spans(plan, _no_skill, seed, calm) == nominal_spans(plan)


def test_stalls_come_as_often_as_they_should() -> None:
    plan = plan_of([[3600] * 100], [])
    model = DelayModel(slower=1.0, stalls_per_h=30.0, stall_s=(6.0, 6.0))
    spans = delayed_spans(plan, _no_skill, 1, model)
    last = plan.motions["r0"][-1]
    stalls = (spans[last.id].end(last) - 360_000.0) / 6.0
    assert stalls == pytest.approx(3000, abs=4 * 3000**0.5)


@settings(max_examples=150)
@given(waiting(), st.frozensets(st.integers(0, 15), min_size=1))
def test_robots_that_rest_where_they_wait_do_not_wait_in_circles(
    waits: Waits, at_speed: frozenset[int]
) -> None:
    if longest(plan_of(*waits)) is None:
        return  # robots that rest everywhere wait for each other, too
    left = at_speed
    for _ in range(20):
        content = content_of(*waits, left)
        circling = circular_waits(content)
        plan = OpenPlan.model_validate(content)
        if not circling:
            nominal_spans(plan)
            return
        with pytest.raises(CircularWaitsError):
            nominal_spans(plan)
        left = frozenset({k for k in left if f"m{k + 1}" not in circling} | {99})
    pytest.fail("there is no end to it")
