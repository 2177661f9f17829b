"""Faults planted in planning, scheduling and twin, one at a time: do the tests find them?

    python -m benchmarks.mutants                 # all of them: hours, with kernels that are compiled anew
    python -m benchmarks.mutants --only 3 7      # by number
    python -m benchmarks.mutants --list

Each is a sign, a bound, an edge that is left out or an index that is exchanged, in a copy of the tracked
files that is thrown away. A snippet is searched in the whole program, so that it outlives moved and
renamed files; where white space differs it is found, too. One that is not there exactly once is
"gone": mend the list. Exits with 1 where a fault is not found.
"""

from __future__ import annotations

import argparse
import os
import re
import shutil
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).parents[1]
ROOMS = ("planning", "scheduling", "twin")
PATIENCE_S = 1800.0
"""A fault that makes tests hang for so long is found, too [s]."""


@dataclass(frozen=True)
class Mutant:
    """A fault.

    Attributes:
        area: what is broken.
        old, new: a snippet, and what takes its place.
        tests: where those that should find it are, below tests/.
    """

    area: str
    old: str
    new: str
    tests: str


GRAPH, CONFLICTS = "scheduling/graph scheduling/test_build_tpg.py", "scheduling"
GEOMETRY, IK = "planning/geometry", "planning/kinematics"
TASKS, TIMING, STATICS = "planning/tasks", "planning/timing", "planning/statics"
SHORTCUTS, ENGINE = "scheduling/shortcuts", "twin/engine"
DRAWS, STUDY, AUDIT = "twin/uncertainty", "twin/study/replications", "twin/audit"

MUTANTS = (
    Mutant("conflicts: bound of the search", "if b.node[t_last - 1] <= floor[a.node[s]]:", "if b.node[t_last - 1] <= floor[a.node[s]] + 1:", CONFLICTS),
    Mutant("conflicts: limit of the search", "if b.node[t] >= limit[a.node[s_last - 1]]:", "if b.node[t] >= limit[a.node[s]]:", CONFLICTS),
    Mutant("conflicts: half of a stretch", "stack[depth, 0] = stack[depth + 1, 1] = (s + s_last) // 2", "stack[depth, 0] = (s + s_last) // 2 + 1; stack[depth + 1, 1] = (s + s_last) // 2", CONFLICTS),
    Mutant("conflicts: slack has the wrong sign", "least - descent.slack, scratch", "least + descent.slack - 0.002, scratch", CONFLICTS),
    Mutant("graph: an edge begins a node early", "edges = [(k, u, i, v) for v, u in found]", "edges = [(k, max(u - 1, 0), i, v) for v, u in found]", CONFLICTS),
    Mutant("graph: an edge is left out", "return np.array(sorted(edges), dtype=np.int64).reshape(-1, 4) def _last_nodes", "return np.array(sorted(edges)[1:], dtype=np.int64).reshape(-1, 4)\n\n\ndef _last_nodes", GRAPH),
    Mutant("graph: dependencies end a node early", "frozenset([(own.chain, own.stop - 1)])", "frozenset([(own.chain, max(own.stop - 2, own.first))])", GRAPH),
    Mutant("reduction: too much is implied", "if mine[r] >= u: keep[e]", "if mine[r] >= u - 1:\n                keep[e]", GRAPH),
    Mutant("reduction: of equal edges both stay", "source[other] == source[e] and other < e", "source[other] == source[e] and other > e + 1", GRAPH),
    Mutant("rollout: a node begins before all it waits for", "t = max(t, end[graph.source[e]]) start[n] = t", "t = end[graph.source[e]]\n        start[n] = t", GRAPH),
    Mutant("dispatcher: the first edge is enough", "self._unmet[target] -= 1 if self._unmet[target] == 0:", "self._unmet[target] -= 1\n            if self._unmet[target] <= 1:", GRAPH),
    Mutant("dispatcher: what is observed lets nobody go", "targets = self._successors.get(number, []) if self._lifted", "targets = self._successors.get(number, [])[1:]\n        if self._lifted", GRAPH),
    Mutant("shortcuts: in-edges end at the first new node", "out[into, 3] = last", "out[into, 3] = first", SHORTCUTS),
    Mutant("shortcuts: an order through replaced nodes is lost", "if edges[i, 3] <= edges[o, 1] and edges[i, 0] != edges[o, 2]", "if edges[i, 3] < edges[o, 1] and edges[i, 0] != edges[o, 2]", SHORTCUTS),
    Mutant("IK: a step beyond a limit", "trial[i] = min(max(q[i] + step[i], lower[i]), upper[i])", "trial[i] = max(q[i] + step[i], lower[i])", IK),
    Mutant("IK: turns are not the nearest", "abs(other - seed[j]) < abs(best - seed[j])", "abs(other - seed[j]) > abs(best - seed[j])", IK),
    Mutant("GJK: far too early", "lower = max(lower, (vx * w0 + vy * w1 + vz * w2) / norm)", "lower = max(lower, (vx * w0 + vy * w1 + abs(vz * w2)) / norm)", GEOMETRY),
    Mutant("GJK: support of one axis", "d = x * corners[v, 0] + y * corners[v, 1] + z * corners[v, 2]", "d = x * corners[v, 0] + y * corners[v, 1] + z * corners[v, 1]", GEOMETRY),
    Mutant("timing: speed is kept too long", "steady = length / speed - 2.0 * build - stay", "steady = length / speed - build - stay", TIMING),
    Mutant("timing: a way of braking is too short", "speed = math.sqrt(speed * speed + 2.0 * length[j] / ramp[j])", "speed = math.sqrt(speed * speed + 2.1 * length[j] / ramp[j])", f"{TIMING} {ENGINE}"),
    Mutant("timing: braking ends too late", "way = 0.5 * entry * entry * ramp", "way = 0.6 * entry * entry * ramp", f"{TIMING} {ENGINE}"),
    Mutant("assignment: balance counts the least twice", "self.model += least <= load", "self.model += least >= load", TASKS),
    Mutant("assignment: the last window is left out", "for j in range(1, steps - size + 2)", "for j in range(1, steps - size + 1)", TASKS),
    Mutant("assignment: who places may support", "self.model += own + supporting(robot) <= 1", "self.model += own <= 1", TASKS),
    Mutant("assignment: what covers may stay", "for at, var in uses[other] if at < step)", "for at, var in uses[other] if at != step)", TASKS),
    Mutant("statics: touching ends too early", "ours = _outline(a[first >= first.max() - SLACK] @ across.T)", "ours = _outline(a[first >= first.max() + SLACK] @ across.T)", STATICS),
    Mutant("statics: whatever scores stands", "return self.score <= LIMIT", "return self.score <= 2.0 + LIMIT", "planning/lego/stability"),
    Mutant("draws: robots share their draws", "counter[2], counter[3] = robot[i], purpose[i]", "counter[2], counter[3] = purpose[i], purpose[i]", DRAWS),
    Mutant("draws: a round has the wrong key", "k1 += _WEYL_1", "k1 += _WEYL_0", DRAWS),
    Mutant("statistics: one-sided interval", "stats.t.ppf(0.5 + 0.5 * confidence, len(sample) - 1)", "stats.t.ppf(confidence, len(sample) - 1)", STUDY),
    Mutant("audit: limits may be passed by half", "for joint, where in runs(share > 1.0):", "for joint, where in runs(share > 1.5):", AUDIT),
    Mutant("audit: jumps are overlooked", "if jump > JUMP:", "if jump > 100 * JUMP:", AUDIT),
)  # fmt: skip


def copied(tree: Path) -> None:
    """Copy the tracked files and the kernels that are compiled, with their times."""
    listed = subprocess.check_output(["git", "ls-files", "-z"], cwd=ROOT, text=True)
    names = [Path(name) for name in filter(None, listed.split("\0"))]
    for room in ROOMS:
        names += [path.relative_to(ROOT) for path in (ROOT / room).rglob("*.nb[ci]")]
    for name in names:
        if (ROOT / name).is_file():
            (tree / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy2(ROOT / name, tree / name)


def planted(mutant: Mutant, tree: Path) -> bool:
    """Plant a fault; False where its snippet is not there exactly once."""
    pattern = re.compile(r"\s+".join(map(re.escape, mutant.old.split())))
    hits = []
    for room in ROOMS:
        for path in sorted((tree / room).rglob("*.py")):
            text = path.read_text(encoding="utf-8")
            hits += [(path, text, found) for found in pattern.finditer(text)]
    if len(hits) != 1:
        return False
    path, text, found = hits[0]
    changed = text[: found.start()] + mutant.new + text[found.end() :]
    compile(changed, str(path), "exec")
    path.write_text(changed, encoding="utf-8")
    return True


def outcome(mutant: Mutant, tree: Path) -> str:
    """Run the tests of a fault's area: ``found``, ``not found`` or what went wrong."""
    tests = [f"tests/{name}" for name in mutant.tests.split()]
    tests = [name for name in tests if (tree / name).exists()]
    options = ("-x", "-q", "-p", "no:cacheprovider", "-m", "not expensive")
    try:
        code = subprocess.run(
            [sys.executable, "-m", "pytest", *options, *tests],
            cwd=tree,
            env={**os.environ, "PYTHONPATH": str(tree)},
            capture_output=True,
            timeout=PATIENCE_S,
            check=False,
        ).returncode
    except subprocess.TimeoutExpired:
        return "found (hangs)"
    return {0: "NOT FOUND", 1: "found"}.get(code, f"pytest ended with {code}")


def main() -> int:
    """Plant what was asked for and print what became of each."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--only", type=int, nargs="+", metavar="NUMBER")
    parser.add_argument("--list", action="store_true", help="plant, but run nothing")
    given = parser.parse_args()
    ends = []
    for number, mutant in enumerate(MUTANTS):
        if given.only and number not in given.only:
            continue
        begin = time.monotonic()
        with tempfile.TemporaryDirectory() as folder:
            copied(Path(folder))
            if not planted(mutant, Path(folder)):
                end = "gone"
            else:
                end = "planted" if given.list else outcome(mutant, Path(folder))
        ends.append(end)
        took = time.monotonic() - begin
        sys.stdout.write(f"{number:2d} {end:10s} {took:5.0f} s  {mutant.area}\n")
        sys.stdout.flush()
    found = sum(end.startswith("found") for end in ends)
    sys.stdout.write(f"{found} of {len(ends)} found\n")
    return 0 if given.list or found == len(ends) else 1


if __name__ == "__main__":
    sys.exit(main())
