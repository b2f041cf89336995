"""A small importer of units of FMI 3.0, by ctypes alone, and the machines that its tests load."""

import ctypes
import math
import xml.etree.ElementTree as ET
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any
from xml.sax.saxutils import escape

import numpy as np
from machines import DC, PMSM, write_scene

from arm_emulator import Plant, Scene
from arm_emulator.machine.plant.compiler import build_machine_unit
from arm_emulator.machine.plant.core_calls import ARM
from arm_emulator.toolchain.c_header import Library
from arm_emulator.toolchain.compile_unit import compile_units
from oracles.random_chain import LINK

OK, WARNING, DISCARD, ERROR, FATAL = range(5)
KINDS = {"Float64": ctypes.c_double, "Int64": ctypes.c_int64, "Int32": ctypes.c_int32}
KINDS["Boolean"] = ctypes.c_bool
FURTHER_TYPES = ("Float32", "Int8", "UInt8", "Int16", "UInt16", "UInt32", "UInt64", "String")
LOG = ctypes.CFUNCTYPE(None, ctypes.c_void_p, ctypes.c_int, ctypes.c_char_p, ctypes.c_char_p)
WATCH = ctypes.CFUNCTYPE(
    None, ctypes.c_void_p, ctypes.c_double, *[ctypes.c_bool] * 4,
    ctypes.POINTER(ctypes.c_bool), ctypes.POINTER(ctypes.c_double),
)  # fmt: skip
POINTER, SIZE, DOUBLE, FLAG = ctypes.c_void_p, ctypes.c_size_t, ctypes.c_double, ctypes.c_bool
_VALUES = [POINTER, POINTER, SIZE, POINTER, SIZE]
_ARGUMENTS: dict[str, list[Any]] = {
    "SetDebugLogging": [POINTER, FLAG, SIZE, POINTER],
    "EnterInitializationMode": [POINTER, FLAG, DOUBLE, DOUBLE, FLAG, DOUBLE],
    **{name: [POINTER] for name in ("ExitInitializationMode", "Terminate", "Reset")},
    **{f"{verb}{kind}": _VALUES for verb in ("Get", "Set") for kind in (*KINDS, *FURTHER_TYPES)},
    "GetFMUState": [POINTER, POINTER],
    "SetFMUState": [POINTER, POINTER],
    "FreeFMUState": [POINTER, POINTER],
    "SerializedFMUStateSize": [POINTER, POINTER, POINTER],
    "SerializeFMUState": [POINTER, POINTER, POINTER, SIZE],
    "DeserializeFMUState": [POINTER, POINTER, SIZE, POINTER],
    "DoStep": [POINTER, DOUBLE, DOUBLE, FLAG] + [POINTER] * 4,
    # Some of what is not supported.
    **{name: [POINTER] for name in ("EnterEventMode", "EnterStepMode", "EnterConfigurationMode")},
    "GetNumberOfContinuousStates": [POINTER, POINTER],
    "GetOutputDerivatives": [POINTER, POINTER, SIZE, POINTER, POINTER, SIZE],
    "SetTime": [POINTER, DOUBLE],
}


class Fmu:
    """A unit, unpacked and loaded.

    Attributes:
        root: of modelDescription.xml.
        variables: its elements by name.
        binary: the loaded library.
    """

    def __init__(self, file: Path, folder: Path, mode: int = ctypes.DEFAULT_MODE) -> None:
        with zipfile.ZipFile(file) as archive:
            archive.extractall(folder)
        self.root = ET.parse(folder / "modelDescription.xml").getroot()
        listed = self.root.find("ModelVariables")
        assert listed is not None, "variables are listed"
        self.variables = {variable.attrib["name"]: variable for variable in listed}
        (library,) = (folder / "binaries" / "x86_64-linux").iterdir()
        self.binary = ctypes.CDLL(str(library), mode)
        for name, arguments in _ARGUMENTS.items():
            function = getattr(self.binary, f"fmi3{name}")
            function.argtypes, function.restype = arguments, ctypes.c_int
        self.binary.fmi3InstantiateCoSimulation.restype = POINTER
        self.binary.fmi3InstantiateCoSimulation.argtypes = (
            [ctypes.c_char_p] * 3 + [FLAG] * 4 + [POINTER, SIZE, POINTER, LOG, WATCH]
        )
        self.binary.fmi3FreeInstance.argtypes = [POINTER]
        self.binary.fmi3FreeInstance.restype = None

    def size(self, name: str) -> int:
        """Number of a variable's values."""
        return math.prod(int(variable.attrib["start"]) for variable in self.variables[name])


class Instance:
    """An instance, ready to be initialised.

    Attributes:
        stated: what it has logged: status, category, text.
        handle: of it.
        early: whether the last step returned early.

    Args:
        fmu: the unit.
        logging: of everything.
        token: in place of the unit's own.
        watch: is called at ticks in the midst of a step, with the time; returns the time at which
            the step shall end, or None.
    """

    def __init__(
        self,
        fmu: Fmu,
        logging: bool = True,
        token: str | None = None,
        watch: Callable[[float], float | None] | None = None,
    ) -> None:
        self.fmu = fmu
        self.printed: list[tuple[int, str, str]] = []
        self._log = LOG(self._hear)
        self._watch = WATCH(self._look) if watch else WATCH()
        self._watched = watch
        self.early = False
        token = fmu.root.attrib["instantiationToken"] if token is None else token
        self.handle = fmu.binary.fmi3InstantiateCoSimulation(
            b"one", token.encode(), None, False, logging, False, bool(watch), None, 0, None,
            self._log, self._watch,
        )  # fmt: skip
        self.time = 0.0

    def __del__(self) -> None:
        self.fmu.binary.fmi3FreeInstance(self.handle)

    def _hear(self, _: Any, status: int, category: bytes, text: bytes) -> None:
        self.printed.append((status, category.decode(), text.decode()))

    def _look(self, _: Any, time: float, wants: bool, may_get: bool, finished: bool, early: bool,
              requested: Any, until: Any) -> None:  # fmt: skip
        assert (wants, may_get, finished, early) == (False, True, True, True), "what is offered"
        assert self._watched is not None
        end = self._watched(time)
        requested[0] = end is not None
        until[0] = end or 0.0

    def call(self, name: str, *arguments: Any) -> int:
        """Call a function and return its status."""
        status: int = getattr(self.fmu.binary, f"fmi3{name}")(self.handle, *arguments)
        return status

    def start(self, start: float = 0.0, stop: float | None = None) -> None:
        """Go to step mode."""
        has_stop = stop is not None
        status = self.call("EnterInitializationMode", False, 0.0, start, has_stop, stop or 0.0)
        assert status == OK, self.printed
        assert self.call("ExitInitializationMode") == OK, self.printed
        self.time = start

    def set(self, name: str, values: Any) -> int:
        """Set a variable."""
        variable = self.fmu.variables[name]
        row = np.atleast_1d(values).ravel().tolist()
        array = (KINDS[variable.tag] * len(row))(*row)
        reference = ctypes.c_uint32(int(variable.attrib["valueReference"]))
        return self.call(f"Set{variable.tag}", ctypes.byref(reference), 1, array, len(row))

    def get(self, name: str) -> np.ndarray:
        """Return the values of a variable."""
        variable = self.fmu.variables[name]
        count = self.fmu.size(name)
        array = (KINDS[variable.tag] * count)()
        reference = ctypes.c_uint32(int(variable.attrib["valueReference"]))
        status = self.call(f"Get{variable.tag}", ctypes.byref(reference), 1, array, count)
        assert status == OK, self.printed
        return np.array(array)

    def everything(self) -> dict[str, bytes]:
        """Return the values of all variables, to the last bit."""
        return {name: self.get(name).tobytes() for name in self.fmu.variables}

    def step(self, seconds: float) -> int:
        """Take a step."""
        flags, last = (ctypes.c_bool * 3)(), ctypes.c_double()
        places = [ctypes.byref(flags, k) for k in range(3)]
        status = self.call("DoStep", self.time, seconds, True, *places, ctypes.byref(last))
        self.time, self.early = last.value, bool(flags[2])
        return status

    def save(self) -> bytes:
        """Return the serialized state."""
        state, size = ctypes.c_void_p(), ctypes.c_size_t()
        assert self.call("GetFMUState", ctypes.byref(state)) == OK, self.printed
        assert self.call("SerializedFMUStateSize", state, ctypes.byref(size)) == OK, self.printed
        array = ctypes.create_string_buffer(size.value)
        assert self.call("SerializeFMUState", state, array, size) == OK, self.printed
        assert self.call("FreeFMUState", ctypes.byref(state)) == OK, self.printed
        return array.raw

    def restore(self, saved: bytes) -> int:
        """Go back to a serialized state."""
        state = ctypes.c_void_p()
        status = self.call("DeserializeFMUState", saved, len(saved), ctypes.byref(state))
        if status == OK:
            status = self.call("SetFMUState", state)
            self.call("FreeFMUState", ctypes.byref(state))
        if status == OK:
            self.time = float(self.get("time")[0])
        return status


def plant_for(scene: Scene, target: str) -> Plant:
    """A plant whose library is for a target, whatever else the cache has."""
    (file,) = compile_units([build_machine_unit(scene)], target, None)
    return Plant(scene, core=Library(file, (ARM,)))


def rich_machine(folder: Path, names: tuple[str, ...], **keys: Any) -> Path:
    """A scene with much of what a scene may have, of as many joints as names: a link that turns,
    one that slides, one that swings freely.
    """
    kinds = ("revolute", "0 0 1"), ("prismatic", "1 0 0"), ("revolute", "0 1 0")
    urdf, parent = '<robot name="rich"><link name="base"/>', "base"
    for name, (kind, axis) in zip(names, kinds, strict=False):
        name = escape(name, {'"': "&quot;"})
        urdf += LINK.format(
            name=name, kind=kind, xyz="0.1 0.2 0.3", rpy="0 0 0", parent=parent, axis=axis,
            com="0.1 0 0", com_rpy="0 0 0", mass=2.0, ixx=0.1, iyy=0.1, izz=0.1, ixy=0, ixz=0,
            iyz=0,
        )  # fmt: skip
        parent = f"{name}_link"
    noisy = {"noise": 0.01}
    encoder = {"counts_per_turn": 4096, "index": "latch"}
    winding = {"heat_capacity": 5.0, "thermal_resistance": 4.0, "limit": 25.0}
    sections: list[dict[str, Any]] = [
        {
            "start": 0.3,
            "motor": {**PMSM, "winding": winding},
            "gear": {"ratio": 0.05, "stiffness": 1e4, "damping": 1.0},
            "brake": {"torque": 1.0, "close_delay": 0.003},
            "encoder": encoder,
            "link_encoder": {**encoder, "counts_per_turn": 8192},
            "current_sensor": noisy,
            "torque_sensor": noisy,
        },
        {
            "motor": {**DC, "current_limit": 5.0},
            "gear": {"ratio": 0.01},
            "encoder": {"counts_per_turn": 1000},
        },
        {"start": -0.2, "friction": {"viscous": 0.01}},
    ]
    unit = {"link": f"{names[-1]}_link", "accelerometer": noisy, "gyroscope": noisy}
    keys = {
        "imus": {"unit 1": unit},
        "seed": 7,
        "gravity": [0.0, 0.0, -9.81],
        "external_wrench": True,
        "payload": {"mass": 0.5},
        "varied": ["payload.mass", "joints.*.gear.stiffness", "seed"],
        "integrator": {"scheme": "implicit", "dt": 5e-4},
        **keys,
    }
    joints = dict(zip(names, sections, strict=False))
    return write_scene(folder, urdf + "</robot>", joints, **keys)


def abuse(rng: np.random.Generator, fmu: Fmu, calls: int) -> dict[int, int]:
    """Call anything in any order, with wrong arguments too; return how often which status came.

    Raises:
        AssertionError: an unknown status, or a call that was not taken and changed a value.
    """
    pair = Instance(fmu), Instance(fmu, logging=False)
    statuses = dict.fromkeys(range(4), 0)
    for _ in range(calls):
        instance = pair[int(rng.integers(2))]
        before = instance.save()
        name, status = _call(rng, instance, pair)
        assert status in statuses, f"{name} returns {status}"
        statuses[status] += 1
        after = instance.save()
        if status == DISCARD:
            assert after == before, f"{name} was discarded, and yet something changed"
        if status == ERROR and name != "DoStep":  # a step may diverge
            assert after[24:-8] == before[24:-8], f"{name} failed, and yet a value changed"
        if status == ERROR and rng.random() < 0.8:
            assert instance.call("Reset") == OK, f"a reset helps: {instance.printed}"
            if rng.random() < 0.9:
                instance.start()
        if rng.random() < 0.1:
            for values in map(instance.get, ("truth.q", "truth.v", "truth.energy", "current")):
                assert np.isfinite(values).all(), f"after {name}: {values}"
    return statuses


_STRANGE = (math.nan, math.inf, -math.inf, 1e308, -1e9, 5e-324, 0.0, -0.0, 1e18, 1e6)


def strange_number(rng: np.random.Generator) -> float:
    """A number, now and then one that no machine takes."""
    return float(rng.choice(_STRANGE) if rng.random() < 0.1 else rng.normal(0.0, 10.0))


def _call(
    rng: np.random.Generator, instance: Instance, pair: tuple[Instance, ...]
) -> tuple[str, int]:
    """Make one call, mostly one that makes sense."""
    kind = rng.random()
    if kind < 0.02:
        return "Reset", instance.call("Reset")
    if kind < 0.06:
        stop = float(rng.choice([1e9, 0.01, math.nan, -1.0]))
        start = 0.0 if rng.random() < 0.9 else strange_number(rng)
        has_stop = bool(rng.random() < 0.3)
        instance.time = start
        name = "EnterInitializationMode"
        return name, instance.call(name, False, 0.0, start, has_stop, stop)
    if kind < 0.1:
        return "ExitInitializationMode", instance.call("ExitInitializationMode")
    if kind < 0.4:
        if rng.random() < 0.05:
            instance.time = strange_number(rng)
        step = 1e-3 * float(rng.integers(1, 4)) if rng.random() < 0.9 else strange_number(rng)
        if step > 1.0:  # or it takes its time
            step = 1e300
        if rng.random() < 0.03:
            return "DoStep", instance.call(
                "DoStep", instance.time, step, True, None, None, None, None
            )
        return "DoStep", instance.step(step)
    if kind < 0.85:
        return _values(rng, instance)
    if kind < 0.95:
        return _states(rng, instance, pair[0] if instance is pair[1] else pair[1])
    name = str(rng.choice([
        "Terminate", "EnterEventMode", "EnterStepMode", "EnterConfigurationMode", "SetTime",
        "GetNumberOfContinuousStates", "GetOutputDerivatives", "SetDebugLogging",
    ]))  # fmt: skip
    if name == "SetDebugLogging":
        categories = [b"logEvents", b"logStatusDiscard", b"logStatusError", b"", b"logAll", None]
        some = [categories[k] for k in rng.integers(0, len(categories), int(rng.integers(0, 3)))]
        array = (ctypes.c_char_p * len(some))(*some)
        return name, instance.call(name, bool(rng.integers(2)), len(some), array if some else None)
    if name == "SetTime":
        return name, instance.call(name, strange_number(rng))
    return name, instance.call(
        name, *[None if kind is POINTER else 0 for kind in _ARGUMENTS[name][1:]]
    )


def _values(rng: np.random.Generator, instance: Instance) -> tuple[str, int]:
    """Get or set some variables, mostly of the right type and size."""
    kind = str(rng.choice([*KINDS, "Float64", "Float64"]))
    if rng.random() < 0.05:
        kind = str(rng.choice(FURTHER_TYPES))
    variables = list(instance.fmu.variables.values())
    fitting = [v for v in variables if v.tag == kind] or variables
    count = int(rng.integers(0, 4))
    some = [fitting[k] for k in rng.integers(0, len(fitting), count)]
    references = [int(v.attrib["valueReference"]) for v in some]
    if references and rng.random() < 0.1:
        references[-1] = int(rng.choice([len(variables), 2**31, 2**32 - 1, 0, 3]))
    size = sum(instance.fmu.size(v.attrib["name"]) for v in some)
    if rng.random() < 0.1:
        size = int(rng.integers(0, 40))
    c_type = KINDS.get(kind, ctypes.c_void_p)
    array = (c_type * size)()
    if kind == "Float64":
        array[:] = [strange_number(rng) for _ in range(size)]
    elif kind == "Boolean":
        ctypes.memset(array, int(rng.integers(256)), ctypes.sizeof(array))
    name = f"{'Get' if rng.random() < 0.4 else 'Set'}{kind}"
    reference_array: Any = (ctypes.c_uint32 * count)(*references)
    if rng.random() < 0.03:
        reference_array = None
    values: Any = None if rng.random() < 0.03 else array
    return name, instance.call(name, reference_array, count, values, size)


def _states(rng: np.random.Generator, instance: Instance, source: Instance) -> tuple[str, int]:
    """Keep, go back, serialize, with states that are null, freed or of another instance."""
    saved = bytearray(source.save())
    if rng.random() < 0.5:
        for _ in range(int(rng.integers(1, 4))):
            saved[int(rng.integers(len(saved)))] ^= 1 << int(rng.integers(8))
        status = instance.restore(bytes(saved))
        assert status == ERROR, "a state that was spoiled is refused"
        return "DeserializeFMUState", status
    if rng.random() < 0.3:
        return "DeserializeFMUState", instance.restore(
            bytes(saved[: int(rng.integers(len(saved)))])
        )
    state, foreign = ctypes.c_void_p(), ctypes.c_void_p()
    assert source.call("GetFMUState", ctypes.byref(foreign)) == OK, source.printed
    name = str(rng.choice(["SetFMUState", "FreeFMUState", "GetFMUState", "SerializeFMUState"]))
    if rng.random() < 0.5:
        assert instance.call("GetFMUState", ctypes.byref(state)) == OK, instance.printed
        if rng.random() < 0.3:
            freed = ctypes.c_void_p(state.value)
            assert instance.call("FreeFMUState", ctypes.byref(state)) == OK, instance.printed
            state = freed
    else:
        state = ctypes.c_void_p(rng.choice([None, foreign.value]))
    size = int(rng.choice([len(saved), 0, 8]))
    array = ctypes.create_string_buffer(size)
    status = {
        "SetFMUState": lambda: instance.call(name, state),
        "FreeFMUState": lambda: instance.call(name, ctypes.byref(state)),
        "GetFMUState": lambda: instance.call(name, ctypes.byref(state)),
        "SerializeFMUState": lambda: instance.call(name, state, array, size),
    }[name]()
    source.call("FreeFMUState", ctypes.byref(foreign))
    return name, status
