"""Executes the plan of a run with stalls, and audits it: ``python -m benchmarks.trusses.stalled RUN``.

Every robot stands still at three random nodes for 1 to 20 s each. Exits with 1 if an audit finds anything.
"""

from __future__ import annotations

import argparse
import sys

import twin

STALLS = {"stalls.count_per_robot": 3}


def main() -> int:
    """Execute and audit; return how many runs were not clean."""
    arguments = argparse.ArgumentParser(description=__doc__)
    arguments.add_argument("run", help="folder of a run")
    arguments.add_argument("--runs", type=int, default=5)
    given = arguments.parse_args()
    plan = twin.read_plan(given.run)
    bad = 0
    for seed in range(1, given.runs + 1):
        run = twin.simulate(plan, STALLS, seed=seed)
        audit = twin.audit(run)
        good = audit.clean and run.outcome == "completed"
        bad += not good
        words = "clean" if good else f"{run.outcome}, {audit.violations.to_pylist()}"
        sys.stdout.write(f"seed {seed}: {run.makespan_s:.1f} s, {words}\n")
        sys.stdout.flush()
    return bad


if __name__ == "__main__":
    sys.exit(1 if main() else 0)
