"""One drive as a CANopen node: frames in, frames out (CiA 301). No bus, and no clock of its own.

The drive's dictionary, state machine and SDO server are those of core/drives.h; this file adds NMT,
PDOs, SYNC, EMCY and heartbeat.
"""

import enum
import struct
from dataclasses import dataclass, field

from arm_emulator_fieldbus.drives import Drives
from arm_emulator_fieldbus.drives_unit import CANOPEN
from arm_emulator_fieldbus.object_dictionary import Aborted, list_entries

LARGEST_NODE = 127
PDOS = 4  # of each way
US, MS = 1_000, 1_000_000  # ns

# Error codes of messages about the bus itself.
LOST, TOO_SHORT, NOT_TAKEN, STOPPED_BY_MASTER = 0x8130, 0x8210, 0x8200, 0x8100
NO_SYNC, NO_DATA = 0x8700, 0x8250
INVALID, NO_REMOTE = 1 << 31, 1 << 30  # bits of a COB-ID
ASYNCHRONOUS = (254, 255)  # transmission types
SYNC_TOLERANCE = 1.5  # periods of SYNC after which a node misses it


@dataclass(frozen=True, slots=True)
class CanFrame:
    """A CAN frame with an identifier of 11 bits."""

    id: int
    data: bytes = b""
    remote: bool = False


class NmtState(enum.IntEnum):
    """NMT state of the node, as heartbeats report it."""

    BOOT = 0
    STOPPED = 4
    OPERATIONAL = 5
    PRE_OPERATIONAL = 127


@dataclass(slots=True)
class _Pdo:
    """A process data object with its present settings."""

    id: int  # -1: none
    remote: bool  # whether it may be asked for
    type: int
    places: list[tuple[int, int, int]]  # index, sub, bytes; index below 8: bytes without a meaning
    inhibit: int = 0  # ns
    timer: int = 0  # ns, within which it is sent, or must be received
    length: int = field(init=False)
    # State of its transfer.
    waiting: bytes | None = field(default=None, compare=False)  # received, for the next SYNC
    received_at: int | None = field(default=None, compare=False)
    sent: bytes | None = field(default=None, compare=False)
    sent_at: int = field(default=0, compare=False)
    count: int = field(default=0, compare=False)  # SYNCs since it was sent

    def __post_init__(self) -> None:
        self.length = sum(size for *_, size in self.places)


class Node:
    """A CANopen node with a drive behind it.

    Attributes:
        number: its node-ID.
        sync_period: time between SYNCs (0x1006) [ns]; 0: unknown.
        beat: time between heartbeats [ns]; 0: none.

    Args:
        drives: all drives of the machine.
        drive: which one this node is.
        number: 1 to 127.
        lockstep: whether time waits for SYNC, so that no message comes too late after one.
        sync_period: of SYNC at the start (0x1006) [us]; 0: unknown.
    """

    def __init__(
        self,
        drives: Drives,
        drive: int,
        number: int,
        *,
        lockstep: bool = False,
        sync_period: int = 0,
    ) -> None:
        self.number = number
        self._drives, self._drive = drives, drive
        self._lockstep, self._first_sync_period = lockstep, sync_period
        self.state = NmtState.BOOT
        self._toggle = 0  # of node guarding
        self._beat_at: int | None = None  # when the last heartbeat was sent
        self._heard_at: int | None = None  # when that of the watched node came
        self._guarded_at: int | None = None  # when the master has last guarded this node
        self._synced_at: int | None = None  # when the last SYNC came
        self._error = 0  # reported last
        self._bad_pdo = False
        self._consumed_heartbeat = (0, 0)  # node, and time between its heartbeats [ns]
        self._receives: list[_Pdo] = []
        self._sends: list[_Pdo] = []
        self._set_defaults()
        # Values after a reset of the communication.
        self._defaults = {
            (entry.index, entry.sub): drives.read(drive, entry.index, entry.sub)
            for entry in list_entries()
            if entry.buses & CANOPEN and 0x1005 <= entry.index < 0x2000 and entry.access == "rw"
            if entry.index not in (0x1010, 0x1011)
        }
        self._read_settings()

    @property
    def state(self) -> NmtState:
        """NMT state; PDOs in use in operational keep their mapping."""
        return self._state

    @state.setter
    def state(self, state: NmtState) -> None:
        self._state = state
        self._drives.lock_mapping(state is NmtState.OPERATIONAL, self._drive)

    # ------------------------------------------------------------------------- the dictionary

    def upload_entry(self, index: int, sub: int) -> bytes:
        """Return the bytes of an entry; raise `Aborted`."""
        return self._drives.upload_entry(self._drive, index, sub)

    def _read_number(self, index: int, sub: int) -> int:
        return int.from_bytes(self._drives.upload_entry(self._drive, index, sub), "little")

    def _set_defaults(self) -> None:
        """Set what depends on the node-ID; targets go with SYNC, the controlword at once.

        The statusword is sent on change, and at least every 10 ms: masters of `canopen` treat a PDO
        received twice as periodic, and wait for it.
        """
        own = {(0x1014, 0): 0x80, (0x1200, 1): 0x600, (0x1200, 2): 0x580}
        for k in range(PDOS):
            own[0x1400 + k, 1] = 0x200 + 0x100 * k
            own[0x1800 + k, 1] = 0x180 + 0x100 * k
            if k:
                self._drives.set_entry(self._drive, 0x1400 + k, 1, 2)
                self._drives.set_entry(self._drive, 0x1800 + k, 1, 2)
        self._drives.set_entry(self._drive, 0x1800, 10, 5)
        for (index, sub), base in own.items():
            self._drives.set_entry(self._drive, index, base + self.number, sub)
        self._drives.set_entry(self._drive, 0x1006, self._first_sync_period)

    def _read_settings(self) -> None:
        """Take the settings of the communication from the dictionary."""
        self._configured = self._drives.count_communication_writes(self._drive)
        self._sync_id = self._read_number(0x1005, 0) & 0x7FF
        emergency = self._read_number(0x1014, 0)
        self._emergency_id = None if emergency & INVALID else emergency & 0x7FF
        self.beat = self._read_number(0x1017, 0) * MS
        self._life = self._read_number(0x100C, 0) * self._read_number(0x100D, 0) * MS
        self.sync_period, self._window = (
            self._read_number(index, 0) * US for index in (0x1006, 0x1007)
        )
        self._drives.set_cycle(self._drive, self.sync_period)
        heartbeat = self._read_number(0x1016, 1)
        before = self._consumed_heartbeat
        self._consumed_heartbeat = (heartbeat >> 16 & 0x7F, (heartbeat & 0xFFFF) * MS)
        if self._consumed_heartbeat != before:
            self._heard_at = None
        for pdos, first in ((self._receives, 0x1400), (self._sends, 0x1800)):
            new = [self._read_pdo(first + k, first + 0x200 + k) for k in range(PDOS)]
            # A PDO with unchanged settings keeps its waiting data.
            pdos[:] = [
                old if old == pdo else pdo for old, pdo in zip(pdos or new, new, strict=True)
            ]

    def _read_pdo(self, communication: int, mapping: int) -> _Pdo:
        cob = self._read_number(communication, 1)
        words = (self._read_number(mapping, k + 1) for k in range(self._read_number(mapping, 0)))
        places = [(word >> 16, word >> 8 & 0xFF, (word & 0xFF) // 8) for word in words]
        is_used = places and not cob & INVALID
        pdo = _Pdo(
            cob & 0x7FF if is_used else -1,
            not cob & NO_REMOTE,
            self._read_number(communication, 2),
            places,
        )
        pdo.inhibit = self._read_number(communication, 3) * 100_000
        pdo.timer = self._read_number(communication, 5) * MS
        return pdo

    # ---------------------------------------------------------------------------------- frames

    def boot_node(self) -> list[CanFrame]:
        """Start up: send the boot message and enter pre-operational."""
        self.state = NmtState.PRE_OPERATIONAL
        self._toggle = 0
        self._beat_at = self._heard_at = self._guarded_at = None
        self._drives.begin_sdo(self._drive)
        return [CanFrame(0x700 + self.number, bytes((NmtState.BOOT,)))]

    def receive_frame(self, frame: CanFrame, now: int) -> list[CanFrame]:
        """Take a frame other than SYNC, and return what the node sends.

        Args:
            frame: from the bus.
            now: logical time [ns].
        """
        id_ = frame.id
        if frame.remote:
            return self._answer_request(id_, now)
        if id_ == 0:
            return self._handle_nmt(frame.data, now)
        if id_ == 0x600 + self.number:
            if self.state is NmtState.STOPPED or self.state is NmtState.BOOT:
                return []
            return self._serve_sdo(frame.data)
        if id_ == 0x700 + self._consumed_heartbeat[0] and self._consumed_heartbeat[1]:
            self._heard_at = now
        if self.state is NmtState.OPERATIONAL:
            return self._receive_data(frame, now)
        return []

    def is_sync(self, frame: CanFrame) -> bool:
        """Return whether a frame is SYNC to this node."""
        return frame.id == self._sync_id and not frame.remote and len(frame.data) <= 1

    def handle_sync(self, now: int) -> list[CanFrame]:
        """Take a SYNC: received data takes effect, and present data is sent."""
        if self.state is not NmtState.OPERATIONAL:
            return []
        self._synced_at = now
        frames = []
        for pdo in self._receives:
            if pdo.waiting is not None:
                data, pdo.waiting = pdo.waiting, None
                frames += self._unpack_pdo(pdo, data)
        for pdo in self._sends:
            if pdo.id < 0 or pdo.type in (*ASYNCHRONOUS, 253):
                continue
            data = self._pack_pdo(pdo)
            pdo.count += 1
            if pdo.type == 252:
                pdo.sent = data
            elif pdo.count >= pdo.type and (pdo.type or data != pdo.sent):
                frames.append(self._send_pdo(pdo, data, now))
        return frames

    def finish_period(self, now: int) -> list[CanFrame]:
        """Return what the node sends on its own after a servo period."""
        frames = self._monitor_messages(now)
        code = self._read_number(0x603F, 0)
        if code != self._error:
            self._error = code
            frames += self._report_emergency(code)
        if self.state is NmtState.OPERATIONAL:
            frames += self._send_events(now)
        return frames

    def send_heartbeat(self, now: int) -> list[CanFrame]:
        """Return the heartbeat if it is due at a time [ns] of the bus's clock."""
        if not self.beat or self.state is NmtState.BOOT:
            return []
        if self._beat_at is not None and now - self._beat_at < self.beat:
            return []
        late = self._beat_at is not None and now - self._beat_at < 2 * self.beat
        self._beat_at = (self._beat_at or 0) + self.beat if late else now
        return [CanFrame(0x700 + self.number, bytes((self.state,)))]

    # --------------------------------------------------------------------------------- details

    def _serve_sdo(self, request: bytes) -> list[CanFrame]:
        """SDO."""
        if len(request) != 8:
            return []
        replies = self._drives.serve_sdo(self._drive, request)
        if self._drives.count_communication_writes(self._drive) != self._configured:
            self._read_settings()
        return [CanFrame(0x580 + self.number, reply) for reply in replies]

    def _handle_nmt(self, data: bytes, now: int) -> list[CanFrame]:
        """NMT."""
        if len(data) != 2 or data[1] not in (0, self.number):
            return []
        match data[0]:
            case 1 if self.state is not NmtState.OPERATIONAL:
                self.state = NmtState.OPERATIONAL
                self._synced_at = None
                for pdo in (*self._receives, *self._sends):
                    pdo.waiting = pdo.sent = pdo.received_at = None
                    pdo.count = 0
                return self._send_events(now)
            case 2:
                self._stop_node()
            case 128:
                self.state = NmtState.PRE_OPERATIONAL
            case 129:
                self._drives.restart_drive(self._drive)
                self._set_defaults()
                return self._restart_node()
            case 130:
                self._stop_node()
                self._restore_communication()
                return self._restart_node()
        return []

    def _restart_node(self) -> list[CanFrame]:
        self._read_settings()
        self._error, self._bad_pdo = 0, False
        return self.boot_node()

    def _stop_node(self) -> None:
        if self.state is NmtState.OPERATIONAL:
            self._drives.report_loss(self._drive, STOPPED_BY_MASTER)
        self.state = NmtState.STOPPED
        self._drives.begin_sdo(self._drive)

    def _restore_communication(self) -> None:
        for (index, sub), value in self._defaults.items():
            self._drives.set_entry(self._drive, index, value, sub)

    def _answer_request(self, id_: int, now: int) -> list[CanFrame]:
        """Remote frames: node guarding, and PDOs."""
        if id_ == 0x700 + self.number and not self.beat and self.state is not NmtState.BOOT:
            self._guarded_at = now
            reported = self._toggle | self.state
            self._toggle ^= 0x80
            return [CanFrame(id_, bytes((reported,)))]
        if self.state is not NmtState.OPERATIONAL:
            return []
        for pdo in self._sends:
            if pdo.id == id_ and pdo.remote:
                data = pdo.sent if pdo.type == 252 else self._pack_pdo(pdo)
                return [CanFrame(id_, data)] if data is not None else []
        return []

    def _receive_data(self, frame: CanFrame, now: int) -> list[CanFrame]:
        frames = []
        for pdo in self._receives:
            if pdo.id != frame.id or (pdo.type not in ASYNCHRONOUS and self._is_late(now)):
                continue
            if len(frame.data) < pdo.length:
                frames += self._report_emergency(TOO_SHORT)
                continue
            pdo.received_at = now
            if pdo.type in ASYNCHRONOUS:
                frames += self._unpack_pdo(pdo, frame.data)
            else:
                pdo.waiting = frame.data
        return frames

    def _unpack_pdo(self, pdo: _Pdo, data: bytes) -> list[CanFrame]:
        at, bad = 0, False
        for index, sub, size in pdo.places:
            if index >= 8:
                try:
                    self._drives.download_entry(self._drive, index, sub, data[at : at + size])
                except Aborted:
                    bad = True
            at += size
        reported = self._report_emergency(NOT_TAKEN) if bad and not self._bad_pdo else []
        self._bad_pdo = bad
        return reported

    def _pack_pdo(self, pdo: _Pdo) -> bytes:
        upload, drive = self._drives.upload_entry, self._drive
        return b"".join(
            upload(drive, index, sub) if index >= 8 else bytes(size)
            for index, sub, size in pdo.places
        )

    def _send_pdo(self, pdo: _Pdo, data: bytes, now: int) -> CanFrame:
        pdo.sent, pdo.sent_at, pdo.count = data, now, 0
        return CanFrame(pdo.id, data)

    def _send_events(self, now: int) -> list[CanFrame]:
        frames = []
        for pdo in self._sends:
            if pdo.id < 0 or pdo.type not in ASYNCHRONOUS:
                continue
            passed = now - pdo.sent_at
            if pdo.sent is not None and passed < pdo.inhibit:
                continue
            data = self._pack_pdo(pdo)
            if data != pdo.sent or (pdo.timer and passed >= pdo.timer):
                frames.append(self._send_pdo(pdo, data, now))
        return frames

    def _is_late(self, now: int) -> bool:
        """Return whether the window for synchronous data after SYNC (0x1007) has passed."""
        return not self._lockstep and _has_expired(self._synced_at, self._window, now)

    def _monitor_messages(self, now: int) -> list[CanFrame]:
        """Check what comes periodically; each loss is reported once, until the next message."""
        frames: list[CanFrame] = []
        if _has_expired(self._heard_at, self._consumed_heartbeat[1], now):
            self._heard_at = None
            frames += self._handle_master_loss()
        if _has_expired(self._guarded_at, self._life, now):
            self._guarded_at = None
            frames += self._handle_master_loss()
        if self.state is not NmtState.OPERATIONAL:
            return frames
        if _has_expired(self._synced_at, int(SYNC_TOLERANCE * self.sync_period), now):
            self._synced_at = None
            frames += self._report_loss(NO_SYNC)
        for pdo in self._receives:
            if _has_expired(pdo.received_at, pdo.timer, now):
                pdo.received_at = None
                frames += self._report_loss(NO_DATA)
        return frames

    def _handle_master_loss(self) -> list[CanFrame]:
        """Take the loss of heartbeats or guarding, after which 0x1029 selects the state."""
        frames = self._report_loss(LOST)
        if self.state is NmtState.OPERATIONAL:
            match self._read_number(0x1029, 1):
                case 0:
                    self.state = NmtState.PRE_OPERATIONAL
                case 2:
                    self.state = NmtState.STOPPED
                    self._drives.begin_sdo(self._drive)
        return frames

    def _report_loss(self, code: int) -> list[CanFrame]:
        """Report a loss to the drive, which reacts as 0x6007 selects, and by EMCY."""
        self._drives.report_loss(self._drive, code)
        reported = self._report_emergency(code)
        self._error = self._read_number(0x603F, 0)
        return reported

    def _report_emergency(self, code: int) -> list[CanFrame]:
        if self._emergency_id is None or self.state in (NmtState.STOPPED, NmtState.BOOT):
            return []
        register = self._read_number(0x1001, 0)
        return [CanFrame(self._emergency_id, struct.pack("<HB5x", code, register))]


def _has_expired(since: int | None, time: int, now: int) -> bool:
    """Return whether more than a time [ns] has passed since a message; 0: it is not monitored."""
    return since is not None and 0 < time < now - since
