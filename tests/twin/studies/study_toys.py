"""Small workloads and summaries for the tests of studies."""

from collections.abc import Sequence
from typing import Any

from tests.twin.twin_toys import random_tpg
from twin.durations.bounded import Uniform
from twin.durations.lognormal import Lognormal
from twin.engine.execution_model import ExecutionModel
from twin.runs.execution_record import Policy
from twin.studies.replications.statistics import Interval
from twin.studies.replications.timing_graph import timing_graph
from twin.studies.replications.workload import Workload
from twin.studies.summary import CellSummary, StudySummary
from twin.uncertainty.disturbances import Disturbances
from twin.uncertainty.skill_durations import SkillDurations

DURATIONS = SkillDurations(
    {
        "pick": Uniform(low_s=0.2, high_s=5.0),
        "place-down": Lognormal(median_s=2.0, p95_s=9.0),
        "handover": Uniform(low_s=1.0, high_s=2.0),
        "support-top": Uniform(low_s=1.0, high_s=9.0),
    }
)


def toy_summary(cells: Sequence[CellSummary], **known: Any) -> StudySummary:
    """Return the figures of a study of some cells, with nothing else in them."""
    none: dict[str, Any] = {"differences": (), "ranking": (), "refused": ()}
    known = {"confidence": 0.9, "deadline_s": None, **known}
    return StudySummary(
        scenario="toy",
        antithetic=False,
        closed_loop=False,
        cells=cells,
        warnings=(),
        **none,
        **known,
    )


def toy_cell_summary(
    policy: str, variant: dict[str, Any], makespan_s: Interval, **known: Any
) -> CellSummary:
    """Return the figures of a cell of a hundred replications."""
    return CellSummary(
        policy=policy,
        variant=variant,
        replications=100,
        outcomes={"completed": 100},
        not_completed=Interval(0.0, 0.0, 0.02, 100),
        errors=0,
        makespan_s=makespan_s,
        engine="bulk",
        event_engine_because=(),
        **known,
    )


def toy_workload(
    seed: int = 1,
    *,
    policy: Policy = "asynchronous",
    reasons: tuple[str, ...] = (),
    disturbances: Disturbances | None = None,
    antithetic: bool = False,
) -> Workload:
    """Three robots and fourteen tasks."""
    tpg = random_tpg(seed, dofs=(2, 2, 3), tasks=14, edges=14)
    return Workload(
        tpg=timing_graph(tpg),
        execution=ExecutionModel(
            SkillDurations(DURATIONS.models, antithetic=antithetic),
            policy=policy,
            disturbances=disturbances or Disturbances(),
        ),
        seed=5,
        reasons=reasons,
    )
