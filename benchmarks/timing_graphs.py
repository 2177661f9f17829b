"""The contracted graphs of all bundled scenarios, on which the tests compare the two engines.

    python -m benchmarks.timing_graphs                 # all of them; the chair takes a minute
    python -m benchmarks.timing_graphs cliff stairs

Writes tests/twin/timing_graphs/<scenario>.npz: plans without shortcuts, without geometry, nodes
joined that nothing tells apart. Make them anew when plans change; a test tells for some of them.
"""

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from planning.errors import OutputError
from planning.files import replace_atomically
from planning.tasks.task import Task
from scheduling.graph.temporal_plan_graph import NodeChain, TemporalPlanGraph
from twin.host.progress import Report, StageDisplay, StageWatch, report_nothing
from twin.planning.pipeline import build_plan_graph, plan_motions
from twin.reading.scenario_file import load_scenario
from twin.studies.replications.timing_graph import bare_cell, timing_graph
from twin.uncertainty.contraction import contract

_CHAIN_ARRAYS = ("task", "skill", "duration", "planned_start")
_GRAPH_ARRAYS = ("edges", "cause", "dependencies", "slots")
_TASK_TEXTS = ("robot", "kind", "label", "object")


def save_timing_graph(path: Path, graph: TemporalPlanGraph) -> None:
    """Write a timing graph as one compressed ``.npz`` file.

    Raises:
        OutputError: it cannot be written.
    """
    arrays: dict[str, Any] = {name: getattr(graph, name) for name in _GRAPH_ARRAYS}
    arrays["robots"] = np.array([chain.robot for chain in graph.chains], dtype=str)
    for k, chain in enumerate(graph.chains):
        arrays |= {f"{name}_{k}": getattr(chain, name) for name in _CHAIN_ARRAYS}
    for name in _TASK_TEXTS:
        values = [getattr(task, name) or "" for task in graph.tasks]
        arrays[f"task_{name}"] = np.array(values, dtype=str)
    arrays["task_index"] = np.array([t.index for t in graph.tasks], dtype=np.int64)
    arrays["task_step"] = np.array([t.step for t in graph.tasks], dtype=np.int64)
    items = graph.cell.objects
    arrays["object_name"] = np.array([item.name for item in items], dtype=str)
    arrays["object_kind"] = np.array([item.kind for item in items], dtype=str)
    with replace_atomically(path) as temporary:
        np.savez_compressed(temporary, **arrays)


def load_timing_graph(path: Path) -> TemporalPlanGraph:
    """Return the graph that ``save_timing_graph`` wrote.

    Raises:
        OutputError: it is missing or damaged.
    """
    try:
        with np.load(path, allow_pickle=False) as arrays:
            return _read(arrays)
    except (OSError, ValueError, KeyError) as error:
        raise OutputError(f"{path}: is no timing graph: {error}") from error


def _read(arrays: Any) -> TemporalPlanGraph:
    texts = [arrays[f"task_{name}"].tolist() for name in _TASK_TEXTS]
    numbers = [arrays["task_index"].tolist(), arrays["task_step"].tolist()]
    tasks = tuple(
        Task(index, robot, kind, step, label, np.zeros((0, 0)), (), name or None)
        for index, step, robot, kind, label, name in zip(*numbers, *texts, strict=True)
    )
    chains = []
    for k, robot in enumerate(arrays["robots"].tolist()):
        own = {name: arrays[f"{name}_{k}"] for name in _CHAIN_ARRAYS}
        count = len(own["task"])
        chains.append(
            NodeChain(
                robot=robot,
                start=np.zeros(0),
                waypoints=np.zeros((0, 0)),
                fraction=np.zeros(0),
                first=np.zeros(count + 1, dtype=np.int64),
                **own,
            )
        )
    kinds = zip(
        arrays["object_name"].tolist(), arrays["object_kind"].tolist(), strict=True
    )
    return TemporalPlanGraph(
        cell=bare_cell(dict(kinds)),
        tasks=tasks,
        chains=tuple(chains),
        handlings=(),
        allowed=(),
        **{name: arrays[name] for name in _GRAPH_ARRAYS},
    )


ROOT = Path(__file__).parents[1]
FOLDER = ROOT / "tests" / "twin" / "timing_graphs"
SCENARIOS = {
    path.stem: path
    for folder in ("lego", "multi_arm")
    for path in sorted((ROOT / "scenarios" / folder).glob("*.yaml"))
}


def contracted_graph(
    path: Path, progress: Report = report_nothing
) -> TemporalPlanGraph:
    """Plan a scenario one task after another and return its contracted timing graph."""
    scenario = load_scenario(path)
    watch = StageWatch(progress)
    turns = plan_motions(scenario, path.parent, watch)
    tpg = build_plan_graph(turns.motion_plan, watch)
    return timing_graph(contract(tpg).tpg)


def main(arguments: Sequence[str] | None = None) -> int:
    """Write the graphs of some scenarios, or of all."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n", 1)[0])
    parser.add_argument("scenarios", nargs="*", metavar="SCENARIO")
    wanted = parser.parse_args(arguments).scenarios or list(SCENARIOS)
    FOLDER.mkdir(exist_ok=True)
    with StageDisplay() as progress:
        for name in wanted:
            path = FOLDER / f"{name}.npz"
            save_timing_graph(path, contracted_graph(SCENARIOS[name], progress))
            sys.stdout.write(f"{path.relative_to(ROOT)}: {path.stat().st_size} bytes\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
