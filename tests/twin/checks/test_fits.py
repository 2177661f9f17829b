"""Parts in each other: what is told, what is refused, what may be; a hair to either side."""

import math
from pathlib import Path

import pytest
import trimesh

from planning.errors import InfeasibleStepError
from planning.parts.part_steps import part_steps
from tests.planted import planted
from tests.twin.written import Change, loaded, refusal
from twin.checks.finding import CheckContext, Finding
from twin.checks.placements import check_starts
from twin.kinds.parts.checks.context import ordered_parts
from twin.kinds.parts.checks.places import check_goals
from twin.kinds.parts.fits import KnownFit
from twin.trial.simulation import scenario_execution

CELL = """\
version: 1
name: fit
cell:
  tools:
    cup: {shapes: [{cylinder: {radius_m: 0.02, length_m: 0.1}, pose: {xyz_m: [0, 0, 0.05]}}], tcp: {xyz_m: [0, 0, 0.1]}, suction: true}
  robots:
    - {name: arm, model: ur5e, tool: cup, base: {xyz_m: [-0.5, 0, 0]}, home_deg: [0, -100, 110, -100, -90, 0]}
  fixtures:
    - {name: table, size_m: [2, 2, 0.04], pose: {xyz_m: [0, 0, -0.02]}}
assembly:
  kind: assembly
  grips: {positions: 1}
  parts:
    - {name: block, shape: {mesh: block.stl, within_m: 0.0005}, start: {xyz_m: [0.1, 0.3, 0.01]}, density_kg_m3: 2700}
    - {name: jig, shape: &jig {box: [0.04, 0.04, 0.02]}, start: {xyz_m: [0.1, -0.3, 0.01]}, density_kg_m3: 2700}
    - name: peg
      shape: {cylinder: {radius_m: 0.0051, length_m: 0.03}}
      start: {xyz_m: [0, -0.2, 0.0151]}
      goal: {xyz_m: [0.1, 0.3, 0.016]}
      density_kg_m3: 7800
    - {name: cube, size_m: [0.04, 0.04, 0.02], start: {xyz_m: [-0.1, -0.3, 0.01]}, goal: {xyz_m: [0.14, -0.3, 0.01]}}
  steps: [peg, cube]
"""
"""A block with a bore of 5.2 mm through it, and a peg of 5.1 mm that goes into it."""

WRONG = planted(r"""
what                       | old                          | new                            | says
a peg too thick            | radius_m: 0.0051             | radius_m: 0.0065               | peg goes where block is by then: they would overlap by 1.3 mm, and may by 0.01 mm; if one is pressed into the other, say fits: [{parts: [peg, block], press_m: 0.0013}]
a peg off its hole         | [0.1, 0.3, 0.016]            | [0.1015, 0.3, 0.016]           | peg goes where block is by then: they would overlap by 1.4 mm
a peg a little off         | [0.1, 0.3, 0.016]            | [0.10013, 0.3, 0.016]          | overlap by 0.03 mm, and may by 0.01 mm
boxes in each other        | [0.14, -0.3, 0.01]           | [0.1385, -0.3, 0.01]           | cube goes where jig is by then: they would overlap by 1.5 mm
a press that nobody states | radius_m: 0.0051             | radius_m: 0.00522              | overlap by 0.02 mm, and may by 0.01 mm
more than is stated        | "  steps: [peg"              | "  fits: [{parts: [jig, cube], press_m: 0.0002}]\n  steps: [peg" | overlap by 0.25 mm, and may by 0.21 mm
in the table               | goal: {xyz_m: [0.1, 0.3, 0.016]} | goal: {xyz_m: [0.1, 0.3, 0.0148]} | peg goes where table stands by then: they would overlap by 0.2 mm
starts in each other       | start: {xyz_m: [-0.1, -0.3, 0.01]} | start: {xyz_m: [0.0601, -0.3, 0.01]} | jig and cube overlap by 0.1 mm at the start, and may by 0.01 mm
""")

RIGHT = planted(r"""
what                       | old                          | new
as it is                   | name: fit                    | name: fit
a peg that just fits       | radius_m: 0.0051             | radius_m: 0.005205
off by its play            | [0.1, 0.3, 0.016]            | [0.10009, 0.3, 0.016]
boxes side by side         | [0.14, -0.3, 0.01]           | [0.139995, -0.3, 0.01]
a press that is stated     | radius_m: 0.0051             | "radius_m: 0.00522"
as deep as is stated       | "  steps: [peg"              | "  fits: [{parts: [cube, jig], press_m: 0.0002}]\n  steps: [peg"
starts side by side        | start: {xyz_m: [-0.1, -0.3, 0.01]} | start: {xyz_m: [0.060005, -0.3, 0.01]}
""")

BESIDES: dict[str, Change] = {
    "more than is stated": ("[0.14, -0.3, 0.01]", "[0.13975, -0.3, 0.01]"),
    "as deep as is stated": ("[0.14, -0.3, 0.01]", "[0.1398, -0.3, 0.01]"),
    "a press that is stated": (
        "  steps: [peg",
        "  fits: [{parts: [peg, block], press_m: 0.00002}]\n  steps: [peg",
    ),
}
"""What else is changed."""


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("fits")
    trimesh.creation.annulus(0.0052, 0.02, 0.02, sections=32).export(out / "block.stl")
    return out


def changed(what: str, old: str, new: str) -> tuple[Change, ...]:
    return ((old, new), *([BESIDES[what]] if what in BESIDES else []))


def findings(folder: Path, *changes: Change) -> list[Finding]:
    subject = CheckContext(loaded(folder, CELL, *changes), folder)
    return [f for check in (check_starts, check_goals) for f in check(subject)]


def plan_steps(folder: Path, *changes: Change) -> None:
    parts = ordered_parts(CheckContext(loaded(folder, CELL, *changes), folder))
    part_steps(parts.cell, parts.listed)


@pytest.mark.parametrize("what", WRONG)
def test_what_is_in_each_other_is_told_with_how_deep_it_may_be(
    what: str, folder: Path
) -> None:
    old, new, says = WRONG[what]
    found = findings(folder, *changed(what, old, new))
    assert any(says in item.message and item.error for item in found), found
    if "start" not in what:
        with pytest.raises(InfeasibleStepError, match="they would overlap by"):
            plan_steps(folder, *changed(what, old, new))


@pytest.mark.parametrize("what", RIGHT)
def test_a_hair_less_is_no_word_worth(what: str, folder: Path) -> None:
    old, new = RIGHT[what]
    assert findings(folder, *changed(what, old, new)) == []
    plan_steps(folder, *changed(what, old, new))


def test_the_fit_is_told_and_how_often_a_robot_that_repeats_so_well_meets_it(
    folder: Path,
) -> None:
    (plain,) = CheckContext(loaded(folder, CELL), folder).checks.fits()
    assert plain.words == "peg in block: 0.10 mm on all sides"
    base = "base: {xyz_m: [-0.5, 0, 0]}"
    stated = (base, f"repeatability_m: 0.0002, {base}")
    given = loaded(folder, CELL, stated)
    (fit,) = CheckContext(given, folder).checks.fits()
    # The radius in the plane is a Rayleigh distribution of 0.2 mm / 3.616.
    chance = 1.0 - math.exp(-0.5 * (0.1 / (0.2 / 3.616)) ** 2)
    assert isinstance(fit, KnownFit)
    assert fit.chances == {"arm": pytest.approx(chance, abs=1e-3)}
    assert fit.words.endswith(f"; fits in {100 * fit.chances['arm']:.3g} % by arm")
    assert fit.content()["play_m"] == pytest.approx(1e-4, abs=1e-6)
    model = scenario_execution(given, folder)
    own = model.disturbances.failures["place-down"]
    assert own.of("arm", "peg") == pytest.approx(1.0 - chance, abs=1e-3)
    assert own.of("arm", "cube") == 0.0
    exact = (base, f"repeatability_m: 0, {base}")
    assert not scenario_execution(
        loaded(folder, CELL, exact), folder
    ).disturbances.failures
    pressed = changed("a press that is stated", *RIGHT["a press that is stated"])
    (tight,) = CheckContext(
        loaded(folder, CELL, stated, *pressed), folder
    ).checks.fits()
    assert tight.words == "peg in block: pressed in by 0.02 mm"
    assert isinstance(tight, KnownFit)
    assert tight.chances == {}


def test_failures_of_parts_are_of_parts_and_robots_that_there_are(folder: Path) -> None:
    for name, says in (
        ("pegs", "unknown part 'pegs'"),
        ("arn/peg", "unknown robot 'arn'"),
    ):
        failures = (
            f"failures: {{place-down: {{probability: 0, parts: {{{name}: 0.1}}}}}}"
        )
        said = refusal(
            folder,
            CELL,
            (
                "  steps: [peg, cube]\n",
                f"  steps: [peg, cube]\nexecution: {{{failures}}}\n",
            ),
        )
        assert says in str(said)


@pytest.mark.parametrize(
    ("fits", "says"),
    [
        ("{parts: [peg, blok], press_m: 0.001}", "unknown part or fixture 'blok'"),
        ("{parts: [peg, peg], press_m: 0.001}", "peg cannot be pressed into itself"),
        ("{parts: [jig, block], press_m: 0.001}", "neither jig nor block is placed"),
        ("{parts: [peg, block]}", "press_m"),
        ("{parts: [peg, block], press_m: 0.2}", "press_m"),
        (
            "{parts: [peg, block], press_m: 0.001}, {parts: [block, peg], press_m: 0.002}",
            "how block and peg fit is already said by fits.0",
        ),
    ],
)
def test_a_fit_is_of_two_things_that_there_are(
    fits: str, says: str, folder: Path
) -> None:
    said = refusal(folder, CELL, ("  steps: [peg", f"  fits: [{fits}]\n  steps: [peg"))
    assert says in str(said)
