"""Stability constraints of a construction: the parts that must be in place before each part.

Parts are held by friction on the parts that they touch, and by joints (``planning.statics``). If the supports of a
part, or one neighbour, carry its weight to the ground, the part may be placed at any time after these. Any other part
is checked when it is planned: it then depends on all parts that it needs, or it must be placed later. If a part would
fall at any time, the robot that places it may hold it until the next part is in place, if both are stable then.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping

from planning.contacts.precedence import PartGraph
from planning.statics.build_order import BuildStep, UnstableState, balance_dependencies
from planning.statics.standing import StabilityChecker
from planning.statics.standing_rules import Joint

_Placed = tuple[tuple[str, float], ...]
"""Parts in the order of planning, and when each is in place [s]."""


class SiteBalance:
    """Tells the prerequisites of a part, and whether it may be placed next.

    Args:
        graph: which parts touch each other and the ground.
        carried: whether a part waits for everything that it rests on.
        standing: knows the parts in their places, and joints; None if balance is not looked at.
    """

    def __init__(
        self, graph: PartGraph, *, carried: bool, standing: StabilityChecker | None
    ) -> None:
        self._graph, self._carried = graph, carried
        self.standing = standing
        self._known: dict[tuple[str, _Placed], frozenset[str] | UnstableState] = {}
        self._fell: set[str] = set()
        self._before: dict[_Placed, Mapping[str, frozenset[str]]] = {(): {}}

    def carriers(self, part: str) -> frozenset[str]:
        """Return the parts that are placed before a part in any order."""
        return self._graph.carriers[part] if self._carried else frozenset()

    def needs(
        self, part: str, placed: Mapping[str, float]
    ) -> frozenset[str] | UnstableState:
        """Return the prerequisites of a part for stability, or what would fall with it.

        Args:
            part: that comes next, as far as its contacts go.
            placed: when the parts planned before it are in place, in the order of planning [s].
        """
        key = part, tuple(placed.items())
        if key not in self._known:
            self._known[key] = found = self._look(part, key[1])
            if isinstance(found, UnstableState):
                self._fell.add(part)
        return self._known[key]

    def _look(self, part: str, placed: _Placed) -> frozenset[str] | UnstableState:
        choices = list(self._choices(part, dict(placed)))
        if self.standing is None:
            return choices[0]
        before, kept = self._waits(placed), self._kept(placed)
        if not placed or placed[-1][0] not in kept:
            for below in choices:
                there = self._closure(below, before, kept)
                if self._bears(self.standing, part, there):
                    lasts = {kept[name] for name in there & kept.keys()}
                    return below | {last for last in lasts if last is not None}
        found: frozenset[str] | UnstableState = frozenset()
        for below in choices:
            found = self._joint_prerequisites(
                self.standing, {**before, part: below}, kept
            )
            if not isinstance(found, UnstableState):
                break
        return found

    def _kept(self, placed: _Placed) -> dict[str, str | None]:
        """Return the part that is held because it would fall, and until which part; None for the next one."""
        names = [name for name, _ in placed]
        return {
            name: names[k + 1] if k + 1 < len(names) else None
            for k, name in enumerate(names)
            # A look-up takes time in proportion to the parts before; few parts ever fall.
            if name in self._fell
            and isinstance(self._known.get((name, placed[:k])), UnstableState)
        }

    def _closure(
        self,
        below: Collection[str],
        before: Mapping[str, frozenset[str]],
        kept: Mapping[str, str | None],
    ) -> set[str]:
        """Return all parts in place when some are, with their prerequisites, and none is held."""
        there, front = set[str](), list(below)
        while front:
            if (name := front.pop()) not in there:
                there.add(name)
                front += before.get(name, ())
                front += [last for last in (kept.get(name),) if last is not None]
        return there

    def _choices(
        self, part: str, placed: Mapping[str, float]
    ) -> Iterator[frozenset[str]]:
        """Yield candidate supports of a part: what it rests on; else the ground, or its first neighbours."""
        own = self.carriers(part)
        if own or part in self._graph.ground:
            yield own
            return
        near = sorted(self._graph.neighbours[part] & placed.keys())
        yield from (frozenset({n}) for n in sorted(near, key=placed.__getitem__))

    def _waits(self, placed: _Placed) -> Mapping[str, frozenset[str]]:
        """Return the prerequisites of each planned part, in their order."""
        if placed not in self._before:
            first, (last, _) = placed[:-1], placed[-1]
            found = self.needs(last, dict(first))
            own = self.carriers(last) if isinstance(found, UnstableState) else found
            self._before[placed] = {**self._waits(first), last: own}
        return self._before[placed]

    def _bears(
        self, standing: StabilityChecker, part: str, below: Collection[str]
    ) -> bool:
        """Tell whether the prerequisites of a part support it, whatever else is in place."""
        if not all(joint.is_unlimited for joint in standing.joints):
            return False  # the forces of all parts together may be too much
        there = {part, *below}
        falls = standing.falling(there, joints=standing.joints, weighing=[part])
        return falls is None

    def _joint_prerequisites(
        self,
        standing: StabilityChecker,
        before: Mapping[str, frozenset[str]],
        kept: Mapping[str, str | None],
    ) -> frozenset[str] | UnstableState:
        """Return the prerequisites of the last of some parts where its supports alone do not suffice."""
        number = {name: k for k, name in enumerate(before)}
        joins: list[list[Joint]] = [[] for _ in before]
        for joint in standing.joints:
            ends = [name for name in joint.ends if name in standing.bodies]
            if ends and number.keys() >= set(ends):
                joins[max(number[name] for name in ends)].append(joint)
        until = {name: number[last or list(number)[-1]] for name, last in kept.items()}
        steps = [
            BuildStep((n,), tuple(joins[k]), until.get(n)) for n, k in number.items()
        ]
        waits = {(number[a], number[b]) for b, own in before.items() for a in own}
        found = balance_dependencies(standing, steps, waits, keepable=())
        if isinstance(found, UnstableState):
            return found
        last, names = len(steps) - 1, list(number)
        return frozenset(names[a] for a, b in (waits | found.waits) if b == last)

    def held(self, placed: Mapping[str, float]) -> Iterator[tuple[str, str]]:
        """Yield parts that would fall and must be held, each with the part that comes next.

        Args:
            placed: see ``needs``.
        """
        for part in self._graph.placeable(placed, carried=self._carried):
            if isinstance(self.needs(part, placed), UnstableState):
                after = {**placed, part: max(placed.values(), default=0.0)}
                for last in self.placeable(after):
                    if part in self._graph.neighbours[last]:
                        yield part, last

    def ready(self, part: str, placed: Mapping[str, float]) -> frozenset[str]:
        """Return the prerequisites of a part, whether it is held or not; see ``needs``."""
        found = self.needs(part, placed)
        if isinstance(found, UnstableState):
            return next(self._choices(part, placed))
        return found

    def placeable(self, placed: Mapping[str, float]) -> tuple[str, ...]:
        """Return the parts that may be placed next, in the order of the graph.

        Args:
            placed: see ``needs``.
        """
        return tuple(
            part
            for part in self._graph.placeable(placed, carried=self._carried)
            if not isinstance(self.needs(part, placed), UnstableState)
        )

    def never_placeable(self) -> tuple[str, str] | None:
        """Return what would fall whenever some part is placed, and why; None if all can be placed."""
        placed: dict[str, float] = {}
        while ready := self.placeable(placed) or next(self.held(placed), ()):
            for part in ready[:1] if ready[0] in self.placeable(placed) else ready:
                placed[part] = float(len(placed))
        for part in self._graph.placeable(placed, carried=self._carried):
            found = self.needs(part, placed)
            if isinstance(found, UnstableState) and self.standing is not None:
                why = self._refusal(self.standing, part, found, placed)
                return found.body, why
        return None

    def _refusal(
        self,
        standing: StabilityChecker,
        part: str,
        fall: UnstableState,
        placed: Mapping[str, float],
    ) -> str:
        """Return in words what would fall with a part in place, and what would help."""
        there = {part, *placed}
        text = (
            f"{fall.body} would not stand once {part} is in place, after all that can come"
            f" before: {standing.why(fall.body, there)}"
        )
        near = standing.touched_by(fall.body) | self._graph.ground.get(
            fall.body, frozenset()
        )
        on = sorted(near - (standing.bodies.keys() - there))
        on = on or sorted(self._graph.neighbours[fall.body] & there)
        pair = f"[{on[0]}, {fall.body}]" if on else ""
        return f"{text}; join it to what is there (joined: [{pair}])" if on else text
