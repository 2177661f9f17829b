"""A LEGO assembly as the planner takes every assembly."""

from __future__ import annotations

from functools import partial

from planning.cell.workcell import Workcell
from planning.lego.bricks.assembly import LegoAssembly
from planning.lego.skills.candidates import LegoCandidates, find_candidates
from planning.lego.skills.expansion import expand_step, link_steps
from planning.tasks.work import AssemblyWork


def prepare_lego(cell: Workcell, assembly: LegoAssembly) -> AssemblyWork:
    """Find every feasible way to do every step of a LEGO assembly.

    Args:
        cell: its objects are the stock of the assembly.
        assembly: the structure and its steps.

    Raises:
        ScenarioError: a step cannot be understood.
    """
    return lego_work(find_candidates(cell, assembly))


def lego_work(candidates: LegoCandidates) -> AssemblyWork:
    """Return what the planner needs of candidates that have been found."""
    return AssemblyWork(
        candidates.problem,
        partial(expand_step, candidates),
        partial(link_steps, candidates),
    )
