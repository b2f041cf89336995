"""The line's end as a pseudo terminal, which masters open like a serial port."""

import contextlib
import os
import select
import sys
import termios
import time
import tty
from pathlib import Path

from arm_emulator.extension.base import Refusal
from arm_emulator_fieldbus.modbus_line import ModbusLine
from arm_emulator_fieldbus.serial_line import compute_bytes_time, compute_silence

# Bytes from another process arrive later than on a line. Only an incomplete
# request waits so long.
LONGEST_GAP = 20_000_000  # ns
REPORT_SILENCE = 5.0  # s
LOOK = 2e-3  # s, between two looks at the loop in real time
_SPEEDS = {
    getattr(termios, name): int(name[1:])
    for name in dir(termios)
    if name[0] == "B" and name[1:].isdigit()
}


class SerialPort:
    """A pseudo terminal: a serial port of this machine whose other end a master opens.

    Attributes:
        path: that masters open.

    Args:
        baud: of the end that is here.
        link: where to put a link to it, in place of one that is there; None: nowhere.

    Raises:
        Refusal: something else stands there, or the link cannot be made.
    """

    def __init__(self, baud: int, link: Path | None) -> None:
        self._baud = baud
        self._speed = next((name for name, speed in _SPEEDS.items() if speed == baud), None)
        self._end, self._port = os.openpty()
        tty.setraw(self._port)
        if self._speed is not None:
            settings = termios.tcgetattr(self._port)
            settings[4] = settings[5] = self._speed
            termios.tcsetattr(self._port, termios.TCSANOW, settings)
        self._reported = False
        os.set_blocking(self._end, False)
        self.path = os.ttyname(self._port)
        self._link = link
        if link is not None:
            try:
                if link.is_symlink():
                    link.unlink()
                link.symlink_to(self.path)
            except OSError as error:
                self._link = None
                self.close()
                raise Refusal("modbus", f"link {link}", "be makeable", error.strerror) from None

    def close(self) -> None:
        """Close the port."""
        if self._link is not None and self._link.is_symlink():
            if os.readlink(self._link) == self.path:
                self._link.unlink()
        os.close(self._end)
        os.close(self._port)

    def read_bytes(self, timeout: float | None) -> bytes:
        """Return the bytes that have come, after at most `timeout` [s]; empty if none have."""
        if not select.select([self._end], [], [], timeout)[0]:
            return b""
        try:
            data = os.read(self._end, 4096)
        except OSError:
            return b""
        return data if self._has_same_speed() else b""

    def write_bytes(self, data: bytes) -> None:
        """Send bytes; bytes that are not read are lost, as on a line."""
        with contextlib.suppress(BlockingIOError):
            os.write(self._end, data)

    def _has_same_speed(self) -> bool:
        """Whether the master has set the speed of this end; else nothing can be understood."""
        speed = termios.tcgetattr(self._port)[5]
        if self._speed is None or speed == self._speed:
            self._reported = False
            return True
        if not self._reported:
            self._reported = True
            theirs = _SPEEDS.get(speed, "another speed in")
            _print_report(
                f"the master has set {theirs} baud, this end has {self._baud}: nothing gets through"
            )
        return False


def serve_port(port: SerialPort, line: ModbusLine) -> None:
    """Serve masters in logical time, indefinitely."""
    gap = max(compute_silence(line.baud), LONGEST_GAP) / 1e9
    silent = False
    while True:
        waiting = line.receiver.has_partial
        data = port.read_bytes(gap if waiting else REPORT_SILENCE)
        if data:
            silent = False
            port.write_bytes(line.exchange_bytes(data))
        elif waiting:
            port.write_bytes(line.note_silence())
        elif not silent:
            silent = True
            tick = line.converter.session.tick
            _print_report(f"the master is silent, logical time stands still at tick {tick}")


class RealTimeService:
    """Serves masters by the clock: a reply comes after the time that it takes on the line.

    Args:
        port: where masters are.
        line: with a converter in front of a session in real time.
    """

    def __init__(self, port: SerialPort, line: ModbusLine) -> None:
        self._port, self._line = port, line

    def serve_masters(self) -> None:
        """Serve masters, indefinitely."""
        line, receiver = self._line, self._line.receiver
        silence = compute_silence(line.baud)
        gap = max(silence, LONGEST_GAP)
        last = began = time.monotonic_ns()
        while True:
            data = self._port.read_bytes(LOOK)
            self._update_state()
            now = time.monotonic_ns()
            if data:
                last = now
                # The first of its bytes is there now; on a line the last one would come later.
                if not receiver.has_partial:
                    began = now
                    count = 0
                count += len(data)
                requests = receiver.take_bytes(line.errors.damage_bytes(data))
            elif receiver.has_partial and now - last > gap:
                requests = receiver.note_silence()
            else:
                continue
            for request in requests:
                heard = began + compute_bytes_time(count, line.baud) + silence
                self._wait_until(heard)
                reply = line.station.answer_request(request)
                if reply:
                    duration = compute_bytes_time(len(reply), line.baud)
                    self._wait_until(max(heard, time.monotonic_ns()) + duration)
                    self._port.write_bytes(line.errors.damage_bytes(reply))

    def _wait_until(self, moment: int) -> None:
        while (left := moment - time.monotonic_ns()) > 0:
            time.sleep(min(left / 1e9, LOOK))
            self._update_state()

    def _update_state(self) -> None:
        """Take what the loop in real time has reached."""
        converter = self._line.converter
        while converter.session.take():
            pass
        if converter.has_tripped():
            converter.offer_commands()


def _print_report(words: str) -> None:
    print(f"modbus: {words}", file=sys.stderr, flush=True)
