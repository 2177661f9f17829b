"""A plan of a robot of one's own goes elsewhere with its folder, and knows when the robot changed."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest

from planning.cell.workcell import PlacedRobot, Workcell
from planning.errors import RobotModelError
from planning.robots.registry import robot_model
from planning.transforms import identity
from scheduling.graph.plan_files import load_plan, save_plan
from scheduling.graph.temporal_plan_graph import TemporalPlanGraph
from tests.planning.robots.test_robot_models import cone_obj, joint, write


def _plan(folder: Path) -> TemporalPlanGraph:
    """Return a plan without motions of an arm whose first link is a mesh."""
    meshes = folder / "arm" / "meshes"
    meshes.mkdir(parents=True)
    (meshes / "cone.obj").write_text(cone_obj())
    path = write(folder, joint("spin", "a", "b"), links="ab")
    mesh = '<mesh filename="package://arm/meshes/cone.obj"/>'
    path.write_text(path.read_text().replace('<box size="0.1 0.1 0.4"/>', mesh, 1))
    model = robot_model("arm.urdf", folder)
    robot = PlacedRobot("one", model, identity(), model.home)
    none = np.empty((0, 4), dtype=np.int64), np.empty(0, dtype=np.uint8)
    return TemporalPlanGraph(Workcell((robot,), (), ()), (), (), *none, (), ())


def test_a_plan_can_be_moved_without_the_robots_own_folder(tmp_path: Path) -> None:
    own, run, moved = tmp_path / "own", tmp_path / "run", tmp_path / "elsewhere"
    own.mkdir()
    tpg = _plan(own)
    save_plan(tpg, run)
    shutil.rmtree(own)
    shutil.move(run, moved)
    model = load_plan(moved).cell.robots[0].model
    assert model.urdf.is_relative_to(moved)
    assert model.joint_names == ("spin",)
    ours = tpg.cell.robots[0].model
    assert [len(p.body.vertices) for p in model.parts] == [
        len(p.body.vertices) for p in ours.parts
    ]


def test_a_mesh_that_has_changed_is_noticed(tmp_path: Path) -> None:
    own, run = tmp_path / "own", tmp_path / "run"
    own.mkdir()
    save_plan(_plan(own), run)
    (mesh,) = run.glob("robots/*/arm/meshes/cone.obj")
    mesh.write_text(mesh.read_text().replace("v ", "v  ", 1) + "# moved\n")
    with pytest.raises(RobotModelError, match="a mesh of it is not as it was"):
        load_plan(run)
