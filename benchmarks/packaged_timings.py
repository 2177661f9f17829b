"""Write the synthetic skill timings: ``python -m benchmarks.packaged_timings [FOLDER]``."""

import sys
from pathlib import Path

import numpy as np

import twin.durations
from planning.transforms import Array
from twin.uncertainty.draws import uniforms

MEDIANS_S = {
    "pick": 6.1,
    "place-down": 7.4,
    "place-up": 7.9,
    "handover": 8.7,
    "support-bottom": 4.3,
    "support-top": 5.0,
}
"""Median duration of each skill [s]: chosen, except for the handover's."""

SPREAD_S = 2.0
"""Largest deviation from a median in the paper's text [s]."""

SPREAD_SHARE = 0.23
"""Largest deviation from a median in the paper's text, as a share of the median."""

PACKAGED = Path(twin.durations.__file__).parent / "packaged"
"""Folder of the timings in the package."""

ROWS = 60
SEED = 10


def skill_timings(skill: str) -> Array:
    """Return the durations of a skill, shape (ROWS,) [s].

    Half lie on either side of the median. The longest is at the smaller of the two bounds of
    the text, the shortest at 0.6 of it.
    """
    median = MEDIANS_S[skill]
    bound = min(SPREAD_S, SPREAD_SHARE * median)
    half = ROWS // 2
    names = ([""] * ROWS, np.arange(ROWS), [skill] * ROWS, "timings")
    u, shuffle = uniforms(SEED, [0, 1], *names).T
    below, above = np.sort(u[:half]), np.sort(u[half:])
    # Powers of uniforms crowd towards the median; the extremes are put on their bounds.
    low = 0.6 * bound * (below / below[-1]) ** 1.7
    high = bound * (above / above[-1]) ** 2.5
    # The two middle values must be as far from the median as each other.
    low[0] = high[0] = min(low[0], high[0])
    durations = np.concatenate([median - low, median + high])
    return durations[np.argsort(shuffle, kind="stable")]


def write_timings(folder: Path) -> None:
    """Write one CSV per skill into a folder."""
    for skill in MEDIANS_S:
        rows = "".join(f"{value:.3f}\n" for value in skill_timings(skill))
        (folder / f"{skill}.csv").write_text("duration_s\n" + rows, encoding="utf-8")


if __name__ == "__main__":
    write_timings(Path(sys.argv[1]) if len(sys.argv) > 1 else PACKAGED)
