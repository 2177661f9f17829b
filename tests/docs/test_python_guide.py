"""The examples of own parts in the guide run one after another, and leave what they say."""

import json
import re
from pathlib import Path

from tests.scripts import DOCS
from tests.twin.program import python


def test_examples_of_own_parts_run(tmp_path: Path) -> None:
    text = (DOCS / "guides/python.md").read_text(encoding="utf-8")
    part = text[text.index("## A scenario from Python") :]
    blocks = re.findall(r"```python\n(.*?)```", part, re.DOTALL)
    assert len(blocks) == 4
    assert all(len(block.splitlines()) <= 40 for block in blocks)
    change = f"import os, twin; os.chdir({str(tmp_path)!r})"
    python("\n".join([change, *blocks]))
    assert json.loads((tmp_path / "run" / "counts.json").read_text())
    assert (tmp_path / "run" / "exports" / "makespan.txt").read_text().endswith("s\n")
