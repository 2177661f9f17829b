"""3-D scene of a cell in viser: robots, fixtures and objects, with poses that can be set."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np
import viser
from scipy.spatial import ConvexHull

from planning.cell.shape import Shape
from planning.cell.workcell import PlacedRobot, Workcell
from planning.kinematics.kinematics import frame_pose
from planning.tasks.task import DOOR
from planning.transforms import Array, Indices, Transform, quat_wxyz
from twin.drawing.looks import coloured_fixtures
from twin.drawing.team_colours import parse_rgb, team_colours
from twin.drawing.triangles import triangles_of
from twin.view.contact_snap import contact_shift
from twin.view.robot_figure import RobotFigure

Colour = tuple[int, int, int]

_AT_FAULT: Colour = (214, 39, 40)
_OPACITY = 0.28
"""Opacity of doors and shells of reach."""

_VIEWED_FROM = (0.55, -0.9, 0.6)
"""Position of the camera from the middle of the cell, in sizes of the cell."""

_GRID_COLOUR = (165, 165, 165)
"""Seen on light and on dark pages, and no brighter than the cell."""

_PANEL_PX = 320
"""Width of the panel beside the scene."""

_FINE_GRID_M = 5.0
"""Cells up to this size stand on a grid of 0.1 m, others on one of 1 m."""

_FLOOR_M = 5.0
"""Fixtures that are larger are floors, which need not be seen as a whole."""

_CONFIGURATIONS = 3000
"""Random configurations from which the reach of a robot is computed."""


class CellScene:
    """The nodes of a cell in a scene of viser.

    Nodes are named ``/robots/NAME/JOINT``, ``/fixtures/NAME`` and ``/objects/NAME``.

    Args:
        scene: the scene, to which nodes are added.
        clicked: called with the name of the body, such as ``fixtures/table``, on which somebody clicks.
    """

    def __init__(
        self, scene: viser.SceneApi, clicked: Callable[[str], None] = lambda _: None
    ) -> None:
        self._scene, self._clicked = scene, clicked
        self._nodes: dict[str, viser.MeshHandle | viser.GlbHandle] = {}
        self._looks: dict[str, object] = {}
        self._poses: dict[str, Transform] = {}
        self._colours: dict[str, Colour] = {}
        self._vertices: dict[str, Array] = {}
        self._boxes: dict[str, Array] = {}
        self._shells: list[viser.SceneNodeHandle] = []
        self.figures: dict[str, RobotFigure] = {}
        self.robots: dict[str, PlacedRobot] = {}

    def show(self, cell: Workcell) -> None:
        """Show a cell with robots at HOME and objects at their start; bodies that look the same stay."""
        colours = team_colours([robot.name for robot in cell.robots])
        there: set[str] = set()
        for robot in cell.robots:
            there |= self._show_robot(robot, colours[robot.name])
        for fixture, colour in coloured_fixtures(cell):
            there.add(name := f"/fixtures/{fixture.name}")
            self._show_body(name, fixture.shape, colour, fixture.pose)
        for item in cell.objects:
            there.add(name := f"/objects/{item.name}")
            self._show_body(name, item.shape, item.colour, item.start)
            self._nodes[name].visible = not item.later
            if item.later:
                del self._boxes[name]
            node = self._nodes[name]
            if item.kind == DOOR and isinstance(node, viser.MeshHandle):
                node.opacity = _OPACITY
        for name in set(self._nodes) - there:
            self._remove(name)
        self.robots = {robot.name: robot for robot in cell.robots}

    @property
    def bodies(self) -> list[str]:
        """All robots and objects, such as ``robots/left``."""
        objects = [name[1:] for name in self._nodes if name.startswith("/objects/")]
        return [*(f"robots/{name}" for name in self.robots), *objects]

    def extent(self) -> tuple[Array, float, float]:
        """Return the middle of the cell, its size, and the height of its lowest corner [m]."""
        feet = [robot.base[:3, 3] for robot in self.robots.values()]
        boxes = [b for b in self._boxes.values() if np.ptp(b, axis=0).max() < _FLOOR_M]
        points = np.vstack([*feet, *boxes])
        low, high = points.min(axis=0), points.max(axis=0)
        size = max(float(np.max(high - low)), 1.0)
        lowest = min((box[0, 2] for box in self._boxes.values()), default=0.0)
        return 0.5 * (low + high), size, float(lowest)

    def box(self, body: str, pose: Transform) -> Array | None:
        """Return the corners of the upright box around a body at a pose, shape (2, 3) [m]; None without a body.

        That of a robot is around what does not move, that of a goal around its object.
        """
        vertices = self._vertices.get(f"/{body.replace('goals/', 'objects/')}")
        if vertices is None:
            return None
        placed = vertices @ pose[:3, :3].T + pose[:3, 3]
        return np.array([placed.min(axis=0), placed.max(axis=0)])

    def snapped(
        self, body: str, pose: Transform, poses: Mapping[str, Transform]
    ) -> Transform:
        """Return a pose of a body at which it touches what it nearly touches; see ``contact_shift``.

        A goal touches other goals, of which the poses are given by their bodies, and no objects at their start.
        """
        boxes = self._boxes | {f"/{own}": self.box(own, poses[own]) for own in poses}
        left_out = "/objects/" if body.startswith("goals/") else "/goals/"
        others = [
            own
            for name, own in boxes.items()
            if own is not None and name != f"/{body}" and not name.startswith(left_out)
        ]
        box, out = self.box(body, pose), pose.copy()
        if box is not None and others:
            out[:3, 3] += contact_shift(box, np.array(others))
        return out

    def move_robot(self, robot: str, q: Array) -> None:
        """Show a robot at a configuration, shape (n,) [rad or m]."""
        for joint, pose in self.figures[robot].poses(q).items():
            self._place(f"/robots/{robot}/{joint}", pose)

    def move_body(self, body: str, pose: Transform) -> None:
        """Show a robot with its base, a fixture or an object at a pose in the world."""
        kind, _, name = body.partition("/")
        if kind == "robots":
            self.figures[name].base = pose
            self.move_robot(name, self.robots[name].home)
        elif f"/{body}" in self._nodes:
            self._place(f"/{body}", pose)

    def show_goal(self, body: str, pose: Transform) -> None:
        """Show a translucent object at its goal, such as ``goals/brick``, and no other one; of other bodies none."""
        for name in [own for own in self._nodes if own.startswith("/goals/")]:
            self._remove(name)
        whole = self._nodes.get(f"/{body.replace('goals/', 'objects/')}")
        if body.startswith("goals/") and isinstance(whole, viser.MeshHandle):
            self._nodes[f"/{body}"] = self._scene.add_mesh_simple(
                f"/{body}",
                whole.vertices,
                whole.faces,
                color=whole.color,
                opacity=2 * _OPACITY,
            )
            self._place(f"/{body}", pose)

    def move_objects(self, poses: Mapping[str, Transform]) -> None:
        """Show objects at poses in the world, and hide all others."""
        for name, node in self._nodes.items():
            item = name.removeprefix("/objects/")
            if item == name:
                continue
            if node.visible != (item in poses):
                node.visible = item in poses
            if item in poses:
                self._place(name, poses[item])

    def look(self, server: viser.ViserServer) -> None:
        """Put a grid below the cell, and have all pages look at it."""
        middle, size, floor = self.extent()
        server.scene.set_up_direction("+z")
        side = np.ceil(4.0 * size)
        server.scene.add_grid(
            "/grid",
            width=side,
            height=side,
            cell_size=0.1 if size < _FINE_GRID_M else 1.0,
            cell_color=_GRID_COLOUR,
            section_color=_GRID_COLOUR,
            position=(middle[0], middle[1], floor - 0.002),
        )

        def look_from(client: viser.ClientHandle) -> None:
            """Look from so far away that the cell is seen on a narrow page, too."""
            camera = client.camera
            wide, high = camera.image_width - _PANEL_PX, camera.image_height
            away = size * max(1.0, 0.8 * high / max(wide, 0.2 * high, 1))
            camera.position = middle + away * np.array(_VIEWED_FROM)
            camera.look_at = middle

        server.on_client_connect(look_from)

    def mark(self, bodies: set[str]) -> None:
        """Colour the fixtures and objects that are at fault, and no others."""
        for name, own in self._colours.items():
            colour = _AT_FAULT if name[1:] in bodies else own
            node = self._nodes.get(name)
            if isinstance(node, viser.MeshHandle) and tuple(node.color) != colour:
                node.color = colour

    def show_reach(self, *, shown: bool) -> None:
        """Show or hide a translucent shell around the places that the tool of each robot reaches."""
        for shell in self._shells:
            shell.remove()
        self._shells = []
        colours = team_colours(list(self.robots))
        for name, robot in self.robots.items() if shown else ():
            if robot.model.is_mobile:
                continue
            vertices, faces = _reach_shell(robot)
            self._shells.append(
                self._scene.add_mesh_simple(
                    f"/reach/{name}",
                    vertices.astype(np.float32),
                    faces.astype(np.uint32),
                    color=parse_rgb(colours[name]),
                    opacity=_OPACITY,
                    side="double",
                )
            )

    def _show_robot(self, robot: PlacedRobot, colour: str) -> set[str]:
        looks = (robot.model.urdf, colour)
        figure = self.figures.get(robot.name)
        group = f"/robots/{robot.name}"
        if figure is None or self._looks.get(group) != looks:
            figure = self.figures[robot.name] = RobotFigure(robot, colour)
            for joint, mesh in figure.meshes.items():
                self._remove(name := f"{group}/{joint}")
                self._nodes[name] = self._scene.add_mesh_trimesh(name, mesh)
                self._listen(name, f"robots/{robot.name}")
            if 0 in figure.meshes:
                self._vertices[group] = figure.meshes[0].vertices
            self._looks[group] = looks
        figure.base = robot.base
        self._bound(group, robot.base)
        self.move_robot(robot.name, robot.home)
        return {f"{group}/{joint}" for joint in figure.meshes}

    def _show_body(
        self, name: str, shape: Shape, colour: Colour, pose: Transform
    ) -> None:
        drawn = triangles_of(shape)
        looks = (drawn.vertices.tobytes(), drawn.faces.tobytes(), colour)
        if self._looks.get(name) != looks:
            self._remove(name)
            self._looks[name], self._colours[name] = looks, colour
            self._nodes[name] = self._scene.add_mesh_simple(
                name,
                drawn.vertices.astype(np.float32),
                drawn.faces.astype(np.uint32),
                color=colour,
                flat_shading=True,
            )
            self._vertices[name] = drawn.vertices
            self._listen(name, name[1:])
        self._bound(name, pose)
        self._place(name, pose)

    def _bound(self, name: str, pose: Transform) -> None:
        """Keep the box around a body, for others to touch."""
        if (box := self.box(name[1:], pose)) is not None:
            self._boxes[name] = box

    def _remove(self, name: str) -> None:
        """Remove a node where there is one; of a robot, its other nodes are drawn again with it."""
        if name in self._nodes:
            self._nodes.pop(name).remove()
        for key in (name, name.rpartition("/")[0]):
            for own in (self._poses, self._looks, self._vertices, self._boxes):
                own.pop(key, None)

    def _listen(self, node: str, body: str) -> None:
        self._nodes[node].on_click(lambda _: self._clicked(body))

    def _place(self, name: str, pose: Transform) -> None:
        """Set the pose of a node, unless it has it."""
        if name not in self._poses or not np.array_equal(self._poses[name], pose):
            self._poses[name], node = pose, self._nodes[name]
            node.position, node.wxyz = pose[:3, 3], quat_wxyz(pose)


def _reach_shell(robot: PlacedRobot) -> tuple[Array, Indices]:
    """Return the convex hull of the places that the tool of a robot comes to: vertices and faces."""
    model = robot.model
    q = np.random.default_rng(0).uniform(
        model.lower, model.upper, (_CONFIGURATIONS, model.dof)
    )
    hull = ConvexHull(np.array([tool_pose(robot, own)[:3, 3] for own in q]))
    return hull.points, hull.simplices.astype(np.int64)


def tool_pose(robot: PlacedRobot, q: Array) -> Transform:
    """Return the world pose of a robot's tool frame; of its flange, where it has none."""
    frame = "tool" if "tool" in robot.model.frames else "flange"
    return frame_pose(robot, q, frame)
