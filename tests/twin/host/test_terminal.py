"""Small things that keep the terminal clean."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from twin.host import kernel_cache
from twin.host.progress import StageDisplay

ROOT = Path(__file__).parents[3]


def test_compiled_code_is_silenced_and_python_speaks_again() -> None:
    code = (
        "import os, sys\n"
        "from twin.host.silence import silenced\n"
        "print('before')\n"
        "with silenced():\n"
        "    os.write(1, b'noise'); os.write(2, b'noise')\n"
        "print('after'); print('error', file=sys.stderr)\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", code],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=True,
    )
    assert (done.stdout, done.stderr) == ("before\nafter\n", "error\n")


def test_a_kernel_is_compiled_when_its_index_is_newer_than_its_source(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(kernel_cache, "_elsewhere", lambda: [])
    source = tmp_path / "kernel.py"
    source.write_text("@njit\ndef f(): ...\n")
    assert not kernel_cache._is_compiled(source)
    index = tmp_path / "__pycache__" / "kernel.f-2.py311.nbi"
    index.parent.mkdir()
    index.write_bytes(b"")
    os.utime(source, (100, 100))
    os.utime(index, (200, 200))
    assert kernel_cache._is_compiled(source)
    os.utime(source, (300, 300))
    assert not kernel_cache._is_compiled(source)


def test_progress_prints_nothing_when_standard_error_is_no_terminal(
    capfd: pytest.CaptureFixture[str],
) -> None:
    with StageDisplay() as display:
        display("motions", 0, 10)
        display("motions", 10, 10)
    assert capfd.readouterr() == ("", "")
