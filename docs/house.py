"""Draw the rooms of the code, what they import, and the way of a scenario through them; measure its walls.

From the top of the repository: ``python docs/house.py`` writes ``docs/images/house.svg``, and the table
of rooms in ``docs/design.md``; another file for the picture, such as ``house.png``, may be named.
Everything but the stages of the way is read from the code.

``python docs/house.py --figures`` prints size and border of the core, and which walls are broken; wings are
declared in ``docs/house.toml``. ``--without WING`` deletes a wing in a copy, with those that need it, and runs
a scenario, ``twin --help`` and ``twin validate`` there; ``--without all`` does so for each.
"""

from __future__ import annotations

import argparse
import ast
import os
import shutil
import subprocess
import sys
import tomllib
from collections import Counter
from collections.abc import Callable, Iterable, Mapping
from itertools import pairwise
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple

import matplotlib as mpl
import networkx as nx
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Circle, FancyArrowPatch, FancyBboxPatch
from matplotlib.path import Path as Curve

ROOT = Path(__file__).resolve().parents[1]
PICTURE = ROOT / "docs" / "images" / "house.svg"
DESIGN = ROOT / "docs" / "design.md"
ROOMS = "<!-- rooms: python docs/house.py -->\n"
"""What stands before and after the table of rooms in the design."""
FLOORS = ("twin", "scheduling", "planning")
"""Packages from top to bottom: each imports those below."""
WINGS = ROOT / "docs" / "house.toml"
TRIED = "scenarios/multi_arm/multi_goal.yaml"
"""Scenario that runs without any wing."""
TRIED_SO = "planning.coordination=sequential"
VALIDATED = {
    "lego": "scenarios/lego/stairs.yaml",
    "assembly": "scenarios/assembly/magazine.yaml",
    "construction": "scenarios/construction/well.yaml",
}
"""Scenario of each kind of assembly in a wing."""

WAY = {
    "read_scenario": "read and check the file",
    "plan_scenario": "go on, stage by stage, to a graph",
    "build_workcell": "make the cell",
    "assembly_kind": "find who could do which step, and how",
    "assign_steps": "choose who does what",
    "plan_motions_sequentially": "plan how everyone moves",
    "build_tpg": "find what must wait for what",
    "reorder_tasks": "put the tasks into a better order",
    "shorten_tpg": "take shortcuts past HOME",
    "run_plan_to_folder": "execute the plan once",
    "Simulator": "let robots run, stall and wait",
    "JsonlRecorder": "write each event as it happens",
    "RunAuditor": "replay and measure it",
    "summarize_run": "say what came of it",
}
"""Stages of ``twin run``, by the function or class that stands for each."""

WIDTH, HEIGHT, ROW, GAP = 2.1, 0.52, 0.92, 0.8
"""Width and height of boxes, and heights from level to level and between floors [inches]."""
LEFT, MIDDLE, RIGHT = 0.4, 5.9, 11.4
"""Limits of the boxes from left to right [inches]."""
COLOURS = {"twin": "#dbe7f5", "scheduling": "#fbe6cf", "planning": "#dcefdc"}


Point = tuple[float, float]


def modules() -> dict[str, ast.Module]:
    """Return every module of the packages by its dotted name."""
    return {
        ".".join(path.relative_to(ROOT).with_suffix("").parts): ast.parse(
            path.read_text(encoding="utf-8")
        )
        for package in FLOORS
        for path in sorted((ROOT / package).rglob("*.py"))
    }


def room_of(module: str) -> str:
    """Return the folder of a module, such as ``planning/cell``."""
    return module.rpartition(".")[0].replace(".", "/")


def imports(
    code: Mapping[str, ast.Module], place: Callable[[str], str] = room_of
) -> nx.DiGraph[str]:
    """Return the rooms, or other places of modules, and an arrow to each from those that import of it."""
    graph: nx.DiGraph[str] = nx.DiGraph()
    for name, tree in code.items():
        if not name.endswith("__init__") or tree.body[1:]:
            graph.add_node(place(name))
        for target in _targets(tree, code):
            if place(target) != place(name):
                graph.add_edge(place(name), place(target))
    return graph


def _targets(tree: ast.Module, code: Mapping[str, ast.Module]) -> Iterable[str]:
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom) and node.module and not node.level:
            for alias in node.names:
                for name in (
                    f"{node.module}.{alias.name}",
                    node.module,
                    f"{node.module}.__init__",
                ):
                    if name in code:
                        yield name
                        break
        elif isinstance(node, ast.Import):
            for alias in node.names:
                for name in (alias.name, f"{alias.name}.__init__"):
                    if name in code:
                        yield name


def lines_of(code: Iterable[str]) -> Counter[str]:
    """Return the lines of code, comments and docstrings of each room."""
    lines: Counter[str] = Counter()
    for name in code:
        path = ROOT / (name.replace(".", "/") + ".py")
        lines[room_of(name)] += len(path.read_text(encoding="utf-8").splitlines())
    return lines


def room_table(code: Mapping[str, ast.Module]) -> str:
    """Return the table of docs/design.md: rooms with modules, and the first sentences of their docstrings."""
    rows = ["| room | what is in it |", "|---|---|"]
    for room in sorted({room_of(name) for name in code if not _is_empty(code[name])}):
        said = ast.get_docstring(code[f"{room.replace('/', '.')}.__init__"]) or ""
        words = said.partition("\n\n")[0].replace("\n", " ").replace("``", "`")
        rows.append(f"| `{room}/` | {words.removesuffix('.')} |")
    return "\n".join(rows) + "\n"


def _is_empty(module: ast.Module) -> bool:
    """Return True for a module that is a docstring at most."""
    return len(module.body) <= 1


def without_circles(graph: nx.DiGraph[str]) -> nx.DiGraph[str]:
    """Return the rooms and arrows without one arrow of each circle."""
    found = nx.DiGraph(graph)
    while not nx.is_directed_acyclic_graph(found):
        found.remove_edge(*nx.find_cycle(found)[-1])
    return found


def floor_arrows(graph: nx.DiGraph[str]) -> list[tuple[str, str]]:
    """Return the arrows within floors without those that follow from others, and without circles."""
    out, graph = [], without_circles(graph)
    for floor in FLOORS:
        own = graph.subgraph(n for n in graph if n.split("/")[0] == floor)
        out += list(nx.transitive_reduction(own).edges)
    return sorted(out)


def way(code: Mapping[str, ast.Module]) -> list[tuple[str, str]]:
    """Return room and words of each stage of a scenario's way.

    Raises:
        LookupError: what stands for a stage is not in one place of the code.
    """
    places: dict[str, list[str]] = {}
    for name, tree in code.items():
        for node in tree.body:
            if isinstance(node, ast.FunctionDef | ast.ClassDef):
                places.setdefault(node.name, []).append(room_of(name))
    for stage in WAY:
        if len(places.get(stage, [])) != 1:
            raise LookupError(f"{stage} is in {places.get(stage, 'no file')}")
    return [(places[stage][0], words) for stage, words in WAY.items()]


class Wing(NamedTuple):
    """A part that the core runs without.

    Attributes:
        about: its purpose.
        places: folders and files, from the top of the repository.
        uses: names of wings that it may import.
        needs: those of them without which nothing of it works.
    """

    about: str
    places: tuple[str, ...]
    uses: tuple[str, ...]
    needs: tuple[str, ...] = ()


class Arrow(NamedTuple):
    """An import of a name.

    Attributes:
        source, target: modules, such as ``twin.runs.events``.
        name: what is imported of the target; empty for the whole module.
    """

    source: str
    target: str
    name: str


def wings() -> dict[str, Wing]:
    """Return the declared wings by name."""
    content = tomllib.loads(WINGS.read_text(encoding="utf-8"))
    return {
        name: Wing(
            row["about"],
            tuple(row["places"]),
            tuple(row["uses"]),
            tuple(row.get("needs", ())),
        )
        for name, row in content.items()
    }


def wing_of(module: str, declared: Mapping[str, Wing]) -> str:
    """Return the wing that a module is in; empty for the core."""
    path = module.removesuffix(".__init__").replace(".", "/")
    for name, wing in declared.items():
        for place in wing.places:
            if path == place.removesuffix(".py") or path.startswith(f"{place}/"):
                return name
    return ""


def top_room_of(module: str, declared: Mapping[str, Wing]) -> str:
    """Return the wing of a module, or the folder below ``twin``, ``scheduling`` or ``planning`` where it is."""
    path = module.removesuffix(".__init__").split(".")
    return wing_of(module, declared) or "/".join(path[:2])


def name_imports(code: Mapping[str, ast.Module]) -> list[Arrow]:
    """Return every import of the packages, at module and at function level."""
    found = []
    for source, tree in code.items():
        for node in ast.walk(tree):
            if isinstance(node, ast.ImportFrom) and node.module and not node.level:
                for alias in node.names:
                    whole = f"{node.module}.{alias.name}"
                    if whole in code or f"{whole}.__init__" in code:
                        found.append(Arrow(source, whole, ""))
                    elif node.module.partition(".")[0] in FLOORS:
                        found.append(Arrow(source, node.module, alias.name))
            elif isinstance(node, ast.Import):
                found += [
                    Arrow(source, alias.name, "")
                    for alias in node.names
                    if alias.name.partition(".")[0] in FLOORS
                ]
    return found


class Walls(NamedTuple):
    """What the imports of the code say of its walls.

    Attributes:
        core_lines: lines of the core.
        border: names of the core that wings use, as ``module.name``.
        core_to_wings: imports from the core into wings. The front door ``twin/__init__`` names them.
        undeclared: imports from a wing into one that it does not declare.
        circles: sets of rooms that import each other, wings and top-level folders of the core.
    """

    core_lines: int
    border: set[str]
    core_to_wings: list[Arrow]
    undeclared: list[Arrow]
    circles: list[set[str]]


def walls(code: Mapping[str, ast.Module], declared: Mapping[str, Wing]) -> Walls:
    """Return what the imports of the code say of its walls."""
    lines = sum(
        len((ROOT / f"{name.replace('.', '/')}.py").read_bytes().splitlines())
        for name in code
        if not wing_of(name, declared)
    )
    border: set[str] = set()
    inwards, undeclared = [], []
    rooms: nx.DiGraph[str] = nx.DiGraph()
    for arrow in name_imports(code):
        source, target = (
            wing_of(name, declared) for name in (arrow.source, arrow.target)
        )
        if arrow.source == "twin.__init__":
            continue
        if source and not target:
            border.add(f"{arrow.target}.{arrow.name}".rstrip("."))
        elif target and not source:
            inwards.append(arrow)
        elif source != target and target not in declared[source].uses:
            undeclared.append(arrow)
        one, other = (
            top_room_of(name, declared) for name in (arrow.source, arrow.target)
        )
        if one != other:
            rooms.add_edge(one, other)
    circles = [set(own) for own in nx.strongly_connected_components(rooms)]
    return Walls(
        lines, border, inwards, undeclared, [own for own in circles if len(own) > 1]
    )


def broken_walls(
    found: Walls, declared: Mapping[str, Wing]
) -> tuple[set[str], set[str]]:
    """Return arrows between rooms that no wall allows, and rooms in circles, as tests list them."""
    arrows = {
        f"{top_room_of(arrow.source, declared)} -> {top_room_of(arrow.target, declared)}"
        for arrow in (*found.core_to_wings, *found.undeclared)
    }
    return arrows, set().union(*found.circles)


def print_figures() -> None:
    """Print size and border of the core, and which walls are broken."""
    declared = wings()
    found = walls(modules(), declared)
    arrows, circles = broken_walls(found, declared)
    for text in (
        f"core: {found.core_lines:,} lines",
        f"border: {len(found.border)} names of the core in {len(declared)} wings",
        f"imports from the core into wings: {len(found.core_to_wings)}",
        *(f"    {a.source} -> {a.target} {a.name}" for a in found.core_to_wings),
        f"imports into wings that are not declared: {len(found.undeclared)}",
        *(f"    {a.source} -> {a.target} {a.name}" for a in found.undeclared),
        f"broken walls: {len(arrows)}",
        *(f'    "{arrow}",' for arrow in sorted(arrows)),
        f"rooms in circles: {len(circles)} in {len(found.circles)}",
        *(f'    "{room}",' for room in sorted(circles)),
    ):
        print(text)  # noqa: T201


def gone_without(wing: str, declared: Mapping[str, Wing]) -> list[str]:
    """Return a wing and those that need it, directly or by others, in the order of their declaration."""
    gone = {wing}
    while more := {n for n, own in declared.items() if gone & set(own.needs)} - gone:
        gone |= more
    return [name for name in declared if name in gone]


def fault_without(wing: str, folder: Path) -> str:
    """Delete a wing, and those that need it, in a copy; return what is wrong there, empty if nothing is.

    A scenario without wings runs, the commands of these wings are gone and no others, and scenarios of
    their kinds are refused while those of other kinds are valid.

    Args:
        wing: name of the wing.
        folder: where the copy is made anew. Kernels that are compiled there serve the next copy.
    """
    from twin.registry import COMMANDS, KINDS

    declared = wings()
    gone = gone_without(wing, declared)
    copy = folder / "copy"
    shutil.rmtree(copy, ignore_errors=True)
    for name in (*FLOORS, "scenarios"):
        ignored = shutil.ignore_patterns("__pycache__")
        shutil.copytree(ROOT / name, copy / name, ignore=ignored)
    for place in (place for name in gone for place in declared[name].places):
        path = copy / place
        shutil.rmtree(path) if path.is_dir() else path.unlink()
    options = ("--no-recording", "--no-audit", "--out", "run", "--set", TRIED_SO)
    done = _twin(copy, "run", TRIED, *options)
    if done.returncode != 0:
        return f"{TRIED} does not run: {_last_line(done)}"
    return _fault_of_commands(copy, set(COMMANDS.own), gone) or _fault_of_kinds(
        copy,
        {k: wing_of(KINDS.own[k].partition(":")[0], declared) for k in VALIDATED},
        gone,
    )


def _fault_of_commands(copy: Path, commands: set[str], gone: Iterable[str]) -> str:
    declared = wings()
    without = set().union(*(commands_of(name, declared) for name in gone))
    listed = _twin(copy, "--help")
    if listed.returncode != 0:
        return f"twin --help fails: {_last_line(listed)}"
    words = {line.split()[1] for line in listed.stdout.splitlines() if line[:2] == "│ "}
    if left := without & words:
        return f"{', '.join(sorted(left))} still in twin --help"
    if lost := commands - without - words:
        return f"{', '.join(sorted(lost))} not in twin --help"
    return ""


def _fault_of_kinds(copy: Path, kinds: Mapping[str, str], gone: Iterable[str]) -> str:
    there = [kind for kind, wing in kinds.items() if wing not in gone]
    done = _twin(copy, "validate", TRIED, *(VALIDATED[kind] for kind in there))
    if done.returncode != 0:
        return f"twin validate fails: {_last_line(done)}"
    for kind in kinds.keys() - there:
        done = _twin(copy, "validate", VALIDATED[kind])
        said = " ".join(done.stderr.split())
        valid = ", ".join(sorted(("goals", *there)))
        if (
            done.returncode != 2
            or f"unknown kind '{kind}'" not in said
            or f"(valid: {valid})" not in said
        ):
            return f"the kind {kind} is not refused as an unknown one: {said}"
    return ""


def commands_of(wing: str, declared: Mapping[str, Wing]) -> set[str]:
    """Return the names of the commands that a wing has."""
    from twin.registry import COMMANDS

    return {
        name
        for name, target in COMMANDS.own.items()
        if wing_of(target.partition(":")[0], declared) == wing
    }


def _twin(folder: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", "twin.cli", *arguments],
        check=False,
        cwd=folder,
        env={
            **os.environ,
            "COLUMNS": "200",
            "NUMBA_CACHE_DIR": str(folder.parent / "kernels"),
            "PYTHONPATH": str(folder),
        },
        capture_output=True,
        text=True,
    )


def _last_line(done: subprocess.CompletedProcess[str]) -> str:
    return (done.stderr.strip().splitlines() or [f"code {done.returncode}"])[-1]


def print_without(wing: str) -> bool:
    """Print for a wing, or ``all``, whether the rest runs without it; return whether it does."""
    declared = wings()
    names = list(declared) if wing == "all" else [wing]
    faults = {}
    with TemporaryDirectory() as folder:
        for name in names:
            faults[name] = fault_without(name, Path(folder))
            users = [own for own in gone_without(name, declared) if own != name]
            also = f" and its users {', '.join(users)}" if users else ""
            print(f"without {name}{also}: {faults[name] or 'passes'}", flush=True)  # noqa: T201
    passed = sum(not fault for fault in faults.values())
    print(f"{passed} of {len(names)} pass")  # noqa: T201
    return passed == len(names)


def _layout(
    graph: nx.DiGraph[str], arrows: list[tuple[str, str]]
) -> tuple[dict[str, Point], dict[tuple[str, str], list[Point]], dict[str, Point]]:
    """Return the middle of each room, the way of each arrow, bottom and top of each floor.

    A room is one level above the highest that it imports. Arrows go round rooms of the levels
    between by bends, which are laid out like rooms.
    """
    places: dict[str, Point] = {}
    routes: dict[tuple[str, str], list[Point]] = {}
    bands: dict[str, Point] = {}
    bottom = 0.2
    for floor in reversed(FLOORS):
        own = [(a, b) for a, b in arrows if a.split("/")[0] == floor]
        rooms: nx.DiGraph[str] = nx.DiGraph(own)
        rooms.add_nodes_from(n for n in graph if n.split("/")[0] == floor)
        levels = [
            sorted(level)
            for level in nx.topological_generations(rooms.reverse(copy=False))
        ]
        level_of = {room: k for k, level in enumerate(levels) for room in level}
        chains = {}
        for one, other in own:
            bends = [
                f"{one}>{other}>{k}"
                for k in range(level_of[one] - 1, level_of[other], -1)
            ]
            for k, bend in enumerate(bends, start=1):
                levels[level_of[one] - k].append(bend)
            chains[one, other] = [one, *bends, other]
        across = _spread(levels, chains.values())
        for k, level in enumerate(levels):
            y = bottom + 0.45 + k * ROW
            places |= {name: (across[name], y) for name in level}
        routes |= {
            edge: [places[name] for name in chain] for edge, chain in chains.items()
        }
        bands[floor] = (bottom, bottom + 0.9 + (len(levels) - 1) * ROW)
        bottom = bands[floor][1] + GAP
    return {room: places[room] for room in graph}, routes, bands


def _spread(levels: list[list[str]], chains: Iterable[list[str]]) -> dict[str, float]:
    """Return where each room and bend is from left to right, near what it is joined to."""
    near: dict[str, list[str]] = {name: [] for level in levels for name in level}
    for chain in chains:
        for one, other in pairwise(chain):
            near[one].append(other)
            near[other].append(one)
    room = {name: 0.25 if ">" in name else WIDTH + 0.2 for name in near}
    across = {
        name: MIDDLE + 2.0 * (k - len(level) / 2)
        for level in levels
        for k, name in enumerate(level)
    }
    for turn in range(60):
        for level in levels if turn % 2 else reversed(levels):
            wish = {
                name: float(np.mean([across[n] for n in near[name]] or [MIDDLE]))
                for name in level
            }
            level.sort(key=wish.__getitem__)
            x = np.array([wish[name] for name in level])
            apart = [(room[a] + room[b]) / 2 for a, b in pairwise(level)]
            for _ in range(200):
                for k, least in enumerate(apart):
                    lack = max(0.0, least - (x[k + 1] - x[k])) / 2
                    x[k], x[k + 1] = x[k] - lack, x[k + 1] + lack
                low = LEFT + room[level[0]] / 2
                high = RIGHT - room[level[-1]] / 2
                x = np.clip(x, low, high)
            across |= dict(zip(level, x.tolist(), strict=True))
    left = min(x - room[name] / 2 for name, x in across.items())
    right = max(x + room[name] / 2 for name, x in across.items())
    shift = MIDDLE - (left + right) / 2
    return {name: x + shift for name, x in across.items()}


def _draw_floors(
    axes: Axes, bands: Mapping[str, Point], lines: Mapping[str, int]
) -> None:
    for floor, (bottom, top) in bands.items():
        total = sum(n for room, n in lines.items() if room.split("/")[0] == floor)
        box = FancyBboxPatch(
            (0.15, bottom),
            RIGHT + 0.1 - 0.15,
            top - bottom,
            "round,pad=0,rounding_size=0.15",
            facecolor=COLOURS[floor],
            edgecolor="none",
            alpha=0.45,
        )
        axes.add_patch(box)
        axes.text(0.3, top - 0.12, floor, size=17, weight="bold", va="top")
        axes.text(
            0.3, top - 0.45, f"{total:,} lines", size=10, va="top", color="#555555"
        )
    for upper, lower in pairwise(FLOORS):
        start, end = bands[upper][0], bands[lower][1]
        axes.add_patch(
            FancyArrowPatch(
                (MIDDLE, start),
                (MIDDLE, end),
                arrowstyle="simple,head_width=18,head_length=12,tail_width=7",
                color="#9aa5b1",
                shrinkA=2,
                shrinkB=2,
            )
        )
        axes.text(
            MIDDLE + 0.3,
            (start + end) / 2,
            "imports",
            size=11,
            va="center",
            color="#555555",
        )


def _draw_arrow(axes: Axes, edge: tuple[str, str], points: list[Point]) -> None:
    (x0, y0), (x1, y1) = points[0], points[-1]
    points = [(x0, y0 - HEIGHT / 2), *points[1:-1], (x1, y1 + HEIGHT / 2)]
    vertices, codes = [points[0]], [Curve.MOVETO]
    for (xa, ya), (xb, yb) in pairwise(points):
        half = (ya + yb) / 2
        vertices += [(xa, half), (xb, half), (xb, yb)]
        codes += [Curve.CURVE4] * 3
    arrow = FancyArrowPatch(
        path=Curve(vertices, codes),
        arrowstyle="-|>,head_width=2.5,head_length=5",
        color="#5b6b7b",
        linewidth=1.0,
        shrinkA=0,
        shrinkB=0,
        zorder=1,
    )
    arrow.set_gid(">".join(edge))
    axes.add_patch(arrow)


def _draw_room(
    axes: Axes, room: str, place: Point, lines: int, numbers: list[int]
) -> None:
    floor, _, name = room.partition("/")
    x, y = place
    box = FancyBboxPatch(
        (x - WIDTH / 2, y - HEIGHT / 2),
        WIDTH,
        HEIGHT,
        "round,pad=0,rounding_size=0.08",
        facecolor="white",
        edgecolor="#5b6b7b",
        linewidth=1.2,
        zorder=2,
    )
    box.set_gid(room)
    axes.add_patch(box)
    words = name or f"{floor}/*.py"
    axes.text(
        x, y + 0.08, words, size=10.5, ha="center", va="center", weight="bold", zorder=3
    )
    axes.text(
        x,
        y - 0.14,
        f"{lines:,} lines",
        size=8,
        ha="center",
        va="center",
        color="#555555",
        zorder=3,
    )
    for k, number in enumerate(numbers):
        _draw_number(axes, number, x - WIDTH / 2 + 0.3 * k, y + HEIGHT / 2)


def _draw_number(axes: Axes, number: int, x: float, y: float) -> None:
    axes.add_patch(
        Circle((x, y), 0.14, facecolor="#b3261e", edgecolor="white", zorder=4)
    )
    axes.text(
        x,
        y - 0.01,
        str(number),
        size=8.5,
        color="white",
        weight="bold",
        ha="center",
        va="center",
        zorder=5,
    )


def _draw_way(axes: Axes, stages: list[tuple[str, str]], top: float) -> None:
    x = RIGHT + 0.35
    axes.text(x, top - 0.45, "The way of a scenario", size=13, weight="bold")
    for k, (room, words) in enumerate(stages, start=1):
        y = top - 0.5 - 0.5 * k
        _draw_number(axes, k, x + 0.12, y)
        axes.text(x + 0.35, y + 0.09, words, size=9.5, va="center")
        axes.text(x + 0.35, y - 0.1, room, size=8.5, va="center", color="#555555")
    notes = (
        "A box is a room, which is a folder.",
        "An arrow goes to a room that is imported;",
        "those that follow from others are left out.",
    )
    for k, note in enumerate(notes):
        axes.text(x, top - 1.4 - 0.5 * len(stages) - 0.22 * k, note, size=9.5)


def main(picture: Path) -> None:
    """Draw the house into a file, and write the table of its rooms."""
    code = modules()
    before, _, after = DESIGN.read_text(encoding="utf-8").split(ROOMS)
    text = ROOMS.join((before, room_table(code), after))
    DESIGN.write_text(text, encoding="utf-8")
    graph = imports(code)
    lines = lines_of(code)
    mpl.rcParams.update({"svg.fonttype": "none", "svg.hashsalt": "house"})
    mpl.rcParams["font.family"] = "sans-serif"
    arrows = floor_arrows(graph)
    places, routes, bands = _layout(graph, arrows)
    height = max(top for _, top in bands.values()) + 0.2
    figure = Figure(figsize=(RIGHT + 4.2, height))
    axes = figure.add_axes((0.0, 0.0, 1.0, 1.0))
    axes.set(xlim=(0.0, RIGHT + 4.2), ylim=(0.0, height))
    axes.axis("off")
    _draw_floors(axes, bands, lines)
    for edge in arrows:
        _draw_arrow(axes, edge, routes[edge])
    stages = way(code)
    for room in graph:
        numbers = [k for k, (where, _) in enumerate(stages, 1) if where == room]
        _draw_room(axes, room, places[room], lines[room], numbers)
    _draw_way(axes, stages, height)
    metadata: dict[str, Any] = {"Date": None} if picture.suffix == ".svg" else {}
    figure.savefig(picture, metadata=metadata, dpi=70)


if __name__ == "__main__":
    sys.path.insert(0, str(ROOT))
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("picture", nargs="?", type=Path, default=PICTURE)
    parser.add_argument("--figures", action="store_true", help="print figures of walls")
    parser.add_argument("--without", metavar="WING", choices=[*wings(), "all"])
    given = parser.parse_args()
    if given.figures:
        print_figures()
    elif given.without:
        sys.exit(0 if print_without(given.without) else 1)
    else:
        main(given.picture)
