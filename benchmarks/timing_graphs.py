"""The contracted graphs of all bundled scenarios, on which the tests compare the two engines.

    python -m benchmarks.timing_graphs                 # all of them; the chair takes a minute
    python -m benchmarks.timing_graphs cliff stairs

Writes tests/twin/timing_graphs/<scenario>.npz: plans without shortcuts, without geometry, nodes
joined that nothing tells apart. Make them anew when plans change; a test tells for some of them.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from benchmarks.timing_graph_files import save_timing_graph
from scheduling.graph.temporal_plan_graph import TemporalPlanGraph
from twin.host.progress import Report, StageDisplay, StageWatch, report_nothing
from twin.planning.pipeline import order_motions, plan_in_turns
from twin.scenario.file import load_scenario
from twin.study.replications.workload import timing_graph
from twin.uncertainty.contraction import contract

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
    turns = plan_in_turns(scenario, path.parent, watch)
    tpg = order_motions(turns.motion_plan, watch)
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
