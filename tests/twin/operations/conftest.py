"""The plan that most of these tests operate."""

import pytest

from tests.twin.operations.operated import stack
from twin.trial.plan_result import PlanResult


@pytest.fixture(scope="session")
def plan(tmp_path_factory: pytest.TempPathFactory) -> PlanResult:
    """A small stack with bricks to spare."""
    return stack(tmp_path_factory.mktemp("stack"))
