"""Panel of the page with what is shown beside the bodies of a cell: reach, camera, and marks of a run."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

import numpy as np
import viser

from planning.kinematics.kinematics import joint_poses_of
from planning.transforms import Array, Transform, quat_wxyz
from twin.durations.nanoseconds import NANOSECONDS
from twin.view.cell_scene import CellScene, Colour, tool_pose
from twin.view.robot_distance import RobotDistance
from twin.view.robot_meshes import checked_meshes
from twin.view.run_playback import RunPlayback

_NOTHING, _THIS, _NEXT, _WHOLE = "nothing", "this bar", "next bar", "whole run"

_BODIES = 9
"""Number of configurations of a swept volume."""

_STEP_S, _MOST_STEPS = 0.02, 10_000
"""Times between points of a path [s], and how many there are at most."""

_OPACITY = 0.16
_THIN = 0.004
"""Thickness of lines, in sizes of the cell."""

_DISTANCE, _DISTANCE_COLOUR = "Distance of robots", (220, 38, 127)


class LookPanel:
    """Draws what is chosen.

    Args:
        server: server of the scene.
        scene: bodies of the cell.
    """

    def __init__(self, server: viser.ViserServer, scene: CellScene) -> None:
        self._server, self._scene, gui = server, scene, server.gui
        reach = gui.add_checkbox("Reach of robots", initial_value=False)
        reach.on_update(lambda _: scene.show_reach(shown=reach.value))
        hint = "Object or tool that stays in the middle; of a robot, its motion alone is drawn"
        self._camera = gui.add_dropdown("Camera on", (_NOTHING,), hint=hint)
        hint = "Path of the tool, and of a bar of the chart the bodies that the planner checks"
        options = (_NOTHING, _THIS, _NEXT, _WHOLE)
        self._motion = gui.add_dropdown("Motion of", options, hint=hint)
        hint = "Least distance of two robots with their tools, without what they hold"
        self._distance = gui.add_checkbox(_DISTANCE, False, hint=hint)
        self._choices = self._camera, self._motion, self._distance
        self._marks: dict[str, tuple[object, list[Any]]] = {}
        self.begin(None)

    @property
    def chosen(self) -> tuple[str | bool, ...]:
        """What is chosen."""
        return tuple(choice.value for choice in self._choices)

    def begin(self, run: RunPlayback | None) -> None:
        """Offer what can be shown of a run that is played; nothing for None."""
        for name in list(self._marks):
            self._mark(name, None, list)
        self._run = run
        self._measured: RobotDistance | None = None
        self._camera.options = (_NOTHING, *self._scene.bodies)
        for choice in self._choices:
            choice.visible = run is not None
        self._thin = _THIN * self._scene.extent()[1]

    def show(
        self,
        t_s: float,
        configurations: Mapping[str, Array],
        objects: Mapping[str, Transform],
        waits_s: float,
    ) -> None:
        """Show what is chosen, and lines from robots that wait to what they wait for.

        Args:
            t_s: time of the run [s].
            configurations: of the robots then.
            objects: poses in the world of the objects then.
            waits_s: time of the waits [s].
        """
        robots = self._scene.robots
        places = {f"objects/{name}": pose[:3, 3] for name, pose in objects.items()}
        for name, q in configurations.items():
            places[f"robots/{name}"] = tool_pose(robots[name], q)[:3, 3]
        assert self._run is not None
        for name in robots:
            self._show_motion(self._run, name, t_s)
            bar = self._run.bar(name, waits_s)
            waits = bar and waits_s < bar[1] and bar[4] in places
            ends = [places[f"robots/{name}"], places[bar[4]]] if waits else []
            self._show_line(name, np.array(ends), self._scene.colours[name])
        self._show_distance(configurations)
        if (middle := places.get(self._camera.value)) is None:
            return
        for client in self._server.get_clients().values():
            camera = client.camera
            if camera.update_timestamp:  # its viewer has said where it is
                # Whoever turns the view or comes nearer keeps the point that it looks at.
                camera.position = middle + camera.position - camera.look_at

    def _show_distance(self, configurations: Mapping[str, Array]) -> None:
        ends, text = np.empty(0), _DISTANCE
        robots = self._scene.robots.values()
        if self._distance.value and len(robots) > 1:
            self._measured = self._measured or RobotDistance(robots)
            least, ends = self._measured.closest(configurations)
            text = f"{_DISTANCE}: {max(1000.0 * least, 0.0):.0f} mm"
        self._show_line("", ends, _DISTANCE_COLOUR)
        if self._distance.label != text:
            self._distance.label = text

    def _show_motion(self, run: RunPlayback, robot: str, t_s: float) -> None:
        of, camera = self._motion.value, self._camera.value
        begin_s, end_s = (run.bar(robot, t_s, int(of == _NEXT)) or [0.0, 0.0])[:2]
        span = (0.0, run.end_s) if of == _WHOLE else (begin_s, end_s)
        if of == _NOTHING or (camera[:7] == "robots/" and camera[7:] != robot):
            span = (0.0, 0.0)
        draw = partial(self._draw_motion, run, robot, span)
        self._mark(f"motion/{robot}", span if span[1] else None, draw)

    def _draw_motion(
        self, run: RunPlayback, robot: str, span: tuple[float, float]
    ) -> list[Any]:
        """Draw the path of a tool and, but for the whole run, bodies at equal steps of joint motion."""
        placed, count = run.robots[robot], 2 + int((span[1] - span[0]) / _STEP_S)
        t_s = np.linspace(*span, min(count, _MOST_STEPS))
        q = run.motions[robot].at((t_s * NANOSECONDS).astype(np.int64))
        points = np.array([tool_pose(placed, own)[:3, 3] for own in q])
        name, colour = f"/motion/{robot}", self._scene.colours[robot]
        steps = np.stack([points[:-1], points[1:]], axis=1)
        nodes = self._draw_lines(name, steps, colour)
        if self._motion.value == _WHOLE:
            return nodes
        far = np.append(0.0, np.cumsum(np.abs(np.diff(q, axis=0)).max(axis=1)))
        chosen = np.unique(np.searchsorted(far, np.linspace(0.0, far[-1], _BODIES)))
        frames = np.array([joint_poses_of(placed, q[k]) for k in chosen])
        for joint, mesh in checked_meshes(placed.model).items():
            if joint == 0:
                continue  # the base does not move
            swept = self._server.scene.add_batched_meshes_simple(
                f"/swept/{robot}/{joint}",
                mesh.vertices,
                mesh.faces,
                np.array([quat_wxyz(pose) for pose in frames[:, joint]]),
                frames[:, joint, :3, 3],
                batched_colors=colour,
                opacity=_OPACITY,
                cast_shadow=False,
            )
            nodes.append(swept)
        return nodes

    def _show_line(self, name: str, ends: Array, colour: Colour) -> None:
        """Show a line between two points, shape (2, 3) [m]; none for an empty array."""
        points = ends.reshape(-1, 2, 3)
        draw = partial(self._draw_lines, f"/line/{name}", points, colour)
        for node in self._mark(f"line/{name}", len(points) or None, draw):
            node.points = points

    def _draw_lines(self, name: str, points: Array, colour: Colour) -> list[Any]:
        scene = self._server.scene
        return [scene.add_line_segments(name, points, colour, thickness=self._thin)]

    def _mark(self, name: str, key: object, draw: Callable[[], list[Any]]) -> list[Any]:
        """Return the nodes of a mark, drawn again when its key changes; None is for no mark."""
        drawn_for, nodes = self._marks.get(name, (None, []))
        if drawn_for != key:
            for node in nodes:
                node.remove()
            nodes = [] if key is None else draw()
            self._marks[name] = key, nodes
        return nodes
