"""Executor of a cell whose robots are moved by drivers, with an optional web page."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from functools import cache
from pathlib import Path

from twin.drivers.drivers_file import read_drivers
from twin.live.executor import LiveExecutor
from twin.live.session import Session
from twin.operations.person import AnswerCallback
from twin.page.attended import AttendedSession
from twin.page.panel import Panel
from twin.page.server import PageServer
from twin.registry import HOOKS
from twin.runs.folder import EVENTS
from twin.trial.loaded_scenario import LoadedScenario
from twin.trial.simulation import scenario_execution
from twin.uncertainty.disturbances import Disturbances


class DrivenCell:
    """A cell whose robots are moved by the drivers of a file.

    Args:
        case: the scenario.
        drivers: the file.

    Raises:
        InvalidScenarioError: the file is not valid.
        RequestError: the drivers cannot be served as configured.
    """

    def __init__(self, case: LoadedScenario, drivers: Path) -> None:
        self._session = Session(
            case.name, read_drivers(drivers, case.robots), drivers.parent
        )
        self._session.require_servable()

    @contextmanager
    def executor(
        self,
        case: LoadedScenario,
        folder: Path,
        *,
        answer: AnswerCallback | None = None,
        page: int | None = None,
        opened: Callable[[str], None] | None = None,
    ) -> Iterator[LiveExecutor]:
        """Yield the executor of a run, while its page is served.

        Args:
            case: scenario to execute.
            folder: of the run.
            answer: answers questions in place of a person; by default the page asks if ``recovery.ask`` is given.
            page: port of the page, 0 for any that is free; None for no page.
            opened: receives the address of the page.
        """
        session = replace(self._session, name=folder.name)
        if page is None:
            yield LiveExecutor(session, answer)
            return
        with _page(case, page, folder / EVENTS, opened) as panel:
            attended = AttendedSession(
                session.name, session.drivers, session.folder, panel=panel
            )
            asks = case.sections.execution.recovery.ask is not None
            yield LiveExecutor(
                attended, panel.answer if asks and answer is None else answer
            )


@contextmanager
def _page(
    case: LoadedScenario, port: int, log: Path, opened: Callable[[str], None] | None
) -> Iterator[Panel]:
    """Serve a page during a run; yield the shared panel."""
    model = scenario_execution(case.sections, case.folder)
    # Failures are reported by drivers, not drawn.
    model = replace(model, disturbances=Disturbances())
    panel = Panel(case.steps)
    with ExitStack() as stack:

        @cache
        def scene() -> str:
            serve = HOOKS.require("live scene", "the 3-D scene")
            return str(stack.enter_context(serve(case, lambda: panel.bodies)))

        server = PageServer(panel, model, port, case.name, log, scene)
        stack.enter_context(server.serving())
        if opened is not None:
            opened(server.address)
        yield panel
