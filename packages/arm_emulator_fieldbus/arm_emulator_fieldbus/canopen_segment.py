"""All drives of a machine as nodes on one CAN bus: frames in, frames out, and servo periods."""

from arm_emulator.extension.base import Refusal
from arm_emulator.extension.machine import Diverged
from arm_emulator_fieldbus.canopen_node import LARGEST_NODE, CanFrame, Node
from arm_emulator_fieldbus.drives import Drives

# Objects in a request of SDO: time between SYNCs, interpolation time.
_TIMES = (bytes([0x06, 0x10]), bytes([0xC2, 0x60]))
LONGEST_SYNC_PERIOD = (1 << 32) - 1  # us


class CanSegment:
    """Nodes of all joints, base to tool, with node-IDs in a row.

    In lock-step each SYNC stands for the time between SYNCs (0x1006), the shortest of those that
    nodes have, or for a servo period. Targets received before it hold from its beginning on, and
    what nodes send with it is what there was then. Else the owner calls `pass_period`.

    Attributes:
        scene: the machine.
        drives: their object dictionaries.
        nodes: one per joint.
        fault: why the machine stays where it is; None if it goes on.
        notices: what was set of times that do not fit each other, in words.

    Args:
        drives: of a machine, made for CANopen.
        first: node-ID of the first joint.
        lockstep: whether SYNC lets time pass.
        sync_period: time between SYNCs (0x1006) that nodes have at the start [s]; 0: unknown.

    Raises:
        Refusal: there are not so many node-IDs, or no such time.
    """

    def __init__(
        self, drives: Drives, first: int = 1, *, lockstep: bool = True, sync_period: float = 0.0
    ) -> None:
        self.scene = scene = drives.plant.scene
        largest = LARGEST_NODE + 1 - len(scene.joints)
        if not 1 <= first <= largest:
            raise Refusal("canopen", "first node-ID", f"be 1 to {largest}", first)
        longest = 1e-6 * LONGEST_SYNC_PERIOD
        if not 0.0 <= sync_period <= longest:
            raise Refusal("canopen", "sync period", f"be 0 to {longest:g} [s]", sync_period)
        self.drives = drives
        self._lockstep = lockstep
        self._period = round(scene.servo_period * 1e9)
        us = round(1e6 * sync_period)
        self.nodes = [
            Node(drives, k, first + k, lockstep=lockstep, sync_period=us)
            for k in range(len(scene.joints))
        ]
        self.fault: Diverged | None = None
        self.notices: list[str] = []
        # Nodes whose times were written since the last SYNC.
        self._written = {node.number for node in self.nodes} if us else set[int]()
        self._noticed: dict[int, str] = {}  # the last notice on each node

    @property
    def tick(self) -> int:
        """Number of servo periods so far."""
        return self.drives.tick

    @property
    def now(self) -> int:
        """Logical time [ns]."""
        return self.tick * self._period

    def boot_nodes(self) -> list[CanFrame]:
        """Start up, and return the frames sent."""
        return [frame for node in self.nodes for frame in node.boot_node()]

    def receive_frame(self, frame: CanFrame) -> list[CanFrame]:
        """Take a frame from the bus, and return the frames sent."""
        now, frames, synced = self.now, [], False
        for node in self.nodes:
            if node.is_sync(frame):
                synced = True
                frames += node.handle_sync(now)
            else:
                frames += node.receive_frame(frame, now)
                if frame.id == 0x600 + node.number and frame.data[1:3] in _TIMES:
                    self._written.add(node.number)
        if synced and self._lockstep:
            periods = self.periods_per_sync
            self._compare_times(periods)
            for _ in range(periods):
                frames += self.pass_period()
        return frames

    @property
    def periods_per_sync(self) -> int:
        """Number of servo periods that a SYNC stands for in lock-step."""
        shortest = min((node.sync_period for node in self.nodes if node.sync_period), default=0)
        return max(1, (2 * shortest + self._period) // (2 * self._period))

    def _compare_times(self, periods: int) -> None:
        """Note times written since the last SYNC that do not fit the time it stands for."""
        for drive, node in enumerate(self.nodes):
            if node.number not in self._written:
                continue
            targets, notice = self.drives.count_periods_per_target(drive), ""
            if node.sync_period and node.sync_period != periods * self._period:
                own = node.sync_period / self._period
                notice = f"0x1006 is {own:g} servo periods: SYNC stands for {periods}"
            elif targets != periods:
                notice = (
                    f"0x60C2 is {targets} servo periods, and SYNC stands for {periods} (0x1006)"
                )
            if notice and notice != self._noticed.get(node.number):
                self.notices.append(f"node {node.number}: {notice}")
            self._noticed[node.number] = notice
        self._written.clear()

    def pass_period(self) -> list[CanFrame]:
        """Advance by a servo period, and return the frames sent after it.

        A diverged machine keeps its state, its drives in Fault.
        """
        if self.fault is None:
            try:
                self.drives.period()
            except Diverged as fault:
                self.fault = fault
        now = self.now
        return [frame for node in self.nodes for frame in node.finish_period(now)]

    def send_heartbeats(self, now: int) -> list[CanFrame]:
        """Return the heartbeats that are due at a time of the bus's clock [ns]."""
        return [frame for node in self.nodes for frame in node.send_heartbeat(now)]

    @property
    def beat(self) -> int:
        """Shortest time between heartbeats of a node [ns]; 0: no node sends any."""
        return min((node.beat for node in self.nodes if node.beat), default=0)
