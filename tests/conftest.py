"""What all tests may ask for."""

from __future__ import annotations

import os
from typing import TYPE_CHECKING, Any

import pytest
from xdist.scheduler import LoadScopeScheduling

if TYPE_CHECKING:
    from tests.shipped_runs import ShippedRuns


class _Scopes(LoadScopeScheduling):
    """Keeps a file's tests in one process, as they share what they plan; commands of docs do not.

    Tests of constructions stay together: their kernels take minutes to compile, once is enough.
    """

    def _split_scope(self, nodeid: str) -> str:
        if nodeid.startswith("tests/docs/test_commands.py"):
            return nodeid
        if "construction" in nodeid.split("::")[0]:
            return "construction"
        return str(super()._split_scope(nodeid))


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config: pytest.Config, log: Any) -> LoadScopeScheduling:
    """Return who says which tests run in which process."""
    return _Scopes(config, log)


@pytest.fixture(scope="session")
def shipped(tmp_path_factory: pytest.TempPathFactory) -> ShippedRuns:
    """Return the runs of the shipped scenarios, which all processes of a session share."""
    from tests.shipped_runs import ShippedRuns

    folder = tmp_path_factory.getbasetemp()
    if "PYTEST_XDIST_WORKER" in os.environ:
        folder = folder.parent
    return ShippedRuns(folder / "shipped")
