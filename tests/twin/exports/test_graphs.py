"""GraphML and DOT are read by other programs as the graph that was executed."""

from __future__ import annotations

from io import BytesIO
from pathlib import Path

import networkx as nx
import pydot
import pytest

from tests.twin.exports.exported_runs import exported, toy_run
from twin.trial.run_result import RunResult

# pydot calls pyparsing by names that pyparsing wants to get rid of.
pytestmark = pytest.mark.filterwarnings("ignore:.*deprecated - use:DeprecationWarning")


@pytest.fixture
def run(tmp_path: Path) -> RunResult:
    return toy_run(tmp_path)[0]


def node_edges(run: RunResult) -> set[tuple[str, str]]:
    """Return the edges of the graph by hand: type 1, then type 2."""
    robots = [chain.robot for chain in run.tpg.chains]
    edges = {
        (f"{c.robot}/{k}", f"{c.robot}/{k + 1}")
        for c in run.tpg.chains
        for k in range(len(c) - 1)
    }
    edges |= {
        (f"{robots[a]}/{n}", f"{robots[b]}/{m}")
        for a, n, b, m in run.tpg.edges.tolist()
    }
    return edges


def task_edges(run: RunResult) -> dict[tuple[str, str], int]:
    """Return how many edges there are between the nodes of two tasks, type 1 once."""
    out: dict[tuple[str, str], int] = {}
    for chain in run.tpg.chains:
        tasks = list(dict.fromkeys(chain.task.tolist()))
        for a, b in zip(tasks, tasks[1:], strict=False):
            out[f"task {a}", f"task {b}"] = 1
    for a, n, b, m in run.tpg.edges.tolist():
        key = (
            f"task {run.tpg.chains[a].task[n]}",
            f"task {run.tpg.chains[b].task[m]}",
        )
        out[key] = out.get(key, 0) + 1
    return out


def test_graphml_of_nodes_comes_back_as_the_graph(run: RunResult) -> None:
    content = exported(run, "graphml", nodes=True)["tpg.graphml"]
    graph = nx.read_graphml(BytesIO(content))
    assert set(graph.edges) == node_edges(run)
    assert nx.is_directed_acyclic_graph(graph)
    times = run.node_times_ns
    for k, chain in enumerate(run.tpg.chains):
        for n in range(len(chain)):
            node = graph.nodes[f"{chain.robot}/{n}"]
            task = run.tpg.tasks[int(chain.task[n])]
            assert node["duration_s"] == chain.duration[n]
            assert node["planned_start_s"] == chain.planned_start[n]
            assert node["skill"] is bool(chain.skill[n])
            assert (node["task"], node["kind"], node["label"]) == (
                task.index,
                task.kind,
                task.label,
            )
            assert round(node["start_s"] * 1e9) == times[k][0][n]
            assert round(node["end_s"] * 1e9) == times[k][1][n]
    types = {data["type"] for _, _, data in graph.edges(data=True)}
    assert types == {1, 2}


def test_graphml_of_tasks_counts_the_edges_between_their_nodes(
    run: RunResult,
) -> None:
    graph = nx.read_graphml(BytesIO(exported(run, "graphml")["tpg.graphml"]))
    expected = task_edges(run)
    assert {(a, b): d["count"] for a, b, d in graph.edges(data=True)} == expected
    assert graph.number_of_nodes() == len(run.tpg.tasks)
    total = sum(data["nodes"] for _, data in graph.nodes(data=True))
    assert total == sum(len(chain) for chain in run.tpg.chains)
    conflicts = sum(data["conflicts"] for _, _, data in graph.edges(data=True))
    assert conflicts == len(run.tpg.edges)  # the toys have no other


@pytest.mark.parametrize("nodes", [False, True])
def test_dot_comes_back_as_the_graph(run: RunResult, nodes: bool) -> None:
    text = exported(run, "dot", nodes=nodes)["tpg.dot"].decode()
    (graph,) = pydot.graph_from_dot_data(text)
    assert graph.get_type() == "digraph"
    edges = {
        (e.get_source().strip('"'), e.get_destination().strip('"'))
        for e in graph.get_edges()
    }
    assert edges == (node_edges(run) if nodes else set(task_edges(run)))
    clusters = {c.get_label().strip('"'): c for c in graph.get_subgraphs()}
    assert set(clusters) == {chain.robot for chain in run.tpg.chains}
    for chain in run.tpg.chains:
        found = {n.get_name().strip('"') for n in clusters[chain.robot].get_nodes()}
        named = {f"{chain.robot}/{n}" for n in range(len(chain))}
        assert found == (named if nodes else {f"task {m}" for m in chain.task})


def test_names_with_quotes_survive_in_dot(run: RunResult) -> None:
    text = exported(run, "dot")["tpg.dot"].decode()
    assert text.startswith('digraph "toy: \\"run\\"" {')
    assert pydot.graph_from_dot_data(text)[0].get_name() == '"toy: \\"run\\""'
