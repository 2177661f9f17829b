"""Waits for balance: all states that can be reached stand, checked one by one."""

from __future__ import annotations

from itertools import combinations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from planning.statics.build_order import BuildStep, Fall, waits_for_balance
from planning.statics.standing import Joint, PlacedBody, Standing
from tests.planning.statics.bodies import box, table


def world(*bodies: PlacedBody) -> Standing:
    return Standing({b.name: b for b in bodies}, table())


POST = box("post", (0.1, 0.1, 0.1), (0, 0, 0.05))
BEAM = box("beam", (0.4, 0.1, 0.02), (0.1, 0, 0.11))
WEIGHT = box("weight", (0.08, 0.1, 0.1), (-0.05, 0, 0.17), mass=10.0)
TIP = box("tip", (0.05, 0.1, 0.02), (0.25, 0, 0.13))


def adds(*names: str) -> list[BuildStep]:
    return [BuildStep((name,)) for name in names]


def test_a_cantilever_falls_at_its_step_and_a_hold_would_help() -> None:
    found = waits_for_balance(world(POST, BEAM), adds("post", "beam"), {(0, 1)})
    assert found == Fall(1, "beam", ("beam",))


def test_what_needs_a_counterweight_waits_for_it() -> None:
    standing = world(POST, BEAM, WEIGHT, TIP)
    # The beam is placed with its weight at once; the tip would pull it over without.
    together = [
        BuildStep(("post",)),
        BuildStep(("beam", "weight")),
        BuildStep(("tip",)),
    ]
    assert waits_for_balance(standing, together, {(0, 1), (1, 2)}) == frozenset()
    short = box("beam", (0.19, 0.1, 0.02), (0.02, 0, 0.11))
    tip = box("tip", (0.06, 0.1, 0.02), (0.1, 0, 0.13), mass=0.5)
    late = world(POST, short, WEIGHT, tip)
    steps = adds("post", "beam", "weight", "tip")
    waits = {(0, 1), (1, 2), (1, 3)}
    assert waits_for_balance(late, steps, waits) == {(2, 3)}
    wrong = waits_for_balance(
        late, adds("post", "beam", "tip", "weight"), {(0, 1), (1, 2), (1, 3)}
    )
    assert isinstance(wrong, Fall)
    assert wrong.step == 2


def test_what_stands_on_its_own_waits_for_nothing() -> None:
    boxes = [box(f"b{k}", (0.1, 0.1, 0.1), (0.1 * k, 0, 0.05)) for k in range(4)]
    found = waits_for_balance(world(*boxes), adds("b0", "b1", "b2", "b3"), set())
    assert found == frozenset()


def test_a_joint_made_by_a_later_step_comes_too_late() -> None:
    weld = Joint("post", "beam")
    steps = [*adds("post", "beam"), BuildStep(joins=(weld,))]
    assert isinstance(
        waits_for_balance(world(POST, BEAM), steps, {(0, 1), (1, 2)}), Fall
    )
    base = Joint("table", "post")
    one = [BuildStep(("post",), (base,)), BuildStep(("beam",), (weld,))]
    assert waits_for_balance(world(POST, BEAM), one, {(0, 1)}) == frozenset()


def test_joints_that_bear_so_much_keep_the_order() -> None:
    parts = [box(f"b{k}", (0.1, 0.1, 0.1), (0.1 * k, 0, 0.05)) for k in range(3)]
    weak = Joint("b0", "b1", force=5.0, torque=1.0)
    steps = [BuildStep(("b0",)), BuildStep(("b1",), (weak,)), BuildStep(("b2",))]
    assert waits_for_balance(world(*parts), steps, set()) == {(0, 1), (0, 2), (1, 2)}


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_every_reachable_state_stands(seed: int) -> None:
    rng = np.random.default_rng(seed)
    bodies: list[PlacedBody] = []
    tops = [
        (0.0, 0.0, 4.0)
    ]  # middle, height of the top and length of what is built upon
    waits = set()
    for k in range(6):
        under = int(rng.integers(max(0, len(tops) - 3), len(tops)))
        middle, height, long = tops[under]
        size = float(rng.uniform(0.1, 0.4))
        x = middle + float(rng.uniform(-0.5, 0.5)) * min(long, 0.6)
        bodies.append(
            box(
                f"b{k}",
                (size, 0.1, 0.05),
                (x, 0, height + 0.025),
                mass=rng.uniform(0.1, 3),
            )
        )
        tops.append((x, height + 0.05, size))
        if under:
            waits.add((under - 1, k))
    standing = world(*bodies)
    if any(
        min(p.gap for p in patches) < -0.01 for patches in standing.patches.values()
    ):
        return  # two of them in one place
    waits |= {
        (a, b)
        for a, b in combinations(range(6), 2)
        if (f"b{a}", f"b{b}") in standing.patches
    }
    steps = adds(*(body.name for body in bodies))
    found = waits_for_balance(standing, steps, waits)
    order = waits | (found if not isinstance(found, Fall) else set())
    if isinstance(found, Fall):
        names = [f"b{k}" for k in range(found.step + 1)]
        assert standing.falling(names) is not None
        return
    for mask in range(1 << 6):
        there = {k for k in range(6) if mask >> k & 1}
        if all(a in there for a, b in order if b in there):
            assert standing.falling([f"b{k}" for k in sorted(there)]) is None


@pytest.mark.parametrize("count", [3])
def test_columns_side_by_side_do_not_wait_for_each_other(count: int) -> None:
    bodies = [
        box(f"c{c}_{k}", (0.1, 0.1, 0.1), (0.5 * c, 0, 0.05 + 0.1 * k))
        for k in range(count)
        for c in range(2)
    ]
    number = {body.name: k for k, body in enumerate(bodies)}
    waits = {
        (number[f"c{c}_{k}"], number[f"c{c}_{k + 1}"])
        for c in range(2)
        for k in range(count - 1)
    }
    assert waits_for_balance(world(*bodies), adds(*number), waits) == frozenset()
