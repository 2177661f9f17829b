"""Which states of an assembly stand by themselves, and what has to be held in the others."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass

import networkx as nx
import numpy as np

from planning.disassembly.body import AssemblyBody
from planning.disassembly.surface_contacts import Patches
from planning.statics.build_order import BuildStep, StableBuild, balance_dependencies
from planning.statics.contact_patch import ContactPatch
from planning.statics.standing import PlacedBody, StabilityChecker
from planning.statics.standing_rules import Joint, StandingRules
from planning.transforms import Array, identity


@dataclass(frozen=True)
class BodyHold:
    """A body that falls unless a hand or a fixture holds it.

    Attributes:
        body: its name.
        since: number of the step that inserts it, from 0.
        until: number of the step once which is complete it stands by itself; None where it never does.
    """

    body: str
    since: int
    until: int | None


class StandingStates:
    """Statics of some bodies of an assembly, one of which is the ground.

    Args:
        bodies: all of them.
        patches: their contacts, and maybe those of others.
        base: name of the one that does not move.
        frame: rotation of the frame of the assembly such that its third axis is up, shape (3, 3).
        rules: friction and tilt.
    """

    def __init__(
        self,
        bodies: Iterable[AssemblyBody],
        patches: Patches,
        base: str,
        frame: Array,
        rules: StandingRules,
    ) -> None:
        placed = {body.name: _placed(body, frame) for body in bodies}
        contacts = {}
        for pair, own in patches.items():
            if placed.keys() >= {*pair}:
                # The second is a body that moves.
                turn, pair = (-frame, pair[::-1]) if pair[1] == base else (frame, pair)
                contacts[pair] = tuple(
                    ContactPatch(p.points @ frame.T, turn @ p.normal, p.gap)
                    for p in own
                )
        ground = {base: placed.pop(base)}
        self._checker = StabilityChecker(placed, ground, rules, contacts)
        self._touching = self._checker.touching()
        self._base = base

    def falling(self, there: Collection[str]) -> int:
        """Return how many bodies have to be held in a state, given the names of those that are in place."""
        return len(self._fallers(there, ()))

    def _fallers(self, there: Collection[str], held: Collection[str]) -> list[str]:
        present = set(there) - {self._base}
        found: list[str] = []
        # Bodies that no contacts connect but through the base stand or fall by themselves.
        for part in nx.connected_components(self._touching.subgraph(present)):
            own = sorted(part)
            needed = [name for name in held if name in part]
            while (name := self._checker.falling(own, held=needed)) is not None:
                needed.append(name)
                found.append(name)
        return found

    def holds(self, groups: Sequence[tuple[str, ...]]) -> tuple[BodyHold, ...]:
        """Return what has to be held while bodies are inserted in an order, given those of each step."""
        there: list[str] = []
        since = {name: k for k, group in enumerate(groups) for name in group}
        held: dict[str, int] = {}
        done: list[BodyHold] = []
        for k, group in enumerate(groups):
            there += group
            for name in list(held):
                others = [other for other in held if other != name]
                if not self._fallers(there, others):
                    done.append(BodyHold(name, held.pop(name), k))
            held |= {name: since[name] for name in self._fallers(there, list(held))}
        done += [BodyHold(name, first, None) for name, first in held.items()]
        return tuple(sorted(done, key=lambda hold: (hold.since, hold.body)))

    def waits(
        self,
        groups: Sequence[tuple[str, ...]],
        waits: Collection[tuple[int, int]],
        holds: Sequence[BodyHold],
    ) -> set[tuple[int, int]]:
        """Return pairs of steps, the first before the second, with which every order stands as well.

        Given are the bodies of each step in an order that stands, pairs that are known, and what is held in it.
        """
        until: dict[int, int] = {}
        for hold in holds:
            if hold.until is not None:
                until[hold.since] = max(hold.until, until.get(hold.since, 0))
        # What never stands by itself is as good as joined to the base.
        fixed = {hold.body for hold in holds if hold.until is None}
        steps = [
            BuildStep(
                adds=group,
                joins=tuple(Joint(self._base, n) for n in group if n in fixed),
                until=until.get(k),
            )
            for k, group in enumerate(groups)
        ]
        found = balance_dependencies(self._checker, steps, waits, keepable=())
        if isinstance(found, StableBuild):
            return set(found.waits)
        return {(k, k + 1) for k in range(len(groups) - 1)}


def _placed(body: AssemblyBody, frame: Array) -> PlacedBody:
    mass = body.density_kg_m3 * abs(float(body.mesh.volume))
    centre = np.asarray(frame @ body.mesh.center_mass)
    return PlacedBody(body.name, (), identity(), mass, centre)
