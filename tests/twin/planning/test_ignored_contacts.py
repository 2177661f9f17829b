"""Pairs of links that may overlap: planner, verification and audit leave them out, and only them."""

from dataclasses import replace
from pathlib import Path

import pytest

import twin
from planning.cell.workcell import Workcell
from scheduling.verification.verify import verify_plan
from tests.planning.vendor_files.folding_arm import SRDF, folding_cell
from tests.twin.program import invoke
from twin.audits.worlds.world import AuditWorld, overlapping_at_home
from twin.planning.build_workcell import build_workcell
from twin.reading.scenario_file import load_scenario

PAIR = ", ignore_contacts: [[link3, link1]]"


def cell_of(file: Path) -> Workcell:
    return build_workcell(load_scenario(file), file.parent)


def audited(cell: Workcell) -> set[tuple[str, str]]:
    """Pairs of links that the audit does not check."""
    world = AuditWorld(cell)
    names = [shape.detail.partition("/")[2] for shape in world.robot_shapes]
    return {(names[i], names[j]) for i, j in overlapping_at_home(world)}


def test_an_arm_that_folds_needs_the_pair(tmp_path: Path) -> None:
    done = invoke("run", folding_cell(tmp_path), "--out", tmp_path / "out", code=2)
    assert "link1_0 and one/arm:link3_0 overlap by 40.0 mm" in done.output


@pytest.mark.parametrize(("more", "srdf"), [(PAIR, None), ("", SRDF)])
def test_all_programs_leave_the_pair_out(
    more: str, srdf: str | None, tmp_path: Path
) -> None:
    plain = cell_of(folding_cell(tmp_path))
    file = folding_cell(tmp_path, more, srdf)
    cell = cell_of(file)
    assert audited(cell) - audited(plain) == {("link1", "link3")}
    plan = twin.plan(file)
    assert twin.audit(twin.simulate(plan)).clean
    tpg = plan.tpg
    assert verify_plan(tpg).ok
    problems = verify_plan(replace(tpg, cell=plain)).problems
    assert {problem.kind for problem in problems} == {"itself"}


@pytest.mark.nightly
def test_the_judge_leaves_the_pair_out(tmp_path: Path) -> None:
    file, plan = folding_cell(tmp_path, PAIR), tmp_path / "plan.json"
    invoke("run", file, "--out", tmp_path / "out", code=0)
    invoke("export", tmp_path / "out", "-f", "open-plan", "--out", plan, code=0)
    invoke("judge", plan, "--scenario", file, code=0)
    plain = folding_cell(tmp_path)
    invoke("judge", plan, "--scenario", plain, code=1)


@pytest.mark.parametrize(
    ("pair", "words"),
    [
        ("[link1, gone]", "there is no link 'gone' (valid: foot, link1, link2"),
        ("[link1]", "ignore_contacts[0]: 2 e"),
        ("[link1, 3]", "ignore_contacts[0][1]"),
    ],
)
def test_a_pair_that_is_none_is_refused_at_its_key(
    pair: str, words: str, tmp_path: Path
) -> None:
    file = folding_cell(tmp_path, f", ignore_contacts: [{pair}]")
    done = invoke("validate", file, code=2)
    assert words in done.output
    assert "cell.yaml:5" in done.output


def test_check_says_what_is_not_checked(tmp_path: Path) -> None:
    done = invoke("check", folding_cell(tmp_path, PAIR), code=0)
    assert (
        "one: pairs of links that are not checked for collisions: ignore_contacts (1)"
        in done.output
    )
    assert "link1 and link3 (40 mm deep" in done.output
