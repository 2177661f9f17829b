"""What happened in a run, in short; and a recorder that is interrupted."""

from twin.runs.events import Event


def story(events: list[Event]) -> list[tuple[float, str, str, int]]:
    return [(e.t_ns / 1e9, e.robot, e.kind, e.node) for e in events]


class InterruptsAt:
    def __init__(self, count: int) -> None:
        self.left = count
        self.closed = False

    def record(self, event: Event) -> None:
        self.left -= 1
        if self.left == 0:
            raise KeyboardInterrupt

    def close(self) -> None:
        self.closed = True
