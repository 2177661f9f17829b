"""``twin import bricks`` and ``ldraw``, ``twin export --format ldraw``: there and back, and cells."""

import json
import re
import shutil
from pathlib import Path

import pytest
import yaml
from typer.testing import Result

from planning.lego.importers.apex_mr.importer import HOME_DEG
from planning.lego.importers.brick_models.cell import APART
from planning.lego.importers.brick_models.ldraw import read_ldraw
from planning.robots.registry import robot_model
from tests.twin.program import invoke
from twin.kinds.lego.kind import build_lego, build_structure
from twin.kinds.lego.section import LegoSection
from twin.reading.scenario_file import load_scenario

ROOT = Path(__file__).parents[3]
DESIGNS = sorted((ROOT / "scenarios" / "lego").glob("*.yaml"))


def lego(path: Path) -> LegoSection:
    section = load_scenario(path).assembly
    assert isinstance(section, LegoSection)
    return section


def built(path: Path) -> list[tuple[str, int, int, int, int, int]]:
    """Return type and span of each brick that a scenario builds or builds upon, from its corner."""
    section = lego(path)
    assembly = build_lego(section)
    bricks = [*(build_structure(section) or assembly.structure), *assembly.scaffold]
    spans = [(b.brick.name, b.span) for b in bricks]
    x, y = min(s.x0 for _, s in spans), min(s.y0 for _, s in spans)
    return sorted(
        (name, s.x0 - x, s.x1 - x, s.y0 - y, s.y1 - y, s.bottom) for name, s in spans
    )


def test_there_are_nine_designs() -> None:
    assert len(DESIGNS) == 9


@pytest.mark.parametrize("design", DESIGNS, ids=lambda f: f.stem)
def test_designs_come_back_from_ldraw(design: Path, tmp_path: Path) -> None:
    """The same bricks at the same cells, up to a shift; found again by LDraw's reader alone."""
    model, scenario = tmp_path / "model.ldr", tmp_path / "back.yaml"
    invoke("export", design, "--format", "ldraw", "-o", model, code=0)
    invoke("import", "ldraw", model, "-o", scenario, code=0)
    back = lego(scenario)
    bricks = build_structure(back) or ()
    expected = built(design)
    spans = [(b.brick.name, b.span) for b in bricks]
    x, y = min(s.x0 for _, s in spans), min(s.y0 for _, s in spans)
    found = [(n, s.x0 - x, s.x1 - x, s.y0 - y, s.y1 - y, s.bottom) for n, s in spans]
    assert sorted(found) == expected


@pytest.mark.nightly
def test_a_run_is_exported_step_by_step(tmp_path: Path) -> None:
    """Of a run: a step an assembly step in the order of the plan, scaffolding before the first."""
    run, model = tmp_path / "run", tmp_path / "faucet.ldr"
    design = ROOT / "scenarios" / "lego" / "faucet.yaml"
    invoke("run", design, "--out", run, "--no-audit", "--no-recording", code=0)
    invoke("export", run, "--format", "ldraw", "-o", model, code=0)
    content = model.read_bytes().decode()
    assert content.count("\r\n") == content.count("\n")
    lines = content.splitlines()
    assert lines[:3] == ["0 faucet", "0 Name: faucet.ldr", "0 Author: assembly-twin"]
    groups = "\n".join(lines[4:]).split("0 STEP")
    fixed = [s for s in lego(ROOT / "scenarios/lego/faucet.yaml").stock if s.fixed]
    assert groups[0].count(".dat") == len(fixed) > 0
    steps = groups[1:-1]
    assert all(group.count(".dat") == 1 for group in steps)
    numbers = [int(n) for group in steps for n in re.findall(r"// step (\d+)", group)]
    assert numbers == list(range(1, len(steps) + 1))
    # Each brick lies where its place puts it, in the colour of the replay.
    plan = json.loads((run / "plan.json").read_text())
    colours = {tuple(item["colour"]) for item in plan["cell"]["objects"]}
    for line in lines:
        if line.startswith("1 "):
            rgb = bytes.fromhex(line.split()[1][3:])
            assert tuple(rgb) in colours
    expected = built(ROOT / "scenarios/lego/faucet.yaml")
    read = read_ldraw(model)
    spans = [(i.brick.name, i.span) for i in read.bricks]
    assert sorted((n, *s[:5]) for n, s in spans) == expected


LIST = "2x4 (0,0,0)\n2x4 (0,0,1)\n1x2 (0,0,2)\n2x2 (0,2,2)\n"
MIXED = """1 4 0 0 0 1 0 0 0 1 0 0 0 1 3001.dat
1 2 0 -8 0 1 0 0 0 1 0 0 0 1 3020.dat
1 1 20 -16 0 1 0 0 0 1 0 0 0 1 3022.dat
"""


def imported(folder: Path, text: str, *options: object) -> tuple[Result, Path]:
    kind, name = (
        ("ldraw", "m.ldr") if text.startswith(("0", "1 ")) else ("bricks", "m.txt")
    )
    (folder / name).write_text(text)
    out = folder / "out.yaml"
    return invoke("import", kind, folder / name, "-o", out, *options), out


def test_a_cell_is_chosen_with_room_between_stations(tmp_path: Path) -> None:
    result, out = imported(tmp_path, MIXED)
    assert result.exit_code == 0, result.output
    assert "3 bricks of 3 types, 4 x 2 studs, 1.667 bricks high" in result.output
    section = lego(out)
    assembly = build_lego(section)
    structure = build_structure(section) or ()
    mine = [b.span for b in structure]
    feeds = [item for item in assembly.stock if item.station]
    assert sorted(f.name for f in feeds) == sorted(
        f"{side}_{kind}"
        for side in ("left", "right")
        for kind in ("2x4", "2x4-plate", "2x2-plate")
    )
    spans = {f.name: f.span for f in feeds}
    for name, a in spans.items():
        for other, b in spans.items():
            apart = max(a.x0 - b.x1, b.x0 - a.x1, a.y0 - b.y1, b.y0 - a.y1)
            assert name == other or apart >= APART
        assert all(max(a.x0 - s.x1, s.x0 - a.x1) > APART for s in mine)
        # Plates are fed from on top of a fixed brick, bricks from the plate.
        assert (a.bottom == 3) == name.endswith("-plate")
    assert sum(item.fixed for item in assembly.stock) == 4
    # In the middle of the plate, as near as whole studs allow.
    assert (min(s.x0 for s in mine), max(s.x1 for s in mine)) == (22, 26)
    assert (min(s.y0 for s in mine), max(s.y1 for s in mine)) == (23, 25)


def test_what_is_imported_is_planned_and_stands(tmp_path: Path) -> None:
    """Plates from their stands, onto a brick: a run from the file of LDraw to a clean audit."""
    _, out = imported(tmp_path, MIXED)
    invoke("run", out, "--out", tmp_path / "run", "--no-recording", code=0)
    summary = json.loads((tmp_path / "run" / "summary.json").read_text())
    assert summary["outcome"] == "completed"
    back = tmp_path / "back.ldr"
    invoke("export", tmp_path / "run", "--format", "ldraw", "-o", back)
    bricks = {(i.brick.name, i.cell, i.colour) for i in read_ldraw(back).bricks}
    assert bricks == {
        (i.brick.name, i.cell, i.colour) for i in read_ldraw(tmp_path / "m.ldr").bricks
    }
    assert len({colour for *_, colour in bricks}) == 3


def test_colours_stay_with_their_bricks(tmp_path: Path) -> None:
    """From LDraw to steps and back to LDraw, without a run; other objects keep their own."""
    _, out = imported(tmp_path, MIXED)
    steps, back = tmp_path / "steps.yaml", tmp_path / "back.ldr"
    invoke("sequence", out, "-o", steps, code=0)
    given = {tuple(step.colour or ()) for step in lego(steps).steps}
    assert given == {(201, 26, 9), (37, 122, 62), (0, 85, 191)}
    invoke("export", steps, "--format", "ldraw", "-o", back)
    assert {i.colour for i in read_ldraw(back).bricks} == given


def test_another_cell_keeps_its_robots_plate_and_stock(tmp_path: Path) -> None:
    chair = ROOT / "scenarios" / "lego" / "chair.yaml"
    text = "2x4 (0,0,0)\n2x4 (0,0,1)\n2x2 (0,2,2)\n"
    result, out = imported(tmp_path, text, "--cell", chair)
    assert result.exit_code == 0, result.output
    new, old = yaml.safe_load(out.read_text()), yaml.safe_load(chair.read_text())
    assert new["cell"] == old["cell"]
    for key in ("plate", "stock"):
        assert new["assembly"][key] == old["assembly"][key]
    assert len(new["assembly"]["structure"]["bricks"]) == 3


def test_another_cell_may_lack_bricks_or_room(tmp_path: Path) -> None:
    cliff = ROOT / "scenarios" / "lego" / "cliff.yaml"
    result, out = imported(tmp_path, LIST, "--cell", cliff)
    assert result.exit_code == 2
    assert "the structure needs 1 bricks 1x2, but the stock has 0" in result.output
    assert not out.exists()
    wide = "".join(f"2x4 ({2 * k},0,0)\n2x4 ({2 * k + 1},0,1)\n" for k in range(23))
    tall = wide + "".join(
        f"4x2 (0,{2 * k},2)\n4x2 (0,{2 * k + 1},3)\n" for k in range(23)
    )
    result, _ = imported(tmp_path, tall, "--cell", cliff)
    assert result.exit_code == 2
    assert "in the middle stand" in result.output


def test_what_fits_turned_is_turned(tmp_path: Path) -> None:
    """40 studs along x are too many, along y they are not: a row with a post at its end."""
    row = [f"8x1 ({4 * k},0,{k % 2})\n" for k in range(9)]
    result, out = imported(tmp_path, "".join([*row, "1x2 (39,0,1)\n"]))
    assert result.exit_code == 0, result.output
    assert "turned by a quarter turn" in result.output
    spans = [b.span for b in build_structure(lego(out)) or ()]
    x, y = min(s.x0 for s in spans), min(s.y0 for s in spans)
    assert [s.y0 - y for s in spans[:-1]] == [4 * k for k in range(9)]
    # What was towards greater y is towards lesser x now.
    assert (spans[-1].x0 - x, spans[-1].x1 - x, spans[0].x0 - x) == (0, 2, 1)


def test_what_is_too_large_is_told_by_its_size(tmp_path: Path) -> None:
    row = "".join(f"8x1 ({4 * k},0,{k % 2})\n" for k in range(12))
    result, out = imported(tmp_path, row)
    assert result.exit_code == 2
    assert "covers 52 x 1 studs; 34 x 48 fit" in result.output
    assert not out.exists()


@pytest.mark.nightly
def test_what_no_arm_reaches_is_told(tmp_path: Path) -> None:
    tower = "".join(f"2x4 (0,0,{z})\n" for z in range(60))
    result, out = imported(tmp_path, tower)
    assert result.exit_code == 2
    assert (
        "2x4_29 (2x4 at [23, 22, 29]): no robot reaches where it goes" in result.output
    )
    assert not out.exists()


def test_only_lego_goes_to_ldraw(tmp_path: Path) -> None:
    other = next((ROOT / "scenarios").glob("**/tower.yaml"))
    result = invoke(
        "export", other, "--format", "ldraw", "-o", tmp_path / "a.ldr", code=2
    )
    assert "only a LEGO assembly" in result.output


def test_stations_that_find_no_room_are_told(tmp_path: Path) -> None:
    """Beside 34 studs there is one column of stations, too short for twelve types."""
    row = [f"8x1 ({4 * k},0,{k % 2})\n" for k in range(7)] + ["6x2 (28,0,1)\n"]
    sizes = ("2x4", "2x6", "2x8", "1x2", "2x2", "1x4", "1x6", "2x3", "1x3", "1x1")
    column = [f"{size} (32,0,{k})\n" for k, size in enumerate(sizes, start=2)]
    result, out = imported(tmp_path, "".join([*row, *column]))
    assert result.exit_code == 2
    assert "no room for a feeding station of" in result.output, result.output
    assert "--cell" in result.output
    assert not out.exists()


def test_another_cell_may_have_robots_of_its_own(tmp_path: Path) -> None:
    """A description beside the other scenario is found from where the new one is written."""
    there, here = tmp_path / "there", tmp_path / "here"
    there.mkdir()
    here.mkdir()
    source = next((ROOT / "planning").rglob("gp4.urdf"))
    shutil.copy(source, there / "arm.urdf")
    shutil.copytree(source.parent / "meshes", there / "meshes")
    frames = {
        name: {"xyz_m": pose[:3, 3].tolist()}
        for name, pose in robot_model("gp4").frames.items()
    }
    content = yaml.safe_load((ROOT / "scenarios" / "lego" / "cliff.yaml").read_text())
    for robot in content["cell"]["robots"]:
        robot |= {"model": "arm.urdf", "frames": frames, "home_deg": list(HOME_DEG)}
    (there / "cell.yaml").write_text(yaml.safe_dump(content))
    text = "2x4 (0,0,0)\n2x4 (0,0,1)\n"
    result, out = imported(here, text, "--cell", there / "cell.yaml")
    assert result.exit_code == 0, result.output
    models = {r["model"] for r in yaml.safe_load(out.read_text())["cell"]["robots"]}
    assert models == {"../there/arm.urdf"}
    invoke("validate", out, code=0)


def test_a_plate_is_placed_where_the_wall_passes_a_brick(tmp_path: Path) -> None:
    """The wall beside the plate's grip stands between the brick below it and one two studs away."""
    text = "\n".join(
        [
            "1 4 20 0 80 0 0 -1 0 1 0 1 0 0 3007.dat",
            "1 4 80 0 40 1 0 0 0 1 0 0 0 1 3003.dat",
            "1 4 30 -8 60 0 0 -1 0 1 0 1 0 0 3023.dat",
        ]
    )
    _, out = imported(tmp_path, text)
    options = ("--out", tmp_path / "run", "--no-recording", "--seed", "0")
    invoke("run", out, *options, code=0)
    summary = json.loads((tmp_path / "run" / "summary.json").read_text())
    assert summary["outcome"] == "completed"


UPRIGHT = "1 0 0 0 1 0 0 0 1"
BLOCK = """0 FILE block.dat
0 !LDRAW_ORG Unofficial_Part
4 16 -20 0 -20 20 0 -20 20 24 -20 -20 24 -20
4 16 -20 0 20 20 0 20 20 24 20 -20 24 20
"""
BESIDE = f"""0 FILE wall.ldr
1 4 0 0 0 {UPRIGHT} 3001.dat
1 4 0 -24 0 {UPRIGHT} 3001.dat
1 2 60 0 0 {UPRIGHT} block.dat
1 2 60 -24 0 {UPRIGHT} 3003.dat
1 1 0 -32 0 {UPRIGHT} 3031.dat
"""
"""A wall beside an own part, with a brick on that part, and a plate of 4 x 4 studs on the wall."""


def test_boxes_become_fixtures_and_new_sizes_types(tmp_path: Path) -> None:
    result, out = imported(tmp_path, BESIDE + BLOCK, "--unknown", "box")
    assert result.exit_code == 0, result.output
    assert "boxes from the start: block.dat (1)" in result.output
    assert "1 left out, joined to nothing" in result.output
    assert "line 5 (2x2)" in result.output
    scenario = load_scenario(out)
    section = lego(out)
    assert set(section.bricks) == {"4x4", "4x4-plate"}  # the plate, and its stand
    (box,) = [f for f in scenario.cell.fixtures if f.name.startswith("obstacle")]
    assert box.name == "obstacle_1_block"
    assert box.size_m == pytest.approx((0.015, 0.015, 0.0086))
    # The model covers 6 x 4 studs: the part is beside the middle two of them.
    wall = next(b for b in build_structure(section) or () if b.cell.level == 0)
    x = 0.44 + (wall.span.x1 + 1 - 24) * 0.008
    y = ((wall.span.y0 + wall.span.y1) / 2 - 24) * 0.008
    assert box.pose.xyz_m == pytest.approx((x, y, 1.1145 + 0.0048))
    invoke("validate", out, code=0)
    back = tmp_path / "back.ldr"
    invoke("export", out, "--format", "ldraw", "-o", back, code=0)
    assert back.read_text().count("3031.dat") == 1


def test_boxes_stand_in_another_cell_too(tmp_path: Path) -> None:
    """On a plate that is turned: the box is where the bricks of the model say."""
    cell = yaml.safe_load((ROOT / "scenarios" / "lego" / "cliff.yaml").read_text())
    pose = cell["assembly"]["plate"]["pose"]
    pose["rpy_deg"] = [0, 0, 90]
    (tmp_path / "cell.yaml").write_text(yaml.safe_dump(cell))
    text = "".join(BESIDE.splitlines(keepends=True)[:4]) + BLOCK
    options = ("--unknown", "box", "--cell", tmp_path / "cell.yaml")
    result, out = imported(tmp_path, text, *options)
    assert result.exit_code == 0, result.output
    section, scenario = lego(out), load_scenario(out)
    plate = build_lego(section).plate
    (box,) = [f for f in scenario.cell.fixtures if f.name.startswith("obstacle")]
    assert box.pose.rpy_deg == pytest.approx((0, 0, 90))
    wall = next(b for b in build_structure(section) or () if b.cell.level == 0)
    nx, ny = plate.studs
    local = ((wall.span.x1 + 1 - nx / 2) * 0.008, (wall.span.y0 + 1 - ny / 2) * 0.008)
    expected = plate.pose @ [*local, 0.0048, 1.0]
    assert box.pose.xyz_m == pytest.approx(tuple(expected[:3]))


@pytest.mark.nightly
def test_bricks_are_placed_beside_a_box(tmp_path: Path) -> None:
    text = "".join(BESIDE.splitlines(keepends=True)[:4]) + BLOCK
    _, out = imported(tmp_path, text, "--unknown", "box")
    run = tmp_path / "run"
    invoke("run", out, "--out", run, "--no-recording", code=0)
    summary = json.loads((run / "summary.json").read_text())
    assert summary["outcome"] == "completed"
    assert summary["audit"]["violations"] == []


SLOPES = f"""0 FILE roof.ldr
1 4 0 0 0 {UPRIGHT} 3001.dat
1 4 0 0 80 {UPRIGHT} 3001.dat
1 4 0 -24 10 {UPRIGHT} slope.dat
1 4 0 -24 70 -1 0 0 0 1 0 0 0 -1 slope.dat
1 4 0 -48 40 0 0 1 0 1 0 -1 0 0 3001.dat
0 FILE slope.dat
0 !LDRAW_ORG Unofficial_Part
4 16 -40 0 10 40 0 10 40 24 10 -40 24 10
4 16 -40 20 -30 40 20 -30 40 24 -30 -40 24 -30
4 16 -40 0 10 -40 0 -10 -40 20 -30 -40 24 -30
3 16 -40 0 10 -40 24 10 -40 24 -30
4 16 40 0 10 40 0 -10 40 20 -30 40 24 -30
3 16 40 0 10 40 24 10 40 24 -30
1 16 -30 0 0 {UPRIGHT} stud.dat
1 16 -10 0 0 {UPRIGHT} stud.dat
1 16 10 0 0 {UPRIGHT} stud.dat
1 16 30 0 0 {UPRIGHT} stud.dat
"""
"""Two slopes with a row of knobs each, a stud between their backs, and a brick on some of these knobs."""


def test_slopes_become_types_with_bare_studs(tmp_path: Path) -> None:
    result, out = imported(tmp_path, SLOPES)
    assert result.exit_code == 0, result.output
    types = lego(out).bricks
    assert {k: v.studs for k, v in types.items()} == {
        "2x4-knobs-f": (2, 4),
        "2x4-knobs-f0": (2, 4),
    }
    rows = {tuple(x for x, _ in v.bare) for v in types.values()}
    assert rows == {(0, 0, 0, 0), (1, 1, 1, 1)}
    invoke("sequence", out, code=0)
    result = invoke("export", out, "--format", "ldraw", "-o", tmp_path / "a.ldr")
    assert result.exit_code == 2
    assert "no part that is known here for 2x4-knobs-f" in result.output
    # A step may not hold a slope where it has no knobs, and a type needs a grip.
    content = yaml.safe_load(out.read_text())
    slope = next(
        b for b in content["assembly"]["structure"]["bricks"] if "f0" in b["brick"]
    )
    floor = {"brick": "2x4", "at": [*slope["at"][:2], 1], "turned": True}
    press = {"side": 4, "offset": 0}
    del content["assembly"]["structure"], slope["colour"]
    content["assembly"]["steps"] = [floor, {**slope, "press": press}]
    out.write_text(yaml.safe_dump(content))
    refused = invoke("validate", out)
    assert refused.exit_code == 2
    assert "a 2x4-knobs-f0 has no knobs there" in refused.output
    press["side"] = 1
    out.write_text(yaml.safe_dump(content))
    invoke("validate", out, code=0)
    bare = content["assembly"]["bricks"]["2x4-knobs-f"]["bare"]
    bare += [[1, 1], [1, 3]]
    out.write_text(yaml.safe_dump(content))
    assert "no two knobs at an edge" in invoke("validate", out).output
    bare[-1] = [2, 3]
    out.write_text(yaml.safe_dump(content))
    assert "beyond 2 x 4" in invoke("validate", out).output


@pytest.mark.nightly
def test_slopes_are_held_by_their_knobs(tmp_path: Path) -> None:
    _, out = imported(tmp_path, SLOPES)
    run = tmp_path / "run"
    invoke("run", out, "--out", run, "--no-recording", code=0)
    summary = json.loads((run / "summary.json").read_text())
    assert summary["outcome"] == "completed"
    assert summary["audit"]["violations"] == []


GOOD = f"1 4 0 0 0 {UPRIGHT} 3001.dat\n"


@pytest.mark.parametrize(
    ("text", "place"),
    [
        (GOOD + "1 4 0 0 0 1 0 0 0 1 0 0 3001.dat\n", ":2: a part has 15 values"),
        (GOOD + GOOD.replace(" 0 0 0", " 0 0 0x10", 1), ":2: '0x10' is no number"),
        (GOOD + GOOD.replace("1 4", "1 4.5"), ":2: '4.5' is no colour"),
        (GOOD + "6 4 0 0 0\n", ":2: '6 4 0 0 0' is no line of LDraw"),
        (GOOD + "0 " + "x" * 20_000 + "\n", ":2: a line of 20002 characters"),
        (
            "0 FILE a.ldr\n" + GOOD + GOOD.replace("3001.dat", "a.ldr"),
            ":3: models within models",
        ),
        ("0 FILE a.ldr\n" + GOOD + "0 FILE A.LDR\n", ":3: a model before it"),
        (GOOD + GOOD.replace("3001", "../../etc/x"), ":2: '../../etc/x.dat' is no"),
        (
            GOOD + GOOD.replace("3001", "block") + "0 FILE block.dat\n3 16 0 0 1\n",
            "m.ldr:4: a face of 3 corners lacks some",
        ),
        (
            "0 FILE a.ldr\n"
            + GOOD
            + GOOD.replace("3001", "block")
            + "0 FILE block.dat\n3 16 0 0 1e9 1 1 1 2 2 2\n",
            "m.ldr:5: 1e9 is no length",
        ),
    ],
)
def test_malformed_models_are_refused_by_line(
    text: str, place: str, tmp_path: Path
) -> None:
    (tmp_path / "m.ldr").write_text(text)
    result = invoke(
        "import", "ldraw", tmp_path / "m.ldr", "-o", tmp_path / "a.yaml", code=2
    )
    assert f"m.ldr{place.removeprefix('m.ldr')}" in result.output
    assert not (tmp_path / "a.yaml").exists()


def test_options_of_the_import_are_checked(tmp_path: Path) -> None:
    result, _ = imported(tmp_path, MIXED, "--unknown", "maybe")
    assert result.exit_code == 2
    assert "refuse, box, leave-out" in result.output
    result, _ = imported(tmp_path, MIXED, "--parts", tmp_path)
    assert result.exit_code == 2
    assert "no parts library of LDraw" in result.output
