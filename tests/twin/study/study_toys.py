"""Small workloads for the tests of studies."""

from __future__ import annotations

from tests.twin.twin_toys import random_tpg
from twin.durations import Lognormal, Uniform
from twin.engine.execution_model import ExecutionModel
from twin.run.events import Policy
from twin.study.replications.workload import Workload, timing_graph
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
