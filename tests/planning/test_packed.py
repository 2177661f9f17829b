"""Packed tuples: kernels that others call by an address which the tuple has."""

import math
import pickle
from typing import Any, NamedTuple

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numba import boolean, float64
from numba.core.errors import TypingError

from planning.kernels import argsort_few, copy_row, kernel
from planning.packed import ROW, SharedKernel, packed
from planning.transforms import Array
from tests.kernels import outer


class Weights(NamedTuple):
    """Weights, and what is asked about numbers with them."""

    weights: Array
    heavy: SharedKernel
    total: SharedKernel


def _total(own: Weights, values: Array) -> float:
    if len(values) != len(own.weights):
        raise ValueError("as many numbers as weights")
    total = 0.0
    for k in range(len(values)):
        total += own.weights[k] * values[k]
    return total


def _heavy(own: Weights, values: Array, limit: float) -> bool:
    return bool(_call_total(own, (values,)) > limit)


TOTAL = SharedKernel(_total, float64, (ROW,))
HEAVY = SharedKernel(_heavy, boolean, (ROW, float64))
_call_total, _call_heavy = TOTAL.call_of("total"), HEAVY.call_of("heavy")


@kernel
def heavy(own: Weights, values: Array, limit: float) -> bool:
    return bool(_call_heavy(own, (values, limit)))


_order_of_few, _copy_row = outer(argsort_few), outer(copy_row)

NUMBERS = st.lists(st.floats(-9.0, 9.0), min_size=1, max_size=6)


def weighted(weights: Any) -> Weights:
    return packed(Weights(np.array(weights, dtype=np.float64), HEAVY, TOTAL))


@given(NUMBERS, st.floats(-9.0, 9.0), st.booleans())
def test_a_shared_kernel_tells_what_it_would_where_it_is_called(
    values: list[float], limit: float, sent: bool
) -> None:
    own = weighted(np.arange(len(values)))
    if sent:
        own = pickle.loads(pickle.dumps(own))
    expected = math.fsum(k * value for k, value in enumerate(values))
    if abs(expected - limit) > 1e-9:
        assert heavy(own, np.array(values), limit) == (expected > limit)


def test_an_error_of_a_shared_kernel_comes_out_of_those_that_call_it() -> None:
    with pytest.raises(ValueError, match="as many numbers as weights"):
        heavy(weighted([1.0, 2.0]), np.ones(3), 0.0)


def test_a_shared_kernel_takes_the_types_that_it_says() -> None:
    own = weighted([1.0])
    with pytest.raises(TypingError, match="in place of"):
        heavy(own, np.ones(1, dtype=np.int64), 0.5)


@given(NUMBERS)
def test_few_numbers_are_sorted_and_rows_are_copied(values: list[float]) -> None:
    numbers, out = np.array(values), np.zeros(len(values))
    order = _order_of_few(numbers)
    assert order.tolist() == np.argsort(numbers, kind="stable").tolist()
    _copy_row(out, numbers)
    assert np.array_equal(out, numbers)
