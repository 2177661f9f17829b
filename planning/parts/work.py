"""A pick-and-place assembly as the planner takes every assembly."""

from __future__ import annotations

from functools import partial

from planning.cell.workcell import Workcell
from planning.parts.assembly import PickPlaceAssembly
from planning.parts.candidates import PickPlaceCandidates, find_candidates
from planning.parts.expansion import expand_step, link_steps
from planning.tasks.work import AssemblyWork


def prepare_pick_place(cell: Workcell, assembly: PickPlaceAssembly) -> AssemblyWork:
    """Find every feasible way to do every step of a pick-and-place assembly.

    Args:
        cell: its objects are the parts.
        assembly: goals and steps.

    Raises:
        InfeasibleStepError: a part would hang in the air, or goes where something is.
    """
    return pick_place_work(find_candidates(cell, assembly))


def pick_place_work(candidates: PickPlaceCandidates) -> AssemblyWork:
    """Return what the planner needs of candidates that have been found."""
    return AssemblyWork(
        candidates.problem,
        partial(expand_step, candidates),
        partial(link_steps, candidates),
    )
