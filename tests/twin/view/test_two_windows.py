"""Two windows on one page, and two servers of one file: nobody's changes are lost silently."""

import shutil
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import closing, contextmanager
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from planning.transforms import Transform, translation
from tests.browser import WAIT_MS, opened_page, playwright
from tests.twin.explorations.sliders import slider_file
from twin.document.yaml_text import KeyPath
from twin.reading.scenario_file import load_scenario
from twin.scenario.shipped import shipped_scenarios
from twin.view.api import cell_page

pytestmark = [pytest.mark.nightly, pytest.mark.timeout(1800)]

SIZE = {"width": 1000, "height": 600}
WITHOUT_PICTURES = """
for (const draw of ["drawArrays", "drawElements", "drawArraysInstanced", "drawElementsInstanced"])
    WebGL2RenderingContext.prototype[draw] = () => {};
requestAnimationFrame = draw => setTimeout(() => draw(performance.now()), 500);
"""
"""Script after which scenes are not drawn: two are too much for a renderer in software."""


@contextmanager
def served(file: Path, port: int) -> Iterator[str]:
    """Yield the address at which a process of its own serves a file."""
    command = [sys.executable, "-m", "twin.cli", "view", str(file), "--no-open"]
    command += ["--port", str(port)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        try:
            yield process.stdout.readline().strip()
        finally:
            process.send_signal(signal.SIGINT)


class Window:
    """A page on which the left robot is moved."""

    def __init__(self, page: Any, address: str) -> None:
        self.page, self.frame = page, page.frame_locator("#scene")
        page.set_default_timeout(WAIT_MS)
        page.add_init_script(WITHOUT_PICTURES)
        page.goto(address)
        self.frame.get_by_role("tab", name="Findings").wait_for()
        self.x = self.frame.locator("input[inputmode=decimal]").first

    def select_robot(self) -> None:
        self.frame.get_by_label("Selected").click()
        self.frame.get_by_role("option", name="robot left").click()
        self.sees(-0.6, saved=True)

    def give(self, x: float) -> None:
        self.x.fill(str(x))
        self.x.press("Enter")
        self.sees(x, saved=False)

    def press(self, key: str) -> None:
        self.frame.get_by_role("button", name=key, exact=True).click()

    def sees(self, x: float, *, saved: bool) -> None:
        playwright.expect(self.x).to_have_value(str(x))
        words = "tray.yaml: saved" if saved else "changes are not saved"
        self.frame.get_by_text(words).wait_for()

    def is_refused(self) -> None:
        self.frame.get_by_text("has changed since it was opened").first.wait_for()


def test_windows_and_servers_of_one_file(tmp_path: Path) -> None:
    file = Path(shutil.copy(shipped_scenarios()["tray"], tmp_path / "tray.yaml"))

    def saved_x() -> float:
        return load_scenario(file).cell.robots[0].base.xyz_m[0]

    with (
        served(file, 8376) as address,
        served(file, 8378) as other_address,
        opened_page("about:blank", viewport=SIZE) as page,
    ):
        second = page.context.browser.new_page(viewport=SIZE)
        left, right = Window(page, address), Window(second, address)
        left.select_robot()
        left.give(-0.62)
        right.sees(-0.62, saved=False)
        right.press("Undo")
        left.sees(-0.6, saved=True)
        right.page.keyboard.press("Control+y")
        left.sees(-0.62, saved=False)
        left.press("Save")
        right.sees(-0.62, saved=True)
        assert saved_x() == -0.62
        right.give(-0.64)
        right.press("Save")
        left.sees(-0.64, saved=True)
        assert saved_x() == -0.64
        # This program has read the file at the beginning.
        other = Window(second, other_address)
        other.select_robot()
        other.give(-0.5)
        other.press("Save")
        other.is_refused()
        other.sees(-0.5, saved=False)
        assert saved_x() == -0.64
        other.press("Read again")
        other.sees(-0.64, saved=True)
        other.press("Undo")
        other.sees(-0.5, saved=False)
        other.press("Overwrite")
        other.sees(-0.5, saved=True)
        assert saved_x() == -0.5
        left.press("Undo")
        left.sees(-0.62, saved=False)
        left.press("Save")
        left.is_refused()
        assert saved_x() == -0.5


def test_simultaneous_changes_are_all_kept(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with closing(cell_page(slider_file(tmp_path, ""), port=8384)) as page:
        editor = page._editor
        assert editor is not None
        moved = editor.moved

        def slowly(at: KeyPath, pose: Transform) -> str:
            text = moved(at, pose)
            time.sleep(0.3)
            return text

        monkeypatch.setattr(editor, "moved", slowly)
        expected = {
            own.at: own.pose @ translation(0.01, 0.0, 0.0)
            for own in list(editor.movables())[:2]
        }
        threads = [
            threading.Thread(target=page._guarded, args=[partial(editor.move, *own)])
            for own in expected.items()
        ]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
        found = {own.at: own.pose for own in editor.movables()}
        for at, pose in expected.items():
            np.testing.assert_allclose(found[at], pose, atol=1e-6)
