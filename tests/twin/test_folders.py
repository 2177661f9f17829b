"""Folders of results that somebody else made: nothing in them is executed, and reading them ends in a sentence."""

import ast
import re
import resource
from pathlib import Path

import pytest

from benchmarks.fuzz.folders import CANARY, FOLDERS, KINDS, MUTATED
from benchmarks.fuzz.worker import Worker

MEMORY_MIB = 1024
"""Most that reading a folder may add to the memory of the process [MiB]."""

ROOT = Path(__file__).parents[2]

UNPICKLED = {
    "twin/explorations/crew.py": "the setting that the scheduler of a cluster sends over mutual TLS",
    "twin/studies/replications/workload.py": "workloads for own processes, and the same for a cluster",
}
"""Files that may unpickle, and what: nothing of it was ever in a file."""


def _endings(name: str, place: Path, cases: range) -> dict[int, str]:
    """Return what is wrong with the endings of some cases."""
    worker = Worker(FOLDERS[name](place, 1))
    begin = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss // 1024
    bad: dict[int, str] = {}
    for case in cases:
        ending = worker.run(case)
        kind = f"{list(KINDS)[case % len(KINDS)]}, {ending.command[:1]}"
        if ending.bad:
            bad[case] = f"{kind}: {ending.bad}: {ending.said[-1500:]}"
        elif (place / CANARY).exists():
            bad[case] = f"{kind}: executed what is in a file"
            (place / CANARY).unlink()
        elif ending.memory_mib - begin > MEMORY_MIB:
            bad[case] = f"{kind}: {ending.memory_mib - begin} MiB more"
        elif "Traceback" in ending.said:
            bad[case] = f"{kind}: {ending.said[-1500:]}"
        elif ending.code == 2 and (place / MUTATED).read_text() not in ending.said:
            bad[case] = f"{kind}: no place in {ending.said[-300:]}"
    worker.stop()
    return bad


@pytest.mark.parametrize("name", FOLDERS)
def test_a_dozen_damaged_folders_end_in_a_sentence(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(ROOT)
    assert not _endings(name, tmp_path, range(12))


@pytest.mark.nightly
@pytest.mark.parametrize("name", FOLDERS)
def test_a_hundred_damaged_folders_end_in_a_sentence(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(ROOT)
    assert not _endings(name, tmp_path, range(12, 112))


def test_only_what_was_never_in_a_file_is_unpickled() -> None:
    """No other file of the product names a module that executes what it reads."""
    found = dict[str, set[str]]()
    for package in ("planning", "scheduling", "twin"):
        for path in sorted((ROOT / package).rglob("*.py")):
            text = path.read_text(encoding="utf-8")
            if SUSPECT.search(text) and (names := _executing(ast.parse(text))):
                found[path.relative_to(ROOT).as_posix()] = names
    assert found.keys() == UNPICKLED.keys(), found
    assert set().union(*found.values()) == {"pickle"}


EXECUTING = {"pickle", "dill", "cloudpickle", "joblib", "shelve", "marshal", "numexpr"}
SUSPECT = re.compile(
    "|".join(EXECUTING) + r"|eval|exec|compile|fromfile|pickle|load\b|_load\b"
)


def _executing(tree: ast.Module) -> set[str]:
    """Return what a file uses that executes what it reads; the error that unpickling raises is none."""
    found = set[str]()
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            found |= {a.name for a in node.names} & EXECUTING
        elif isinstance(node, ast.ImportFrom) and node.module in EXECUTING:
            if {a.name for a in node.names} != {"UnpicklingError"}:
                found.add(str(node.module))
        elif isinstance(node, ast.Call):
            called = node.func
            if isinstance(called, ast.Name) and called.id in (
                "eval",
                "exec",
                "compile",
            ):
                found.add(called.id)
            if isinstance(called, ast.Attribute) and ast.unparse(called) in (
                *(
                    "np.load",
                    "numpy.load",
                    "yaml.load",
                    "yaml.unsafe_load",
                    "np.fromfile",
                ),
                *("yaml.full_load", "torch.load", "pd.read_pickle"),
            ):
                safe = {"allow_pickle": False}
                given = {k.arg: getattr(k.value, "value", None) for k in node.keywords}
                if not (called.attr == "load" and given.items() >= safe.items()):
                    found.add(ast.unparse(called))
    return found
