"""``twin drive``: a simulated arm in a process of its own, which asks a cell for its robot's nodes."""

from __future__ import annotations

from pathlib import Path

import typer

from twin.commands.command import command
from twin.host.guard import COMPLETED


def drive_robot(
    address: str,
    robot: str,
    *,
    certificates: Path | None = None,
    pace: float = 1.0,
    patience: float = 60.0,
    as_json: bool = False,
    quiet: bool = False,
) -> int:
    """Drive a simulated arm for a cell that twin operate --drivers executes.

    The cell's drivers file says kind: grpc of the robot. It asks again and again until the cell is there, and
    ends when the cell says that nothing more will come.

    Args:
        address: where the cell listens, such as 127.0.0.1:50551.
        robot: its name in the cell.
        certificates: folder that twin cluster certificates made, where the cell listens with one.
        pace: how many times as fast as planned; that of the cell's drivers file.
        patience: how long it asks for a cell that is not there [s].
    """
    from twin.cluster.certificates import certificates_in
    from twin.drivers.simulated_arm import SimulatedArm
    from twin.host.guard import print_json
    from twin.live.driver_end import DriverEnd
    from twin.live.remote import drive_remotely
    from twin.live.wire import started_now

    end = DriverEnd(SimulatedArm(pace=pace), robot, started_now())
    held = None if certificates is None else certificates_in(certificates)
    drive_remotely(
        end, address, held, every_s=min(0.02, 0.1 / pace), patience_s=patience
    )
    done = end.report().state.done
    if as_json:
        print_json({"robot": robot, "done": done})
    elif not quiet:
        typer.echo(f"{robot}: {done} nodes")
    return COMPLETED


drive = command(
    f"{__name__}:drive_robot",
    pace={"min": 1e-6},
    patience={"min": 0},
)
