"""Skills in the log of a run take what was drawn for them, whatever else happened."""

from pathlib import Path

import numpy as np
import pytest

from planning.errors import RequestError
from tests.twin.twin_toys import random_tpg
from twin.durations.bounded import Uniform
from twin.durations.model import NANOSECONDS
from twin.engine.engine import Simulator
from twin.engine.execution_model import ExecutionModel
from twin.fit.samples import skills_in_log
from twin.recorders.observers import JsonlRecorder
from twin.uncertainty.disturbances import Disturbances
from twin.uncertainty.skill_durations import SkillDurations

DISTURBANCES = Disturbances.model_validate_json(
    """{
    "stalls": {"count_per_robot": 6, "duration_s": [1, 20]},
    "breakdowns": {"mtbf_s": 4, "mttr_s": 2, "clock": "run"},
    "emergency_stops": [{"at_s": 2, "duration_s": 3}, {"at_s": 9, "duration_s": 3}],
    "failures": {"pick": {"probability": 0.5, "retries": 20}, "handover": {"probability": 0.5, "retries": 20}}
    }"""
)


@pytest.mark.parametrize("seed", range(6))
def test_disturbances_leave_what_was_drawn(tmp_path: Path, seed: int) -> None:
    tpg = random_tpg(seed, tasks=12)
    skills = {task.kind for task in tpg.tasks if task.kind != "transit"}
    durations = SkillDurations({s: Uniform(low_s=1, high_s=3) for s in skills})
    log = tmp_path / "events.jsonl"
    model = ExecutionModel(durations, disturbances=DISTURBANCES)
    run = Simulator(tpg, model).run(seed=seed, recorders=(JsonlRecorder(log),))
    assert run.outcome == "completed"
    draws = durations.bind(tpg)
    totals = draws.totals(seed=seed, replications=[0])[:, 0] / NANOSECONDS
    expected = sorted(
        zip(draws.skills, [r for r, _ in draws.names], totals.tolist(), strict=True)
    )
    found = skills_in_log(log, tpg)
    assert [(s, r) for s, r, *_ in expected] == sorted(
        (f.skill, f.robot) for f in found
    )
    times = sorted((f.skill, f.robot, f.seconds) for f in found)
    np.testing.assert_allclose(
        [t for *_, t in times], [t for *_, t in expected], atol=1e-9
    )


def test_a_log_that_breaks_off_or_is_of_another_plan(tmp_path: Path) -> None:
    tpg = random_tpg(1, tasks=12)
    log = tmp_path / "events.jsonl"
    model = ExecutionModel(SkillDurations({}))
    Simulator(tpg, model).run(seed=0, recorders=(JsonlRecorder(log),))
    whole = skills_in_log(log, tpg)
    lines = log.read_text().splitlines(keepends=True)
    log.write_text("".join(lines[: len(lines) // 2]))
    part = skills_in_log(log, tpg)
    assert part == whole[: len(part)]
    assert 0 < len(part) < len(whole)
    with pytest.raises(RequestError, match=r"events.jsonl:\d+: the plan beside it"):
        skills_in_log(log, random_tpg(1, tasks=2))
