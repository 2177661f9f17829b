"""Decorators for functions that are compiled by Numba, and progress reports of their compilation."""

from __future__ import annotations

import gc
import logging
import re
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from functools import cache
from hashlib import sha256
from itertools import count
from pathlib import Path
from pickle import UnpicklingError
from typing import Any, TypeVar, cast

import numpy as np
from numba import njit
from numba.core import event
from numba.core.caching import FunctionCache
from numba.core.codegen import JITCodeLibrary
from numba.core.compiler import Compiler

_log = logging.getLogger(__name__)

Function = TypeVar("Function", bound=Callable[..., Any])


_ROOT = Path(__file__).parents[1]
_IMPORT = re.compile(
    rb"^from ((?:planning|scheduling|twin)(?:\.\w+)+) import", re.MULTILINE
)

_UNREADABLE = (
    AttributeError,
    EOFError,
    ImportError,
    KeyError,
    OSError,
    TypeError,
    UnpicklingError,
    ValueError,
)
"""Errors when reading a cache that is truncated, or was written by another version."""

_numbers = count()

ZERO = cast(int, np.int64(0))
"""Zero of type int64. Kernels are recompiled for every type and every literal among their arguments; this avoids it."""


@cache
def files_of_kernels(root: Path, module: str) -> frozenset[Path]:
    """Return the source files that may be compiled into the kernels of a module, its own included.

    These are the files with kernels or extensions of numba that the module imports, directly or through other such
    files. Kernels are compiled into their callers, also across files; numba itself only checks the file of the
    caller, and would keep outdated code of callees.

    Args:
        root: folder above the packages.
        module: dotted name; a module outside the folder has no files.
    """
    found: set[Path] = set()
    ahead = [module]
    while ahead:
        path = root / (ahead.pop().replace(".", "/") + ".py")
        if path in found or not path.is_file():
            continue
        source = path.read_bytes()
        if b"planning.kernels import" in source or b"from numba" in source:
            found.add(path)
            ahead += [name.decode() for name in _IMPORT.findall(source)]
    return frozenset(found)


@cache
def stamp_of_kernels(root: Path, module: str) -> str:
    """Return a hash of all code that may be compiled into the kernels of a module."""
    digest = sha256()
    for path in sorted(files_of_kernels(root, module)):
        digest.update(path.read_bytes())
    return digest.hexdigest()


class _Cache(FunctionCache):
    """Disk cache of compiled code; stale or unreadable entries are recompiled.

    The folder belongs to the installation, or to the user: numba unpickles the files in it. Where it
    cannot be written to, code is recompiled by every process. Cached files refer to types and functions by module,
    which may be missing in another version.
    """

    def __init__(self, function: Callable[..., Any]) -> None:
        super().__init__(function)  # type: ignore[no-untyped-call]
        file = self._cache_file
        file._source_stamp = (
            file._source_stamp,
            stamp_of_kernels(_ROOT, function.__module__),
        )

    def _load_overload(self, *signature: Any) -> Any:
        try:
            return super()._load_overload(*signature)  # type: ignore[no-untyped-call]
        except _UNREADABLE:
            with suppress(OSError):
                self.flush()  # type: ignore[no-untyped-call]
            return None

    def _save_overload(self, *compiled: Any) -> None:
        try:
            super()._save_overload(*compiled)  # type: ignore[no-untyped-call]
        except OSError as error:
            _warn_of_no_cache(f"{self.cache_path}: {error.strerror or error}")


@cache
def _warn_of_no_cache(reason: str) -> None:
    """Log once per reason that compiled code is not cached."""
    _log.warning("compiled code cannot be kept, the next start is slow: %s", reason)


class _NoEngine:
    """Null execution engine for code that is only linked into other code."""

    def set_env(self, name: str, environment: object) -> None:
        """Do nothing."""


class _InnerLibrary(JITCodeLibrary):
    """Code of a function that only kernels call.

    The code is linked into these kernels, and is optimised and translated to machine code only as part of them.
    """

    @property
    def codegen(self) -> _NoEngine:
        return _NoEngine()

    def get_pointer_to_function(self, name: str) -> int:
        """Return 0: it has no machine code of its own."""
        return 0

    def serialize_using_object_code(self) -> Any:
        """Return its form in the disk cache."""
        return self.serialize_using_bitcode()  # type: ignore[no-untyped-call]

    def _optimize_final_module(self) -> None:
        """Do nothing: the kernels that it is linked into are optimised."""

    def _finalize_final_module(self) -> None:
        self._finalize_dynamic_globals()  # type: ignore[no-untyped-call]
        self._verify_declare_only_symbols()  # type: ignore[no-untyped-call]
        self._finalized = True


class _InnerCompiler(Compiler):
    """Compiles functions that only kernels call."""

    def define_pipelines(self) -> Any:
        """Return the passes, after setting the library for the compiled code."""
        codegen = self.state.targetctx.codegen()
        name = f"inner {next(_numbers)}"
        self.state.library = _InnerLibrary(codegen, name)  # type: ignore[no-untyped-call]
        return super().define_pipelines()  # type: ignore[no-untyped-call]


def kernel(function: Function) -> Function:
    """Compile a function that is called from Python."""
    return _compiled(function, no_cfunc_wrapper=True)


def inner_kernel(function: Function) -> Function:
    """Compile a function that only kernels call, as part of those, which halves the compilation."""
    return _compiled(
        function,
        no_cpython_wrapper=True,
        no_cfunc_wrapper=True,
        pipeline_class=_InnerCompiler,
    )


def _compiled(function: Function, **options: Any) -> Function:
    dispatcher: Any = njit(nogil=True, **options)(function)
    try:
        dispatcher._cache = _Cache(function)
    except RuntimeError:  # none of numba's cache folders is writable
        _warn_of_no_cache(
            "no folder for it can be written to; NUMBA_CACHE_DIR names one"
        )
    return cast(Function, dispatcher)


@inner_kernel
def copy_row(out: Any, values: Any) -> None:
    """Copy values into a one-dimensional array, converted to its type.

    An assignment of slices would take seconds to compile, because of its error message about shapes.
    """
    for k in range(len(out)):
        out[k] = values[k]


@inner_kernel
def argsort_few(values: Any) -> Any:
    """Return the indices that sort a few numbers, stably.

    This is an insertion sort, because the general sorts of numba take long to compile.
    """
    order = np.arange(len(values))
    for k in range(1, len(values)):
        at = k
        while at > 0 and values[order[at - 1]] > values[k]:
            order[at] = order[at - 1]
            at -= 1
        order[at] = k
    return order


class _NoCollection(event.Listener):
    """Disables garbage collection during compilation, which allocates much and frees little."""

    def __init__(self) -> None:
        self._under_way = 0
        self._was_on = False

    def on_start(self, event: event.Event) -> None:
        if self._under_way == 0:
            self._was_on = gc.isenabled()
            gc.disable()
        self._under_way += 1

    def on_end(self, event: event.Event) -> None:
        self._under_way -= 1
        if self._under_way == 0 and self._was_on:
            gc.enable()


event.register("numba:compile", _NoCollection())


class _CompilationListener(event.Listener):
    def __init__(self, begin: Callable[[], None], end: Callable[[], None]) -> None:
        self._begin, self._end = begin, end
        self._under_way = 0

    def on_start(self, event: event.Event) -> None:
        self._under_way += 1
        # While it compiles kernels, numba also compiles functions of its own, which do not count.
        if not event.data["dispatcher"].py_func.__module__.startswith("numba."):
            self._begin()

    def on_end(self, event: event.Event) -> None:
        self._under_way -= 1
        if self._under_way == 0:
            self._end()


@contextmanager
def watch_compilation(
    begin: Callable[[], None], end: Callable[[], None]
) -> Iterator[None]:
    """Call back while kernels are compiled; cached ones are not.

    Args:
        begin: called before each, by the thread that needs it.
        end: called when none is under way any more.
    """
    with event.install_listener("numba:compile", _CompilationListener(begin, end)):
        yield
