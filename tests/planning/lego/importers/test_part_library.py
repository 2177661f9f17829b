"""LDraw models with parts that are no known bricks: a parts library, obstacles, what is left out."""

import time
from collections.abc import Iterable
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from planning.errors import ScenarioError
from planning.lego.bricks.assembly import BrickType, Cell, PlacedBrick
from planning.lego.bricks.brick_grips import legal_presses, press_cell
from planning.lego.bricks.brick_types import BRICKS, brick_of_size
from planning.lego.bricks.brick_world import grasp_number, press_from_number
from planning.lego.importers.brick_models.ldraw import Unknown, read_ldraw
from planning.lego.importers.brick_models.model import BrickModel
from planning.lego.importers.brick_models.part_library import PartLibrary
from planning.lego.importers.brick_models.part_shape import PartShape
from planning.lego.stability.contacts import filled_places, find_joints

UPRIGHT = "1 0 0 0 1 0 0 0 1"
TURNS = (UPRIGHT, "0 0 -1 0 1 0 1 0 0", "-1 0 0 0 1 0 0 0 -1", "0 0 1 0 1 0 -1 0 0")


def part(x: float, y: float, z: float, name: str, turn: str = UPRIGHT) -> str:
    return f"1 4 {x:g} {y:g} {z:g} {turn} {name}\n"


def face(*corners: tuple[float, float, float]) -> str:
    numbers = " ".join(f"{v:g}" for corner in corners for v in corner)
    return f"{len(corners)} 16 {numbers}\n"


def prism(x0: float, x1: float, outline: Iterable[tuple[float, float]]) -> str:
    """Return the faces of a convex outline in (y, z) that is drawn out along x."""
    points = list(outline)
    sides = [
        face((x0, *a), (x1, *a), (x1, *b), (x0, *b))
        for a, b in zip(points, points[1:] + points[:1], strict=True)
    ]
    ends = [
        face((x, *points[0]), (x, *points[k]), (x, *points[k + 1]))
        for x in (x0, x1)
        for k in range(1, len(points) - 1)
    ]
    return "".join([*sides, *ends])


def block(
    nx: int, nz: int, levels: int, shift: tuple[float, float, float] = (0, 0, 0)
) -> str:
    """Return the faces of a closed box, its origin in the middle of its top."""
    x, y, z = shift
    z0, z1, bottom = z - 10 * nz, z + 10 * nz, y + 8 * levels
    outline = [(y, z0), (y, z1), (bottom, z1), (bottom, z0)]
    return prism(x - 10 * nx, x + 10 * nx, outline)


def knobs(
    nx: int,
    nz: int,
    shift: tuple[float, float, float] = (0, 0, 0),
    name: str = "stud.dat",
) -> str:
    x, y, z = shift
    return "".join(
        part(x + 20 * i - 10 * (nx - 1), y, z + 20 * k - 10 * (nz - 1), name)
        for i in range(nx)
        for k in range(nz)
    )


SLOPE = [(0.0, -10.0), (0.0, 10.0), (24.0, 10.0), (24.0, -30.0), (20.0, -30.0)]

PARTS = {
    "parts/block5x5.dat": block(5, 5, 3) + knobs(5, 5),
    "parts/tile2x2.dat": block(2, 2, 1),
    "parts/tile1x2.dat": block(2, 1, 1),
    "parts/ramp2x2.dat": prism(-20, 20, SLOPE),
    "parts/slope2x2.dat": prism(-20, 20, SLOPE) + knobs(2, 1),
    "parts/corner.dat": block(2, 2, 3) + knobs(1, 1, (10, 0, 10)),
    "parts/inverse.dat": prism(-20, 20, [(24 - y, z) for y, z in SLOPE])
    + knobs(2, 2, (0, 0, -10)),
    "parts/jumper.dat": block(2, 1, 1) + knobs(1, 1),
    "parts/sideways.dat": block(1, 1, 3)
    + knobs(1, 1)
    + part(0, 10, -10, "stud.dat", "1 0 0 0 0 -1 0 1 0"),
    "parts/narrow.dat": block(2, 2, 3).replace("20", "19") + knobs(2, 2),
    "parts/arch.dat": block(1, 1, 3, (-30, 0, 0))
    + block(1, 1, 3, (30, 0, 0))
    + block(2, 1, 1)
    + knobs(4, 1),
    "parts/By Parts.DAT": part(0, 0, 0, "S\\Half.dat") + part(0, 8, 0, "flat.dat"),
    "parts/s/half.dat": part(0, 0, 0, "STUG-2X2.dat") + block(2, 2, 2),
    "p/flat.dat": "0 BFC CERTIFY CCW\n0 BFC INVERTNEXT\n" + block(2, 2, 2),
    "p/stug-2x2.DAT": knobs(2, 2, name="Stud2.dat"),
    "parts/moved.dat": "0 ~Moved to block5x5\n" + part(0, 0, 0, "block5x5.dat"),
    "parts/incomplete.dat": block(2, 2, 3) + part(0, 0, 0, "s\\none.dat"),
    "parts/bad.dat": "0 bad\n3 16 0 0 0 1 0 0 1 x 1\n",
    "parts/short.dat": "4 16 0 0 0 1 0 0 1 1 1\n",
    "parts/garbled.dat": block(2, 2, 3) + "hello\n",
    "parts/ring.dat": part(0, 0, 0, "s\\ring.dat"),
    "parts/s/ring.dat": part(0, 0, 0, "ring.dat"),
    "parts/up.dat": part(0, 0, 0, "..\\secret.dat"),
    "parts/empty.dat": "0 nothing\n",
}


@pytest.fixture(scope="module")
def library(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A parts library of the test's own parts."""
    folder = tmp_path_factory.mktemp("ldraw")
    return write_library(folder, PARTS)


def write_library(folder: Path, parts: dict[str, str]) -> Path:
    for name, text in parts.items():
        file = folder / name
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(text)
    return folder


def read(
    folder: Path,
    text: str | bytes,
    library: Path | None = None,
    unknown: Unknown = "refuse",
) -> BrickModel:
    file = folder / "model.mpd"
    file.write_bytes(text if isinstance(text, bytes) else text.encode())
    return read_ldraw(file, library=library, unknown=unknown)


def cells(model: BrickModel) -> list[tuple[str, Cell]]:
    return [(item.brick.name, item.cell) for item in model.bricks]


def shape(library: Path, name: str) -> PartShape | str:
    return PartLibrary(library, Path("m.ldr"), {}).shape(name)


def kind_of(found: PartShape | str) -> BrickType:
    """Return the brick type that a part is where it stands as its file draws it."""
    assert isinstance(found, PartShape)
    assert not found.reason
    return found.brick(np.eye(4))[0]


@settings(max_examples=40, deadline=None)
@given(data=st.data())
def test_blocks_with_knobs_are_bricks(
    data: st.DataObject, tmp_path_factory: pytest.TempPathFactory
) -> None:
    """Of any size, anywhere in the frame of the part, at any turn, with any of the knobs that leave a grip."""
    nx, nz = data.draw(st.integers(1, 6)), data.draw(st.integers(1, 6))
    levels = data.draw(st.integers(1, 12))
    shift = data.draw(st.tuples(*[st.integers(-50, 50)] * 3))
    lines = knobs(nx, nz, shift).splitlines(keepends=True)
    lost = data.draw(st.sets(st.integers(0, len(lines) - 1), max_size=len(lines) - 1))
    kept = [line for k, line in enumerate(lines) if k not in lost]
    text = block(nx, nz, levels, shift) + "".join(kept)
    folder = write_library(tmp_path_factory.mktemp("library"), {"parts/a.dat": text})
    found = shape(folder, "a.dat")
    assert isinstance(found, PartShape)
    x, y, z = shift
    assert np.allclose(found.low, [x - 10 * nx, y, z - 10 * nz])
    assert np.allclose(found.high, [x + 10 * nx, y + 8 * levels, z + 10 * nz])
    here = {divmod(k, nz) for k in range(nx * nz) if k not in lost}
    edges = [
        [((i, k), (i, k + 1)) for i in (0, nx - 1) for k in range(nz - 1)],
        [((i, k), (i + 1, k)) for k in (0, nz - 1) for i in range(nx - 1)],
    ]
    ends = {(i, k) for i in (0, nx - 1) for k in (0, nz - 1) if 1 in (nx, nz)}
    pairs = [pair for own in edges for pair in own]
    has_grip = any(here.issuperset(pair) for pair in pairs) or bool(here & ends)
    assert (not found.reason) == has_grip, found.reason
    if not has_grip:
        return
    # The brick as it is placed has its knobs where the knobs of the part are.
    turn = data.draw(st.sampled_from(TURNS))
    pose = np.eye(4)
    pose[:3, :3] = np.reshape([float(v) for v in turn.split()], (3, 3))
    kind, turned = found.brick(pose)
    assert kind == brick_of_size((min(nx, nz), max(nx, nz)), levels, kind.bare)
    low = found.placed(pose)[0]
    placed = PlacedBrick("", kind, Cell(0, 0, 1, turned))
    middles = [
        (shift + np.array([20 * i - 10 * (nx - 1), 0, 20 * k - 10 * (nz - 1)]))
        for i, k in here
    ]
    at = [(pose[:3, :3] @ middle - low)[[0, 2]] // 20 for middle in middles]
    assert placed.knobs == {(int(i), int(k)) for i, k in at}


def test_sizes_without_a_library_type_weigh_in_proportion() -> None:
    assert brick_of_size((2, 4), 3) is BRICKS["2x4"]
    assert brick_of_size((1, 4), 1) is BRICKS["1x4-plate"]
    tall, wide = brick_of_size((1, 8), 6), brick_of_size((4, 4), 1)
    assert (tall.name, wide.name) == ("1x8x2", "4x4-plate")
    assert tall.mass == pytest.approx(2 * BRICKS["1x8"].mass)
    assert wide.mass == pytest.approx(4 * BRICKS["2x2-plate"].mass)
    assert brick_of_size((1, 2), 4).name == "1x2-4"


@pytest.mark.parametrize(
    ("name", "reason"),
    [
        ("tile2x2.dat", "no knobs at an edge"),
        ("jumper.dat", "not on the grid of its studs"),
        ("corner.dat", "no knobs at an edge"),
        ("inverse.dat", "sides do not reach"),
        ("arch.dat", "sides do not reach"),
        ("sideways.dat", "not of whole studs"),
        ("narrow.dat", "not of whole studs"),
    ],
)
def test_other_shapes_are_no_bricks(name: str, reason: str, library: Path) -> None:
    found = shape(library, name)
    assert isinstance(found, PartShape)
    assert reason in found.reason


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("none.dat", "not known in the parts library"),
        ("incomplete.dat", "parts/incomplete.dat:9: 's/none.dat': it is not known"),
        ("bad.dat", "parts/bad.dat:2: 'x' is no number"),
        ("short.dat", "parts/short.dat:1: a face of 4 corners lacks some"),
        ("garbled.dat", "parts/garbled.dat:9: 'hello' is no line of LDraw"),
        ("ring.dat", "parts/s/ring.dat:1: 'ring.dat': it contains itself"),
        ("up.dat", "parts/up.dat:1: '../secret.dat': its path leads out"),
        ("../parts/tile2x2.dat", "its path leads out"),
        ("/etc/hostname", "its path leads out"),
        ("c:/a.dat", "its path leads out"),
        ("empty.dat", "nothing is drawn in it"),
    ],
)
def test_parts_without_a_size_say_why(name: str, words: str, library: Path) -> None:
    found = shape(library, name)
    assert isinstance(found, str)
    assert words in found


def test_parts_of_parts_are_found_in_any_case(library: Path) -> None:
    for name, brick in (("by parts.dat", "2x2"), ("moved.dat", "5x5")):
        assert kind_of(shape(library, name)).name == brick


def test_links_do_not_lead_out_of_a_library(tmp_path: Path) -> None:
    secret = tmp_path / "secret.dat"
    secret.write_text(block(2, 2, 3) + knobs(2, 2))
    folder = write_library(
        tmp_path / "ldraw", {"parts/a.dat": block(1, 1, 3) + knobs(1, 1)}
    )
    (folder / "parts" / "out.dat").symlink_to(secret)
    (folder / "parts" / "inside.dat").symlink_to(folder / "parts" / "a.dat")
    (folder / "parts" / "self.dat").symlink_to(folder / "parts" / "self.dat")
    assert "is a link out of" in str(shape(folder, "out.dat"))
    assert "is a link out of" in str(shape(folder, "self.dat"))
    assert isinstance(shape(folder, "inside.dat"), PartShape)
    with pytest.raises(ScenarioError, match="no folder 'parts'"):
        read(tmp_path, part(0, 0, 0, "3001.dat"), tmp_path)


def test_files_that_multiply_are_refused_at_once(tmp_path: Path) -> None:
    """Twenty files, each with ten of the next one: 10^20 faces."""
    parts = {f"parts/m{k}.dat": 10 * part(0, 0, 0, f"m{k + 1}.dat") for k in range(20)}
    parts["parts/m20.dat"] = block(1, 1, 1)
    deep = {f"parts/d{k}.dat": part(0, 0, 0, f"d{k + 1}.dat") for k in range(40)}
    folder = write_library(tmp_path, {**parts, **deep})
    began = time.process_time()
    assert "faces" in str(shape(folder, "m0.dat"))
    assert "deep" in str(shape(folder, "d0.dat"))
    assert time.process_time() - began < 2.0


def test_a_part_of_a_library_is_placed_as_a_brick(
    library: Path, tmp_path: Path
) -> None:
    for turn in TURNS:
        text = part(0, 0, 0, "block5x5.dat", turn) + part(-40, -24, -40, "3005.dat")
        model = read(tmp_path, text, library)
        assert [name for name, _ in cells(model)] == ["5x5", "1x1"]
        assert model.bricks[1].cell == Cell(0, 0, 2)


def test_a_file_may_bring_its_parts_along(tmp_path: Path) -> None:
    """Models that were packed for the web contain the library's files, under their folders or not."""
    text = (
        "0 FILE main.ldr\n"
        + part(0, 0, 0, "parts/own.dat")
        + part(0, -24, 0, "3001.dat")
        + "0 NOFILE\n0 !DATA picture.png\n0 !: aGVsbG8=\n"
        + "0 FILE parts/own.dat\n0 !LDRAW_ORG Unofficial_Part\n"
        + part(0, 0, 0, "s\\own.dat")
        + "0 FILE parts/s/own.dat\n0 !LDRAW_ORG Subpart\n"
        + block(4, 4, 3)
        + part(0, 0, 0, "stug-4.dat")
        + "0 FILE p/stug-4.dat\n0 !LDRAW_ORG Primitive\n"
        + knobs(4, 4)
        + "0 FILE wing.dat\n0 a model of old programs\n"
        + part(0, 0, 0, "3001.dat")
    )
    model = read(tmp_path, text)
    assert cells(model) == [
        ("4x4", Cell(0, 0, 1)),
        ("2x4", Cell(0, 1, 2, turned=True)),
    ]
    assert model.notes == ()
    used = read(tmp_path, text.replace("3001.dat", "wing.dat", 1))
    assert cells(used) == cells(model)


LETTERS = (
    "0 a model\n"
    "0 !COLOUR Mine CODE 9001 VALUE #0102FF EDGE #333333\n"
    "0 BFC CERTIFY CCW\n0 BFC INVERTNEXT\n0 // comment\n0\n\n0 WRITE hello\n"
    "1 9001 0 0 0 1 0 0 0 1 0 0 0 1 3001.dat\n"
    "0 STEP\n0 ROTSTEP 0 90 0 ABS\n0 !TEXMAP START PLANAR 0 0 0 1 0 0 0 0 1 a.png\n"
    "0 !: 1 16 0 0 0 1 0 0 0 1 0 0 0 1 none.dat\n0 !TEXMAP FALLBACK\n"
    "1 0x2FF0000 2e1 -2.4E1 +0.0 1. 0 0 0 1 -0 0 0 .1e1 3003.DAT\n"
    "0 !TEXMAP END\n0 ROTSTEP END\n0 caf\u00e9\n"
)


@pytest.mark.parametrize(
    "text",
    [
        LETTERS.encode(),
        LETTERS.replace("\n", "\r\n").encode(),
        LETTERS.replace("\n", "\r").encode(),
        LETTERS.encode("utf-8-sig"),
        LETTERS.encode("latin-1"),
        LETTERS.replace("\n", "\r\n").encode("utf-16"),
        LETTERS.replace(" ", "\t").encode(),
        LETTERS.replace("\n", "   \n  ").encode(),
    ],
)
def test_the_same_model_in_other_letters(text: bytes, tmp_path: Path) -> None:
    model = read(tmp_path, text)
    assert cells(model) == [
        ("2x4", Cell(0, 0, 1, turned=True)),
        ("2x2", Cell(2, 0, 2)),
    ]
    assert [item.colour for item in model.bricks] == [(1, 2, 255), (255, 0, 0)]


@pytest.mark.parametrize(
    "turn",
    [
        "1 0 0 0 0.9659258 -0.258819 0 0.258819 0.9659258",
        "0.9659258 0 0.258819 0 1 0 -0.258819 0 0.9659258",
        "1 0 0 0 0 -1 0 1 0",
    ],
)
def test_a_model_that_is_turned_as_a_whole_stands_upright(
    turn: str, tmp_path: Path
) -> None:
    """One part of it that leans is still refused, by its line."""
    wall = (
        part(0, 0, 0, "3001.dat")
        + part(0, -24, 0, "3001.dat", TURNS[1])
        + part(0, -48, 0, "3003.dat", TURNS[2])
    )
    straight = read(tmp_path, wall)
    text = f"0 FILE a\n1 4 30 40 50 {turn} b\n0 FILE b\n"
    model = read(tmp_path, text + wall)
    assert cells(model) in (cells(straight), cells(straight.quarter_turned()))
    assert "the model stands upright, not turned as in its file" in model.notes
    leaning = part(0, -72, 0, "3003.dat", "1 0 0 0 0.8 -0.6 0 0.6 0.8")
    with pytest.raises(ScenarioError, match=r":7: 3003.dat .* is tilted by 37 degrees"):
        read(tmp_path, text + wall + leaning)


def nested(levels: int, across: int) -> str:
    """Return a model of models: ``across`` towers of as many bricks, wrapped ``levels`` deep."""
    text = ["0 FILE main.ldr\n"]
    text += [part(80 * k, 0, 0, "row 1.ldr", TURNS[0]) for k in range(across)]
    for level in range(1, levels):
        text += [f"0 FILE row {level}.ldr\n", part(0, 0, 0, f"row {level + 1}.ldr")]
    text.append(f"0 FILE row {levels}.ldr\n")
    text += [part(0, -24 * k, 0, "own.dat") for k in range(across)]
    return "".join(text)


def test_hundreds_of_parts_in_nested_models_are_read_in_seconds(
    tmp_path: Path,
) -> None:
    """529 parts of a library, five models deep: at most 5 CPU seconds."""
    folder = write_library(
        tmp_path / "ldraw", {"parts/own.dat": block(4, 4, 3) + knobs(4, 4)}
    )
    began = time.process_time()
    model = read(tmp_path, nested(5, 23), folder)
    assert time.process_time() - began < 5.0
    assert len(model.bricks) == 529
    assert model.size == (92, 4, 69)


WALL = (
    part(0, 0, 0, "3001.dat")
    + part(0, -24, 0, "3001.dat")
    + part(20, -32, 0, "tile2x2.dat")
    + part(70, 0, 0, "ramp2x2.dat", TURNS[3])
    + part(60, -24, 0, "3003.dat")
    + part(60, -48, 0, "3003.dat")
    + part(50, -72, 10, "3005.dat")
)


def test_unknown_parts_are_counted_and_both_choices_named(
    library: Path, tmp_path: Path
) -> None:
    with pytest.raises(ScenarioError) as caught:
        read(tmp_path, WALL + part(200, 0, 0, "tile2x2.dat"), library)
    text = str(caught.value)
    assert "model.mpd:3: 'tile2x2.dat' is no brick" in text
    assert "model.mpd:4: 'ramp2x2.dat' is no brick" in text
    assert "3 parts: tile2x2.dat (2), ramp2x2.dat (1)" in text
    assert "--unknown box" in text
    assert "--unknown leave-out" in text
    assert "--parts" not in text
    with pytest.raises(ScenarioError, match="--parts DIR"):
        read(tmp_path, WALL)


def test_what_only_unknown_parts_hold_is_left_out_too(tmp_path: Path) -> None:
    """The bricks above the slope, one on the other, are joined to nothing else; no library is needed."""
    model = read(tmp_path, WALL, unknown="leave-out")
    assert [item.source for item in model.bricks] == ["line 1", "line 2"]
    assert not model.obstacles
    assert "no bricks, left out: tile2x2.dat (1), ramp2x2.dat (1)" in model.notes
    assert (
        "3 left out, joined to nothing that stands on the plate:"
        " line 5 (2x2), line 6 (2x2), line 7 (1x1)" in model.notes
    )


def test_boxes_stand_where_their_parts_end_up(library: Path, tmp_path: Path) -> None:
    """The slope stands on the plate; the tile is on bricks that come first."""
    model = read(tmp_path, WALL, library, "box")
    assert [item.source for item in model.bricks] == ["line 1", "line 2"]
    (slope,) = model.obstacles
    assert slope.words == "line 4 (ramp2x2.dat)"
    # The quarter turn puts the slope's z = -30 to 10 along x.
    assert slope.low == pytest.approx((4.0, 0.0, 0.0))
    assert slope.high == pytest.approx((6.0, 2.0, 3.0))
    assert model.size == (6, 2, 6)
    assert (
        "1 left out, on bricks, which come first: line 3 (tile2x2.dat)" in model.notes
    )
    turned = model.quarter_turned()
    (box,) = turned.obstacles
    assert box.low[:2] == pytest.approx((0.0, 4.0))
    assert box.high[:2] == pytest.approx((2.0, 6.0))
    with pytest.raises(ScenarioError, match=r":3: 'tile2x2.dat' has no size for a box"):
        read(tmp_path, WALL, None, "box")


def test_every_grip_of_a_long_brick_has_a_number_of_its_own() -> None:
    for studs in ((1, 10), (2, 16), (8, 16)):
        presses = legal_presses(brick_of_size(studs, 3))
        numbers = [grasp_number(press) for press in presses]
        assert [press_from_number(n) for n in numbers] == list(presses)


def test_a_slope_is_held_by_its_knobs(library: Path, tmp_path: Path) -> None:
    """At every turn the grips are on the two knobs, and only what is on these is joined to it."""
    kinds = set()
    for turn in TURNS:
        # The middle of the slope is 10 behind its origin.
        ahead = np.reshape([float(v) for v in turn.split()], (3, 3)) @ [0, 0, 10]
        x, y, z = ahead.tolist()
        text = part(x, y, z, "slope2x2.dat", turn) + part(0, 24, 0, "16x16.dat")
        own = {**PARTS, "parts/16x16.dat": block(16, 16, 3) + knobs(16, 16)}
        model = read(tmp_path, text, write_library(tmp_path / "own", own))
        slope, floor = model.bricks
        kinds.add(slope.brick)
        (grip,) = legal_presses(slope.brick)
        item = PlacedBrick("slope", slope.brick, slope.cell)
        cell = press_cell(item, grip, up=False)
        pair = PlacedBrick("", BRICKS["1x2"], cell)
        assert pair.studs == item.knobs
        base = PlacedBrick("floor", floor.brick, floor.cell)
        above = Cell.at_level(slope.cell.x, slope.cell.y, item.span.top)
        upper = PlacedBrick("upper", BRICKS["2x2"], above)
        bricks = {b.name: b for b in (base, item, upper)}
        joints = {
            j.upper: set(j.studs) for j in find_joints(bricks, filled_places(bricks))
        }
        assert joints["upper"] == item.knobs
        assert joints["slope"] == item.studs
    # Each turn of a square part has knobs of its own.
    assert len(kinds) == 4


def test_colours_of_a_library(tmp_path: Path) -> None:
    """Those of the model's file come first, then those of the library's, then the known ones."""
    line = "0 !COLOUR Mine CODE {} VALUE #{} EDGE #333333\n"
    folder = write_library(
        tmp_path / "ldraw",
        {
            "parts/a.dat": "",
            "LDConfig.LDR": line.format(901, "010203") + line.format(902, "040506"),
        },
    )
    bricks = [
        part(0, -24 * k, 0, "3001.dat").replace("1 4", f"1 {code}")
        for k, code in enumerate((901, 902, 4, 903))
    ]
    text = line.format(902, "070809") + "".join(bricks)
    model = read(tmp_path, text, folder)
    colours = [item.colour for item in model.bricks]
    assert colours == [(1, 2, 3), (7, 8, 9), (201, 26, 9), None]
    assert "bricks of colour 903, which" in model.notes[0]


def test_a_part_that_is_packed_twice_is_read_once(tmp_path: Path) -> None:
    own = block(2, 2, 3) + knobs(2, 2)
    text = "0 FILE main.ldr\n" + part(0, 0, 0, "own.dat")
    text += "0 FILE own.dat\n" + own + "0 FILE OWN.DAT\n" + block(9, 9, 1)
    assert cells(read(tmp_path, text)) == [("2x2", Cell(0, 0, 1))]


def test_the_largest_group_stands_where_little_else_does(tmp_path: Path) -> None:
    """A wheel's plate below, a tower of twelve on an unknown part above it."""
    tower = [part(0, -96 - 24 * k, 0, "3001.dat") for k in range(12)]
    text = part(0, 0, 0, "3003.dat") + part(0, -50, 0, "none.dat") + "".join(tower)
    model = read(tmp_path, text, unknown="leave-out")
    assert len(model.bricks) == 12
    assert model.size == (4, 2, 36)
    assert any("below the largest group" in note for note in model.notes)
