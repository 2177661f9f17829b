"""Scenarios that come with the program: found by name, copied, never overwritten."""

import json
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

import twin
from planning.cell.differences import cell_differences
from planning.errors import OutputError, ScenarioError
from tests.twin.program import invoke
from twin.beginnings.beginning import TEMPLATE, create_scenario
from twin.document.yaml_text import read_yaml
from twin.planning.build_workcell import build_workcell
from twin.scenario.shipped import scenario_path, shipped_scenarios

ROOT = Path(__file__).parents[3]

FILES: dict[str, set[str]] = {
    "taskboard": {"driver.urdf"},
    "shapes": {"shapes_housing.stl"},
    "gearbox": set(),
    "machine_tending": {"tools/gripper.urdf"},
    "torso": {"torso.urdf"},
}
"""Scenarios that name files, with some of them."""


def test_all_are_found_and_no_two_have_one_name() -> None:
    files = sorted(ROOT.glob("scenarios/*/*.yaml"))
    assert sorted(shipped_scenarios().values()) == files
    assert len({path.stem for path in files}) == len(files)


@pytest.mark.parametrize("name", shipped_scenarios())
def test_a_copy_of_each_is_whole_wherever_it_is(name: str, tmp_path: Path) -> None:
    original = twin.load(name)
    assert original.sections.description
    assert original.name == name
    copied = twin.load(create_scenario(tmp_path / "copy", name))
    sections = copied.sections.model_copy(update={"name": original.name})
    assert sections == original.sections
    files = [path for path in copied.folder.rglob("*") if path.is_file()]
    named = {path.relative_to(copied.folder).as_posix() for path in files}
    named -= {"scenario.yaml", "scenario.schema.json"}
    assert named >= FILES.get(name, set())
    assert bool(named) == (name in FILES)
    for path in named:
        kept = (copied.folder / path).read_bytes()
        assert kept == (original.folder / path).read_bytes()


@pytest.mark.parametrize(
    "name",
    [
        # Its gear is a mesh that is cut into convex pieces first; that of shapes is soon cut.
        pytest.param(name, marks=pytest.mark.nightly) if name == "gearbox" else name
        for name in shipped_scenarios()
    ],
)
def test_a_copy_of_each_is_of_the_same_cell(name: str, tmp_path: Path) -> None:
    original = twin.load(name)
    copied = twin.load(create_scenario(tmp_path / "copy", name))
    cells = (build_workcell(own.sections, own.folder) for own in (original, copied))
    assert not cell_differences(*cells)


def test_a_name_is_a_scenario_unless_there_is_such_a_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    assert scenario_path(Path("cliff")) == ROOT / "scenarios/lego/cliff.yaml"
    assert scenario_path(Path("cliff.yaml")) == Path("cliff.yaml")
    (tmp_path / "cliff").write_text("")
    assert scenario_path(Path("cliff")) == Path("cliff")
    with pytest.raises(ScenarioError, match=r"no scenario of this name .*tower"):
        scenario_path(Path("clif"))
    own = create_scenario(Path("own"))
    assert scenario_path(Path("own")) == own


@pytest.mark.parametrize("name", ["tray", "cliff", "wall"])
def test_a_copy_is_valid_and_named_after_its_place(name: str, tmp_path: Path) -> None:
    file = create_scenario(tmp_path / "my-cell", name)
    assert file == tmp_path / "my-cell/scenario.yaml"
    found = twin.load(file)
    assert found.name == "my-cell"
    original = twin.load(name).sections
    assert found.sections.model_copy(update={"name": name}) == original
    schema = json.loads((tmp_path / "my-cell/scenario.schema.json").read_text())
    assert set(read_yaml(file, file.read_text()).data) <= set(schema["properties"])
    single = create_scenario(tmp_path / "other.yaml", name)
    assert twin.load(single).name == "other"
    assert sorted(p.name for p in tmp_path.iterdir()) == ["my-cell", "other.yaml"]


def test_files_that_a_scenario_names_may_be_there_already(tmp_path: Path) -> None:
    create_scenario(tmp_path / "board", "taskboard")
    create_scenario(tmp_path / "board/second.yaml", "taskboard")  # the same file
    (tmp_path / "other").mkdir()
    (tmp_path / "other/driver.urdf").write_text("<robot/>")
    with pytest.raises(OutputError, match=r"driver\.urdf: is there already"):
        create_scenario(tmp_path / "other", "taskboard")


def test_what_cannot_be_a_name_leaves_the_name(tmp_path: Path) -> None:
    for place in ("2nd cell.yaml", "null.yaml", "12.yaml", f"{65 * 'x'}.yaml"):
        assert twin.load(create_scenario(tmp_path / place)).name == TEMPLATE


def test_nothing_is_overwritten(tmp_path: Path) -> None:
    (tmp_path / "mine.yaml").write_text("mine")
    with pytest.raises(OutputError, match="is there already"):
        create_scenario(tmp_path / "mine.yaml")
    assert (tmp_path / "mine.yaml").read_text() == "mine"
    (tmp_path / "driver.urdf").write_text("mine")
    with pytest.raises(OutputError, match=r"driver.urdf: is there already"):
        create_scenario(tmp_path / "board.yaml", "taskboard")
    assert not (tmp_path / "board.yaml").exists()
    (tmp_path / "scenario.schema.json").write_text("{}")
    create_scenario(tmp_path)
    assert (tmp_path / "scenario.schema.json").read_text() == "{}"
    invoke("init", tmp_path, code=2)
    invoke("init", tmp_path / "mine.yaml" / "x", code=2)


def test_the_template_is_planned_and_audited_without_a_word(tmp_path: Path) -> None:
    file = create_scenario(tmp_path / "cell")
    found = twin.check(file)
    assert found.report.findings == ()
    assert len(found.scenario.robots) == 2
    assert found.scenario.steps == 5
    run = twin.simulate(twin.plan(found.scenario))
    assert run.passed
    assert {row["robot"] for row in run.plan.tasks.to_pylist()} == {"left", "right"}
    assert twin.audit(run).clean


def test_the_program_lists_copies_and_says_what_to_do_next(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    rows = json.loads(invoke("scenarios", "--json").stdout)
    assert {row["name"] for row in rows} == set(shipped_scenarios())
    assert "cliff" in invoke("scenarios").stdout
    done = invoke("init", "own", "--from", "cliff", code=0)
    for line in done.stdout.splitlines()[1:]:
        assert line.split()[:1] == ["twin"]
        assert line.split()[-1] == "own/scenario.yaml"
    invoke("validate", "own", "cliff", code=0)
    refused = invoke("init", "other", "--from", "clif", code=2)
    assert "cliff" in refused.stderr
    assert not (tmp_path / "other").exists()


def test_the_version_is_that_of_the_package() -> None:
    assert invoke("--version").stdout == f"assembly-twin {twin.__version__}\n"


@pytest.mark.expensive
def test_the_wheel_brings_them(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "pip", "wheel", "--no-deps"]
    command += ["--no-build-isolation", "--wheel-dir", str(tmp_path), str(ROOT)]
    subprocess.run(command, check=True, capture_output=True)
    (wheel,) = tmp_path.glob("*.whl")
    names = zipfile.ZipFile(wheel).namelist()
    for path in shipped_scenarios().values():
        assert f"twin/shipped/{path.parent.name}/{path.name}" in names
    for package in ("planning", "scheduling", "twin"):
        assert f"{package}/py.typed" in names
    assert "twin/scenario/scenario.schema.json" in names
