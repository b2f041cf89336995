"""Boards and programs of firmware, sound and spoiled."""

import struct
from pathlib import Path

import numpy as np
import yaml

Rng = np.random.Generator

JOINTS = "waist", "shoulder", "elbow"


def write_board(rng: Rng, folder: Path) -> Path:
    board = {
        "clock": 168e6, "interrupts": 82, "cycles_per_instruction": 1,
        "memory": {
            "flash": {"at": 0x08000000, "size": 1 << 16},
            "ram": {"at": 0x20000000, "size": 1 << 16},
        },
        "registers": {"all": {"at": 0x40000000, "size": 0x8000}},
        "encoders": {name: {"at": 0x40000000 + 4 * k, "bits": 16} for k, name in enumerate(JOINTS)},
        "pwm": {
            name: {"kind": "float", "compare": 0x40000100 + 4 * k} for k, name in enumerate(JOINTS)
        },
    }  # fmt: skip
    (folder / "firmware.elf").write_bytes(_elf())
    file = folder / "spoiled.yaml"
    file.write_text(yaml.safe_dump(board))
    return file


def _elf() -> bytes:
    """Return firmware that sleeps: vectors, `wfi`, a jump back, and a table of symbols."""
    code = struct.pack("<2I", 0x20010000, 0x08000201) + bytes(0x1F8) + b"\x30\xbf\xfd\xe7"
    strings = b"\0main\0"
    symbols = bytes(16) + struct.pack("<IIIBBH", 1, 0x08000201, 4, 0x12, 0, 1)
    names = b"\0.text\0.symtab\0.strtab\0.shstrtab\0"
    at = 52 + 32
    places = [at, at + len(code)]
    places += [places[1] + len(symbols), places[1] + len(symbols) + len(strings)]
    table = places[3] + len(names)
    head = b"\x7fELF\x01\x01\x01" + bytes(9) + struct.pack(
        "<HHIIIIIHHHHHH", 2, 40, 1, 0x08000201, 52, table, 0x5000400, 52, 32, 1, 40, 5, 4
    )  # fmt: skip
    program = struct.pack("<8I", 1, at, 0x08000000, 0x08000000, len(code), len(code), 5, 4)
    sections = bytes(40)
    for name, kind, address, place, size, link, info, each in (
        (1, 1, 0x08000000, places[0], len(code), 0, 0, 0),
        (7, 2, 0, places[1], len(symbols), 3, 1, 16),
        (15, 3, 0, places[2], len(strings), 0, 0, 0),
        (23, 3, 0, places[3], len(names), 0, 0, 0),
    ):
        sections += struct.pack("<10I", name, kind, 0, address, place, size, link, info, 4, each)
    return head + program + code + symbols + strings + names + sections


def write_firmware(rng: Rng, folder: Path) -> Path:
    write_board(rng, folder).rename(folder / "board.yaml")
    file = folder / "spoiled.elf"
    file.write_bytes(_elf())
    return file


def elf_odd(rng: Rng, file: Path) -> None:
    """Change a number in one of the headings."""
    body = bytearray(file.read_bytes())
    table = len(body) - 5 * 40
    at = int(rng.choice([rng.integers(16, 84), rng.integers(table, len(body) - 4)]))
    width = int(rng.choice([1, 2, 4]))
    number = int(rng.choice([0, 1, 2**16 - 1, 2**31, 2**32 - 1, rng.integers(2**32), len(body)]))
    body[at : at + width] = (number & (1 << 8 * width) - 1).to_bytes(width, "little")
    file.write_bytes(bytes(body))
    if rng.random() < 0.1:
        with file.open("ab") as stream:
            stream.truncate(1 << int(rng.integers(20, 30)))
