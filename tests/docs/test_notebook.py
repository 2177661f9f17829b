"""The notebook of the documentation runs from its first cell to its last, and shows what it says."""

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

ROOT = Path(__file__).parents[2]
NOTEBOOK = ROOT / "docs/guides/tray.ipynb"

# In a process of its own: a kernel, and what its packages warn of, are not for the others.
_EXECUTE = """
import sys
import nbformat
from jupyter_client import AsyncKernelManager
from nbclient import NotebookClient

notebook = nbformat.read(sys.argv[1], as_version=4)
manager = AsyncKernelManager(transport="ipc", kernel_name="python3")
NotebookClient(notebook, km=manager, timeout=300).execute()
nbformat.write(notebook, sys.argv[2])
"""


def cells(path: Path) -> list[dict[str, Any]]:
    found: list[dict[str, Any]] = json.loads(path.read_text())["cells"]
    return found


def test_the_notebook_is_kept_without_outputs() -> None:
    code = [cell for cell in cells(NOTEBOOK) if cell["cell_type"] == "code"]
    assert len(code) > 8
    assert all(cell["outputs"] == [] for cell in code)
    assert all(cell["execution_count"] is None for cell in code)


@pytest.mark.nightly
def test_the_notebook_runs(tmp_path: Path) -> None:
    done = tmp_path / "done.ipynb"
    subprocess.run(
        [sys.executable, "-c", _EXECUTE, str(NOTEBOOK), str(done)],
        cwd=tmp_path,
        check=True,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
    )
    shown = {
        "".join(cell["source"]).splitlines()[-1]: [
            "".join(output["data"].get("text/html", output["data"]["text/plain"]))
            for output in cell["outputs"]
        ]
        for cell in cells(done)
        if cell["cell_type"] == "code"
    }
    for last in ("scenario", "check", "plan", "run", "audit"):
        (page,) = shown[last]
        assert "<table" in page, last
    for last in ("scenario", "run"):
        assert "data:image/png" in shown[last][0]
    assert "Audit: clean" in shown["audit"][0]
    assert "no robot reaches" in shown["layouts.refused.to_pylist()"][0]
    assert (tmp_path / "tray.rrd").stat().st_size > 100_000
    assert len(list(tmp_path.glob("logs/study-tray-*/report.html"))) == 2
