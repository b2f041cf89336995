"""A microcontroller with firmware as a step of `arm_emulator.machine.firmware_loop`: runner.h."""

from __future__ import annotations

import ctypes
import socket
from collections.abc import Iterable
from functools import cache

from arm_emulator.base.refusal import Refusal
from arm_emulator.build.flags import SHARED
from arm_emulator.build.unit import Calls, Unit, address, library
from arm_emulator.core import BOUNDARY
from arm_emulator.doors.microcontroller import FOLDER
from arm_emulator.doors.microcontroller.board import Board, Pwm
from arm_emulator.doors.microcontroller.elf_image import ElfImage
from arm_emulator.doors.microcontroller.unicorn_library import (
    load_unicorn,
    unicorn_headers,
    unicorn_version,
)
from arm_emulator.machine.control_code import ControlCode
from arm_emulator.machine.scene import Scene

FLAGS = (*"-std=c++20 -O2 -fvisibility=hidden -ffp-contract=off".split(), *SHARED)

_pointer, _int32, _uint32 = ctypes.c_void_p, ctypes.c_int32, ctypes.c_uint32
_int64, _uint64, _double = ctypes.c_int64, ctypes.c_uint64, ctypes.c_double
_CALLS: Calls = {
    "mcu_new": (_pointer, [_pointer] * 2),
    "mcu_delete": (None, [_pointer]),
    "mcu_load": (ctypes.c_int, [_pointer, _uint32, ctypes.c_char_p, _int64]),
    "mcu_debug": (None, [_pointer, ctypes.c_int]),
    "mcu_step": (None, [_pointer] * 3),
    "mcu_stopped": (_pointer, [_pointer]),
    "mcu_get_fault": (None, [_pointer] * 2),
    "mcu_get_figures": (None, [_pointer] * 2),
}

_KINDS = ("flash", "ram", "registers", "code_ram")  # enum mcu_kind
_PWMS = ("float", "bipolar", "unipolar", "pair")  # enum mcu_pwm_kind
_PINS = ("enable", "brake", "fault", "powered")  # enum mcu_pin_kind


def _struct(name: str, *fields: tuple[str, object]) -> type[ctypes.Structure]:
    """Return a struct of runner.h."""
    return type(name, (ctypes.Structure,), {"_fields_": fields})


def _of(kind: object, names: str) -> tuple[tuple[str, object], ...]:
    return tuple((name, kind) for name in names.split())


_REGION = _struct("mcu_region", *_of(_uint32, "at size"), *_of(_int32, "kind reserved"))
_WORD = _struct("mcu_word", *_of(_uint32, "at value fixed reserved"))
_ENCODER = _struct("mcu_encoder", *_of(_uint32, "at"), *_of(_int32, "bits joint reserved"))
_ADC = _struct(
    "mcu_adc",
    *_of(_uint32, "status control"),
    *_of(_int32, "flag enable interrupt clear_by_one"),
)
_CHANNEL = _struct(
    "mcu_channel",
    *_of(_uint32, "at"),
    *_of(_int32, "joint bits adc"),
    *_of(_double, "counts_per_ampere offset"),
)
_PWM = _struct(
    "mcu_pwm",
    *_of(_int32, "kind joint"),
    *_of(_uint32, "compare reload minus direction"),
    *_of(_int32, "direction_bit counts_more"),
    *_of(_double, "full_scale"),
)
_PIN = _struct("mcu_pin", *_of(_uint32, "at"), *_of(_int32, "bit kind joint low reserved"))
_PORT = _struct("mcu_port", *_of(_uint32, "output set_reset set clear"))
_UART = _struct(
    "mcu_uart",
    *_of(_uint32, "status data control"),
    *_of(_int32, "interrupt"),
    *_of(_double, "baud"),
    *_of(_int32, "out into targets reserved"),
)
_MAILBOX = _struct(
    "mcu_mailbox", *_of(_uint32, "count"), *_of(_int32, "interrupt"), ("at", _pointer)
)
_LISTS = "region word encoder adc channel pwm pin port uart".split()
_BOARD = _struct(
    "mcu_board",
    *_of(_uint32, "size"),
    *_of(_int32, "joints"),
    *_of(_double, "clock cycles_per_instruction cycles_per_branch boot"),
    *_of(_int64, "period"),
    *_of(_uint32, "vectors"),
    *_of(_int32, "interrupts priority_bits preload"),
    *_of(_pointer, " ".join(_LISTS)),
    *_of(_pointer, "mailbox"),
    *_of(_int32, " ".join(f"{name}s" for name in _LISTS)),
    *_of(_int32, "reserved"),
)


class Fault(ctypes.Structure):
    """``mcu_fault``."""

    _fields_ = (
        ("pc", _uint32),
        ("address", _uint32),
        ("time", _double),
        ("what", ctypes.c_char * 240),
    )


_FIGURES = ("instructions", "cycles", "asleep", "exceptions", "faults", "resets")


class Figures(ctypes.Structure):
    """``mcu_figures``: what the processor has done, in instructions and cycles."""

    _fields_ = tuple((name, _uint64) for name in _FIGURES)


class FirmwareEnd(RuntimeError):
    """The firmware cannot go on, or a debugger has ended it; the message is one line."""


def runner_unit() -> Unit:
    """Return the runner as what is compiled.

    Raises:
        Refusal: Unicorn is not installed.
    """
    source = f'#include "runner.cpp"\n// with Unicorn {unicorn_version()}\n'
    folders = (FOLDER, BOUNDARY, unicorn_headers())
    about, part = "the microcontroller's runner", "runner.cpp"
    return Unit("microcontroller", source, FLAGS, folders, _CALLS, "microcontroller", about, part)


@cache
def _runner() -> ctypes.CDLL:
    load_unicorn()
    return library(runner_unit())


class Microcontroller(ControlCode):
    """Firmware on a board, wired to a scene's machine.

    Attributes:
        name: of the firmware's file, for refusals.
        step: address of the step.
        with_: address that it gets.
        stop: address of what tells the loop that the firmware has ended.

    Args:
        board: what is where.
        image: the firmware.
        scene: the machine.
        uarts: file descriptors to write to and to read from, of each serial line that has some.

    Raises:
        Refusal: the firmware does not fit into the board's memory, or Unicorn is missing.
    """

    def __init__(
        self,
        board: Board,
        image: ElfImage,
        scene: Scene,
        uarts: dict[str, tuple[int, int]] | None = None,
    ) -> None:
        self.name = image.name
        self._image = image
        self._calls = _runner()
        self._told = _board_struct(board, scene, uarts or {})
        why = ctypes.create_string_buffer(120)
        self.with_ = self._calls.mcu_new(ctypes.byref(self._told), why)
        if not self.with_:
            raise Refusal(board.where, "board", "be one that Unicorn runs", why.value.decode())
        for at, piece in image.pieces:
            if not self._calls.mcu_load(self.with_, at, piece, len(piece)):
                known = ", ".join(
                    f"{one.name} {one.at:#x} to {one.at + one.size:#x}"
                    for one in board.regions
                    if one.kind != "registers"
                )
                got = f"{len(piece)} bytes at {at:#x}"
                raise Refusal(image.name, "what is loaded", "fit into the memory", got, known)
        self.step = address(self._calls, "mcu_step")
        self._stopped = self.stop = int(self._calls.mcu_stopped(self.with_))

    def __del__(self) -> None:
        if getattr(self, "with_", None):
            self._calls.mcu_delete(self.with_)

    def debug(self, listening: socket.socket) -> None:
        """Wait for gdb at a socket that listens, and let it halt the processor."""
        self._calls.mcu_debug(self.with_, listening.fileno())

    @property
    def ended(self) -> FirmwareEnd | None:
        """Why the firmware has ended, None if it goes on."""
        if not ctypes.c_int32.from_address(self._stopped).value:
            return None
        return FirmwareEnd(f"{self.name}: {self.fault or 'ended by the debugger'}")

    @property
    def fault(self) -> str:
        """What has ended the firmware, or the first fault that it handled itself; "" for none."""
        fault = Fault()
        self._calls.mcu_get_fault(self.with_, ctypes.byref(fault))
        if not fault.what:
            return ""
        symbol = self._image.symbol(fault.pc)
        at = f"{fault.pc:#010x}" + (f" in {symbol}" if symbol else "")
        return f"{fault.what.decode()}, pc {at}, at {fault.time:.9g} s"

    @property
    def figures(self) -> Figures:
        """What the processor has done so far."""
        figures = Figures()
        self._calls.mcu_get_figures(self.with_, ctypes.byref(figures))
        return figures


def _full_scale(pwm: Pwm, scene: Scene) -> float:
    """Return what a duty of 1 stands for [V, A or N m]: of a bridge the supply."""
    command = scene.joints[scene.joint_names.index(pwm.joint)].command
    if pwm.full_scale is not None or pwm.kind == "float":
        return pwm.full_scale or 0.0
    if command != "V":
        rule = f"be given: the motor takes a command [{command}], and no bridge makes one of a duty"
        raise Refusal("board", f"pwm.{pwm.joint}.full_scale", rule, "nothing")
    return scene.supply_voltage


def _board_struct(
    board: Board, scene: Scene, uarts: dict[str, tuple[int, int]]
) -> ctypes.Structure:
    """Return a board as runner.h has it."""
    full_scales = [_full_scale(one, scene) for one in board.pwms]
    joints = scene.joint_names.index
    lists: dict[str, Iterable[tuple[float, ...]]] = {
        "region": [(one.at, one.size, _KINDS.index(one.kind)) for one in board.regions],
        "word": [(one.at, one.value, one.fixed) for one in board.words],
        "encoder": [(one.at, one.bits, joints(one.joint)) for one in board.encoders],
        "adc": [
            (one.status, one.control, one.flag, one.enable, one.interrupt, one.clear == "one")
            for one in board.adcs
        ],
        "channel": [
            (one.at, joints(one.joint), one.bits, index, one.counts_per_ampere, one.offset)
            for index, adc in enumerate(board.adcs)
            for one in adc.channels
        ],
        "pwm": [
            (
                _PWMS.index(one.kind),
                joints(one.joint),
                *(one.compare, one.reload, one.minus, one.direction, one.direction_bit),
                one.aligned == "edge",
                full_scale,
            )
            for one, full_scale in zip(board.pwms, full_scales, strict=True)
        ],
        "pin": [
            (
                *(one.at, one.bit, _PINS.index(one.is_)),
                joints(one.joint) if one.joint else -1,
                one.active == "low",
            )
            for one in board.pins
        ],
        "port": [(one.output, one.set_reset, one.set, one.clear) for one in board.ports],
        "uart": [
            (
                *(one.status, one.data, one.control, one.interrupt, one.baud),
                *uarts.get(one.name, (-1, -1)),
                one.targets,
            )
            for one in board.uarts
        ],
    }
    kinds = (_REGION, _WORD, _ENCODER, _ADC, _CHANNEL, _PWM, _PIN, _PORT, _UART)
    told = _BOARD(
        size=ctypes.sizeof(_BOARD),
        joints=len(scene.joints),
        clock=board.clock,
        cycles_per_instruction=board.cycles_per_instruction,
        cycles_per_branch=board.cycles_per_branch,
        boot=board.boot,
        period=round(scene.servo_period * 1e9),
        vectors=board.vectors,
        interrupts=board.interrupts,
        priority_bits=board.priority_bits,
        preload=board.preload,
    )
    kept: list[object] = []  # the struct points to them
    for (name, rows), kind in zip(lists.items(), kinds, strict=True):
        entries = [kind(*row) for row in rows]
        array = (kind * len(entries))(*entries)
        kept.append(array)
        setattr(told, name, ctypes.addressof(array))
        setattr(told, f"{name}s", len(entries))
    if board.mailbox is not None:
        at = (_uint32 * len(scene.joints))(
            *(board.mailbox.at.get(name, 0) for name in scene.joint_names)
        )
        mailbox = _MAILBOX(board.mailbox.count, board.mailbox.interrupt, ctypes.addressof(at))
        kept += [at, mailbox]
        told.mailbox = ctypes.addressof(mailbox)
    told.kept = kept
    return told
