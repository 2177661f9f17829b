"""Brick lists: what is read, what is refused by its line, and the way back."""

from __future__ import annotations

import os
import re
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from planning.errors import ScenarioError
from planning.importers.brick_models.model import read_brick_list
from planning.lego.bricks.assembly import BRICKS, Cell

DATA = Path(os.environ.get("ASSEMBLY_TWIN_BRICKGPT_DATA", "/work/shared/data/brickgpt"))

GOOD = "2x4 (10,8,0)\n4x2 (10,8,1)\n1x1 (13,9,2)\n"


def read(folder: Path, text: str | bytes):
    file = folder / "model.txt"
    file.write_bytes(text if isinstance(text, bytes) else text.encode())
    return read_brick_list(file)


def cells(model):
    return [(item.brick.name, item.cell, item.source) for item in model.bricks]


def test_a_list_is_moved_to_the_corner_of_the_grid(tmp_path: Path) -> None:
    model = read(tmp_path, GOOD)
    assert cells(model) == [
        ("2x4", Cell(0, 0, 1), "line 1"),
        ("2x4", Cell(0, 0, 2, turned=True), "line 2"),
        ("1x1", Cell(3, 1, 3), "line 3"),
    ]
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
    here, there = read(tmp_path, GOOD), read(tmp_path, text)
    assert [c[:2] for c in cells(there)] == [c[:2] for c in cells(here)]


@pytest.mark.parametrize(
    ("text", "messages"),
    [
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
    ],
)
def test_what_is_no_model_is_told_by_its_line(
    text: str | bytes, messages: list[str], tmp_path: Path
) -> None:
    with pytest.raises(ScenarioError) as caught:
        read(tmp_path, text)
    for message in messages:
        assert message in str(caught.value)


def test_a_file_that_is_not_there(tmp_path: Path) -> None:
    with pytest.raises(ScenarioError, match="cannot be read"):
        read_brick_list(tmp_path / "none.txt")
    with pytest.raises(ScenarioError, match=r"folder|directory"):
        read_brick_list(tmp_path)


@settings(max_examples=60, deadline=None)
@given(data=st.data())
def test_any_tower_comes_back(data: st.DataObject, tmp_path_factory) -> None:
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
    model = read(tmp_path_factory.mktemp("lists"), "\n".join(lines))
    low = [min(e[k] for e in expected) for k in (1, 2)]
    found = [
        (i.brick, i.cell.x, i.cell.y, i.cell.z, i.cell.turned) for i in model.bricks
    ]
    assert found == [
        (kind, x - low[0], y - low[1], z, turned) for kind, x, y, z, turned in expected
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
