"""Plans for all products of a production line, made by repeating the plans of the first products."""

from __future__ import annotations

from collections.abc import Mapping

from planning.errors import PlanInvariantError
from scheduling.copies import Pattern
from scheduling.graph.temporal_plan_graph import TemporalPlanGraph
from scheduling.repeat import repeat_graph
from twin.host.progress import StageWatch
from twin.runs.policies import IN_TURNS, SHORTENED

PRODUCTS = "all products"
"""Name of the stage for progress displays."""


def repeated_plans(
    plans: Mapping[str, TemporalPlanGraph], pattern: Pattern | None, watch: StageWatch
) -> dict[str, TemporalPlanGraph]:
    """Return plans for all products; complete ones are returned unchanged.

    Args:
        plans: by their names in twin.runs.policies, that in turns before the shortened one.
        pattern: pattern of the repetition, None without one.
        watch: measures the stage, which is products.

    Raises:
        PlanInvariantError: equipment of one product obstructs the next.
    """
    if pattern is None:
        return dict(plans)
    found: dict[str, TemporalPlanGraph] = {}
    with watch.stage("products", PRODUCTS):
        for name, tpg in plans.items():
            try:
                found[name] = repeat_graph(tpg, pattern)
            except PlanInvariantError:
                # A shortcut of one product may obstruct the next; HOME never does.
                if name != SHORTENED or IN_TURNS not in found:
                    raise
                found[name] = found[IN_TURNS]
    return found
