"""A board, wired to a scene's machine, as the structs of runner.h."""

from __future__ import annotations

from arm_emulator.base.refusal import Refusal
from arm_emulator.build.c_header import CData, Header
from arm_emulator.core import BOUNDARY
from arm_emulator.doors.microcontroller import FOLDER
from arm_emulator.doors.microcontroller.board import Board, Pwm
from arm_emulator.machine.parts.input import VOLTAGE
from arm_emulator.machine.scene import Scene

RUNNER = Header(FOLDER / "runner.h", (BOUNDARY,))

_KINDS = {
    word: RUNNER.constant(kind)
    for word, kind in {
        "flash": "MCU_FLASH", "ram": "MCU_RAM", "registers": "MCU_REGISTERS",
        "code_ram": "MCU_CODE_RAM", "float": "MCU_VOLTS", "bipolar": "MCU_BIPOLAR",
        "unipolar": "MCU_UNIPOLAR", "pair": "MCU_PAIR", "enable": "MCU_ENABLE",
        "brake": "MCU_BRAKE", "fault": "MCU_FAULT", "powered": "MCU_POWERED",
    }.items()
}  # fmt: skip


def board_struct(
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
    kept: dict[str, CData] = {}  # the struct points to them
    for name, rows in _rows(board, scene, uarts).items():
        kept[name] = RUNNER.ffi.new(f"mcu_{name}[]", rows)
        kept[f"{name}s"] = len(rows)
    if board.mailbox is not None:
        registers = [board.mailbox.at.get(name, 0) for name in scene.joint_names]
        at = kept["at"] = RUNNER.ffi.new("uint32_t[]", registers)
        count, interrupt = board.mailbox.count, board.mailbox.interrupt
        kept["mailbox"] = RUNNER.new("mcu_mailbox", count=count, interrupt=interrupt, at=at)
    fields = {name: one for name, one in kept.items() if name != "at"}
    reported = RUNNER.new(
        "mcu_board",
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
        **fields,
    )
    return reported, kept


def _rows(
    board: Board, scene: Scene, uarts: dict[str, tuple[int, int]]
) -> dict[str, list[dict[str, float]]]:
    """Return the rows of the board's lists, by the names of their structs."""
    full_scales = [_full_scale(one, scene) for one in board.pwms]
    joints = scene.joint_names.index
    return {
        "region": [
            {"at": one.at, "size": one.size, "kind": _KINDS[one.kind]} for one in board.regions
        ],
        "word": [_numbers(one, "at value fixed") for one in board.words],
        "encoder": [
            {**_numbers(one, "at bits"), "joint": joints(one.joint)} for one in board.encoders
        ],
        "adc": [
            {
                **_numbers(one, "status control flag enable interrupt"),
                "clear_by_one": one.clear == "one",
            }
            for one in board.adcs
        ],
        "channel": [
            {
                **_numbers(one, "at bits counts_per_ampere offset"),
                "joint": joints(one.joint),
                "adc": index,
            }
            for index, adc in enumerate(board.adcs)
            for one in adc.channels
        ],
        "pwm": [
            {
                **_numbers(one, "compare reload minus direction direction_bit"),
                "kind": _KINDS[one.kind],
                "joint": joints(one.joint),
                "counts_more": one.aligned == "edge",
                "full_scale": full_scale,
            }
            for one, full_scale in zip(board.pwms, full_scales, strict=True)
        ],
        "pin": [
            {
                **_numbers(one, "at bit"),
                "kind": _KINDS[one.is_],
                "joint": joints(one.joint) if one.joint else -1,
                "low": one.active == "low",
            }
            for one in board.pins
        ],
        "port": [_numbers(one, "output set_reset set clear") for one in board.ports],
        "uart": [
            {
                **_numbers(one, "status data control interrupt baud targets"),
                **dict(zip(("out", "in"), uarts.get(one.name, (-1, -1)), strict=True)),
            }
            for one in board.uarts
        ],
    }


def _full_scale(pwm: Pwm, scene: Scene) -> float:
    """Return the command at a duty of 1 [V, A or N m]: of a bridge the supply."""
    command = scene.joints[scene.joint_names.index(pwm.joint)].inputs[0]
    if pwm.full_scale is not None or pwm.kind == "float":
        return pwm.full_scale or 0.0
    if command != VOLTAGE:
        takes = f"{command.about} [{command.unit}]"
        rule = f"be given: the joint's command is {takes}, and no bridge makes that of a duty"
        raise Refusal("board", f"pwm.{pwm.joint}.full_scale", rule, "nothing")
    return scene.supply_voltage


def _numbers(one: object, names: str) -> dict[str, float]:
    """Return those that are in a board file as in its struct."""
    return {name: getattr(one, name) for name in names.split()}
