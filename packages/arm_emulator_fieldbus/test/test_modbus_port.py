"""The port of the data converter: in lock-step and in real time."""

import os
import random
import select
import signal
import struct
import subprocess
import sys
import termios
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from modbus_line import line_of, read_write, sound

from arm_emulator.machine.scene.scene import Scene, load_scene
from arm_emulator_fieldbus import converter as registers
from arm_emulator_fieldbus.modbus_rtu import is_sound

PATIENCE = 120.0  # s


@pytest.fixture(scope="module")
def scene() -> Scene:
    return load_scene("three_axis")


@contextmanager
def served(tmp_path: Path, *arguments: str) -> Iterator[tuple[int, subprocess.Popen[str]]]:
    """The command in a process of its own, and its port opened as a master would."""
    link = tmp_path / "port"
    command = [sys.executable, "-m", "arm_emulator", "modbus", "three_axis", "--link", str(link)]
    with subprocess.Popen(
        [*command, *arguments], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as process:
        try:
            assert process.stdout is not None
            while "baud" not in process.stdout.readline():
                assert process.poll() is None, process.stderr
            port = os.open(link, os.O_RDWR | os.O_NOCTTY)
            yield port, process
            os.close(port)
            process.send_signal(signal.SIGINT)
            out, err = process.communicate(timeout=PATIENCE)
            assert process.returncode == 0 and "Traceback" not in err, out + err
            assert not link.is_symlink(), "the link is taken away"
        finally:
            process.kill()


def ask(port: int, request: bytes, length: int) -> bytes:
    """Return the reply from a port, or what of it has come within 20 s."""
    os.write(port, request)
    reply, until = b"", time.monotonic() + 20.0
    while len(reply) < length and (left := until - time.monotonic()) > 0:
        if select.select([port], [], [], left)[0]:
            reply += os.read(port, 256)
    return reply


def test_port_serves_in_lockstep_and_ends_on_ctrl_c(tmp_path: Path, scene: Scene) -> None:
    line, _ = line_of(scene)
    draw = random.Random(1)
    with served(tmp_path) as (port, process):
        os.write(port, b"noise that is no frame")
        time.sleep(0.1)  # a pause; where the server sees none, the request is lost: asked again
        for k in range(20):
            request = sound(b"\1" + read_write(1000, 15, 2001, draw.choices(range(3000), k=3)))
            expected = line.exchange_bytes(request)
            reply = ask(port, request, len(expected))
            assert (reply or (k == 0 and ask(port, request, len(expected)))) == expected
        settings = termios.tcgetattr(port)
        settings[4] = settings[5] = termios.B9600
        termios.tcsetattr(port, termios.TCSANOW, settings)
        os.write(port, request)
        assert process.stderr is not None
        reported = "the master has set 9600 baud, this end has 115200: nothing gets through"
        assert reported in process.stderr.readline()
        settings[4] = settings[5] = termios.B115200
        termios.tcsetattr(port, termios.TCSANOW, settings)
        expected = line.exchange_bytes(request)
        assert ask(port, request, len(expected)) == expected, "what was not heard changed nothing"


def test_port_in_real_time_takes_the_time_of_the_line_and_watches(tmp_path: Path) -> None:
    """A lower bound on the time of an exchange, which no load can break; and drives off in time."""
    with served(tmp_path, "--clock", "realtime", "--baud", "9600", "--watchdog", "50") as (port, _):
        request = sound(b"\1" + read_write(1000, 9, 2001, (2000, 0, 0)))
        started = time.monotonic()
        for _ in range(3):
            reply = ask(port, request, 23)
            assert is_sound(reply)
        min_seconds = 3 * ((19 + 23) * 11 / 9600 + 3.5 * 11 / 9600)
        assert time.monotonic() - started >= min_seconds
        status = sound(struct.pack(">BBHH", 1, 4, 1000, 3))
        until = time.monotonic() + PATIENCE
        while not ask(port, status, 11)[4] & registers.WATCHDOG:
            assert time.monotonic() < until, "drives still on"
        off = ask(port, status, 11)
        assert not off[4] & registers.POWERED and off[8] + (off[7] << 8) > 50
