"""DLPack: arrays are handed from one library to another without a copy.

Source of the layouts: dlpack.h of DLPack 1.0, and the protocol of the Python array API 2023.12.
"""

from __future__ import annotations

import contextlib
import ctypes
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

VERSION = 1, 0
READ_ONLY, IS_COPIED = 1, 2  # flags
KINDS = {"i": 0, "u": 1, "f": 2, "c": 5, "b": 6}  # of numbers, by NumPy's letters
LETTERS = {kind: letter for letter, kind in KINDS.items()}


class _Tensor(ctypes.Structure):
    """DLTensor."""

    _fields_ = (
        ("data", ctypes.c_void_p),
        ("device_kind", ctypes.c_int32),
        ("device_index", ctypes.c_int32),
        ("ndim", ctypes.c_int32),
        ("kind", ctypes.c_uint8),
        ("bits", ctypes.c_uint8),
        ("lanes", ctypes.c_uint16),
        ("shape", ctypes.POINTER(ctypes.c_int64)),
        ("strides", ctypes.POINTER(ctypes.c_int64)),
        ("byte_offset", ctypes.c_uint64),
    )


class _Managed(ctypes.Structure):
    """DLManagedTensor, of DLPack before 1.0."""

    _fields_ = (
        ("tensor", _Tensor),
        ("context", ctypes.c_void_p),
        ("deleter", ctypes.c_void_p),
    )
    flags = 0


class _Versioned(ctypes.Structure):
    """DLManagedTensorVersioned."""

    _fields_ = (
        ("major", ctypes.c_uint32),
        ("minor", ctypes.c_uint32),
        ("context", ctypes.c_void_p),
        ("deleter", ctypes.c_void_p),
        ("flags", ctypes.c_uint64),
        ("tensor", _Tensor),
    )


# Names of capsules, which their consumers change to "used_...", and what they contain.
_CONTENTS: dict[bytes, type[_Managed] | type[_Versioned]] = {
    b"dltensor": _Managed,
    b"dltensor_versioned": _Versioned,
}

_is_valid = ctypes.pythonapi.PyCapsule_IsValid
_is_valid.argtypes = ctypes.py_object, ctypes.c_char_p
_get_pointer = ctypes.pythonapi.PyCapsule_GetPointer
_get_pointer.restype = ctypes.c_void_p
_get_pointer.argtypes = ctypes.py_object, ctypes.c_char_p


class _ForeignMemory:
    """Memory anywhere, as NumPy takes that of other libraries: it keeps this object."""

    def __init__(
        self, owner: object, pointer: int, dtype: np.dtype[Any], shape: Sequence[int]
    ) -> None:
        self._owner = owner
        self.__array_interface__ = {
            "data": (pointer, False),
            "typestr": dtype.str,
            "shape": tuple(shape),
            "version": 3,
        }


def make_capsule(
    owner: object,
    pointer: int,
    dtype: np.dtype[Any],
    shape: Sequence[int],
    device: tuple[int, int],
    max_version: tuple[int, int] | None,
    flags: int,
) -> object:
    """Return a capsule of an array in C's order.

    NumPy makes it, with functions in C that free it. They may be called without Python's lock, or
    while an exception is on its way, where code in Python could not run.

    Args:
        owner: lives until the consumer is done with the array.
        pointer: of the first number.
        dtype: of the numbers.
        shape: of the array.
        device: kind and index.
        max_version: newest version of DLPack that the consumer knows; None: one before 1.0.
        flags: of DLPack 1.0; consumers before that do not see them.

    Raises:
        BufferError: DLPack has no such numbers.
    """
    if dtype.kind not in KINDS or not dtype.isnative:
        raise BufferError(f"DLPack has no numbers of type {dtype}")
    # NumPy reads no memory for that, wherever it is.
    array = np.asarray(_ForeignMemory(owner, pointer, dtype, shape))
    if max_version is None:
        capsule = array.__dlpack__()
    else:
        try:
            capsule = array.__dlpack__(max_version=max_version)
        except TypeError:  # NumPy 1
            capsule = array.__dlpack__()
    managed = _find_managed(capsule)
    assert managed is not None, "NumPy has made it"
    managed.tensor.data = pointer or None  # NumPy has its own place for no numbers
    managed.tensor.device_kind, managed.tensor.device_index = device
    managed.flags |= flags
    return capsule


class Handed(NamedTuple):
    """An array that another library hands over, as long as the capsule lives.

    Attributes:
        pointer: of the first number.
        dtype: of the numbers; None: NumPy has none such.
        shape: of the array.
        device: kind and index.
        is_in_order: whether it is in C's order.
        is_read_only: whether it must not be written to.
    """

    pointer: int
    dtype: np.dtype[Any] | None
    shape: tuple[int, ...]
    device: tuple[int, int]
    is_in_order: bool
    is_read_only: bool


def read_capsule(capsule: object) -> Handed | None:
    """Return what a capsule contains; None if it is no unused capsule of DLPack."""
    managed = _find_managed(capsule)
    if managed is None:
        return None
    tensor = managed.tensor
    shape = tuple(tensor.shape[k] for k in range(tensor.ndim))
    in_order = True
    if tensor.strides and 0 not in shape:
        stride = 1
        for axis in range(tensor.ndim - 1, -1, -1):
            in_order &= shape[axis] == 1 or tensor.strides[axis] == stride
            stride *= shape[axis]
    dtype = None
    if tensor.kind in LETTERS and tensor.lanes == 1:
        with contextlib.suppress(TypeError):  # for example integers of 4 bits
            dtype = np.dtype(f"{LETTERS[tensor.kind]}{tensor.bits / 8:g}")
    pointer = (tensor.data or 0) + tensor.byte_offset
    device = tensor.device_kind, tensor.device_index
    return Handed(pointer, dtype, shape, device, in_order, bool(managed.flags & READ_ONLY))


def _find_managed(capsule: object) -> _Managed | _Versioned | None:
    for name, kind in _CONTENTS.items():
        if _is_valid(capsule, name):
            return kind.from_address(_get_pointer(capsule, name))
    return None
