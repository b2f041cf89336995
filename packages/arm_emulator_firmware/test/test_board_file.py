"""Board files of a microcontroller: every mistake is refused in one line."""

import copy
import importlib.util
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from documents import page_of
from draws import some

from arm_emulator.base.refusal import Refusal
from arm_emulator.cli.command_line import main
from arm_emulator_firmware import FOLDER
from arm_emulator_firmware.board import Board, load_board
from arm_emulator_firmware.elf_image import ElfImage

EXAMPLE = FOLDER / "examples/stm32f4_like/board.yaml"
JOINTS = (
    "shoulder_pan_joint shoulder_lift_joint elbow_joint wrist_1_joint wrist_2_joint wrist_3_joint"
).split()
# Every section has an entry with all of its keys.
FULL: dict[str, Any] = {
    "clock": 1e8,
    "cycles_per_instruction": 1.5,
    "cycles_per_branch": 2,
    "boot": 0.1,
    "interrupts": 60,
    "priority_bits": 3,
    "preload": True,
    "vectors": "0x8000",
    "memory": {
        "flash": {"at": "0x8000", "size": "0x10000"},
        "ram": {"at": 0x20000000, "size": 4096},
        "fast": {"kind": "code_ram", "at": 0x10000000, "size": 1024},
    },
    "registers": {"one": {"at": "0x40000000", "size": 4096}},
    "values": {"ready": {"at": "0x40000000", "value": 3, "fixed": "0x2"}},
    "encoders": {"a": {"at": "0x40000010", "bits": 16}},
    "adc": {
        "ADC": {
            "status": "0x40000020",
            "flag": 2,
            "control": "0x40000024",
            "enable": 7,
            "interrupt": 18,
            "clear": "one",
            "channels": {
                "a": {
                    "at": "0x40000028",
                    "holds": "counts",
                    "bits": 12,
                    "counts_per_ampere": -40,
                    "offset": 2048,
                },
                "b": {"at": "0x4000002c", "holds": "float"},
            },
        }
    },
    "pwm": {
        "a": {
            "kind": "unipolar",
            "compare": "0x40000030",
            "reload": "0x40000034",
            "aligned": "center",
            "direction": "0x40000038",
            "direction_bit": 3,
        },
        "b": {"kind": "pair", "compare": "0x4000003c", "reload": "0x40000034", "minus": 1073741888},
    },
    "ports": {
        "A": {
            "output": "0x40000050",
            "set_reset": "0x40000054",
            "set": "0x40000058",
            "clear": "0x4000005c",
        }
    },
    "pins": {"on": {"is": "enable", "at": "0x40000050", "bit": 0, "active": "low", "joint": "a"}},
    "uart": {
        "line": {
            "status": "0x40000060",
            "data": "0x40000064",
            "control": "0x40000068",
            "interrupt": 3,
            "baud": 9600,
            "targets": True,
        }
    },
    "targets": {"count": "0x40000070", "interrupt": 4, "joints": {"a": "0x40000074"}},
}


def load(content: object, folder: Path) -> Board:
    file = folder / "board.yaml"
    file.write_text(content if isinstance(content, str) else yaml.safe_dump(content))
    return load_board(file, ("a", "b"))


def places(content: dict[str, Any], above: tuple[str, ...] = ()) -> list[tuple[str, ...]]:
    """Return the paths to all keys."""
    keys = []
    for key, value in content.items():
        keys.append((*above, key))
        if isinstance(value, dict):
            keys += places(value, (*above, key))
    return keys


def changed(path: tuple[str, ...], value: object) -> dict[str, Any]:
    """Return the full board with one key changed; without it if the value is `...`."""
    board = copy.deepcopy(FULL)
    section = board
    for key in path[:-1]:
        section = section[key]
    if value is ...:
        del section[path[-1]]
    else:
        section[path[-1]] = value
    return board


def test_the_example_and_a_board_with_every_key_are_read(tmp_path: Path) -> None:
    board = load_board(EXAMPLE, JOINTS)
    joints = [row["joint"] for row in board.rows["encoder"]]
    assert joints == list(range(len(JOINTS))), "joints with an encoder"
    fields = [board.fields[name] for name in ("clock", "interrupts", "vectors")]
    assert fields == [168e6, 82, 0x08000000]
    full = load(FULL, tmp_path)
    for name, read in (full.rows | full.fields).items():
        assert read, f"{name} is read"
    assert full.rows["channel"][0]["counts_per_ampere"] == -40.0, "a sensor that counts down"


def test_every_key_is_documented() -> None:
    text = page_of("microcontroller").read_text()
    for path in places(FULL):
        key = path[-1]
        if key in ("a", "b", "A", "ADC", "line", "on", "one", "fast", "ready", "flash", "ram"):
            continue
        assert f"`{key}`" in text, f"{'.'.join(path)} in docs/how_to/microcontroller.md"


WRONG = {
    ("clock",): (0, -1, 1e11, "fast", None, True, float("nan")),
    ("cycles_per_instruction",): (-1, 2000, "one"),
    ("cycles_per_branch",): (-0.5, None),
    ("boot",): (-1, 1e3),
    ("interrupts",): (0, 241, 1.5, ...),
    ("priority_bits",): (0, 9),
    ("preload",): ("yes", 1),
    ("vectors",): ("0x8004", "0x17f80", "0x30000000"),
    ("memory",): (..., {}, [], None, {"ram": {"at": 0x20000000, "size": 1024}}),
    ("memory", "flash", "at"): ("0x8001", -1024, "8000h", 2**32, "0xdffffc00", ...),
    ("memory", "ram", "size"): (0, 1000, 2**29, "0x100000000"),
    ("memory", "fast", "kind"): ("rom", ..., None),
    ("memory", "fast", "at"): ("0x8400", 0x20000000),
    ("registers", "one", "at"): (0, "0xe000e000", "0x20000000"),
    ("values", "ready", "at"): ("0x40000002", "0x50000000", ...),
    ("encoders", "a", "bits"): (7, 33, ...),
    ("encoders", "a", "at"): ("0x40000020", "0x40001000"),
    ("encoders",): ({"c": {"at": "0x40000010", "bits": 16}},),
    ("adc", "ADC", "status"): ("0x40000024", ...),
    ("adc", "ADC", "flag"): (32, -1, ...),
    ("adc", "ADC", "control"): (...,),
    ("adc", "ADC", "interrupt"): (60, -1, 2.5),
    ("adc", "ADC", "clear"): ("both", 0),
    ("adc", "ADC", "channels"): ({"c": {"at": "0x40000028", "holds": "float"}}, 3),
    ("adc", "ADC", "channels", "a", "bits"): (0, 32, ...),
    ("adc", "ADC", "channels", "a", "counts_per_ampere"): (0, float("inf"), ...),
    ("adc", "ADC", "channels", "a", "offset"): (-1, 4096, ...),
    ("adc", "ADC", "channels", "a", "holds"): ("volts",),
    ("adc", "ADC", "channels", "b", "bits"): (12,),
    ("pwm", "a", "kind"): ("tripolar", ..., None),
    ("pwm", "a", "reload"): (..., 5),
    ("pwm", "a", "aligned"): ("left",),
    ("pwm", "a", "direction_bit"): (32, ...),
    ("pwm", "a", "minus"): ("0x40000040",),
    ("pwm", "b", "minus"): (...,),
    ("ports", "A", "output"): (..., "0x40000051"),
    ("ports", "A", "set"): ("0x40000054",),
    ("pins", "on", "is"): ("led", ...),
    ("pins", "on", "active"): ("up",),
    ("pins", "on", "joint"): ("c", 1, ""),
    ("uart", "line", "baud"): (0, 1e9),
    ("uart", "line", "data"): ("0x40000060", ...),
    ("uart", "line", "targets"): ("all",),
    ("targets", "count"): (..., "0x40000074"),
    ("targets", "joints"): (..., {"c": "0x40000074"}),
}


@pytest.mark.parametrize("path", WRONG, ids=".".join)
def test_a_wrong_value_is_refused_with_its_place(path: tuple[str, ...], tmp_path: Path) -> None:
    for value in WRONG[path]:
        with pytest.raises(Refusal) as no:
            load(changed(path, value), tmp_path)
        line = str(no.value)
        assert line.startswith("board.yaml: ") and " must " in line and "\n" not in line, line
        assert any(key in line for key in path), f"{path} = {value!r}: {line}"


@pytest.mark.parametrize("seed", some(range(40), 7))
def test_any_change_of_a_board_is_read_or_refused_in_a_line(seed: int, tmp_path: Path) -> None:
    """Keys that go, come, change places or get any other value: nothing but a refusal."""
    rng = np.random.default_rng([1, seed])
    all_places = places(FULL)
    odd = [
        *(None, True, "", "x", 0, -1, 1, 31, 2**31, 2**32, 2**70, 1e-300, 1e300),
        *(float("nan"), float("inf"), [], [1], {}, {"at": 1}, {"a": {}}, "0x", "0xfffffffff"),
        *("0x40000010", 1073741840, "é", "a" * 5000, {"": 3}),
    ]
    refused = 0
    for _ in range(25):
        board = copy.deepcopy(FULL)
        for _ in range(int(rng.integers(1, 4))):
            path = all_places[rng.integers(len(all_places))]
            section: Any = board
            for key in path[:-1]:
                section = section.get(key, {}) if isinstance(section, dict) else {}
            if not isinstance(section, dict) or path[-1] not in section:
                continue
            change = rng.integers(4)
            value = section[path[-1]]
            if change == 0:
                del section[path[-1]]
            elif change == 1:
                section[str(rng.choice(["more", "kind", "at", "c", "joint"]))] = value
            else:
                section[path[-1]] = copy.deepcopy(odd[rng.integers(len(odd))])
        try:
            load(board, tmp_path)
        except Refusal as no:
            refused += 1
            assert "\n" not in str(no) and str(no).startswith("board.yaml: "), str(no)
    assert refused > 5, "boards that are refused"


@pytest.mark.parametrize("seed", some(range(20), 4))
def test_any_bytes_are_no_firmware(seed: int, tmp_path: Path) -> None:
    """Damaged ELF files: a refusal in one line, or what is still sound."""
    pytest.importorskip("elftools")
    rng = np.random.default_rng([2, seed])
    sound = elf_file()
    file = tmp_path / "firmware.elf"
    file.write_bytes(sound)
    assert ElfImage(file).pieces == [(0x8000, b"code")], "what a sound file loads"
    for _ in range(60):
        content = bytearray(sound)
        for place in rng.integers(0, len(content), int(rng.integers(1, 6))):
            content[place] = int(rng.choice([0, 1, 0xFF, rng.integers(256)]))
        file.write_bytes(content[: int(rng.integers(len(content) + 1))] if rng.random() < 0.3
                         else content)  # fmt: skip
        try:
            ElfImage(file)
        except Refusal as no:
            assert "\n" not in str(no) and str(no).startswith("firmware.elf: "), str(no)


def elf_file() -> bytes:
    """Return an ELF file for Arm with one segment of four bytes."""
    header = b"\x7fELF\x01\x01\x01" + bytes(9)
    for size, value in ((2, 2), (2, 40), (4, 1), (4, 0x8001), (4, 52), (4, 0), (4, 0)):
        header += value.to_bytes(size, "little")
    for value in (52, 32, 1, 40, 0, 0):
        header += value.to_bytes(2, "little")
    segment = (1, 84, 0x20000000, 0x8000, 4, 4, 5, 4)
    return header + b"".join(value.to_bytes(4, "little") for value in segment) + b"code"


def test_a_missing_package_is_named(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """In one line, with what to install."""
    find = importlib.util.find_spec
    (tmp_path / "firmware.elf").write_bytes(elf_file())
    for missing, package in (("elftools", "pyelftools"), ("unicorn", "unicorn")):
        monkeypatch.setattr(
            importlib.util,
            "find_spec",
            lambda name, *more, without=missing: None if name == without else find(name, *more),
        )
        with pytest.raises(Refusal, match=f"pip install {package}$"):
            if missing == "elftools":
                ElfImage(tmp_path / "firmware.elf")
            else:
                from arm_emulator_firmware.unicorn_library import find_headers

                find_headers()


@pytest.mark.parametrize(
    ("words", "line"),
    [
        (["nothing.yaml", "x.elf"], "nothing.yaml: file must be readable, got no such file"),
        ([str(EXAMPLE), "x.elf"], "board.yaml: encoders must name joints of the scene"),
        ([str(EXAMPLE), "x.elf", "--scene", "ur5", "--uart", "line=pty"], "--uart must name a"),
        (
            [str(EXAMPLE), "x.elf", "--scene", "ur5", "--uart", "USART2=lp"],
            "--uart must state where",
        ),
        ([str(EXAMPLE), "x.elf", "--scene", "ur5", "--seconds", "0"], "seconds must be at least"),
        ([str(EXAMPLE), "x.elf", "--scene", "ur5", "--gdb", "70000"], "--gdb must be a port"),
        ([str(EXAMPLE), "x.elf", "--scene", "ur5"], "x.elf: file must be readable"),
    ],
)
def test_the_command_refuses_in_a_line(
    words: list[str], line: str, monkeypatch: pytest.MonkeyPatch, capfd: Any
) -> None:
    monkeypatch.setattr("sys.argv", ["arm_emulator", "firmware", *words])
    with pytest.raises(SystemExit) as end:
        main()
    printed = capfd.readouterr().err
    assert end.value.code == 2 and line in printed and printed.count("\n") == 1, printed
