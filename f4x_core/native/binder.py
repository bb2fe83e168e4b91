"""Calls the compiled kernels from Python: C signatures as data, arrays checked in one place. Needs numpy alone.

A wrapper declares each C struct as a `Struct` and each C function as a `Function`. Filling a struct checks the dtype, the
shape and the layout of every array before its address is taken, because the kernels walk bare pointers and can check nothing.
Arrays are numpy arrays or torch tensors; tensors are known by their `data_ptr`, so torch is not imported.
"""

from __future__ import annotations

import ctypes
import math
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache, lru_cache
from typing import Any, NoReturn

import numpy as np

from ..errors import F4xError
from .library import require_library

INT32, INT64, FLOAT, DOUBLE, POINTER = ctypes.c_int32, ctypes.c_int64, ctypes.c_float, ctypes.c_double, ctypes.c_void_p
"""Kinds of a number: the C types of the same size. `FLOAT * 3` is `float name[3]`. `POINTER` is what only C reads."""

Check = Callable[[Any], int | None]
"""Takes an array, returns the address of its memory; None of what may be left out."""
Length = int | str
"""An axis: a number, or sums and products of numbers and named sizes, for example `1+times`."""


@dataclass(frozen=True)
class Array:
    """Kind of a pointer to the elements of an array."""

    dtype: str
    """Name of the element type in numpy and torch, for example `float32`."""
    shape: tuple[Length, ...]
    optional: bool = False
    """True if it may be a null pointer: the array is then None or, in a struct, left out."""
    output: bool = False
    """True if the kernel writes it."""
    strides: tuple[Length, ...] | None = None
    """Elements from one entry to the next along each axis; None = C-contiguous."""

    def names(self) -> set[str]:
        """Return the sizes that shape and strides refer to."""
        lengths = map(str, (*self.shape, *(self.strides or ())))
        return {part for length in lengths for part in re.split("[+*]", length) if not part.isdigit()}


@dataclass(frozen=True)
class Result:
    """Kind of a pointer to one number that the function writes; its argument is an instance of `kind`."""

    kind: Any


@cache
def _name(dtype: Any) -> str:
    """Return the name of a dtype of numpy or torch, for example `float32`."""
    return str(dtype).removeprefix("torch.")


class Struct:
    """A C struct: its fields as data. Calling it with the values by name checks them and returns the filled struct.

    Integer fields are named sizes that shapes refer to; `sizes` are further ones, which the C struct does not hold.
    """

    def __init__(self, name: str, fields: Mapping[str, Any], sizes: tuple[str, ...] = ()):
        """Lay out a C struct of `fields`, in the order of C: name and kind, a number type or an `Array`."""
        self.name, self.fields, self.sizes = name, dict(fields), sizes
        self.arrays = {field: kind for field, kind in fields.items() if isinstance(kind, Array)}
        self._known = (*fields, *sizes)
        integers = (field for field, kind in fields.items() if kind in (INT32, INT64))
        self._sizes = [
            size for size in (*sizes, *integers) if any(size in kind.names() for kind in self.arrays.values())
        ]
        self._left_out = {field: None for field, kind in self.arrays.items() if kind.optional}
        self._dtypes = {field: np.dtype(kind.dtype) for field, kind in self.arrays.items()}
        layout = [(field, POINTER if field in self.arrays else kind) for field, kind in fields.items()]
        self.type: Any = type(name, (ctypes.Structure,), {"_fields_": layout})
        # A fit fills the same struct with the same sizes at every step.
        self._plan = lru_cache(maxsize=64)(self._make_plan)

    def plain(self, arrays: Mapping[str, np.ndarray | None], *names: str) -> dict[str, np.ndarray]:
        """Return those of the fields `names` that `arrays` holds, in the dtype of the field and C-contiguous.

        An array that is so already is returned itself, others as copies.
        """
        return {
            name: np.ascontiguousarray(array, self._dtypes[name])
            for name in names
            if (array := arrays.get(name)) is not None
        }

    def __call__(self, **values: Any) -> Any:
        """Return the ctypes struct of `values`, by name: every number, and every array that is not optional.

        The struct keeps its arrays alive.

        Raises:
            F4xError: a value is missing or unknown, or an array has another dtype, shape or layout, or cannot be written.
        """
        full = self._left_out | values
        try:
            plan = self._plan(*[values[size] for size in self._sizes])
            row = [full[name] if check is None else check(full[name]) for name, check in plan]
        except KeyError as missing:
            raise F4xError(f"{self.name} needs {missing.args[0]}.") from None
        if len(full) != len(self._known):
            raise F4xError(f"{self.name} has no field {next(name for name in full if name not in self._known)}.")
        filled = self.type(*row)
        filled.arrays, filled.checks = values, dict(plan)
        return filled

    @staticmethod
    def refill(filled: Any, **values: Any) -> None:
        """Put other `values`, by name, into a struct of the same sizes: a step of a fit changes few of them."""
        for name, value in values.items():
            check = filled.checks[name]
            setattr(filled, name, value if check is None else check(value))
        filled.arrays.update(values)

    def _make_plan(self, *sizes: int) -> list[tuple[str, Check | None]]:
        """Return every field of C in order and, of an array, its check for the values of `_sizes`."""
        named = dict(zip(self._sizes, sizes, strict=True))
        return [
            (name, _check_of(f"{self.name}.{name}", kind, named) if name in self.arrays else None)
            for name, kind in self.fields.items()
        ]


class Function:
    """A C function: its name, its arguments and what it returns as data."""

    def __init__(self, name: str, arguments: Mapping[str, Any], returns: Any = None):
        """Declare a C function with `arguments` in its order: name and kind, also a `Struct` (by address) or a `Result`."""
        self.name, self.arguments, self.returns = name, dict(arguments), returns
        self._arrays = any(isinstance(kind, Array) for kind in arguments.values())

    def __call__(self, *values: Any, library: ctypes.CDLL | None = None, sizes: Mapping[str, int] | None = None) -> Any:
        """Call it in `library` (the one that is open); `sizes` are those that the shapes of its arrays name.

        Raises:
            F4xError: the count of values is wrong, or one does not fit its argument.
        """
        if len(values) != len(self.arguments):
            takes = f"{len(self.arguments)} arguments ({', '.join(self.arguments)})"
            raise F4xError(f"{self.name} takes {takes}, not {len(values)}.")
        if self._arrays:
            values = self._with_addresses(values, sizes or {})
        function = self.declared(require_library() if library is None else library)
        try:
            return function(*values)
        except ctypes.ArgumentError as error:
            raise F4xError(f"{self.name} does not take these values: {error}.") from error

    def declared(self, library: ctypes.CDLL) -> Any:
        """Return the function of `library` with its signature set."""
        function = getattr(library, self.name)
        if function.argtypes is None:
            function.restype = self.returns
            function.argtypes = [_c_type(kind) for kind in self.arguments.values()]
        return function

    def _with_addresses(self, values: tuple[Any, ...], sizes: Mapping[str, int]) -> tuple[Any, ...]:
        return tuple(
            _check_of(f"{self.name}.{name}", kind, sizes)(value) if isinstance(kind, Array) else value
            for (name, kind), value in zip(self.arguments.items(), values, strict=True)
        )


def _length(axis: Length, sizes: Mapping[str, int]) -> int:
    if isinstance(axis, int):
        return axis
    return sum(math.prod(part if isinstance(part, int) else sizes[part] for part in parts) for parts in _terms(axis))


@cache
def _terms(axis: str) -> tuple[tuple[Length, ...], ...]:
    """Return the products, each a row of factors, whose sum `axis` is."""
    return tuple(tuple(int(part) if part.isdigit() else part for part in term.split("*")) for term in axis.split("+"))


def _c_type(kind: Any) -> Any:
    if isinstance(kind, Struct):
        return ctypes.POINTER(kind.type)
    if isinstance(kind, Result):
        return ctypes.POINTER(kind.kind)
    return POINTER if isinstance(kind, Array) else kind


def _check_of(where: str, kind: Array, sizes: Mapping[str, int]) -> Check:
    """Return the function that gives the address of an array, or refuses it: what is known beforehand is worked out here."""
    shape = tuple(_length(axis, sizes) for axis in kind.shape)
    strides = None if kind.strides is None else tuple(_length(axis, sizes) for axis in kind.strides)
    output, optional, one_byte = kind.output, kind.optional, ctypes.c_char.from_buffer
    seen = None  # the dtype object that passed last: its name need not be asked for again

    def is_named(dtype: Any) -> bool:
        nonlocal seen
        if _name(dtype) == kind.dtype:
            seen = dtype
        return dtype is seen

    # Every step of a fit comes here dozens of times: the order and form of the tests are those that take the least time.
    def check(array: Any) -> int | None:
        if array is None and optional:
            return None
        if isinstance(array, np.ndarray):
            if (array.dtype is seen or is_named(array.dtype)) and array.shape == shape:
                if strides is None:
                    try:  # only contiguous memory that can be written gets through, four times as fast as `ctypes.data`
                        return ctypes.addressof(one_byte(array))  # type: ignore[arg-type]  # an array is a buffer
                    except (TypeError, ValueError, BufferError):
                        pass
                fits = array.flags.c_contiguous if strides is None else _strided(array, shape, strides)
                if fits and (array.flags.writeable or not output):
                    return array.ctypes.data
        elif (
            hasattr(type(array), "data_ptr")
            and ((dtype := array.dtype) is seen or is_named(dtype))
            and array.shape == shape
            and (array.is_contiguous() if strides is None else _strided(array, shape, strides))
            and array.is_cpu
        ):
            return array.data_ptr()
        _refuse(where, kind, array, shape, strides)

    return check


def _strided(array: Any, shape: tuple[int, ...], strides: tuple[int, ...]) -> bool:
    """Return True where strides are the wanted ones along every axis with a second entry; those of empty arrays do not matter."""
    found = tuple(s // array.itemsize for s in array.strides) if isinstance(array, np.ndarray) else array.stride()
    return (
        found == strides
        or 0 in shape
        or all(length < 2 or one == other for length, one, other in zip(shape, found, strides, strict=True))
    )


def _refuse(
    where: str, kind: Array, array: Any, expected: tuple[int, ...], strides: tuple[int, ...] | None
) -> NoReturn:
    """Say in one sentence what is wrong with an array."""
    if array is None:
        owner, _, name = where.partition(".")
        raise F4xError(f"{owner} needs {name}.")
    tensor = not isinstance(array, np.ndarray)
    if tensor and not hasattr(array, "data_ptr"):
        raise F4xError(f"{where} has to be a numpy array or a torch tensor, not {type(array).__name__}.")
    if (dtype := _name(array.dtype)) != kind.dtype:
        raise F4xError(f"{where} has to be {kind.dtype}, not {dtype}.")
    if (shape := tuple(array.shape)) != expected:
        named = f"({', '.join(map(str, kind.shape))}{',' if len(kind.shape) == 1 else ''})"
        raise F4xError(f"{where} has to have the shape {named} = {expected}, not {shape}.")
    if tensor and not array.is_cpu:
        raise F4xError(f"{where} has to lie in the memory of the CPU, not on {array.device}.")
    if not tensor and kind.output and not array.flags.writeable:
        raise F4xError(f"{where} is written by the kernel, but the array is read-only.")
    layout = "C-contiguous" if strides is None else f"laid out with the strides {strides}"
    raise F4xError(f"{where} has to be {layout} in memory.")
