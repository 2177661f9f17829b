"""Import of the STEP file of an assembly: what is read, the cell around it, and the scenario that is written."""

from __future__ import annotations

import json
import re
import shutil
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from planning.cad.layout import Layout, Lying, PartToLay, lay_out, least_opening
from planning.cad.part_types import PartType, Placed, unique_names, with_unique_names
from planning.cad.step_file import read_assembly
from planning.cad.table import Area, Table, best_place, find_table
from planning.cell.shape import Shape
from planning.cell.workcell import Fixture
from planning.contacts.interference import ROUNDING, overlap_depth
from planning.contacts.touching import PlacedObject, nearby_entities
from planning.errors import OutputError, RequestError, ShapeError
from planning.grips.grip import GripRules
from planning.transforms import Array, Transform, identity, translation
from twin.cad.base_cell import (
    OPENINGS_M,
    SLACK_M,
    cell_like,
    default_cell,
    fixture_names,
    open_fingers,
)
from twin.cad.cell_content import (
    PartEntry,
    colour_of,
    part_content,
    pose_content,
    shape_content,
    stand_content,
    write_mesh,
)
from twin.cad.part_order import Group, ordered_groups
from twin.checks.check import CheckReport, check_scenario
from twin.checks.finding import CheckContext
from twin.document.yaml_text import scenario_text
from twin.host.atomic_files import write_text
from twin.kinds.parts.checks.context import ordered_parts
from twin.planning.shapes import build_shape
from twin.reading.scenario_file import parse_scenario
from twin.scenario.sections.shapes import ShapedSection

DENSITY = 7850.0
"""Density of bodies for which none is given: that of steel [kg/m^3]."""

_FROM_ASSEMBLY = 0.1
"""Room for hands around the assembly [m]."""

_FILLED, _FINE = 0.001, 0.0005
"""Where pieces of a mesh are deeper than the first in a part that is in a hollow of it, they may be so by the second [m]."""

UPS: Mapping[str, Transform] = {
    "z": np.eye(4),
    "-z": np.diag([1.0, -1.0, -1.0, 1.0]),
    "y": np.array([[1.0, 0, 0, 0], [0, 0, -1, 0], [0, 1, 0, 0], [0, 0, 0, 1]]),
    "-y": np.array([[1.0, 0, 0, 0], [0, 0, 1, 0], [0, -1, 0, 0], [0, 0, 0, 1]]),
    "x": np.array([[0.0, 0, -1, 0], [0, 1, 0, 0], [1, 0, 0, 0], [0, 0, 0, 1]]),
    "-x": np.array([[0.0, 0, 1, 0], [0, 1, 0, 0], [-1, 0, 0, 0], [0, 0, 0, 1]]),
}
"""Turns of an assembly, by the axis of its file that points up."""


@dataclass(frozen=True)
class Wishes:
    """Options of an import.

    Attributes:
        base: name of the body that the others are put on; None for the heaviest.
        at: where the middle of the base comes to lie, and the lowest point of the assembly [m]; None to choose.
        up: axis of the file that points up, a key of ``UPS``.
        like: scenario whose cell is taken; None for two arms.
        density: of all bodies [kg/m^3].
        densities: of bodies by name.
        picture: folder for the picture of bodies that hold each other; None for none.
    """

    base: str | None = None
    at: tuple[float, float, float] | None = None
    up: str = "z"
    like: Path | None = None
    density: float = DENSITY
    densities: Mapping[str, float] = field(default_factory=dict)
    picture: Path | None = None


@dataclass(frozen=True, eq=False)
class ImportedAssembly:
    """The base, parts in the order of the steps, notes on what was left out or assumed, and the check of the scenario."""

    base: Placed
    entries: tuple[PartEntry, ...]
    notes: list[str]
    report: CheckReport


def import_step_file(file: Path, output: Path, wishes: Wishes) -> ImportedAssembly:
    """Write the scenario of an assembly, and the meshes of its parts beside it.

    Raises:
        RequestError: the file or an option cannot be used.
        ScenarioError: the cell of another scenario cannot be used.
    """
    writer = _Writer(file, output, wishes)
    try:
        content, entries = writer.content()
        text = scenario_text(content, f"Imported from {file.name}.")
        scenario, document = parse_scenario(output, text)
        write_text(output, text)
    except BaseException:
        writer.remove_meshes()
        raise
    report = check_scenario(scenario, document, output.parent)
    return ImportedAssembly(writer.base, entries, writer.notes, report)


class _Writer:
    """Writer of the scenario of one assembly, see ``import_step_file``."""

    def __init__(self, file: Path, output: Path, wishes: Wishes) -> None:
        types, self.notes = read_assembly(file)
        self._cell: dict[str, Any] = {}
        self._grips: dict[str, Any] | None = None
        if wishes.like is None:
            self._cell = default_cell()
        else:
            self._cell, self._grips = cell_like(wishes.like, output)
        types = with_unique_names(types, fixture_names(self._cell))
        self._file, self._output, self._types = file, output, types
        self._wishes, self._turn = wishes, UPS[wishes.up]
        self._kinds = {own.name: kind for kind in types for own in kind.placed}
        self._placed = {own.name: own for kind in types for own in kind.placed}
        given = wishes.densities
        self._densities = {
            name: given.get(name, given.get(kind.name, wishes.density))
            for name, kind in self._kinds.items()
        }
        base = wishes.base
        if base is None:
            masses = {n: self._densities[n] * k.volume for n, k in self._kinds.items()}
            base = max(masses, key=lambda name: masses[name])
        if base not in self._placed:
            raise RequestError(f"{file}: no body {base!r}", choices=tuple(self._placed))
        self.base = self._placed[base]
        self._folder = output.parent / f"{output.stem}_parts"
        self._created = not self._folder.exists()
        self._written: list[Path] = []
        self._shapes = {own.name: self._shape(own) for own in types}

    def content(self) -> tuple[dict[str, Any], tuple[PartEntry, ...]]:
        """Return the content of the scenario, and its parts."""
        kind = self._kinds[self.base.name]
        fixture = {"name": self.base.name, **self._shapes[kind.name]}
        fixture["colour"] = colour_of(kind, self._types.index(kind))
        self._cell.setdefault("fixtures", []).append(fixture)
        # Shapes and robots do not depend on where things are, and take time to build.
        fixture["pose"] = pose_content(self.base.pose)
        groups = ordered_groups(
            self._types,
            self.base,
            self._turn,
            self._densities,
            self._file,
            self._wishes.picture,
        )
        entries = self._entries(groups, identity())
        self._refine_bores()
        if self._grips is None:
            self._grips = open_fingers(self._cell, self._opening(entries))
        provisional = Layout({own.name: list(own.goals) for own in entries})
        text = scenario_text(self._scenario(entries, provisional, ()), "")
        scenario, _ = parse_scenario(self._output, text)
        context = CheckContext(scenario, self._output.parent)
        table = find_table(context.built, self.base.name)
        place = self._assembly_pose(table, context)
        fixture["pose"] = pose_content(place @ self.base.pose)
        entries = self._entries(groups, place)
        layout = self._layout(context, entries, table, place)
        self._cell["fixtures"] += [
            stand_content(own.name, layout, table.top)
            for own in entries
            if layout.lying[own.name].stand
        ]
        presses = self._presses(context)
        self.notes += layout.notes
        return self._scenario(entries, layout, presses), entries

    def remove_meshes(self) -> None:
        """Remove the mesh files."""
        for path in self._written:
            path.unlink(missing_ok=True)
        if self._created and self._folder.is_dir():
            shutil.rmtree(self._folder, ignore_errors=True)

    def _shape(self, kind: PartType) -> dict[str, Any]:
        """Return the shape of a type, whose mesh is written if it has one."""
        path = self._folder / f"{kind.name}.stl"
        if kind.form is None:
            try:
                self._folder.mkdir(parents=True, exist_ok=True)
            except OSError as error:
                raise OutputError(f"{self._folder}: {error.strerror}") from None
            write_mesh(kind, path)
            self._written.append(path)
        return shape_content(kind, f"{self._folder.name}/{path.name}")

    def _scenario(
        self,
        entries: Sequence[PartEntry],
        layout: Layout,
        presses: Sequence[dict[str, Any]],
    ) -> dict[str, Any]:
        numbers = {own.name: k for k, own in enumerate(self._types)}
        assembly: dict[str, Any] = {"kind": "assembly"}
        if self._grips:
            assembly["grips"] = self._grips
        assembly["parts"] = []
        for own in entries:
            kind, starts = own.type.name, layout.starts[own.name]
            rules = self._own_grips(layout.lying.get(own.name))
            part = part_content(own, self._shapes[kind], starts, numbers[kind], rules)
            assembly["parts"].append(part)
        assembly["steps"] = [own.name for own in entries]
        if presses:
            assembly["fits"] = list(presses)
        name = re.sub(r"[^A-Za-z0-9_.-]", "_", self._file.stem)[:60]
        if not re.match(r"[A-Za-z]", name) or name.lower() in ("true", "false", "null"):
            name = f"assembly_{name}"
        about = {"version": 1, "name": name, "seed": 0}
        # Written and read again, as YAML would refer to what is there twice.
        whole = {**about, "cell": self._cell, "assembly": assembly}
        return dict(json.loads(json.dumps(whole)))

    def _build(self, kind: PartType) -> Shape:
        """Return the shape of a type, as planning has it."""
        section = ShapedSection.model_validate_json(json.dumps(self._shapes[kind.name]))
        return build_shape(kind.name, section.described, self._output.parent)

    def _refine_bores(self) -> None:
        """Have meshes cut finer whose convex pieces fill the hollows in which other parts are."""
        placed: dict[str, PlacedObject] = {
            name: (Fixture(name, self._build(self._kinds[name]), own.pose), own.pose)
            for name, own in self._placed.items()
        }
        fine: dict[str, PartType] = {}
        for other, name, gap in _meeting(placed):
            deep = gap < -_FILLED
            if deep and overlap_depth(placed[name], placed[other]) <= ROUNDING:
                found = (self._kinds[name], self._kinds[other])
                fine |= {kind.name: kind for kind in found if kind.is_milled}
        for kind in fine.values():
            self._shapes[kind.name]["shape"]["within_m"] = _FINE
            try:
                self._build(kind)
            except ShapeError:  # too many pieces
                del self._shapes[kind.name]["shape"]["within_m"]

    def _own_grips(self, lying: Lying | None) -> dict[str, float]:
        """Return the rules for grips on a part that are others than those of the assembly."""
        if lying is None or lying.rules is None:
            return {}
        usual = {"depth_m": GripRules().depth, "opening_m": GripRules().opening}
        usual |= self._grips or {}
        own = {"depth_m": lying.rules.depth, "opening_m": lying.rules.opening}
        return {key: value for key, value in own.items() if value != usual[key]}

    def _opening(self, entries: Sequence[PartEntry]) -> float:
        """Return how far fingers must be apart [m]."""
        parts = [(self._build(own.type), self._turn @ own.goals[0]) for own in entries]
        wide = [opening - SLACK_M for opening in OPENINGS_M]
        return least_opening(parts, GripRules(), wide) + SLACK_M

    def _bounds(self, pose: Transform, bodies: Iterable[Placed]) -> tuple[Array, Array]:
        """Return the corners of the box around bodies of the assembly at a pose [m]."""
        points = np.vstack([own.vertices @ pose[:3, :3].T for own in bodies])
        points += pose[:3, 3]
        return points.min(axis=0), points.max(axis=0)

    def _assembly_pose(self, table: Table, context: CheckContext) -> Transform:
        """Return the pose of the assembly's frame in the world."""
        low, high = self._bounds(self._turn, self._placed.values())
        first, last = self._bounds(self._turn, [self.base])
        middle = np.array([*(0.5 * (first + last))[:2], low[2]])
        at = self._wishes.at
        if at is None:
            area = Area(low[:2] - middle[:2], high[:2] - middle[:2])
            bases = [robot.base[:2, 3] for robot in context.built.robots]
            found = best_place(table, area, bases)
            if found is None:
                size = " x ".join(f"{v * 1e3:.0f}" for v in (high - low)[:2])
                words = f"which is {size} mm seen from above: say --at X,Y,Z"
                raise RequestError(
                    f"{self._file}: the table has no room for the assembly, {words}"
                )
            at = (*found, table.top)
        return translation(*(np.array(at) - middle)) @ self._turn

    def _entries(
        self, groups: Sequence[Group], place: Transform
    ) -> tuple[PartEntry, ...]:
        """Return the parts of the scenario, in the order of their steps."""
        kinds = [kind.name for kind, *_ in groups]
        names = unique_names(kinds, fixture_names(self._cell))
        out = []
        for name, (kind, placed, insert, length) in zip(names, groups, strict=True):
            goals = tuple(place @ own.pose for own in placed)
            density = self._densities[placed[0].name]
            out.append(PartEntry(name, kind, goals, insert, length, density))
        return tuple(out)

    def _layout(
        self,
        context: CheckContext,
        entries: Sequence[PartEntry],
        table: Table,
        place: Transform,
    ) -> Layout:
        """Return where the parts lie at the start."""
        listed = ordered_parts(context).listed
        low, high = self._bounds(place, self._placed.values())
        obstacles = [*table.obstacles, (Area(low[:2], high[:2]), _FROM_ASSEMBLY)]
        table = replace(table, obstacles=obstacles, middle=0.5 * (low + high)[:2])
        parts, pose = [], place @ self.base.pose
        there = {
            name: (item, pose) for name, (item, _) in self._standing(context).items()
        }
        for own in entries:
            name = own.name if len(own.goals) == 1 else f"{own.name}.1"
            item, handling = context.built.object(name), listed.handling(name)
            parts.append(PartToLay(own.name, item, own.goals, handling, dict(there)))
            there |= {f"{name}/{k}": (item, goal) for k, goal in enumerate(own.goals)}
        try:
            return lay_out(parts, context.cell.robots, listed.frame, table)
        except ValueError as error:
            words = f"the table has no room left for {error}"
            raise RequestError(f"{self._file}: {words}") from None

    def _standing(self, context: CheckContext) -> dict[str, PlacedObject]:
        """Return the base of the assembly, as it stands in a cell."""
        return {
            item.name: (item, item.pose)
            for item in context.built.fixtures
            if item.name == self.base.name
        }

    def _presses(self, context: CheckContext) -> list[dict[str, Any]]:
        """Return the pairs of parts that are in each other in their places, as ``fits``."""
        placed = self._standing(context)
        for name, pose in ordered_parts(context).listed.goals.items():
            placed[name] = context.built.object(name), pose
        deepest: dict[tuple[str, str], float] = {}
        for other, name, _ in _meeting(placed):
            deep = overlap_depth(placed[name], placed[other])
            if deep > ROUNDING:
                pair = _entry_name(other), _entry_name(name)
                deepest[pair] = max(deepest.get(pair, 0.0), deep)
        return [
            {"parts": list(pair), "press_m": round(deep + 5e-7, 6)}
            for pair, deep in deepest.items()
        ]


def _meeting(placed: Mapping[str, PlacedObject]) -> Iterator[tuple[str, str, float]]:
    """Yield pairs whose convex pieces meet, the earlier first, and the gap of these [m]."""
    before: dict[str, PlacedObject] = {}
    for name, own in placed.items():
        for other, gap in nearby_entities(own, before, 0.0).items():
            yield other, name, gap
        before[name] = own


def _entry_name(name: str) -> str:
    """Return the name in the file of a part, which may be one of several that are alike."""
    entry, _, number = name.rpartition(".")
    return entry if entry and number.isdigit() else name
