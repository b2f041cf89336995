"""pymodbus as the master of the data converter: its own servo loop moves the three-axis arm."""

import re
import signal
import struct
import subprocess
import sys
import textwrap
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from documents import page_of

from arm_emulator import Session, load_scene

client = pytest.importorskip("pymodbus.client")
pytest.importorskip("serial")
ModbusException: Any = pytest.importorskip("pymodbus.exceptions").ModbusException


ROOT = Path(__file__).resolve().parents[4]


@contextmanager
def master_of(tmp_path: Path, *arguments: str, patience: float = 30.0) -> Iterator[Any]:
    """The converter in a process of its own, and a master on its port.

    After `patience` [s] the master asks again: on a line that damages nothing never, however busy
    the machine is.
    """
    link = tmp_path / "port"
    command = [sys.executable, "-m", "arm_emulator", "modbus", "three_axis", "--link", str(link)]
    with subprocess.Popen([*command, *arguments], stdout=subprocess.PIPE, text=True) as process:
        try:
            assert process.stdout is not None
            while "baud" not in process.stdout.readline():
                assert process.poll() is None
            master = client.ModbusSerialClient(
                str(link), baudrate=115_200, timeout=patience, retries=5
            )
            assert master.connect()
            yield master
            master.close()
            process.send_signal(signal.SIGINT)
            assert process.wait(timeout=30) == 0
        finally:
            process.kill()


def long_of(words: list[int]) -> list[int]:
    return list(struct.unpack(f">{len(words) // 2}i", struct.pack(f">{len(words)}H", *words)))


def float_of(words: list[int]) -> float:
    return float(struct.unpack(">d", struct.pack(">4H", *words))[0])


@pytest.mark.parametrize("errors", [0.0, 0.0002])
def test_a_servo_loop_over_the_line_reaches_its_target(tmp_path: Path, errors: float) -> None:
    """The arm moves as the plant predicts from the same commands, to the last count.

    The master requests a lost reply again. This is one more write of commands, and so one more
    servo period under them: the tick in each reply reports it.
    """
    session = Session(load_scene("three_axis"), "lockstep", "first_answer")
    line = "--error-rate", str(errors), "--seed", "3"
    with master_of(tmp_path, *line, patience=0.5 if errors else 30.0) as master:
        assert master.read_holding_registers(0, count=2).registers == [2, 3]
        per_volt, rad_per_count, ratio = [], [], []
        for joint in range(3):
            words = master.read_input_registers(10000 + 48 * joint, count=48).registers
            per_volt.append(32768 / float_of(words[2:6]))
            rad_per_count.append(1 / float_of(words[6:10]))
            ratio.append(float_of(words[14:18]))
        reported = master.read_input_registers(1000, count=9).registers
        start = last = np.array(long_of(reported[3:9])) * rad_per_count
        target = start + np.array([0.10, -0.05, 0.08]) / ratio
        words, tick, answered = [0, 0, 0], 0, 0
        while tick < 600:
            answered += 1
            reported = master.readwrite_registers(
                read_address=1000, read_count=9, write_address=2001, values=words
            ).registers
            now = (reported[1] << 16) + reported[2]
            assert now == tick + 1 or errors, "one period per write"
            applied = np.array(words, np.uint16).astype(np.int16) * (48.0 / 32768)
            for k in range(tick, now):
                session.advance_under(applied, k)
            counts = long_of(reported[3:9])
            assert counts == session.measured.encoder_counts.tolist(), f"as predicted, tick {now}"
            theta = np.array(counts) * rad_per_count
            speed, last, tick = (theta - last) / ((now - tick) * 1e-3), theta, now
            volt = 2.0 * (target - theta) - 0.1 * speed
            words = [round(v) & 0xFFFF for v in np.clip(volt * per_volt, -32768, 32767).tolist()]
        # Without gravity and dry friction the loop stands still within a count or two.
        assert np.abs(theta - target).max() < 3 * 2 * np.pi / 1024
        if errors:
            damaged = master.diag_read_bus_comm_error_count().count
            assert tick > answered or damaged, "a request or a reply came damaged"


def test_wrong_requests_are_answered_with_exceptions(tmp_path: Path) -> None:
    with master_of(tmp_path) as master:
        assert master.read_input_registers(999, count=2).exception_code == 2
        assert master.write_register(1000, 1).exception_code == 2
        assert master.write_register(2000, 8).exception_code == 3
        assert master.read_coils(0, count=1).exception_code == 1
        assert master.diag_query_data(b"\x12\x34").message == b"\x12\x34"
        assert master.read_input_registers(1000, count=3).registers == [1, 0, 0]


def test_page_shows_the_real_output(tmp_path: Path) -> None:
    """The master of docs/how_to/modbus.md."""
    page = page_of("modbus").read_text()
    blocks = re.findall(r"(?:^    .*\n|^\n)+", page, re.M)
    (example,) = [textwrap.dedent(block).strip() for block in blocks if "import Modbus" in block]
    script, _, printed = example.rpartition("\n\n")
    with master_of(tmp_path) as master:
        master.close()  # the port is for one
        script = script.replace("/tmp/arm", str(tmp_path / "port"))
        ran = subprocess.run(
            [sys.executable, "-c", script], capture_output=True, text=True, timeout=60, check=False
        )
        assert ran.returncode == 0, ran.stderr
        assert ran.stdout.strip() == printed
