"""3-D scene of a cell in operation: robots, parts and doors where they are now."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from planning.cell.workcell import Workcell
from planning.transforms import Array
from twin.planning.build_workcell import build_workcell
from twin.runs.trajectory import Placement
from twin.trial.loaded_scenario import LoadedScenario
from twin.view.cell_scene import CellScene
from twin.view.look_panel import LookPanel
from twin.view.run_playback import world_poses
from twin.view.server import ViewServer

_PORT, _FRAME_S = 8150, 0.1
"""First port that is tried, and time between two frames [s]."""

Bodies = tuple[Workcell, dict[str, Array], dict[str, Placement]]
"""Cell, configurations of robots, and placements of objects that have changed hands."""


@contextmanager
def live_scene(case: LoadedScenario, now: Callable[[], Bodies | None]) -> Iterator[str]:
    """Serve the scene of a cell; yield its address.

    Args:
        case: the scenario.
        now: returns where all is; None before the run has begun.
    """
    answers = {"chart": lambda _: {}, "player": lambda _: {"chart": 0}}
    server, over = ViewServer(answers, _PORT, case.name), threading.Event()
    scene = CellScene(server.viser.scene)
    scene.show(build_workcell(case.sections, case.folder))
    scene.look(server.viser)
    LookPanel(server.viser, scene)

    def follow() -> None:
        shown: Workcell | None = None
        while not over.wait(_FRAME_S):
            if (bodies := now()) is None:
                continue
            cell, measured, changed = bodies
            if cell is not shown:
                scene.show(shown := cell)
            there = [own for own in cell.objects if not own.later]
            start = {own.name: Placement(0, own.name, None, own.start) for own in there}
            q = {own.name: own.home for own in cell.robots} | measured
            with server.viser.atomic():
                for robot, own in q.items():
                    scene.move_robot(robot, own)
                scene.move_objects(world_poses(start | changed, scene.robots, q))

    thread = threading.Thread(target=follow, daemon=True)
    thread.start()
    try:
        yield server.address
    finally:
        over.set()
        thread.join()
        server.viser.stop()
