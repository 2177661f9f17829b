"""From the sections of a scenario to the objects that planning works with."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np

from planning.lego.contacts import PlacedBrick
from planning.lego.structure import (
    BrickType,
    Cell,
    LegoAssembly,
    LegoStep,
    Plate,
    Press,
    StockBrick,
    Support,
)
from planning.robots.model import RobotModel
from planning.transforms import Transform, from_quat_wxyz, from_rpy, readonly
from planning.workcell import Clearances, Fixture, PlacedRobot, Workcell
from twin.scenario import (
    FixtureSection,
    LegoSection,
    PlateSection,
    PoseSection,
    PressSection,
    RobotSection,
    Scenario,
    StepSection,
    StockSection,
    SupportSection,
)
from twin.scenario_structure import read_structure


def build_workcell(scenario: Scenario, folder: Path = Path()) -> Workcell:
    """Return the cell of a scenario: robots, fixtures, the plate, and the stock.

    Args:
        scenario: a checked scenario.
        folder: where relative paths in it start, that of its file.

    Raises:
        RobotModelError: a robot description cannot be used.
    """
    from planning.lego.objects import STORAGE, plate_fixture, stock_objects

    clearance = scenario.cell.clearance
    assembly = build_assembly(scenario)
    plates = [plate_fixture(assembly.plate)]
    if assembly.storage is not None:
        plates.append(plate_fixture(assembly.storage, STORAGE))
    return Workcell(
        robots=tuple(_robot(r, folder) for r in scenario.cell.robots),
        fixtures=(
            *(_fixture(f) for f in scenario.cell.fixtures),
            *plates,
        ),
        objects=stock_objects(assembly),
        clearances=Clearances(clearance.robot_robot_m, clearance.robot_object_m),
    )


def build_assembly(scenario: Scenario) -> LegoAssembly:
    """Return the plate, the stock and the steps of a scenario.

    There are no steps yet where the scenario gives a structure; see ``build_structure``.
    """
    lego = scenario.assembly
    twist = lego.twist_deg.model_dump(by_alias=True)
    return LegoAssembly(
        plate=_plate(lego.plate),
        bricks=brick_types(lego),
        stock=tuple(_stock(s) for s in lego.stock),
        steps=tuple(_step(s) for s in lego.steps),
        twist={skill: float(np.deg2rad(angle)) for skill, angle in twist.items()},
        storage=None if lego.storage_plate is None else _plate(lego.storage_plate),
    )


def build_structure(scenario: Scenario) -> tuple[PlacedBrick, ...] | None:
    """Return the bricks of the finished structure, None where the scenario gives steps."""
    lego = scenario.assembly
    if lego.structure is None:
        return None
    return read_structure(lego.structure, brick_types(lego)).bricks


def brick_count(scenario: Scenario) -> int:
    """Return how many bricks are placed, which is the number of steps."""
    structure = build_structure(scenario)
    return len(scenario.assembly.steps if structure is None else structure)


def brick_types(assembly: LegoSection) -> dict[str, BrickType]:
    """Return the brick types by name: the library, then those of the scenario."""
    from planning.lego.bricks import BRICKS

    own = {
        name: BrickType(name, (brick.studs[0], brick.studs[1]), brick.mass_kg)
        for name, brick in assembly.bricks.items()
    }
    return {**BRICKS, **own}


def build_transform(pose: PoseSection) -> Transform:
    """Return a pose of the scenario as a (4, 4) transform."""
    if pose.quat_wxyz is not None:
        return from_quat_wxyz(pose.xyz_m, pose.quat_wxyz)
    rpy = np.deg2rad(pose.rpy_deg or (0.0, 0.0, 0.0))
    return from_rpy(pose.xyz_m, rpy.tolist())


def _robot(section: RobotSection, folder: Path) -> PlacedRobot:
    from planning.robots.registry import robot_model

    model: RobotModel = robot_model(section.model, folder)
    if section.frames:
        own = {name: build_transform(pose) for name, pose in section.frames.items()}
        model = dataclasses.replace(model, frames={**model.frames, **own})
    if section.home_deg is not None:
        home = readonly(np.deg2rad(section.home_deg))
    elif section.home_rad_or_m is not None:
        home = readonly(section.home_rad_or_m)
    else:
        home = model.home
    return PlacedRobot(section.name, model, build_transform(section.base), home)


def _fixture(section: FixtureSection) -> Fixture:
    from planning.geometry.cover import box_body

    size = readonly(section.size_m)
    pose = build_transform(section.pose)
    return Fixture(section.name, size, pose, box_body(section.name, size))


def _plate(section: PlateSection) -> Plate:
    return Plate(build_transform(section.pose), (section.studs[0], section.studs[1]))


def _stock(section: StockSection) -> StockBrick:
    x, y, z = section.at
    cell = Cell(x, y, z, section.turned)
    return StockBrick(section.name, section.brick, cell, section.fixed, section.station)


def _step(section: StepSection) -> LegoStep:
    x, y, z = section.at
    press = press_cell = support = None
    if section.press is not None:
        press = _press(section.press)
    if section.press_cell is not None:
        i, j, layer = section.press_cell.at
        press_cell = Cell(i, j, layer, section.press_cell.turned)
    if section.support is not None:
        support = _support(section.support)
    return LegoStep(
        brick=section.brick,
        cell=Cell(x, y, z, section.turned),
        up=section.place == "up",
        press=press,
        press_cell=press_cell,
        support=support,
        attack=section.attack,
        stock=section.stock,
        presses=tuple(_press(item) for item in section.presses),
        supports=tuple(_support(item) for item in section.supports),
    )


def _press(section: PressSection) -> Press:
    return Press(section.side, section.offset)


def _support(section: SupportSection) -> Support:
    x, y, z = section.at
    return Support(x, y, z, section.orientation)
