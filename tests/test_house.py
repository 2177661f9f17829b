"""The layout of the code: which way imports point, which walls stand, what rooms say they are, its picture."""

from __future__ import annotations

import ast
import re
from pathlib import Path

import networkx as nx
import pytest

from tests.scripts import script

ROOT = Path(__file__).parents[1]
DESIGN_ROW = re.compile(r"^\| `([\w/]+)/` \| .+ \|$", re.MULTILINE)
MOST_DOCSTRING_LINES = 5
MOST_CLASSES = 14
"""From the text of a scenario to the plan that the dispatcher executes."""

BROKEN_WALLS: set[str] = set()
"""Imports from the core into a wing, or into a wing that is not declared. Add none; what is mended goes."""

IN_CIRCLES: set[str] = set()
"""Rooms that import each other by way of others. Add none; what is mended goes."""


HOUSE = script("house")
FLOORS: tuple[str, ...] = HOUSE.FLOORS
FOLDERS = sorted(
    {path.parent for floor in FLOORS for path in (ROOT / floor).rglob("*.py")}
)


@pytest.fixture(scope="module")
def code() -> dict[str, ast.Module]:
    modules: dict[str, ast.Module] = HOUSE.modules()
    return modules


@pytest.fixture(scope="module")
def rooms(code: dict[str, ast.Module]) -> nx.DiGraph[str]:
    graph: nx.DiGraph[str] = HOUSE.imports(code)
    return graph


def test_imports_point_from_twin_over_scheduling_to_planning(
    rooms: nx.DiGraph[str],
) -> None:
    height = {floor: k for k, floor in enumerate(FLOORS)}
    for one, other in rooms.edges:
        assert height[one.split("/")[0]] <= height[other.split("/")[0]], (one, other)


def test_files_do_not_import_each_other(code: dict[str, ast.Module]) -> None:
    try:
        circle = [one for one, _ in nx.find_cycle(HOUSE.imports(code, str))]
    except nx.NetworkXNoCycle:
        return
    pytest.fail(f"they import each other: {' -> '.join([*circle, circle[0]])}")


def test_top_folders_do_not_import_each_other(code: dict[str, ast.Module]) -> None:
    """With all folders below them, and imports in functions; ``twin`` itself names what others have."""
    inside = {name: tree for name, tree in code.items() if name != "twin.__init__"}
    graph = HOUSE.imports(inside, lambda module: "/".join(module.split(".")[:2]))
    circles = [c for c in nx.strongly_connected_components(graph) if len(c) > 1]
    assert circles == []


def test_walls_stand_but_for_those_listed(code: dict[str, ast.Module]) -> None:
    declared = HOUSE.wings()
    arrows, circles = HOUSE.broken_walls(HOUSE.walls(code, declared), declared)
    assert arrows == BROKEN_WALLS, "python docs/house.py --figures"
    assert circles == IN_CIRCLES, "python docs/house.py --figures"


def test_wings_are_declared_as_they_are(code: dict[str, ast.Module]) -> None:
    declared = HOUSE.wings()
    found: dict[str, set[str]] = {name: set() for name in declared}
    for arrow in HOUSE.name_imports(code):
        one, other = (
            HOUSE.wing_of(name, declared) for name in (arrow.source, arrow.target)
        )
        if one and other and one != other:
            found[one].add(other)
    assert {name: set(wing.uses) for name, wing in declared.items()} == found
    uses = nx.DiGraph((n, own) for n, wing in declared.items() for own in wing.uses)
    assert set(uses) <= set(declared)
    assert nx.is_directed_acyclic_graph(uses), nx.find_cycle(uses)
    for wing in declared.values():
        assert set(wing.needs) <= set(wing.uses)
        assert [p for p in wing.places if not (ROOT / p).exists()] == []


def test_private_names_stay_in_their_room(code: dict[str, ast.Module]) -> None:
    declared = HOUSE.wings()
    for arrow in HOUSE.name_imports(code):
        one, other = (
            HOUSE.top_room_of(name, declared) for name in (arrow.source, arrow.target)
        )
        parts = [*arrow.target.split("."), arrow.name]
        private = [p for p in parts if p.startswith("_") and not p.startswith("__")]
        assert one == other or not private, arrow


def test_a_wall_is_broken_by_imports_in_functions() -> None:
    declared = {"fit": HOUSE.Wing("", ("twin/fit",), ())}
    code = {
        "twin.runs.events": ast.parse("def f():\n    from twin.fit.samples import g"),
        "twin.fit.samples": ast.parse("from twin.host.guard import guarded"),
        "twin.host.guard": ast.parse(""),
    }
    arrows = [a for a in HOUSE.name_imports(code) if HOUSE.wing_of(a.target, declared)]
    assert arrows == [("twin.runs.events", "twin.fit.samples", "g")]


def test_commands_of_a_wing_are_known() -> None:
    declared = HOUSE.wings()
    assert HOUSE.commands_of("study", declared) == {"study", "compare"}
    assert "run" in HOUSE.commands_of("", declared)


def test_a_package_that_is_imported_whole_is_an_arrow() -> None:
    code = {
        "twin.__init__": ast.parse("from twin.commands.run import run"),
        "twin.commands.run": ast.parse("def run():\n    import twin"),
    }
    assert set(HOUSE.imports(code).edges) == {
        ("twin", "twin/commands"),
        ("twin/commands", "twin"),
    }


def test_a_public_name_of_a_class_stands_once(code: dict[str, ast.Module]) -> None:
    places: dict[str, list[str]] = {}
    for name, tree in code.items():
        for node in ast.walk(tree):
            if isinstance(node, ast.ClassDef) and not node.name.startswith("_"):
                places.setdefault(node.name, []).append(f"{name}, line {node.lineno}")
    assert not {name: where for name, where in places.items() if len(where) > 1}


def test_nothing_outside_a_kind_asks_which_kind_it_is(
    code: dict[str, ast.Module],
) -> None:
    kinds = {k: tree for k, tree in code.items() if k.startswith("twin.kinds.")}
    own = {
        node.name
        for tree in kinds.values()
        for node in ast.walk(tree)
        if isinstance(node, ast.ClassDef) and node.name.endswith(("Kind", "Section"))
    }
    assert "LegoKind" in own
    for name in code.keys() - kinds.keys() - {"twin.kinds.goals.checks"}:
        for node in ast.walk(code[name]):
            assert not (isinstance(node, ast.Name) and node.id in own), (name, node.id)
            if isinstance(node, ast.Compare) and not _asks_a_registry(node):
                sides = map(ast.unparse, (node.left, *node.comparators))
                assert not any(side.endswith("assembly.kind") for side in sides), name


def _asks_a_registry(node: ast.Compare) -> bool:
    return isinstance(node.ops[0], ast.In) and isinstance(node.comparators[0], ast.Name)


def test_the_design_names_every_room(code: dict[str, ast.Module]) -> None:
    design = (ROOT / "docs" / "design.md").read_text(encoding="utf-8")
    rooms = DESIGN_ROW.findall(HOUSE.room_table(code))
    assert DESIGN_ROW.findall(design) == rooms, "python docs/house.py"


def test_files_that_the_design_names_are_there() -> None:
    text = (ROOT / "docs" / "design.md").read_text(encoding="utf-8")
    rooms = [*FLOORS, "benchmarks", "docs", "tests"]
    places = [str(path) for room in rooms for path in (ROOT / room).rglob("*.py")]
    for name in re.findall(r"`([\w/]+\.py)`", text):
        assert any(place.endswith(f"/{name}") for place in places), name


def test_the_path_of_a_scenario_in_the_design_is_short_and_there(
    code: dict[str, ast.Module],
) -> None:
    text = (ROOT / "docs" / "design.md").read_text(encoding="utf-8")
    (path,) = re.findall(r"```text\n(YamlDocument.*?)```", text, re.DOTALL)
    classes = re.findall(r"\b[A-Z]\w+\b(?!\.)", path)
    functions = re.findall(r"\b[a-z]+(?:_[a-z]+)+\b", path)
    defined = {
        node.name
        for tree in code.values()
        for node in ast.walk(tree)
        if isinstance(node, ast.ClassDef | ast.FunctionDef)
    }
    assert len(classes) <= MOST_CLASSES
    assert {*classes, *functions} <= defined


@pytest.mark.parametrize("folder", FOLDERS, ids=lambda f: str(f.relative_to(ROOT)))
def test_a_room_says_what_it_is(folder: Path) -> None:
    init = folder / "__init__.py"
    assert init.exists(), "a room needs an __init__.py that says what is in it"
    words = ast.get_docstring(ast.parse(init.read_text(encoding="utf-8")))
    assert words, f"{init} has no docstring"
    assert len(words.splitlines()) <= MOST_DOCSTRING_LINES


def test_the_picture_shows_the_rooms_and_their_imports(
    code: dict[str, ast.Module], rooms: nx.DiGraph[str]
) -> None:
    drawn = set(re.findall(r'id="([^"]+)"', HOUSE.PICTURE.read_text(encoding="utf-8")))
    drawn = {name.replace("&gt;", ">") for name in drawn}
    again = "the house has changed: python docs/house.py"
    assert {name for name in drawn if ">" in name} == {
        f"{one}>{other}" for one, other in HOUSE.floor_arrows(rooms)
    }, again
    assert set(rooms) == {
        name for name in drawn if name.split("/")[0] in FLOORS and ">" not in name
    }, again


def test_the_picture_shows_the_way_of_a_scenario(code: dict[str, ast.Module]) -> None:
    picture = HOUSE.PICTURE.read_text(encoding="utf-8")
    for room, words in HOUSE.way(code):
        assert f">{words}</text>" in picture
        assert f">{room}</text>" in picture
