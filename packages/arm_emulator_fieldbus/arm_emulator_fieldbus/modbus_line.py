"""A converter on a serial line. Knows nothing of ptys and of the wall clock."""

from arm_emulator_fieldbus.converter import RegisterConverter
from arm_emulator_fieldbus.modbus_rtu import FrameReceiver, ModbusStation
from arm_emulator_fieldbus.serial_line import BITS_PER_BYTE, LineErrors, compute_silence


class ModbusLine:
    """A master's end of the line: it sends and receives bytes.

    Clock "lockstep": each write of commands is a servo period, and the line takes no time. "line":
    logical time is the time of requests, replies and the silences between them on the line.
    Meanwhile servo periods pass under the held commands; the master itself takes no time.
    "realtime": servo periods pass by themselves, see `RealTimeService`.

    Attributes:
        receiver, station: of the converter.

    Args:
        converter: what is behind the line.
        number: its address.
        clock: "lockstep", "line" or "realtime".
        baud: speed of the line [bit/s].
        errors: that the line makes, in both directions.
    """

    def __init__(
        self, converter: RegisterConverter, number: int, clock: str, baud: int, errors: LineErrors
    ) -> None:
        self.receiver = FrameReceiver()
        self.station = ModbusStation(number, converter, lambda: self.receiver.damaged)
        self.converter, self.errors, self.baud = converter, errors, baud
        self._silence = compute_silence(baud)
        self._bytes = self._silences = 0  # on the line since the machine's tick 0
        self._by_line = clock == "line"
        if clock == "lockstep":
            converter.on_commands = converter.answer_tick
        elif clock == "realtime":
            converter.on_commands = converter.offer_commands

    @property
    def time(self) -> int:
        """Time for which the line has been busy since the start [ns]."""
        return self._bytes * BITS_PER_BYTE * 10**9 // self.baud + self._silences * self._silence

    def exchange_bytes(self, data: bytes) -> bytes:
        """Return what comes back for the bytes that a master sends."""
        self._bytes += len(data)
        return self._answer_requests(self.receiver.take_bytes(self.errors.damage_bytes(data)))

    def note_silence(self) -> bytes:
        """Take note that the master has sent nothing for a while; return what comes back."""
        return (
            self._answer_requests(self.receiver.note_silence())
            if self.receiver.has_partial
            else b""
        )

    def _answer_requests(self, requests: list[bytes]) -> bytes:
        replies = b""
        for request in requests:
            self._silences += 1
            self._pass_periods()
            reply = self.station.answer_request(request)
            if reply:
                self._bytes += len(reply)
                self._silences += 1
                replies += self.errors.damage_bytes(reply)
        return replies

    def _pass_periods(self) -> None:
        """Let the servo periods pass that end up to now on the line."""
        if not self._by_line:
            return
        session = self.converter.session
        while (session.tick + 1) * session.period_ns <= self.time and session.fault is None:
            self.converter.pass_period()
