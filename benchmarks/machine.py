"""Description of the machine, for the heads of result files."""

import os
import platform
from collections.abc import Sequence
from datetime import UTC, datetime
from pathlib import Path

from planning.caches import BoundedCache
from planning.kinematics import kinematics


def machine_line() -> str:
    """Return the processor, its cores, the memory and the Python version in one line."""
    name = platform.processor() or platform.machine()
    info = Path("/proc/cpuinfo")
    if info.exists():
        for line in info.read_text().splitlines():
            if line.startswith("model name"):
                name = line.split(":", 1)[1].strip()
                break
    pages = os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    return (
        f"{name}, {os.cpu_count()} cores, {pages / 2**30:.0f} GiB, "
        f"Python {platform.python_version()}"
    )


def date_line() -> str:
    """Return today's date (UTC)."""
    return f"{datetime.now(UTC):%Y-%m-%d}"


def load_line(loads: Sequence[tuple[float, float]]) -> str:
    """Return how busy the machine was: processes that ran or waited, a minute's average.

    Args:
        loads: ``os.getloadavg()[0]`` before and after each measurement.
    """
    values = [value for pair in loads for value in pair]
    return f"load of the machine {min(values):.1f} to {max(values):.1f}"


def forget_answers() -> None:
    """Let inverse kinematics forget what it was asked before, which would spare what is measured."""
    kinematics._SOLVED = BoundedCache(20_000)  # noqa: SLF001
