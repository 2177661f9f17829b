"""The page of a cell: its scene, the run that is played, and its panels."""

from __future__ import annotations

import threading
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from planning.errors import TwinError
from planning.transforms import Transform
from twin.checks.finding import Finding
from twin.document.yaml_text import KeyPath
from twin.planning.build_workcell import build_workcell
from twin.trial.loaded_scenario import LoadedScenario
from twin.trial.run_result import RunResult
from twin.view.arrange_panel import ArrangePanel
from twin.view.cell_editor import CellEditor
from twin.view.cell_scene import CellScene
from twin.view.command_panel import CommandPanel
from twin.view.findings import FindingsThread
from twin.view.look_panel import LookPanel
from twin.view.player import SPEEDS, Player
from twin.view.run_playback import RunPlayback
from twin.view.server import ViewServer


class CellPage:
    """Shows a cell, and changes its file.

    Args:
        scenario: the cell.
        run: what is played; None for the cell alone.
        path: the scenario file that may be changed; None for none.
        port: port of the page.
        about: what is shown, for people.

    Attributes:
        server: serves the page.
    """

    def __init__(
        self,
        scenario: LoadedScenario,
        run: RunResult | None,
        path: Path | None,
        port: int,
        about: str = "",
    ) -> None:
        self._lock = threading.RLock()
        self._player: Player | None = None
        self._charts = 0
        answers = {"chart": self._answer_chart, "player": self._answer_player}
        self.server = ViewServer(answers, port, scenario.name)
        self._viser = self.server.viser
        self._scene = CellScene(self._viser.scene, self._clicked)
        self._editor = None if path is None else CellEditor(path, self._changed)
        self._arrange: ArrangePanel | None = None
        self._checks = FindingsThread(self._show_findings)
        self._show_cell(scenario)
        self._scene.look(self._viser)
        self._build_panel(about)
        self._checks.check(lambda: scenario)
        if run is not None:
            self.play(run)

    def play(self, run: RunResult) -> None:
        """Play a run on the page, in place of the one before."""
        with self._lock:
            self._stop_playing()
            self._scene.show(run.tpg.cell)
            self._look.begin(playback := RunPlayback(run))
            self._player = Player(playback, self._scene, self._look, self._viser.atomic)

    def close(self) -> None:
        """End playback, checks and server."""
        with self._lock:
            self._stop_playing()
        self._checks.stop()
        self._viser.stop()

    def _stop_playing(self) -> None:
        self._charts += 1
        if self._player is not None:
            self._player.stop()
            self._player = None
            self._look.begin(None)

    def _answer_chart(self, _: Mapping[str, str]) -> dict[str, Any]:
        """Return the Gantt chart of the run that is played; nothing without one."""
        player = self._player
        return {} if player is None else {**player.run.chart, "speeds": SPEEDS}

    def _answer_player(self, given: Mapping[str, str]) -> dict[str, Any]:
        """Do with the player what a request says, and return its state."""
        player = self._player
        if player is None:
            return {"chart": self._charts}
        if "t" in given:
            player.seek(_number(given["t"]))
        if "speed" in given:
            player.speed = min(max(_number(given["speed"]), SPEEDS[0]), SPEEDS[-1])
        if "step" in given:
            player.step(backwards=_number(given["step"]) < 0.0)
        if "playing" in given:
            player.play(playing=given["playing"] == "1")
        if "waits" in given:
            of = given["waits"]
            player.show_waits(None if of == "now" else _number(of))
        return {
            "now_s": player.now_s,
            "playing": player.playing,
            "speed": player.speed,
            "chart": self._charts,
        }

    def _build_panel(self, about: str) -> None:
        gui = self._viser.gui
        # The button that shares a scene would send it to a server of others.
        gui.configure_theme(show_logo=False, show_share_button=False)
        gui.main_panel.dock_right()
        self._about = gui.add_markdown(about, visible=bool(about))
        tabs = gui.add_tab_group()
        if self._editor is not None:
            with tabs.add_tab("Arrange"):
                self._arrange = ArrangePanel(
                    self._viser,
                    self._editor,
                    self._scene,
                    self._guarded,
                    self._moving,
                )
        with tabs.add_tab("Findings"):
            self._findings = gui.add_markdown("the cell is being checked")
        with tabs.add_tab("Look"):
            self._look = LookPanel(self._viser, self._scene)
        if self._editor is not None:
            with tabs.add_tab("Do"):
                CommandPanel(gui, self._editor, self._guarded, self.play)

    def _clicked(self, body: str) -> None:
        if self._arrange is not None:
            self._arrange.select_body(body)

    def _show_cell(self, scenario: LoadedScenario) -> None:
        cell = build_workcell(scenario.sections, scenario.folder)
        with self._viser.atomic():
            self._scene.show(cell)

    def _changed(self) -> None:
        """Show the cell of the changed file, or what is wrong with the file."""
        assert self._editor is not None
        assert self._arrange is not None
        self._stop_playing()
        scenario = self._editor.scenario
        if self._editor.problems:
            words = _listed("errors in the file", self._editor.problems)
            self._findings.content = words
        else:
            self._guarded(lambda: self._show_cell(scenario))
            self._checks.check(lambda: scenario)
        self._arrange.show()

    def _moving(self, at: KeyPath, pose: Transform) -> None:
        """Check the cell as it would be with a pose at a key."""
        editor = self._editor
        if editor is not None and not editor.problems:
            self._checks.check(
                lambda: editor.parsed(editor.moved(at, pose)), moving=True
            )

    def _show_findings(self, found: Sequence[Finding], complete: bool) -> None:
        if self._editor is not None and self._editor.problems:
            return
        text = _listed("errors", [own.message for own in found if own.error])
        text += _listed("warnings", [own.message for own in found if not own.error])
        if not complete:
            text += "\nreach is being checked"
        self._findings.content = text or "nothing found"
        at_fault = {own.at[:3] for own in found if own.error}
        with self._lock:
            movables = self._arrange.movables.values() if self._arrange else ()
            self._scene.mark({own.body for own in movables if own.at[:3] in at_fault})

    def _guarded(self, act: Callable[[], object]) -> None:
        """Call a function when no other one is called; show its error to everybody who looks."""
        try:
            with self._lock:
                act()
        except TwinError as error:
            for client in self._viser.get_clients().values():
                client.add_notification("Not done", str(error), color="red")


def _listed(title: str, entries: Sequence[str]) -> str:
    if not entries:
        return ""
    lines = "\n".join(f"- {own}" for own in entries)
    return f"**{len(entries)} {title}**\n\n{lines}\n\n"


def _number(text: str) -> float:
    """Return the number that a text is; ValueError for none that is finite."""
    value = float(text)
    if not np.isfinite(value):
        raise ValueError(f"{text!r} is not a finite number")
    return value
