"""The runs whose trajectories are followed: planned once, and kept."""

import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

from benchmarks.machine import machine_line
from benchmarks.store import program_hash

ROOT = Path(__file__).parents[2]
KEPT = ROOT / "benchmarks" / ".measured" / "tracking"
WITHIN = "limits"
"""Speed model of motions within limits of acceleration."""


@dataclass(frozen=True)
class Case:
    """A scenario whose motions are followed.

    Attributes:
        name: of the case.
        path: of the scenario, below the root.
        free: speed model of motions that are at full speed at once.
    """

    name: str
    path: str
    free: str = "joint"

    def folder(self, speed_model: str) -> Path:
        """Return the folder of a run, with the exported trajectories; it is made if need be.

        Raises:
            subprocess.CalledProcessError: the run failed.
        """
        program = program_hash(ROOT, machine_line())
        folder = KEPT / f"{Path(self.path).stem}-{speed_model}-{program}"
        if not (folder / "exports").exists():
            setting = f"planning.speed_model={speed_model}"
            quick = ["--no-audit", "--no-recording", "--out", str(folder)]
            _twin("run", self.path, "--set", setting, *quick)
            _twin("export", str(folder), "--format", "joint-trajectory")
        return folder


CASES = (
    Case("cliff", "scenarios/lego/cliff.yaml", free="l1"),
    Case("boat", "scenarios/multi_arm/assembly.yaml"),
    Case("gearbox", "scenarios/assembly/gearbox.yaml"),
    Case("wall", "scenarios/construction/wall.yaml"),
)


def _twin(*words: str) -> None:
    subprocess.run([sys.executable, "-m", "twin.cli", *words], cwd=ROOT, check=True)
