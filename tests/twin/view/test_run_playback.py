"""Poses on the page are those that the audit replays."""

from itertools import pairwise

import numpy as np
import pytest

from planning.kinematics.kinematics import frame_pose, joint_poses_of
from tests.shipped_runs import ShippedRuns
from twin.audits.motion.executed import ReplayedRun, read_recording
from twin.audits.worlds.world import AuditWorld
from twin.view.run_playback import RunPlayback


@pytest.mark.parametrize("name", ["lego/cliff"])
def test_poses_are_those_of_the_audit(shipped: ShippedRuns, name: str) -> None:
    run = shipped(name).trial
    cell = run.tpg.cell
    playback = RunPlayback(run)
    recording = read_recording(run.files, cell)
    replayed, world = ReplayedRun(cell, recording), AuditWorld(cell)
    for t_s in np.random.default_rng(0).uniform(0.0, playback.end_s, 50).tolist():
        shown = playback.configurations(t_s)
        objects = playback.objects(t_s, shown)
        for k, robot in enumerate(cell.robots):
            q = recording.robots[robot.name].at(np.array([t_s]))
            np.testing.assert_allclose(shown[robot.name], q[0], atol=1e-6)
            flange = world.flange_poses(k, q)[0]
            np.testing.assert_allclose(
                frame_pose(robot, shown[robot.name]), flange, atol=1e-6
            )
            last = joint_poses_of(robot, q[0])
            tip = flange @ np.linalg.inv(robot.model.flange)
            joint = len(robot.model.joint_names)
            np.testing.assert_allclose(last[joint], tip, atol=1e-6)
        there = {}
        for stay in replayed.at(t_s).values():
            pose = stay.pose
            if stay.holder in shown:
                k = list(shown).index(stay.holder)
                q = recording.robots[stay.holder].at(np.array([t_s]))
                pose = world.flange_poses(k, q)[0] @ pose
            there[stay.object] = pose
        assert objects.keys() == {
            name for name, stay in replayed.at(t_s).items() if stay.holder != "(gone)"
        }
        for name, pose in objects.items():
            np.testing.assert_allclose(pose, there[name], atol=1e-6)


def test_events_one_after_another(shipped: ShippedRuns) -> None:
    playback = RunPlayback(shipped("lego/cliff").trial)
    t_s, seen = 0.0, []
    while t_s < playback.end_s:
        t_s = playback.neighbour_s(t_s, backwards=False)
        seen.append(t_s)
    assert seen == [t for t in playback.event_times_s if t > 1e-6]
    for expected in reversed(seen[:-1]):
        t_s = playback.neighbour_s(t_s, backwards=True)
        assert t_s == expected
    lanes = {lane["name"]: lane["bars"] for lane in playback.chart["lanes"]}
    assert set(lanes) == {"left", "right"}
    for bars in lanes.values():
        assert all(a[1] <= b[0] + 1e-9 for a, b in pairwise(bars))
