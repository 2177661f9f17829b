"""``twin drive``: a simulated arm in a process of its own."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from twin.commands.options import AsJson, Quiet
from twin.host.guard import guarded, print_json


@guarded
def drive(
    address: Annotated[
        str,
        typer.Argument(
            metavar="ADDRESS", help="Where the cell listens, such as 127.0.0.1:50551."
        ),
    ],
    robot: Annotated[
        str, typer.Argument(metavar="ROBOT", help="Its name in the cell.")
    ],
    certificates: Annotated[
        Path | None,
        typer.Option(
            metavar="DIR",
            help="Folder created by twin cluster certificates, if the cell uses them.",
        ),
    ] = None,
    pace: Annotated[
        float,
        typer.Option(
            min=1e-6,
            help="Speed relative to the plan; the same as in the cell's drivers file.",
        ),
    ] = 1.0,
    patience: Annotated[
        float,
        typer.Option(min=0, help="Time for which it tries to connect [s]."),
    ] = 60.0,
    as_json: AsJson = False,
    quiet: Quiet = False,
) -> None:
    """Drive a simulated arm for a cell that twin operate --drivers executes.

    The cell's drivers file has kind: grpc for the robot. The driver tries to connect until the cell answers,
    and ends when the cell has no more work for it.
    """
    from twin.cluster.certificates import certificates_in
    from twin.drivers.simulated_arm import SimulatedArm
    from twin.live.driver_end import DriverEnd, new_instance_number
    from twin.live.service import drive_remotely

    end = DriverEnd(SimulatedArm(pace=pace), robot, new_instance_number())
    held = None if certificates is None else certificates_in(certificates)
    drive_remotely(
        end, address, held, every_s=min(0.02, 0.1 / pace), patience_s=patience
    )
    done = end.report().state.done
    if as_json:
        print_json({"robot": robot, "done": done})
    elif not quiet:
        typer.echo(f"{robot}: {done} nodes")
