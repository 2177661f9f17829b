"""Waits for balance: all states that can be reached stand, checked one by one."""

from __future__ import annotations

from itertools import combinations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from planning.statics.build_order import BuildStep, Fall, Stand, waits_for_balance
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
    assert waits_for_balance(standing, together, {(0, 1), (1, 2)}) == Stand(frozenset())
    short = box("beam", (0.19, 0.1, 0.02), (0.02, 0, 0.11))
    tip = box("tip", (0.06, 0.1, 0.02), (0.1, 0, 0.13), mass=0.5)
    late = world(POST, short, WEIGHT, tip)
    steps = adds("post", "beam", "weight", "tip")
    waits = {(0, 1), (1, 2), (1, 3)}
    assert waits_for_balance(late, steps, waits) == Stand(frozenset({(2, 3)}))
    wrong = waits_for_balance(
        late, adds("post", "beam", "tip", "weight"), {(0, 1), (1, 2), (1, 3)}
    )
    assert isinstance(wrong, Fall)
    assert wrong.step == 2


def test_what_stands_on_its_own_waits_for_nothing() -> None:
    boxes = [box(f"b{k}", (0.1, 0.1, 0.1), (0.1 * k, 0, 0.05)) for k in range(4)]
    found = waits_for_balance(world(*boxes), adds("b0", "b1", "b2", "b3"), set())
    assert found == Stand(frozenset())


def test_what_a_later_step_joins_is_kept_hold_of_until_then() -> None:
    weld, base = Joint("post", "beam"), Joint("table", "post")
    steps = [
        BuildStep(("post",), (base,)),
        BuildStep(("beam",)),
        BuildStep(joins=(weld,)),
    ]
    waits = {(0, 1), (1, 2)}
    standing = world(POST, BEAM)
    found = waits_for_balance(standing, steps, waits)
    assert found == Stand(frozenset({(1, 2)}), {1: 2})
    held = waits_for_balance(standing, steps, waits, keepable=())
    assert held == Fall(1, "beam", ("beam",))
    # With a post that stands loose on the table both fall over as one.
    loose = [BuildStep(("post",)), *steps[1:]]
    heavy = box("beam", (0.4, 0.1, 0.02), (0.1, 0, 0.11), mass=3.0)
    fall = waits_for_balance(world(POST, heavy), loose, waits)
    assert isinstance(fall, Fall)
    assert fall.step == 2


def test_what_is_kept_hold_of_as_said_must_stand_after_that() -> None:
    steps = [*adds("post"), BuildStep(("beam",), until=2), *adds("weight")]
    waits = {(0, 1), (1, 2)}
    assert waits_for_balance(world(POST, BEAM, WEIGHT), steps, waits) == Stand(
        frozenset({(1, 2)}), {1: 2}
    )
    light = box("weight", (0.08, 0.1, 0.1), (-0.05, 0, 0.17), mass=0.01)
    fall = waits_for_balance(world(POST, BEAM, light), steps, waits)
    assert isinstance(fall, Fall)
    assert (fall.step, fall.body) == (2, "beam")


def test_a_joint_made_by_the_step_itself_is_in_time() -> None:
    weld = Joint("post", "beam")
    base = Joint("table", "post")
    one = [BuildStep(("post",), (base,)), BuildStep(("beam",), (weld,))]
    assert waits_for_balance(world(POST, BEAM), one, {(0, 1)}) == Stand(frozenset())


def test_joints_that_bear_so_much_keep_the_order() -> None:
    parts = [box(f"b{k}", (0.1, 0.1, 0.1), (0.1 * k, 0, 0.05)) for k in range(3)]
    weak = Joint("b0", "b1", force=5.0, torque=1.0)
    steps = [BuildStep(("b0",)), BuildStep(("b1",), (weak,)), BuildStep(("b2",))]
    assert waits_for_balance(world(*parts), steps, set()) == Stand(
        frozenset({(0, 1), (0, 2), (1, 2)})
    )


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
    order = waits | (set(found.waits) if isinstance(found, Stand) else set())
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
    assert waits_for_balance(world(*bodies), adds(*number), waits) == Stand(frozenset())


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_every_reachable_state_stands_with_what_hands_hold(seed: int) -> None:
    """Beams on posts, on each other and in the air, some welded later: all states, one by one."""
    rng = np.random.default_rng(seed)
    bodies = [
        box(
            f"b{k}",
            (float(rng.uniform(0.1, 0.4)), 0.1, 0.05),
            (float(rng.uniform(-0.3, 0.3)), 0, 0.025 + 0.05 * int(rng.integers(0, 3))),
            mass=float(rng.uniform(0.1, 3)),
        )
        for k in range(4)
    ]
    standing = world(*bodies)
    steps, waits = adds(*(body.name for body in bodies)), set[tuple[int, int]]()
    pairs = [pair for pair in standing.patches if rng.random() < 0.7]
    for first, second in pairs:
        ends = [int(n[1:]) for n in (first, second) if n != "table"]
        waits |= {(end, len(steps)) for end in ends}
        steps.append(BuildStep(joins=(Joint(first, second),)))
    steps = steps[: 4 + min(len(pairs), 4)]
    order = [0, 1, *rng.permutation(np.arange(2, len(steps))).tolist()]
    place = {k: n for n, k in enumerate(order)}
    # Joints come after what they join; what else comes first is up to chance.
    order.sort(key=lambda k: max([place[k], *(place[a] for a, b in waits if b == k)]))
    place = {k: n for n, k in enumerate(order)}
    waits = {(place[a], place[b]) for a, b in waits if b in place}
    waits = {(a, b) for a, b in waits if a < b}
    steps = [steps[k] for k in order]
    if rng.random() < 0.3:
        k = next(n for n, step in enumerate(steps) if step.adds)
        last = int(rng.integers(k + 1, len(steps)))
        steps[k] = BuildStep(steps[k].adds, steps[k].joins, last)
    found = waits_for_balance(standing, steps, waits)
    until = {k: s.until for k, s in enumerate(steps) if s.until is not None}
    if isinstance(found, Fall):
        return
    assert until.items() <= found.keeps.items()
    needed = waits | found.waits | set(found.keeps.items())
    for mask in range(1 << len(steps)):
        done = {k for k in range(len(steps)) if mask >> k & 1}
        if any(b in done and a not in done for a, b in needed):
            continue
        held = [
            name
            for k, last in found.keeps.items()
            if k in done and last not in done
            for name in steps[k].adds
        ]
        names = [name for k in sorted(done) for name in steps[k].adds]
        joints = [joint for k in sorted(done) for joint in steps[k].joins]
        assert standing.falling(names, joints=joints, held=held) is None


def test_the_first_fall_is_one() -> None:
    """Whatever is refused does fall in the order of the list, hands and joints and all."""
    kept = 0
    for seed in range(40):
        rng = np.random.default_rng(seed)
        x = float(rng.uniform(-0.2, 0.4))
        beam = box("beam", (0.4, 0.1, 0.02), (x, 0, 0.11))
        standing = world(POST, beam)
        weld = Joint("post", "beam", torque=float(rng.uniform(0.0, 3.0)))
        steps = [
            BuildStep(("post",), (Joint("table", "post"),)),
            BuildStep(("beam",)),
            BuildStep(joins=(weld,)),
        ]
        found = waits_for_balance(standing, steps, {(0, 1), (1, 2)})
        alone = standing.falling(["post", "beam"], joints=steps[0].joins)
        welded = standing.falling(["post", "beam"], joints=(*steps[0].joins, weld))
        if isinstance(found, Fall):
            assert found.body == "beam"
            assert welded == "beam"
        else:
            assert welded is None
            assert (found.keeps == {1: 2}) == (alone is not None)
            kept += bool(found.keeps)
    assert kept > 3
