"""Makespans of many policies and variants: all of them, or those that are asked for."""

from __future__ import annotations

from typing import Any

from twin.study.report.fixing import makespans_table


def _summary(variants: int) -> dict[str, Any]:
    share = {"estimate": 0.0, "low": 0.0, "high": 0.02, "count": 100}
    mean = {"estimate": 100.04, "low": 99.96, "high": None, "count": 100}
    return {
        "confidence": 0.9,
        "deadline_s": None,
        "cells": [
            {
                "policy": policy,
                "variant": {"stalls.rate_per_h": k},
                "replications": 100,
                "makespan_s": mean,
                "makespan_p50_s": {**mean, "high": 101.5},
                "not_completed": share,
            }
            for k in range(variants)
            for policy in ("sequential", "asynchronous")
        ],
    }


def test_only_the_rows_that_are_asked_for() -> None:
    summary = _summary(5)
    assert makespans_table(summary).count("<tr>") == 1 + 10
    assert makespans_table(summary, summary["cells"][:2]).count("<tr>") == 1 + 2


def test_long_names_may_be_broken_and_numbers_may_not() -> None:
    found = makespans_table(_summary(1))
    assert "<th>stalls.<wbr>rate_<wbr>per_<wbr>h</th>" in found
    assert "<span>100.0</span></td>" in found  # a mean without an interval
    assert '<span>100.0</span><br><span class="interval">100.0 to 101.5</span>' in found
    assert "90 % intervals" in found
    assert "<td>-</td>" in found  # no P90
