"""Brick lists and models of LDraw: what is read, what is refused by its line, models within models."""

import os
import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from planning.errors import ScenarioError
from planning.lego.bricks.assembly import BrickType, Cell
from planning.lego.bricks.brick_types import BRICKS
from planning.lego.importers.brick_models.brick_list import read_brick_list
from planning.lego.importers.brick_models.ldraw import read_ldraw
from planning.lego.importers.brick_models.ldraw_files import PARTS
from planning.lego.importers.brick_models.model import BrickModel

DATA = Path(
    os.environ.get("ASSEMBLY_TWIN_BRICKGPT_DATA")
    or Path(__file__).parents[4] / "../shared/data/brickgpt"
)

GOOD = "2x4 (10,8,0)\n4x2 (10,8,1)\n1x1 (13,9,2)\n"


def read(folder: Path, text: str | bytes, name: str = "model.ldr") -> BrickModel:
    """Read a model: a brick list where it is a text file, else one of LDraw."""
    file = folder / name
    file.write_bytes(text if isinstance(text, bytes) else text.encode())
    return read_brick_list(file) if name.endswith(".txt") else read_ldraw(file)


def read_list(folder: Path, text: str | bytes) -> BrickModel:
    return read(folder, text, "model.txt")


def cells(model: BrickModel) -> list[tuple[str, Cell]]:
    return [(item.brick.name, item.cell) for item in model.bricks]


def test_a_list_is_moved_to_the_corner_of_the_grid(tmp_path: Path) -> None:
    model = read_list(tmp_path, GOOD)
    assert cells(model) == [
        ("2x4", Cell(0, 0, 1)),
        ("2x4", Cell(0, 0, 2, turned=True)),
        ("1x1", Cell(3, 1, 3)),
    ]
    assert [item.source for item in model.bricks] == ["line 1", "line 2", "line 3"]
    assert model.size == (4, 4, 9)
    assert {k.name: v for k, v in model.kinds.items()} == {"2x4": 2, "1x1": 1}
    assert model.notes == ()


@pytest.mark.parametrize(
    "text",
    [
        GOOD.replace("\n", "\r\n"),
        "\ufeff" + GOOD,
        GOOD.replace("\n", "\r\n").encode("utf-16"),
        "# a model\n\n" + GOOD.replace("\n", "   # a brick\n\n"),
        "  2 X 4 ( 10 , 8 , 0 )\n4x2(10,8,1),\n1x1\t(13, 9, 2)",
        GOOD.replace(",0)", ",5)").replace(",1)", ",6)").replace(",2)", ",7)"),
        GOOD.replace("(10,", "(-4,").replace("(13,", "(-1,"),
    ],
)
def test_the_same_in_other_letters(text: str | bytes, tmp_path: Path) -> None:
    here, there = read_list(tmp_path, GOOD), read_list(tmp_path, text)
    assert cells(there) == cells(here)


def test_a_file_that_is_not_there(tmp_path: Path) -> None:
    with pytest.raises(ScenarioError, match="cannot be read"):
        read_brick_list(tmp_path / "none.txt")
    with pytest.raises(ScenarioError, match=r"folder|directory"):
        read_brick_list(tmp_path)


@settings(max_examples=60, deadline=None)
@given(data=st.data())
def test_any_tower_comes_back(
    data: st.DataObject, tmp_path_factory: pytest.TempPathFactory
) -> None:
    """Bricks over one stud, one a layer: written, and read at the same cells."""
    kinds = [brick for brick in BRICKS.values() if brick.height == 3]
    lines, expected = [], []
    for z in range(data.draw(st.integers(1, 8))):
        kind = data.draw(st.sampled_from(kinds))
        turned = data.draw(st.booleans()) and kind.studs[0] != kind.studs[1]
        nx, ny = kind.studs[::-1] if turned else kind.studs
        x = 50 - data.draw(st.integers(0, nx - 1))
        y = 50 - data.draw(st.integers(0, ny - 1))
        lines.append(f"{nx}x{ny} ({x},{y},{z})")
        expected.append((kind, x, y, z + 1, turned))
    model = read_list(tmp_path_factory.mktemp("lists"), "\n".join(lines))
    low_x, low_y = min(e[1] for e in expected), min(e[2] for e in expected)
    found = [
        (i.brick, i.cell.x, i.cell.y, i.cell.z, i.cell.turned) for i in model.bricks
    ]
    assert found == [
        (kind, x - low_x, y - low_y, z, turned) for kind, x, y, z, turned in expected
    ]


@pytest.mark.skipif(not DATA.exists(), reason="published brick lists not found")
@pytest.mark.parametrize("file", sorted(DATA.glob("*.txt")), ids=lambda f: f.stem)
def test_published_lists_are_read_as_they_are_written(file: Path) -> None:
    model = read_brick_list(file)
    numbers = [
        [int(n) for n in re.findall(r"\d+", line)]
        for line in file.read_text().splitlines()
    ]
    assert len(model.bricks) == len(numbers) > 20
    x0, y0 = (min(n[k] for n in numbers) for k in (2, 3))
    for item, (h, w, x, y, z) in zip(model.bricks, numbers, strict=True):
        assert item.span.size == (h, w)
        assert (item.cell.x + x0, item.cell.y + y0, item.cell.z) == (x, y, z + 1)


STRAIGHT = "1 0 0 0 1 0 0 0 1"
QUARTER = "0 0 -1 0 1 0 1 0 0"
HALF = "-1 0 0 0 1 0 0 0 -1"


def part(
    x: float, y: float, z: float, number: str = "3001.dat", turn: str = STRAIGHT
) -> str:
    return f"1 4 {x:g} {y:g} {z:g} {turn} {number}\n"


def test_a_brick_a_plate_and_a_turned_brick(tmp_path: Path) -> None:
    text = (
        part(0, 0, 0) + part(-20, -8, 0, "3022.dat") + part(-20, -32, 0, turn=QUARTER)
    )
    model = read(tmp_path, text)
    # The turned brick reaches one stud beyond on both sides of y.
    assert cells(model) == [
        ("2x4", Cell(0, 1, 1, turned=True)),
        ("2x2-plate", Cell(0, 1, 2)),
        ("2x4", Cell(0, 0, 2, raised=1)),
    ]
    assert model.size == (4, 4, 7)


@pytest.mark.parametrize(("number", "kind"), sorted(PARTS.items()))
@pytest.mark.parametrize("turn", [STRAIGHT, QUARTER, HALF])
def test_every_part_covers_its_studs(
    number: str, kind: BrickType, turn: str, tmp_path: Path
) -> None:
    """The longer side lies along LDraw's x; half studs of odd sizes are no matter."""
    nx, nz = (max(kind.studs), min(kind.studs))
    if turn == QUARTER:
        nx, nz = nz, nx
    top = part(nx * 10 - 10, -8 * kind.height, nz * 10 - 10, f"{number}.DAT", turn)
    model = read(tmp_path, part(0, 0, 0, "3005.dat") + top)
    base, item = model.bricks
    assert base.cell == Cell(0, 0, 1)
    assert (item.cell.x, item.cell.y) == (0, 0)
    assert item.span.size == (nx, nz)
    assert item.brick == kind


@settings(max_examples=40, deadline=None)
@given(
    shift=st.tuples(*[st.floats(-1000, 1000)] * 3),
    drift=st.floats(-0.1, 0.1),
)
def test_a_shifted_model_is_the_same(
    shift: tuple[float, float, float],
    drift: float,
    tmp_path_factory: pytest.TempPathFactory,
) -> None:
    """Wherever it hangs, and with the small errors that programs leave behind."""
    places = [(0, 0, 0), (40, -24, 0), (40, -48, 20)]
    turns = [STRAIGHT, QUARTER, STRAIGHT]
    folder = tmp_path_factory.mktemp("models")

    def text(shift: Sequence[float], drift: float = 0.0) -> str:
        return "".join(
            part(x + drift * k, y + drift * k, z + drift * k, turn=t)
            for k, ((x, y, z), t) in enumerate(
                zip(np.add(places, shift).tolist(), turns, strict=True)
            )
        )

    here = read(folder, text((0.0, 0.0, 0.0)))
    rounded = [round(v, 3) for v in shift]
    assert cells(read(folder, text(rounded, drift))) == cells(here)


MPD = """0 FILE main.ldr
0 Name: main.ldr
1 16 0 0 0 1 0 0 0 1 0 0 0 1 Wing Left.ldr
1 16 100 0 0 0 0 1 0 1 0 -1 0 0 wing left.LDR
1 4 40 -48 0 1 0 0 0 1 0 0 0 1 3001.dat
0 STEP
0 NOFILE
0 FILE Wing Left.ldr
1 16 0 0 0 1 0 0 0 1 0 0 0 1 feather.ldr
1 0x2FF0000 20 -24 0 1 0 0 0 1 0 0 0 1 3003.dat
0 NOFILE
0 FILE feather.ldr
1 14 0 0 0 1 0 0 0 1 0 0 0 1 3001.dat
4 16 0 0 0 1 0 0 1 1 0 0 1 0
0 NOFILE
"""


def test_models_within_models_are_moved_and_turned(tmp_path: Path) -> None:
    model = read(tmp_path, MPD.replace("\n", "\r\n"), "model.mpd")
    # The second wing is turned by a quarter turn: its brick lies along y, and its 2x2, 20 along x
    # in the wing, is at -20 along z.
    assert cells(model) == [
        ("2x4", Cell(0, 1, 1, turned=True)),
        ("2x2", Cell(2, 1, 2)),
        ("2x4", Cell(6, 0, 1)),
        ("2x2", Cell(6, 0, 2)),
        ("2x4", Cell(2, 1, 3, turned=True)),
    ]
    assert [item.source for item in model.bricks] == [
        "line 13 by way of line 9 by way of line 3",
        "line 10 by way of line 3",
        "line 13 by way of line 9 by way of line 4",
        "line 10 by way of line 4",
        "line 5",
    ]
    assert "2 lines that draw" not in str(model.notes)
    assert any("1 line that draws" in note for note in model.notes)
    assert any("1 step is left out" in note for note in model.notes)
    assert [item.colour for item in model.bricks] == [
        (242, 205, 55),
        (255, 0, 0),
        (242, 205, 55),
        (255, 0, 0),
        (201, 26, 9),
    ]


def test_parts_that_a_file_brings_along_are_parts(tmp_path: Path) -> None:
    text = (
        "0 FILE a.ldr\n" + part(0, 0, 0) + "0 FILE 3001.dat\n3 16 0 0 0 1 1 1 2 2 2\n"
    )
    assert cells(read(tmp_path, text)) == [("2x4", Cell(0, 0, 1, turned=True))]


def test_a_base_plate_is_the_plate_of_the_cell(tmp_path: Path) -> None:
    base = part(0, 0, 0, "3811.dat")
    model = read(tmp_path, base + part(20, -24, 10) + part(-40, -24, 10, "3003.dat"))
    assert cells(model) == [
        ("2x4", Cell(2, 0, 1, turned=True)),
        ("2x2", Cell(0, 0, 1)),
    ]
    assert "base plates are left out" in str(model.notes)
    with pytest.raises(ScenarioError, match="no bricks in it"):
        read(tmp_path, base)


@pytest.mark.parametrize(
    ("code", "colour"),
    [
        ("4", (201, 26, 9)),
        ("0x2A0B0C0", (160, 176, 192)),
        ("0x3a0b0c0", (160, 176, 192)),
        ("#A0B0C0", (160, 176, 192)),
        ("9001", (1, 2, 255)),
        ("16", None),
        ("9999", None),
    ],
)
def test_colours_of_parts(
    code: str, colour: tuple[int, int, int] | None, tmp_path: Path
) -> None:
    text = "0 !COLOUR Mine CODE 9001 VALUE #0102FF EDGE #333333\n" + part(0, 0, 0)
    model = read(tmp_path, text.replace("1 4 ", f"1 {code} "))
    assert model.bricks[0].colour == colour
    assert any("9999" in note for note in model.notes) == (code == "9999")


def test_prints_are_bricks(tmp_path: Path) -> None:
    assert cells(read(tmp_path, part(0, 0, 0, "3005p01.dat"))) == [
        ("1x1", Cell(0, 0, 1))
    ]


SIDE = "1 0 0 0 0 -1 0 1 0"
LEAN = "0.8660254 -0.5 0 0.5 0.8660254 0 0 0 1"
ODD = "0.8660254 0 0.5 0 1 0 -0.5 0 0.8660254"

NO_LISTS = [
    ("2x4 (1,2)\n", [":1: '2x4 (1,2)' is no brick", "'2x4 (10,8,0)'"]),
    (GOOD + "\nhello\n", [":5: 'hello' is no brick"]),
    ("2x4 (1,2,0.5)\n", [":1: '2x4 (1,2,0.5)' is no brick"]),
    ("3x5 (0,0,0)\n", [":1: no brick type has 3 x 5 studs (there are 1 x 1"]),
    ("0x0 (0,0,0)\n", [":1: no brick type has 0 x 0 studs"]),
    ("x\n" * 9, ["model.txt:6: 'x' is no brick", "and 3 more"]),
    ("", ["no bricks in it"]),
    ("# nothing\n", ["no bricks in it"]),
    (b"\x00\x01\x02", ["no text file"]),
    (
        "2x4 (0,0,0)\n2x4 (1,0,0)\n",
        ["in one place: line 1 (2x4) and line 2 (2x4)"],
    ),
    ("2x4 (0,0,0)\n2x2 (9,9,1)\n", ["joined to nothing", "line 2 (2x2)"]),
    ("2x2 (0,0,0)\n2x2 (2,0,1)\n", ["joined to nothing", "line 2 (2x2)"]),
    ("2x2 (0,0,0)\n2x2 (999999,0,0)\n", ["more than 100000 studs apart"]),
    ("2x2 (0,0,0)\n2x2 (9999999,0,0)\n", [":2: '2x2 (9999999,0,0)' is no brick"]),
]
NO_LDRAW = [
    (part(0, 0, 0, turn=SIDE), [":1: 3001.dat is on its side"]),
    (part(0, 0, 0, turn="1 0 0 0 -1 0 0 0 -1"), ["upside down"]),
    (part(0, 0, 0, turn="2 0 0 0 1 0 0 0 1"), ["scaled or sheared"]),
    (part(0, 0, 0, turn="1 0 0 0 1 0 0 0 0"), ["scaled or sheared"]),
    (part(0, 0, 0, turn=LEAN), ["tilted by 30 degrees"]),
    (part(0, 0, 0, turn=ODD), ["turned by 30 degrees, no quarter turn"]),
    (part(0, 0, 0, "9999.dat"), [":1: '9999.dat' is no brick", "3001 (2x4)"]),
    ("1 4 0 0 0 3001.dat\n", [":1: a part has 15 values, this line 6", "'1 4 20"]),
    (f"1 red 0 0 0 {STRAIGHT} 3001.dat", [":1: 'red' is no colour"]),
    (f"1 4 a 0 0 {STRAIGHT} 3001.dat", [":1: 'a' is no number"]),
    (f"1 4 nan 0 0 {STRAIGHT} 3001.dat", ["nan is no length"]),
    (f"1 4 1e99 0 0 {STRAIGHT} 3001.dat", ["1e99 is no length"]),
    ("hello\n", [":1: 'hello' is no line of LDraw"]),
    ("0 empty\n", ["no bricks in it"]),
    ("", ["no bricks in it"]),
    ("0 FILE a.ldr\n1 4 0 0 0 1 0 0 0 1 0 0 0 1 a.ldr\n", [":2: models within"]),
    ("0 FILE a\n0 FILE a\n", [":2: a model before it is called 'a', too"]),
    (
        part(0, 0, 0) + part(0, -24, 0) + part(5, -48, 0),
        [":3: 3001.dat is off the studs", "x 5, y 0, z 0", "2 of 3 parts"],
    ),
    (
        part(0, 0, 0) + part(0, -24, 0) + part(0, -51, 0),
        [":3: 3001.dat is off the studs", "x 0, y -3, z 0"],
    ),
    (part(0, 0, 0) + part(20, 0, 0), ["in one place: line 1 (2x4) and line 2"]),
    (part(0, 0, 0) + part(0, -48, 0), ["joined to nothing", "line 2 (2x4)"]),
    (part(0, 0, 0, "wing.ldr"), [":1: 'wing.ldr' is no brick or plate"]),
]


@pytest.mark.parametrize(
    ("name", "text", "messages"),
    [
        *(("model.txt", *row) for row in NO_LISTS),
        *(("model.ldr", *row) for row in NO_LDRAW),
    ],
)
def test_what_is_no_model_of_bricks_is_told_by_its_line(
    name: str, text: str | bytes, messages: list[str], tmp_path: Path
) -> None:
    with pytest.raises(ScenarioError) as caught:
        read(tmp_path, text, name)
    for message in messages:
        assert message in str(caught.value)


def test_an_archive_is_no_model(tmp_path: Path) -> None:
    with pytest.raises(ScenarioError, match="export the model as LDraw"):
        read(tmp_path, b"PK\x03\x04 and more", "model.io")


def test_models_that_multiply_are_refused_at_once(tmp_path: Path) -> None:
    """Forty models, each twice in the one before it: none has any part."""
    text = "".join(
        f"0 FILE m{k}\n" + 2 * f"1 4 0 0 0 {STRAIGHT} m{k + 1}\n" for k in range(40)
    )
    with pytest.raises(ScenarioError, match="more than"):
        read(tmp_path, text + "0 FILE m40\n")


@pytest.mark.parametrize("turn", ["-1 0 0 0 1 0 0 0 1", "0 0 1 0 1 0 1 0 0"])
def test_a_mirrored_brick_is_the_same_brick(turn: str, tmp_path: Path) -> None:
    straight = QUARTER if turn.startswith("0") else STRAIGHT
    bottom = part(0, 24, 0, "3003.dat")
    mirrored = read(tmp_path, bottom + part(20, 0, 0, turn=turn))
    assert cells(mirrored) == cells(
        read(tmp_path, bottom + part(20, 0, 0, turn=straight))
    )


def test_a_turned_model_turns_its_bricks(tmp_path: Path) -> None:
    """A part that leans in a model that leans back stands upright."""
    back = "0.8660254 0.5 0 -0.5 0.8660254 0 0 0 1"
    text = f"0 FILE a\n1 4 0 0 0 {back} b\n0 FILE b\n1 4 0 0 0 {LEAN} 3001.dat\n"
    assert cells(read(tmp_path, text)) == [("2x4", Cell(0, 0, 1, turned=True))]
