"""Structs of arrays that are passed to compiled kernels by address.

Numba passes an array to a function as separate fields. With a hundred arrays and a dozen nested functions, this
adds minutes of compilation, and it updates the reference counts of arrays owned by Python atomically. Therefore
kernels take one address, and read each field by its name where they use it.
"""

from __future__ import annotations

import ctypes
from collections.abc import Callable
from typing import Any, TypeVar, cast
from zlib import crc32

import numpy as np
from llvmlite import ir  # type: ignore[import-untyped]
from numba import types
from numba.core import cgutils
from numba.core.errors import TypingError
from numba.core.typing.templates import AttributeTemplate
from numba.extending import (
    NativeValue,
    infer_getattr,
    intrinsic,
    lower_getattr_generic,
    models,
    register_model,
    unbox,
)
from numba.np import arrayobj
from numba.np.numpy_support import from_dtype

from planning.kernels import kernel

Fields = TypeVar("Fields", bound=tuple[Any, ...])
_OBJECT_BYTES = object.__basicsize__
_TRIED = np.arange(8.0)[2:]

ROW = types.Array(types.float64, 1, "C")
"""Type of an array of numbers, or of a row of such arrays."""

_TYPES: dict[tuple[type, tuple[Any, ...]], PackedType] = {}


class PackedType(types.Type):
    """Numba type of a named tuple that is passed by address.

    Args:
        name: of the named tuple.
        fields: name and type of each field; those of a nested tuple are a PackedType.
    """

    def __init__(self, name: str, fields: tuple[tuple[str, types.Type], ...]) -> None:
        self.fields = fields
        # Functions are named by the types of their arguments: what is long costs time.
        layout = ", ".join(f"{field}: {kind}" for field, kind in fields)
        super().__init__(name=f"{name}.{crc32(layout.encode()):08x}")

    def slot(self, field: str) -> tuple[int, types.Type] | None:
        """Return the header offset of a field, and its type."""
        at = 0
        for name, kind in self.fields:
            if name == field:
                return at, kind
            at += _slots(kind)
        return None


def _slots(kind: types.Type) -> int:
    return 1 + kind.ndim if isinstance(kind, types.Array) else 1


def _described_address(array: Any) -> int:
    """Return the data address of an array from its own interface."""
    return int(array.__array_interface__["data"][0])


def _read_address(array: Any) -> int:
    """Return the data address of an array from CPython's memory layout: 15 times as fast."""
    return ctypes.c_void_p.from_address(id(array) + _OBJECT_BYTES).value or 0


_address = _described_address
if _read_address(_TRIED) == _described_address(_TRIED):
    _address = _read_address


class SharedKernel:
    """A kernel called through an address that a packed tuple holds.

    A kernel is compiled into each that calls it. What many call, and what is long, makes the first run
    of a program long: this one is compiled once for each type of tuple.

    Args:
        function: takes the packed tuple first.
        returns: type of what it returns.
        arguments: types of what it takes besides.
    """

    def __init__(
        self,
        function: Callable[..., Any],
        returns: types.Type,
        arguments: tuple[types.Type, ...],
    ) -> None:
        self._kernel: Any = kernel(function)
        self._returns, self._arguments = returns, arguments
        self._known: dict[PackedType, int] = {}

    def address(self, own: PackedType) -> int:
        """Return the address of its code for a type of packed tuple, compiled on first use."""
        if own not in self._known:
            signature = own, *self._arguments
            self._kernel.compile(signature)
            code = self._kernel.overloads[signature]
            name = code.fndesc.llvm_func_name
            self._known[own] = code.library.get_pointer_to_function(name)
        return self._known[own]

    def call_of(self, field: str) -> Any:
        """Return the function by which kernels call it, through a field of a packed tuple."""

        @intrinsic
        def call(typing: Any, own: Any, others: Any) -> Any:
            if tuple(others) != self._arguments:
                raise TypingError(f"{others} in place of {self._arguments}")
            returned, taken = self._returns, (own, *self._arguments)

            def code(context: Any, builder: Any, signature: Any, args: Any) -> Any:
                convention = context.call_conv
                kind = convention.get_function_type(returned, taken)
                address = _read_field(context, builder, own, args[0], field)
                callee = builder.inttoptr(address, kind.as_pointer())
                given = args[0], *cgutils.unpack_tuple(builder, args[1])
                status, value = convention.call_function(
                    builder, callee, returned, taken, given
                )
                with cgutils.if_unlikely(builder, status.is_error):
                    convention.return_status_propagate(builder, status)
                return value

            return returned(own, others), code

        return call


class Packed:
    """A named tuple of arrays, numbers and packed tuples, handed to kernels by its address.

    Kernels may write to the arrays whether or not Python may. Other attributes, seen from
    Python, are those of the named tuple.
    """

    __slots__ = ("_header", "_numba_type_", "address", "fields")

    address: int
    _numba_type_: PackedType

    def __init__(self, fields: tuple[Any, ...]) -> None:
        """Write the header: numbers, addresses of packed tuples, addresses and shapes of arrays."""
        kinds: list[Any] = []
        header: list[int] = []
        shared: list[tuple[int, SharedKernel]] = []
        for value in fields:
            if isinstance(value, np.ndarray):
                if not value.flags.c_contiguous:
                    raise ValueError("kernels take contiguous arrays")
                kinds.append((value.dtype, value.ndim))
                header.append(_address(value))
                header += value.shape
            elif isinstance(value, Packed):
                kinds.append(value._numba_type_)
                header.append(value.address)
            elif isinstance(value, SharedKernel):
                kinds.append(types.int64)
                shared.append((len(header), value))
                header.append(0)
            elif isinstance(value, float):
                kinds.append(types.float64)
                header.append(int(np.float64(value).view(np.int64)))
            else:
                kinds.append(types.int64)
                header.append(int(value))
        self.fields = fields
        self._header = np.array(header, dtype=np.int64)
        self.address = _address(self._header)
        self._numba_type_ = _packed_type(type(fields), tuple(kinds))
        for slot, function in shared:
            self._header[slot] = function.address(self._numba_type_)

    def __reduce__(self) -> tuple[Any, ...]:
        """Copy and pickle the fields: a header is valid in its own process only."""
        return Packed, (self.fields,)

    def __getattr__(self, name: str) -> Any:
        """Return an attribute of the named tuple."""
        return getattr(self.fields, name)


def packed(fields: Fields) -> Fields:
    """Return a named tuple in a form that kernels take by its address."""
    return cast(Fields, Packed(fields))


def _packed_type(tuple_type: Any, kinds: tuple[Any, ...]) -> PackedType:
    known = _TYPES.get((tuple_type, kinds))
    if known is None:
        known = _TYPES[tuple_type, kinds] = PackedType(
            tuple_type.__name__,
            tuple(
                (name, _field_type(kind))
                for name, kind in zip(tuple_type._fields, kinds, strict=True)
            ),
        )
    return known


def _field_type(kind: Any) -> types.Type:
    if isinstance(kind, types.Type):
        return kind
    dtype, ndim = kind
    return types.Array(from_dtype(dtype), ndim, "C")


@register_model(PackedType)
class _PackedModel(models.PrimitiveModel):
    def __init__(self, manager: Any, kind: PackedType) -> None:
        super().__init__(manager, kind, ir.IntType(64).as_pointer())  # type: ignore[no-untyped-call]


@unbox(PackedType)
def _unbox(kind: PackedType, value: Any, c: Any) -> NativeValue:
    number = c.pyapi.object_getattr_string(value, "address")
    address = c.pyapi.long_as_longlong(number)
    c.pyapi.decref(number)
    return NativeValue(c.builder.inttoptr(address, ir.IntType(64).as_pointer()))


@infer_getattr
class _PackedFields(AttributeTemplate):
    key = PackedType

    def generic_resolve(self, kind: PackedType, field: str) -> Any:  # type: ignore[override]
        found = kind.slot(field)
        return None if found is None else found[1]


@lower_getattr_generic(PackedType)
def _read_field(
    context: Any, builder: Any, kind: PackedType, header: Any, field: str
) -> Any:
    found = kind.slot(field)
    assert found is not None
    at, wanted = found

    def word(k: int) -> Any:
        slot = builder.gep(header, [ir.Constant(ir.IntType(64), at + k)])
        value = builder.load(slot)
        # The header never changes: what is read once need not be read again.
        value.set_metadata("invariant.load", builder.module.add_metadata([]))
        return value

    if isinstance(wanted, PackedType):
        return builder.inttoptr(word(0), ir.IntType(64).as_pointer())
    if not isinstance(wanted, types.Array):
        return builder.bitcast(word(0), context.get_value_type(wanted))
    array = arrayobj.make_array(wanted)(context, builder)
    item = context.get_abi_sizeof(context.get_data_type(wanted.dtype))
    shape = [word(1 + k) for k in range(wanted.ndim)]
    strides = [ir.Constant(ir.IntType(64), item)]
    for length in reversed(shape[1:]):
        strides.insert(0, builder.mul(strides[0], length))
    data = builder.inttoptr(word(0), context.get_data_type(wanted.dtype).as_pointer())
    # No reference is counted: the tuple outlives the call.
    arrayobj.populate_array(
        array,
        data=data,
        shape=cgutils.pack_array(builder, shape, ir.IntType(64)),
        strides=cgutils.pack_array(builder, strides, ir.IntType(64)),
        itemsize=ir.Constant(ir.IntType(64), item),
        meminfo=None,
    )
    return array._getvalue()


@intrinsic
def _packed_at(typing: Any, addresses: Any, k: Any, like: Any) -> Any:
    def code(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        row = arrayobj.make_array(signature.args[0])(context, builder, args[0])
        address = builder.load(builder.gep(row.data, [args[1]]))
        return builder.inttoptr(address, ir.IntType(64).as_pointer())

    return like(addresses, types.int64, like), code


packed_at: Any = _packed_at
"""Return the packed tuple whose address is the k-th of a row, of the type of another one."""


@intrinsic(prefer_literal=True)
def _stack_rows(typing: Any, rows: Any, columns: Any) -> Any:
    shape = rows.literal_value, columns.literal_value
    array_type = types.Array(types.float64, 2, "C")

    def code(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        word, item = ir.IntType(64), ir.DoubleType()
        room = cgutils.alloca_once(builder, item, size=shape[0] * shape[1])
        array = arrayobj.make_array(array_type)(context, builder)
        arrayobj.populate_array(
            array,
            data=room,
            shape=cgutils.pack_array(builder, [word(n) for n in shape], word),
            strides=cgutils.pack_array(builder, [word(8 * shape[1]), word(8)], word),
            itemsize=word(8),
            meminfo=None,
        )
        return array._getvalue()

    return array_type(rows, columns), code


stack_rows: Any = _stack_rows
"""Return a temporary array of the given rows and columns, both literals, within a kernel call.

It costs nothing, where one of numpy is allocated and counted. It is of no use to whoever called."""
