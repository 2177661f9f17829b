"""The program: bad input ends with code 2 and one clear message, and leaves nothing behind."""

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from planning.errors import InfeasibleStepError, OutputError, TransitError, TwinError
from tests.twin.program import invoke, python
from tests.twin.scenarios.cells import ONE_BRICK
from twin.host.guard import guarded

ROOT = Path(__file__).parents[2]
CLIFF = ROOT / "scenarios" / "lego" / "cliff.yaml"
SMALL = "".join(line for line in ONE_BRICK.splitlines(True) if "right" not in line)
"""One arm and a brick."""


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    return tmp_path


BAD_FILES = {
    "missing": (None, "no such file"),
    "empty": ("", "the file is empty"),
    "not YAML": ("a: [1\n", "not valid YAML"),
    "key twice": (SMALL + "name: other\n", "key 'name' is already given on line 2"),
    "misspelt key": (SMALL.replace("model:", "modle:"), "did you mean 'model'"),
    "wrong unit": (SMALL.replace("xyz_m: [0, 0", "xyz_mm: [0, 0"), "is in metres"),
    "unknown robot": (SMALL.replace("gp4", "gp9"), "unknown robot model 'gp9'"),
    "unknown brick": (SMALL.replace("b1, brick: 2x4", "b1, brick: 9x9"), "'9x9'"),
    "floating": (SMALL.replace("[24, 24, 1]", "[24, 24, 2]"), "would float"),
    "taken": (SMALL.replace("[24, 24, 1]", "[4, 24, 1]"), "where b1 already is"),
    "negative duration": (
        SMALL + "execution: {skills: {pick: {kind: fixed, value_s: -1}}}\n",
        "must be at least 0, not -1",
    ),
    "missing csv": (
        SMALL + "execution: {skills: {pick: {kind: empirical, csv: no.csv}}}\n",
        "no such file",
    ),
}


@pytest.mark.parametrize("command", ["run", "validate"])
@pytest.mark.parametrize("case", BAD_FILES)
def test_a_bad_scenario_ends_with_code_2(case: str, command: str, here: Path) -> None:
    text, words = BAD_FILES[case]
    file = here / "scenario.yaml"
    if text is not None:
        file.write_text(text)
    result = invoke(command, file, code=2)
    assert result.stdout == ""
    messages = [s for s in result.stderr.splitlines() if f"{file}:" in s]
    assert len(messages) == 1, result.stderr
    assert words in messages[0]
    assert "Traceback" not in result.stderr
    assert {p.name for p in here.iterdir()} <= {"scenario.yaml"}


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (
            ["--policy", "eager"],
            "(valid: asynchronous, sequential, synchronous, open-loop)",
        ),
        (["--seed", "-1"], "--seed"),
        (["--stalls", "many"], "--stalls"),
        (["--no-such-option"], "No such option"),
        (["--plan", "nowhere"], "cannot read the plan in nowhere"),
    ],
)
def test_bad_options_end_with_code_2(
    options: list[str], words: str, here: Path
) -> None:
    (here / "small.yaml").write_text(SMALL)
    result = invoke("run", "small.yaml", *options, code=2)
    assert words in result.stderr
    assert [p.name for p in here.iterdir()] == ["small.yaml"]


def test_an_output_folder_that_cannot_be_is_refused_before_planning(
    here: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def never(*_: object, **__: object) -> None:
        pytest.fail("planning has started")

    monkeypatch.setattr("twin.api.runs.plan_until_final", never)
    (here / "small.yaml").write_text(SMALL)
    (here / "taken").write_text("a file")
    result = invoke("run", "small.yaml", "--out", "taken/run", code=2)
    assert "cannot be written to" in result.stderr


@pytest.mark.parametrize("before", [False, True])
def test_planning_that_fails_ends_with_code_2_and_leaves_no_folder(
    before: bool, here: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(*_: object, **__: object) -> None:
        raise InfeasibleStepError("step 1 (2x4) cannot be done")

    monkeypatch.setattr("twin.api.runs.plan_until_final", fail)
    (here / "small.yaml").write_text(SMALL)
    if before:
        (here / "run").mkdir()
    result = invoke("run", "small.yaml", "--out", "run", code=2)
    assert result.stderr.splitlines()[-1] == "error: step 1 (2x4) cannot be done"
    assert (here / "run").exists() == before


def test_validate_checks_every_file_and_says_what_is_in_them(here: Path) -> None:
    (here / "good.yaml").write_text(SMALL)
    (here / "bad.yaml").write_text(SMALL.replace("gp4", "gp9"))
    result = invoke("validate", "bad.yaml", "good.yaml", CLIFF, code=2)
    assert "bad.yaml:5:27: unknown robot model 'gp9'" in result.stderr
    assert result.stdout.splitlines()[0] == (
        "good.yaml: ok (1 robots, 1 steps, 1 bricks in stock)"
    )
    invoke("validate", "good.yaml", code=0)


def test_validate_prints_the_resolved_scenario(here: Path) -> None:
    (here / "good.yaml").write_text(SMALL)
    result = invoke("validate", "--resolved", "good.yaml")
    content = json.loads(result.stdout)
    assert content["planning"]["step_s"] == 0.05
    assert content["assembly"]["twist_deg"]["place-down"] == 16.0


def test_the_schema_is_the_committed_one() -> None:
    committed = (ROOT / "twin" / "scenario" / "scenario.schema.json").read_text()
    assert invoke("schema").stdout == committed


def test_robots_lists_the_registry() -> None:
    rows = json.loads(invoke("robots", "--json").stdout)
    assert {"gp4", "panda", "iiwa14"} <= {row["name"] for row in rows}
    assert "gp4" in invoke("robots").stdout


def test_the_list_of_robots_is_plain_in_a_file_and_fits_a_width(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.delenv("COLUMNS", raising=False)
    plain = invoke("robots").stdout
    assert plain.isascii() or not set("│┃━─") & set(plain)
    assert any(line.split()[:2] == ["gp4", "6"] for line in plain.splitlines())
    monkeypatch.setenv("COLUMNS", "80")
    narrow = invoke("robots").stdout.split("Any other robot")[0]
    assert max(map(len, narrow.splitlines())) <= 80


def test_efforts_have_units_joint_by_joint() -> None:
    assert " 87 N m" in invoke("robots", "panda").stdout
    assert "N m or N" not in invoke("robots", "tower-crane").stdout


def test_doctor_finds_everything_it_needs() -> None:
    result = invoke("doctor", "--json")
    found = json.loads(result.stdout)
    assert result.exit_code == 0, found["missing"]
    assert found["missing"] == {}
    assert {"numba", "coal", "rerun-sdk"} <= set(found["versions"])
    engine = "pybullet" if "pybullet" in found["versions"] else "coal"
    assert found["audit_engine"] == engine


def test_doctor_does_without_pybullet(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "twin.audits.worlds.bullet_world", None)
    monkeypatch.setattr("twin.doctor.commands.OPTIONAL", ("pybullet", "no_pybullet"))
    result = invoke("doctor", code=0)
    assert "audit engine   coal" in result.stdout
    assert "pip install 'assembly-twin[audit]'" in result.stdout


def test_an_engine_that_is_not_there_is_told_of_before_planning(
    here: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "twin.audits.worlds.bullet_world", None)
    for engine, said in (
        ("pybullet", "assembly-twin[audit]"),
        ("fcl", "pybullet, coal"),
    ):
        options = ("--audit-engine", engine, "--out", "r")
        result = invoke("run", CLIFF, *options, code=2)
        assert said in result.stderr
        assert len(result.stderr.strip().splitlines()) == 1
    assert not (here / "r").exists()


def test_import_lists_the_tasks_there_are(here: Path) -> None:
    (here / "assembly_tasks").mkdir()
    (here / "assembly_tasks" / "cliff.json").write_text("{}")
    task = ("--task", "clif", "-o", "out.yaml")
    result = invoke("import", "apex-mr", here, *task, code=2)
    assert "(valid: cliff)" in result.stderr
    assert not (here / "out.yaml").exists()


def test_import_writes_a_scenario_that_is_valid(here: Path) -> None:
    default = ROOT.parent / "shared" / "data" / "apex-mr"
    data = Path(os.environ.get("ASSEMBLY_TWIN_APEX_DATA", default))
    if not data.is_dir():
        pytest.skip("the published APEX-MR files are not here")
    faucet = ("import", "apex-mr", data, "--task", "faucet", "-o")
    invoke(*faucet, "faucet.yaml", code=0)
    invoke("validate", "faucet.yaml", code=0)
    again = invoke(*faucet, "no/f.yaml", code=2)
    assert "cannot be written" in again.stderr


@pytest.mark.parametrize(
    ("error", "code"),
    [
        (InfeasibleStepError("step 3 cannot be done"), 2),
        (TransitError("no way round"), 1),
        (TwinError("something else"), 1),
        (OutputError("no room"), 2),
        (KeyboardInterrupt(), 130),
    ],
)
def test_errors_become_exit_codes(error: BaseException, code: int) -> None:
    import typer

    @guarded
    def command() -> None:
        raise error

    with pytest.raises(typer.Exit) as caught:
        command()
    assert caught.value.exit_code == code


def test_help_is_quick_and_imports_nothing_heavy() -> None:
    heavy = "{'numba', 'pinocchio', 'pybullet', 'rerun', 'matplotlib', 'scipy', 'coal'}"
    code = f"import sys, twin.cli; print(sorted({heavy} & set(sys.modules)))"
    assert python(code).stdout.strip() == "[]"


def test_a_reader_that_goes_away_is_no_traceback() -> None:
    done = subprocess.run(
        f"{sys.executable} -m twin.cli schema | head -n 1",
        shell=True,
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=True,
    )
    assert done.stdout == "{\n"
    assert done.stderr == ""


def test_ctrl_c_while_planning_ends_with_130_and_a_message(here: Path) -> None:
    code = (
        "import signal, sys, time, twin.trial.planning, twin.cli;"
        # Where the tests run in the background, SIGINT is ignored, and that is inherited.
        "signal.signal(signal.SIGINT, signal.default_int_handler);"
        "twin.trial.planning.plan_scenario = lambda *a, **k: (print('go', flush=True), time.sleep(60));"
        "sys.argv = ['twin', 'run', sys.argv[1], '--out', sys.argv[2]]; twin.cli.main()"
    )
    with subprocess.Popen(
        [sys.executable, "-c", code, str(CLIFF), str(here / "run")],
        cwd=ROOT,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    ) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == "go\n"
        time.sleep(0.2)
        process.send_signal(signal.SIGINT)
        try:
            _, stderr = process.communicate(timeout=20)
        finally:
            process.kill()
    assert process.returncode == 130
    assert "interrupted" in stderr
    assert "Traceback" not in stderr
    assert not (here / "run").exists()
