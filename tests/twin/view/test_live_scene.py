"""The scene of a cell in operation shows robots and objects where they are reported."""

import threading
import time
from pathlib import Path
from typing import Any
from urllib.request import urlopen

import numpy as np
import pytest

import twin
from planning.kinematics.kinematics import frame_pose, joint_poses_of
from planning.tasks.task import Handling
from planning.transforms import Array, translation
from tests.twin.operations.operated import STACK
from twin.planning.build_workcell import build_workcell
from twin.runs.trajectory import Placement, object_placements
from twin.trial.loaded_scenario import load
from twin.view import live_scene as module
from twin.view.cell_scene import CellScene


@pytest.fixture
def scenes(monkeypatch: pytest.MonkeyPatch) -> list[CellScene]:
    """Scenes that are made."""
    found: list[CellScene] = []

    class Kept(CellScene):
        def __init__(self, *about: Any) -> None:
            super().__init__(*about)
            found.append(self)

    monkeypatch.setattr(module, "CellScene", Kept)
    return found


def until(true: Any) -> None:
    end = time.monotonic() + 60.0
    while not true():
        assert time.monotonic() < end
        time.sleep(0.02)


def place(scene: CellScene, body: str, joint: int = 0) -> Array:
    return np.array(scene._bodies[body].nodes[joint].position)


def test_reported_bodies(tmp_path: Path, scenes: list[CellScene]) -> None:
    (tmp_path / "stack.yaml").write_text(STACK)
    case = load(tmp_path / "stack.yaml")
    cell = build_workcell(case.sections, case.folder)
    held, gone, rest = (item.name for item in cell.objects[:3])
    bodies: list[module.Bodies | None] = [None]
    with module.live_scene(case, lambda: bodies[0]) as address:
        assert address.startswith("http://127.0.0.1:")
        (scene,) = scenes
        left, right = cell.robots[0], cell.robots[1]
        q = left.home + 0.1
        hand, last = translation(0.0, 0.0, 0.02), f"robots/{left.name}"
        before = place(scene, last, 6)
        bodies[0] = (
            cell,
            {left.name: q},
            {
                held: Placement(0, held, left.name, hand),
                gone: Placement(0, gone, Handling.GONE, hand),
            },
        )
        until(lambda: not np.array_equal(place(scene, last, 6), before))
        until(lambda: not scene._bodies[f"objects/{gone}"].nodes[0].visible)
        expected = (frame_pose(left, q) @ hand)[:3, 3]
        np.testing.assert_allclose(place(scene, f"objects/{held}"), expected, atol=1e-6)
        start = cell.object(rest).start[:3, 3]
        np.testing.assert_allclose(place(scene, f"objects/{rest}"), start, atol=1e-6)
        poses = joint_poses_of(right, right.home)
        np.testing.assert_allclose(
            place(scene, f"robots/{right.name}", 6), poses[6][:3, 3], atol=1e-6
        )


@pytest.mark.nightly
def test_a_cell_is_operated_with_its_scene(
    tmp_path: Path, scenes: list[CellScene]
) -> None:
    (tmp_path / "stack.yaml").write_text(STACK)
    (tmp_path / "drivers.yaml").write_text("pace: 10\n")
    seen: list[Any] = []

    def look(address: str) -> None:
        with urlopen(f"{address}scene", timeout=120) as answer:
            seen.append((answer.status, answer.url.split("/")[2] in address))

    threads = []

    def opened(address: str) -> None:
        threads.append(threading.Thread(target=look, args=[address], daemon=True))
        threads[0].start()

    done = twin.operate(
        tmp_path / "stack.yaml",
        drivers=tmp_path / "drivers.yaml",
        page=0,
        opened=opened,
        out=tmp_path / "run",
        recording=False,
        audit=False,
    )
    threads[0].join()
    assert seen == [(200, False)]
    assert done.outcome == "completed"
    (scene,) = scenes
    assert done.record is not None
    last = {own.object: own for own in object_placements(done.tpg, done.record)}
    for name, own in last.items():
        assert own.holder is None
        shown = place(scene, f"objects/{name}")
        np.testing.assert_allclose(shown, own.pose[:3, 3], atol=1e-6)
