"""Files of tests by how long they take, so that the longest begin first.

    pytest -n 2 --junitxml=times.xml && python -m tests.longest times.xml

writes tests/longest_first.txt. A file that is not in it comes after those that are.
"""

import sys
from collections import Counter
from pathlib import Path
from xml.etree import ElementTree

ROOT = Path(__file__).parents[1]
LIST = Path(__file__).with_name("longest_first.txt")
SHORT_S = 1.0
"""Files that take less are not listed [s]."""


def ranks() -> dict[str, int]:
    """Return the place of each listed file, the longest first."""
    lines = LIST.read_text(encoding="utf-8").splitlines()
    return {line.split()[1]: rank for rank, line in enumerate(lines)}


def measured(report: Path) -> Counter[str]:
    """Return the seconds of each file in a report of pytest as JUnit writes it."""
    seconds: Counter[str] = Counter()
    for case in ElementTree.parse(report).iter("testcase"):
        words = case.get("classname", "").split(".")
        # What follows the module is a class of tests.
        while words and not ROOT.joinpath(*words).with_suffix(".py").is_file():
            words.pop()
        if words:
            name = "/".join(words) + ".py"
            seconds[name] += float(case.get("time", 0.0))  # type: ignore[assignment]
    return seconds


if __name__ == "__main__":
    found = measured(Path(sys.argv[1])).most_common()
    lines = [f"{s:6.1f} {name}\n" for name, s in found if s >= SHORT_S]
    LIST.write_text("".join(lines), encoding="utf-8")
