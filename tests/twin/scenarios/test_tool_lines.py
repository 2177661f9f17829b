"""A line with a change of tools per product, a robot on a rail, and a rack behind a door."""

import re
from collections import defaultdict
from pathlib import Path

import numpy as np
import pytest

from benchmarks.operate import audited
from planning.tasks.task import TaskKind
from scheduling.build_tpg import build_tpg
from scheduling.graph.plan_files import load_plan, save_plan
from scheduling.graph.temporal_plan_graph import TemporalPlanGraph
from scheduling.verification.verify import verify_plan
from tests.planted import rows
from tests.twin.operations.operated import operated
from tests.twin.operations.operated import planned as operated_plan
from tests.twin.scenarios.executed import executed
from tests.twin.scenarios.tool_line import AT_RACKS, tool_line
from tests.twin.simulated import simulate
from tests.twin.written import loaded, refusal, written
from twin.durations.nanoseconds import Nanoseconds
from twin.runs.execution_record import ExecutionRecord
from twin.scenario.sections.kind import assembly_kind
from twin.throughput.throughput import product_nodes
from twin.trial.loaded_scenario import load
from twin.trial.plan_result import PlanResult
from twin.trial.planning import plan_scenario
from twin.trial.simulation import skill_durations
from twin.uncertainty.disturbances import Disturbances, Stalls

BOUND = "products: {count: 7, ", "products: {count: 7, in_progress: 1, "
STALLS = Disturbances(stalls=Stalls(rate_per_h=120.0, duration_s=(1.0, 20.0)))


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("tool_line")


@pytest.fixture(scope="module")
def planned(folder: Path) -> PlanResult:
    """The plan of seven products, of which the motions of one are repeated."""
    return plan_scenario(loaded(folder, tool_line(folder)), folder)


def drawn(planned: PlanResult, tpg: TemporalPlanGraph, seed: int) -> ExecutionRecord:
    """Return a run with random durations and standstills."""
    durations = skill_durations(planned.scenario.sections, planned.scenario.folder)
    return simulate(tpg, durations, seed=seed, disturbances=STALLS)


def when(
    tpg: TemporalPlanGraph, run: ExecutionRecord
) -> dict[int, tuple[Nanoseconds, Nanoseconds]]:
    """Return the begin and the end of each task that has nodes [ns]."""
    found = {}
    for chain, start, end in zip(tpg.chains, run.start_ns, run.end_ns, strict=True):
        for task in np.unique(chain.task):
            own = chain.task == task
            found[int(task)] = start[own].min(), end[own].max()
    return found


def test_each_product_is_made_with_its_tools_and_proved_and_audited(
    planned: PlanResult, folder: Path
) -> None:
    tpg = planned.tpg
    assert verify_plan(tpg).problems == ()
    executed(planned.scenario.sections, tpg, folder / "run", base=folder)
    on_it, used = {"arm": "gripper"}, defaultdict(list)
    changes = 0
    for task in tpg.tasks:
        if task.kind == TaskKind.LEAVE_TOOL:
            assert on_it.pop(task.robot) == task.object
        elif task.kind == TaskKind.TAKE_TOOL:
            assert task.robot not in on_it
            on_it[task.robot] = str(task.object)
            changes += 1
        elif task.kind in ("pick", "place-down", "screw") and task.robot == "arm":
            used[int(tpg.products[task.index])].append((task.kind, on_it["arm"]))
    one = [("pick", "gripper"), ("place-down", "gripper"), ("screw", "driver")]
    assert used == dict.fromkeys(range(1, 8), one)
    assert (changes, on_it) == (14, {"arm": "gripper"})


def test_nobody_is_at_the_rack_behind_a_door_that_is_shut(planned: PlanResult) -> None:
    tpg, waited = planned.tpg, False
    press = [task.index for task in tpg.tasks if task.kind == "pressing"]
    racks = [task.index for task in tpg.tasks if task.object == "driver"]
    for seed in range(3):
        run = drawn(planned, tpg, seed)
        times = when(tpg, run)
        for shut, open_again in (times[task] for task in press):
            for begin, end in (times[task] for task in racks):
                assert end <= shut or begin >= open_again
            waited |= bool(np.isin(open_again, run.start_ns[tpg.chain_index["arm"]]))
    assert waited


def test_a_product_is_complete_before_its_tool_is_back(
    planned: PlanResult, folder: Path
) -> None:
    tpg = planned.tpg
    save_plan(tpg, folder / "saved")
    run, nodes = drawn(planned, tpg, 0), product_nodes(load_plan(folder / "saved"))
    assert nodes is not None
    times = when(tpg, run)
    screwed = [times[task.index][1] for task in tpg.tasks if task.kind == "screw"]
    back = [
        times[task.index][0]
        for task in tpg.tasks
        if (task.kind, task.object) == (TaskKind.LEAVE_TOOL, "driver")
    ]
    complete = nodes.end(np.concatenate(run.end_ns))
    assert np.all(screwed <= complete)
    assert np.all(complete <= back)


def test_one_product_after_another(folder: Path, planned: PlanResult) -> None:
    """The same motions overlap without a bound, and with a bound of one they do not."""

    def overlaps(tpg: TemporalPlanGraph, seed: int) -> int:
        nodes, run = product_nodes(tpg), drawn(planned, tpg, seed)
        assert nodes is not None
        begin = nodes.begin(np.concatenate(run.start_ns))
        end = nodes.end(np.concatenate(run.end_ns))
        return int(np.count_nonzero(begin[1:] < end[:-1]))

    own = assembly_kind(loaded(folder, tool_line(folder), BOUND).assembly)
    bounded = own.all_products([build_tpg(planned.motions.motion_plan)])
    assert verify_plan(bounded).problems == ()
    for seed in range(5):
        assert overlaps(planned.tpg, seed) > 0
        assert overlaps(bounded, seed) == 0


@pytest.mark.nightly
def test_what_fails_at_a_rack_is_planned_again(folder: Path) -> None:
    """Each product is written out, one after another, and attempts to take the driver fail for good."""
    few = (BOUND[0], "products: {count: 2, in_progress: 1, ")
    text = tool_line(folder) + AT_RACKS
    plan = plan_scenario(load(written(folder, text, few)), keep=True)
    done, events = operated(plan, 1, **{"recovery.again": 5, "recovery.shortcuts": 0})
    failed = [event for event in events if event.kind == "failed"]
    assert "take driver" in str(failed)
    assert done.record.outcome == "completed"
    assert verify_plan(done.tpg).problems == ()
    assert audited(done, plan.scenario) == []
    nodes = product_nodes(done.tpg)
    assert nodes is not None
    first, _ = nodes.end(np.concatenate(done.record.end_ns))
    _, second = nodes.begin(np.concatenate(done.record.start_ns))
    assert first <= second


@pytest.mark.parametrize(
    ("old", "new", "message"),
    rows(r"""
old                       | new                              | says
count: 7                  | count: 7, in_progress: 0         | assembly.products.in_progress: must be at least 1
count: 7                  | count: 7, in_progress: 101       | in_progress: must be at most 100
count: 7                  | count: 7, in_progress: two       | in_progress: a whole number expected
count: 7                  | count: 7, in_progres: 2          | did you mean 'in_progress'?
[gripper, driver]         | [gripper, cup]                   | cup has no rack
tools: [gripper, driver]  | tools: [gripper]                 | two or more
tool: driver}             | tool: drill}                     | (valid: gripper, driver, cup)
"""),
)
def test_what_cannot_be_said_is_refused(
    folder: Path, old: str, new: str, message: str
) -> None:
    assert message in str(refusal(folder, tool_line(folder), (old, new)))


@pytest.fixture(scope="module")
def without_changes(folder: Path) -> PlanResult:
    """Four products planned one by one, with an arm that keeps its tool."""
    text = tool_line(folder).replace("tools: [gripper, driver]", "tool: gripper")
    text = text.replace("tool: driver}", "tool: gripper}").replace(
        "count: 7", "count: 4"
    )
    text = re.sub(r"    driver:\n(      .*\n)+?(?=    cup)", "", text)
    text = re.sub(r"      rack: .*\n", "", text)
    return operated_plan(written(folder, text, name="fixed_tools.yaml"))


@pytest.mark.parametrize(("robot", "at_s"), [("arm", 0.82), ("press", 2.32)])
def test_an_outage_leaves_no_half_skill_and_nothing_in_the_air(
    without_changes: PlanResult, robot: str, at_s: float
) -> None:
    """An arm stops on its way to a block; a press that is out leaves caps without blocks."""
    values = {"outages": [{"robot": robot, "at_s": at_s}]}
    done, _ = operated(without_changes, 0, **values)
    assert verify_plan(done.tpg).problems == ()
    assert audited(done, without_changes.scenario.varied(values)) == []
