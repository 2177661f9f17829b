"""The program as a shell runs it, and Python in processes of its own."""

import os
import subprocess
import sys
from pathlib import Path

from typer.testing import CliRunner, Result

from twin.cli import app

ROOT = Path(__file__).parents[2]


def python(
    text: str, *arguments: object, code: int = 0, **environment: str
) -> subprocess.CompletedProcess[str]:
    """Run Python in a process of its own, which must end with a code."""
    done = subprocess.run(
        [sys.executable, "-c", text, *map(str, arguments)],
        check=False,
        cwd=ROOT,
        env={**os.environ, "PYTHONPATH": str(ROOT), **environment},
        capture_output=True,
        text=True,
    )
    assert done.returncode == code, done.stderr
    return done


def invoke(*arguments: object, code: int | None = None) -> Result:
    """Run a command, which must end with a code where that is given."""
    result = CliRunner().invoke(app, [str(a) for a in arguments])
    assert code in (None, result.exit_code), result.output
    return result
