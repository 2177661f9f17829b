"""What is drawn beside the bodies of a run is where the audit's own kinematics has it."""

from collections.abc import Iterator
from itertools import combinations, product
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from planning.transforms import Array
from tests.shipped_runs import ShippedRuns
from twin.audits.worlds.world import AuditWorld
from twin.trial.run_result import RunResult
from twin.view.cell_scene import CellScene
from twin.view.look_panel import LookPanel
from twin.view.run_playback import RunPlayback
from twin.view.server import ViewServer


class Shown:
    """A run in a scene at a time, and its audit world."""

    def __init__(self, run: RunResult, server: ViewServer) -> None:
        self.playback, self.world = RunPlayback(run), AuditWorld(run.tpg.cell)
        self.names = [robot.name for robot in run.tpg.cell.robots]
        scene = CellScene(server.viser.scene)
        scene.show(run.tpg.cell)
        self.look: Any = LookPanel(server.viser, scene)
        self.look.begin(self.playback)

    def at(self, t_s: float, waits_s: float | None = None) -> dict[str, Array]:
        q = self.playback.configurations(t_s)
        objects = self.playback.objects(t_s, q)
        self.look.show(t_s, q, objects, t_s if waits_s is None else waits_s)
        return q

    def nodes(self, name: str) -> list[Any]:
        found: list[Any] = self.look._marks[name][1]
        return found

    def tools(self, robot: str, times_s: Array) -> Array:
        """Return the positions of a tool by the audit's kinematics, shape (m, 3)."""
        placed = self.playback.robots[robot]
        q = np.array([self.playback.configurations(t)[robot] for t in times_s])
        flange = self.world.flange_poses(self.names.index(robot), q)
        return np.asarray((flange @ placed.model.frames["tool"])[:, :3, 3])


@pytest.fixture(scope="module")
def shown(shipped: ShippedRuns) -> Iterator[Shown]:
    server = ViewServer({}, 8335, "cell")
    yield Shown(shipped("lego/cliff").trial, server)
    server.viser.stop()


def bars(shown: Shown, robot: str) -> list[list[Any]]:
    (lane,) = (own for own in shown.playback.chart["lanes"] if own["name"] == robot)
    found: list[list[Any]] = lane["bars"]
    return found


@pytest.mark.parametrize("ahead", [0, 1])
def test_the_motion_of_a_bar(shown: Shown, ahead: int) -> None:
    shown.look._motion.value = ("this bar", "next bar")[ahead]
    for k in np.random.default_rng(0).integers(0, 40, 4).tolist():
        now, bar = bars(shown, "left")[k], bars(shown, "left")[k + ahead]
        shown.at(0.5 * (now[0] + now[1]))
        path, *swept = shown.nodes("motion/left")
        ends = shown.tools("left", np.array(bar[:2]))
        np.testing.assert_allclose(path.points[[0, -1], [0, 1]], ends, atol=2e-6)
        times = np.linspace(bar[0], bar[1], len(path.points) + 1)
        middle = len(times) // 2
        expected = shown.tools("left", times[[middle]])
        np.testing.assert_allclose(path.points[[middle], 0], expected, atol=2e-6)
        # Bodies stand where the robot is at the beginning and at the end, and within the motion between.
        q = [shown.playback.configurations(t)["left"] for t in times]
        frames = shown.world.link_frames(shown.names.index("left"), np.array(q))[1]
        assert len(swept) == 6
        for joint, node in enumerate(swept, start=1):
            at = node.batched_positions
            np.testing.assert_allclose(at[0], frames[0, joint], atol=2e-6)
            away = np.linalg.norm(at[:, None] - frames[None, :, joint], axis=2)
            assert away.min(axis=1).max() < 2e-6
    shown.look._motion.value = "whole run"
    shown.at(3.0)
    (path,) = shown.nodes("motion/right")
    whole = shown.tools("right", np.array([0.0, shown.playback.end_s]))
    np.testing.assert_allclose(path.points[[0, -1], [0, 1]], whole, atol=2e-6)
    shown.look._camera.value = "robots/left"
    shown.at(3.1)
    assert shown.nodes("motion/left")
    assert not shown.nodes("motion/right")
    shown.look._camera.value = shown.look._motion.value = "nothing"


def test_the_least_distance_is_that_of_all_pairs(shown: Shown) -> None:
    shown.look._distance.value = True
    world, robots = shown.world, range(len(shown.names))
    for t_s in np.random.default_rng(1).uniform(0.0, shown.playback.end_s, 5).tolist():
        q = shown.at(t_s)
        for k, name in enumerate(shown.names):
            world.configure(k, q[name])
        own = [[s for s in world.robot_shapes if s.robot == k] for k in robots]
        expected = min(
            world.distance(a, b, 10.0)
            for first, second in combinations(own, 2)
            for a, b in product(first, second)
        )
        (line,) = shown.nodes("line/")
        length = np.linalg.norm(np.diff(line.points[0], axis=0))
        assert length == pytest.approx(expected, abs=5e-5)
        assert (
            shown.look._distance.label == f"Distance of robots: {1e3 * expected:.0f} mm"
        )
    shown.look._distance.value = False
    shown.at(1.0)
    assert shown.nodes("line/") == []


def test_a_line_leads_from_who_waits_to_what_is_waited_for(shown: Shown) -> None:
    waits = [bar for bar in bars(shown, "right") if bar[4]]
    assert {bar[2] for bar in waits} == {"waiting"}
    assert {bar[4] for bar in waits} == {"robots/left"}
    t_s = 0.5 * (waits[0][0] + waits[0][1])
    assert "waits for left" in waits[0][3]
    shown.at(t_s)
    (line,) = shown.nodes("line/right")
    ends = [shown.tools(robot, np.array([t_s]))[0] for robot in ("right", "left")]
    np.testing.assert_allclose(line.points[0], ends, atol=2e-6)
    shown.at(waits[0][1] + 1e-3)
    assert shown.nodes("line/right") == []
    # Of a bar under the pointer, between where both are now.
    shown.at(waits[0][1] + 1e-3, waits_s=t_s)
    (line,) = shown.nodes("line/right")
    now = np.array([waits[0][1] + 1e-3])
    ends = [shown.tools(robot, now)[0] for robot in ("right", "left")]
    np.testing.assert_allclose(line.points[0], ends, atol=2e-6)


def test_the_camera_keeps_its_offset(
    shown: Shown, monkeypatch: pytest.MonkeyPatch
) -> None:
    camera = SimpleNamespace(
        update_timestamp=1.0, position=np.array([2.0, 0.0, 1.0]), look_at=np.zeros(3)
    )
    client, late = SimpleNamespace(camera=camera), SimpleNamespace()
    late.camera = SimpleNamespace(update_timestamp=0.0)  # has not said where it is
    server = SimpleNamespace(get_clients=lambda: {0: client, 1: late})
    monkeypatch.setattr(shown.look, "_server", server)
    shown.look._camera.value = "robots/right"
    shown.at(9.0)
    tool = shown.tools("right", np.array([9.0]))[0]
    expected = tool + np.array([2.0, 0.0, 1.0])
    np.testing.assert_allclose(camera.position, expected, atol=1e-6)
    shown.look._camera.value = "nothing"
