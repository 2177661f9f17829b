"""Export of LEGO structures as LDraw models, with one model step per assembly step.

LeoCAD, Studio and LDView display these models. Temporary support bricks are in a separate first step. Colours are those
of the recording of the run. The origin is the middle of the top surface of the base plate.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import groupby
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from planning.cell.workcell import CellObject
from planning.errors import OutputError
from planning.lego.bricks.assembly import (
    STUD_PITCH,
    BrickType,
    LegoAssembly,
    PlacedBrick,
)
from planning.lego.bricks.brick_world import brick_colour, stock_objects
from planning.lego.bricks.grid import box_pose, box_size
from planning.lego.importers.brick_models.ldraw_files import part_number
from planning.lego.importers.brick_models.part_shape import STUD
from planning.transforms import Transform, inverse
from twin.kinds.lego.section import LegoSection, brick_types
from twin.scenario.sections.scenario import Scenario
from twin.trial.run_result import RunResult

if TYPE_CHECKING:
    from scheduling.graph.temporal_plan_graph import TemporalPlanGraph

_UNIT = STUD_PITCH / STUD
"""Length of LDraw's unit [m]."""

_PLACES = 4
"""Decimals of positions."""

_END = "\r\n"


@dataclass(frozen=True)
class ShownBrick:
    """A brick of a model.

    Attributes:
        kind: its type.
        pose: of the centre of its box in the frame of the plate.
        height: of its box [m].
        colour: (r, g, b), 0 to 255.
        step: its step, 0 for bricks present from the start.
    """

    kind: BrickType
    pose: Transform
    height: float
    colour: tuple[int, int, int]
    step: int


def ldraw_files(run: RunResult) -> Mapping[str, bytes]:
    """Return the structure of a run as ``<scenario>.ldr``.

    Raises:
        OutputError: the run is of no LEGO assembly, or LDraw has no part for a brick.
    """
    from twin.kinds.lego.kind import build_lego

    section = run.sections.assembly
    if not isinstance(section, LegoSection):
        raise OutputError(f"{run.folder}: only a LEGO assembly is a model of LDraw")
    assembly, types = build_lego(section), brick_types(section)
    bricks = _shown(run.tpg, assembly, types)
    return {f"{run.name}.ldr": ldraw_model(run.name, bricks)}


def ldraw_of_scenario(scenario: Scenario, file: Path) -> bytes:
    """Return the structure of a scenario as a model, before planning.

    Steps are those that it gives; of a structure every layer is one.

    Args:
        scenario: of a LEGO assembly.
        file: that it is read from, for messages.

    Raises:
        OutputError: it is no LEGO assembly, or LDraw has no part for a brick.
    """
    from twin.kinds.lego.kind import brick_colours, build_lego, build_structure

    section = scenario.assembly
    if not isinstance(section, LegoSection):
        raise OutputError(f"{file}: only a LEGO assembly is a model of LDraw")
    assembly = build_lego(section)
    away = inverse(assembly.plate.pose)
    numbered: Sequence[tuple[int, PlacedBrick]] = list(
        enumerate(assembly.structure, start=1)
    )
    structure = build_structure(section)
    if structure is not None:
        levels = sorted({item.cell.level for item in structure})
        layer = {level: k for k, level in enumerate(levels, start=1)}
        ordered = sorted(structure, key=lambda item: item.cell.level)
        numbered = [(layer[item.cell.level], item) for item in ordered]
    bricks = _scaffold(assembly, brick_types(section))
    colours = brick_colours(section)
    for step, item in numbered:
        pose = away @ box_pose(assembly.plate, item)
        height = float(box_size(item.brick)[2])
        colour = colours.get(item.cell, brick_colour(item.brick))
        bricks.append(ShownBrick(item.brick, pose, height, colour, step))
    return ldraw_model(scenario.name, bricks)


def ldraw_model(name: str, bricks: Iterable[ShownBrick]) -> bytes:
    """Return a model as the content of a ``.ldr`` file.

    Args:
        name: of the model.
        bricks: in the order of their steps.

    Raises:
        OutputError: LDraw has no part of a size; names it.
    """
    lines = [f"0 {name}", f"0 Name: {name}.ldr", "0 Author: assembly-twin", ""]
    for step, group in groupby(bricks, key=lambda brick: brick.step):
        lines.append(f"0 // step {step}" if step else "0 // scaffolding")
        lines += [_line(brick) for brick in group]
        lines.append("0 STEP")
    return _END.join([*lines, ""]).encode()


def _shown(
    tpg: TemporalPlanGraph, assembly: LegoAssembly, types: Mapping[str, BrickType]
) -> list[ShownBrick]:
    """Return scaffolding and structure, each brick with its step.

    A brick that is put down and taken away again comes where it is put down last.
    """
    away = inverse(assembly.plate.pose)
    items: dict[str, CellObject] = {item.name: item for item in tpg.cell.objects}
    held: set[str] = set()
    rests: dict[str, tuple[int, Transform]] = {}
    for task in tpg.tasks:
        for handling in task.handlings:
            if handling.holder is not None:
                held.add(handling.object)
                rests.pop(handling.object, None)
            elif handling.object in held:
                rests[handling.object] = task.step, handling.pose
    out = _scaffold(assembly, types)
    for name, (step, pose) in sorted(rests.items(), key=lambda rest: rest[1][0]):
        item = items[name]
        if item.kind not in types:
            what = f"the plan has {name!r} for a {item.kind!r}, which is no brick"
            raise OutputError(what, choices=tuple(sorted(types)))
        kind, height = types[item.kind], float(item.size[2])
        out.append(ShownBrick(kind, away @ pose, height, item.colour, step))
    return out


def _scaffold(
    assembly: LegoAssembly, types: Mapping[str, BrickType]
) -> list[ShownBrick]:
    """Return the scaffolding, without the supports of feeding stations."""
    away = inverse(assembly.plate.pose)
    stations = [item.span for item in assembly.stock if item.station]
    out = []
    for brick, item in zip(assembly.stock, stock_objects(assembly), strict=True):
        if brick.fixed and not any(map(brick.span.carries, stations)):
            kind, height = types[item.kind], float(item.size[2])
            out.append(ShownBrick(kind, away @ item.start, height, item.colour, 0))
    return out


def _line(brick: ShownBrick) -> str:
    """Return the line of a part: its origin is in the middle of its top, its y points down."""
    kind = brick.kind
    number = None if kind.bare else part_number(kind.studs, kind.height)
    if number is None:
        form = (
            f"{kind.studs[0]} x {kind.studs[1]} studs, {kind.height}/3 of a brick high"
        )
        raise OutputError(
            f"LDraw has no part that is known here for {kind.name} ({form})"
        )
    top = brick.pose[:3, 3] + brick.pose[:3, 2] * brick.height / 2
    # The longer side of a part lies along its x.
    along = brick.pose[:2, 0 if kind.studs[0] >= kind.studs[1] else 1]
    ex, ey = np.round(along).astype(int).tolist()
    red, green, blue = brick.colour
    place = [_tidy(v) for v in (top[0], -top[2], top[1])]
    turn = (ex, 0, -ey, 0, 1, 0, ey, 0, ex)
    words = [f"0x2{red:02X}{green:02X}{blue:02X}", *place, *map(str, turn)]
    return " ".join(["1", *words, f"{number}.dat"])


def _tidy(metres: float) -> str:
    value = round(float(metres) / _UNIT, _PLACES) + 0.0
    return f"{value:.{_PLACES}f}".rstrip("0").rstrip(".")
