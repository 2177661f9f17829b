"""Plans and runs of three small scenarios are what they were, up to the last bits of numbers."""

import json

import numpy as np
import pytest

from tests.golden.fingerprint import differences, fingerprint, run_fingerprint
from tests.golden.renew import SCENARIOS, committed
from tests.shipped_runs import ShippedRuns


@pytest.mark.parametrize("name", SCENARIOS)
def test_the_run_is_the_one_it_was(name: str, shipped: ShippedRuns) -> None:
    found = run_fingerprint(shipped(*SCENARIOS[name]).trial.files)
    changed = differences(found, json.loads(committed(name).read_text()))
    assert not changed, (
        f"{name} is planned or executed otherwise than before:\n  "
        + "\n  ".join(changed)
        + f"\nIf that is meant: python -m tests.golden.renew {name}"
    )


def test_a_fingerprint_shows_small_changes_and_no_last_bits() -> None:
    rng = np.random.default_rng(3)
    values = rng.uniform(-3.0, 3.0, (5000, 6))
    before = {"a": fingerprint(values)}
    bits = values * (1.0 + 1e-15 * rng.standard_normal(values.shape))
    assert differences({"a": fingerprint(bits)}, before) == []
    moved = values.copy()
    moved[2500, 3] += 1e-3
    (line,) = differences({"a": fingerprint(moved)}, before)
    assert line.startswith("a: f[5000, 6] ")
    assert differences({"a": fingerprint(values[:-1])}, before) != []


def test_a_fingerprint_of_whole_numbers_and_names_is_exact() -> None:
    for one, other in (([1, 2], [2, 1]), ([True, False], [True, True]), ("ab", "ba")):
        before = {"a": fingerprint(np.array(list(one)))}
        assert differences(before, before) == []
        assert differences({"a": fingerprint(np.array(list(other)))}, before) != []
        assert differences({}, before) == ["a: gone"]
        assert differences(before, {}) == ["a: new"]
