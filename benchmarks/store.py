"""Store of measurements, so that hours of measuring can be interrupted."""

import hashlib
import json
import subprocess
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from benchmarks.machine import date_line, machine_line
from twin.host.atomic_files import write_json

Row = dict[str, Any]
_PACKAGES = ("planning", "scheduling", "twin", "scenarios")


class RowStore:
    """A folder with one file a row; a row says what it was measured on, when, and of which program.

    Only what the same program measured on the same machine is found again, unless rows of any
    version are asked for.

    Args:
        folder: of the files.
        root: of the program.
        any_version: take rows of other versions of the program, too.
    """

    def __init__(self, folder: Path, root: Path, *, any_version: bool = False) -> None:
        self._folder = folder
        self._any = any_version
        self._stamp = {
            "program": program_hash(root, machine_line()),
            "commit": _commit(root),
            "machine": machine_line(),
        }

    def load(self, key: str) -> Row | None:
        """Return a row, None where it was not measured."""
        path = self._folder / f"{key}.json"
        if not path.exists():
            return None
        row: Row = json.loads(path.read_text(encoding="utf-8"))
        known = self._any or row["program"] == self._stamp["program"]
        return row if known else None

    def save(self, key: str, row: Row) -> Row:
        """Keep a row, in place of an older one; return it as it is kept."""
        self._folder.mkdir(parents=True, exist_ok=True)
        full = {**row, **self._stamp, "date": date_line()}
        write_json(self._folder / f"{key}.json", full)
        return full

    def rows(self) -> Iterator[Row]:
        """Yield all rows that count."""
        for path in sorted(self._folder.glob("*.json")):
            row = self.load(path.stem)
            if row is not None:
                yield row


def _commit(root: Path) -> str:
    """Return which commit the sources are of, with a mark where they differ from it."""

    def git(*arguments: str) -> str:
        done = subprocess.run(
            ["git", *arguments], cwd=root, capture_output=True, text=True, check=False
        )
        return done.stdout.strip()

    # Results that have been written are no other program.
    differs = git("status", "--porcelain", "--", *_PACKAGES)
    return (git("rev-parse", "--short", "HEAD") or "unknown") + "+" * bool(differs)


def program_hash(root: Path, machine: str) -> str:
    """Return a short hash of all sources, scenarios and the machine."""
    digest = hashlib.sha256(machine.encode())
    for package in _PACKAGES:
        for path in sorted((root / package).rglob("*")):
            if path.is_file() and "__pycache__" not in path.parts:
                digest.update(str(path.relative_to(root)).encode())
                digest.update(path.read_bytes())
    return digest.hexdigest()[:12]
