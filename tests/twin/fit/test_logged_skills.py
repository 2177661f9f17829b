"""Skills in the log of a run take what was drawn for them, whatever else happened."""

from pathlib import Path

import pytest

from planning.errors import RequestError
from tests.twin.simulated import simulate
from tests.twin.twin_toys import random_tpg
from twin.durations.bounded import Uniform
from twin.durations.nanoseconds import NANOSECONDS
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
    run = simulate(
        tpg,
        durations,
        recorders=(JsonlRecorder(log),),
        seed=seed,
        disturbances=DISTURBANCES,
    )
    assert run.outcome == "completed"
    draws = durations.bind(tpg)
    totals = draws.totals(seed=seed, replications=[0])[:, 0] / NANOSECONDS
    expected = sorted(
        zip(draws.skills, [r for r, _ in draws.names], totals.tolist(), strict=True)
    )
    found = skills_in_log(log, tpg)
    times = sorted((f.skill, f.robot, f.seconds) for f in found)
    assert [own[:2] for own in times] == [own[:2] for own in expected]
    assert [own[2] for own in times] == pytest.approx(
        [own[2] for own in expected], rel=1e-7, abs=1e-9
    )


def test_a_log_that_breaks_off_or_is_of_another_plan(tmp_path: Path) -> None:
    tpg = random_tpg(1, tasks=12)
    log = tmp_path / "events.jsonl"
    simulate(tpg, recorders=(JsonlRecorder(log),))
    whole = skills_in_log(log, tpg)
    lines = log.read_text().splitlines(keepends=True)
    log.write_text("".join(lines[: len(lines) // 2]))
    part = skills_in_log(log, tpg)
    assert part == whole[: len(part)]
    assert 0 < len(part) < len(whole)
    with pytest.raises(RequestError, match=r"events.jsonl:\d+: the plan beside it"):
        skills_in_log(log, random_tpg(1, tasks=2))
