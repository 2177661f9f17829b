"""What is known of ways past things that stand, whichever plan they were found for.

A way depends on what moves, from where to where, and on what stands around, by shape and place;
which objects these are, and at which step of which plan, does not matter. A straight way, and a
skill, stays as it is wherever all that stands has been found to be clear of it; what was found by a
search holds where just the same stands around.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable
from dataclasses import dataclass, field

from planning.errors import TransitError
from planning.kept_answers import KeptAnswers
from planning.motion.known_scenes import KnownScenes, Scene
from planning.transforms import Array

Way = tuple[Array, Array]
"""Waypoints, and the times at which they are passed, from 0 [s]."""

_MOST = 20_000
"""Ways that are kept; all are forgotten when there are more."""


@dataclass(frozen=True)
class FoundWay:
    """A way, and whether it stays the same whatever else is clear of it."""

    way: Way
    plain: bool


@dataclass(frozen=True)
class _ClearWay:
    """A way that asks for nothing but to be clear, and all that was found to be clear of it."""

    way: Way
    of: int


@dataclass(frozen=True)
class KnownMotions:
    """Ways that were found for plans of one cell with the same settings.

    Attributes:
        scenes: what they lead through.
    """

    scenes: KnownScenes = field(default_factory=KnownScenes)
    _clear: dict[Hashable, _ClearWay] = field(default_factory=dict)
    _found: KeptAnswers[Way | str] = field(default_factory=lambda: KeptAnswers(_MOST))

    def way(
        self,
        moving: Hashable,
        scene: Scene,
        seed: int,
        work_out: Callable[[], FoundWay],
    ) -> Way:
        """Return a way, worked out unless it is known.

        Args:
            moving: what moves, and through what.
            scene: what it moves amid.
            seed: of the search for it.
            work_out: finds it.

        Raises:
            TransitError: there is none, or none was found in this scene before.
        """
        alike = moving, scene.amid
        clear = self._clear.get(alike)
        if clear is not None and scene.is_within(clear.of):
            return clear.way

        def ask() -> Way | str:
            try:
                found = work_out()
            except TransitError as error:
                return str(error)
            if found.plain:
                self._note_clear(alike, found.way, scene.standing)
            return found.way

        known = self._found.get((moving, scene, seed), ask)
        if isinstance(known, str):
            raise TransitError(known)
        return known

    def _note_clear(self, alike: Hashable, way: Way, of: int) -> None:
        known = self._clear.get(alike)
        if known is None and len(self._clear) >= _MOST:
            self._clear.clear()
        self._clear[alike] = _ClearWay(way, of if known is None else known.of | of)
