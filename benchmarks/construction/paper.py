"""Figures that Hartmann et al. report, and the cases that are measured here."""

from __future__ import annotations

from typing import NamedTuple


class PaperSeconds(NamedTuple):
    """Computation time of a plan [s]: keyframes, paths, post-processing, and their sum."""

    keyframes: float
    path: float
    postprocessing: float
    total: float


TEAMS: dict[str, tuple[int, ...]] = {
    "tower": (1, 2, 5, 7, 10, 12),
    "wall": (1, 2, 3, 5, 10),
    "well": (1, 5, 6),
    "pavilion": (1, 5, 8),
    "handover": (4,),
    "gatehouse": (6, 12),
}
"""Robots for each model: those of the tables and case studies, a few between, and mixed teams."""

SEEDS = 10
"""Runs of each; in the paper 10 of tower and wall, 5 of the others."""

TABLE_I: dict[tuple[str, int], PaperSeconds] = {
    ("tower", 1): PaperSeconds(12.2, 0.6, 4.7, 18.2),
    ("tower", 5): PaperSeconds(24.0, 3.8, 18.9, 50.0),
    ("tower", 10): PaperSeconds(42.4, 12.1, 53.3, 112.9),
    ("wall", 1): PaperSeconds(51.0, 5.5, 35.0, 97.3),
    ("wall", 5): PaperSeconds(93.3, 16.4, 76.7, 199.5),
    ("wall", 10): PaperSeconds(161.5, 35.8, 134.6, 345.0),
    ("well", 1): PaperSeconds(198.4, 32.3, 117.5, 377.7),
    ("well", 5): PaperSeconds(345.8, 82.4, 212.4, 676.0),
    ("pavilion", 1): PaperSeconds(644.4, 157.3, 476.8, 1299.8),
    ("pavilion", 5): PaperSeconds(846.7, 220.9, 667.4, 1869.5),
}
"""The method; mean of 10 runs (tower, wall) or 5, on one core of an i7-8565U at 1.8 GHz."""

TABLE_II: dict[tuple[str, int], PaperSeconds] = {
    ("tower", 1): PaperSeconds(9.7, 0.8, 6.2, 17.4),
    ("tower", 5): PaperSeconds(133.9, 8.5, 29.1, 179.3),
    ("tower", 10): PaperSeconds(371.0, 22.1, 71.0, 498.1),
    ("wall", 1): PaperSeconds(34.9, 6.4, 43.9, 89.2),
    ("wall", 5): PaperSeconds(206.1, 23.6, 76.7, 325.1),
    ("wall", 10): PaperSeconds(619.9, 56.0, 122.6, 842.4),
}
"""The baseline with actions of a fixed duration; mean of 10 runs."""

CASE_STUDIES = {("well", 6): 14.1 * 60.0, ("pavilion", 8): 43.2 * 60.0}
"""Computation time of the case studies [s]."""

DURATIONS = (2.0, 3.0, 4.0, 6.0, 8.0)
"""The five values of T that are tried for the baseline [s]; the paper does not give its own."""

WITH_BASELINE = {"tower": (1, 5, 7, 10), "wall": (1, 5, 10)}
"""Cases of Table II and Fig. 11."""
