"""A small EtherCAT master for tests: frames into a segment of the same process, no sockets."""

import struct
from dataclasses import dataclass

import pytest

from arm_emulator import load_gains, load_scene
from arm_emulator.base.io.config_files import find_scene
from arm_emulator_fieldbus.ethercat import Segment

PERIOD = 1_000_000  # ns
NOP, APRD, APWR, APRW, FPRD, FPWR, FPRW, BRD, BWR, BRW, LRD, LWR, LRW, ARMW, FRMW = range(15)
INIT, PREOP, BOOT, SAFEOP, OP = 1, 2, 3, 4, 8
ERROR = ACKNOWLEDGE = 0x10
STATION = 0x1001  # of the first slave
MAILBOX = 128  # half of what slaves offer, so that more is cut into segments
HEADER = bytes.fromhex("ffffffffffff 020000000001 88a4")


def datagram(command: int, address: int, data: bytes, more: bool = False, **options: int) -> bytes:
    """One datagram; `address`: position or station in the low word, offset in the high one."""
    flags = len(data) | (0x8000 if more else 0) | options.get("flags", 0)
    return struct.pack("<BBIHH", command, 0, address, flags, 0) + data + b"\0\0"


def at(station: int, offset: int) -> int:
    return station & 0xFFFF | offset << 16


def frame(*datagrams: tuple[int, int, bytes]) -> bytes:
    chain = b"".join(
        datagram(*fields, more=k + 1 < len(datagrams)) for k, fields in enumerate(datagrams)
    )
    return HEADER + struct.pack("<H", len(chain) | 0x1000) + chain


def read_replies(back: bytes) -> list[tuple[bytes, int]]:
    """Data and working counter of each datagram of a frame."""
    out, place, more = [], 16, True
    while more:
        size = struct.unpack_from("<H", back, place + 6)[0]
        more, size = bool(size & 0x8000), size & 0x7FF
        data = back[place + 10 : place + 10 + size]
        out.append((data, struct.unpack_from("<H", back, place + 10 + size)[0]))
        place += 12 + size
    return out


class Aborted(Exception):
    """An SDO that the slave does not carry out; `code` states why."""

    def __init__(self, code: int) -> None:
        super().__init__(f"{code:#010x}")
        self.code = code


@dataclass
class Emergency:
    slave: int
    code: int


class Master:
    """A master of a segment whose slaves it finds at once."""

    def __init__(self, segment: Segment, mailbox: int = MAILBOX) -> None:
        self.segment = segment
        self.mailbox = mailbox  # bytes
        self.now = 0  # ns, of its clock
        self.slaves = self.one(BRD, 0, bytes(1))[1]
        for k in range(self.slaves):
            assert self.one(APWR, at(-k, 0x0010), struct.pack("<H", STATION + k))[1] == 1
        self.emergencies: list[Emergency] = []
        self._counter = [0] * self.slaves

    def send(self, *datagrams: tuple[int, int, bytes]) -> list[tuple[bytes, int]]:
        return read_replies(self.segment.frame(frame(*datagrams), self.now))

    def one(self, command: int, address: int, data: bytes) -> tuple[bytes, int]:
        return self.send((command, address, data))[0]

    def read(self, slave: int, offset: int, size: int) -> bytes:
        data, count = self.one(FPRD, at(STATION + slave, offset), bytes(size))
        assert count == 1, f"slave {slave} does not let {offset:#06x} be read"
        return data

    def write(self, slave: int, offset: int, data: bytes) -> int:
        return self.one(FPWR, at(STATION + slave, offset), data)[1]

    def word(self, slave: int, offset: int) -> int:
        return int(struct.unpack("<H", self.read(slave, offset, 2))[0])

    # ------------------------------------------------------------------------------- states

    def ask(self, slave: int, state: int) -> tuple[int, int]:
        """Ask for a state; return AL status and its code."""
        self.write(slave, 0x0120, struct.pack("<H", state))
        return self.word(slave, 0x0130), self.word(slave, 0x0134)

    def guard(self, slave: int, k: int, start: int, size: int, control: int, on: int = 1) -> None:
        self.write(slave, 0x0800 + 8 * k, struct.pack("<HHBBBB", start, size, control, 0, on, 0))

    def preop(self, slave: int) -> tuple[int, int]:
        self.ask(slave, INIT | ACKNOWLEDGE)
        for k in range(4):
            self.guard(slave, k, 0, 0, 0, 0)
        self.guard(slave, 0, 0x1000, self.mailbox, 0x26)
        self.guard(slave, 1, 0x1100, self.mailbox, 0x22)
        self._counter[slave] = 0
        return self.ask(slave, PREOP)

    def sizes(self, slave: int) -> tuple[int, int]:
        """Bytes of outputs and inputs."""
        out = []
        for assignment in (0x1C12, 0x1C13):
            bits = 0
            for k in range(self.number(slave, assignment, 0)):
                pdo = self.number(slave, assignment, k + 1)
                for sub in range(self.number(slave, pdo, 0)):
                    bits += self.number(slave, pdo, sub + 1) & 0xFF
            out.append(bits // 8)
        return out[0], out[1]

    def safeop(self, slave: int, logical: int) -> tuple[int, int]:
        """Map outputs, then inputs, from a logical address on; ask for SAFEOP."""
        out, into = self.sizes(slave)
        self.guard(slave, 2, 0x1200, out, 0x64)
        self.guard(slave, 3, 0x1500, into, 0x20)
        for k, (start, size, place, direction) in enumerate(
            ((logical, out, 0x1200, 2), (logical + out, into, 0x1500, 1))
        ):
            unit = struct.pack("<IHBBHBBB3x", start, size, 0, 7, place, 0, direction, 1)
            self.write(slave, 0x0600 + 16 * k, unit)
        return self.ask(slave, SAFEOP)

    def bring_up(self) -> None:
        """All slaves to OP, alike in what they map."""
        for k in range(self.slaves):
            assert self.preop(k) == (PREOP, 0), f"slave {k} does not reach PREOP"
        self.out, self.into = self.sizes(0)
        for k in range(self.slaves):
            status = self.safeop(k, 0x10000 + k * (self.out + self.into))
            assert status == (SAFEOP, 0), f"slave {k} does not reach SAFEOP: {status}"
        for k in range(self.slaves):
            assert self.ask(k, OP) == (OP, 0), f"slave {k} does not reach OP"

    def exchange(self, outputs: list[bytes]) -> list[bytes]:
        """Process data of all slaves by one LRW."""
        data = b"".join(output + bytes(self.into) for output in outputs)
        back, count = self.one(LRW, 0x10000, data)
        self.count = count
        each = self.out + self.into
        return [back[k * each + self.out : (k + 1) * each] for k in range(self.slaves)]

    # -------------------------------------------------------------------------------- mailbox

    def mail(self, slave: int, body: bytes, kind: int = 3, size: int | None = None) -> int:
        self._counter[slave] = self._counter[slave] % 7 + 1
        size = len(body) if size is None else size
        head = struct.pack("<HHBB", size, 0, 0, kind | self._counter[slave] << 4)
        return self.write(slave, 0x1000, (head + body).ljust(self.mailbox, b"\0"))

    def fetch(self, slave: int) -> tuple[int, bytes] | None:
        """Kind and body of the next message, emergencies put aside; None: no message."""
        while True:
            data, count = self.one(FPRD, at(STATION + slave, 0x1100), bytes(self.mailbox))
            if count == 0:
                return None
            size, kind = struct.unpack_from("<H", data)[0], data[5] & 15
            body = data[6 : 6 + size]
            if kind == 3 and body[1] >> 4 == 1:
                code = struct.unpack_from("<H", body, 2)[0]
                self.emergencies.append(Emergency(slave, code))
                continue
            return kind, body

    def coe(self, slave: int, service: int, body: bytes) -> bytes:
        """A request and its reply, without the header of CoE."""
        assert self.mail(slave, struct.pack("<H", service << 12) + body) == 1, "mailbox is full"
        answer = self.fetch(slave)
        assert answer is not None and answer[0] == 3, f"no answer of CoE, but {answer}"
        return answer[1][2:]

    def sdo(self, slave: int, body: bytes) -> bytes:
        reply = self.coe(slave, 2, body.ljust(8, b"\0"))
        if reply[0] == 0x80:
            raise Aborted(struct.unpack_from("<I", reply, 4)[0])
        return reply

    def upload(self, slave: int, index: int, sub: int = 0, complete: bool = False) -> bytes:
        reply = self.sdo(slave, struct.pack("<BHB", 0x40 | complete << 4, index, sub))
        if reply[0] & 2:
            return reply[4 : 8 - (reply[0] >> 2 & 3)]
        size = struct.unpack_from("<I", reply, 4)[0]
        data, toggle = reply[8:], 0
        while len(data) < size:
            reply = self.sdo(slave, bytes([0x60 | toggle]))
            assert reply[0] >> 4 & 1 == toggle >> 4, "segments do not alternate"
            unused = reply[0] >> 1 & 7 if len(reply) == 8 else 0
            data += reply[1 : len(reply) - unused]
            toggle ^= 0x10
            assert bool(reply[0] & 1) == (len(data) == size), "the last segment is not the last"
        return data

    def download(
        self, slave: int, index: int, sub: int, data: bytes, complete: bool = False, part: int = 112
    ) -> None:
        """In segments of `part` bytes where it is too long for one message."""
        ca = complete << 4
        if len(data) <= 4 and data:
            command = 0x23 | ca | (4 - len(data)) << 2
            self.sdo(slave, struct.pack("<BHB", command, index, sub) + data)
            return
        head = struct.pack("<BHBI", 0x21 | ca, index, sub, len(data))
        self.sdo(slave, head + data[:part])
        toggle, place = 0, min(part, len(data))
        while place < len(data):
            piece = data[place : place + part]
            place += len(piece)
            unused = max(0, 7 - len(piece)) << 1
            self.sdo(slave, bytes([toggle | unused | (place == len(data))]) + piece.ljust(7, b"\0"))
            toggle ^= 0x10

    def number(self, slave: int, index: int, sub: int = 0) -> int:
        return int.from_bytes(self.upload(slave, index, sub), "little")

    def information(self, slave: int, opcode: int, body: bytes) -> bytes:
        """A service of SDO information; the bodies of all messages of the reply."""
        reply = self.coe(slave, 8, struct.pack("<BBH", opcode, 0, 0) + body)
        out = b""
        while True:
            if reply[0] & 0x7F == 7:
                raise Aborted(struct.unpack_from("<I", reply, 4)[0])
            assert reply[0] & 0x7F == opcode + 1, "another service answers"
            out += reply[4:]
            left = struct.unpack_from("<H", reply, 2)[0]
            assert bool(reply[0] & 0x80) == (left > 0), "fragments left are reported wrongly"
            if not left:
                return out
            answer = self.fetch(slave)
            assert answer is not None, "a fragment is missing"
            reply = answer[1][2:]


def segment(lockstep: bool = True) -> Segment:
    path = find_scene("three_axis")
    return Segment(load_scene(path), load_gains(path).servo, lockstep)


@pytest.fixture
def master() -> Master:
    return Master(segment())
