"""Kernels in tests: those that only kernels call, and compiling each once for all processes."""

import fcntl
from collections import Counter
from pathlib import Path
from types import FunctionType
from typing import Any
from zlib import crc32

from numba.core.compiler_lock import global_compiler_lock
from numba.core.dispatcher import Dispatcher

from planning.kernels import kernel


def outer(inner: Any) -> Any:
    """Return an inner kernel compiled with what Python needs to call it, and kept beside the inner one."""
    code = inner.py_func
    other = FunctionType(code.__code__, code.__globals__, code.__name__)
    other.__qualname__ = f"outer_{code.__qualname__}"
    return kernel(other)


def compile_once(folder: Path) -> None:
    """Let one of all processes that name a folder compile a kernel, while others wait and load it.

    A kernel's byte of one file is locked meanwhile. Kernels call each other without circles, so nobody
    waits for who waits for it.
    """
    file = (folder / "kernels.lock").open("a+b")
    depth: Counter[int] = Counter()
    compile_or_load = Dispatcher.compile

    def compile_locked(self: Any, signature: Any) -> Any:
        name = f"{self.py_func.__module__}.{self.py_func.__qualname__}"
        byte = crc32(name.encode())
        with global_compiler_lock:
            if not depth[byte]:
                fcntl.lockf(file, fcntl.LOCK_EX, 1, byte)
            depth[byte] += 1
            try:
                return compile_or_load(self, signature)
            finally:
                depth[byte] -= 1
                if not depth[byte]:
                    fcntl.lockf(file, fcntl.LOCK_UN, 1, byte)

    # Numba has no hook of its own for this.
    Dispatcher.compile = compile_locked  # type: ignore[method-assign,assignment]
