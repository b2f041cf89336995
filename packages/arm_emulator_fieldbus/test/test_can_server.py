"""The CAN bus that the CANopen nodes offer over TCP; strange things on it and on python-can's."""

from __future__ import annotations

import contextlib
import re
import socket
import threading
from collections.abc import Callable, Iterator
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from draws import some

from arm_emulator.base.refusal import Refusal
from arm_emulator_fieldbus import can_server
from arm_emulator_fieldbus.can_bus import BusService, PythonCanBus
from arm_emulator_fieldbus.can_server import LONGEST_LINE, MAX_CLIENTS, CanServer
from arm_emulator_fieldbus.canopen_node import CanFrame
from arm_emulator_fieldbus.commands.canopen import load_segment, open_requested_bus

DEVICE_TYPE = 0x00020192


@pytest.fixture(scope="module")
def server() -> Iterator[CanServer]:
    """The nodes of three_axis, served in a thread."""
    goes_on = threading.Event()
    goes_on.set()
    bus_server = CanServer(port=0)
    service = BusService(bus_server, load_segment("three_axis"), None)
    thread = threading.Thread(target=service.serve_nodes, args=(goes_on.is_set,))
    thread.start()
    yield bus_server
    goes_on.clear()
    thread.join()
    bus_server.close()


class Client:
    """A member of the bus that speaks socketcand's words by hand."""

    def __init__(self, server: CanServer) -> None:
        self.socket = socket.create_connection(server.address, timeout=20.0)
        self._unread = b""
        assert self.line() == "< hi >"
        for words in ("open arm", "rawmode"):
            self.send(f"< {words} >")
            assert self.line() == "< ok >", words

    def send(self, text: str) -> None:
        self.socket.sendall(text.encode("latin-1"))

    def line(self) -> str:
        while b">" not in self._unread:
            data = self.socket.recv(4096)
            assert data, "the server has hung up"
            self._unread += data
        line, _, self._unread = self._unread.partition(b">")
        return line.decode() + ">"

    def frame(self, number: int) -> bytes:
        """Data of the next frame with an identifier."""
        while True:
            words = self.line().split()
            if words[1] == "frame" and int(words[2], 16) == number:
                return bytes.fromhex(words[4] if len(words) == 6 else "")

    def device_type(self, node: int = 1) -> int:
        """0x1000, by SDO."""
        self.send(f"< send {0x600 + node:03X} 8 40 0 10 0 0 0 0 0 >")
        return int.from_bytes(self.frame(0x580 + node)[4:], "little")

    def __enter__(self) -> Client:
        return self

    def __exit__(self, *_: object) -> None:
        self.socket.close()


def test_a_member_reaches_nodes_and_further_members(server: CanServer) -> None:
    with Client(server) as first, Client(server) as second:
        assert [first.device_type(node) for node in (1, 2, 3)] == [DEVICE_TYPE] * 3
        second.frame(0x603)  # what one asks
        assert len(second.frame(0x583)) == 8, "and the answer"
        first.send("< send 123 3 1 a ff >< send 00000581 1 7 >< send 080 0 >")
        assert second.frame(0x123) == b"\x01\x0a\xff", "data as they are"
        line = second.line()
        assert line.startswith("< frame 00000581 ") and line.endswith(" 07 >"), "29 bits"
        assert second.frame(0x080) == b"", "no data"
        second.send("< echo >")
        assert second.line() == "< echo >"


def test_frames_that_come_early_wait_until_the_handshake_is_read(
    server: CanServer, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Clients read the reply to `rawmode` alone; what came with it would be taken for no reply."""
    with Client(server) as client, socket.create_connection(server.address, timeout=20.0) as late:

        def served() -> None:
            client.send("< echo >")
            assert client.line() == "< echo >", "the server has done what came before"

        served()
        monkeypatch.setattr(can_server, "SETTLING", 1e9)  # s: until the test lets them go
        assert late.recv(64) == b"< hi >"
        late.sendall(b"< open arm >")
        assert late.recv(64) == b"< ok >"
        late.sendall(b"< rawmode >")
        assert late.recv(64, socket.MSG_PEEK) == b"< ok >"
        served()
        client.send("< send 123 1 5 >")
        served()
        assert late.recv(64) == b"< ok >", "and no frame"
        for member in server._members.values():
            member.settled = 0.0
        client.send("< send 124 0 >")
        served()
        words = b""
        while words.count(b">") < 2:
            words += late.recv(64)
        assert re.fullmatch(rb"< frame 123 \S+ 05 >< frame 124 \S+  ?>", words), words


def test_it_listens_on_this_machine_only_by_default() -> None:
    with open_requested_bus("0", None, None, None) as (bus, name):
        assert isinstance(bus, CanServer)
        assert bus.address[0] == "127.0.0.1" and name.startswith("socketcand on 127.0.0.1:")
        taken = str(bus.address[1])
        with pytest.raises(Refusal, match=f"address 127.0.0.1:{taken} must be free, got Address"):
            with open_requested_bus(taken, None, None, None):
                pass
    with open_requested_bus("0.0.0.0:0", None, None, None) as (bus, _):
        assert isinstance(bus, CanServer) and bus.address[0] == "0.0.0.0"
    for listen in ("", "here", "127.0.0.1:", "1:99999", "127.0.0.1:-1", "no such host:1"):
        with pytest.raises(
            Refusal,
            match=r"canopen: (--listen must be \[HOST:\]PORT|--listen, port|address .* must be fr)",
        ):
            with open_requested_bus(listen, None, None, None):
                pass
    with pytest.raises(Refusal, match="canopen: channel must come with --bus, got can0"):
        with open_requested_bus("0", None, "can0", None):
            pass


def strange(rng: np.random.Generator) -> bytes:
    """Return a malformed message of a client."""
    kind = rng.integers(8)
    size = int(rng.integers(1, 3 * LONGEST_LINE))
    if kind == 0:
        return rng.bytes(size)
    if kind == 1:
        return bytes(rng.choice(list(b"<> send rawmode open 0123456789abcdefx-_.\n"), size))
    if kind == 2:
        return b"POST / HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n< open arm >< send 000 2 81 0 >"
    if kind == 3:
        return b"<" * size
    data = b" ".join(b"%x" % k for k in rng.bytes(int(kind)))
    head = b"< send %03X %X " % (int(rng.integers(0x1000)), int(rng.integers(12)))
    line = bytearray(head + data + b" >")
    for _ in range(rng.integers(4)):
        line[rng.integers(len(line))] = rng.integers(256)
    return bytes(line)


@pytest.mark.parametrize("seed", some(range(20), 2))
def test_a_member_that_sends_garbage_does_not_disturb_the_others(
    server: CanServer, seed: int
) -> None:
    rng = np.random.default_rng(seed)
    with Client(server) as client:
        for _ in range(100):
            odd = socket.create_connection(server.address, timeout=20.0)
            with odd, contextlib.suppress(ConnectionError):
                odd.sendall(b"< open arm >< rawmode >" * int(rng.integers(2)))
                for _ in range(rng.integers(1, 5)):
                    odd.sendall(strange(rng))
        client.send(
            "< send 000 2 81 0 >"
        )  # what it sent may have been a sound NMT: reset all nodes
        assert client.device_type() == DEVICE_TYPE
    assert server.ignored > 0, "counted"


def test_a_client_that_does_not_read_and_an_excess_client_are_dropped(server: CanServer) -> None:
    with Client(server) as client, Client(server) as deaf:
        for _ in range(60):
            deaf.send("< send 123 8 0 0 0 0 0 0 0 0 >" * 50)
            client.send("< send 601 8 40 0 10 0 0 0 0 0 >" * 50)
            for _ in range(50):
                client.frame(0x581)
        assert client.device_type() == DEVICE_TYPE
        more = [socket.create_connection(server.address, timeout=20.0) for _ in range(MAX_CLIENTS)]
        assert client.device_type() == DEVICE_TYPE
        assert any(late.recv(64) == b"" for late in more), "one too many is hung up on"
        for late in more:
            late.close()


# ------------------------------------------------------------------------------------- python-can


def message(**options: object) -> SimpleNamespace:
    plain = {
        "arbitration_id": 0x123, "data": b"\1", "is_extended_id": False, "is_error_frame": False,
        "is_fd": False, "is_remote_frame": False,
    }  # fmt: skip
    return SimpleNamespace(**{**plain, **options})


def bus_of(comes: Callable[[], object]) -> PythonCanBus:
    return PythonCanBus(SimpleNamespace(recv=lambda _timeout: comes()))


def test_messages_that_are_no_frames_are_counted() -> None:
    assert bus_of(message).receive(0.0) == CanFrame(0x123, b"\1")
    assert bus_of(lambda: None).receive(0.0) is None
    for fields in ({"arbitration_id": 1 << 11}, {"arbitration_id": -1}, {"arbitration_id": "x"},
                 {"data": bytes(9)}, {"data": "text"}, {"is_fd": True}):  # fmt: skip
        bus = bus_of(lambda fields=fields: message(**fields))  # type: ignore[misc]
        assert bus.receive(0.0) is None and bus.ignored == 1, fields

    def fails(cause: Exception) -> None:
        raise RuntimeError("could not unpack received message") from cause

    bus = bus_of(lambda: fails(ValueError("extra bytes")))
    assert bus.receive(0.0) is None and bus.ignored == 1
    with pytest.raises(Refusal, match="canopen: bus must stay open, got could not unpack"):
        bus_of(lambda: fails(OSError("network is down"))).receive(0.0)


def test_stray_datagrams_on_a_bus_by_udp_are_counted() -> None:
    can: Any = pytest.importorskip("can", reason="see requirements-peers.txt")
    msgpack: Any = pytest.importorskip("msgpack", reason="see requirements-peers.txt")
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    try:
        line = can.Bus(interface="udp_multicast", channel="239.74.163.9", port=port)
    except can.CanError as error:
        pytest.skip(f"no multicast here: {error}")
    rng = np.random.default_rng(1)
    sound: dict[str, object] = {
        "timestamp": 0.0, "arbitration_id": 0x123, "is_extended_id": False,
        "is_remote_frame": False, "is_error_frame": False, "channel": None, "dlc": 1,
        "data": b"\1", "is_fd": False, "bitrate_switch": False, "error_state_indicator": False,
    }  # fmt: skip
    odd = [None, "", -1, 1 << 63, 1.5, float("nan"), [1], {"a": 1}, b"\0" * 300, True, "0x12"]
    bus, sent = PythonCanBus(line), 0
    try:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as stranger:
            for k in range(300):
                changed = dict(sound)
                changed[str(rng.choice(list(changed)))] = odd[rng.integers(len(odd))]
                data = rng.bytes(int(rng.integers(60))) if k % 3 else msgpack.packb(changed)
                stranger.sendto(data, ("127.0.0.1", port))
                sent += 1
                frame = bus.receive(5.0)
                if frame is not None:
                    assert 0 <= frame.id < 1 << 11 and len(frame.data) <= 8
                    sent -= 1
            stranger.sendto(msgpack.packb(sound), ("127.0.0.1", port))
            assert bus.receive(5.0) == CanFrame(0x123, b"\1"), "a sound one is still taken"
    finally:
        line.shutdown()
    assert bus.ignored == sent, "every other one is counted"
