"""Workers whose results could differ from those of the machine that asks are refused."""

from __future__ import annotations

import pytest

from twin.cluster.client import ClusterError, require_same_versions

HERE = {"python": "3.11.7", "numpy": "2.4.6", "scipy": "1.17.1"}
A, B = "tls://10.0.0.1:1", "tls://10.0.0.2:1"


def test_workers_with_the_same_versions_are_taken() -> None:
    require_same_versions({A: dict(HERE), B: {**HERE, "more": "1"}}, HERE)


def test_a_worker_with_another_version_is_named() -> None:
    without = {name: version for name, version in HERE.items() if name != "scipy"}
    with pytest.raises(ClusterError) as found:
        require_same_versions({A: HERE, B: {**without, "numpy": "2.4.5"}}, HERE)
    assert str(found.value) == (
        f"the worker at {B} has other versions, so results could differ:"
        " numpy is 2.4.5 there and 2.4.6 here, scipy is missing there and 1.17.1 here"
    )


def test_a_worker_without_the_package_is_named() -> None:
    missing = ModuleNotFoundError("No module named 'twin'")
    with pytest.raises(ClusterError, match=f"{B} cannot work .* No module named"):
        require_same_versions({A: HERE, B: missing}, HERE)
