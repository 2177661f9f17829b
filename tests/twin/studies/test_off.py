"""Studies whose bases or skills are off: drawn by replication, inside what was said, and audited where they are."""

import json
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from planning.cell.workcell import PoseError
from planning.kinematics.kinematics import frame_pose
from scheduling.graph.plan_files import load_plan
from tests.twin.program import invoke
from tests.twin.written import written
from twin.audits.audit import audit_off_bases, audit_run
from twin.audits.motion.deviations import with_flange_deviations
from twin.audits.motion.executed import read_recording
from twin.studies.folder import AUDITS
from twin.studies.pose_errors import drawn_deviations

ROOT = Path(__file__).parents[3]
SCENARIO = ROOT / "scenarios/multi_arm/rearrangement.yaml"


def studied(folder: Path, off: str) -> tuple[str, list[dict[str, float]]]:
    """What a study says, and what the audit found in each replication."""
    line = f"execution:\n  {off}\n"
    text = SCENARIO.read_text(encoding="utf-8")
    file = written(folder.parent, text, ("execution:\n", line))
    study = ("study", str(file), "-n", "4", "--workers", "0", "--out", str(folder))
    how = ("--policy", "asynchronous", "--audit-sample", "3")
    found = invoke(*study, *how, code=0)
    files = sorted((folder / AUDITS / "0").glob("*.json"))
    said = " ".join(found.output.split())
    return said, [json.loads(file.read_text()) for file in files]


@pytest.mark.nightly
@pytest.mark.usefixtures("no_report")
def test_replications_are_audited_where_their_bases_are(tmp_path: Path) -> None:
    said, small = studied(tmp_path / "small", "base_error: {m: 0.0002, rad: 0.0001}")
    assert len(small) == 3
    assert [item["violations"] for item in small] == [0, 0, 0]
    assert len({item["min_distance_m"] for item in small}) == 3
    assert "0 of 3 replications audited with" in said
    assert "bases and skills off as drawn" in said
    _, large = studied(tmp_path / "large", "base_error: {m: 0.1, rad: 0.1}")
    assert any(item["violations"] for item in large)


def test_bases_where_they_are_planned_make_no_difference(tmp_path: Path) -> None:
    out = tmp_path / "run"
    invoke("run", SCENARIO, "--out", out, "-q", "--shortcuts", "0", code=0)
    tpg = load_plan(out)
    recording = read_recording(out, tpg.cell)
    usual = audit_run(out, engine="coal")
    same = audit_off_bases(tpg, recording, {}, "coal")
    assert same.violations == ()
    assert same.min_distance_m == pytest.approx(usual.min_distance_m, abs=1e-9)
    # All of them 5 cm up together: from each other they are as far away as before.
    up = {r.name: np.array(r.base) for r in tpg.cell.robots}
    for base in up.values():
        base[2, 3] += 0.05
    raised = audit_off_bases(tpg, recording, up, "coal")
    assert raised.min_distance_m == pytest.approx(usual.min_distance_m, abs=1e-6)
    # One of them 12 cm down: what it reaches for, and the table, are in its way.
    first = next(iter(up))
    down = np.array(tpg.cell.robot(first).base)
    down[2, 3] -= 0.12
    lowered = audit_off_bases(tpg, recording, {first: down}, "coal")
    assert lowered.violations
    assert all(
        first in v.first or first in v.second or v.depth_m > 0.0
        for v in lowered.violations
    )


ERROR = PoseError(0.002, 0.01)


@pytest.mark.nightly
@pytest.mark.usefixtures("no_report")
def test_replications_are_audited_on_the_paths_that_are_drawn(tmp_path: Path) -> None:
    own = "{pick: {m: 0.0002, rad: 0.0002}, place-down: {m: 0.0002}}"
    said, found = studied(tmp_path / "study", f"deviation: {own}")
    assert "0 of 3 replications audited with" in said
    assert "bases and skills off as drawn" in said
    assert len({item["min_distance_m"] for item in found}) == 3


@pytest.mark.nightly
@pytest.mark.parametrize("limits", [False, True])
def test_flanges_go_where_they_are_drawn_in_skills_and_nowhere_else(
    tmp_path: Path, limits: bool
) -> None:
    text, out = SCENARIO.read_text(encoding="utf-8"), tmp_path / "run"
    change = [("speed_model: l1\n", "speed_model: limits\n")] if limits else []
    file = written(tmp_path, text, *change)
    invoke("run", file, "--out", out, "-q", "--shortcuts", "0", code=0)
    tpg = load_plan(out)
    usual = read_recording(out, tpg.cell)
    skills = {"pick": ERROR, "place-down": ERROR}
    twists = drawn_deviations(tpg, skills, seed=3, replication=1)
    assert twists
    assert twists.keys() == {
        (chain.robot, node)
        for chain in tpg.chains
        for node in np.flatnonzero(chain.skill).tolist()
    }
    ways = np.array(list(twists.values()))
    assert np.linalg.norm(ways[:, :3], axis=1).max() <= ERROR.m
    assert np.linalg.norm(ways[:, 3:], axis=1).max() <= ERROR.rad
    # All nodes of one skill are off by the same, no two skills are.
    doing = {c.robot: c.task for c in tpg.chains}
    tasks = {(robot, int(doing[robot][node])) for robot, node in twists}
    assert len(np.unique(ways[:, 0])) == len(tasks)
    off = with_flange_deviations(tpg.cell, usual, twists)
    (name, node), twist = next(iter(twists.items()))
    robot, rows, moved = (
        tpg.cell.robot(name),
        usual.robots[name],
        off.robots[name],
    )
    assert moved.t[-1] == rows.t[-1]
    inside = np.flatnonzero(moved.node == node)
    times = np.linspace(moved.t[inside[0] - 1], moved.t[inside[-1]], 101)
    far = []
    for q, other in zip(rows.at(times), moved.at(times), strict=True):
        a, b = frame_pose(robot, q), frame_pose(robot, other)
        turn = Rotation.from_matrix(b[:3, :3] @ a[:3, :3].T).as_rotvec()
        far.append(np.concatenate([b[:3, 3] - a[:3, 3], turn]))
    assert np.allclose(far[0], 0.0, atol=1e-9)
    assert np.allclose(far[-1], 0.0, atol=1e-9)
    best = int(np.argmin(np.linalg.norm(np.array(far) - twist, axis=1)))
    assert np.allclose(far[best], twist, atol=2e-5)
    most = np.linalg.norm(np.array(far)[:, :3], axis=1).max()
    assert most <= np.linalg.norm(twist[:3]) + 2e-5
    # Outside skills it is where it was.
    own = {n for r, n in twists if r == name}
    calm = [t for t, n in zip(rows.t, rows.node, strict=True) if n not in own]
    assert np.allclose(moved.at(np.array(calm)), rows.at(np.array(calm)), atol=1e-9)
