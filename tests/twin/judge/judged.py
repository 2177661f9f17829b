"""Open plans for the tests of the judge: ours, and changed by hand."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

from tests.shipped_runs import ShippedRuns
from twin.exports.formats import exported_files
from twin.judge.judge import Judgement
from twin.judge.judge import judge as judge_file

Document = dict[str, Any]


def exported(shipped: ShippedRuns, name: str) -> Document:
    """Return the plan of a shipped scenario as an open plan."""
    (data,) = exported_files(shipped(name).trial, "open-plan").values()
    content: Document = json.loads(data)
    return content


def filed(content: Document, folder: Path) -> Path:
    """Return the file of a plan."""
    file = folder / "plan.json"
    file.write_text(json.dumps(content, indent=1), encoding="utf-8")
    return file


def judged(content: Document, folder: Path, *, seeds: int = 0) -> Judgement:
    """Return what the judge says of a plan."""
    return judge_file(filed(content, folder), seeds=seeds)


def motion_with(content: Document, verb: str, thing: str | None = None) -> Document:
    """Return the first motion in which something happens, to a thing where that is given."""
    for robot in content["robots"].values():
        for motion in robot["motions"]:
            for event in motion.get("events", ()):
                if thing in (None, event.get(verb)) and verb in event:
                    found: Document = motion
                    return found
    raise AssertionError(f"nothing of {verb} {thing}")


FORMATS = Path(__file__).parents[3] / "docs" / "reference" / "formats.md"


def yard(folder: Path) -> Document:
    """Return the plan that the reference writes out by hand, its scenario written into a folder."""
    page = FORMATS.read_text(encoding="utf-8")
    scenario = re.search(
        r"<!-- file: yard.yaml -->\n```yaml\n(.*?)```", page, re.DOTALL
    )
    plan = re.search(r"```json\n(\{\n  \"format\": .*?)```", page, re.DOTALL)
    assert scenario is not None
    assert plan is not None
    (folder / "yard.yaml").write_text(scenario[1], encoding="utf-8")
    content: Document = json.loads(plan[1])
    return content
