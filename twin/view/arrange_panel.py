"""Panel of the page that changes the scenario file: poses, HOME, what is added, undo and save."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import viser

from planning.transforms import (
    Array,
    Transform,
    from_quat_wxyz,
    from_rpy,
    quat_wxyz,
)
from twin.document.yaml_text import KeyPath
from twin.view.addition_panel import AdditionPanel
from twin.view.cell_editor import CellEditor, Movable, angles_deg
from twin.view.cell_scene import CellScene
from twin.view.contact_snap import SNAP_M

_NOTHING = "nothing"
_OFF = "off"
_GRIDS_MM = (_OFF, "1", "5", "10", "50", "100")
_GIZMO_M = 0.35


class ArrangePanel:
    """Changes a scenario file by gizmo, numbers and buttons.

    Args:
        server: server of the scene.
        editor: the file.
        scene: where bodies move along.
        guarded: calls a function, and shows its error.
        moving: called with the key and the pose of what is moved by its handles, until they are let go.

    Attributes:
        movables: poses of the file by the names of the list.
    """

    def __init__(
        self,
        server: viser.ViserServer,
        editor: CellEditor,
        scene: CellScene,
        guarded: Callable[[Callable[[], object]], None],
        moving: Callable[[KeyPath, Transform], None],
    ) -> None:
        self._server, self._editor, self._scene = server, editor, scene
        self._guarded, self._moving = guarded, moving
        self.movables: dict[str, Movable] = {}
        self._gizmo: viser.TransformControlsHandle | None = None
        gui = server.gui
        self._selected = gui.add_dropdown("Selected", (_NOTHING,))
        self._selected.on_update(lambda _: guarded(self._select))
        self._xyz = gui.add_vector3("Position [m]", (0.0, 0.0, 0.0), step=0.001)
        self._rpy = gui.add_vector3("Angles [deg]", (0.0, 0.0, 0.0), step=1.0)
        for numbers in (self._xyz, self._rpy):
            numbers.on_update(self._numbers_given)
        self._grid = gui.add_dropdown(
            "Grid [mm]", _GRIDS_MM, hint="Positions to which the handles snap"
        )
        self._snap = gui.add_checkbox(
            "Snap to contacts",
            initial_value=True,
            hint=f"A body within {1000 * SNAP_M:g} mm of another one touches it, by upright boxes around both",
        )
        with gui.add_folder("HOME of a robot", expand_by_default=False):
            self._build_home()
        with gui.add_folder("Add", expand_by_default=False):
            AdditionPanel(gui, editor, guarded, self._top)
        steps = {"Undo": editor.undo, "Redo": editor.redo}
        keys = gui.add_button_group("Changes", tuple(steps), hint="Ctrl-Z, Ctrl-Y")
        keys.on_click(lambda _: guarded(steps[keys.value]))
        undo = gui.add_command("Undo", hotkey="Z", modifier="cmd/ctrl")
        undo.on_trigger(lambda _: guarded(editor.undo))
        redo = gui.add_command("Redo", hotkey="Y", modifier="cmd/ctrl")
        redo.on_trigger(lambda _: guarded(editor.redo))
        files = gui.add_button_group("File", ("Save", "Read again", "Overwrite"))
        files.on_click(lambda _: guarded(lambda: self._file(files.value)))
        self._state = gui.add_markdown("")
        self.show()

    def select_body(self, body: str) -> None:
        """Select the pose of a body, such as ``fixtures/table``."""
        for name, movable in self.movables.items():
            if movable.body == body:
                self._selected.value = name  # type: ignore[misc]

    def show(self) -> None:
        """Show the poses of the file as it is now."""
        self.movables = {own.name: own for own in self._editor.movables()}
        names = (_NOTHING, *self.movables)
        if tuple(self._selected.options) != names:
            self._selected.options = names
        robots = tuple(self._scene.robots)
        if tuple(self._robot.options) != robots:
            self._robot.options = robots
        movable = self.movables.get(self._selected.value)
        if movable is not None and self._gizmo is not None:
            self._gizmo.position = movable.pose[:3, 3]
            self._gizmo.wxyz = quat_wxyz(movable.pose)
            self._show_numbers(movable.pose)
            self._scene.show_goal(movable.body, movable.pose)
        words = "**changes are not saved**" if self._editor.unsaved else "saved"
        if self._editor.problems:
            words += ", **and not valid: see Findings**"
        self._state.content = f"{self._editor.path.name}: {words}"

    def _build_home(self) -> None:
        gui = self._server.gui
        self._robot = gui.add_dropdown("Robot", tuple(self._scene.robots))
        self._robot.on_update(lambda _: self._guarded(self._build_joints))
        self._folder = gui.add_folder("Joints [deg or mm]")
        self._joints: list[tuple[viser.GuiInputHandle[float], float]] = []
        key = gui.add_button("Set as HOME")
        key.on_click(
            lambda _: self._guarded(
                lambda: self._editor.set_home(self._robot.value, self._joint_values())
            )
        )
        self._build_joints()

    def _build_joints(self) -> None:
        """Show a slider for each joint of the chosen robot; keep it with its units in a radian or metre."""
        for slider, _ in self._joints:
            slider.remove()
        self._joints = []
        robot = self._scene.robots[self._robot.value]
        with self._folder:
            for k, joint in enumerate(robot.model.joint_names):
                unit = 1000.0 if robot.model.chain.prismatic[k] else 180.0 / np.pi
                low, high = unit * robot.model.lower[k], unit * robot.model.upper[k]
                slider = self._server.gui.add_slider(
                    joint,
                    min=float(low),
                    max=float(high),
                    step=0.1,
                    initial_value=float(np.clip(unit * robot.home[k], low, high)),
                )
                slider.on_update(lambda _: self._guarded(self._show_joints))
                self._joints.append((slider, unit))

    def _joint_values(self) -> list[float]:
        return [slider.value / unit for slider, unit in self._joints]

    def _show_joints(self) -> None:
        self._scene.move_robot(self._robot.value, np.array(self._joint_values()))

    def _top(self) -> Array:
        """Return the middle of the top of what is selected, the origin without a body, shape (3,) [m]."""
        movable = self.movables.get(self._selected.value)
        box = self._scene.box(movable.body, movable.pose) if movable else None
        top = (0.0, 0.0, 0.0) if box is None else (*box[:, :2].mean(axis=0), box[1, 2])
        return np.array(top)

    def _select(self) -> None:
        if self._gizmo is not None:
            self._gizmo.remove()
            self._gizmo = None
        movable = self.movables.get(self._selected.value)
        if movable is None:
            self._scene.show_goal("", np.eye(4))
            return
        self._scene.show_goal(movable.body, movable.pose)
        self._show_numbers(movable.pose)
        gizmo = self._server.scene.add_transform_controls(
            "/gizmo",
            scale=_GIZMO_M,
            position=movable.pose[:3, 3],
            wxyz=quat_wxyz(movable.pose),
        )
        gizmo.on_update(
            lambda event: self._guarded(
                lambda: self._dragged(movable, gizmo, event.phase)
            )
        )
        self._gizmo = gizmo

    def _dragged(
        self, movable: Movable, gizmo: viser.TransformControlsHandle, phase: str
    ) -> None:
        """Move the body along with the handles; change the file when they are let go."""
        pose = self._pose_of(gizmo)
        if self._snap.value:
            poses = {own.body: own.pose for own in self.movables.values() if own.body}
            pose = self._scene.snapped(movable.body, pose, poses)
        self._show_numbers(pose)
        if phase == "end":
            self._editor.move(movable.at, pose)
        else:
            self._scene.move_body(movable.body, pose)
            self._moving(movable.at, pose)

    def _pose_of(self, gizmo: viser.TransformControlsHandle) -> Transform:
        """Return the pose of the handles, on the grid."""
        pose = from_quat_wxyz(gizmo.position.tolist(), gizmo.wxyz.tolist())
        if self._grid.value != _OFF:
            step = float(self._grid.value) / 1000.0
            pose[:3, 3] = np.round(pose[:3, 3] / step) * step
        return pose

    def _show_numbers(self, pose: Transform) -> None:
        shown = np.round(pose[:3, 3], 6), np.round(angles_deg(pose), 4)
        self._xyz.value, self._rpy.value = shown  # type: ignore[misc,assignment]

    def _numbers_given(self, event: viser.GuiEvent[viser.GuiVector3Handle]) -> None:
        movable = self.movables.get(self._selected.value)
        # What the program itself shows comes without a client.
        if movable is None or event.client is None:
            return
        pose = from_rpy(self._xyz.value, np.deg2rad(self._rpy.value))
        self._guarded(lambda: self._editor.move(movable.at, pose))

    def _file(self, key: str) -> None:
        if key == "Read again":
            self._editor.read_again()
        else:
            self._editor.save(force=key == "Overwrite")
        self.show()
