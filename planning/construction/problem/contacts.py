"""Contacts of parts: what each touches at the start and in its place, and pads that hold it."""

from __future__ import annotations

from planning.construction.problem.problem import ConstructionProblem, Part
from planning.geometry.robot_bodies import entity
from planning.parts.contact_graph import Lying, near_to, standing

NEAR = 0.002
"""Things this near to each other touch [m]: rounding, and the margin that planning keeps."""

Pairs = frozenset[frozenset[str]]


class PartContacts:
    """The contacts of every part at the start and in its place, found once."""

    def __init__(self, problem: ConstructionProblem) -> None:
        cell = problem.cell
        fixed = standing(cell)
        starts: dict[str, Lying] = {o.name: (o, o.start) for o in cell.objects}
        parts = {p.name: p for p in problem.parts}
        goals: dict[str, Lying] = {
            name: (cell.object(name), part.goal) for name, part in parts.items()
        }
        still = {n: lying for n, lying in starts.items() if n not in parts}
        # What lies on a part has been taken before it: from then on it is in somebody's hand.
        covers = problem.graph.covers
        self._start = {
            name: _touching(
                name,
                starts,
                {k: v for k, v in starts.items() if k not in covers.get(name, ())}
                | fixed,
            )
            for name in parts
        }
        self._goal = {
            name: _touching(name, goals, goals | still | fixed) for name in parts
        }

    def at_start(self, part: Part) -> Pairs:
        """Return the pairs of a part and what it touches in the supply when it is taken."""
        return self._start[part.name]

    def at_goal(self, part: Part) -> Pairs:
        """Return the pairs of a part and what it touches in its place."""
        return self._goal[part.name]


def held_by(robot: str, part: Part) -> Pairs:
    """Return the contact of a robot's pad with the part that it handles."""
    return frozenset({frozenset((entity(robot, "tool"), part.name))})


def _touching(name: str, lying: dict[str, Lying], others: dict[str, Lying]) -> Pairs:
    rest = {key: value for key, value in others.items() if key != name}
    return frozenset(frozenset((name, key)) for key in near_to(lying[name], rest, NEAR))
