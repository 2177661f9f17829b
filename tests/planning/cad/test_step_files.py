"""STEP files that are not valid: refused with the place, without harm to the program."""

import re
from pathlib import Path

import numpy as np
import pytest

from planning.cad import step_file
from planning.cad.glb_bodies import read_bodies
from planning.cad.part_types import readable_name, sort_by_shape, unique_names
from planning.cad.step_file import read_assembly, triangulate_step
from planning.cad.step_text import check_step_text
from planning.errors import RequestError

PEGS = Path(__file__).parent / "pegs.step"
GOOD = PEGS.read_bytes()
FINE = 1e-5


def line_of(content: bytes, found: bytes) -> int:
    return content.count(b"\n", 0, content.index(found)) + 1


def replaced(old: bytes, new: bytes) -> bytes:
    assert old in GOOD
    return GOOD.replace(old, new, 1)


CUT = GOOD[:9000]
TWICE = replaced(b"\n#20 = ", b"\n#19 = ")
MISSING = re.sub(rb"\n#40 = [^;]*;", b"", GOOD, count=1)
FIRST_POINT = re.search(rb"CARTESIAN_POINT\('',\([^)]*\)\)", GOOD)
assert FIRST_POINT is not None

BY_TEXT = {
    "empty": (b"", 1, "the file is empty"),
    "blank": (b" \n\n ", 1, "the file is empty"),
    "other text": (b"solid cube\nfacet normal 0 0 1\n", 1, "this is no STEP file"),
    "noise": (bytes(range(256)) * 100, 1, "this is no STEP file"),
    "another standard": (
        replaced(b"ISO-10303-21;", b"ISO-10303-28;"),
        1,
        "this is no STEP file",
    ),
    "cut off": (CUT, CUT.count(b"\n") + 1, "the file is cut off"),
    "no schema": (replaced(b"FILE_SCHEMA", b"FILE_SCHEMO"), 2, "no FILE_SCHEMA"),
    "another schema": (
        replaced(b"AUTOMOTIVE_DESIGN", b"IFC2X3"),
        line_of(GOOD, b"FILE_SCHEMA"),
        "schema 'IFC2X3",
    ),
    "no header": (replaced(b"HEADER;", b"HEAD;"), 1, "has no HEADER"),
    "no entities": (
        GOOD[: GOOD.index(b"#1 = ")] + b"ENDSEC;\nEND-ISO-10303-21;\n",
        line_of(GOOD, b"DATA;"),
        "no entities",
    ),
    "given twice": (TWICE, line_of(GOOD, b"\n#20 = ") + 1, "entity #19 is given twice"),
    "missing": (
        MISSING,
        line_of(MISSING, b"#40"),
        "entity #40 is not in the file",
    ),
    "huge": (
        replaced(FIRST_POINT[0], b"CARTESIAN_POINT('',(1.E25,0.,0.))"),
        line_of(GOOD, FIRST_POINT[0]),
        "coordinate '1.E25' is no number",
    ),
    "not a number": (
        replaced(FIRST_POINT[0], b"CARTESIAN_POINT('',(NaN,0.,0.))"),
        line_of(GOOD, FIRST_POINT[0]),
        "coordinate 'NaN' is no number",
    ),
}


@pytest.mark.parametrize("case", BY_TEXT)
def test_what_the_text_shows_is_refused_at_its_line(case: str) -> None:
    content, line, words = BY_TEXT[case]
    with pytest.raises(RequestError) as found:
        check_step_text(Path("a.step"), content)
    place, _, message = found.value.message.partition(":1: ")
    assert place == f"a.step:{line}"
    assert words in message


def test_strings_and_comments_are_no_entities() -> None:
    text = b"'it''s #123 = (' /* #7 = #8 */"
    check_step_text(PEGS, GOOD)
    check_step_text(
        PEGS, replaced(b"PRODUCT('pegs','pegs'", b"PRODUCT(" + text + b",''")
    )


BY_KERNEL: dict[str, tuple[bytes, str]] = {
    "syntax": (replaced(b";\n#20 = ", b"\n#20 = "), "cannot read 1 of its entities"),
    "solid of itself": (
        re.sub(
            rb"(#\d+) = MANIFOLD_SOLID_BREP\('',#\d+\)",
            rb"\1 = MANIFOLD_SOLID_BREP('',\1)",
            GOOD,
        ),
        "refers to itself",
    ),
    "brackets": (replaced(b"\n#20 = ", b"\n#20 = )("), "a.step:"),
    "arguments": (
        re.sub(rb"AXIS2_PLACEMENT_3D\([^)]*\)", b"AXIS2_PLACEMENT_3D('')", GOOD),
        "the CAD kernel crashed on it (SIG",
    ),
}


BY_DAY = "solid of itself"
"""Case that the kernel reads by day: each takes a second."""


def refusal(path: Path) -> str:
    """Return why a file is refused, of whatever kind."""
    with pytest.raises(RequestError) as found:
        read_assembly(path)
    return found.value.message


@pytest.mark.parametrize(
    "case",
    [
        pytest.param(case, marks=() if case == BY_DAY else pytest.mark.nightly)
        for case in BY_KERNEL
    ],
)
def test_what_the_kernel_refuses_is_refused(case: str, tmp_path: Path) -> None:
    content, words = BY_KERNEL[case]
    path = tmp_path / "a.step"
    path.write_bytes(content)
    message = refusal(path)
    assert message.startswith(str(path))
    assert words in message


def test_what_is_no_file_is_refused(tmp_path: Path) -> None:
    assert "this is a folder" in refusal(tmp_path)
    assert "no such file" in refusal(tmp_path / "a.step")
    assert "no regular file" in refusal(Path("/dev/zero"))


@pytest.mark.parametrize(
    ("limit", "value", "words"),
    [("_SECONDS", 0, "takes more than 0 s"), ("_MEMORY", 1 << 27, "")],
)
def test_the_process_is_limited(
    limit: str, value: int, words: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(step_file, limit, value)
    assert words in refusal(PEGS)


def test_bodies_have_names_colours_and_places() -> None:
    bodies, notes = read_bodies(triangulate_step(PEGS, FINE))
    assert not notes
    plate, *pegs = sort_by_shape(bodies)
    assert plate.name == "base_plate"
    assert plate.placed[0].body.colour == (88, 118, 152)
    (peg,) = pegs
    assert peg.name == "peg"
    assert [own.name for own in peg.placed] == ["peg", "peg_2"]
    # One is in an assembly of its own, upside down: of a cylinder that is the same.
    for own, x in zip(peg.placed, (-0.025, 0.025), strict=True):
        np.testing.assert_allclose(own.pose[:3, :3], np.eye(3), atol=1e-9)
        np.testing.assert_allclose(own.pose[:3, 3], [x, 0.0, 0.01], atol=1e-7)


@pytest.mark.nightly
@pytest.mark.parametrize(
    ("unit", "scale"),
    [(b"SI_UNIT(.MILLI.,.METRE.)", 1.0), (b"SI_UNIT($,.METRE.)", 1e3)],
)
def test_units_of_the_file_count(unit: bytes, scale: float, tmp_path: Path) -> None:
    path = tmp_path / "a.step"
    path.write_bytes(GOOD.replace(b"SI_UNIT(.MILLI.,.METRE.)", unit))
    bodies, _ = read_bodies(triangulate_step(path, FINE * scale))
    size = np.ptp(bodies[0].vertices, axis=0)
    np.testing.assert_allclose(size, scale * np.array([0.09, 0.06, 0.02]), rtol=1e-6)


@pytest.mark.parametrize(
    ("names", "expected"),
    [
        (("Stützplatte #3", ""), "Stutzplatte_3"),
        (("Ã¼ber", ""), "uber"),
        (("SOLID", "left bracket"), "left_bracket"),
        (("=>[0:1:1:2]", "NAUO12"), "part"),
        (("螺丝", ""), "part"),
        (("true", ""), "part_true"),
        (("12-34", ""), "part"),
        (("a.1", ""), "a_1"),
        (("x" * 300, ""), "x" * 56),
    ],
)
def test_names_become_valid(names: tuple[str, str], expected: str) -> None:
    assert readable_name(names) == expected


def test_names_are_unique() -> None:
    found = unique_names(["pin", "Pin", "pin_2", "pin"], {"table": None})
    assert found == ["pin", "Pin_2", "pin_2_2", "pin_3"]
    assert len({name.lower() for name in found}) == 4
