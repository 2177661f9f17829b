"""The best sequence of products of several variants, beside all sequences that there are."""

from itertools import pairwise, permutations
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.twin.planning.test_variants import PRESS, STEPS, mix
from twin.kinds.parts.best_sequence import (
    Objective,
    SequenceModel,
    best_sequence,
    counts_by_shares,
)
from twin.reading.scenario_file import load_scenario
from twin.scenario.sections.kind import assembly_kind

TIMES = st.integers(0, 9).map(float)


@st.composite
def models(draw: st.DrawFn) -> SequenceModel:
    """Return few products of up to three variants, with times of all kinds."""
    counts = draw(st.lists(st.integers(1, 3), min_size=1, max_size=3))
    counts = counts if sum(counts) <= 6 else [min(2, n) for n in counts]

    def times(n: int) -> tuple[float, ...]:
        return tuple(draw(st.lists(TIMES, min_size=n, max_size=n)))

    changes = tuple(times(len(counts)) for _ in counts)
    own = draw(st.booleans())
    return SequenceModel(
        tuple(counts),
        times(len(counts)),
        changes,
        tuple(tuple(3 * t for t in times(n)) for n in counts) if own else (),
        () if own else tuple(3 * t for t in times(sum(counts))),
    )


def cost(model: SequenceModel, sequence: tuple[int, ...], objective: Objective) -> Any:
    """Return the cost of a sequence, and its time, step by step."""
    time, late, made = 0.0, 0.0, [0] * len(model.counts)
    for k, variant in enumerate(sequence):
        if k:
            time += model.changes[sequence[k - 1]][variant]
        time += model.cycles[variant]
        due = model.due[variant][made[variant]] if model.due else model.due_in_turn[k]
        late += max(0.0, time - due)
        made[variant] += 1
    changes = sum(a != b for a, b in pairwise(sequence))
    return {"makespan": time, "changeovers": changes, "lateness": late}[objective], time


@given(models(), st.sampled_from(["makespan", "changeovers", "lateness"]))
@settings(max_examples=60, deadline=None)
def test_no_sequence_is_better(model: SequenceModel, objective: Objective) -> None:
    found = best_sequence(model, objective)
    items = [v for v, n in enumerate(model.counts) for _ in range(n)]
    assert sorted(found) == items
    least = min(cost(model, own, objective) for own in set(permutations(items)))
    assert cost(model, found, objective) == pytest.approx(least)


@given(
    st.dictionaries(st.sampled_from("abcd"), st.integers(1, 9), min_size=1),
    st.integers(1, 50),
)
@settings(max_examples=30, deadline=None)
def test_counts_are_nearest_to_shares(shares: dict[str, int], count: int) -> None:
    found = counts_by_shares(shares, count)
    assert sum(found) == count
    whole = sum(shares.values())
    for share, own in zip(shares.values(), found, strict=True):
        assert abs(own - share * count / whole) < 1.0
        assert own == share * count / whole or share * count % whole


def test_the_best_order_is_that_of_the_changeovers(tmp_path: Path) -> None:
    press = {"process": "pressing", "at": {"part": "bolt"}}
    # From short to long the press takes 20 s, back the nest takes 5.5 s.
    steps = [*STEPS[:3], press, STEPS[3]]
    about: dict[str, Any] = {"count": 5, "spare": 2, "order": "best"}
    variants: dict[str, Any] = {"short": {"share": 3}, "long": {"share": 2}}
    file = mix(tmp_path, steps=steps, assembly=PRESS, variants=variants, **about)
    kind = assembly_kind(load_scenario(file).assembly)
    assert kind.variants() == ("long",) * 2 + ("short",) * 3
    # Spare products begin the order again.
    assert kind.written_out().variants() == (*kind.variants(), "long", "long")
    due = {"short": (10.0, 46.0), "long": (40.0, 46.0)}
    variants = {
        name: {"cycle_s": 10.0, "due": {"first_s": first, "every_s": every}}
        for name, (first, every) in due.items()
    }
    about |= {"count": 6, "spare": 0, "objective": "lateness"}
    file = mix(tmp_path, steps=steps, assembly=PRESS, variants=variants, **about)
    kind = assembly_kind(load_scenario(file).assembly)
    assert kind.variants() == ("short", "long") * 3
    assert kind.due()[0] == (10.0, 40.0, 56.0, 86.0, 102.0, 132.0)


def test_what_cannot_be_compared_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    many = SequenceModel((2500, 2500), (1.0,) * 2, ((0.0,) * 2,) * 2)
    with pytest.raises(ValueError, match="compares more than 1000000"):
        best_sequence(many, "makespan")
    monkeypatch.setattr("twin.kinds.parts.best_sequence.MOST_COMPARED", 60)
    due = ((3.0, 5.0, 8.0, 13.0), (1.0, 2.0, 30.0, 40.0))
    some = SequenceModel((4, 4), (2.0, 1.0), ((0.0, 3.0), (5.0, 0.0)), due)
    with pytest.raises(ValueError, match="compares more than 60"):
        best_sequence(some, "lateness")
