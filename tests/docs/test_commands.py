"""Every command in the documentation runs, and prints what the page says it prints.

Blocks marked as a story are run one after the other, in a folder of their own: what one command
writes the next may read. Blocks marked as a file are what the reader types into it, piece after piece.
"""

import re
import shlex
from dataclasses import dataclass
from pathlib import Path

import pytest

from tests.cad_assemblies import write_step
from tests.planned_once import PlannedOnce
from tests.twin.program import invoke

ROOT = Path(__file__).parents[2]
PAGES = sorted(
    [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *ROOT.glob("docs/**/*.md")]
)
_BLOCK = re.compile(
    r"(<!-- (?P<mark>expensive|nightly|story) -->\n)?```console\n(?P<body>.*?)```",
    re.DOTALL,
)
_PIECE = re.compile(
    r"<!-- file: (?P<name>\S+) -->\n```(?:yaml|text)\n(?P<body>.*?)```", re.DOTALL
)


@dataclass(frozen=True)
class Command:
    """A command of a page, and the output that the page shows under it."""

    page: Path
    line: str
    output: str
    mark: str | None

    def __str__(self) -> str:
        return f"{self.page.stem}: {self.line}"


def commands() -> list[Command]:
    out = []
    for page in PAGES:
        for block in _BLOCK.finditer(page.read_text(encoding="utf-8")):
            for part in re.split(r"^\$ ", block["body"], flags=re.MULTILINE)[1:]:
                line, _, output = part.partition("\n")
                out.append(Command(page, line, output, block["mark"]))
    return out


COMMANDS = commands()


def pieces(page: Path) -> dict[str, str]:
    """Return the files that a page has its reader type, by their names."""
    out: dict[str, str] = {}
    for block in _PIECE.finditer(page.read_text(encoding="utf-8")):
        out[block["name"]] = out.get(block["name"], "") + block["body"]
    return out


TWIN = [c for c in COMMANDS if c.line.startswith("twin ")]
CHEAP = [c for c in TWIN if c.mark is None]
LONGER = [
    pytest.param(c, marks=getattr(pytest.mark, c.mark))
    for c in TWIN
    if c.mark in ("expensive", "nightly")
]
STORIES = {
    page.stem: [c for c in TWIN if c.page == page and c.mark == "story"]
    for page in dict.fromkeys(c.page for c in TWIN if c.mark == "story")
}

LONG = (
    "tutorial-wall",
    "tutorial-gearbox",
    "failures",
    "layout",
    "studies",
    "lines",
    "robots",
    "from-cad",
)
"""Pages whose stories are for the night: the wall for three teams, a cell of vendors' files studied, designs of a
cell, studies of what fails and of the cliff, a line of ten kits, a cell of drivers operated and fitted, an assembly
that is modelled first."""

MODELLED = {"from-cad": "gearbox"}
"""Assembly whose STEP file the reader of a page has, by page."""


@pytest.fixture(autouse=True)
def _plans_once(planned_once: PlannedOnce, monkeypatch: pytest.MonkeyPatch) -> None:
    """Plan the motions of a scenario once for all commands, however it is then executed."""
    planned_once.take_over(monkeypatch)


@pytest.fixture(autouse=True)
def _nobody_looks(monkeypatch: pytest.MonkeyPatch) -> None:
    """Open no browser, and end pages at once."""
    monkeypatch.setattr("webbrowser.open", lambda _: True)
    monkeypatch.setattr("twin.view.commands.wait_for_interrupt", lambda: None)


def arguments(line: str, logs: Path | None) -> list[str]:
    """Return the arguments of a command, which writes into a folder if that is given."""
    program, *out = shlex.split(line)
    assert program == "twin"
    if logs is not None and out[0] in ("run", "compare", "explore", "fit"):
        out += ["--out", str(logs)]
        if "-o" in out:
            file = out.index("-o") + 1
            out[file] = str(logs.parent / Path(out[file]).name)
    return out


def test_the_pages_have_commands() -> None:
    assert len(CHEAP) >= 4
    assert COMMANDS[0].page.name in {"CONTRIBUTING.md", "README.md"}


@pytest.mark.parametrize(
    "command",
    [*CHEAP, *LONGER],
    ids=str,
)
def test_command_runs(
    command: Command, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(ROOT)
    done = invoke(*arguments(command.line, tmp_path / "run"), code=0)
    assert command.mark or command.output.strip() in done.stdout


@pytest.mark.parametrize(
    "page",
    [
        pytest.param(
            page,
            marks=pytest.mark.nightly if page in LONG else pytest.mark.expensive,
        )
        for page in STORIES
    ],
)
def test_story_runs(page: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "scenarios").symlink_to(ROOT / "scenarios")
    if page in MODELLED:
        write_step(MODELLED[page], tmp_path / f"{MODELLED[page]}.step")
    typed = pieces(STORIES[page][0].page)
    for command in STORIES[page]:
        for name, text in typed.items():
            if name in command.line:
                (tmp_path / name).write_text(text)
        done = invoke(*arguments(command.line, None))
        if "--stills" in command.line and "Vulkan" in done.stderr:
            continue  # no headless viewer here; the message is what a user should get
        assert done.exit_code == 0, f"{command.line}\n{done.output}"
        assert command.output.strip() in done.stdout, command.line


def test_make_knows_every_target_that_a_page_names() -> None:
    targets = {c.line.split()[1] for c in COMMANDS if c.line.startswith("make ")}
    assert targets >= {"demo", "test"}
    makefile = (ROOT / "Makefile").read_text()
    for target in targets:
        assert re.search(rf"^{target}:", makefile, re.MULTILINE), target


def test_links_between_pages_lead_somewhere() -> None:
    for page in PAGES:
        text = page.read_text(encoding="utf-8")
        for target in re.findall(r"\]\(([^)#]+)\)", text):
            if "://" not in target:
                assert (page.parent / target).exists(), f"{page}: {target}"


def test_files_that_pages_name_are_there() -> None:
    named = re.compile(r"`((?:planning|scheduling|twin|tests|benchmarks)/[\w./-]+)`")
    for page in PAGES:
        for name in named.findall(page.read_text(encoding="utf-8")):
            assert (ROOT / name).exists(), f"{page}: {name}"


def test_a_page_of_results_names_a_command_that_remakes_it() -> None:
    for page in ROOT.glob("benchmarks/results/*.md"):
        text = page.read_text(encoding="utf-8")
        names = re.findall(r"python -m (benchmarks[\w.]*\w)", text)
        for name in names:
            place = ROOT / name.replace(".", "/")
            assert place.is_dir() or place.with_suffix(".py").exists(), page
        assert names or re.search(r"`(make paper|twin verify)", text), page


def test_every_key_of_a_scenario_is_in_the_reference() -> None:
    from twin.scenario.schema import scenario_schema

    text = (ROOT / "docs" / "reference" / "scenario.md").read_text(encoding="utf-8")
    words = set(re.findall(r"[\w-]+", text))
    for name, part in scenario_schema()["$defs"].items():
        for key in part.get("properties", {}):
            assert key in words, f"{name}.{key}"
