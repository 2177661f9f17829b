"""What a scenario may say at most gives plans that are read back, or a refusal at the place."""

import re
from pathlib import Path

import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st

import planning.bounds as bounds
from scheduling.graph.plan_files import load_plan, plan_sha256, save_plan
from tests.twin.explorations.sliders import SCENARIO, URDF
from tests.twin.program import invoke
from twin.document.validation import InvalidScenarioError
from twin.reading.scenario_file import parse_scenario
from twin.trial.planning import plan_scenario

rates = st.sampled_from([bounds.SLOWEST, 1.0, bounds.FASTEST])


@st.composite
def slider_scenarios(draw: st.DrawFn) -> str:
    """Draw the two sliders, somewhere, with values at the bounds of the schema."""
    document = yaml.safe_load(SCENARIO)
    far = draw(st.sampled_from([0.0, 1.0, bounds.FARTHEST - 2.0]))
    robots, moves = document["cell"]["robots"], document["assembly"]["moves"]
    names = {
        name: draw(st.sampled_from([name, name * 12])) for name in ("left", "right")
    }
    for item in (*robots, *(move["to"] for move in moves)):
        place = item.get("base", item)["xyz_m"]
        place[0] += far
    for robot in robots:
        robot["name"] = names[robot["name"]]
        robot["home_rad_or_m"] = [
            draw(st.sampled_from([-1.00005, -1.0, 0.0, 1.0, 1.5]))
        ]
        robot["limits"] = {
            key: draw(rates) for key in ("velocity", "acceleration", "jerk")
        }
    for move in moves:
        move["robot"] = names[move["robot"]]
    table = document["cell"]["fixtures"][0]
    table["size_m"] = draw(
        st.sampled_from([[1, 0.2, 0.02], [bounds.THINNEST_M] * 3, [900, 0.2, 0.02]])
    )
    document["planning"]["speed_model"] = draw(st.sampled_from(["joint", "limits"]))
    return yaml.safe_dump(document)


@given(text=slider_scenarios())
@settings(max_examples=12)
def test_plans_at_the_bounds_are_read_back(
    text: str, tmp_path_factory: pytest.TempPathFactory
) -> None:
    folder = tmp_path_factory.mktemp("bounds")
    (folder / "slider.urdf").write_text(URDF)
    if "1.5" in text:  # HOME of one, which has a limit of 1 m
        with pytest.raises(InvalidScenarioError, match="must be -1 to 1 m"):
            parse_scenario(folder / "sliders.yaml", text)
        return
    own, _ = parse_scenario(folder / "sliders.yaml", text)
    tpg = plan_scenario(own, folder).tpg
    save_plan(tpg, folder)
    assert plan_sha256(load_plan(folder)) == plan_sha256(tpg)


@pytest.mark.nightly
def test_durations_at_the_bounds_are_read_back(tmp_path: Path) -> None:
    """Products that are gone after eleven days each, made by a process that takes as long."""
    document = yaml.safe_load(Path("scenarios/assembly/kitting.yaml").read_text())
    document["assembly"]["products"] = {"count": 3, "leave_s": bounds.LONGEST_S}
    document["planning"]["shortcut_candidates"] = 0
    own, _ = parse_scenario(tmp_path / "line.yaml", yaml.safe_dump(document))
    tpg = plan_scenario(own, tmp_path).tpg
    assert max(chain.planned_start[-1] for chain in tpg.chains) > bounds.LONGEST_S
    save_plan(tpg, tmp_path)
    assert plan_sha256(load_plan(tmp_path)) == plan_sha256(tpg)


ARM = """\
version: 1
name: arm
cell:
  robots:
    - name: arm
      model: ur5e
      %s
assembly: {kind: goals, moves: [{robot: arm, to: {xyz_m: [0.4, 0.1, 0.4]}}]}
"""


@pytest.mark.parametrize(
    ("key", "words"),
    [
        ("home_deg: [0, -90, 361, -90, -90, 0]", "361 deg is beyond the limits of"),
        ("home_rad_or_m: [0, -7, 1, -1, -1, 0]", "-7 rad is beyond the limits of"),
    ],
)
def test_home_beyond_a_limit_is_refused_at_its_key_by_every_command(
    key: str, words: str, tmp_path: Path
) -> None:
    file = tmp_path / "arm.yaml"
    file.write_text(ARM % key)
    value = re.search(r"361|-7", key)
    assert value is not None
    at = f"{file}:7:{7 + value.start()}: "
    for command in (("validate",), ("check",), ("run", "--out", str(tmp_path / "out"))):
        done = invoke(command[0], file, *command[1:], code=2)
        assert done.output.startswith(f"{at}{words} ")
    assert not (tmp_path / "out").exists()


def test_every_bound_is_stated_once() -> None:
    """Sections and readers take bounds from one module: no other names one of the same value anew."""
    names = [name for name in vars(bounds) if name.isupper()]
    root = Path(bounds.__file__).parents[1]
    code = [
        path
        for package in ("planning", "scheduling", "twin")
        for path in (root / package).rglob("*.py")
        if path.name != "bounds.py"
    ]
    texts = {path: path.read_text(encoding="utf-8") for path in code}
    for name in names:
        assert any(name in text for text in texts.values()), f"{name} bounds nothing"
        for path, text in texts.items():
            assert f"\n{name} = " not in text, f"{path} has {name} of its own"
