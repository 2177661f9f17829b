"""Checks of a construction problem that need no search: everything known to be wrong at once."""

from __future__ import annotations

from planning.construction.problem.bounds import ReachBounds, require_reach
from planning.construction.problem.part_graph import MOST_OVERLAP
from planning.construction.problem.problem import ConstructionProblem
from planning.errors import ConstructionError
from planning.geometry.scene import SceneChecker
from planning.pick_place.contact_graph import Lying, near_to
from planning.workcell import start_state


def require_buildable(problem: ConstructionProblem) -> ReachBounds:
    """Check what a lower bound can show to be impossible; return who reaches what.

    Goal poses that overlap are found where the part graph is built.

    Raises:
        ConstructionError: a part that nothing connects to the ground, parts that overlap in
            the supply, robots that stand in something, or parts that the team cannot bring to
            their places.
    """
    require_grounded(problem)
    require_free_supply(problem)
    bounds = ReachBounds(problem)
    require_reach(bounds)
    return bounds


def require_grounded(problem: ConstructionProblem) -> None:
    """Check that every part stands on the ground, or on parts that do.

    Raises:
        ConstructionError: names the parts that hang in the air.
    """
    floating = problem.graph.floating()
    if floating:
        shown = ", ".join(floating[:6])
        more = f" and {len(floating) - 6} more" if len(floating) > 6 else ""
        raise ConstructionError(
            f"nothing connects {shown}{more} to the ground: every part must touch a fixture, or "
            "a part that is connected to one"
        )


def require_free_supply(problem: ConstructionProblem) -> None:
    """Check that nothing overlaps at the start.

    Raises:
        ConstructionError: names the two things that do.
    """
    cell = problem.cell
    lying: dict[str, Lying] = {
        item.name: (item, item.start) for item in cell.objects if not item.later
    }
    fixed: dict[str, Lying] = {item.name: (item, item.pose) for item in cell.fixtures}
    before: dict[str, Lying] = {}
    for name, item in lying.items():
        for other, gap in near_to(item, {**fixed, **before}, 0.0).items():
            if gap < -MOST_OVERLAP:
                raise ConstructionError(
                    f"{name} and {other} overlap by {-gap * 1e3:.0f} mm at the start: change "
                    "the supply's layout"
                )
        before[name] = item
    for robot in cell.robots:
        contact = SceneChecker(
            cell, robot.name, start_state(cell), frozenset()
        ).contact(robot.home)
        if contact is not None:
            raise ConstructionError(
                f"{robot.name} cannot stand at HOME at the start: {contact}"
            )
