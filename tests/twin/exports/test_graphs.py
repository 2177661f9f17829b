"""GraphML and DOT are read by other programs as the graph that was executed, and as the tasks of its plan."""

from dataclasses import replace
from io import BytesIO
from pathlib import Path

import networkx as nx
import numpy as np
import pytest

from planning.cell.workcell import Workcell
from planning.motion.motion_plan import MotionPlan, TaskMotion
from planning.tasks.task import Handling, Task
from planning.transforms import identity, translation
from scheduling.build_nodes import build_nodes
from scheduling.graph.temporal_plan_graph import TemporalPlanGraph
from tests.twin.exports.exported_runs import exported, toy_run
from tests.twin.twin_toys import toy_cell
from twin.exports.graphs import task_graph
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


ADA, BOB, BRICK = "robot_0", "robot_1", "brick_0"


def task(index: int, robot: str, kind: str, *handlings: Handling) -> Task:
    return Task(index, robot, kind, 1, f"{kind} {index}", np.zeros((2, 2)), handlings)


def planned(cell: Workcell, tasks: tuple[Task, ...], *waits: int) -> TemporalPlanGraph:
    """Return a plan of tasks of a second each; pairs of numbers say what waits for what."""
    motions = tuple(
        TaskMotion(np.zeros((3, 2)), np.linspace(k, k + 1, 3))
        for k in range(len(tasks))
    )
    dependencies = np.array(waits, dtype=np.int64).reshape(-1, 2)
    return build_nodes(MotionPlan(cell, tasks, motions, dependencies, ()))


def handover() -> TemporalPlanGraph:
    """Ada picks, hands over to Bob, who places."""
    tasks = (
        task(0, ADA, "pick", Handling(BRICK, 1, ADA, identity())),
        task(1, BOB, "support-top"),
        task(2, ADA, "handover", Handling(BRICK, 1, BOB, identity())),
        task(3, BOB, "support-top"),
        task(4, ADA, "support-top"),
        task(5, BOB, "place-up", Handling(BRICK, 1, None, translation(1, 2, 3))),
    )
    return planned(toy_cell((2, 2)), tasks, 1, 2, 2, 3)


def edges(tpg: TemporalPlanGraph, kind: str) -> set[tuple[str, str]]:
    graph = task_graph(tpg)
    return {(a, b) for a, b, edge in graph.edges(data=True) if edge["kind"] == kind}


def test_tasks_are_ordered_by_their_robot_and_by_what_they_wait_for() -> None:
    order = {(0, 2), (2, 4), (1, 3), (3, 5)}
    assert edges(handover(), "order") == {(f"task {a}", f"task {b}") for a, b in order}
    waits = {("task 1", "task 2"), ("task 2", "task 3")}
    assert edges(handover(), "dependency") == waits
    graph = task_graph(handover())
    assert nx.is_directed_acyclic_graph(graph)
    assert nx.has_path(graph, "task 0", "task 5")


def test_an_object_passes_from_stay_to_stay() -> None:
    tpg = handover()
    taken = {("brick_0 0", "task 0"), ("brick_0 1", "task 3")}
    assert edges(tpg, "attached") == taken
    left = {("task 2", "brick_0 1"), ("task 5", "brick_0 2")}
    assert edges(tpg, "detached") == left
    graph = task_graph(tpg)
    stays = [data for _, data in graph.nodes(data=True) if data["type"] == "object"]
    assert [stay["holder"] for stay in stays] == ["", BOB, ""]
    assert [stays[2][key] for key in ("x_m", "y_m", "z_m")] == [1.0, 2.0, 3.0]


def test_an_object_that_comes_up_follows_the_task_that_lets_it() -> None:
    cell = toy_cell((2, 2), objects=2)
    first, second = cell.objects
    cell = replace(cell, objects=(first, replace(second, later=True)))
    comes = Handling("brick_1", 2, None, second.start)
    tasks = (
        task(0, ADA, "pick", Handling(BRICK, 1, ADA, identity()), comes),
        task(1, BOB, "pick", Handling("brick_1", 1, BOB, identity())),
    )
    tpg = planned(cell, tasks)
    assert edges(tpg, "detached") == {("task 0", "brick_1 0")}
    assert ("brick_1 0", "task 1") in edges(tpg, "attached")


def test_every_task_and_object_of_a_run_comes_back(tmp_path: Path) -> None:
    run = toy_run(tmp_path)[0]
    content = exported(run, "task-graph")["task_graph.graphml"]
    graph = nx.read_graphml(BytesIO(content))
    kinds = nx.get_node_attributes(graph, "type")
    tasks = {name for name, kind in kinds.items() if kind == "task"}
    assert tasks == {f"task {item.index}" for item in run.tpg.tasks}
    for item in run.tpg.tasks:
        target = graph.nodes[f"task {item.index}"]["target_rad_or_m"]
        assert [float(x) for x in target.split()] == item.path[-1].tolist()
    objects = {graph.nodes[n]["object"] for n in graph if kinds[n] == "object"}
    assert objects == {item.name for item in run.tpg.cell.objects}
