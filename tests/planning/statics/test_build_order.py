"""Waits for balance: all states that can be reached stand, checked one by one."""

from collections.abc import Iterator
from itertools import combinations

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from planning.statics.build_order import (
    BuildStep,
    StableBuild,
    UnstableState,
    Waits,
    balance_dependencies,
)
from planning.statics.standing import PlacedBody, StabilityChecker
from planning.statics.standing_rules import Joint
from tests.planning.statics.bodies import box, table


def world(*bodies: PlacedBody) -> StabilityChecker:
    return StabilityChecker({b.name: b for b in bodies}, table())


def adds(*names: str) -> list[BuildStep]:
    return [BuildStep((name,)) for name in names]


def beam(mass: float | None = None) -> PlacedBody:
    return box("beam", (0.4, 0.1, 0.02), (0.1, 0, 0.11), mass=mass)


def weight(mass: float) -> PlacedBody:
    return box("weight", (0.08, 0.1, 0.1), (-0.05, 0, 0.17), mass=mass)


POST = box("post", (0.1, 0.1, 0.1), (0, 0, 0.05))
ON_BEAM = (POST, beam(), weight(10.0), box("tip", (0.05, 0.1, 0.02), (0.25, 0, 0.13)))
SHORT = (
    POST,
    box("beam", (0.19, 0.1, 0.02), (0.02, 0, 0.11)),
    weight(10.0),
    box("tip", (0.06, 0.1, 0.02), (0.1, 0, 0.13), mass=0.5),
)
ROW = [box(f"b{k}", (0.1, 0.1, 0.1), (0.1 * k, 0, 0.05)) for k in range(4)]
COLUMNS = [
    box(f"c{c}{k}", (0.1, 0.1, 0.1), (0.5 * c, 0, 0.05 + 0.1 * k))
    for k in range(3)
    for c in range(2)
]
BASE, WELD = Joint("table", "post"), Joint("post", "beam")
FREE = BuildStep(("post",))
FIXED = BuildStep(("post",), (BASE,))
LATE = [BuildStep(("beam",)), BuildStep(joins=(WELD,))]
HELD = [FREE, BuildStep(("beam",), until=2), *adds("weight")]
WEAK = BuildStep(("b1",), (Joint("b0", "b1", force=5.0, torque=1.0),))
NOTHING = StableBuild(frozenset())
KEPT = StableBuild(frozenset({(1, 2)}), {1: 2})


@pytest.mark.parametrize(
    ("bodies", "steps", "waits", "expected"),
    [
        # A cantilever falls at its step, and a hold would help.
        (
            (POST, beam()),
            adds("post", "beam"),
            {(0, 1)},
            UnstableState(1, "beam", ("beam",)),
        ),
        # The beam is placed with its weight at once; the tip would pull it over without.
        (
            ON_BEAM,
            [FREE, BuildStep(("beam", "weight")), *adds("tip")],
            {(0, 1), (1, 2)},
            NOTHING,
        ),
        # What needs a counterweight waits for it, and falls before it.
        (
            SHORT,
            adds("post", "beam", "weight", "tip"),
            {(0, 1), (1, 2), (1, 3)},
            StableBuild(frozenset({(2, 3)})),
        ),
        (SHORT, adds("post", "beam", "tip", "weight"), {(0, 1), (1, 2), (1, 3)}, 2),
        # What stands on its own, and columns side by side, wait for nothing.
        (ROW, adds("b0", "b1", "b2", "b3"), set(), NOTHING),
        (
            COLUMNS,
            adds(*(body.name for body in COLUMNS)),
            {(0, 2), (2, 4), (1, 3), (3, 5)},
            NOTHING,
        ),
        # What a later step joins is kept hold of until then.
        ((POST, beam()), [FIXED, *LATE], {(0, 1), (1, 2)}, KEPT),
        # With a post that stands loose on the table both fall over as one.
        ((POST, beam(3.0)), [FREE, *LATE], {(0, 1), (1, 2)}, 2),
        # What is kept hold of as said must stand after that.
        ((POST, beam(), weight(10.0)), HELD, {(0, 1), (1, 2)}, KEPT),
        ((POST, beam(), weight(0.01)), HELD, {(0, 1), (1, 2)}, (2, "beam")),
        # A joint made by the step itself is in time.
        ((POST, beam()), [FIXED, BuildStep(("beam",), (WELD,))], {(0, 1)}, NOTHING),
        # Joints that bear so much keep the order.
        (
            ROW[:3],
            [BuildStep(("b0",)), WEAK, BuildStep(("b2",))],
            set(),
            StableBuild(frozenset({(0, 1), (0, 2), (1, 2)})),
        ),
    ],
)
def test_what_waits_for_what_or_falls(
    bodies: tuple[PlacedBody, ...],
    steps: list[BuildStep],
    waits: set[tuple[int, int]],
    expected: StableBuild | UnstableState | int | tuple[int, str],
) -> None:
    """A fall may be given by its step alone, or with what falls."""
    found = balance_dependencies(world(*bodies), steps, waits)
    if isinstance(expected, StableBuild | UnstableState):
        assert found == expected
        return
    assert isinstance(found, UnstableState)
    assert expected in (found.step, (found.step, found.body))


def test_what_nobody_may_keep_hold_of_falls() -> None:
    steps, waits = [FIXED, *LATE], {(0, 1), (1, 2)}
    held = balance_dependencies(world(POST, beam()), steps, waits, keepable=())
    assert held == UnstableState(1, "beam", ("beam",))


def states(count: int, order: Waits | set[tuple[int, int]]) -> Iterator[set[int]]:
    """Yield every set of steps that contains, with a step, all that it waits for."""
    for mask in range(1 << count):
        done = {k for k in range(count) if mask >> k & 1}
        if all(a in done for a, b in order if b in done):
            yield done


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_every_reachable_state_stands(seed: int) -> None:
    rng = np.random.default_rng(seed)
    bodies: list[PlacedBody] = []
    # Middle, height of the top and length of what is built upon.
    tops = [(0.0, 0.0, 4.0)]
    waits = set()
    for k in range(6):
        under = int(rng.integers(max(0, len(tops) - 3), len(tops)))
        middle, height, long = tops[under]
        size = float(rng.uniform(0.1, 0.4))
        x = middle + float(rng.uniform(-0.5, 0.5)) * min(long, 0.6)
        at, mass = (x, 0, height + 0.025), rng.uniform(0.1, 3)
        bodies.append(box(f"b{k}", (size, 0.1, 0.05), at, mass=mass))
        tops.append((x, height + 0.05, size))
        if under:
            waits.add((under - 1, k))
    standing = world(*bodies)
    if any(min(p.gap for p in own) < -0.01 for own in standing.patches.values()):
        return  # two of them in one place
    pairs = combinations(range(6), 2)
    waits |= {(a, b) for a, b in pairs if (f"b{a}", f"b{b}") in standing.patches}
    found = balance_dependencies(standing, adds(*(body.name for body in bodies)), waits)
    if isinstance(found, UnstableState):
        names = [f"b{k}" for k in range(found.step + 1)]
        assert standing.falling(names) is not None
        return
    for there in states(6, waits | found.waits):
        assert standing.falling([f"b{k}" for k in sorted(there)]) is None


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 2**32 - 1))
@example(5836)  # whose program the primal simplex leaves in doubt
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
    found = balance_dependencies(standing, steps, waits)
    until = {k: s.until for k, s in enumerate(steps) if s.until is not None}
    if isinstance(found, UnstableState):
        return
    assert until.items() <= found.keeps.items()
    for done in states(len(steps), waits | found.waits | set(found.keeps.items())):
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
        standing = world(POST, box("beam", (0.4, 0.1, 0.02), (x, 0, 0.11)))
        weld = Joint("post", "beam", torque=float(rng.uniform(0.0, 3.0)))
        steps = [FIXED, BuildStep(("beam",)), BuildStep(joins=(weld,))]
        found = balance_dependencies(standing, steps, {(0, 1), (1, 2)})
        alone = standing.falling(["post", "beam"], joints=(BASE,))
        welded = standing.falling(["post", "beam"], joints=(BASE, weld))
        if isinstance(found, UnstableState):
            assert found.body == "beam"
            assert welded == "beam"
        else:
            assert welded is None
            assert (found.keeps == {1: 2}) == (alone is not None)
            kept += bool(found.keeps)
    assert kept > 3
