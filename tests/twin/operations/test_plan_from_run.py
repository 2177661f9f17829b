"""Plans begin in a world: what is left of a run at a time is planned from what was executed up to there."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

import twin
from planning.errors import OutputError, RequestError, ScenarioError
from planning.kinematics.kinematics import frame_pose
from planning.tasks.task import TaskKind
from planning.transforms import from_quat_wxyz
from scheduling.graph.temporal_plan_graph import TemporalPlanGraph
from scheduling.verification.verify import verify_plan
from tests.shipped_runs import ShippedRuns
from tests.twin.operations.operated import STACK, lost, stack
from tests.twin.program import invoke
from twin.trial.plan_result import PlanResult
from twin.trial.run_result import RunResult

PLACES = ("place-down", "place-up")


@pytest.fixture(scope="module")
def plan(tmp_path_factory: pytest.TempPathFactory) -> PlanResult:
    return stack(tmp_path_factory.mktemp("stack"))


@pytest.fixture(scope="module")
def run(plan: PlanResult, tmp_path_factory: pytest.TempPathFactory) -> RunResult:
    folder = tmp_path_factory.mktemp("run") / "run"
    return twin.run(plan, out=folder, recording=False, audit=False)


def from_moment(run: RunResult, t_s: float, *out: str) -> PlanResult:
    """Plan what is left, as one who has nothing but the folder."""
    return twin.plan(world=f"{run.files}@{t_s!r}", out_of_service=out)


def placed(tpg: TemporalPlanGraph) -> list[int]:
    return sorted(task.step for task in tpg.tasks if task.kind in PLACES)


def require_rest_of(run: RunResult, left: PlanResult, t_s: float, folder: Path) -> None:
    """Check a plan against the tables of the run alone: it begins where the run was, and ends with all in place."""
    tpg = left.tpg
    lasts, starts = {}, {}
    for chain in tpg.chains:
        motion = run.motions[chain.robot]
        late = motion.q[np.searchsorted(motion.t_ns, round(t_s * 1e9)) :]
        # It stood there from then on, or came to stand there.
        stands = np.abs(late - chain.start).max(axis=1) < 1e-6
        assert stands.any()
        starts[chain.robot] = chain.start
        first = len(motion.q) - len(late) + int(np.argmax(stands))
        lasts[chain.robot] = motion.t_ns[first] * 1e-9
    rows = run.objects.to_pylist()
    for item in tpg.cell.objects:
        own = [row for row in rows if row["object"] == item.name]
        parents = {row["parent"].split("/")[0] for row in own} & lasts.keys()
        until = max([t_s, *(lasts[name] for name in parents)])
        k = sum(row["t_s"] <= until + 1e-9 for row in own) - 1
        while own[k]["parent"].split("/")[0] not in {"world", *starts}:
            k += 1  # who has nothing left to do has put it down, however late that was
        pose = from_quat_wxyz(own[k]["xyz"], own[k]["quat_wxyz"])
        holder = own[k]["parent"].split("/")[0]
        if holder in starts:
            pose = frame_pose(tpg.cell.robot(holder), starts[holder]) @ pose
            (taken,) = (
                h
                for h in tpg.handlings
                if h.object == item.name and tpg.holds_before(h)
            )
            assert taken.holder == holder
        assert np.allclose(item.start, pose, atol=1e-6)
    assert verify_plan(tpg).problems == ()
    again = twin.read_plan(left.save(folder / "plan"), left.scenario)
    done = twin.run(again, out=folder / "again", recording=False)
    # The audit wants every brick at its place in the end, those of before too.
    assert done.passed, done.summary["audit"]["violations"]


@settings(
    max_examples=2,
    deadline=None,
    suppress_health_check=[HealthCheck.function_scoped_fixture],
)
@given(share=st.floats(0.0, 0.93))
def test_whatever_the_time_the_rest_completes_what_was_executed(
    run: RunResult, tmp_path_factory: pytest.TempPathFactory, share: float
) -> None:
    t_s = round(share * run.makespan_s, 3)
    left = from_moment(run, t_s)
    require_rest_of(run, left, t_s, tmp_path_factory.mktemp("rest"))
    begun = left.tpg.cell.begun
    assert begun is not None
    before = dict(begun.done).get("place-down", 0)
    assert before + len(placed(left.tpg)) == 4


def test_at_the_beginning_it_is_the_whole_plan(
    run: RunResult, plan: PlanResult
) -> None:
    left = from_moment(run, 0.0)
    assert [t.label for t in left.tpg.tasks] == [t.label for t in plan.tpg.tasks]
    assert [len(c) for c in left.tpg.chains] == pytest.approx(
        [len(c) for c in plan.tpg.chains], rel=0.05
    )
    assert left.makespan_s == pytest.approx(plan.makespan_s, rel=0.05)


def test_hands_are_full_from_the_start(run: RunResult) -> None:
    left = from_moment(run, 0.13 * run.makespan_s).tpg
    held = {h.object: h.holder for h in left.handlings if left.holds_before(h)}
    assert held == {"left_a": "left", "right_a": "right"}
    # Where a hand is empty in the plan, the proof has the brick elsewhere than in the hand.
    moved = tuple(
        replace(item, start=item.start @ np.diag([-1.0, -1.0, 1.0, 1.0]))
        if item.name == "left_a"
        else item
        for item in left.cell.objects
    )
    found = verify_plan(replace(left, cell=replace(left.cell, objects=moved)))
    assert any("has it at the start" in p.message for p in found.problems)
    # Nor does a plan that says nothing of what was before begin anywhere but at HOME.
    unsaid = verify_plan(replace(left, cell=replace(left.cell, begun=None)))
    assert any("away from HOME" in p.message for p in unsaid.problems)


def test_who_is_out_stands_and_the_other_does_the_rest(
    run: RunResult, tmp_path: Path
) -> None:
    left = from_moment(run, 0.86 * run.makespan_s, "right")
    assert {chain.robot for chain in left.tpg.chains} == {"left"}
    done = twin.run(left, out=tmp_path / "run", recording=False)
    assert done.passed
    alone = from_moment(run, 0.0, "right")
    assert placed(alone.tpg) == [1, 2, 3, 4]
    assert {task.robot for task in alone.tpg.tasks} == {"left"}


@pytest.mark.parametrize(
    ("world", "out", "words"),
    [
        ("{run}", (), "is no time of a run: RUN@T"),
        ("{run}@soon", (), "is no time of a run: RUN@T"),
        ("{run}@nan", (), "is no time of a run: RUN@T"),
        ("{run}@-1", (), "is not within the run 'small', which went from 0 to 5"),
        ("{run}@1e6", (), "is not within the run 'small', which went from 0 to 5"),
        ("{run}@{end}", (), "nothing is left to do at"),
        ("{run}@0", ("middle",), "there is no robot 'middle'"),
        ("{run}@{held}", ("right",), "'right' is out and has 'right_a' in its hand"),
        (
            "{run}@12.9",
            ("right",),
            "not all steps can be done from there: step 2: .* blocked at",
        ),
        (None, ("right",), "out of service from a time of a run on"),
    ],
)
def test_what_cannot_go_on_is_refused_with_the_reason(
    run: RunResult,
    plan: PlanResult,
    world: str | None,
    out: tuple[str, ...],
    words: str,
) -> None:
    if world is not None:
        end = repr(run.makespan_s)
        held = 0.13 * run.makespan_s
        world = world.format(run=run.files, end=end, held=held)
    with pytest.raises(RequestError, match=words):
        twin.plan(plan.scenario, world=world, out_of_service=out)


def test_other_cells_and_other_runs_are_refused(
    run: RunResult, plan: PlanResult, tmp_path: Path
) -> None:
    world = f"{run.files}@20"
    moved = plan.scenario.varied({"cell.robots.left.base.xyz_m.2": 0.93})
    with pytest.raises(RequestError, match="cell is not that of the run"):
        twin.plan(moved, world=world)
    with pytest.raises(OutputError, match="this is no run"):
        twin.plan(world=f"{tmp_path}@20")
    with pytest.raises(RequestError, match="say what to plan"):
        twin.plan()
    left = twin.plan(world=world)
    with pytest.raises(ScenarioError, match="has moved: its base"):
        twin.read_plan(left.save(tmp_path / "left"), moved)
    resumed = twin.run(left, out=tmp_path / "resumed", recording=False, audit=False)
    with pytest.raises(RequestError, match="itself began in the middle, after small"):
        twin.plan(world=twin.RunMoment(resumed, 5.0))


@pytest.mark.parametrize(
    "seed", [1, *(pytest.param(k, marks=pytest.mark.nightly) for k in (2, 3, 4, 6))]
)
def test_what_a_failed_run_left_is_done(
    plan: PlanResult, tmp_path: Path, seed: int
) -> None:
    case = plan.scenario.varied({"seed": seed, **lost(0.25)})
    run = twin.run(
        replace(plan, scenario=case), out=tmp_path / "run", recording=False, audit=False
    )
    assert run.outcome == "failed"
    # The last event: everybody has gone as far as they could without the skill that failed.
    left = from_moment(run, run.makespan_ns / 1e9)
    assert verify_plan(left.tpg).problems == ()
    calm = replace(left, scenario=left.scenario.varied({"failures": {}}))
    done = twin.run(calm, out=tmp_path / "again", recording=False)
    assert done.passed, done.summary["audit"]["violations"]


@pytest.mark.nightly
@pytest.mark.parametrize("seed", range(1, 7))
def test_runs_in_which_skills_failed_go_on_without_what_was_lost(
    plan: PlanResult, tmp_path: Path, seed: int
) -> None:
    case = plan.scenario.varied({"seed": seed, **lost(0.25)})
    run = twin.operate(case, out=tmp_path / "run", recording=False, audit=False)
    refused = []
    for share in (0.2, 0.4, 0.6, 0.8):
        try:
            left = from_moment(run, share * run.makespan_s)
        except RequestError as error:
            refused.append(str(error))
            continue
        assert TaskKind.FAILED not in {task.kind for task in left.tpg.tasks}
        assert verify_plan(left.tpg).problems == ()
        calm = replace(left, scenario=left.scenario.varied({"failures": {}}))
        done = twin.run(calm, out=tmp_path / f"{share}", recording=False)
        assert done.passed, done.summary["audit"]["violations"]
    words = ("fails later in this run", "nothing is left to do")
    assert all(any(own in text for own in words) for text in refused)


@pytest.mark.nightly
@pytest.mark.parametrize(
    "name",
    ["lego/cliff", "multi_arm/multi_goal", "assembly/gearbox", "assembly/taskboard"],
)
def test_shipped_scenarios_go_on_from_anywhere(
    shipped: ShippedRuns, name: str, tmp_path: Path
) -> None:
    run = shipped(name).trial
    for share in (0.0, 0.11, 0.37, 0.72):
        t_s = round(share * run.makespan_s, 3)
        left = from_moment(run, t_s)
        require_rest_of(run, left, t_s, tmp_path / f"{share}")


def test_the_program_plans_the_rest(run: RunResult, tmp_path: Path) -> None:
    rest = tmp_path / "rest"
    said = invoke("plan", "--from", f"{run.files}@12", "--out", rest, code=0).output
    assert "begins after small" in said
    assert "left holds left_a" in said
    assert "4 steps, 15 tasks" in said
    wrong = invoke("plan", "--from", f"{run.files}@9999", "--out", rest, code=2)
    assert "is not within the run" in wrong.stderr
    assert invoke("plan", code=2).stderr.startswith("error: say what to plan")


@pytest.mark.nightly
def test_the_program_verifies_runs_and_studies_the_rest(
    run: RunResult, tmp_path: Path
) -> None:
    rest, file, again = (tmp_path / name for name in ("rest", "stack.yaml", "again"))
    file.write_text(STACK)
    invoke("plan", "--from", f"{run.files}@12", "--out", rest, code=0)
    invoke("verify", rest, code=0)
    invoke("run", file, "--plan", rest, "--out", again, code=0)
    invoke("export", again, "--format", "mcap", "--format", "open-plan", code=0)
    invoke("study", "--plan", rest, "-n", 3, "--out", tmp_path / "study", code=0)
