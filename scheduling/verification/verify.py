"""Independent, slow proof that a saved plan keeps its guarantee (``twin verify``).

Nothing here is shared with the code that builds the graph: order comes from sets of ancestors,
geometry from pinocchio's own reading of the URDF files and coal's exact shapes, occupancy from
dense samples grown by the motion between them; no capsules, no clocks, no conflict search.
Checked are the structure, and the invariant: (a) nodes of two robots that come too close are
ordered, (b) so are a node and a robot that stands, (c) and a node and an object at rest.
"""

from __future__ import annotations

from dataclasses import dataclass

from scheduling.graph.temporal_plan_graph import TemporalPlanGraph
from scheduling.verification.clearance import ClearanceCheck, Progress
from scheduling.verification.findings import Moment, Problem
from scheduling.verification.graph_structure import check_structure

__all__ = ["Moment", "Problem", "VerificationReport", "verify_plan"]


@dataclass(frozen=True)
class VerificationReport:
    """Outcome of a verification.

    Attributes:
        pairs_checked: pairs of pieces that may happen at once (motions, stands, rests).
        min_distance_robots_m: least distance measured between two robots in such pairs;
            infinite if none came near enough to be measured [m].
        min_distance_objects_m: likewise between a robot or its load and anything else, where
            no contact is allowed [m].
        problems: empty for a plan that keeps its guarantee; cut off at ``limit``.
    """

    pairs_checked: int
    min_distance_robots_m: float
    min_distance_objects_m: float
    problems: tuple[Problem, ...]

    @property
    def ok(self) -> bool:
        """True when nothing is wrong."""
        return not self.problems


def verify_plan(
    tpg: TemporalPlanGraph,
    *,
    limit: int = 100,
    progress: Progress | None = None,
) -> VerificationReport:
    """Check a plan from scratch.

    Args:
        tpg: the plan.
        limit: stop after so many problems.
        progress: told how far it has come.
    """
    precedence, problems = check_structure(tpg)
    check = ClearanceCheck(tpg, limit - len(problems), progress)
    if precedence is not None:
        check.run(precedence)
    return VerificationReport(
        check.pairs,
        check.least[True],
        check.least[False],
        tuple([*problems, *check.problems][:limit]),
    )
