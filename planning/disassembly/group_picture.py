"""Picture of bodies in their places, such as those that block each other."""

from __future__ import annotations

import io
from collections.abc import Collection, Sequence

import numpy as np

from planning.disassembly.body import AssemblyBody

_MM = 1000.0


def draw_bodies(bodies: Sequence[AssemblyBody], names: Collection[str]) -> bytes:
    """Return a picture of the bodies of some names, such as ``InterlockedError.bodies``, each in its colour, as PNG."""
    from matplotlib import colormaps
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure
    from matplotlib.patches import Patch

    figure = Figure(figsize=(8.0, 6.0), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.add_subplot(projection="3d")
    shown = [body for body in bodies if body.name in names]
    marks = []
    for number, body in enumerate(shown):
        colour = colormaps["tab10"](number % 10)
        corners = (np.asarray(body.mesh.vertices) * _MM).T
        axes.plot_trisurf(*corners, triangles=body.mesh.faces, color=colour, alpha=0.75)
        marks.append(Patch(color=colour, label=body.name))
    axes.set(xlabel="x [mm]", ylabel="y [mm]", zlabel="z [mm]")
    axes.set_aspect("equal")
    axes.legend(handles=marks, loc="upper left")
    out = io.BytesIO()
    figure.savefig(out, format="png", dpi=100)
    return out.getvalue()
