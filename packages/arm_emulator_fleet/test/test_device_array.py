"""Arrays on a device: shared with other libraries without a copy, and alive as long as they."""

import copy
import ctypes
import gc
import subprocess
import sys
import weakref
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from arm_emulator import Refusal
from arm_emulator_fleet import dlpack
from arm_emulator_fleet.device import Device
from arm_emulator_fleet.device_array import DeviceArray, convert_to_device_array
from arm_emulator_fleet.processor_device import ProcessorDevice

pytest_plugins = ["devices"]

RNG = np.random.default_rng(44)
DTYPES = ["f8", "f4", "f2", "i8", "u8", "i4", "u4", "i2", "u2", "i1", "u1", "?", "c16", "c8"]
VERSIONS = [None, (0, 8), (1, 0), (1, 1)]


def draw(dtype: str = "f8", shape: tuple[int, ...] | None = None) -> np.ndarray:
    if shape is None:
        shape = tuple(int(n) for n in RNG.integers(0, 6, RNG.integers(0, 4)))
    return (100.0 * RNG.normal(size=shape)).astype("i8").astype(dtype)


def place(device: Device, numbers: np.ndarray) -> DeviceArray:
    array = DeviceArray(numbers.shape, numbers.dtype, device)
    array.copy_from(numbers)
    return array


class Consumer:
    """A library that takes arrays by DLPack, written from its specification alone."""

    def __init__(self, capsule: object) -> None:
        python = ctypes.pythonapi
        python.PyCapsule_GetName.restype = ctypes.c_char_p
        python.PyCapsule_GetName.argtypes = (ctypes.py_object,)
        pointer_of = ctypes.PYFUNCTYPE(ctypes.c_void_p, ctypes.py_object, ctypes.c_char_p)(
            ("PyCapsule_GetPointer", python)
        )
        python.PyCapsule_SetName.argtypes = ctypes.py_object, ctypes.c_char_p
        name = python.PyCapsule_GetName(capsule)
        self.address = pointer_of(capsule, name)
        self._used = b"used_" + name
        python.PyCapsule_SetName(capsule, self._used)
        self.name = name.decode()
        words = (ctypes.c_uint64 * 10).from_address(self.address)
        if self.name == "dltensor":
            # DLTensor, manager_ctx, deleter
            tensor, self._deleter, self.version, self.flags = words[0:6], words[7], None, None
        else:
            # version, manager_ctx, deleter, flags, DLTensor
            version = words[0] & 0xFFFFFFFF, words[0] >> 32
            tensor, self._deleter, self.version, self.flags = (
                words[4:10],
                words[2],
                version,
                words[3],
            )
        data, device, numbers, shape, strides, offset = tensor
        self.device = device & 0xFFFFFFFF, device >> 32
        self.ndim = numbers & 0xFFFFFFFF
        self.kind, self.bits, self.lanes = numbers >> 32 & 255, numbers >> 40 & 255, numbers >> 48
        self.pointer = data + offset
        self.shape = self._row(shape)
        self.strides = self._row(strides)

    def _row(self, address: int) -> list[int]:
        return list((ctypes.c_int64 * self.ndim).from_address(address)) if self.ndim else []

    def end(self) -> None:
        ctypes.CFUNCTYPE(None, ctypes.c_void_p)(self._deleter)(self.address)


# Arrays


@pytest.mark.parametrize("dtype", DTYPES)
def test_numbers_go_to_the_device_and_back(device: Device, dtype: str) -> None:
    for _ in range(5):
        numbers = draw(dtype)
        array = place(device, numbers)
        assert (array.shape, array.dtype, array.size) == (numbers.shape, dtype, numbers.size)
        assert (array.ndim, array.nbytes) == (numbers.ndim, numbers.nbytes)
        for back in (array.numpy(), np.asarray(array), np.array(array)):
            assert back.dtype == numbers.dtype and np.array_equal(back, numbers)
        assert not np.shares_memory(array.numpy(), array.numpy())
        assert str(array.shape) in repr(array)


def test_rows_are_of_the_same_memory(device: Device) -> None:
    numbers = draw(shape=(5, 4, 3))
    array = place(device, numbers)
    assert len(array) == 5 and len(list(array)) == 5
    for row in (0, 4, -1, -5, np.int64(2)):
        np.testing.assert_array_equal(array[row].numpy(), numbers[row])
        np.testing.assert_array_equal(array[row][-1].numpy(), numbers[row][-1])
        assert array[row].memory is array.memory
    for rows in (slice(1, 3), slice(None), slice(-2, None), slice(3, 1), slice(9, 12)):
        np.testing.assert_array_equal(array[rows].numpy(), numbers[rows])
    array[3] = numbers[3] = draw(shape=(4, 3))
    array[1:3] = numbers[1:3] = draw(shape=(2, 4, 3))
    array[4][2][1] = numbers[4, 2, 1] = 7.0
    np.testing.assert_array_equal(array.numpy(), numbers)


@pytest.mark.parametrize("row", [5, -6, 1.5, None, True, "1", slice(0, 5, 2), slice(5, 0, -1)])
def test_no_such_row(device: Device, row) -> None:
    with pytest.raises(Refusal):
        DeviceArray((5, 2), "f8", device)[row]


def test_an_array_without_axes_has_no_rows(device: Device) -> None:
    array = place(device, np.float64(3.0))
    assert float(array.numpy()) == 3.0
    with pytest.raises(TypeError):
        len(array)


@pytest.mark.parametrize("shape", [(-1,), (1.5,), ("a",), (2**40, 2**40), -1])
def test_no_such_shape(device: Device, shape) -> None:
    with pytest.raises(Refusal):
        DeviceArray(shape, "f8", device)


def test_an_array_fits_into_its_memory(device: Device) -> None:
    memory = device.allocate(100)
    array = DeviceArray((3, 4), "f8", device, memory=memory, offset=4)
    array[:] = np.ones((3, 4))
    for shape, offset in (((3, 4), 5), ((13,), 0), ((1,), 93), ((1,), -8)):
        with pytest.raises(Refusal):
            DeviceArray(shape, "f8", device, memory=memory, offset=offset)
    with pytest.raises(Refusal, match="dtype must be of numbers"):
        DeviceArray(3, object, device)


@pytest.mark.parametrize(
    "values", [np.zeros(4), np.zeros((1, 3)), 1.0, "abc", None, [1.0, "a", 2.0], [[1.0], [1, 2]],
               np.zeros(3, complex), np.array([object()] * 3)],
)  # fmt: skip
def test_values_that_do_not_convert_are_refused_and_change_nothing(device: Device, values) -> None:
    array = place(device, np.arange(3.0))
    with pytest.raises(Refusal, match=r"DeviceArray.copy_from: values must"):
        array.copy_from(values)
    np.testing.assert_array_equal(array.numpy(), np.arange(3.0))


def test_numbers_are_converted_without_loss_of_their_kind(device: Device) -> None:
    array = DeviceArray(3, "f8", device)
    for values in ([1, 2, 3], np.array([1, 2, 3], "u1"), np.array([1, 2, 3], "f4"), (1, 2.0, 3)):
        array.copy_from(values)
        np.testing.assert_array_equal(array.numpy(), [1.0, 2.0, 3.0])
    full_array = DeviceArray(3, "i4", device)
    with pytest.raises(Refusal, match="values must be of type int32, got float64"):
        full_array.copy_from(array)
    array.copy_from(place(device, np.array([4, 5, 6], "i2")))
    np.testing.assert_array_equal(array.numpy(), [4.0, 5.0, 6.0])


def test_rows_of_an_array_are_copied_to_its_further_rows(device: Device) -> None:
    numbers = draw(shape=(6, 2))
    array = place(device, numbers)
    array[1:5] = array[0:4]
    numbers[1:5] = numbers[0:4].copy()
    np.testing.assert_array_equal(array.numpy(), numbers)


def test_numpy_gets_copies_alone(device: Device) -> None:
    array = place(device, np.arange(3.0))
    assert np.asarray(array, "f4").dtype == "f4"
    with pytest.raises(ValueError, match=r"from_dlpack shares it"):
        np.asarray(array, copy=False)


# DLPack


@pytest.mark.parametrize("dtype", DTYPES)
def test_numpy_shares_an_array_of_the_processor(dtype: str) -> None:
    device = ProcessorDevice(1)
    for _ in range(5):
        numbers = draw(dtype)
        array = place(device, numbers)
        shared = np.from_dlpack(array)
        assert shared.dtype == dtype and np.array_equal(shared, numbers)
        assert shared.flags.c_contiguous and shared.flags.writeable
        if shared.size:
            assert shared.ctypes.data == array.pointer
            shared[...] = 1
            assert (array.numpy() == 1).all()


def test_rows_are_shared_too() -> None:
    numbers = draw(shape=(5, 4))
    array = place(ProcessorDevice(1), numbers)
    np.testing.assert_array_equal(np.from_dlpack(array[3]), numbers[3])
    np.from_dlpack(array[1:3])[...] = 5.0
    assert (array.numpy()[1:3] == 5.0).all() and np.array_equal(array.numpy()[3:], numbers[3:])


@pytest.mark.parametrize("version", VERSIONS)
def test_a_capsule_is_as_dlpack_specifies(device: Device, version) -> None:
    for dtype in DTYPES:
        numbers = draw(dtype)
        array = place(device, numbers)
        used = Consumer(array.__dlpack__(max_version=version))
        if version is None or version < (1, 0):
            assert (used.name, used.version, used.flags) == ("dltensor", None, None)
        else:
            assert (used.name, used.version, used.flags) == ("dltensor_versioned", (1, 0), 0)
        assert used.device == array.__dlpack_device__() == device.dlpack
        assert used.pointer == array.pointer and used.shape == list(numbers.shape)
        kind = {"i": 0, "u": 1, "f": 2, "c": 5, "b": 6}[numbers.dtype.kind]
        assert (used.kind, used.bits, used.lanes) == (kind, 8 * numbers.itemsize, 1)
        if numbers.size:
            assert used.strides == [step // numbers.itemsize for step in numbers.strides]
        used.end()


@pytest.mark.parametrize("version", VERSIONS)
def test_memory_lives_until_the_consumer_is_done(device: Device, version) -> None:
    array = place(device, np.arange(20.0))
    memory = weakref.ref(array.memory)
    capsule = array[3:].__dlpack__(max_version=version)
    del array
    used = Consumer(capsule)
    del capsule
    assert memory() is not None
    used.end()
    assert memory() is None


@pytest.mark.parametrize("version", VERSIONS)
def test_memory_lives_as_long_as_an_unused_capsule(device: Device, version) -> None:
    array = place(device, np.arange(20.0))
    memory = weakref.ref(array.memory)
    capsule = array.__dlpack__(max_version=version)
    del array
    assert memory() is not None
    del capsule
    assert memory() is None


def test_memory_lives_as_long_as_an_array_of_numpy() -> None:
    array = place(ProcessorDevice(1), np.arange(20.0))
    memory = weakref.ref(array.memory)
    shared = np.from_dlpack(array)
    del array
    row = shared[3:]
    del shared
    assert memory() is not None and row.tolist() == list(range(3, 20))
    del row
    assert memory() is None


def test_a_copy_is_returned_where_it_is_requested(device: Device) -> None:
    array = place(device, np.arange(4.0))
    used = Consumer(array.__dlpack__(copy=True, max_version=(1, 0)))
    assert used.pointer != array.pointer and used.flags == 2
    used.end()
    used = Consumer(array.__dlpack__(copy=False, max_version=(1, 0)))
    assert used.pointer == array.pointer and used.flags == 0
    used.end()


def test_a_processor_gets_a_copy_of_a_card(cards: SimpleNamespace) -> None:
    array = place(cards.open(), np.arange(4.0))
    copied = np.from_dlpack(array, device="cpu")
    assert copied.tolist() == [0.0, 1.0, 2.0, 3.0]
    for wrong in (
        {"dl_device": (1, 0), "copy": False},
        {"dl_device": (2, 1)},
        {"dl_device": (10, 0)},
    ):
        with pytest.raises(BufferError, match="stub 0 shares its memory with no other device"):
            array.__dlpack__(**wrong)
    with pytest.raises((BufferError, RuntimeError)):
        np.from_dlpack(array)


def test_numbers_that_dlpack_has_not(device: Device) -> None:
    for dtype in (np.dtype([("a", "f8")]), np.dtype("M8[s]"), np.dtype(">f8"), np.dtype("S3")):
        with pytest.raises(BufferError, match="DLPack has no numbers of type"):
            DeviceArray(3, dtype, device).__dlpack__()


def test_a_consumers_stream_waits_for_ours(cards: SimpleNamespace) -> None:
    array = place(cards.open(), np.arange(4.0))
    for stream, waits in ((None, False), (-1, False), (1, False), (2, True), (2**40, True)):
        cards.stub.calls.stub_forget()
        array.__dlpack__(stream=stream)
        assert ("cuCtxSynchronize" in dict(cards.stub.notes)) is waits
    for wrong in (0, -2, 1.5, "1", False):
        with pytest.raises(Refusal, match=r"DeviceArray: stream must"):
            array.__dlpack__(stream=wrong)


def test_the_processor_has_no_streams() -> None:
    with pytest.raises(Refusal, match="stream must be None on the processor, got 1"):
        place(ProcessorDevice(1), np.zeros(3)).__dlpack__(stream=1)


ENDS = """
import numpy as np
from arm_emulator_fleet.device_array import DeviceArray
from arm_emulator_fleet.processor_device import ProcessorDevice
array = DeviceArray(5, "f8", ProcessorDevice(1))
shared, capsule = np.from_dlpack(array), array.__dlpack__()
shared.flags.writeable
import builtins
builtins.remains = shared, capsule
"""


def test_a_process_ends_with_arrays_that_are_shared() -> None:
    command = [sys.executable, "-c", f"import sys; sys.path[:] = {sys.path}\n{ENDS}"]
    result = subprocess.run(command, capture_output=True, text=True, check=False)
    assert (result.returncode, result.stderr) == (0, "")


# Arrays of others


class Foreign:
    """An array of another library on a card, by the interfaces that it is given."""

    def __init__(self, array: DeviceArray, **changes: Any) -> None:
        self._array, self._changes = array, changes
        self.streams: list[int] = []


class ByInterface(Foreign):
    @property
    def __cuda_array_interface__(self) -> dict[str, Any]:
        return self._array.__cuda_array_interface__ | self._changes


class ByOldDlpack(Foreign):
    def __dlpack__(self, stream: int | None = None) -> object:
        self.streams.append(stream)
        return self._array.__dlpack__(stream=stream)

    def __dlpack_device__(self) -> tuple[int, int]:
        return self._array.__dlpack_device__()


class ByDlpack(ByOldDlpack):
    def __dlpack__(self, *, stream: int | None = None, max_version=None, **more) -> object:
        self.streams.append(stream)
        return self._array.__dlpack__(stream=stream, max_version=max_version, **more)


@pytest.mark.parametrize("kind", [ByInterface, ByOldDlpack, ByDlpack])
def test_arrays_of_others_on_the_card_are_taken_without_a_copy(
    cards: SimpleNamespace, kind: type[Foreign]
) -> None:
    card = cards.open()
    array = place(card, np.arange(6.0).reshape(3, 2))
    pointer, memory = array.pointer, weakref.ref(array.memory)
    foreign = kind(array)
    taken = convert_to_device_array(card, foreign)
    assert (taken.pointer, taken.shape, taken.dtype) == (pointer, (3, 2), np.float64)
    assert foreign.streams in ([], [1], [1, 1])
    del array, foreign
    assert memory() is not None, "it lives as long as what shares it"
    assert taken.numpy().tolist() == [[0.0, 1.0], [2.0, 3.0], [4.0, 5.0]]
    del taken
    assert memory() is None


@pytest.mark.parametrize("kind", [ByInterface, ByOldDlpack, ByDlpack])
def test_numbers_of_others_are_copied_on_the_card(
    cards: SimpleNamespace, kind: type[Foreign]
) -> None:
    card = cards.open()
    array, target = place(card, np.arange(6.0)), DeviceArray(6, "f8", card)
    cards.stub.calls.stub_forget()
    target.copy_from(kind(array))
    assert "cuMemcpyDtoD_v2" in dict(cards.stub.notes)
    assert "cuMemcpyDtoH_v2" not in dict(cards.stub.notes)
    assert target.numpy().tolist() == list(range(6))


@pytest.mark.parametrize(("stream", "waits"), [(None, False), (1, True), (2, True)])
def test_the_stream_of_an_array_is_waited_for(cards: SimpleNamespace, stream, waits) -> None:
    card = cards.open()
    foreign = ByInterface(place(card, np.arange(6.0)), stream=stream)
    cards.stub.calls.stub_forget()
    convert_to_device_array(card, foreign)
    assert ("cuStreamSynchronize" in dict(cards.stub.notes)) is waits


def test_arrays_that_must_not_be_written_to_are_copied(cards: SimpleNamespace) -> None:
    card = cards.open()
    array = place(card, np.arange(6.0))
    foreign = ByInterface(array, data=(array.pointer, True))
    taken = convert_to_device_array(card, foreign)
    assert taken.pointer != array.pointer and taken.numpy().tolist() == list(range(6))
    device, numbers = ProcessorDevice(1), np.arange(6.0)
    numbers.flags.writeable = False
    taken = convert_to_device_array(device, numbers)
    assert taken.pointer != numbers.ctypes.data and taken.numpy().tolist() == list(range(6))


def test_an_array_on_another_card_is_copied(cards: SimpleNamespace) -> None:
    first, second = cards.open(0), cards.open(1)
    array = place(first, np.arange(6.0))
    for values in (array, ByDlpack(array)):
        taken = convert_to_device_array(second, values)
        assert taken.device is second and taken.pointer != array.pointer
        assert taken.numpy().tolist() == list(range(6))
    with pytest.raises(Refusal, match=r"as_device_array: values must be an array of numbers"):
        convert_to_device_array(second, ByInterface(array))


def test_strided_foreign_arrays_are_refused_in_a_line(cards: SimpleNamespace) -> None:
    card = cards.open()
    foreign = ByInterface(place(card, np.arange(6.0)), strides=(16,), shape=(3,))
    with pytest.raises(Refusal, match=r"as_device_array: values must be an array of numbers"):
        convert_to_device_array(card, foreign)


def test_arrays_of_numpy_are_shared_where_they_can(cards: SimpleNamespace) -> None:
    device, card, numbers = ProcessorDevice(1), cards.open(), draw(shape=(4, 3))
    shared = convert_to_device_array(device, numbers)
    assert shared.pointer == numbers.ctypes.data
    for view in (numbers.T, numbers[::2], numbers[:, 1], numbers.astype(">f8"), numbers.tolist()):
        for where in (device, card):
            taken = convert_to_device_array(where, view)
            assert np.array_equal(taken.numpy(), np.asarray(view))
            assert taken.pointer != numbers.ctypes.data
    assert convert_to_device_array(device, numbers, "f8").pointer == numbers.ctypes.data
    single = convert_to_device_array(device, numbers, "f4")
    assert single.dtype == np.float32 and np.array_equal(single.numpy(), numbers.astype("f4"))
    assert convert_to_device_array(device, shared) is shared


def test_arrays_of_a_library_on_the_processor_are_shared() -> None:
    """NumPy's own DLPack stands for another library."""

    class Library:
        def __init__(self, numbers: np.ndarray) -> None:
            self.numbers = numbers

        def __dlpack__(self, **options) -> object:
            return self.numbers.__dlpack__(**options)

        def __dlpack_device__(self) -> tuple[int, int]:
            return self.numbers.__dlpack_device__()

    device = ProcessorDevice(1)
    for dtype in DTYPES:
        numbers = draw(dtype, (3, 2))
        taken = convert_to_device_array(device, Library(numbers))
        assert taken.pointer == numbers.ctypes.data and taken.dtype == dtype
        assert np.array_equal(taken.numpy(), numbers)
    for view in (numbers.T, numbers[::2]):
        taken = convert_to_device_array(device, Library(view))
        assert np.array_equal(taken.numpy(), view) and taken.pointer != view.ctypes.data
    array = DeviceArray((3, 2), numbers.dtype, device)
    array.copy_from(Library(numbers))
    assert np.array_equal(array.numpy(), numbers)


@pytest.mark.parametrize("values", [None, "abc", object(), [object()], {"a": 1.0}])
def test_no_numbers(device: Device, values) -> None:
    with pytest.raises(Refusal, match=r"as_device_array: values must be an array of numbers"):
        convert_to_device_array(device, values)


def test_cuda_arrays_are_on_cards_alone(cards: SimpleNamespace) -> None:
    array = place(cards.open(), np.arange(6.0).reshape(3, 2))
    assert array[1].__cuda_array_interface__ == {
        "shape": (2,), "typestr": "<f8", "data": (array.pointer + 16, False), "strides": None,
        "stream": 1, "version": 3,
    }  # fmt: skip
    assert not hasattr(place(ProcessorDevice(1), np.zeros(3)), "__cuda_array_interface__")


def test_numbers_that_numpy_has_not_are_no_array() -> None:
    """bfloat16, integers of 4 and 128 bits, vectors of 4 numbers."""
    for kind, bits, lanes in ((4, 16, 1), (0, 4, 1), (0, 128, 1), (2, 8, 1), (2, 32, 4), (7, 8, 1)):
        capsule = np.zeros(3).__dlpack__()
        tensor = dlpack._find_managed(capsule).tensor
        tensor.kind, tensor.bits, tensor.lanes = kind, bits, lanes
        handed = dlpack.read_capsule(capsule)
        assert handed is not None and handed.dtype is None and handed.shape == (3,)


def test_a_capsule_of_something_else_is_no_array() -> None:
    assert dlpack.read_capsule(np.zeros(3).__array_struct__) is None
    used = copy.copy(np.zeros(3)).__dlpack__()
    consumer = Consumer(used)
    assert dlpack.read_capsule(used) is None and dlpack.read_capsule(3) is None
    consumer.end()
    gc.collect()
