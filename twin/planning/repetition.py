"""Plans for all products of a production line, made by repeating the plans of a few."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from planning.errors import PlanInvariantError
from scheduling.graph.temporal_plan_graph import TemporalPlanGraph
from twin.host.progress import StageWatch
from twin.runs.policies import IN_TURNS, SHORTENED
from twin.scenario.sections.kind import AssemblyKind

PRODUCTS = "all products"
"""Name of the stage for progress displays."""


def plans_of_all_products(
    units: Sequence[Mapping[str, TemporalPlanGraph]],
    kind: AssemblyKind,
    watch: StageWatch,
) -> dict[str, TemporalPlanGraph]:
    """Return plans of all products; those of an assembly that is made once are returned unchanged.

    Args:
        units: plans of each unit, by their names in twin.runs.policies, that in turns before the shortened one.
        kind: of the assembly.
        watch: measures the stage, which is products.

    Raises:
        PlanInvariantError: equipment of one product obstructs another.
    """
    if kind.products() == 1:
        return dict(units[0])
    found: dict[str, TemporalPlanGraph] = {}
    with watch.stage("products", PRODUCTS):
        for name in units[0]:
            try:
                found[name] = kind.all_products([plans[name] for plans in units])
            except PlanInvariantError:
                # A shortcut of one product may obstruct the next; HOME never does.
                if name != SHORTENED or IN_TURNS not in found:
                    raise
                found[name] = found[IN_TURNS]
    return found
