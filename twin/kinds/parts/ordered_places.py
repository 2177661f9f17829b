"""Places of sources and pallets, in the order in which they are emptied and filled."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from planning.transforms import Array, Transform, read_only_copy, translation
from twin.kinds.parts.section import PartSection, PartsSection
from twin.kinds.parts.sources import SourceSection, StackSection, TraySection


@dataclass(frozen=True)
class OrderedPlaces:
    """Places that are emptied or filled one after another, and then again from the first.

    Attributes:
        poses: in the world; of a pallet, by which products are moved.
        words: what they are called, empty where there is one alone.
        begins: by index of its first place from 0, each source that they belong to, and how many are its own.
        stacked: whether parts lie on each other.
    """

    poses: tuple[Transform, ...]
    words: tuple[str, ...]
    begins: Mapping[int, tuple[str, int]]
    stacked: bool = False

    def brought(self, count: int) -> int:
        """Return how many parts come where a number is needed: what lies on others comes with all below."""
        if not self.stacked:
            return count
        last = (count - 1) % len(self.poses)
        ends = [begin + own for begin, (_, own) in self.begins.items()]
        return count - 1 - last + min(end for end in ends if end > last)


def source_places(section: PartsSection, part: PartSection) -> OrderedPlaces:
    """Return the places of the sources of a part: one source after another, in the order of removal."""
    poses: list[Transform] = []
    words: list[str] = []
    begins: dict[int, tuple[str, int]] = {}
    sources = [section.sources[name] for name in part.sources]
    stacked = any(
        isinstance(own, StackSection)
        or (isinstance(own, TraySection) and len(own.grid.counts) > 2)
        for own in sources
    )
    directions = np.array(part.take_out), -_tool_direction(section, part)
    for name in part.sources:
        found = _emptied(section.sources[name], directions)
        begins[len(poses)] = name, len(found)
        poses += [read_only_copy(pose) for pose, _ in found]
        words += [f"{own} of {name}" if own else "" for _, own in found]
    return OrderedPlaces(tuple(poses), tuple(words), begins, stacked)


def pallet_places(section: PartsSection) -> OrderedPlaces:
    """Return the places of a pallet in the order in which products fill it; one without a pallet."""
    grid = None if section.products is None else section.products.places
    if grid is None:
        return OrderedPlaces((translation(0.0, 0.0, 0.0),), ("",), {})
    placed = (part for part in section.parts if part.name in section.placed)
    first = next(placed, section.parts[0])
    directions = np.array(first.insert), _tool_direction(section, first)
    numbers, poses = grid.numbers(np.eye(4), directions), grid.by_number()
    words = tuple(f"{grid.words(k)} of products.places" for k in numbers)
    return OrderedPlaces(tuple(poses[k] for k in numbers), words, {})


def _tool_direction(section: PartsSection, part: PartSection) -> Array:
    """Return the direction in the world along which the tool points at a part, shape (3,)."""
    own = part.grips.directions if part.grips else None
    directions = np.array(own or section.grips.directions)
    lengths = np.linalg.norm(directions, axis=1, keepdims=True)
    return np.asarray((directions / lengths).sum(axis=0))


def _emptied(
    source: SourceSection, directions: tuple[Array, Array]
) -> list[tuple[Transform, str]]:
    """Return the poses of the parts of a full source in the order of removal, and what their places are called."""
    pose = source.pose.transform()
    if isinstance(source, TraySection):
        numbers = source.grid.numbers(pose, directions, emptied=True)
        inside = source.grid.by_number()
        return [(pose @ inside[k], source.grid.words(k)) for k in numbers]
    if isinstance(source, StackSection):
        pitch, count = source.pitch_m, range(source.count)
        down = [pose @ translation(0.0, 0.0, -k * pitch) for k in count]
        return [(at, f"number {k + 1} from above") for k, at in enumerate(down)]
    return [(pose, "")]
