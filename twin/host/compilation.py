"""Display of kernel compilation: how many are compiled, as a first run has to wait for them."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from twin.host.progress import StageDisplay


class CompiledKernels:
    """Kernels compiled so far; those that are cached are only loaded.

    Args:
        display: where they are counted.
        silent: whether nothing is said of them.
    """

    def __init__(self, display: StageDisplay, *, silent: bool) -> None:
        self.count = 0
        self._display = display
        self._silent = silent

    def begin(self) -> None:
        """Note that one more is compiled from now on."""
        if self.count == 0 and not self._silent:
            self._display.say("compiling kernels, once ...")
        self.count += 1
        self._display.count("compiling kernels", self.count, done=False)

    def end(self) -> None:
        """Note that no more are compiled for now."""
        self._display.count("compiling kernels", self.count, done=True)


@contextmanager
def compilation_shown(
    display: StageDisplay, *, silent: bool
) -> Iterator[CompiledKernels]:
    """Show the kernels that are compiled meanwhile."""
    from planning.kernels import watch_compilation

    compiled = CompiledKernels(display, silent=silent)
    with watch_compilation(compiled.begin, compiled.end):
        yield compiled
