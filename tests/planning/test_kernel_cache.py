"""Compiled code that cannot be kept is compiled again: that is said, and is no error."""

import os
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[2]

MODULE = """
from planning.kernels import kernel

@kernel
def tripled(x):
    return 3 * x
"""

CODE = """
import resource, sys
sys.path.insert(0, sys.argv[1])
if sys.argv[2]:
    resource.setrlimit(resource.RLIMIT_FSIZE, (0, resource.RLIM_INFINITY))
from tripling import tripled
print(tripled(14), tripled(1.5))
"""


def _tripled(folder: Path, limit: str = "", **environment: str) -> str:
    """Return what a process that compiles a function logs; it must get its result."""
    (folder / "tripling.py").write_text(MODULE)
    inherited = {k: v for k, v in os.environ.items() if k != "NUMBA_CACHE_DIR"}
    done = subprocess.run(
        [sys.executable, "-B", "-c", CODE, str(folder), limit],
        env={**inherited, "PYTHONPATH": str(ROOT), **environment},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout == "42 4.5\n"
    return done.stderr


def test_without_any_folder_for_it_code_is_compiled_again(tmp_path: Path) -> None:
    nowhere = tmp_path / "file"
    nowhere.write_text("")
    (tmp_path / "__pycache__").write_text("")
    places = dict.fromkeys(("HOME", "XDG_CACHE_HOME", "NUMBA_CACHE_DIR"), str(nowhere))
    said = _tripled(tmp_path, **places)
    assert said.count("compiled code cannot be kept") == 1
    assert "NUMBA_CACHE_DIR" in said


def test_on_a_full_disk_code_is_compiled_again(tmp_path: Path) -> None:
    said = _tripled(tmp_path, "full")
    assert said.count("compiled code cannot be kept") == 1
    assert "File too large" in said
    assert _tripled(tmp_path) == ""
    assert _tripled(tmp_path, "full") == "", "it is there now"
