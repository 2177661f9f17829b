"""Packed tables seen from kernels, and answers that are kept."""

import os
import pickle
import subprocess
import sys
from copy import deepcopy
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest

from planning.caches import BoundedCache
from planning.kernels import (
    files_of_kernels,
    inner_kernel,
    kernel,
    stamp_of_kernels,
)
from planning.packed import packed, stack_rows
from planning.transforms import Array, Indices

ROOT = Path(__file__).parents[2]


class _Rows(NamedTuple):
    values: Array
    scale: float


class _Table(NamedTuple):
    rows: _Rows
    chosen: Indices
    sums: Array
    offset: int


@inner_kernel
def _sum_row(rows: _Rows, k: int) -> float:
    total = 0.0
    for j in range(rows.values.shape[1]):
        total += rows.values[k, j]
    return total * rows.scale


@kernel
def _sum_chosen(table: _Table) -> int:
    for k in range(len(table.chosen)):
        table.sums[k] = _sum_row(table.rows, table.chosen[k]) + table.offset
    return len(table.chosen)


@inner_kernel
def _squared(x: float) -> float:
    """Return (x + x^2 + x^3)^2, by way of a table."""
    powers = stack_rows(3, 1)
    for r in range(3):
        powers[r, 0] = x ** (r + 1)
    total = 0.0
    for r in range(3):
        for s in range(3):
            total += powers[r, 0] * powers[s, 0]
    return total


@inner_kernel
def _to_the_fourth(x: float) -> float:
    """Return (x + x^2 + x^3)^4, by way of a table that is filled by way of others."""
    mine = stack_rows(3, 2)
    for r in range(3):
        mine[r, 0], mine[r, 1] = x ** (r + 1), _squared(x)
    total = 0.0
    for r in range(3):
        for s in range(3):
            total += mine[r, 0] * mine[s, 0] * mine[r, 1]
    return total


@kernel
def _sum(values: Array) -> float:
    total = 0.0
    for x in values:
        total += _to_the_fourth(x)
    return total


def test_tables_on_the_stack_are_each_their_own() -> None:
    values = np.random.default_rng(0).uniform(-1.0, 1.0, 10_000)
    square = (values + values**2 + values**3) ** 2
    assert _sum(values) == pytest.approx(float(np.sum(square**2)))


def _table(values: Array) -> _Table:
    rows = packed(_Rows(values, 0.5))
    return packed(_Table(rows, np.array([2, 0]), np.zeros(2), 10))


def test_kernels_read_and_write_packed_tables() -> None:
    values = np.arange(12.0).reshape(3, 4)
    values.setflags(write=False)
    table = _table(values)
    assert _sum_chosen(table) == 2
    assert table.sums.tolist() == [29.0, 13.0]
    other = packed(table._replace(offset=0))
    _sum_chosen(other)
    assert table.sums.tolist() == [19.0, 3.0]


def test_tables_of_one_layout_are_of_one_type() -> None:
    one, other = _table(np.zeros((1, 2))), _table(np.zeros((5, 1)))
    assert one._numba_type_ == other._numba_type_  # type: ignore[attr-defined]
    flat = packed(_Rows(np.zeros(3), 1.0))
    assert flat._numba_type_ != one.rows._numba_type_  # type: ignore[attr-defined]


def test_packed_tables_are_copied_and_pickled_with_their_arrays() -> None:
    table = _table(np.arange(12.0).reshape(3, 4))
    for other in (deepcopy(table), pickle.loads(pickle.dumps(table))):
        table.rows.values[:] = 0.0
        _sum_chosen(other)
        assert other.sums.tolist() == [29.0, 13.0]
        table = _table(np.arange(12.0).reshape(3, 4))


def test_arrays_with_gaps_are_refused() -> None:
    with pytest.raises(ValueError, match="contiguous"):
        packed(_Rows(np.zeros((4, 4))[:, :2], 1.0))


def test_answers_are_worked_out_once_until_there_are_too_many() -> None:
    asked: list[int] = []

    def square(k: int) -> int:
        return kept.get(k, lambda: asked.append(k) or k * k)  # type: ignore[func-returns-value]

    kept: BoundedCache[int] = BoundedCache(2)
    assert [square(k) for k in (3, 3, 4, 3, 5, 3)] == [9, 9, 16, 9, 25, 9]
    assert asked == [3, 4, 5, 3]


def test_a_cache_that_cannot_be_read_is_written_anew(tmp_path: Path) -> None:
    (tmp_path / "there.py").write_text(
        "from planning.kernels import kernel\n\n"
        "@kernel\ndef double(x):\n    return 2 * x\n"
    )
    program = "from there import double; print(double(3), len(double.stats.cache_hits))"

    def run() -> str:
        paths = {"PYTHONPATH": f"{tmp_path}:{ROOT}", "NUMBA_CACHE_DIR": str(tmp_path)}
        command = [sys.executable, "-c", program]
        done = subprocess.run(
            command, env={**os.environ, **paths}, capture_output=True, text=True
        )
        return done.stdout + done.stderr

    assert [run(), run()] == ["6 0\n", "6 1\n"]
    index = next(tmp_path.rglob("*.nbi"))
    index.write_bytes(b"cnumba\ngone\n.")
    assert [run(), run()] == ["6 0\n", "6 1\n"]


def test_a_change_of_a_kernel_makes_those_stale_that_may_contain_it(
    tmp_path: Path,
) -> None:
    (tmp_path / "planning").mkdir()
    sources = {
        "inner": "from planning.kernels import inner_kernel\n",
        "middle": "from numba import njit\nfrom planning.inner import a\n",
        "outer": "from planning.kernels import kernel\nfrom planning.middle import (\n b,\n)\n",
        "beside": "from planning.kernels import kernel\nfrom planning.plain import c\n",
        "plain": "import numpy\n",
    }

    def write(name: str, text: str) -> None:
        (tmp_path / "planning" / f"{name}.py").write_text(text)

    def stamps() -> dict[str, str]:
        stamp_of_kernels.cache_clear()
        files_of_kernels.cache_clear()
        return {n: stamp_of_kernels(tmp_path, f"planning.{n}") for n in sources}

    for name, text in sources.items():
        write(name, text)
    before = stamps()
    stale = {
        "inner": {"inner", "middle", "outer"},
        "middle": {"middle", "outer"},
        "beside": {"beside"},
        "plain": set(),
    }
    for name, expected in stale.items():
        write(name, sources[name] + "# changed\n")
        found = stamps()
        assert {n for n in sources if found[n] != before[n]} == expected
        write(name, sources[name])


def test_kernels_of_the_program_name_the_files_that_they_contain() -> None:
    found = files_of_kernels(ROOT, "planning.geometry.clearing")
    names = {str(path.relative_to(ROOT)) for path in found}
    assert "planning/geometry/distance.py" in names
    assert not any(name.startswith("twin/") for name in names)
