"""The page of a cell: scene, playback of a run, panel for changes, findings and commands."""

from __future__ import annotations

import threading
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import viser
from scipy.spatial.transform import Rotation

from planning.errors import TwinError
from planning.robots.registry import ROBOTS
from planning.transforms import Transform, quat_wxyz
from twin.planning.build_workcell import build_workcell
from twin.scenario.sections.kind import assembly_kind
from twin.trial.loaded_scenario import LoadedScenario
from twin.trial.run_result import RunResult, read_run
from twin.view.cell_editor import CellEditor, Movable
from twin.view.cell_scene import CellScene
from twin.view.command_process import CommandProcess, command_line
from twin.view.findings import Findings, FindingsThread
from twin.view.player import SPEEDS, Player
from twin.view.replayed_run import ReplayedRun
from twin.view.server import ViewServer

_NOTHING = "nothing"
_GRIDS_MM = ("off", "1", "5", "10", "50", "100")
_GIZMO_M = 0.35
_VIEWED_FROM = (0.7, -1.1, 0.7)
"""Position of the camera from the middle of the cell, in sizes of the cell."""


class CellPage:
    """Shows a cell, and changes its file.

    Args:
        scenario: the cell.
        run: what is played; None for the cell alone.
        path: the scenario file that may be changed; None for read only.
        port: port of the page.

    Attributes:
        server: serves the page.
    """

    def __init__(
        self,
        scenario: LoadedScenario,
        run: RunResult | None,
        path: Path | None,
        port: int,
    ) -> None:
        self._lock = threading.RLock()
        self._player: Player | None = None
        self._chart = 0
        answers = {"chart": self._answer_chart, "player": self._answer_player}
        self.server = ViewServer(answers, port, scenario.name)
        self._viser = self.server.viser
        self._scene = CellScene(self._viser.scene, self._select_body)
        self._editor = None if path is None else CellEditor(path, self._changed)
        self._scenario = scenario
        self._movables: dict[str, Movable] = {}
        self._gizmo: viser.TransformControlsHandle | None = None
        self._checked = FindingsThread(self._show_findings)
        self._commands = CommandProcess(self._report, self._command_ended)
        self._viser.scene.set_up_direction("+z")
        self._build_panel()
        self._show_cell()
        centre, size = self._scene.extent()
        self._viser.scene.add_grid(
            "/grid", width=4.0 * size, height=4.0 * size, cell_size=0.1 if size < 5 else 1
        )
        self._viser.initial_camera.position = centre + size * np.array(_VIEWED_FROM)
        self._viser.initial_camera.look_at = centre
        if self._editor is not None:
            self._build_joints(self._viser.gui)
            self._show_movables()
            self._show_state()
        if run is not None:
            self.play(run)

    def play(self, run: RunResult) -> None:
        """Play a run on the page."""
        with self._lock:
            if self._player is not None:
                self._player.stop()
            self._scene.show(run.tpg.cell)
            self._player = Player(ReplayedRun(run), self._scene, self._viser.atomic)
            self._player.start()
            self._chart += 1

    def _show_cell(self) -> None:
        """Show the cell of the scenario, and check it."""
        sections, folder = self._scenario.sections, self._scenario.folder
        cell = build_workcell(sections, folder, assembly_kind(sections.assembly))
        with self._viser.atomic():
            self._scene.show(cell)
        self._checked.check(self._scenario)

    # Playback

    def _answer_chart(self, given: Mapping[str, str]) -> dict[str, Any]:
        player = self._player
        return {} if player is None else {**player.run.chart, "speeds": SPEEDS}

    def _answer_player(self, given: Mapping[str, str]) -> dict[str, Any]:
        player = self._player
        if player is None:
            return {"chart": self._chart}
        if "t" in given:
            player.seek(_number(given["t"]))
        if "speed" in given:
            player.speed = min(max(_number(given["speed"]), SPEEDS[0]), SPEEDS[-1])
        if "step" in given:
            player.playing = False
            player.step(backwards=_number(given["step"]) < 0.0)
        if "playing" in given:
            if player.now_s >= player.run.end_s:
                player.seek(0.0)
            player.playing = given["playing"] == "1"
        return {
            "now_s": player.now_s,
            "playing": player.playing,
            "speed": player.speed,
            "chart": self._chart,
        }

    # Panel

    def _build_panel(self) -> None:
        gui = self._viser.gui
        gui.configure_theme(control_layout="collapsible", show_logo=False)
        tabs = gui.add_tab_group()
        if self._editor is not None:
            with tabs.add_tab("Arrange"):
                self._build_editor(gui, self._editor)
        with tabs.add_tab("Findings"):
            self._list = gui.add_markdown("Checking the cell ...")
        with tabs.add_tab("Look"):
            reach = gui.add_checkbox("Reach of robots", initial_value=False)
            reach.on_update(lambda _: self._scene.show_reach(shown=reach.value))
        if self._editor is not None:
            with tabs.add_tab("Do"):
                self._build_commands(gui, self._editor)

    def _build_editor(self, gui: viser.GuiApi, editor: CellEditor) -> None:
        self._selected = gui.add_dropdown("Selected", (_NOTHING,))
        self._selected.on_update(lambda _: self._select(self._selected.value))
        self._xyz = gui.add_vector3("Position [m]", (0.0, 0.0, 0.0), step=0.001)
        self._rpy = gui.add_vector3("Angles [deg]", (0.0, 0.0, 0.0), step=1.0)
        for numbers in (self._xyz, self._rpy):
            numbers.on_update(self._numbers_given)
        self._grid = gui.add_dropdown("Grid [mm]", _GRIDS_MM, initial_value="off")
        robots = tuple(robot.name for robot in self._scenario.sections.cell.robots)
        with gui.add_folder("HOME of a robot", expand_by_default=False):
            self._robot = gui.add_dropdown("Robot", robots)
            self._robot.on_update(lambda _: self._build_joints(gui))
            self._joints_folder = gui.add_folder("Joints [deg or mm]")
            self._joints: list[viser.GuiInputHandle[float]] = []
            gui.add_button("Set as HOME").on_click(
                lambda _: editor.set_home(self._robot.value, self._joint_values())
            )
        with gui.add_folder("Add", expand_by_default=False):
            kind = gui.add_dropdown("What", ("robot", "fixture"))
            model = gui.add_dropdown("Robot model", tuple(ROBOTS))
            name = gui.add_text("Name", "new")
            size = gui.add_vector3("Size of a fixture [m]", (0.2, 0.2, 0.1))
            gui.add_button("Add").on_click(
                lambda _: self._guarded(
                    lambda: self._add(
                        editor, kind.value, name.value, model.value, size.value
                    )
                )
            )
        keys = gui.add_button_group("Changes", ("Undo", "Redo"))
        keys.on_click(
            lambda _: editor.undo() if keys.value == "Undo" else editor.redo()
        )
        files = gui.add_button_group("File", ("Save", "Read again", "Overwrite"))
        files.on_click(lambda _: self._guarded(lambda: self._file(files.value)))
        self._state = gui.add_markdown("")

    def _build_joints(self, gui: viser.GuiApi) -> None:
        for slider in self._joints:
            slider.remove()
        robot = self._scene.robots[self._robot.value]
        self._joints = []
        with self._joints_folder:
            for k, joint in enumerate(robot.model.joint_names):
                unit = 1000.0 if robot.model.chain.prismatic[k] else 180.0 / np.pi
                low, high = unit * robot.model.lower[k], unit * robot.model.upper[k]
                slider = gui.add_slider(
                    joint,
                    min=float(low),
                    max=float(high),
                    step=0.1,
                    initial_value=float(np.clip(unit * robot.home[k], low, high)),
                )
                slider.on_update(lambda _: self._joints_moved())
                self._joints.append(slider)

    def _joint_values(self) -> list[float]:
        prismatic = self._scene.robots[self._robot.value].model.chain.prismatic
        return [
            slider.value / (1000.0 if slides else 180.0 / np.pi)
            for slider, slides in zip(self._joints, prismatic, strict=False)
        ]

    def _joints_moved(self) -> None:
        self._scene.move_robot(self._robot.value, np.array(self._joint_values()))

    def _build_commands(self, gui: viser.GuiApi, editor: CellEditor) -> None:
        folder = editor.path.parent
        name = editor.path.name
        commands = {
            "Plan": ["plan", name, "--out", "view/plan"],
            "Run": ["run", name, "--out", "view/run", "--no-recording"],
            "Study": ["study", name, "-n", "200", "--out", "view/study"],
            "Explore": ["explore", name, "--out", "view/explore"],
        }
        keys = gui.add_button_group("Command", tuple(commands))
        line = gui.add_text("As typed", "", disabled=True)

        def start() -> None:
            if editor.unsaved:
                editor.save()
            arguments = commands[keys.value]
            line.value = command_line(arguments)
            self._commands.start(arguments, folder)

        keys.on_click(lambda _: self._guarded(start))
        gui.add_button("Cancel").on_click(lambda _: self._commands.cancel())
        self._output = gui.add_markdown("")

    def _report(self, title: str, lines: str) -> None:
        self._output.content = f"`{title}`\n\n```\n{lines}\n```"

    def _command_ended(self, arguments: Sequence[str], code: int) -> None:
        words = "completed" if code == 0 else f"ended with exit code {code}"
        self._output.content += f"\n\n{command_line(arguments)}: **{words}**"
        if arguments[0] == "run" and code == 0 and self._editor is not None:
            self._guarded(
                lambda: self.play(read_run(self._folder() / arguments[3]))
            )

    def _folder(self) -> Path:
        assert self._editor is not None
        return self._editor.path.parent

    # Changes

    def _select_body(self, body: str) -> None:
        for name, movable in self._movables.items():
            if movable.body == body:
                self._selected.value = name
                self._select(name)

    def _select(self, name: str) -> None:
        with self._lock:
            if self._gizmo is not None:
                self._gizmo.remove()
                self._gizmo = None
            movable = self._movables.get(name)
            if movable is None:
                return
            self._show_numbers(movable.pose)
            gizmo = self._viser.scene.add_transform_controls(
                "/gizmo",
                scale=_GIZMO_M,
                position=movable.pose[:3, 3],
                wxyz=quat_wxyz(movable.pose),
            )
            gizmo.on_update(lambda _: self._dragged(movable, gizmo))
            gizmo.on_drag_end(lambda _: self._dropped(movable, gizmo))
            self._gizmo = gizmo

    def _dragged(
        self, movable: Movable, gizmo: viser.TransformControlsHandle
    ) -> None:
        pose = self._on_grid(gizmo)
        self._show_numbers(pose)
        if movable.body:
            self._scene.move_body(movable.body, pose)

    def _dropped(
        self, movable: Movable, gizmo: viser.TransformControlsHandle
    ) -> None:
        assert self._editor is not None
        self._editor.move(movable.at, self._on_grid(gizmo))

    def _on_grid(self, gizmo: viser.TransformControlsHandle) -> Transform:
        pose = np.eye(4)
        pose[:3, :3] = Rotation.from_quat(gizmo.wxyz, scalar_first=True).as_matrix()
        pose[:3, 3] = gizmo.position
        if self._grid.value != _GRIDS_MM[0]:
            step = float(self._grid.value) / 1000.0
            pose[:3, 3] = np.round(pose[:3, 3] / step) * step
        return pose

    def _show_numbers(self, pose: Transform) -> None:
        angles = Rotation.from_matrix(pose[:3, :3]).as_euler("xyz", degrees=True)
        self._xyz.value = tuple(np.round(pose[:3, 3], 6).tolist())
        self._rpy.value = tuple(np.round(angles, 4).tolist())

    def _numbers_given(self, event: viser.GuiEvent[Any]) -> None:
        movable = self._movables.get(self._selected.value)
        # Values that the program itself shows come without a client.
        if movable is None or self._editor is None or event.client is None:
            return
        pose = np.eye(4)
        turn = Rotation.from_euler("xyz", self._rpy.value, degrees=True)
        pose[:3, :3], pose[:3, 3] = turn.as_matrix(), self._xyz.value
        self._editor.move(movable.at, pose)

    def _add(
        self,
        editor: CellEditor,
        kind: str,
        name: str,
        model: str,
        size: tuple[float, ...],
    ) -> None:
        if kind == "robot":
            entry = {"name": name, "model": model, "base": {"xyz_m": [0.0, 0.0, 0.0]}}
        else:
            pose = {"xyz_m": [0.0, 0.0, size[2] / 2]}
            entry = {"name": name, "size_m": list(size), "pose": pose}
        editor.add(("cell", f"{kind}s"), entry)

    def _file(self, what: str) -> None:
        assert self._editor is not None
        if what == "Read again":
            self._editor.read_again()
        else:
            self._editor.save(force=what == "Overwrite")
        self._show_state()

    def _changed(self) -> None:
        """Show the cell of the changed text, or what is wrong with it."""
        editor = self._editor
        assert editor is not None
        with self._lock:
            if self._player is not None:
                self._player.stop()
                self._player = None
                self._chart += 1
            self._scenario = editor.scenario
            if editor.problems:
                self._list.content = _listed("errors in the file", editor.problems)
            else:
                self._guarded(self._show_cell)
            self._show_movables()
            self._show_state()

    def _show_movables(self) -> None:
        assert self._editor is not None
        self._movables = {own.name: own for own in self._editor.movables()}
        names = (_NOTHING, *self._movables)
        selected = self._selected.value
        if tuple(self._selected.options) != names:
            self._selected.options = names
        if selected in self._movables and self._gizmo is not None:
            pose = self._movables[selected].pose
            self._gizmo.position, self._gizmo.wxyz = pose[:3, 3], quat_wxyz(pose)
            self._show_numbers(pose)

    def _show_state(self) -> None:
        assert self._editor is not None
        words = "**changes are not saved**" if self._editor.unsaved else "saved"
        self._state.content = f"{self._editor.path.name}: {words}"

    # Findings

    def _show_findings(self, found: Findings) -> None:
        if self._editor is not None and self._editor.problems:
            return
        errors = [own.message for own in found.found if own.error]
        warnings = [own.message for own in found.found if not own.error]
        text = _listed("errors", errors) + _listed("warnings", warnings)
        if found.reason:
            text = _listed("errors", [found.reason])
        elif not found.complete:
            text += "\nreach is being checked ..."
        self._list.content = text or "nothing found"
        at_fault = {own.at for own in found.found if own.error}
        self._scene.mark(
            {
                movable.body
                for movable in self._movables.values()
                if any(at[:3] == movable.at[:3] for at in at_fault)
            }
        )

    def _guarded(self, act: Any) -> None:
        """Do something; show why where it cannot be done."""
        try:
            act()
        except TwinError as error:
            for client in self._viser.get_clients().values():
                client.add_notification("Not done", str(error), color="red")


def _listed(title: str, entries: Sequence[str]) -> str:
    if not entries:
        return ""
    return f"**{len(entries)} {title}**\n" + "\n".join(f"- {own}" for own in entries) + "\n"


def _number(text: str) -> float:
    """Return the number that a text is; ValueError for none that is finite."""
    value = float(text)
    if not np.isfinite(value):
        raise ValueError(f"{text!r} is not a finite number")
    return value
