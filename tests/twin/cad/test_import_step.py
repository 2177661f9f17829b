"""``twin import step``: from the file of an assembly to a run whose audit is clean."""

import json
import resource
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from planning.cad.step_file import read_assembly
from tests.cad_assemblies import ASSEMBLIES, write_step
from tests.twin.program import invoke
from twin.cad.part_order import ordered_groups

PEGS = Path(__file__).parents[2] / "planning" / "cad" / "pegs.step"

COUNTS = {
    "gearbox": {"shaft": 2, "gear": 2, "cover": 1, "screw": 4},
    "valve": {"piston": 1, "bonnet": 1, "screw": 4, "wheel": 1},
    "hinge": {"leaf_b": 1, "pin": 1},
    "drawer": {"drawer": 2, "lid": 1, "dowel": 2},
    "stack": {"plate": 3, "screw": 4},
    "board": {"peg": 19},
    "puzzle": {"ring_1": 1, "ring_2": 1, "ring_3": 1, "lock": 1},
    "flange": {"ring": 2, "cover": 1, "bolt": 2},
}
"""Parts of each assembly and how many of them there are."""

MOST_CPU_S = 180.0
"""Import, check and run of an assembly take less time of the processor [s]."""


def content(path: Path) -> Any:
    return yaml.safe_load(path.read_text())


def counts(path: Path) -> dict[str, int]:
    return {
        own["name"]: own.get("count", 1) for own in content(path)["assembly"]["parts"]
    }


def test_an_assembly_becomes_a_scenario(tmp_path: Path) -> None:
    """A plate with two blind holes is the base; two pegs of a product, one in a sub-assembly, are alike."""
    out = tmp_path / "pegs.yaml"
    options = ("--at", "0,0.1,0", "--density", "2700", "--density", "peg=1200")
    done = invoke("import", "step", PEGS, "-o", out, *options, code=0)
    assert "base_plate: the base, a fixture" in done.stdout
    assert "step 1: peg.1 in base_plate: 0.050 mm on all sides" in done.stdout
    assert "pegs.yaml: nothing found" in done.stdout
    written = content(out)
    table, base = written["cell"]["fixtures"]
    assert table["name"] == "table"
    assert base["shape"]["mesh"] == "pegs_parts/base_plate.stl"
    assert base["pose"] == {"xyz_m": [0.0, 0.1, 0.01]}
    (peg,) = written["assembly"]["parts"]
    assert peg["shape"] == {"cylinder": {"radius_m": 0.008, "length_m": 0.03}}
    assert peg["density_kg_m3"] == 1200
    goals = sorted(goal["xyz_m"] for goal in peg["goals"])
    np.testing.assert_allclose(goals, [[-0.025, 0.1, 0.02], [0.025, 0.1, 0.02]])
    # The holes are 15 mm deep: it is led straight for that and 10 mm more, about 1 mm.
    assert 0.025 <= peg["approach_m"] <= 0.03
    assert "insert" not in peg
    assert written["assembly"]["steps"] == ["peg"]


def test_what_cannot_be_imported_ends_with_2(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    out = tmp_path / "out.yaml"
    bad = tmp_path / "bad.step"
    bad.write_bytes(PEGS.read_bytes()[:5000])
    cases: dict[tuple[object, ...], str] = {
        (bad,): "bad.step:",
        (PEGS, "--up", "w"): "valid: z, -z",
        (PEGS, "--at", "0,1"): "X,Y,Z expected",
        (PEGS, "--density", "peg=heavy"): "kg/m^3",
        (PEGS, "--density", "1e9"): "kg/m^3",
        (PEGS, "--like", tmp_path / "none.yaml"): "no such file",
    }
    for arguments, words in cases.items():
        done = invoke("import", "step", *arguments, "-o", out, code=2)
        assert words in done.stderr, arguments
    assert not out.exists()
    assert not (tmp_path / "out_parts").exists()
    monkeypatch.setitem(sys.modules, "cascadio", None)
    done = invoke("import", "step", PEGS, "-o", out, code=2)
    assert "pip install 'assembly-twin[cad]'" in done.stderr


@pytest.mark.nightly
def test_the_base_can_be_chosen_among_the_bodies() -> None:
    types, _ = read_assembly(PEGS)
    peg = types[1].placed[0]
    densities = {own.name: 7850.0 for kind in types for own in kind.placed}
    groups = ordered_groups(types, peg, np.eye(4), densities, PEGS)
    assert [kind.name for kind, *_ in groups] == ["base_plate", "peg"]
    # The plate comes onto a peg from below, and the other peg into the plate from above.
    assert [insert for _, _, insert, _ in groups] == [(0, 0, 1), (0, 0, -1)]


@pytest.mark.nightly
@pytest.mark.parametrize("name", COUNTS)
def test_assemblies_are_imported_and_built(name: str, tmp_path: Path) -> None:
    file, out = write_step(name, tmp_path / f"{name}.step"), tmp_path / "cell.yaml"
    before = _cpu_s()
    invoke("import", "step", file, "-o", out, code=0)
    assert counts(out) == COUNTS[name]
    invoke("check", out, code=0)
    invoke("run", out, "--out", tmp_path / "run", "--no-recording", code=0)
    assert _cpu_s() - before < MOST_CPU_S
    summary = json.loads((tmp_path / "run" / "summary.json").read_text())
    assert summary["outcome"] == "completed"
    assert summary["audit"]["violations"] == []


@pytest.mark.nightly
def test_what_is_interlocked_is_refused(tmp_path: Path) -> None:
    file, out = write_step("interlocked", tmp_path / "a.step"), tmp_path / "a.yaml"
    done = invoke("import", "step", file, "-o", out, "--picture", tmp_path, code=2)
    assert (tmp_path / "locked.png").stat().st_size > 5000
    assert "link_a, link_b hold each other" in done.stderr
    assert not out.exists()


@pytest.mark.nightly
def test_the_cell_of_another_scenario_is_taken(tmp_path: Path) -> None:
    out = tmp_path / "cell.yaml"
    invoke("import", "step", PEGS, "-o", out, "--like", "gearbox", code=0)
    written = content(out)
    assert {own["model"] for own in written["cell"]["robots"]} == {"ur5e"}
    names = [own["name"] for own in written["cell"]["fixtures"]]
    assert names == ["table", "jig", "rack", "base_plate"]
    invoke("run", out, "--out", tmp_path / "run", "--no-recording", code=0)


def test_every_assembly_is_tried() -> None:
    assert {*COUNTS, "interlocked"} == {*ASSEMBLIES}


def _cpu_s() -> float:
    used = (
        resource.getrusage(who)
        for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)
    )
    return sum(own.ru_utime + own.ru_stime for own in used)
