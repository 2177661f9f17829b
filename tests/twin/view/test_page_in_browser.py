"""The page in a browser: a run is played, a robot is moved, a finding appears, and the file is saved."""

import re
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import twin
from tests.browser import WAIT_MS, opened_page, playwright
from twin.reading.scenario_file import load_scenario
from twin.scenario.shipped import shipped_scenarios
from twin.view.api import cell_page
from twin.view.cell_page import CellPage
from twin.view.cell_scene import _AT_FAULT, tool_pose

pytestmark = [pytest.mark.nightly, pytest.mark.timeout(900)]


@contextmanager
def opened(path: Path, port: int) -> Iterator[tuple[Any, Any, CellPage]]:
    """Yield the page of a path in the browser, the frame of its scene, and what serves it."""
    shown = cell_page(path, port=port)
    try:
        size = {"width": 1200, "height": 800}
        with opened_page(shown.server.address, viewport=size) as page:
            frame = page.frame_locator("#scene")
            frame.get_by_role("tab", name="Findings").wait_for()
            yield page, frame, shown
    finally:
        shown.close()


@pytest.fixture
def file(tmp_path: Path) -> Path:
    return Path(shutil.copy(shipped_scenarios()["tray"], tmp_path / "tray.yaml"))


def test_a_run_is_played(file: Path, tmp_path: Path) -> None:
    done = twin.run(file, out=tmp_path / "run", recording=False, audit=False)
    with opened(tmp_path / "run", 8360) as (page, _, _):
        time = page.locator("#time")
        playwright.expect(time).to_have_text(f"0.00 of {done.makespan_s:.2f} s")
        page.locator("#step").click()
        playwright.expect(time).not_to_have_text(f"0.00 of {done.makespan_s:.2f} s")
        page.locator("#speed").select_option("50")
        page.locator("#play").click()
        end = f"{done.makespan_s:.2f} of {done.makespan_s:.2f} s"
        playwright.expect(time).to_have_text(end, timeout=WAIT_MS)
        playwright.expect(page.locator("#play")).to_have_text("▶ Play")
        page.locator("#speed").select_option("0.25")
        box = page.locator("#chart").bounding_box()
        page.mouse.click(box["x"] + box["width"] / 2, box["y"] + 10)
        playwright.expect(time).not_to_have_text(end, timeout=WAIT_MS)
        page.keyboard.press("Space")
        playwright.expect(page.locator("#play")).to_have_text("❚❚ Pause")


def test_a_robot_is_moved_and_the_file_saved(file: Path) -> None:
    before = file.read_text()
    with opened(file, 8370) as (_, frame, _):
        frame.get_by_role("tab", name="Findings").click()
        frame.get_by_text("nothing found").wait_for()
        frame.get_by_role("tab", name="Arrange").click()
        frame.get_by_label("Selected").click()
        frame.get_by_role("option", name="robot left").click()
        field = frame.locator("input[inputmode=decimal]").first
        playwright.expect(field).to_have_value("-0.6")
        field.fill("-3")
        field.press("Enter")
        frame.get_by_text("changes are not saved").wait_for()
        frame.get_by_role("tab", name="Findings").click()
        frame.get_by_text("errors").first.wait_for()
        assert file.read_text() == before
        frame.get_by_role("tab", name="Arrange").click()
        frame.get_by_role("button", name="Undo").click()
        frame.get_by_text("tray.yaml: saved").wait_for()
        field.fill("-0.62")
        field.press("Enter")
        frame.get_by_text("changes are not saved").wait_for()
        frame.get_by_role("button", name="Save").click()
        frame.get_by_text("tray.yaml: saved").wait_for()
    changed = [
        (old, new)
        for old, new in zip(
            before.splitlines(), file.read_text().splitlines(), strict=True
        )
        if old != new
    ]
    assert len(changed) == 1
    assert "-0.62" in changed[0][1]


def test_the_camera_follows_a_robot_whose_motion_is_drawn(
    file: Path, tmp_path: Path
) -> None:
    twin.run(file, out=tmp_path / "run", recording=False, audit=False)
    with opened(tmp_path / "run", 8380) as (page, frame, shown):

        def choose(label: str, option: str) -> None:
            frame.get_by_label(label).click()
            frame.get_by_role("option", name=option).click()

        def looked_at() -> Any:
            (client,) = shown.server.viser.get_clients().values()
            return client.camera.look_at

        frame.get_by_role("tab", name="Look").click()
        frame.get_by_label("Distance of robots").click()
        frame.get_by_text(re.compile(r"Distance of robots: \d+ mm")).wait_for()
        choose("Motion of", "next bar")
        choose("Camera on", "robots/left")
        assert shown._player is not None
        for t_s in (0.0, 5.0):
            shown._player.seek(t_s)
            run = shown._player.run
            q = run.configurations(t_s)["left"]
            tool = tool_pose(run.robots["left"], q)[:3, 3]
            for _ in range(100):
                if np.allclose(looked_at(), tool, atol=1e-3):
                    break
                page.wait_for_timeout(100)
            np.testing.assert_allclose(looked_at(), tool, atol=1e-3)
        page.wait_for_timeout(2000)
        # What the browser says of its camera is what it was told.
        np.testing.assert_allclose(looked_at(), tool, atol=1e-3)


def test_a_part_is_added_and_nobodys_changes_are_lost(file: Path) -> None:
    with opened(file, 8372) as (_, frame, _):
        frame.get_by_text("Add", exact=True).first.click()
        frame.get_by_role("button", name="Part", exact=True).click()
        frame.get_by_text("changes are not saved").wait_for()
        theirs = file.read_text() + "# theirs\n"
        file.write_text(theirs)
        frame.get_by_role("button", name="Save", exact=True).click()
        frame.get_by_text("has changed since it was opened").wait_for()
        assert file.read_text() == theirs
        file.write_text("cell: [")
        frame.get_by_role("button", name="Read again").click()
        frame.get_by_text("not valid: see Findings").wait_for()
        frame.get_by_role("tab", name="Findings").click()
        frame.get_by_text("errors in the file").wait_for()
        frame.get_by_role("tab", name="Arrange").click()
        frame.get_by_role("button", name="Undo").click()
        frame.get_by_text("changes are not saved").wait_for()
        frame.get_by_role("button", name="Overwrite").click()
        frame.get_by_text("tray.yaml: saved").wait_for()
    assembly: Any = load_scenario(file).assembly
    assert assembly.parts[-1].name == "new"


def test_a_body_snaps_and_is_checked_while_it_moves(file: Path) -> None:
    before = file.read_text()
    with opened(file, 8374) as (_, frame, shown):
        frame.get_by_role("tab", name="Findings").click()
        frame.get_by_text("nothing found").wait_for()
        panel, editor = shown._arrange, shown._editor
        assert panel is not None
        assert editor is not None
        panel.select_body("objects/motor")
        gizmo, motor = panel._gizmo, panel.movables["motor start"]
        assert gizmo is not None
        above = motor.pose[:3, 3] + [0.0, 0.0, 0.003]
        gizmo.position = above
        panel._dragged(motor, gizmo, "update")
        node: Any = shown._scene._nodes["/objects/motor"]
        np.testing.assert_allclose(node.position, motor.pose[:3, 3], atol=1e-6)
        gizmo.position = np.add(above, [3.0, 0.0, 0.0])
        panel._dragged(motor, gizmo, "update")
        frame.get_by_text("errors").first.wait_for()
        assert tuple(node.color) == _AT_FAULT
        assert not editor.unsaved
        assert file.read_text() == before
