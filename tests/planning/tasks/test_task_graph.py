"""The task graph has every task with its target, and says what waits for what."""

import networkx as nx
import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from planning.tasks.task import Task
from planning.tasks.work import DEPENDENCY, ORDER, task_graph

PLANS = st.lists(st.sampled_from(["ada", "bob", "eve"]), max_size=12).flatmap(
    lambda robots: st.tuples(
        st.just(robots),
        st.sets(
            st.tuples(st.integers(0, 11), st.integers(0, 11)).filter(
                lambda pair: pair[0] < pair[1] < len(robots)
            ),
            max_size=15,
        ),
    )
)


@given(PLANS)
def test_paths_say_what_must_be_complete_before(
    plan: tuple[list[str], set[tuple[int, int]]],
) -> None:
    """Against the transitive closure of a table of who waits for whom."""
    robots, needs = plan
    tasks = [
        Task(k, robot, "transit", 1, f"task {k}", np.full((k % 3, 2), float(k)))
        for k, robot in enumerate(robots)
    ]
    graph = task_graph(tasks, np.array(sorted(needs), dtype=np.int64).reshape(-1, 2))
    count = len(robots)
    waits = np.zeros((count, count), dtype=np.bool_)
    for a in range(count):
        for b in range(a + 1, count):
            waits[a, b] = robots[a] == robots[b] or (a, b) in needs
    for k in range(count):
        waits |= waits[:, [k]] & waits[[k], :]
    assert nx.is_directed_acyclic_graph(graph)
    for a in range(count):
        assert nx.descendants(graph, a) == set(np.flatnonzero(waits[a]).tolist())
    for a, b, edge in graph.edges(data=True):
        assert edge["kind"] == (DEPENDENCY if (a, b) in needs else ORDER)
    assert [graph.nodes[k]["task"] for k in range(count)] == tasks
    for k in graph.nodes:
        target = graph.nodes[k]["target"]
        same = np.array_equal(target, np.full(2, float(k)))
        assert same if k % 3 else target is None
