"""Renew the committed fingerprints, where a plan has changed on purpose.

From the top of the repository: ``python -m tests.golden.renew``, maybe with names of scenarios.
"""

import json
import sys
from pathlib import Path
from tempfile import TemporaryDirectory

from tests.golden.fingerprint import run_fingerprint
from tests.shipped_runs import ShippedRuns

SCENARIOS: dict[str, tuple[str, int | None]] = {
    "cliff": ("lego/cliff", None),
    "multi_goal": ("multi_arm/multi_goal", None),
    "tower": ("construction/tower", 2),
}
"""Small scenarios, one of each way of planning: file, and robots where not all of them."""


def committed(name: str) -> Path:
    """Return the file of a scenario's fingerprint."""
    return Path(__file__).with_name(f"{name}.json")


def renew(names: list[str]) -> None:
    with TemporaryDirectory() as folder:
        run_of = ShippedRuns(Path(folder))
        for name in names:
            found = run_fingerprint(run_of(*SCENARIOS[name]).trial.files)
            text = json.dumps(found, indent=1, ensure_ascii=False) + "\n"
            committed(name).write_text(text, encoding="utf-8")


if __name__ == "__main__":
    renew(sys.argv[1:] or list(SCENARIOS))
