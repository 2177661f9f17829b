"""Processes that die or hang cost the design that they were at, and nothing else."""

from __future__ import annotations

import os
import time
from pathlib import Path
from typing import Any

from tests.twin.explore.bench import setting_of
from tests.twin.explore.sliders import slider_file
from tests.twin.program import invoke
from twin.explore.crew import Crew, DesignTask, parallel
from twin.explore.journal import Journal


class Dies(dict[str, Any]):
    """Changes that kill the process that looks at them."""

    def __bool__(self) -> bool:
        os._exit(7)


class Hangs(dict[str, Any]):
    """Changes at which a process looks for ever."""

    def __bool__(self) -> bool:
        time.sleep(1000)
        return True


def test_a_design_that_kills_or_holds_its_process_is_refused(tmp_path: Path) -> None:
    setting = setting_of(slider_file(tmp_path))
    tasks = [
        DesignTask(0, Dies()),
        DesignTask(1, {}),
        DesignTask(2, Hangs()),
        DesignTask(3, {"cell.robots.left.base.xyz_m.0": 0.2}),
        DesignTask(4, {"cell.robots.left.model": "no-such-model"}),
    ]
    with Crew(setting, 1, 20.0) as crew:
        found = {task.number: done for task, done in parallel(tasks, crew)}
    assert found[0].reason == "its process died (exit code 7)"
    assert found[2].reason == "not done within 20 s"
    assert {found[0].rung, found[2].rung, found[4].rung} == {"check"}
    assert "no-such-model" in found[4].reason
    assert found[1].outcome == found[3].outcome == "done"
    assert found[1].goals[0] > found[3].goals[0] - 1e-9


def test_the_command_explores_and_goes_on(tmp_path: Path) -> None:
    file, out = slider_file(tmp_path), tmp_path / "out"
    told = invoke("explore", file, "--designs", 4, "--workers", 1, "--out", out, code=0)
    assert "minimise makespan_s, 4 designs" in told.output
    assert "how far designs got" in told.output
    again = invoke("explore", file, "--out", out, code=2)
    assert "--resume" in again.output
    invoke("explore", "--resume", out, "--designs", 6, "--workers", 1, code=0)
    assert [row.design for row in Journal(out).searched] == list(range(6))
