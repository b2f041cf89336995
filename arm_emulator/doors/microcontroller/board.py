"""Board files: which registers of a microcontroller are wired to which part of a machine."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import TypeVar

from arm_emulator.base.number import REQUIRED, Number, number, numbers_of
from arm_emulator.base.refusal import Refusal
from arm_emulator.base.section import Section
from arm_emulator.base.yaml_file import read_yaml

PAGE = 1024  # bytes that regions are multiples of
PRIVATE = 0xE0000000  # where the processor's own registers begin
MOST_INTERRUPTS = 240
MOST = 64  # entries of a section
LARGEST = 1 << 28  # bytes of a region

_WORD = Number("", at_least=0, at_most=2**32 - 1, whole=True)
_BIT = Number("bit", at_least=0, at_most=31, whole=True)
_INTERRUPT = Number("interrupt", at_least=0, whole=True, default=-1)
_FULL_SCALE = Number("full_scale", "V, A or N m", at_least=1e-9, at_most=1e9)

_Entry = TypeVar("_Entry")


@dataclass(frozen=True)
class Region:
    """A piece of the address space.

    Attributes:
        kind: "flash", "ram", "code_ram" (which instructions may run from) or "registers".
    """

    name: str
    at: int
    size: int
    kind: str


@dataclass(frozen=True)
class Word:
    """Initial value of a register; bits that are `fixed` always read so."""

    at: int
    value: int
    fixed: int


@dataclass(frozen=True)
class Encoder:
    """A timer's counter of so many bits."""

    joint: str
    at: int
    bits: int = number(ends=(8, 32), whole=True)


@dataclass(frozen=True)
class Channel:
    """A data register of a converter; `bits` 0: it holds amperes as a float."""

    joint: str
    at: int
    bits: int = number(ends=(1, 31), whole=True)
    counts_per_ampere: float = number("1/A", ends=(1e-9, 1e9), in_size=True)
    offset: float = number("counts", at_least=0.0)


@dataclass(frozen=True)
class Adc:
    """A converter: registers and bits of its end of conversion, 0: none; `interrupt` -1: none."""

    name: str
    status: int
    flag: int
    control: int
    enable: int
    interrupt: int
    clear: str
    channels: tuple[Channel, ...]


@dataclass(frozen=True)
class Pwm:
    """Registers that state what voltage a motor gets, or its drive is commanded; 0: none."""

    joint: str
    kind: str
    compare: int
    reload: int
    aligned: str
    minus: int
    direction: int
    direction_bit: int
    full_scale: float | None
    """At a duty of 1, in the unit of the motor's command; None: the supply [V]."""


@dataclass(frozen=True)
class Pin:
    """A bit of a register that is wired to the drives; `joint` empty: to all."""

    name: str
    is_: str
    at: int
    bit: int
    active: str
    joint: str


@dataclass(frozen=True)
class Port:
    """Registers that set and clear bits of an output register; 0: none."""

    output: int
    set_reset: int
    set: int
    clear: int


@dataclass(frozen=True)
class Uart:
    """A serial line; `interrupt` -1: none; `targets`: joint targets come here."""

    name: str
    status: int
    data: int
    control: int
    interrupt: int
    targets: bool
    baud: float = number("1/s", ends=(1.0, 1e8), default=115200.0)


@dataclass(frozen=True)
class Mailbox:
    """Registers where joint targets are read; `count` counts them, `interrupt` -1: none."""

    count: int
    interrupt: int
    at: dict[str, int]


@dataclass(frozen=True, kw_only=True)
class Board:
    """A microcontroller and its wiring, see docs/how_to/microcontroller.md for each key.

    Attributes:
        where: the file's name.
    """

    where: str
    vectors: int
    preload: bool
    regions: tuple[Region, ...]
    words: tuple[Word, ...]
    encoders: tuple[Encoder, ...]
    adcs: tuple[Adc, ...]
    pwms: tuple[Pwm, ...]
    pins: tuple[Pin, ...]
    ports: tuple[Port, ...]
    uarts: tuple[Uart, ...]
    mailbox: Mailbox | None
    clock: float = number("Hz", ends=(1e4, 1e10))
    cycles_per_instruction: float = number("cycles", ends=(0.0, 1000.0), default=1.0)
    cycles_per_branch: float = number("cycles", ends=(0.0, 1000.0), default=1.0)
    boot: float = number("s", ends=(0.0, 100.0), default=0.0)
    interrupts: int = number(ends=(1, MOST_INTERRUPTS), whole=True)
    priority_bits: int = number(ends=(1, 8), whole=True, default=4)


def load_board(file: Path, joint_names: Sequence[str]) -> Board:
    """Read a board file.

    Args:
        file: which one.
        joint_names: of the scene.

    Raises:
        Refusal: no such file, no YAML, a key that is not known or missing, a value out of its
            range, registers outside of every block or used twice, or unknown joints.
    """
    return _Reader(Section(read_yaml(file), file.name), joint_names).board()


class _Reader:
    def __init__(self, top: Section, joint_names: Sequence[str]) -> None:
        self._top = top
        self._joints = tuple(joint_names)
        self._blocks: tuple[Region, ...] = ()
        self._used: dict[int, str] = {}

    def board(self) -> Board:
        top = self._top
        memory = self._entries("memory", self._memory)
        self._blocks = self._entries("registers", self._block)
        regions = (*memory, *self._blocks)
        _check_regions(top.where, regions)
        flash = [region.at for region in memory if region.kind == "flash"]
        if not flash:
            raise Refusal(top.where, "memory", "have a region of kind flash", "none")
        numbers = top.numbers(Board)
        self._interrupts = numbers["interrupts"]
        board = Board(
            where=top.where,
            vectors=self._vectors(memory, flash[0]),
            preload=top.flag("preload"),
            regions=regions,
            words=self._entries("values", self._word),
            encoders=self._of_joints("encoders", self._encoder),
            adcs=self._entries("adc", self._adc),
            ports=self._entries("ports", self._port),
            pwms=self._of_joints("pwm", self._pwm),
            pins=self._entries("pins", self._pin),
            uarts=self._entries("uart", self._uart),
            mailbox=self._mailbox(),
            **numbers,
        )
        top.finish()
        if sum(uart.targets for uart in board.uarts) > 1:
            raise Refusal(top.where, "uart", "bring targets on one line at most", "several")
        joints = [channel.joint for adc in board.adcs for channel in adc.channels]
        for joint in joints:
            if joints.count(joint) > 1:
                rule = "have a channel of one converter at most"
                raise Refusal(top.where, "adc", rule, f"several for {joint}")
        return board

    def _vectors(self, memory: tuple[Region, ...], default: int) -> int:
        at = _word(self._top, "vectors", default)
        size = 4 * (16 + self._interrupts)
        if at % 128 or not any(one.at <= at <= one.at + one.size - size for one in memory):
            rule = f"be a multiple of 128 with {size} bytes of memory from there on"
            raise self._top.refusal("vectors", rule, hex(at))
        return at

    def _memory(self, name: str, section: Section) -> Region:
        kinds = ("flash", "ram", "code_ram")
        kind = section.choice("kind", kinds, name)
        if kind not in kinds:
            raise section.refusal("kind", "be there", "nothing", ", ".join(kinds))
        return self._region(name, section, kind)

    def _block(self, name: str, section: Section) -> Region:
        return self._region(name, section, "registers")

    def _region(self, name: str, section: Section, kind: str) -> Region:
        at, size = _word(section, "at"), _word(section, "size")
        for key, value in (("at", at), ("size", size)):
            if value % PAGE:
                raise section.refusal(key, f"be a multiple of {PAGE} bytes", hex(value))
        if not 0 < size <= LARGEST:
            raise section.refusal("size", f"be from {PAGE} to {LARGEST:#x} bytes", hex(size))
        if at + size > PRIVATE:
            rule = f"end at or below {PRIVATE:#x}, where the processor's own registers are"
            raise section.refusal("at", rule, f"{at:#x} to {at + size:#x}")
        if kind == "registers" and at == 0:
            raise section.refusal("at", "be > 0", hex(at))
        return Region(name, at, size, kind)

    def _word(self, _name: str, section: Section) -> Word:
        at = self._register(section, "at")
        return Word(at, _word(section, "value"), _word(section, "fixed", 0))

    def _encoder(self, joint: str, section: Section) -> Encoder:
        numbers = section.numbers(Encoder)
        return Encoder(joint, self._own(section, "at"), **numbers)

    def _adc(self, name: str, section: Section) -> Adc:
        channels = tuple(
            self._channel(joint, one) for joint, one in self._sections(section, "channels")
        )
        for channel in channels:
            self._check_joint(section, "channels", channel.joint)
        status = self._own(section, "status") if section.has("status") else 0
        control = self._own(section, "control") if section.has("control") else 0
        for key, needs in (("flag", status), ("enable", control), ("interrupt", status)):
            if section.has(key) and not needs:
                what = "control" if key == "enable" else "status"
                raise section.refusal(key, f"stand beside `{what}`, a register", "none")
        return Adc(
            name,
            status,
            section.integer(_BIT.named("flag")) if status else 0,
            control,
            section.integer(_BIT.named("enable")) if control else 0,
            self._interrupt(section),
            section.choice("clear", ("zero", "one"), "zero"),
            channels,
        )

    def _channel(self, joint: str, section: Section) -> Channel:
        at = self._own(section, "at")
        if section.choice("holds", ("counts", "float"), "counts") == "float":
            return Channel(joint, at, 0, 0.0, 0.0)
        numbers = section.numbers(Channel)
        largest = 2 ** numbers["bits"] - 1
        section.number(replace(numbers_of(Channel)["offset"], at_most=largest))
        return Channel(joint, at, **numbers)

    def _pwm(self, joint: str, section: Section) -> Pwm:
        kinds = ("bipolar", "unipolar", "pair", "float")
        kind = section.choice("kind", kinds, "")
        if not kind:
            raise section.refusal("kind", "be there", "nothing", ", ".join(kinds))
        counted = kind != "float"
        unipolar = kind == "unipolar"
        return Pwm(
            joint,
            kind,
            self._register(section, "compare"),
            self._register(section, "reload") if counted else 0,
            section.choice("aligned", ("edge", "center"), "edge") if counted else "edge",
            self._register(section, "minus") if kind == "pair" else 0,
            self._register(section, "direction") if unipolar else 0,
            section.integer(_BIT.named("direction_bit")) if unipolar else 0,
            section.number(_FULL_SCALE) if counted and section.has("full_scale") else None,
        )

    def _pin(self, name: str, section: Section) -> Pin:
        kinds = ("enable", "brake", "fault", "powered")
        is_ = section.choice("is", kinds, "")
        if not is_:
            raise section.refusal("is", "be there", "nothing", ", ".join(kinds))
        joint = section.text("joint") if section.has("joint") else ""
        if joint:
            self._check_joint(section, "joint", joint)
        bit = section.integer(_BIT)
        active = section.choice("active", ("high", "low"), "high")
        return Pin(name, is_, self._register(section, "at"), bit, active, joint)

    def _port(self, _name: str, section: Section) -> Port:
        output = self._register(section, "output")
        return Port(
            output, *(self._optional(section, key) for key in ("set_reset", "set", "clear"))
        )

    def _uart(self, name: str, section: Section) -> Uart:
        return Uart(
            name,
            self._own(section, "status"),
            self._own(section, "data"),
            self._own(section, "control"),
            self._interrupt(section),
            section.flag("targets"),
            **section.numbers(Uart),
        )

    def _mailbox(self) -> Mailbox | None:
        section = self._top.section("targets")
        if section is None:
            return None
        joints = section.required_section("joints")
        names = joints.keys()
        for joint in names:
            self._check_joint(section, "joints", joint)
        at = {joint: self._own(joints, joint) for joint in names}
        return Mailbox(self._own(section, "count"), self._interrupt(section), at)

    def _interrupt(self, section: Section) -> int:
        return section.integer(replace(_INTERRUPT, at_most=self._interrupts - 1))

    def _check_joint(self, section: Section, key: str, joint: str) -> None:
        if joint not in self._joints:
            rule = "name joints of the scene"
            raise section.refusal(key, rule, joint, ", ".join(self._joints))

    def _of_joints(self, key: str, read: Callable[[str, Section], _Entry]) -> tuple[_Entry, ...]:
        section = self._top.section(key)
        for joint in section.keys() if section else ():
            self._check_joint(self._top, key, joint)
        return self._entries(key, read)

    def _entries(self, key: str, read: Callable[[str, Section], _Entry]) -> tuple[_Entry, ...]:
        return tuple(read(name, one) for name, one in self._sections(self._top, key))

    @staticmethod
    def _sections(above: Section, key: str) -> list[tuple[str, Section]]:
        section = above.section(key)
        names = section.keys() if section else []
        if len(names) > MOST:
            raise above.refusal(key, f"have at most {MOST} entries", len(names))
        return [(name, section.required_section(name)) for name in names] if section else []

    def _optional(self, section: Section, key: str) -> int:
        return self._own(section, key) if section.has(key) else 0

    def _own(self, section: Section, key: str) -> int:
        """Return the address of a register that nothing else uses."""
        at = self._register(section, key)
        if at in self._used:
            rule = f"be a register of its own, not {self._used[at]}"
            raise section.refusal(key, rule, hex(at))
        self._used[at] = "the one of another key"
        return at

    def _register(self, section: Section, key: str) -> int:
        at = _word(section, key)
        if at % 4 or not any(one.at <= at < one.at + one.size for one in self._blocks):
            known = ", ".join(f"{b.name} from {b.at:#x}" for b in self._blocks) or "no block"
            rule = "be a multiple of 4 within a block of `registers`"
            raise section.refusal(key, rule, hex(at), known)
        return at


def _word(section: Section, key: str, default: int | None = None) -> int:
    """Return a whole number of 32 bits, written as 0x40000000 or in decimal."""
    value = section.value(key)
    if isinstance(value, str) and re.fullmatch(r"0[xX][0-9a-fA-F]{1,8}", value):
        return int(value, 16)
    return section.integer(
        replace(_WORD, name=key, default=REQUIRED if default is None else default)
    )


def _check_regions(where: str, regions: tuple[Region, ...]) -> None:
    ordered = sorted(regions, key=lambda one: one.at)
    for one, other in pairwise(ordered):
        if one.at + one.size > other.at:
            rule = f"end before {other.name} begins, at {other.at:#x}"
            raise Refusal(where, f"region {one.name}", rule, hex(one.at + one.size))
