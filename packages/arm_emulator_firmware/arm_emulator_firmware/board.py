"""Board files: which registers of a microcontroller are wired to which part of a machine.

docs/how_to/microcontroller.md has their keys. It is read into the structs of core/runner.h.
"""

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise
from pathlib import Path
from typing import Any, TypeVar

from arm_emulator.extension.base import REQUIRED, Number, Refusal, Section, read_yaml
from arm_emulator.extension.compiler import BOUNDARY_FOLDER, CData, Header
from arm_emulator.extension.machine import VOLTAGE_INPUT, Scene
from arm_emulator_firmware import CORE_FOLDER

PAGE = 1024  # bytes that regions are multiples of
PRIVATE = 0xE0000000  # where the processor's own registers begin
MAX_INTERRUPTS = 240
MAX_ENTRIES = 64  # entries of a section
LARGEST = 1 << 28  # bytes of a region

RUNNER = Header(CORE_FOLDER / "runner.h", (BOUNDARY_FOLDER,))

# Numbers of a board file, by their keys, in sections of these kinds.
BOARD = (
    Number("clock", "Hz", at_least=1e4, at_most=1e10),
    Number("cycles_per_instruction", "cycles", at_least=0.0, at_most=1000.0, default=1.0),
    Number("cycles_per_branch", "cycles", at_least=0.0, at_most=1000.0, default=1.0),
    Number("boot", "s", at_least=0.0, at_most=100.0, default=0.0),
    Number("interrupts", at_least=1, at_most=MAX_INTERRUPTS, whole=True),
    Number("priority_bits", at_least=1, at_most=8, whole=True, default=4),
)
ENCODER = (Number("bits", at_least=8, at_most=32, whole=True),)
CHANNEL = (
    Number("bits", at_least=1, at_most=31, whole=True),
    Number("counts_per_ampere", "1/A", at_least=1e-9, at_most=1e9, in_size=True),
    Number("offset", "counts", at_least=0.0),
)
UART = (Number("baud", "1/s", at_least=1.0, at_most=1e8, default=115200.0),)

_WORD = Number("", at_least=0, at_most=2**32 - 1, whole=True)
_BIT = Number("bit", at_least=0, at_most=31, whole=True)
_INTERRUPT = Number("interrupt", at_least=0, whole=True, default=-1)
_FULL_SCALE = Number("full_scale", "V, A or N m", at_least=1e-9, at_most=1e9)

MEMORY = ("flash", "ram", "code_ram")
BRIDGES = ("bipolar", "unipolar", "pair", "float")
PINS = ("enable", "brake", "fault", "powered")

_Entry = TypeVar("_Entry")
_KINDS = {
    word: RUNNER.get_constant(kind)
    for word, kind in {
        "flash": "MCU_FLASH", "ram": "MCU_RAM", "registers": "MCU_REGISTERS",
        "code_ram": "MCU_CODE_RAM", "float": "MCU_VOLTS", "bipolar": "MCU_BIPOLAR",
        "unipolar": "MCU_UNIPOLAR", "pair": "MCU_PAIR", "enable": "MCU_ENABLE",
        "brake": "MCU_BRAKE", "fault": "MCU_FAULT", "powered": "MCU_POWERED",
    }.items()
}  # fmt: skip


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


Row = dict[str, Any]  # fields of a struct


@dataclass(frozen=True)
class Board:
    """A microcontroller and its wiring.

    Attributes:
        where: the file's name.
        regions: pieces of its address space.
        uarts: names of its serial lines.
        rows: of the structs of runner.h, by what follows ``mcu_`` in their names.
        fields: of ``mcu_board`` itself; "mailbox" of ``mcu_mailbox``, if there is one.
    """

    where: str
    regions: tuple[Region, ...]
    uarts: tuple[str, ...]
    rows: dict[str, tuple[Row, ...]] = field(repr=False)
    fields: Row = field(repr=False)


def load_board(file: Path, joint_names: Sequence[str]) -> Board:
    """Read a board file.

    Args:
        file: which one.
        joint_names: of the scene.

    Raises:
        Refusal: no such file, no YAML; a key that is not known or missing; a value out of its
            range; registers outside of every block or used twice; unknown joints.
    """
    return _Reader(Section(read_yaml(file), file.name), joint_names).read_board()


class _Reader:
    def __init__(self, top: Section, joint_names: Sequence[str]) -> None:
        self._top = top
        self._joints = tuple(joint_names)
        self._blocks: tuple[Region, ...] = ()
        self._used: set[int] = set()
        self._channels: list[Row] = []
        self._adcs = 0

    def read_board(self) -> Board:
        top = self._top
        memory = self._read_entries("memory", self._read_memory)
        self._blocks = self._read_entries("registers", self._read_block)
        regions = (*memory, *self._blocks)
        _check_regions(top.where, regions)
        flash = [region.at for region in memory if region.kind == "flash"]
        if not flash:
            raise Refusal(top.where, "memory", "have a region of kind flash", "none")
        fields = _read_numbers(top, BOARD)
        self._interrupts = fields["interrupts"]
        fields["vectors"] = self._read_vectors(memory, flash[0])
        fields["preload"] = top.is_true("preload")
        rows = {
            "region": tuple(
                {"at": region.at, "size": region.size, "kind": _KINDS[region.kind]}
                for region in regions
            ),
            "word": self._read_entries("values", self._read_word_row),
            "encoder": self._read_joint_entries("encoders", self._read_encoder),
            "adc": self._read_entries("adc", self._read_adc),
            "port": self._read_entries("ports", self._read_port),
            "pwm": self._read_joint_entries("pwm", self._read_pwm),
            "pin": self._read_entries("pins", self._read_pin),
            "uart": self._read_entries("uart", self._read_uart),
            "channel": tuple(self._channels),
        }
        if (mailbox := self._read_mailbox()) is not None:
            fields["mailbox"] = mailbox
        names = [name for name, _ in self._list_sections(top, "uart")]
        top.refuse_unread_keys()
        if sum(uart["targets"] for uart in rows["uart"]) > 1:
            raise Refusal(top.where, "uart", "bring targets on one line at most", "several")
        joints = [channel["joint"] for channel in self._channels]
        for joint in joints:
            if joints.count(joint) > 1:
                rule = "have a channel of one converter at most"
                raise Refusal(top.where, "adc", rule, f"several for {self._joints[joint]}")
        return Board(top.where, regions, tuple(names), rows, fields)

    def _read_vectors(self, memory: tuple[Region, ...], default: int) -> int:
        at = _read_word(self._top, "vectors", default)
        size = 4 * (16 + self._interrupts)
        if at % 128 or not any(
            region.at <= at <= region.at + region.size - size for region in memory
        ):
            rule = f"be a multiple of 128 with {size} bytes of memory from there on"
            raise self._top.make_refusal("vectors", rule, hex(at))
        return at

    def _read_memory(self, name: str, section: Section) -> Region:
        return self._read_region(name, section, _choose_word(section, "kind", MEMORY, name))

    def _read_block(self, name: str, section: Section) -> Region:
        return self._read_region(name, section, "registers")

    def _read_region(self, name: str, section: Section, kind: str) -> Region:
        at, size = _read_word(section, "at"), _read_word(section, "size")
        for key, value in (("at", at), ("size", size)):
            if value % PAGE:
                raise section.make_refusal(key, f"be a multiple of {PAGE} bytes", hex(value))
        if not 0 < size <= LARGEST:
            raise section.make_refusal("size", f"be from {PAGE} to {LARGEST:#x} bytes", hex(size))
        if at + size > PRIVATE:
            rule = f"end at or below {PRIVATE:#x}, where the processor's own registers are"
            raise section.make_refusal("at", rule, f"{at:#x} to {at + size:#x}")
        if kind == "registers" and at == 0:
            raise section.make_refusal("at", "be > 0", hex(at))
        return Region(name, at, size, kind)

    def _read_word_row(self, _name: str, section: Section) -> Row:
        at = self._read_register(section, "at")
        return {
            "at": at,
            "value": _read_word(section, "value"),
            "fixed": _read_word(section, "fixed", 0),
        }

    def _read_encoder(self, joint: str, section: Section) -> Row:
        numbers = _read_numbers(section, ENCODER)
        return {
            "joint": self._joints.index(joint),
            "at": self._claim_register(section, "at"),
            **numbers,
        }

    def _read_adc(self, _name: str, section: Section) -> Row:
        sections = self._list_sections(section, "channels")
        channels = [self._read_channel(section) for _, section in sections]
        for (joint, _), channel in zip(sections, channels, strict=True):
            self._check_joint(section, "channels", joint)
            channel |= {"joint": self._joints.index(joint), "adc": self._adcs}
        self._channels += channels
        self._adcs += 1
        status = self._claim_optional_register(section, "status")
        control = self._claim_optional_register(section, "control")
        for key, needs in (("flag", status), ("enable", control), ("interrupt", status)):
            if section.has_key(key) and not needs:
                register = "control" if key == "enable" else "status"
                raise section.make_refusal(
                    key, f"be given together with `{register}`, a register", "none"
                )
        return {
            "status": status,
            "flag": section.read_integer(_BIT.rename("flag")) if status else 0,
            "control": control,
            "enable": section.read_integer(_BIT.rename("enable")) if control else 0,
            "interrupt": self._read_interrupt(section),
            "clear_by_one": section.read_choice("clear", ("zero", "one"), "zero") == "one",
        }

    def _read_channel(self, section: Section) -> Row:
        at = self._claim_register(section, "at")
        if section.read_choice("holds", ("counts", "float"), "counts") == "float":
            return {"at": at, "bits": 0}
        numbers = _read_numbers(section, CHANNEL)
        section.read_number(replace(CHANNEL[-1], at_most=2 ** numbers["bits"] - 1))
        return {"at": at, **numbers}

    def _read_pwm(self, joint: str, section: Section) -> Row:
        kind = _choose_word(section, "kind", BRIDGES)
        counted = kind != "float"
        unipolar = kind == "unipolar"
        row: Row = {
            "joint": self._joints.index(joint),
            "kind": _KINDS[kind],
            "compare": self._read_register(section, "compare"),
            "reload": self._read_register(section, "reload") if counted else 0,
        }
        aligned = section.read_choice("aligned", ("edge", "center"), "edge") if counted else ""
        row |= {
            "counts_more": aligned == "edge",
            "minus": self._read_register(section, "minus") if kind == "pair" else 0,
            "direction": self._read_register(section, "direction") if unipolar else 0,
            "direction_bit": section.read_integer(_BIT.rename("direction_bit")) if unipolar else 0,
        }
        if not counted:
            row["full_scale"] = 0.0
        elif section.has_key("full_scale"):
            row["full_scale"] = section.read_number(_FULL_SCALE)
        return row

    def _read_pin(self, _name: str, section: Section) -> Row:
        kind = _choose_word(section, "is", PINS)
        joint = section.read_text("joint") if section.has_key("joint") else ""
        if joint:
            self._check_joint(section, "joint", joint)
        return {
            "joint": self._joints.index(joint) if joint else -1,
            "kind": _KINDS[kind],
            "bit": section.read_integer(_BIT),
            "low": section.read_choice("active", ("high", "low"), "high") == "low",
            "at": self._read_register(section, "at"),
        }

    def _read_port(self, _name: str, section: Section) -> Row:
        row = {"output": self._read_register(section, "output")}
        return row | {
            key: self._claim_optional_register(section, key)
            for key in ("set_reset", "set", "clear")
        }

    def _read_uart(self, _name: str, section: Section) -> Row:
        row = {key: self._claim_register(section, key) for key in ("status", "data", "control")}
        row |= {"interrupt": self._read_interrupt(section), "targets": section.is_true("targets")}
        return {**row, **_read_numbers(section, UART)}

    def _read_mailbox(self) -> Row | None:
        section = self._top.get_section("targets")
        if section is None:
            return None
        joints = section.require_section("joints")
        names = joints.list_keys()
        for joint in names:
            self._check_joint(section, "joints", joint)
        at = {joint: self._claim_register(joints, joint) for joint in names}
        return {
            "at": [at.get(joint, 0) for joint in self._joints],
            "count": self._claim_register(section, "count"),
            "interrupt": self._read_interrupt(section),
        }

    def _read_interrupt(self, section: Section) -> int:
        return section.read_integer(replace(_INTERRUPT, at_most=self._interrupts - 1))

    def _check_joint(self, section: Section, key: str, joint: str) -> None:
        if joint not in self._joints:
            rule = "name joints of the scene"
            raise section.make_refusal(key, rule, joint, ", ".join(self._joints))

    def _read_joint_entries(
        self, key: str, read: Callable[[str, Section], _Entry]
    ) -> tuple[_Entry, ...]:
        section = self._top.get_section(key)
        for joint in section.list_keys() if section else ():
            self._check_joint(self._top, key, joint)
        return self._read_entries(key, read)

    def _read_entries(self, key: str, read: Callable[[str, Section], _Entry]) -> tuple[_Entry, ...]:
        return tuple(read(name, section) for name, section in self._list_sections(self._top, key))

    @staticmethod
    def _list_sections(above: Section, key: str) -> list[tuple[str, Section]]:
        section = above.get_section(key)
        names = section.list_keys() if section else []
        if len(names) > MAX_ENTRIES:
            raise above.make_refusal(key, f"have at most {MAX_ENTRIES} entries", len(names))
        return [(name, section.require_section(name)) for name in names] if section else []

    def _claim_optional_register(self, section: Section, key: str) -> int:
        return self._claim_register(section, key) if section.has_key(key) else 0

    def _claim_register(self, section: Section, key: str) -> int:
        """Return the address of a register that nothing else uses."""
        at = self._read_register(section, key)
        if at in self._used:
            rule = "be a register of its own, not the one of another key"
            raise section.make_refusal(key, rule, hex(at))
        self._used.add(at)
        return at

    def _read_register(self, section: Section, key: str) -> int:
        at = _read_word(section, key)
        if at % 4 or not any(block.at <= at < block.at + block.size for block in self._blocks):
            blocks = ", ".join(f"{b.name} from {b.at:#x}" for b in self._blocks) or "no block"
            rule = "be a multiple of 4 within a block of `registers`"
            raise section.make_refusal(key, rule, hex(at), blocks)
        return at


def _choose_word(section: Section, key: str, values: tuple[str, ...], default: str = "") -> str:
    """Return one of some words, which must be there unless the default is one of them."""
    value = section.read_choice(key, values, default)
    if value not in values:
        raise section.make_refusal(key, "be there", "nothing", ", ".join(values))
    return value


def _read_numbers(section: Section, declared: Sequence[Number]) -> Row:
    return {number.name: section.read_number(number) for number in declared}


def _read_word(section: Section, key: str, default: int | None = None) -> int:
    """Return a whole number of 32 bits, written as 0x40000000 or in decimal."""
    value = section.read_value(key)
    if isinstance(value, str) and re.fullmatch(r"0[xX][0-9a-fA-F]{1,8}", value):
        return int(value, 16)
    return section.read_integer(
        replace(_WORD, name=key, default=REQUIRED if default is None else default)
    )


def _check_regions(where: str, regions: tuple[Region, ...]) -> None:
    ordered = sorted(regions, key=lambda region: region.at)
    for region, following in pairwise(ordered):
        if region.at + region.size > following.at:
            rule = f"end before {following.name} begins, at {following.at:#x}"
            raise Refusal(where, f"region {region.name}", rule, hex(region.at + region.size))


def make_board_struct(
    board: Board, scene: Scene, uarts: dict[str, tuple[int, int]]
) -> tuple[CData, dict[str, CData]]:
    """Return a board as in runner.h, and the objects that must outlive it.

    Args:
        board: wiring of registers.
        scene: the machine.
        uarts: file descriptors to write to and to read from, of each serial line that has some.

    Raises:
        Refusal: a bridge makes no command of the kind that a joint takes.
    """
    rows = dict(board.rows)
    rows["pwm"] = tuple({"full_scale": _find_full_scale(row, scene), **row} for row in rows["pwm"])
    rows["uart"] = tuple(
        {**settings, **dict(zip(("out", "in"), uarts.get(name, (-1, -1)), strict=True))}
        for name, settings in zip(board.uarts, rows["uart"], strict=True)
    )
    fields = dict(board.fields)
    arrays: dict[str, CData] = {}  # the struct points to them
    for name, some in rows.items():
        fields[name] = arrays[name] = RUNNER.ffi.new(f"mcu_{name}[]", some)
        fields[f"{name}s"] = len(some)
    if "mailbox" in fields:
        at = arrays["at"] = RUNNER.ffi.new("uint32_t[]", fields["mailbox"]["at"])
        mailbox = RUNNER.make_struct("mcu_mailbox", **{**fields["mailbox"], "at": at})
        fields["mailbox"] = arrays["mailbox"] = mailbox
    period = round(scene.servo_period * 1e9)
    return RUNNER.make_struct(
        "mcu_board", joints=len(scene.joints), period=period, **fields
    ), arrays


def _find_full_scale(pwm: Row, scene: Scene) -> float:
    """Return the command at a duty of 1 [V, A or N m] where none is given: of a bridge the supply.

    Raises:
        Refusal: no bridge makes such a command.
    """
    joint = scene.joints[pwm["joint"]]
    command = joint.inputs[0]
    if command != VOLTAGE_INPUT and "full_scale" not in pwm:
        takes = f"{command.about} [{command.unit}]"
        rule = f"be given: the joint's command is {takes}, and no bridge makes that of a duty"
        raise Refusal("board", f"pwm.{joint.name}.full_scale", rule, "nothing")
    return scene.supply_voltage
