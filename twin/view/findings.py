"""Findings of the checks of a cell while it is edited, in a thread of its own."""

from __future__ import annotations

import queue
import threading
from collections.abc import Callable, Sequence

from planning.errors import TwinError
from twin.checks.check import findings_without_reach, reach_findings
from twin.checks.finding import CheckContext, Finding
from twin.trial.loaded_scenario import LoadedScenario

_Given = tuple[Callable[[], LoadedScenario], bool]


class FindingsThread:
    """Checks the newest scenario that it is given; quick findings first, then those on reach.

    Args:
        publish: called with findings as they are known, and with whether reach was checked, too.
    """

    def __init__(self, publish: Callable[[Sequence[Finding], bool], None]) -> None:
        self._publish_now, self._over = publish, False
        self._publishing = threading.Lock()
        self._given: queue.SimpleQueue[_Given | None] = queue.SimpleQueue()
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
        self._given.put((read, moving))

    def stop(self) -> None:
        """End the thread after its current check, of which nothing is published any more."""
        with self._publishing:
            self._over = True
        self._given.put(None)

    def _publish(self, found: Sequence[Finding], *, complete: bool) -> None:
        with self._publishing:
            if not self._over:
                self._publish_now(found, complete)

    def _check(self) -> None:
        while (given := self._given.get()) is not None:
            if not self._given.empty():
                continue
            read, moving = given
            try:
                scenario = read()
                subject = CheckContext(scenario.sections, scenario.folder)
                quick = findings_without_reach(subject)
                if not moving:
                    self._publish(quick, complete=False)
                if moving or self._given.empty():
                    whole = dict.fromkeys([*quick, *reach_findings(subject, quick)])
                    self._publish(list(whole), complete=True)
            except TwinError as error:
                self._publish([Finding((), str(error), error=True)], complete=True)
