"""Bars that meet in nodes: how deep they may be in each other, and who keeps hold of them.

A beam that would fall off a post: refused, propped in a found order, or joined, up to the audit.
"""

import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from planning.cell.workcell import CONTACT_DEPTH
from planning.errors import InfeasibleStepError
from scheduling.verification.verify import verify_plan
from tests.twin.scenarios.cells import cell, panda
from tests.twin.scenarios.executed import built, executed
from tests.twin.written import loaded
from twin.audits.audit import AuditReport, audit_run
from twin.audits.expectations import scenario_expectations
from twin.checks.finding import CheckContext
from twin.kinds.parts.checks.places import check_balance
from twin.reading.scenario_file import load_scenario
from twin.trial.loaded_scenario import LoadedScenario
from twin.trial.plan_result import PlanResult, given_plan
from twin.trial.planning import plan_scenario
from twin.trial.run_plan import run_plan_to_folder
from twin.trial.run_result import RunResult

NODE = cell(
    "node",
    (panda("arm", -0.5),),
    """\
  kind: assembly
  grips: {positions: 3, depth_m: 0.012}
  parts:
    - name: first
      shape: {cylinder: {radius_m: 0.012, length_m: 0.2}}
      start: {xyz_m: [-0.1, 0.3, 0.0125], rpy_deg: [0, 90, 0]}
      goal: {xyz_m: [0, 0.1, 0.0125], rpy_deg: [0, 90, 0]}
    - name: second
      shape: {cylinder: {radius_m: 0.012, length_m: 0.2}}
      start: {xyz_m: [-0.1, -0.3, 0.0125], rpy_deg: [0, 90, 0]}
      goal: {xyz_m: [0.04, -0.006, 0.0125], rpy_deg: [0, 90, 90]}
  joined: [[first, second]]
  joined_overlap_m: 0.007
  steps: [first, second]
planning: {speed_model: l1, speed_rad_s: 4.0, shortcut_candidates: 0}
""",
)


def test_bars_that_are_joined_may_be_in_each_other_as_far_as_the_scenario_says(
    tmp_path: Path,
) -> None:
    given = loaded(tmp_path, NODE)
    planned = plan_scenario(given)
    tpg = planned.tpg
    assert verify_plan(tpg).problems == ()
    usual = replace(tpg.cell.clearances, contact_depth=CONTACT_DEPTH)
    less = replace(tpg, cell=replace(tpg.cell, clearances=usual))
    words = [p.message for p in verify_plan(less).problems]
    assert words
    assert all("first" in text and "second" in text for text in words)
    # The plan says of the pair how deep it is, and is held to that by proof and audit.
    own = [c for c in tpg.allowed if {c.first, c.second} == {"first", "second"}]
    assert own
    assert all(0.005 < (c.depth or 0.0) < 0.0065 for c in own)
    allowed = tuple(replace(c, depth=0.0045) if c in own else c for c in tpg.allowed)
    shallow = replace(tpg, allowed=allowed)
    words = [p.message for p in verify_plan(shallow).problems]
    assert words
    assert all("first" in text and "second" in text for text in words)
    case = given_plan(LoadedScenario(given, tmp_path), shallow)
    (tmp_path / "shallow").mkdir()
    found = run_plan_to_folder(case, tmp_path / "shallow").summary["audit"][
        "violations"
    ]
    assert {(v["kind"], *sorted((v["first"], v["second"]))) for v in found} == {
        ("contact", "first", "second")
    }
    out = tmp_path / "run"
    executed(given, tpg, out)
    wanted = scenario_expectations(given)
    smaller = dict.fromkeys(wanted.overlaps_m, 0.002)
    strict = audit_run(out, wanted=replace(wanted, overlaps_m=smaller))
    assert {v.kind for v in strict.violations} == {"contact"}
    touched = {name for v in strict.violations for name in (v.first, v.second)}
    assert touched == {"first", "second"}


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("  joined_overlap_m: 0.007\n", "", "say joined_overlap_m: 0.006"),
        (
            "  joined: [[first, second]]\n",
            "",
            r"join them \(joined: \[\[first, second\]\]\)$",
        ),
    ],
)
def test_bars_that_are_too_deep_in_each_other_are_refused_with_the_remedy(
    old: str, new: str, said: str, tmp_path: Path
) -> None:
    given = loaded(tmp_path, NODE, (old, new))
    with pytest.raises(InfeasibleStepError, match=said):
        plan_scenario(given)


KEPT = cell(
    "kept",
    (panda("left", -0.5), panda("right", 0.5)),
    """\
  kind: assembly
  grips: {positions: 3, depth_m: 0.012}
  parts:
    - {name: post, size_m: [0.03, 0.03, 0.06], start: {xyz_m: [-0.1, 0.3, 0.0305]}, goal: {xyz_m: [0.05, 0, 0.0305]}}
    - {name: beam, size_m: [0.2, 0.03, 0.03], start: {xyz_m: [-0.2, -0.3, 0.0155]}, goal: {xyz_m: [-0.04, 0, 0.076]}}
    - {name: cap, size_m: [0.03, 0.03, 0.03], start: {xyz_m: [0.2, -0.3, 0.0155]}, goal: {xyz_m: [-0.12, 0, 0.107]}}
  processes:
    weld: {duration: {kind: fixed, value_s: 3}}
  steps:
    - post
    - beam
    - {process: weld, at: {pose: {xyz_m: [0.05, 0, 0.0915]}}, after: [beam], name: neck}
    - cap
  joined: [[table, post], {parts: [post, beam], by: neck}]
planning: {shortcut_candidates: 20}
""",
)


@pytest.fixture(scope="module")
def kept_run(tmp_path_factory: pytest.TempPathFactory) -> tuple[PlanResult, RunResult]:
    folder = tmp_path_factory.mktemp("kept")
    given = loaded(folder, KEPT)
    planned = plan_scenario(given)
    return planned, executed(given, planned.tpg, folder / "run")


def test_what_would_fall_is_kept_hold_of_until_it_is_joined(
    kept_run: tuple[PlanResult, RunResult],
) -> None:
    planned, _ = kept_run
    tasks = planned.tpg.tasks
    place = next(t for t in tasks if t.kind == "place-down" and t.object == "beam")
    weld = next(t for t in tasks if t.kind == "weld")
    back = next(t for t in tasks if t.label == "let go of beam")
    assert place.robot == back.robot != weld.robot
    own = [t.index for t in tasks if t.robot == place.robot]
    assert own.index(back.index) == own.index(place.index) + 1
    assert (weld.index, back.index) in {tuple(d) for d in planned.tpg.dependencies}
    assert verify_plan(planned.tpg).problems == ()


def kept_report(folder: Path, **keeps: str) -> AuditReport:
    given = load_scenario(folder.parent / "own.yaml")
    wanted = scenario_expectations(given)
    assert wanted.keeps == {}
    return audit_run(folder, wanted=replace(wanted, keeps=keeps))


def test_the_audit_finds_what_is_let_go_of_too_early(
    kept_run: tuple[PlanResult, RunResult], tmp_path: Path
) -> None:
    """The arm that keeps hold goes away a second before the weld is done: no edge tells."""
    planned, trial = kept_run
    tpg = planned.tpg
    weld, back = (
        next(t for t in tpg.tasks if t.label.startswith(words))
        for words in ("weld", "let go of beam")
    )
    chain = tpg.chains[tpg.chain_index[back.robot]]
    away = int(np.flatnonzero(chain.task == back.index)[0])
    table = pq.read_table(trial.files / "trajectory.parquet")
    t, node = (np.array(table[name].to_pylist()) for name in ("t_s", "node"))
    own = np.array(table["robot"].to_pylist()) == back.robot
    # It stands from when it has placed the part, and now until a second earlier.
    assert t[own & (node >= away)].min() > t[own & (node < away)].max() + 1.0
    t[own & (node >= away)] -= 1.0
    folder = tmp_path / "run"
    shutil.copytree(trial.files, folder)
    shutil.copy(trial.files.parent / "own.yaml", tmp_path)
    column = table.column_names.index("t_s")
    pq.write_table(
        table.set_column(column, "t_s", pa.array(t)), folder / "trajectory.parquet"
    )
    # What it does next comes too early as well, for other checks.
    (v,) = (v for v in kept_report(folder).violations if v.kind == "support")
    assert (v.first, v.second) == ("beam", back.robot)
    # Its fingers take 0.4 s to open, and hold until then.
    assert v.t_end - v.t_start == pytest.approx(1.0 - 0.4, abs=0.01)
    assert f"before {weld.label} is complete" in v.detail


def test_the_audit_takes_from_the_scenario_how_long_a_part_is_kept_hold_of(
    kept_run: tuple[PlanResult, RunResult], tmp_path: Path
) -> None:
    folder = kept_run[1].files
    assert kept_report(folder, beam="neck").violations == ()
    (v,) = kept_report(folder, post="neck").violations
    assert (v.kind, v.first) == ("support", "post")
    assert "before neck is complete" in v.detail
    said = "    - beam\n", "    - {place: beam, until: neck}\n"
    given = loaded(tmp_path, KEPT, said)
    wanted = scenario_expectations(given)
    assert wanted.keeps == {"beam": "neck"}


SCENARIO = cell(
    "cantilever",
    (panda("arm", -0.5),),
    """\
  kind: assembly
  grips: {positions: 3, depth_m: 0.012}
  parts:
    - {name: post, size_m: [0.03, 0.03, 0.06], start: {xyz_m: [-0.1, 0.3, 0.0305]}, goal: {xyz_m: [0, 0, 0.0305]}}
    - {name: prop, size_m: [0.03, 0.03, 0.06], start: {xyz_m: [-0.2, 0.3, 0.0305]}, goal: {xyz_m: [0.1, 0, 0.0305]}}
    - {name: beam, size_m: [0.16, 0.03, 0.03], start: {xyz_m: [-0.1, -0.3, 0.0155]}, goal: {xyz_m: [0.04, 0, 0.076]}}
  steps: [post, beam, prop]
planning: {speed_rad_s: 4.0, shortcut_candidates: 0}
""",
)
BEAM, JOINED = (
    "goal: {xyz_m: [0.04, 0, 0.076]}",
    "joined: [[table, post], [post, beam]]",
)
STEPS = "steps: [post, beam, prop]"


def test_it_is_refused_before_anything_is_planned(tmp_path: Path) -> None:
    given = loaded(tmp_path, SCENARIO)
    with pytest.raises(InfeasibleStepError, match="beam would not stand") as caught:
        plan_scenario(given)
    assert "joined: [[post, beam]]" in str(caught.value)
    assert "place prop before" in str(caught.value)
    (finding,) = check_balance(CheckContext(given, tmp_path))
    assert finding.error
    assert finding.at == ("assembly", "parts", 2, "goal")


def test_the_check_can_be_turned_off(tmp_path: Path) -> None:
    unchecked = "steps:", "balance: {check: false}\n  steps:"
    off = loaded(tmp_path, SCENARIO, unchecked)
    assert not list(check_balance(CheckContext(off, tmp_path)))


@pytest.mark.parametrize(
    ("new", "order"),
    [
        (f"order: find\n  {STEPS}", ["post", "prop", "beam"]),
        (f"{JOINED}\n  steps: [post, beam]", ["post", "beam"]),
    ],
)
def test_a_prop_or_a_joint_keeps_it_up(
    new: str, order: list[str], tmp_path: Path
) -> None:
    tasks = built(tmp_path, SCENARIO, (STEPS, new), recording=True).tpg.tasks
    assert [t.object for t in tasks if t.kind == "place-down"] == order


def test_the_centre_of_mass_decides_what_falls(tmp_path: Path) -> None:
    alone = "beam, prop]", "beam]"
    built(tmp_path, SCENARIO, (BEAM, f"centre_of_mass_m: [-0.04, 0, 0], {BEAM}"), alone)
    ahead = BEAM, f"centre_of_mass_m: [0.01, 0, 0], {BEAM}"
    with pytest.raises(InfeasibleStepError, match="beam would not stand"):
        plan_scenario(loaded(tmp_path, SCENARIO, ahead, alone))


def test_what_hangs_on_a_joint_hangs_for_the_audit_without_it(tmp_path: Path) -> None:
    """The beam stops 5 mm above the post: held by the joint alone."""
    higher = BEAM, BEAM.replace("0.076", "0.081")
    steps = "\n  steps: [post, beam]"
    gap = "joined: [[table, post], {parts: [post, beam], gap_m: 0.006}]"
    built(tmp_path, SCENARIO, higher, (STEPS, gap + steps))
    bare = loaded(
        tmp_path, SCENARIO, higher, (STEPS, "joined: [[table, post]]" + steps)
    )
    with pytest.raises(InfeasibleStepError, match="in the air"):
        plan_scenario(bare)
