"""The judge agrees with the audit of our own plans, and sees what is planted in them."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.shipped_runs import ShippedRuns
from tests.twin.judge.judged import exported, judged, motion_with
from twin.audits.run_auditor import audit_execution


def test_our_own_plan_is_clean_through_the_door_of_all(
    shipped: ShippedRuns, tmp_path: Path
) -> None:
    found = judged(exported(shipped, "lego/cliff"), tmp_path, seeds=1)
    assert found.findings == ()
    (run,) = found.delayed
    assert run.findings == ()
    assert run.makespan_s > found.planned_s > 0.0
    own = shipped("lego/cliff").trial.makespan_s
    assert found.planned_s == pytest.approx(own, rel=0.05)


@pytest.mark.nightly
@pytest.mark.parametrize("name", ["assembly/truss", "assembly/taskboard"])
def test_plans_that_wait_where_they_pass_at_speed_are_clean(
    shipped: ShippedRuns, tmp_path: Path, name: str
) -> None:
    """A bar is held until it is welded, where the torch stands on; three robots wait within their passages."""
    found = judged(exported(shipped, name), tmp_path, seeds=2)
    assert found.findings == ()
    assert [run.findings for run in found.delayed] == [(), ()]


@pytest.mark.nightly
def test_the_judge_says_of_our_plan_what_the_audit_says_of_its_run(
    shipped: ShippedRuns, tmp_path: Path
) -> None:
    own = shipped("assembly/gearbox")
    report = audit_execution(own.scenario, own.trial.files, ordered=True, finished=True)
    found = judged(exported(shipped, "assembly/gearbox"), tmp_path)
    assert report.violations == found.findings == ()
    # Distances are those of a run whose skills take as long as planned.
    assert found.min_distance_m == pytest.approx(report.min_distance_m, abs=0.002)
    assert found.engine == report.engine


def test_an_arm_that_dips_into_the_plate_between_two_rows_is_seen(
    shipped: ShippedRuns, tmp_path: Path
) -> None:
    content = exported(shipped, "lego/cliff")
    placing = motion_with(content, "put", "right_2x6")
    dip = list(placing["q"][-1])
    dip[1] += 0.25
    placing["q"].insert(-1, dip)
    placing["t_s"].insert(-1, 0.5 * (placing["t_s"][-2] + placing["t_s"][-1]))
    found = [v for v in judged(content, tmp_path).findings if v.kind == "contact"]
    assert any(v.first.startswith("right/") for v in found)
    assert all(placing["t_s"][0] <= v.t_start <= placing["t_s"][-1] for v in found)
