"""A CAN bus over TCP, by the protocol of socketcand: each client is on the bus with our nodes.

Lines are texts between angle brackets: ``< open NAME >``, ``< rawmode >``, then one way
``< send 601 2 40 0 >`` (identifier, count, data; hexadecimal) and the other way
``< frame 581 1.5 4000 >`` (identifier, seconds, data).
"""

from __future__ import annotations

import contextlib
import selectors
import socket
import time
from collections import deque

from arm_emulator.extension.base import refuse_taken_address
from arm_emulator_fieldbus.canopen_node import CanFrame

PORT = 29536  # of socketcand
MAX_CLIENTS = 64
LONGEST_LINE = 256  # bytes
MAX_UNSENT = 1 << 20  # bytes, for a client that does not read
SETTLING = 0.05  # s, in which a new client reads the replies to its first lines
_OK = b"< ok >"


class CanServer:
    """A bus whose members are TCP connections and this process.

    Frames of a member go to all others. Bytes that are no frame are answered with an error and
    counted; a client that sends anything but lines is dropped.

    Attributes:
        address: host and port where it listens.
        ignored: lines that were no frame and no command, and members that did not speak in lines.

    Args:
        host: of the interface that it listens on.
        port: 0: any that is free.

    Raises:
        Refusal: it cannot listen there.
    """

    def __init__(self, host: str = "127.0.0.1", port: int = PORT) -> None:
        self._listening = socket.socket()
        try:
            self._listening.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            self._listening.bind((host, port))
            self._listening.listen(MAX_CLIENTS)
        except (OSError, OverflowError) as error:
            self._listening.close()
            raise refuse_taken_address("canopen", host, port, error) from None
        self._listening.setblocking(False)
        self.address: tuple[str, int] = self._listening.getsockname()
        self.ignored = 0
        self._arrived: deque[CanFrame] = deque()
        self._selector = selectors.DefaultSelector()
        self._selector.register(self._listening, selectors.EVENT_READ)
        self._members: dict[int, _Member] = {}

    def close(self) -> None:
        """End all connections."""
        for member in list(self._members.values()):
            self._drop_client(member)
        self._selector.close()
        self._listening.close()

    def receive(self, timeout: float) -> CanFrame | None:
        """Return the next frame, None if none comes in time [s]."""
        until = time.monotonic() + timeout
        while not self._arrived:
            left = until - time.monotonic()
            self._wait_events(min([max(left, 0.0), *self._list_settling()]))
            if left <= 0.0:
                break
        return self._arrived.popleft() if self._arrived else None

    def send(self, frame: CanFrame) -> None:
        """Send a frame to all members."""
        self._broadcast_line(_format_frame(frame.id, frame.data), None)

    # ---------------------------------------------------------------------------------- members

    def _list_settling(self) -> list[float]:
        """Return how long new clients must still wait for frames [s]."""
        now = time.monotonic()
        return [max(value.settled - now, 0.0) for value in self._members.values() if value.waiting]

    def _wait_events(self, timeout: float) -> None:
        for key, events in self._selector.select(timeout):
            if key.fileobj is self._listening:
                self._accept_client()
                continue
            if events & selectors.EVENT_READ and key.fd in self._members:
                self._read_lines(self._members[key.fd])
            if events & selectors.EVENT_WRITE and key.fd in self._members:
                self._write_unsent(self._members[key.fd])
        now = time.monotonic()
        for member in list(self._members.values()):
            if member.waiting and member.settled <= now:
                member.unsent += member.waiting
                member.waiting.clear()
                self._write_unsent(member)

    def _accept_client(self) -> None:
        try:
            connection, _ = self._listening.accept()
        except OSError:  # it has gone again
            return
        if len(self._members) >= MAX_CLIENTS:
            connection.close()
            return
        connection.setblocking(False)
        connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        member = _Member(connection)
        self._members[connection.fileno()] = member
        self._selector.register(connection, selectors.EVENT_READ)
        self._answer_client(member, b"< hi >")

    def _drop_client(self, member: _Member) -> None:
        if self._members.pop(member.connection.fileno(), None) is not None:
            self._selector.unregister(member.connection)
            member.connection.close()

    def _read_lines(self, member: _Member) -> None:
        try:
            data = member.connection.recv(4096)
        except BlockingIOError:
            return
        except OSError:
            data = b""
        if not data:
            self._drop_client(member)
            return
        with contextlib.suppress(OSError):  # or a client's next frame would wait for our next one
            member.connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_QUICKACK, 1)
        *lines, rest = (member.unread + data).split(b">")
        member.unread = rest
        for line in lines:
            if member.connection.fileno() >= 0:
                self._take_line(member, line)
        if len(rest) > LONGEST_LINE or rest.lstrip()[:1] not in (b"", b"<"):
            self._drop_wrong_protocol(member)

    def _take_line(self, member: _Member, line: bytes) -> None:
        head, _, text = line.partition(b"<")
        words = text.split() or [b""]
        if head.strip() or len(text) > LONGEST_LINE:
            self._drop_wrong_protocol(member)
            return
        match words[0]:
            case b"open" if len(words) == 2:
                member.opened = True
                self._answer_client(member, _OK)
            case b"rawmode" if member.opened:
                self._answer_client(member, _OK)
                member.listens = True
                member.settled = time.monotonic() + SETTLING
            case b"echo":
                self._answer_client(member, b"< echo >")
            case b"send" if member.opened:
                self._take_frame(member, words[1:])
            case _:
                self._ignore_command(member)

    def _take_frame(self, member: _Member, words: list[bytes]) -> None:
        """Take ``IDENTIFIER LENGTH BYTE ...``: three digits, or eight for one of 29 bits."""
        try:
            number, *data = (int(word, 16) for word in [words[0], *words[2:]])
            short = len(words[0]) == 3
            bytes_ = bytes(data)
            sound = len(words[0]) in (3, 8) and int(words[1], 16) == len(bytes_) <= 8
            sound = sound and 0 <= number < 1 << (11 if short else 29)
        except (ValueError, IndexError):
            sound = False
        if not sound:
            self._ignore_command(member)
            return
        if short:
            self._arrived.append(CanFrame(number, bytes_))
        self._broadcast_line(_format_frame(number, bytes_, 3 if short else 8), member)

    def _drop_wrong_protocol(self, member: _Member) -> None:
        """Drop a client of another protocol, such as a browser."""
        self.ignored += 1
        self._drop_client(member)

    def _ignore_command(self, member: _Member) -> None:
        self.ignored += 1
        self._answer_client(member, b"< error unknown command >")

    def _broadcast_line(self, line: bytes, sender: _Member | None) -> None:
        for member in list(self._members.values()):
            if member is not sender and member.listens:
                self._answer_client(member, line)

    def _answer_client(self, member: _Member, line: bytes) -> None:
        if member.connection.fileno() < 0:
            return
        if member.waiting or time.monotonic() < member.settled:  # no frame passes those before it
            member.waiting += line
        else:
            member.unsent += line
            self._write_unsent(member)
        if len(member.waiting) + len(member.unsent) > MAX_UNSENT:
            self._drop_client(member)

    def _write_unsent(self, member: _Member) -> None:
        try:
            while member.unsent:
                del member.unsent[: member.connection.send(member.unsent)]
        except BlockingIOError:
            pass
        except OSError:
            self._drop_client(member)
            return
        if bool(member.unsent) != member.waits:
            member.waits = not member.waits
            events = selectors.EVENT_READ | (selectors.EVENT_WRITE if member.waits else 0)
            self._selector.modify(member.connection, events)


class _Member:
    """A connection with its input and output buffers."""

    def __init__(self, connection: socket.socket) -> None:
        self.connection = connection
        self.unread = b""
        self.unsent, self.waiting = bytearray(), bytearray()
        self.opened = self.listens = False
        self.waits = False  # for room to write
        self.settled = 0.0  # monotonic time [s], until which frames are held


def _format_frame(number: int, data: bytes, digits: int = 3) -> bytes:
    return f"< frame {number:0{digits}X} {time.time():.6f} {data.hex().upper()} >".encode()
