"""A study whose bases are off: drawn by replication, and audited where they are."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from scheduling.graph.plan_files import load_plan
from tests.twin.written import written
from twin.audit.audit import audit_off_bases, audit_run
from twin.audit.motion.executed import read_recording
from twin.cli import app
from twin.study.folder import AUDITS

ROOT = Path(__file__).parents[3]
SCENARIO = ROOT / "scenarios/multi_arm/rearrangement.yaml"


def studied(folder: Path, error: str) -> tuple[str, list[dict[str, float]]]:
    """What a study says, and what the audit found in each replication."""
    line = f"execution:\n  base_error: {error}\n"
    text = SCENARIO.read_text(encoding="utf-8")
    file = written(folder.parent, text, ("execution:\n", line))
    study = ("study", str(file), "-n", "4", "--workers", "0", "--out", str(folder))
    how = ("--policy", "asynchronous", "--audit-sample", "3")
    found = CliRunner().invoke(app, [*study, *how])
    assert found.exit_code == 0, found.output
    files = sorted((folder / AUDITS / "0").glob("*.json"))
    return found.output, [json.loads(file.read_text()) for file in files]


@pytest.mark.nightly
@pytest.mark.usefixtures("no_report")
def test_replications_are_audited_where_their_bases_are(tmp_path: Path) -> None:
    said, small = studied(tmp_path / "small", '{"m": 0.0002, "rad": 0.0001}')
    assert len(small) == 3
    assert [item["violations"] for item in small] == [0, 0, 0]
    assert len({item["min_distance_m"] for item in small}) == 3
    assert "0 of 3 replications audited with" in " ".join(said.split())
    assert "bases and skills off as drawn" in " ".join(said.split())
    _, large = studied(tmp_path / "large", '{"m": 0.1, "rad": 0.1}')
    assert any(item["violations"] for item in large)


def test_bases_where_they_are_planned_make_no_difference(tmp_path: Path) -> None:
    out = tmp_path / "run"
    found = CliRunner().invoke(
        app, ["run", str(SCENARIO), "--out", str(out), "-q", "--shortcuts", "0"]
    )
    assert found.exit_code == 0, found.output
    tpg = load_plan(out)
    recording = read_recording(out, tpg.cell)
    usual = audit_run(out, engine="coal")
    same = audit_off_bases(tpg, recording, {}, "coal")
    assert same.violations == ()
    assert same.min_distance_m == pytest.approx(usual.min_distance_m, abs=1e-9)
    # All of them 5 cm up together: from each other they are as far away as before.
    up = {r.name: np.array(r.base) for r in tpg.cell.robots}
    for base in up.values():
        base[2, 3] += 0.05
    raised = audit_off_bases(tpg, recording, up, "coal")
    assert raised.min_distance_m == pytest.approx(usual.min_distance_m, abs=1e-6)
    # One of them 12 cm down: what it reaches for, and the table, are in its way.
    first = next(iter(up))
    down = np.array(tpg.cell.robot(first).base)
    down[2, 3] -= 0.12
    lowered = audit_off_bases(tpg, recording, {first: down}, "coal")
    assert lowered.violations
    assert all(
        first in v.first or first in v.second or v.depth_m > 0.0
        for v in lowered.violations
    )
