"""A brick picked one stud beside another: planned, executed, audited and verified."""

import json
from pathlib import Path

import pytest

from tests.twin.program import invoke
from tests.twin.scenarios.cells import GP4S, cell
from tests.twin.written import written

SCENARIO = cell(
    "beside",
    GP4S,
    """\
  kind: lego
  plate: {pose: {xyz_m: [0.44, 0, 1.1145]}}
  stock:
    - {name: a, brick: 2x4, at: [20, 20, 1]}
    - {name: beside, brick: 2x4, at: [17, Y, 1], fixed: true}
  steps:
    - {brick: 2x4, at: [30, 32, 1], press: {side: 1, offset: OFFSET}}
""",
    "{name: table, size_m: [0.6, 1.2, 0.02], pose: {xyz_m: [0.44, 0, 1.1045]}}",
)


@pytest.mark.parametrize(
    ("y", "offset", "grazing"), [(20, 0, False), (24, 2, True)], ids=["leans", "grazes"]
)
def test_it_is_picked_and_the_audit_is_clean(
    tmp_path: Path, y: int, offset: int, grazing: bool
) -> None:
    place = ("Y, 1]", f"{y}, 1]"), ("OFFSET", str(offset))
    file, out = written(tmp_path, SCENARIO, *place), tmp_path / "run"
    invoke("run", file, "--out", out, code=0)
    plan = json.loads((out / "plan.json").read_text())
    touched = [
        contact.get("grazing", False)
        for contact in plan["allowed"]
        if "beside" in (contact["first"], contact["second"])
    ]
    assert touched == [grazing]
    audit = json.loads((out / "summary.json").read_text())["audit"]
    assert audit["violations"] == []
    deepest = audit["deepest_graze_m"]
    assert 0.0 < deepest <= 0.0002 if grazing else deepest == 0.0
    invoke("verify", out, code=0)
