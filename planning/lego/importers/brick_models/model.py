"""A brick model from a file of another program: bricks on the stud grid, each with its line number in the file."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from planning.errors import ScenarioError, format_faults, format_names
from planning.files import read_file
from planning.lego.bricks.assembly import BrickType, Cell, GridPlace, OnGrid
from planning.lego.bricks.grid import bricks_joined_to_plate

MOST_BRICKS = 20_000
"""Greatest number of bricks in a model."""

_REASONABLE = 100_000
"""Greatest extent of a model; a larger one is taken for an error in the file [studs or levels]."""


@dataclass(frozen=True)
class ModelBrick(OnGrid):
    """A brick of a model.

    Attributes:
        brick: its type.
        cell: where it is; the least x, y and level of a whole model are 0.
        source: where it stands in the file, such as ``"line 12"``.
        colour: red, green and blue, None where the file gives none.
    """

    brick: BrickType
    cell: Cell
    source: str
    colour: tuple[int, int, int] | None = None

    @property
    def words(self) -> str:
        """Source and type, such as ``"line 12 (2x4)"``."""
        return f"{self.source} ({self.brick.name})"


@dataclass(frozen=True)
class BrickModel:
    """A brick model, moved to the corner of the grid and down to its plate.

    Attributes:
        bricks: in the order of the file.
        notes: what was not imported, a line each.
    """

    bricks: tuple[ModelBrick, ...]
    notes: tuple[str, ...] = ()

    @property
    def size(self) -> tuple[int, int, int]:
        """Studs along x and y, and levels."""
        spans = [item.span for item in self.bricks]
        return (
            max(s.x1 for s in spans),
            max(s.y1 for s in spans),
            max(s.top for s in spans),
        )

    def quarter_turned(self) -> BrickModel:
        """Return the model turned by +90 degrees about the vertical."""
        deep = self.size[1]
        bricks = []
        for item in self.bricks:
            span = item.span
            turned = not item.cell.turned and item.brick.studs[0] != item.brick.studs[1]
            cell = replace(item.cell, x=deep - span.y1, y=span.x0, turned=turned)
            bricks.append(replace(item, cell=cell))
        return replace(self, bricks=tuple(bricks))

    @property
    def kinds(self) -> Counter[BrickType]:
        """Number of bricks of each type."""
        return Counter(item.brick for item in self.bricks)


class FileFaults:
    """Faults of a file, each at its line, reported together.

    Args:
        path: the file.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._faults: list[tuple[int, str]] = []

    def add(self, line: int, message: str) -> None:
        """Note a fault at a line, counted from 1."""
        self._faults.append((line, message))

    def check(self, *, choices: Sequence[str] = (), form: str = "") -> None:
        """Raise an error where there are faults, with valid alternatives or the expected form of a line.

        Raises:
            ScenarioError: names the first faults by line, and how many more there are.
        """
        if not self._faults:
            return
        lines = [f"{self._path}:{at}: {words}" for at, words in sorted(self._faults)]
        shown = format_faults(lines) + (f"\n{form}" if form else "")
        raise ScenarioError(shown, choices=tuple(choices))


def read_lines(path: Path) -> list[str]:
    """Return the lines of a text file of any usual encoding, without line ends.

    Raises:
        ScenarioError: it cannot be read, or is no text.
    """
    try:
        content = read_file(path)
    except IsADirectoryError:
        raise ScenarioError(f"{path}: this is a folder, a file is expected") from None
    except OSError as error:
        reason = error.strerror or str(error)
        raise ScenarioError(f"{path}: cannot be read: {reason}") from None
    if content.startswith(b"PK\x03\x04"):
        raise ScenarioError(
            f"{path}: this is an archive, such as Studio's .io: export the model as LDraw there"
        )
    wide = content.startswith((b"\xff\xfe", b"\xfe\xff"))
    try:
        text = content.decode("utf-16" if wide else "utf-8-sig")
    except UnicodeDecodeError:
        # Windows programs write names in their own code page.
        text = content.decode("utf-16" if wide else "cp1252", errors="replace")
    if "\x00" in text:
        raise ScenarioError(f"{path}: this is no text file")
    return text.replace("\r\n", "\n").replace("\r", "\n").split("\n")


def finish_model(
    path: Path, bricks: Sequence[ModelBrick], notes: Iterable[str] = ()
) -> BrickModel:
    """Return a model of bricks from any position on the grid, moved to its corner.

    Raises:
        ScenarioError: there are no bricks or too many, two are in one place, or some are
            joined to nothing that stands on the plate; names them.
    """
    if not bricks:
        raise ScenarioError(f"{path}: there are no bricks in it")
    if len(bricks) > MOST_BRICKS:
        raise ScenarioError(f"{path}: more than {MOST_BRICKS} bricks")
    spans = [item.span for item in bricks]
    low = [min(getattr(s, key) for s in spans) for key in ("x0", "y0", "bottom")]
    high = [max(getattr(s, key) for s in spans) for key in ("x1", "y1", "top")]
    if max(b - a for a, b in zip(low, high, strict=True)) > _REASONABLE:
        raise ScenarioError(
            f"{path}: the bricks are more than {_REASONABLE} studs apart"
        )
    moved = []
    for item, span in zip(bricks, spans, strict=True):
        at = span.x0 - low[0], span.y0 - low[1], span.bottom - low[2]
        cell = Cell.at_level(*at, turned=item.cell.turned)
        moved.append(replace(item, cell=cell))
    _check_places(path, moved)
    return BrickModel(tuple(moved), tuple(notes))


def _check_places(path: Path, bricks: Sequence[ModelBrick]) -> None:
    """Check that no two bricks overlap, and that all are connected to the plate."""
    taken: dict[GridPlace, ModelBrick] = {}
    overlaps: dict[tuple[str, str], None] = {}
    places = [item.places for item in bricks]
    for item, own in zip(bricks, places, strict=True):
        for place in sorted(own):
            other = taken.setdefault(place, item)
            if other is not item:
                overlaps.setdefault((other.words, item.words))
    if overlaps:
        pairs = [f"{a} and {b}" for a, b in overlaps]
        raise ScenarioError(f"{path}: in one place: {format_names(pairs)}")
    held = bricks_joined_to_plate(dict(enumerate(places)))
    loose = [item.words for k, item in enumerate(bricks) if k not in held]
    if loose:
        raise ScenarioError(
            f"{path}: joined to nothing that stands where the lowest brick stands: {format_names(loose)}"
        )
