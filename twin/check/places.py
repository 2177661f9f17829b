"""The places that objects go to, as convex pieces, for every kind of assembly."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from planning.cell.cover import box_body
from planning.parts.assembly import Place
from planning.parts.part_steps import stop_pose
from planning.transforms import Array, Transform
from twin.check.finding import Subject
from twin.scenario.sections.lego import LegoSection
from twin.scenario.sections.parts import PartsSection


def goal_boxes(subject: Subject) -> Iterator[tuple[str, Array]]:
    """Yield what is put somewhere, with the corners of each of its pieces there, shape (v, 3) [m]."""
    section = subject.scenario.assembly
    if isinstance(section, PartsSection):
        from twin.planning.part_assembly.built import build_assembly

        assembly, cell = build_assembly(section), subject.cell
        stops = [
            (step.part, stop_pose(cell, step.stop))
            for step in assembly.steps
            if isinstance(step, Place) and step.stop is not None
        ]
        for name, pose in (*assembly.goals.items(), *stops):
            for piece in cell.object(name).shape.pieces:
                yield name, piece.vertices @ pose[:3, :3].T + pose[:3, 3]
    elif isinstance(section, LegoSection):
        yield from _bricks(section)
    else:
        from twin.planning.construction import ConstructionKind

        if isinstance(subject.kind, ConstructionKind):
            for part in subject.kind.parts:
                yield part.name, _corners(part.size, part.goal)


def _bricks(section: LegoSection) -> Iterator[tuple[str, Array]]:
    from planning.lego.bricks.grid import box_pose, box_size
    from twin.planning.lego import build_lego, build_structure

    assembly = build_lego(section)
    bricks = build_structure(section) or assembly.structure
    for placed in bricks:
        pose = box_pose(assembly.plate, placed.cell, placed.brick)
        yield placed.name, _corners(box_size(placed.brick), pose)


def _corners(size: Array, pose: Transform) -> Array:
    vertices = box_body("place", size).vertices
    return np.asarray(vertices @ pose[:3, :3].T + pose[:3, 3])
