"""The nodes on a bus: their own over TCP, or one of python-can, such as socketcan."""

from __future__ import annotations

import contextlib
import logging
import sys
import time
from collections.abc import Callable, Iterator
from typing import Any

from arm_emulator.extension.base import Refusal
from arm_emulator_fieldbus.can_server import CanServer
from arm_emulator_fieldbus.canopen_node import CanFrame
from arm_emulator_fieldbus.canopen_segment import CanSegment

LOOK = 0.1  # s, after which a silent bus is checked
REPORT_SILENCE = 5.0  # s
LATEST = 100_000_000  # ns, beyond which periods are lost
MAX_FRAMES = 200  # frames answered between two late servo periods


@contextlib.contextmanager
def open_bus(interface: str, channel: str, bitrate: int | None) -> Iterator[PythonCanBus]:
    """Open a bus for a block.

    Raises:
        Refusal: python-can is not installed, or it does not open this bus.
    """
    try:
        import can
    except ImportError:
        rule = "be installed (pip install python-can)"
        raise Refusal("canopen", "package python-can", rule, "none") from None
    logging.getLogger("can").setLevel(logging.CRITICAL)  # relevant events are published below
    interfaces = sorted(can.VALID_INTERFACES)
    if interface not in interfaces:
        raise Refusal("canopen", "bus", "be one of python-can", interface, ", ".join(interfaces))
    speed: dict[str, Any] = {} if bitrate is None else {"bitrate": bitrate}
    try:
        bus = can.Bus(interface=interface, channel=channel, **speed)
    except (can.CanError, OSError, ValueError, ImportError) as error:
        where = f"bus {interface}, channel {channel}"
        raise Refusal("canopen", where, "open", error) from None
    try:
        yield PythonCanBus(bus)
    finally:
        bus.shutdown()


class PythonCanBus:
    """A bus of python-can.

    Attributes:
        ignored: items that are not frames of 11 bits with at most 8 bytes.
    """

    def __init__(self, bus: Any) -> None:
        self._bus = bus
        self.ignored = 0

    def receive(self, timeout: float) -> CanFrame | None:
        """Return the next frame, None if none comes in time [s].

        Raises:
            Refusal: the bus is gone.
        """
        try:
            message = self._bus.recv(timeout)
            if message is None:
                return None
            if not (message.is_extended_id or message.is_error_frame or message.is_fd):
                number, data = int(message.arbitration_id), bytes(message.data or b"")
                if 0 <= number < 1 << 11 and len(data) <= 8:
                    return CanFrame(number, data, bool(message.is_remote_frame))
        # python-can may raise any exception on the data of others.
        except Exception as error:
            if _is_system_error(error):
                raise Refusal("canopen", "bus", "stay open", error) from None
        self.ignored += 1
        return None

    def send(self, frame: CanFrame) -> None:
        """Send a frame."""
        import can

        message = can.Message(
            arbitration_id=frame.id, data=frame.data, is_extended_id=False, check=False
        )
        try:
            self._bus.send(message)
        except can.CanError as error:
            _report_line(f"a frame was not sent: {error}")


Bus = PythonCanBus | CanServer


def _is_system_error(error: BaseException | None) -> bool:
    """Whether the operating system is the cause, and not the received data."""
    while error is not None:
        if isinstance(error, OSError):
            return True
        error = error.__cause__ or error.__context__
    return False


class BusService:
    """Serves a bus until requested to end.

    Args:
        bus: that they are on.
        segment: the nodes.
        period: servo period [ns]; None: in lock-step.
    """

    def __init__(self, bus: Bus, segment: CanSegment, period: int | None) -> None:
        self._bus, self._segment, self._period = bus, segment, period
        self._reported = False
        self.lost_periods = 0  # in real time: lateness of logical time

    def serve_nodes(self, goes_on: Callable[[], bool] = lambda: True) -> None:
        """Boot the nodes, and serve."""
        self._send_frames(self._segment.boot_nodes())
        if self._period is None:
            self._serve_in_lockstep(goes_on)
        else:
            self._serve_in_real_time(goes_on, self._period)

    def _serve_in_lockstep(self, goes_on: Callable[[], bool]) -> None:
        silent, since, tick = False, time.monotonic(), -1
        while goes_on():
            beat = self._segment.beat
            self._has_received(min(beat / 2e9, LOOK) if beat else LOOK)
            if self._segment.tick != tick:
                tick, since, silent = self._segment.tick, time.monotonic(), False
            elif not silent and time.monotonic() - since > REPORT_SILENCE:
                silent = True
                _report_line(f"no SYNC, logical time stands still at tick {tick}")

    def _serve_in_real_time(self, goes_on: Callable[[], bool], period: int) -> None:
        due = time.monotonic_ns() + period
        while goes_on():
            late = time.monotonic_ns() - due
            if late < 0:
                self._has_received(-late / 1e9)
                continue
            if late > LATEST:
                lost = late // period
                self.lost_periods += lost
                due += lost * period
                _report_line(
                    f"{late / 1e9:.1f} s late: {self.lost_periods} servo periods lost so far"
                )
            due += period
            self._send_frames(self._segment.pass_period())
            self._report_fault()
            for _ in range(MAX_FRAMES):
                if not self._has_received(0.0):
                    break

    def _has_received(self, timeout: float) -> bool:
        """Wait for a frame, and answer it; send heartbeats that are due. Return whether one came.

        Raises:
            Refusal: the bus is gone.
        """
        frame = self._bus.receive(timeout)
        if frame is not None:
            self._send_frames(self._segment.receive_frame(frame))
            while self._segment.notices:
                _report_line(self._segment.notices.pop(0))
            self._report_fault()
        self._send_frames(self._segment.send_heartbeats(time.monotonic_ns()))
        return frame is not None

    def _send_frames(self, frames: list[CanFrame]) -> None:
        for frame in frames:
            self._bus.send(frame)

    def _report_fault(self) -> None:
        if self._segment.fault is not None and not self._reported:
            self._reported = True
            _report_line(str(self._segment.fault))


def _report_line(words: str) -> None:
    print(f"canopen: {words}", file=sys.stderr, flush=True)
