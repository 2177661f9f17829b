"""What all tests may ask for."""

from __future__ import annotations

import os
from typing import TYPE_CHECKING

import pytest

if TYPE_CHECKING:
    from tests.shipped_runs import ShippedRuns


@pytest.fixture(scope="session")
def shipped(tmp_path_factory: pytest.TempPathFactory) -> ShippedRuns:
    """Return the runs of the shipped scenarios, which all processes of a session share."""
    from tests.shipped_runs import ShippedRuns

    folder = tmp_path_factory.getbasetemp()
    if "PYTEST_XDIST_WORKER" in os.environ:
        folder = folder.parent
    return ShippedRuns(folder / "shipped")
