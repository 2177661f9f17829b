"""Store of measurements, so that hours of measuring can be interrupted."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path

from twin.comparison.comparison import Measurement
from twin.host.atomic import write_json

_PACKAGES = ("planning", "scheduling", "twin", "scenarios")


class MeasuredStore:
    """A folder with one file a scenario, seed and number of candidates.

    Only what the same program measured on the same machine is found again: files carry a hash of
    all sources and scenarios.
    """

    def __init__(self, folder: Path, root: Path, machine: str) -> None:
        """Keep measurements of the program under ``root`` in ``folder``."""
        self._folder = folder
        self._program = program_hash(root, machine)

    def load(
        self, name: str, seed: int, candidates: int
    ) -> tuple[dict[str, Measurement], str] | None:
        """Return the measurements of each policy and their date, None where there are none."""
        path = self._path(name, seed, candidates)
        if not path.exists():
            return None
        content = json.loads(path.read_text(encoding="utf-8"))
        rows = {key: Measurement(**row) for key, row in content["policies"].items()}
        return rows, content["date"]

    def save(
        self,
        name: str,
        seed: int,
        candidates: int,
        rows: Mapping[str, Measurement],
        date: str,
    ) -> None:
        """Keep the measurements of each policy."""
        self._folder.mkdir(parents=True, exist_ok=True)
        policies = {key: asdict(row) for key, row in rows.items()}
        write_json(
            self._path(name, seed, candidates), {"date": date, "policies": policies}
        )

    def _path(self, name: str, seed: int, candidates: int) -> Path:
        return self._folder / f"{name}-{seed}-{candidates}-{self._program}.json"


def program_hash(root: Path, machine: str) -> str:
    """Return a short hash of all sources, scenarios and the machine."""
    digest = hashlib.sha256(machine.encode())
    for package in _PACKAGES:
        for path in sorted((root / package).rglob("*")):
            if path.is_file() and "__pycache__" not in path.parts:
                digest.update(str(path.relative_to(root)).encode())
                digest.update(path.read_bytes())
    return digest.hexdigest()[:12]
