"""Feasibility checks of a construction problem before any search."""

from __future__ import annotations

from planning.construction.problem.problem import ConstructionProblem
from planning.construction.problem.reach_bounds import (
    ReachBounds,
    reach_bounds,
    require_reach,
)
from planning.contacts.interference import Overlaps
from planning.contacts.touching import (
    NEAR,
    PlacedObject,
    nearby_entities,
    standing_fixtures,
)
from planning.errors import ConstructionError, format_names
from planning.geometry.scene_checker import SceneChecker
from planning.transforms import translation

_CLEAR = 1e-4
"""Distance below which two boxes touch [m]."""


def require_buildable(problem: ConstructionProblem) -> ReachBounds:
    """Check necessary conditions of feasibility by lower bounds; return the reachability of parts.

    Goal poses that overlap are found where the part graph is built.

    Raises:
        ConstructionError: a part that nothing connects to the ground, parts that wait for each
            other, parts too near to each other for a part in hand, ways into a place that begin
            in a fixture, parts that overlap in the supply, robots that stand in something, or
            parts that the team cannot bring to their places.
    """
    require_grounded(problem)
    _require_order(problem)
    _require_room(problem)
    require_free_supply(problem)
    bounds = reach_bounds(problem)
    require_reach(bounds)
    _require_way_in(problem)
    return bounds


def require_grounded(problem: ConstructionProblem) -> None:
    """Check that every part stands on the ground, or on parts that do.

    Raises:
        ConstructionError: names the parts that hang in the air.
    """
    floating = problem.graph.floating()
    if floating:
        raise ConstructionError(
            f"nothing connects {format_names(floating)} to the ground: every part must touch a fixture, or "
            "a part that is connected to one",
            parts=floating,
        )


def _require_order(problem: ConstructionProblem) -> None:
    """Check that there is a feasible placement order in which all parts stand."""
    waiting = problem.graph.never_placeable(carried=problem.carried)
    if waiting:
        raise ConstructionError(
            f"{format_names(waiting)} cannot be placed in any order: a part must touch the ground or a "
            "part in place, and what it rests on must be in place before; does one hang below "
            "another, or do they rest on each other in a circle?",
            parts=waiting,
        )
    if (falls := problem.balance.never_placeable()) is not None:
        body, why = falls
        raise ConstructionError(why, parts=[body])


def _require_room(problem: ConstructionProblem) -> None:
    """Check that a held part can come as near to others as its place is.

    What touches a part in its place is left out, up to NEAR: it may be touched.
    """
    cell, least = problem.cell, problem.cell.clearances.robot_object
    fixed = standing_fixtures(cell)
    there: dict[str, PlacedObject] = {}
    for part in problem.parts:
        placed = (problem.object(part), part.goal)
        for other, gap in nearby_entities(placed, {**fixed, **there}, least).items():
            if NEAR < gap < least:
                raise ConstructionError(
                    f"{part.name} and {other} lie {gap * 1e3:.1f} mm apart where they belong, and "
                    f"a part in hand keeps {least * 1e3:.1f} mm from all that it does not touch: "
                    "make the joint wider, or the clearance of robots to objects smaller",
                    parts=[part.name],
                )
        there[part.name] = placed


def _require_way_in(problem: ConstructionProblem) -> None:
    """Check that a part is clear of all fixtures at the start of its straight insertion path."""
    cell = problem.cell
    least = cell.clearances.robot_object + _CLEAR
    fixed = standing_fixtures(cell)
    for part in problem.parts:
        before = translation(*(-problem.approach * part.insertion)) @ part.goal
        for other in nearby_entities((problem.object(part), before), fixed, least):
            x, y, z = part.insertion
            raise ConstructionError(
                f"{part.name} goes into its place along ({x:.2f}, {y:.2f}, {z:.2f}), from "
                f"{problem.approach:.3g} m away, where it touches {other}: give it another "
                "insertion, or change approach_m",
                parts=[part.name],
            )


def require_free_supply(problem: ConstructionProblem) -> None:
    """Check that nothing overlaps at the start.

    Raises:
        ConstructionError: names the two things that do.
    """
    cell = problem.cell
    placed: dict[str, PlacedObject] = {
        item.name: (item, item.start) for item in cell.objects if not item.later
    }
    fixed = standing_fixtures(cell)
    before: dict[str, PlacedObject] = {}
    for name, item in placed.items():
        deep = Overlaps().is_too_deep(name, item, {**fixed, **before})
        for other, depth in deep.items():
            raise ConstructionError(
                f"{name} and {other} overlap by {depth * 1e3:.3g} mm at the start: change "
                "the supply's layout",
                parts=[name],
                at_start=True,
            )
        before[name] = item
    for robot in cell.robots:
        contact = SceneChecker(
            cell, robot.name, cell.start_state(), frozenset()
        ).contact(robot.home)
        if contact is not None:
            raise ConstructionError(
                f"{robot.name} cannot stand at HOME at the start: {contact}",
                parts=[name for name in (contact.obstacle,) if name in placed],
                at_start=True,
            )
