"""The examples of own parts in the guide run one after another, use public names, and leave what they say."""

import ast
import json
import re
from pathlib import Path

from tests.scripts import DOCS, script
from tests.twin.program import python


def test_examples_of_own_parts_run(tmp_path: Path) -> None:
    text = (DOCS / "guides/python.md").read_text(encoding="utf-8")
    part = text[text.index("## A scenario from Python") :]
    blocks = re.findall(r"```python\n(.*?)```", part, re.DOTALL)
    assert len(blocks) == 7
    assert all(len(block.splitlines()) <= 40 for block in blocks)
    reference = script("python_reference")
    public = {f"{m}.{name}" for m, own in reference.PARTS.items() for name in own}
    public |= {f"twin.registry.{name}" for name in reference.GROUPS}
    used = {
        f"{node.module}.{item.name}"
        for node in ast.walk(ast.parse("\n".join(blocks)))
        if isinstance(node, ast.ImportFrom)
        for item in node.names
        if (node.module or "").split(".")[0] in ("twin", "scheduling", "planning")
    }
    assert used <= public
    change = f"import os, twin; os.chdir({str(tmp_path)!r})"
    python("\n".join([change, *blocks]))
    assert json.loads((tmp_path / "run" / "counts.json").read_text())
    assert (tmp_path / "run" / "exports" / "makespan.txt").read_text().endswith("s\n")
