"""Dispatch policies of one's own: named in a scenario, the same in both engines, refused where they deadlock."""

from pathlib import Path

import numpy as np
import pytest

from planning.errors import RequestError
from planning.transforms import Indices
from scheduling.graph.task_edges import task_nodes
from scheduling.graph.temporal_plan_graph import TemporalPlanGraph
from tests.twin.scenarios.cells import ONE_BRICK
from tests.twin.simulated import NOMINAL, assert_same_ends, simulate
from tests.twin.twin_toys import random_tpg
from tests.twin.written import loaded, refusal
from twin.engine.execution_model import ExecutionModel, Messages
from twin.engine.model_holds import with_model_holds
from twin.registry import POLICIES
from twin.runs.policies import (
    IN_TURNS,
    SHORTENED,
    named_policies,
    parse_policy_name,
    policy_name,
)
from twin.scenario.schema import scenario_schema

TEXT = ONE_BRICK + "execution:\n  policy: "


def in_step(tpg: TemporalPlanGraph) -> Indices:
    """Return edges by which no robot begins its task k before every robot has done its task k - 1."""
    tasks = task_nodes(tpg.chains)
    return np.array(
        [
            (one[k - 1].chain, one[k - 1].stop - 1, own[k].chain, own[k].first)
            for own in tasks
            for one in tasks
            for k in range(1, min(len(own), len(one)))
            if one is not own
        ],
        dtype=np.int64,
    ).reshape(-1, 4)


@pytest.fixture(autouse=True)
def registered(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(POLICIES._added, "in-step", in_step)


def test_a_scenario_and_a_study_name_it(tmp_path: Path) -> None:
    assert loaded(tmp_path, TEXT + "in-step\n").execution.policy == "in-step"
    (problem,) = refusal(tmp_path, TEXT + "in-steps\n").problems
    assert "did you mean 'in-step'" in problem.message
    schema = scenario_schema()["$defs"]["ExecutionSection"]["properties"]["policy"]
    assert schema["enum"] == [*POLICIES.own, "in-step"]
    assert parse_policy_name("In-Step + shortcut") == "in-step + shortcuts"
    assert named_policies()["in-step"] == (IN_TURNS, "in-step")
    assert policy_name(SHORTENED, "in-step") == "in-step + shortcuts"


@pytest.mark.parametrize("messages", [Messages(), Messages.of_seconds(2, 0.1, 0.2)])
def test_engines_agree(messages: Messages) -> None:
    free = random_tpg(3, dofs=(2, 2, 2), tasks=12, edges=0)
    model = ExecutionModel(NOMINAL, "in-step", messages)
    found = assert_same_ends(with_model_holds(free, model), model, 1, range(3))
    assert found.makespan_ns[0] > simulate(free, messages=messages).makespan_ns


@pytest.mark.parametrize(
    ("edges", "said"),
    [
        ([(0, 0, 1, 0), (1, 0, 0, 0)], "wait for each other in a circle"),
        ([(0, 0, 7, 0)], "no node 0 of chain 7"),
        ([(0, 0, 1)], "shape"),
        ([(0.0, 0.0, 1.0, 0.0)], "integers"),
    ],
)
def test_what_cannot_be_executed_is_refused(
    monkeypatch: pytest.MonkeyPatch, edges: list[tuple[float, ...]], said: str
) -> None:
    monkeypatch.setitem(POLICIES._added, "wrong", lambda tpg: np.array(edges))
    with pytest.raises(RequestError, match=said):
        with_model_holds(random_tpg(1), ExecutionModel(NOMINAL, "wrong"))
