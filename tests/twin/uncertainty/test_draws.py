from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import stats

from tests.twin.drawn_runs import uniform
from tests.twin.program import python
from twin.uncertainty.draws import philox_block, stable_hash, uniforms

WORD = st.integers(min_value=0, max_value=2**64 - 1)


def block(counter: list[int], key: list[int]) -> np.ndarray:
    out = np.empty(4, np.uint64)
    philox_block(np.array(counter, np.uint64), np.array(key, np.uint64), out)
    return out


def numpys_block(counter: list[int], key: list[int]) -> np.ndarray:
    """numpy counts up before it draws, so it must start one below (with borrow)."""
    number = sum(word << (64 * k) for k, word in enumerate(counter))
    before = (number - 1) % 2**256
    words = [(before >> (64 * k)) % 2**64 for k in range(4)]
    generator = np.random.Philox(
        counter=np.array(words, np.uint64), key=np.array(key, np.uint64)
    )
    return generator.random_raw(4)


@settings(deadline=None)
@given(st.lists(WORD, min_size=4, max_size=4), st.lists(WORD, min_size=2, max_size=2))
def test_blocks_equal_numpys_bit_for_bit(counter: list[int], key: list[int]) -> None:
    assert np.array_equal(block(counter, key), numpys_block(counter, key))


def test_blocks_equal_numpys_at_the_edges_of_words() -> None:
    top = 2**64 - 1
    for counter in ([0] * 4, [top] * 4, [0, 1, 0, 0], [top, 0, 0, top]):
        for key in ([0, 0], [top, top]):
            assert np.array_equal(block(counter, key), numpys_block(counter, key))


def test_a_draw_follows_from_its_name_as_documented() -> None:
    words = numpys_block(
        [5, 7, stable_hash("robot", "left"), stable_hash("pick", "duration")], [3, 11]
    )
    expected = ((int(words[0]) >> 12) + 0.5) * 2.0**-52
    assert uniform(3, 11, "left", 7, "pick", "duration", 5) == expected


def test_hashes_of_names_are_fixed_for_all_time() -> None:
    assert stable_hash("robot", "left") == 0xE6BFFD88DC01B0B7
    assert stable_hash("ab", "c") != stable_hash("a", "bc")
    code = "from twin.uncertainty.draws import stable_hash; print(stable_hash('robot', 'left'))"
    assert int(python(code).stdout) == stable_hash("robot", "left")


def test_every_part_of_the_name_matters() -> None:
    base = (0, 0, "left", 1, "pick", "duration", 0)
    other = (1, 1, "right", 2, "handover", "stall", 1)
    names: list[Any] = [(*base[:k], other[k], *base[k + 1 :]) for k in range(len(base))]
    assert len({uniform(*name) for name in [base, *names]}) == len(base) + 1


def test_bulk_draws_do_not_depend_on_what_else_is_drawn() -> None:
    robots = ["left", "right"] * 50
    tasks = np.arange(100)
    kinds = ["pick"] * 100
    forward = uniforms(4, [2], robots, tasks, kinds, "duration")[:, 0]
    backward = uniforms(4, [2], robots[::-1], tasks[::-1], kinds, "duration")[:, 0]
    assert np.array_equal(forward, backward[::-1])
    assert forward[17] == uniform(4, 2, "right", 17, "pick", "duration")


@settings(deadline=None)
@given(
    st.integers(0, 2**63),
    st.lists(st.integers(0, 2**62), max_size=5),
    st.integers(0, 4),
)
def test_many_replications_at_once_are_the_same_draws(
    seed: int, replications: list[int], n: int
) -> None:
    names = ["left", "right", "left", "third"][:n]
    kinds = ["pick", "pick", "handover", ""][:n]
    found = uniforms(seed, replications, names, range(n), kinds, "x", [3] * n)
    assert found.shape == (n, len(replications))
    for column, replication in zip(found.T, replications, strict=True):
        one = uniforms(seed, [replication], names, range(n), kinds, "x", 3)[:, 0]
        assert np.array_equal(column, one)


def test_draws_are_uniform_and_open() -> None:
    n = 20_000
    u = uniforms(0, [0], ["left"] * n, np.arange(n), ["pick"] * n, "duration")[:, 0]
    assert u.min() > 0
    assert u.max() < 1
    assert stats.kstest(u, "uniform").pvalue > 0.01
    assert abs(np.corrcoef(u[:-1], u[1:])[0, 1]) < 0.03


@pytest.mark.parametrize(("seed", "replication"), [(-1, 0), (0, -1), (2**64, 0)])
def test_seeds_must_fit(seed: int, replication: int) -> None:
    with pytest.raises(ValueError, match="must be"):
        uniform(seed, replication, "left", 0, "pick", "duration")
    with pytest.raises(ValueError, match="must be"):
        uniforms(seed, [0, replication], ["left"], [0], ["pick"], "duration")
