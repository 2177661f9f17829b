"""3-D scene of a cell in viser: robots, fixtures and objects, with poses that can be set."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import trimesh
import viser

from planning.cell.shape import Shape
from planning.cell.workcell import PlacedRobot, Workcell
from planning.kinematics.kinematics import frame_pose, joint_poses_of
from planning.tasks.task import DOOR
from planning.transforms import Array, Transform, quat_wxyz
from twin.drawing.looks import coloured_fixtures
from twin.drawing.team_colours import parse_rgb, team_colours
from twin.drawing.triangles import triangles_of
from twin.view.contact_snap import contact_shift
from twin.view.robot_meshes import visual_meshes

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


@dataclass
class _Body:
    """A robot, fixture, object or goal that is shown.

    Attributes:
        looks: what it was drawn from.
        nodes: its meshes, of a robot by the number of the joint that moves them.
        vertices: of the mesh that does not move by itself, shape (n, 3) [m]; None for none.
        colour: its own colour, which it has unless it is at fault; None for robots.
        box: corners of the upright box around it, for others to touch, shape (2, 3) [m]; None for none.
    """

    looks: object
    nodes: dict[int, viser.MeshHandle | viser.GlbHandle]
    vertices: Array | None = None
    colour: Colour | None = None
    box: Array | None = None
    _poses: dict[int, Transform] = field(default_factory=dict)

    def place(self, pose: Transform, joint: int = 0) -> None:
        """Set the pose of a mesh, unless it has it."""
        if joint not in self._poses or not np.array_equal(self._poses[joint], pose):
            self._poses[joint], node = pose, self.nodes[joint]
            node.position, node.wxyz = pose[:3, 3], quat_wxyz(pose)

    def bound(self, pose: Transform) -> Array | None:
        """Return the upright box around its vertices at a pose, shape (2, 3) [m]; None without vertices."""
        if self.vertices is None:
            return None
        placed = self.vertices @ pose[:3, :3].T + pose[:3, 3]
        return np.array([placed.min(axis=0), placed.max(axis=0)])


class CellScene:
    """The bodies of a cell in a scene of viser.

    Bodies are named ``robots/NAME``, ``fixtures/NAME``, ``objects/NAME`` and ``goals/NAME``. Nodes have their names,
    those of robots with the number of a joint.

    Args:
        scene: the scene, to which nodes are added.
        clicked: called with the name of the body on which somebody clicks.

    Attributes:
        robots: the robots where they are shown, by name.
        colours: of the robots, by name.
    """

    def __init__(
        self, scene: viser.SceneApi, clicked: Callable[[str], None] = lambda _: None
    ) -> None:
        self._scene, self._clicked = scene, clicked
        self._bodies: dict[str, _Body] = {}
        self._shells: list[viser.SceneNodeHandle] = []
        self.robots: dict[str, PlacedRobot] = {}
        self.colours: dict[str, Colour] = {}

    def show(self, cell: Workcell) -> None:
        """Show a cell with robots at HOME and objects at their start; bodies that look the same stay."""
        self.robots = {robot.name: robot for robot in cell.robots}
        colours = team_colours(list(self.robots))
        self.colours = {name: parse_rgb(own) for name, own in colours.items()}
        there = set()
        for robot in cell.robots:
            there.add(name := f"robots/{robot.name}")
            self._show_robot(name, robot)
        for fixture, colour in coloured_fixtures(cell):
            there.add(name := f"fixtures/{fixture.name}")
            self._show_body(name, fixture.shape, colour, fixture.pose)
        for item in cell.objects:
            there.add(name := f"objects/{item.name}")
            self._show_body(name, item.shape, item.colour, item.start)
            node = self._bodies[name].nodes[0]
            node.visible = not item.later
            if item.later:
                self._bodies[name].box = None
            if item.kind == DOOR and isinstance(node, viser.MeshHandle):
                node.opacity = _OPACITY
        for name in set(self._bodies) - there:
            self._remove(name)
        self.show_reach(shown=bool(self._shells))

    @property
    def bodies(self) -> list[str]:
        """All robots and objects, such as ``robots/left``."""
        return [own for own in self._bodies if own.startswith(("robots/", "objects/"))]

    def extent(self) -> tuple[Array, float, float]:
        """Return the middle of the cell, its size, and the height of its lowest corner [m]."""
        feet = [robot.base[:3, 3] for robot in self.robots.values()]
        boxes = [own.box for own in self._bodies.values() if own.box is not None]
        small = [box for box in boxes if np.ptp(box, axis=0).max() < _FLOOR_M]
        points = np.vstack([*feet, *small])
        low, high = points.min(axis=0), points.max(axis=0)
        size = max(float(np.max(high - low)), 1.0)
        lowest = min((box[0, 2] for box in boxes), default=0.0)
        return 0.5 * (low + high), size, float(lowest)

    def box(self, body: str, pose: Transform) -> Array | None:
        """Return the corners of the upright box around a body at a pose, shape (2, 3) [m]; None without a body.

        That of a robot is around what does not move, that of a goal around its object.
        """
        found = self._bodies.get(body.replace("goals/", "objects/"))
        return None if found is None else found.bound(pose)

    def snapped(
        self, body: str, pose: Transform, poses: Mapping[str, Transform]
    ) -> Transform:
        """Return a pose of a body at which it touches what it nearly touches; see ``contact_shift``.

        A goal touches other goals, of which the poses are given by their bodies, and no objects at their start.
        """
        boxes = {name: own.box for name, own in self._bodies.items()}
        boxes |= {name: self.box(name, own) for name, own in poses.items()}
        left_out = "objects/" if body.startswith("goals/") else "goals/"
        others = [
            own
            for name, own in boxes.items()
            if own is not None and name != body and not name.startswith(left_out)
        ]
        box, out = self.box(body, pose), pose.copy()
        if box is not None and others:
            out[:3, 3] += contact_shift(box, np.array(others))
        return out

    def move_robot(self, robot: str, q: Array) -> None:
        """Show a robot at a configuration, shape (n,) [rad or m]."""
        poses, body = (
            joint_poses_of(self.robots[robot], q),
            self._bodies[f"robots/{robot}"],
        )
        for joint in body.nodes:
            body.place(poses[joint], joint)

    def move_body(self, body: str, pose: Transform) -> None:
        """Show a robot with its base, a fixture or an object at a pose in the world."""
        kind, _, name = body.partition("/")
        if kind == "robots":
            self.robots[name] = replace(self.robots[name], base=pose)
            self.move_robot(name, self.robots[name].home)
        elif body in self._bodies:
            self._bodies[body].place(pose)

    def show_goal(self, body: str, pose: Transform) -> None:
        """Show a translucent object at its goal, such as ``goals/brick``, and no other one; of other bodies none."""
        for name in [own for own in self._bodies if own.startswith("goals/")]:
            self._remove(name)
        whole = self._bodies.get(body.replace("goals/", "objects/"))
        if body.startswith("goals/") and whole is not None:
            node = whole.nodes[0]
            assert isinstance(node, viser.MeshHandle)
            copy = self._scene.add_mesh_simple(
                f"/{body}",
                node.vertices,
                node.faces,
                color=node.color,
                opacity=2 * _OPACITY,
            )
            self._bodies[body] = _Body(None, {0: copy})
            self._bodies[body].place(pose)

    def move_objects(self, poses: Mapping[str, Transform]) -> None:
        """Show objects at poses in the world, and hide all others."""
        for name, body in self._bodies.items():
            kind, _, item = name.partition("/")
            if kind != "objects":
                continue
            body.nodes[0].visible = item in poses
            if item in poses:
                body.place(poses[item])

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
        for name, own in self._bodies.items():
            if own.colour is not None:
                node = own.nodes[0]
                assert isinstance(node, viser.MeshHandle)
                node.color = _AT_FAULT if name in bodies else own.colour

    def show_reach(self, *, shown: bool) -> None:
        """Show or hide a translucent shell around the places that the tool of each robot reaches."""
        for shell in self._shells:
            shell.remove()
        self._shells = []
        for name, robot in self.robots.items() if shown else ():
            if robot.model.is_mobile:
                continue
            hull = _reach_hull(robot)
            self._shells.append(
                self._scene.add_mesh_simple(
                    f"/reach/{name}",
                    hull.vertices,
                    hull.faces,
                    color=self.colours[name],
                    opacity=_OPACITY,
                    side="double",
                )
            )

    def _show_robot(self, name: str, robot: PlacedRobot) -> None:
        colour = self.colours[robot.name]
        looks, body = (robot.model.urdf, colour), self._bodies.get(name)
        if body is None or body.looks != looks:
            self._remove(name)
            meshes = visual_meshes(robot, colour)
            nodes = {
                joint: self._scene.add_mesh_trimesh(f"/{name}/{joint}", mesh)
                for joint, mesh in meshes.items()
            }
            base = meshes[0].vertices if 0 in meshes else None
            body = self._add(name, _Body(looks, {**nodes}, base))
        body.box = body.bound(robot.base)
        self.move_robot(robot.name, robot.home)

    def _show_body(
        self, name: str, shape: Shape, colour: Colour, pose: Transform
    ) -> None:
        drawn, body = triangles_of(shape), self._bodies.get(name)
        looks = (drawn.vertices.tobytes(), drawn.faces.tobytes(), colour)
        if body is None or body.looks != looks:
            self._remove(name)
            node = self._scene.add_mesh_simple(
                f"/{name}",
                drawn.vertices,
                drawn.faces,
                color=colour,
                flat_shading=True,
            )
            body = self._add(name, _Body(looks, {0: node}, drawn.vertices, colour))
        body.box = body.bound(pose)
        body.place(pose)

    def _add(self, name: str, body: _Body) -> _Body:
        """Return a body that is kept, and listens to clicks."""
        self._bodies[name] = body
        for node in body.nodes.values():
            node.on_click(lambda _: self._clicked(name))
        return body

    def _remove(self, name: str) -> None:
        """Remove a body where there is one."""
        if name in self._bodies:
            for node in self._bodies.pop(name).nodes.values():
                node.remove()


def _reach_hull(robot: PlacedRobot) -> Any:
    """Return the convex hull of the places that the tool of a robot comes to."""
    model = robot.model
    q = np.random.default_rng(0).uniform(
        model.lower, model.upper, (_CONFIGURATIONS, model.dof)
    )
    places = np.array([tool_pose(robot, own)[:3, 3] for own in q])
    return trimesh.convex.convex_hull(places)


def tool_pose(robot: PlacedRobot, q: Array) -> Transform:
    """Return the world pose of a robot's tool frame; of its flange, where it has none."""
    frame = "tool" if "tool" in robot.model.frames else "flange"
    return frame_pose(robot, q, frame)
