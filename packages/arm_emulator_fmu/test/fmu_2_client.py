"""As fmu_client.py, for units of FMI 2.0."""

import ctypes
import xml.etree.ElementTree as ET
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
from fmu_client import DISCARD, DOUBLE, ERROR, OK, POINTER, SIZE, strange_number

KINDS = {"Real": ctypes.c_double, "Integer": ctypes.c_int, "Boolean": ctypes.c_int}
KINDS["String"] = ctypes.c_void_p
INT = ctypes.c_int
_ARGUMENTS: dict[str, list[Any]] = {
    "SetDebugLogging": [POINTER, INT, SIZE, POINTER],
    "SetupExperiment": [POINTER, INT, DOUBLE, DOUBLE, INT, DOUBLE],
    **{f"{step}InitializationMode": [POINTER] for step in ("Enter", "Exit")},
    **{name: [POINTER] for name in ("Terminate", "Reset", "CancelStep")},
    **{f"{verb}{kind}": [POINTER, POINTER, SIZE, POINTER] for verb in ("Get", "Set")
       for kind in KINDS},
    "DoStep": [POINTER, DOUBLE, DOUBLE, INT],
    "GetFMUstate": [POINTER, POINTER],
    "SetFMUstate": [POINTER, POINTER],
    "FreeFMUstate": [POINTER, POINTER],
    "SerializedFMUstateSize": [POINTER, POINTER, POINTER],
    "SerializeFMUstate": [POINTER, POINTER, POINTER, SIZE],
    "DeSerializeFMUstate": [POINTER, POINTER, SIZE, POINTER],
    **{f"Get{kind}Status": [POINTER, INT, POINTER] for kind in (*KINDS, "")},
}  # fmt: skip


class Fmu2:
    """A unit, unpacked and loaded."""

    def __init__(self, file: Path, folder: Path) -> None:
        with zipfile.ZipFile(file) as archive:
            archive.extractall(folder)
        self.root = ET.parse(folder / "modelDescription.xml").getroot()
        self.kinds = [pair[0].tag for pair in self.root.iter("ScalarVariable")]
        (library,) = (folder / "binaries" / "linux64").iterdir()
        self.binary = ctypes.CDLL(str(library))
        for name, arguments in _ARGUMENTS.items():
            getattr(self.binary, f"fmi2{name}").argtypes = arguments
        make = self.binary.fmi2Instantiate
        make.restype = POINTER
        make.argtypes = [ctypes.c_char_p, INT, ctypes.c_char_p, ctypes.c_char_p, POINTER, INT, INT]
        self.binary.fmi2FreeInstance.argtypes = [POINTER]

    def instance(self) -> int:
        """Return a new instance."""
        guid = self.root.attrib["guid"].encode()
        handle: int = self.binary.fmi2Instantiate(b"one", 1, guid, None, None, 0, 1)
        return handle


class _Abuser:
    """Calls of one instance, with wrong arguments too.

    Attributes:
        time: of the next step [s].
    """

    def __init__(self, rng: np.random.Generator, fmu: Fmu2) -> None:
        self._rng, self._fmu = rng, fmu
        self.handle = fmu.instance()
        self.time = 0.0

    def call(self, name: str, *arguments: Any) -> int:
        status: int = getattr(self._fmu.binary, f"fmi2{name}")(self.handle, *arguments)
        return status

    def save(self) -> bytes:
        state, size = ctypes.c_void_p(), ctypes.c_size_t()
        assert self.call("GetFMUstate", ctypes.byref(state)) == OK, "a state is kept"
        assert self.call("SerializedFMUstateSize", state, ctypes.byref(size)) == OK, "it has a size"
        array = ctypes.create_string_buffer(size.value)
        assert self.call("SerializeFMUstate", state, array, size) == OK, "it is written"
        assert self.call("FreeFMUstate", ctypes.byref(state)) == OK, "it is forgotten"
        return array.raw

    def any(self) -> tuple[str, int]:
        """Call a function drawn at random; return its name and status."""
        kind = self._rng.random()
        if kind < 0.4:
            return self._step()
        if kind < 0.85:
            return self._values()
        return self._states() if kind < 0.93 else self._rest()

    def _step(self) -> tuple[str, int]:
        rng = self._rng
        step = 1e-3 * float(rng.integers(1, 4)) if rng.random() < 0.9 else strange_number(rng)
        step = 1e300 if step > 1.0 else step  # or it takes its time
        return "DoStep", self.call("DoStep", self.time, step, 1)

    def _values(self) -> tuple[str, int]:
        rng, kinds = self._rng, self._fmu.kinds
        kind = str(rng.choice(["Real", "Real", "Boolean", "Integer", "String"]))
        fitting = [k for k, variable_kind in enumerate(kinds) if variable_kind == kind] or [0]
        count = int(rng.integers(0, 5))
        references = [int(k) for k in rng.choice(fitting, count)]
        if references and rng.random() < 0.05:
            references[-1] = int(rng.choice([len(kinds), 2**31, 2**32 - 1, 0]))
        array = (KINDS[kind] * count)()
        if kind != "String":
            number = strange_number if kind == "Real" else lambda rng: int(rng.integers(-2, 3))
            array[:] = [number(rng) for _ in range(count)]
        name = f"{'Get' if rng.random() < 0.4 else 'Set'}{kind}"
        reference_array: Any = (
            None if rng.random() < 0.02 else (ctypes.c_uint32 * count)(*references)
        )
        return name, self.call(name, reference_array, count, None if rng.random() < 0.02 else array)

    def _states(self) -> tuple[str, int]:
        rng, saved = self._rng, bytearray(self.save())
        if rng.random() < 0.5:
            saved[int(rng.integers(len(saved)))] ^= 1 << int(rng.integers(8))
        state = ctypes.c_void_p()
        name = "DeSerializeFMUstate"
        status = self.call(name, bytes(saved), len(saved), ctypes.byref(state))
        if status == OK and rng.random() < 0.5:
            freed = ctypes.c_void_p(state.value)
            assert self.call("FreeFMUstate", ctypes.byref(state)) == OK, "it is forgotten"
            state = freed
        if status == OK:
            name = str(rng.choice(["SetFMUstate", "FreeFMUstate"]))
            status = self.call(name, state if name == "SetFMUstate" else ctypes.byref(state))
        return name, status

    def _rest(self) -> tuple[str, int]:
        rng = self._rng
        name = str(
            rng.choice(
                [
                    argument
                    for argument in _ARGUMENTS
                    if "Status" in argument or argument[0] in "SCTR"
                ]
            )
        )
        arguments = [
            None if kind is POINTER else 0.0 if kind is DOUBLE else int(rng.integers(0, 4))
            for kind in _ARGUMENTS[name][1:]
        ]
        if "Status" in name and rng.random() < 0.8:
            arguments[1] = ctypes.byref(ctypes.c_double())
        return name, self.call(name, *arguments)

    def begin_again(self) -> None:
        assert self.call("Reset") == OK, "a reset helps"
        for mode in ("Enter", "Exit") if self._rng.random() < 0.9 else ():
            assert self.call(f"{mode}InitializationMode") == OK, "it begins again"

    def take_time(self) -> None:
        here = ctypes.c_double()
        assert self.call("GetRealStatus", 2, ctypes.byref(here)) == OK, "the time is reported"
        self.time = here.value if self._rng.random() < 0.98 else strange_number(self._rng)


def abuse_2(rng: np.random.Generator, fmu: Fmu2, calls: int) -> dict[int, int]:
    """Call anything in any order, with wrong arguments too; return how often which status came.

    Raises:
        AssertionError: an unknown status, or a call that was not taken and changed a value.
    """
    abuser = _Abuser(rng, fmu)
    statuses = dict.fromkeys(range(4), 0)
    for _ in range(calls):
        before = abuser.save()
        name, status = abuser.any()
        assert status in statuses, f"{name} returns {status}"
        statuses[status] += 1
        after = abuser.save()
        if status == DISCARD:
            assert after == before, f"{name} was discarded, and yet something changed"
        if status == ERROR and name != "DoStep":  # a step may diverge
            assert after[24:-8] == before[24:-8], f"{name} failed, and yet a value changed"
        if status == ERROR and rng.random() < 0.8:
            abuser.begin_again()
        abuser.take_time()
    fmu.binary.fmi2FreeInstance(abuser.handle)
    return statuses
