"""The page in a browser: a run is played, a robot is moved, a finding appears, and the file is saved."""

import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

import twin
from tests.browser import WAIT_MS, opened_page, playwright
from twin.scenario.shipped import shipped_scenarios
from twin.view.api import cell_page

pytestmark = [pytest.mark.nightly, pytest.mark.timeout(900)]


@contextmanager
def opened(path: Path, port: int) -> Iterator[tuple[Any, Any]]:
    """Yield the page of a path, and the frame of its scene."""
    shown = cell_page(path, port=port)
    try:
        size = {"width": 1200, "height": 800}
        with opened_page(shown.server.address, viewport=size) as page:
            frame = page.frame_locator("#scene")
            frame.get_by_role("tab", name="Findings").wait_for()
            yield page, frame
    finally:
        shown.close()


@pytest.fixture
def file(tmp_path: Path) -> Path:
    return Path(shutil.copy(shipped_scenarios()["tray"], tmp_path / "tray.yaml"))


def test_a_run_is_played(file: Path, tmp_path: Path) -> None:
    done = twin.run(file, out=tmp_path / "run", recording=False, audit=False)
    with opened(tmp_path / "run", 8360) as (page, _):
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
        playwright.expect(time).not_to_have_text(end)
        page.keyboard.press("Space")
        playwright.expect(page.locator("#play")).to_have_text("❚❚ Pause")


def test_a_robot_is_moved_and_the_file_saved(file: Path) -> None:
    before = file.read_text()
    with opened(file, 8370) as (_, frame):
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
