"""Findings of the checks of a cell while it is edited, in a thread of its own."""

from __future__ import annotations

import threading
from collections.abc import Callable
from dataclasses import dataclass

from planning.errors import TwinError
from twin.checks.check import findings_without_reach, reach_findings
from twin.checks.finding import CheckContext, Finding
from twin.trial.loaded_scenario import LoadedScenario


@dataclass(frozen=True)
class Findings:
    """Findings on a scenario.

    Attributes:
        found: the findings.
        complete: whether reach was checked, too.
        reason: why nothing could be checked; empty if it could.
    """

    found: tuple[Finding, ...] = ()
    complete: bool = False
    reason: str = ""


class FindingsThread:
    """Checks the newest scenario that it is given; quick findings first, then those on reach.

    Args:
        publish: called with findings as they are known.
    """

    def __init__(self, publish: Callable[[Findings], None]) -> None:
        self._publish_now = publish
        self._publishing = threading.Lock()
        self._over = threading.Event()
        self._newest: tuple[Callable[[], LoadedScenario], bool] | None = None
        self._wake = threading.Condition()
        threading.Thread(target=self._check, daemon=True).start()

    def check(
        self, read: Callable[[], LoadedScenario], *, moving: bool = False
    ) -> None:
        """Check a scenario, in place of one whose check has not begun.

        Args:
            read: returns it; called in the thread of the checks.
            moving: whether more follow soon: all findings are published together, so that none of reach disappear
                meanwhile.
        """
        with self._wake:
            self._newest = read, moving
            self._wake.notify()

    def stop(self) -> None:
        """End the thread after its current check, of which nothing is published any more."""
        with self._publishing:
            self._over.set()
        with self._wake:
            self._wake.notify()

    def _publish(self, found: Findings) -> None:
        with self._publishing:
            if not self._over.is_set():
                self._publish_now(found)

    def _check(self) -> None:
        while not self._over.is_set():
            with self._wake:
                while self._newest is None:
                    if self._over.is_set():
                        return
                    self._wake.wait()
                (read, moving), self._newest = self._newest, None
            try:
                scenario = read()
                subject = CheckContext(scenario.sections, scenario.folder)
                quick = findings_without_reach(subject)
                if not moving:
                    self._publish(Findings(tuple(quick)))
                if moving or self._newest is None:
                    whole = [*quick, *reach_findings(subject, quick)]
                    self._publish(Findings(tuple(dict.fromkeys(whole)), complete=True))
            except TwinError as error:
                self._publish(Findings(complete=True, reason=str(error)))
