"""The bound of load: against every way to share steps out, and no plan is below it."""

from itertools import product

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from planning.motion.load_bound import AlternativeLoad, least_load


@st.composite
def ways(draw: st.DrawFn) -> list[AlternativeLoad]:
    out = []
    for step in range(1, draw(st.integers(1, 5)) + 1):
        for number in range(draw(st.integers(1, 3))):
            robots = draw(st.sets(st.sampled_from("abc"), min_size=1))
            seconds = {r: draw(st.floats(0.0, 10.0)) for r in sorted(robots)}
            out.append(AlternativeLoad(step, f"o{step}-{number}", seconds))
    return out


@given(ways())
@settings(max_examples=60, deadline=None)
def test_no_choice_is_below_the_bound(found: list[AlternativeLoad]) -> None:
    steps = sorted({way.step for way in found})
    loads = []
    for chosen in product(*([w for w in found if w.step == s] for s in steps)):
        robots = {robot for way in chosen for robot in way.seconds}
        loads.append(
            max(sum(way.seconds.get(r, 0.0) for way in chosen) for r in robots)
        )
    bound = least_load(found, frozenset())
    assert bound <= min(loads) + 1e-6
    longest = max(
        min(max(w.seconds.values()) / len("abc") for w in found if w.step == s)
        for s in steps
    )
    assert bound >= longest - 1e-6


def test_equal_steps_are_shared_evenly_and_an_object_is_used_once() -> None:
    both = [AlternativeLoad(s, f"{r}{s}", {r: 4.0}) for s in (1, 2, 3) for r in "ab"]
    assert least_load(both, frozenset()) == pytest.approx(6.0)
    # The quick object can be taken in one step only.
    scarce = [AlternativeLoad(s, "quick", {"a": 1.0}) for s in (1, 2)]
    scarce += [AlternativeLoad(s, f"slow{s}", {"a": 5.0}) for s in (1, 2)]
    assert least_load(scarce, frozenset()) == pytest.approx(6.0)
    assert least_load(scarce, frozenset({"quick"})) == pytest.approx(2.0)
