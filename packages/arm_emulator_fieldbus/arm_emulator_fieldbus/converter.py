"""The paper's data converter: encoder counts and currents in, motor commands out, as registers.

docs/how_to/modbus.md has the table. It stands between a bus of 16-bit words and a `Session`; of
Modbus it uses only the codes of refusals.
"""

import itertools
import math
import struct
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from arm_emulator.extension.base import Refusal
from arm_emulator.extension.machine import (
    ALWAYS_OUTPUTS,
    ARM_HEADER,
    OUTPUT_AXES,
    DuplicateCommand,
    Joint,
    Output,
    Scene,
    Session,
    find_input,
    list_further_inputs,
    list_outputs,
    list_units,
)
from arm_emulator_fieldbus.modbus_rtu import Code, ModbusException

MAP_VERSION = 2
# First addresses of the blocks of registers.
MACHINE, MEASURED, COMMANDED, SETTINGS, FAULTS, JOINTS = 0, 1000, 2000, 3000, 4000, 10000
FAULT_NAMES = 20000
PER_JOINT = 48  # registers of a joint's description
PER_FAULT = 40  # registers of a fault's name
PER_MAGNITUDE = 4  # registers of a fault's magnitude, a float64

# Bits of the status.
POWERED, WATCHDOG, FAULT, RUNNING = 1, 2, 4, 8
# Bits of the control word.
POWER, ACKNOWLEDGE, RESET = 1, 2, 4

FULL_SCALE = 32768  # of a command's word
LARGEST_PERIOD = 2**32 - 1  # ns, that a register can report


@dataclass(frozen=True)
class Block:
    """Registers of one kind, a row of docs/how_to/modbus.md."""

    address: int
    count: int  # registers
    per: int  # of them per joint, 0: not by joints
    name: str
    kind: str
    unit: str
    writable: bool = False


def find_full_scale(scene: Scene, joint: Joint) -> float:
    """Return the full scale of commands, 32768 [V, N m or A, as the joint's motor takes it].

    Raises:
        Refusal: unknown, since a motor's torque or current has no limit.
    """
    limit = float(scene.largest_commands[scene.joints.index(joint)])
    if not math.isfinite(limit):
        assert joint.motor is not None, "a joint without a motor has the supply's"
        where = f"joints.{joint.name}.motor.{joint.motor.limit}"
        raise Refusal(scene.where, where, "be given: it is the full scale of its command", "none")
    return limit


def list_measurements(scene: Scene) -> tuple[Output, ...]:
    """Return the measurements in the order of registers, those of every machine first."""
    return tuple(dict.fromkeys((*ALWAYS_OUTPUTS, *list_outputs(scene))))


# Words of a value and its type, by the kind of an output.
_WORDS = {
    "number": (2, "float32"),
    "count": (2, "int32"),
    "flag": (1, "uint16"),
    "bits": (1, "uint16"),
}


def list_measured_blocks(scene: Scene) -> list[Block]:
    """Return the registers of measurements, in their order, without addresses."""
    rows, N = [], len(scene.joints)
    for output in list_measurements(scene):
        per, kind = _WORDS[output.kind]
        unit = "counts, modulo 2^32" if output.kind == "count" else output.unit
        if output.per_unit:
            for unit_of_scene in scene.imus:
                name = f"{unit_of_scene.name}: {output.about}, x, y, z"
                rows.append(Block(0, per * OUTPUT_AXES, 0, name, kind, unit))
        else:
            units = " or ".join(dict.fromkeys(list_units(scene, output))) or unit
            rows.append(Block(0, per * N, per, output.about, kind, units))
    return rows


def list_blocks(scene: Scene) -> tuple[Block, ...]:
    """Return the table of registers of a scene, by address."""
    N = len(scene.joints)
    rows = [
        Block(MACHINE, 1, 0, "version of this table", "uint16", "1"),
        Block(MACHINE + 1, 1, 0, "joints N", "uint16", "1"),
        Block(MACHINE + 2, 2, 0, "servo period", "uint32", "ns"),
        Block(MEASURED, 1, 0, "status", "bits", ""),
        Block(MEASURED + 1, 2, 0, "tick, modulo 2^32", "uint32", "servo periods"),
    ]
    at = MEASURED + 3
    for block in list_measured_blocks(scene):
        rows.append(replace(block, address=at))
        at += block.count
    rows += [
        Block(COMMANDED, 1, 0, "control", "bits", "", True),
        *(
            Block(COMMANDED + 1 + k * N, N, 1, name, "int16", "full scale / 32768", True)
            for k, name in enumerate(("command", *list_further_inputs(scene)))
        ),
        Block(SETTINGS, 1, 0, "watchdog, 0: none", "uint16", "ms", True),
        Block(FAULTS, 1, 0, "faults F", "uint16", "1"),
    ]
    for k, fault in enumerate(scene.faults):
        name = f"magnitude of {fault.varied.name}, 0: off"
        rows.append(Block(FAULTS + 1 + 4 * k, 4, 0, name, "float64", "", True))
    for joint in range(N):
        at = JOINTS + PER_JOINT * joint
        for count, name, kind, unit in (
            (1, "turns (0) or slides (1)", "uint16", "1"),
            (1, "commanded V (1), N m (2), A (4), V across the flux (8)", "uint16", "1"),
            (4, "full scale of its command", "float64", "V, N m or A"),
            (4, "encoder at the motor", "float64", "counts/rad"),
            (4, "where its counts wrap, 0: nowhere", "int64", "counts"),
            (4, "gear ratio", "float64", "rad or m per rad"),
            (4, "encoder at the link", "float64", "counts/rad or counts/m"),
            (4, "where its counts wrap, 0: nowhere", "int64", "counts"),
            (PER_JOINT - 42, "0", "", ""),
            (16, "name", "UTF-8", ""),
        ):
            rows.append(Block(at, count, 0, f"joint {joint}: {name}", kind, unit))
            at += count
    rows += [
        Block(FAULT_NAMES + PER_FAULT * k, PER_FAULT, 0, f"fault {k}: name", "UTF-8", "")
        for k in range(len(scene.faults))
    ]
    return tuple(rows)


class RegisterConverter:
    """Registers of a machine, and the watchdog over its master.

    Its owner advances time by `pass_period`, or the session's loop does in real time.

    Attributes:
        session: the machine.
        target: commands that were written last, and further inputs (1 + I, N) [V, N m or A].
        on_commands: is called when commands were written.

    Args:
        session: the machine, at tick 0.
        watchdog: how long the drives stay on without new commands [ms]; 0: indefinitely.

    Raises:
        Refusal: no such time, or a scene that registers cannot report.
    """

    def __init__(self, session: Session, watchdog: int) -> None:
        scene = session.scene
        if not 0 <= watchdog <= 0xFFFF:
            raise Refusal("modbus", "watchdog", "be 0 to 65535 ms", watchdog)
        if session.period_ns > LARGEST_PERIOD:
            rule = f"be at most {LARGEST_PERIOD / 1e9:g} s"
            raise Refusal(scene.where, "servo_period", rule, scene.servo_period)
        N = len(scene.joints)
        self._inputs = list_further_inputs(scene)
        inputs = N * (1 + len(self._inputs))
        largest = SETTINGS - COMMANDED - 1
        if inputs > largest:
            raise Refusal(scene.where, "inputs of motors", f"be at most {largest}", inputs)
        measured = 3 + sum(block.count for block in list_measured_blocks(scene))
        if measured > COMMANDED - MEASURED:
            rule = f"fill at most {COMMANDED - MEASURED} registers with measurements"
            raise Refusal(scene.where, "joints and their sensors", rule, measured)
        largest = min((JOINTS - FAULTS - 1) // 4, (0x10000 - FAULT_NAMES) // PER_FAULT)
        if len(scene.faults) > largest:
            raise Refusal(scene.where, "faults", f"be at most {largest}", len(scene.faults))
        self._outputs = list_measurements(scene)
        self.session = session
        self._faults = [fault.varied for fault in scene.faults]
        self._full_scale = np.array([find_full_scale(scene, joint) for joint in scene.joints])
        self._per_word = self._full_scale / FULL_SCALE
        self._N = N
        # Whether a word of the commands is taken: a motor without a further input has 0 there.
        self._is_taken = [True] * N + [
            find_input(joint, name) is not None for name in self._inputs for joint in scene.joints
        ]
        self._fixed = {
            MACHINE: [MAP_VERSION, N, *_pack_words(">I", session.period_ns)],
            JOINTS: [word for joint in range(N) for word in self._describe_joint(joint)],
            FAULT_NAMES: [
                word
                for fault in self._faults
                for word in _pack_words(f">{2 * PER_FAULT}s", fault.name.encode())
            ],
        }
        starts = (MACHINE, MEASURED, COMMANDED, SETTINGS, FAULTS, JOINTS, FAULT_NAMES)
        self._sizes: dict[int, int] = {}  # of the blocks, by their first addresses
        for block in list_blocks(scene):
            start = max(base for base in starts if base <= block.address)
            self._sizes[start] = block.address + block.count - start
        self.on_commands: Callable[[], object] = lambda: None
        self._watchdog = watchdog
        self._forget_commands()

    def _forget_commands(self) -> None:
        self._zero_commands()
        self._zoh_target = self.target  # in the period that is under way
        self._written_tick: int | None = None  # when the newest commands came
        self._tripped = False

    def _zero_commands(self) -> None:
        """Set all commands to 0."""
        self._command = [0] * self._N * (1 + len(self._inputs))
        self.target = np.zeros((1 + len(self._inputs), self._N))

    def _describe_joint(self, index: int) -> tuple[int, ...]:
        scene = self.session.scene
        joint = ARM_HEADER.make_struct("arm_joint_description")
        self.session.plant.core.arm_describe_joint(index, joint)
        return _pack_words(
            ">2H2dq2dq12x32s",
            joint.kind,
            joint.modes & 0xFFFF,
            find_full_scale(scene, scene.joints[index]),
            joint.counts_per_rad,
            joint.encoder_wrap,
            joint.gear_ratio,
            joint.link_counts_per_rad,
            joint.link_encoder_wrap,
            scene.joint_names[index].encode(),
        )

    def _find_block(self, address: int, count: int) -> tuple[int, int]:
        for base, size in self._sizes.items():
            if base <= address and address + count <= base + size:
                return base, address - base
        raise ModbusException(Code.ADDRESS)

    def read(self, address: int, count: int) -> Sequence[int]:
        """Return registers, see `modbus_rtu.Registers`."""
        base, at = self._find_block(address, count)
        if base == MEASURED:
            words: Sequence[int] = self._read_measurement(at + count)
        elif base == COMMANDED:
            words = [POWER * self.session.powered, *(word & 0xFFFF for word in self._command)]
        elif base == SETTINGS:
            words = [self._watchdog]
        elif base == FAULTS:
            present = self.session.plant.parameters
            magnitudes = (_pack_words(">d", present[fault.name]) for fault in self._faults)
            words = [len(self._faults), *itertools.chain.from_iterable(magnitudes)]
        else:
            words = self._fixed[base]
        return words[at : at + count]

    @property
    def status(self) -> int:
        """Bits of the status."""
        session = self.session
        return (
            POWERED * session.powered
            | WATCHDOG * self._tripped
            | FAULT * (session.fault is not None)
            | RUNNING * (self._written_tick is not None)
        )

    def _read_measurement(self, count: int) -> Sequence[int]:
        """Return at least the first `count` words of the measurement."""
        session = self.session
        tick = session.tick
        words = [self.status, tick >> 16 & 0xFFFF, tick & 0xFFFF]
        measured = session.measured
        for output in self._outputs:
            if len(words) >= count:
                break
            values = getattr(measured, output.name).ravel()
            if output.kind == "number":
                values = values.astype(">f4").view(">u4").astype(np.int64)
            words += _split_words(values) if _WORDS[output.kind][0] == 2 else values.tolist()
        return words

    def write(self, address: int, words: Sequence[int]) -> None:
        """Take registers, see `modbus_rtu.Registers`."""
        base, at = self._find_block(address, len(words))
        if base == SETTINGS:
            self._watchdog = words[0]
            return
        if base == FAULTS and at:
            self._take_magnitudes(at - 1, words)
            return
        if base != COMMANDED:
            raise ModbusException(Code.ADDRESS)
        control = words[0] if at == 0 else None
        if control is not None and control & ~(POWER | ACKNOWLEDGE | RESET):
            raise ModbusException(Code.VALUE)
        values = words[1:] if at == 0 else words
        first = max(at - 1, 0)
        taken = self._is_taken[first:]
        if any(word and not is_taken for word, is_taken in zip(values, taken, strict=False)):
            raise ModbusException(Code.VALUE)
        resets = control is not None and control & RESET
        if values and self.session.fault is not None and not resets:
            raise ModbusException(Code.FAILURE)
        if control is not None:
            self._take_control(control)
        if values:
            signed = [word - ((word & 0x8000) << 1) for word in values]
            self._command[first : first + len(signed)] = signed
            self.target = np.reshape(self._command, self.target.shape) * self._per_word
            self._written_tick = self.session.tick
            self.on_commands()

    def _take_magnitudes(self, at: int, words: Sequence[int]) -> None:
        """Set magnitudes of faults from now on, all of them or none.

        Raises:
            ModbusException: a part of a magnitude, or one out of its range; nothing has changed.
        """
        if at % PER_MAGNITUDE or len(words) % PER_MAGNITUDE:
            raise ModbusException(Code.VALUE)
        raw = struct.pack(f">{len(words)}H", *words)
        values = struct.unpack(f">{len(words) // PER_MAGNITUDE}d", raw)
        chosen = self._faults[at // PER_MAGNITUDE :][: len(values)]
        try:
            for fault, value in zip(chosen, values, strict=True):
                fault.number.check_value("modbus", value)
        except Refusal:
            raise ModbusException(Code.VALUE) from None
        for fault, value in zip(chosen, values, strict=True):
            self.session.set_varied(fault.name, value)

    def _take_control(self, control: int) -> None:
        session = self.session
        if control & RESET:
            session.reset()
            self._forget_commands()
        if control & ACKNOWLEDGE and self._tripped:
            self._tripped = False
            self._written_tick = session.tick
        powered = bool(control & POWER) and not self._tripped
        if powered != session.powered:
            session.powered = powered

    def pass_period(self) -> None:
        """Advance by a servo period under the commands at its beginning.

        A diverged machine keeps its state.
        """
        session = self.session
        if session.fault is None:
            session.advance_under(self._zoh_target, session.tick)
        self.has_tripped()
        self._zoh_target = self.target

    def answer_tick(self) -> None:
        """Advance by a servo period under the commands just written."""
        self._zoh_target = self.target
        self.pass_period()

    def offer_commands(self) -> None:
        """Pass the commands to a session in real time."""
        session = self.session
        try:
            command, *rows = self.target.tolist()
            further = dict(zip(self._inputs, rows, strict=True))
            session.offer(session.tick, session.scene.joint_names, command, further)
        except DuplicateCommand:
            pass  # the same as before, in the same period

    def has_tripped(self) -> bool:
        """Switch the drives off if the master has been silent for too long; return whether."""
        session = self.session
        if not self._watchdog or self._written_tick is None or self._tripped:
            return False
        silent = (session.tick - self._written_tick) * session.period_ns
        if silent <= self._watchdog * 1_000_000:
            return False
        self._tripped = True
        self._zero_commands()
        session.powered = False
        return True


def _pack_words(layout: str, *values: object) -> tuple[int, ...]:
    data = struct.pack(layout, *values)
    return struct.unpack(f">{len(data) // 2}H", data)


def _split_words(values: NDArray[np.int64]) -> list[int]:
    """Return the two words of each number modulo 2^32, the high one first."""
    words: list[int] = (np.stack((values >> 16, values), axis=1) & 0xFFFF).ravel().tolist()
    return words
