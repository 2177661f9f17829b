"""Windows of time between steps: planned, kept, told of, audited, and refused where they cannot be."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from planning.errors import OutputError
from planning.transforms import Indices
from scheduling.graph.plan_files import load_plan, plan_sha256, save_plan
from scheduling.graph.windows import window_gaps, window_nodes
from scheduling.verification.verify import verify_plan
from tests.planted import rows
from tests.shipped_runs import SCENARIOS, ShippedRun, ShippedRuns
from tests.twin.scenarios.executed import executed
from tests.twin.scenarios.test_machines import scenario as machines
from tests.twin.written import checked, loaded, refusal, written
from twin.audits.audit import audit_run
from twin.audits.expectations import scenario_expectations
from twin.durations.nanoseconds import NANOSECONDS
from twin.engine.engine import Simulator
from twin.engine.model_holds import with_model_holds
from twin.scenario.sections.scenario import Scenario
from twin.studies.replications.block_results import cell_part, write_block
from twin.studies.replications.experiment import Block
from twin.studies.replications.timing_graph import timing_graph
from twin.studies.replications.workload import Engines, Workload
from twin.studies.window_figures import windows_summary
from twin.trial.planning import plan_scenario
from twin.trial.simulation import execute, scenario_execution
from twin.warnings.plan_warnings import nominal_window_warnings

TEXT = (SCENARIOS / "assembly" / "gluing.yaml").read_text(encoding="utf-8")
GLUED = "{step: glue_b, within_s: 20, at_least_s: 3}"
LOOK = "look: {duration: {kind: lognormal, median_s: 8, p95_s: 30}, distance_m: 0.1}"


@pytest.fixture(scope="module")
def gluing(shipped: ShippedRuns) -> ShippedRun:
    return shipped("assembly/gluing")


def held(scenario: Scenario, hold: float) -> Scenario:
    windows = scenario.execution.windows.changed(hold=hold)
    return scenario.changed(execution=scenario.execution.changed(windows=windows))


def test_the_shipped_plan_is_safe_and_tells_how_its_windows_were_kept(
    gluing: ShippedRun,
) -> None:
    tpg = gluing.planned.tpg
    assert verify_plan(tpg).problems == ()
    told = {own["window"]: own for own in gluing.trial.summary["windows"]}
    late = told["block_b after glue_b"]
    assert (late["at_least_s"], late["within_s"], late["broken"]) == (3.0, 20.0, True)
    assert late["slack_s"] == pytest.approx(20.0 - late["passed_s"])
    assert not told["block_a after glue_a"]["broken"]
    assert told["bridge after block_a"]["passed_s"] >= 60.0
    assert told["bridge after block_a"]["broken"] is None
    log = (gluing.trial.files / "events.jsonl").read_text().splitlines()
    events = [json.loads(line) for line in log]
    (broken,) = (event for event in events if event["kind"] == "window_broken")
    due = int(window_nodes(tpg)[1, 2]) - len(tpg.chains[0])
    assert (broken["robot"], broken["node"]) == ("right", due)
    opened = broken["t_s"] - late["passed_s"]
    assert any(
        e["kind"] == "completed" and e["t_s"] == pytest.approx(opened) for e in events
    )


def test_what_opens_a_window_is_held_back_and_the_run_stays_in_order(
    gluing: ShippedRun, tmp_path: Path
) -> None:
    run = executed(held(gluing.scenario, 0.95), gluing.planned.tpg, tmp_path / "run")
    assert not any(own["broken"] for own in run.summary["windows"])
    assert run.summary["makespan_s"] >= gluing.trial.summary["makespan_s"]


def test_files_keep_windows_and_say_nothing_of_none(
    gluing: ShippedRun, tmp_path: Path
) -> None:
    tpg = gluing.planned.tpg
    save_plan(tpg, tmp_path)
    assert load_plan(tmp_path).windows == tpg.windows
    plan = json.loads((tmp_path / "plan.json").read_text())
    plan["windows"][0]["due"] = len(tpg.tasks)
    (tmp_path / "plan.json").write_text(json.dumps(plan))
    with pytest.raises(OutputError, match=r"windows\.0: is of a task that has no node"):
        load_plan(tmp_path)
    bare = replace(tpg, windows=())
    assert plan_sha256(bare) != plan_sha256(tpg)
    save_plan(bare, tmp_path)
    assert "windows" not in json.loads((tmp_path / "plan.json").read_text())


def test_the_audit_takes_least_times_from_the_scenario(gluing: ShippedRun) -> None:
    section = gluing.scenario
    wanted = scenario_expectations(section)
    assert wanted.lags["bridge", "block_a"] == 60.0
    lags = {**wanted.lags, ("bridge", "block_a"): 90.0}
    report = audit_run(gluing.trial.files, wanted=replace(wanted, lags=lags))
    assert [own.detail for own in report.violations] == [
        "bridge begins before block_a is complete for 90 s"
    ]


def test_a_plan_says_at_nominal_times_what_it_does_not_keep(gluing: ShippedRun) -> None:
    tpg, base = gluing.planned.tpg, gluing.file.parent
    assert nominal_window_warnings(gluing.scenario, tpg, base) == ()
    strict = replace(tpg, windows=(replace(tpg.windows[1], least=0.0, most=4.0),))
    (doubt,) = nominal_window_warnings(gluing.scenario, strict, base)
    assert "more than 4 s; hold back what opens it" in doubt
    assert nominal_window_warnings(held(gluing.scenario, 0.95), strict, base) == ()
    never = replace(tpg, windows=(replace(tpg.windows[1], least=0.0, most=2.0),))
    (doubt,) = nominal_window_warnings(held(gluing.scenario, 0.95), never, base)
    assert "what lies between takes 1.000 s too long, whenever it is opened" in doubt


def test_a_study_counts_what_single_runs_break(
    gluing: ShippedRun, tmp_path: Path
) -> None:
    own, tpg = held(gluing.scenario, 0.95), gluing.planned.tpg
    model = scenario_execution(own, gluing.file.parent)
    free = timing_graph(tpg)
    load = Workload(with_model_holds(free, model), model, seed=5, free=free)
    block = Block(0, 0, 12)
    result = Engines(load).compute(block)
    write_block(tmp_path, result)
    times = cell_part(tmp_path, 0, "windows")
    assert times is not None
    found = windows_summary(tpg, 0.95, times, result.rows.makespans_s(), 0.95)
    assert found is not None
    for graph, gaps, name in (
        (load.tpg, times.gap_ns, "broken"),
        (free, times.free_gap_ns, "broken_free"),
    ):
        late = np.zeros(len(tpg.windows))
        for replication in range(block.count):
            run = Simulator(graph, model).run(seed=5, replication=replication)
            start, end = np.concatenate(run.start_ns), np.concatenate(run.end_ns)
            passed: Indices = np.asarray(window_gaps(graph, start, end))
            assert np.array_equal(passed, gaps[:, replication])
            most = [np.inf if w.most is None else w.most for w in tpg.windows]
            late += passed / NANOSECONDS > np.array(most)
        shares = [getattr(row, name) for row in found.windows]
        assert [s.estimate for s in shares[:2]] == pytest.approx(late[:2] / block.count)
        assert shares[2:] == [None, None]
    assert found.holding_s is not None
    longer = result.rows.makespan_ns - times.free_makespan_ns
    assert found.holding_s.estimate == pytest.approx(longer.mean() / NANOSECONDS)
    assert found.windows[1].broken_free.estimate >= found.windows[1].broken.estimate  # type: ignore[union-attr]


def test_windows_are_those_of_every_product(tmp_path: Path) -> None:
    steps = [
        {"place": "blank", "at": NEST, "robots": ["left"], "name": "laid"},
        {"process": "milling", "at": {"part": "blank"}, "name": "milled"},
        {
            "place": "blank",
            "robots": ["right"],
            "after": [{"step": "milled", "at_least_s": 9, "within_s": 30}],
        },
    ]
    own = machines(tmp_path, steps=steps, processes={"milling": MILLING})
    tpg = plan_scenario(own, tmp_path).tpg
    assert len(tpg.windows) == 5
    run = execute(own, tpg, tmp_path)
    start, end = np.concatenate(run.start_ns), np.concatenate(run.end_ns)
    passed: Indices = np.asarray(window_gaps(tpg, start, end))
    assert np.all(passed >= 9 * NANOSECONDS)


NEST: dict[str, Any] = {
    "fixture": "vise",
    "frame": "nest",
    "pose": {"xyz_m": [0, 0, 0.015]},
}
MILLING = {
    "duration": {"kind": "uniform", "low_s": 5.0, "high_s": 9.0},
    "machine": "mill",
}


@pytest.mark.parametrize(
    ("instead", "says"),
    rows(r"""
instead                                          | says
{step: glue_b, within_s: 2, at_least_s: 3}       | no time is left: within_s 2 is below at_least_s 3
{step: glue_c, within_s: 20}                     | unknown step 'glue_c'; did you mean 'glue_b'
{step: block_b, within_s: 20}                    | no order can be: block_b after block_b
{step: bridge, within_s: 20}                     | bridge is listed later, as step 8
{within_s: 20}                                   | key 'step' is missing
{step: glue_b, within_s: -1}                     | must be at least 0
{step: glue_b, within: 20}                       | unknown key 'within'
{step: glue_b, within_m: 20}                     | this quantity is in seconds, as 'within_s'
{step: glue_b, within_s: soon}                   | a number expected, not 'soon'
7                                                | a mapping (key: value) or text expected, not 7
"""),
)
def test_what_cannot_be_is_said(tmp_path: Path, instead: str, says: str) -> None:
    assert says in str(refusal(tmp_path, TEXT, (GLUED, instead)))


def test_a_probability_of_one_is_not_to_be_had(tmp_path: Path) -> None:
    more = ("execution:\n", "execution:\n  windows: {hold: 1}\n")
    assert "must be at most 0.9999" in str(refusal(tmp_path, TEXT, more))


def test_a_machine_may_not_have_the_name_of_a_robot(tmp_path: Path) -> None:
    other = ("left", "glue_a.lag")
    assert "glue_a.lag" in str(refusal(tmp_path, TEXT, other))


@pytest.mark.parametrize(("within", "found"), [(25, 0), (24.5, 1)])
def test_what_takes_longer_than_its_window_is_found_before_planning(
    tmp_path: Path, within: float, found: int
) -> None:
    dry = "dry: {duration: {kind: uniform, low_s: 22, high_s: 90}, unattended: true}"
    drying = "    - {process: dry, at: {part: plate}, name: dry, after: [{step: glue_b, at_least_s: 2}]}\n"
    line = "    - {place: block_b, "
    wait = GLUED.replace("20", f"{within}") + ", {step: dry, at_least_s: 1}"
    file = written(
        tmp_path,
        TEXT,
        (LOOK, f"{dry}\n    {LOOK}"),
        (line, drying + line),
        (GLUED, wait),
    )
    report = checked(file)
    assert len(report.errors) == found
    for error in report.errors:
        assert "glue_b, dry, block_b take at least 25 s, 0.5 s more" in error.message


def test_a_plain_name_and_a_mapping_say_the_same(tmp_path: Path) -> None:
    plain = loaded(tmp_path, TEXT, (GLUED, "glue_b"))
    spelt = loaded(tmp_path, TEXT, (GLUED, "{step: glue_b}"))
    steps = [scenario_expectations(own).places for own in (plain, spelt)]
    assert [p.after for p in steps[0]] == [p.after for p in steps[1]]
