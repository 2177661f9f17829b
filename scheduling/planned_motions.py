"""An assembly with its planned motions: the input of every coordination method."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

from planning.cell.workcell import Workcell
from planning.motion.motion_plan import MotionPlan
from planning.motion.sequential import MotionSettings
from planning.tasks.assembly import Assembly
from planning.tasks.assignment import TaskPlan


@dataclass(frozen=True)
class PlannedMotions:
    """An assembly with its planned motions: the input of every coordination method.

    Attributes:
        cell: the workcell.
        assembly: what is built, such as a ``LegoAssembly``; the plan of a construction.
        task_plan: the assignment; empty where that is decided along with the motions.
        motion_plan: how everyone moves.
        settings: how tasks were turned into motions.
        work: what task and motion plan were made from, where others can be made from it.
        further: motions of the other units of which the plan of all products consists, see ``AssemblyKind.units``.
        ahead: the assembly of which ``work`` is the first steps, None where all are planned.
    """

    cell: Workcell
    assembly: Any
    task_plan: TaskPlan
    motion_plan: MotionPlan
    settings: MotionSettings
    work: Assembly | None = field(default=None, kw_only=True)
    further: tuple[PlannedMotions, ...] = field(default=(), kw_only=True)
    ahead: Assembly | None = field(default=None, kw_only=True)
