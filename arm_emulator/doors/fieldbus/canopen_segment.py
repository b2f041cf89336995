"""All drives of a machine as nodes on one CAN bus: frames in, frames out, and servo periods."""

from __future__ import annotations

from arm_emulator.base.refusal import Refusal
from arm_emulator.doors.fieldbus.canopen_node import LARGEST_NODE, Frame, Node
from arm_emulator.doors.fieldbus.drives import Drives
from arm_emulator.machine.diverged import Diverged

_INTERPOLATION_TIME = bytes([0xC2, 0x60])  # in a request of SDO


class Segment:
    """Nodes of all joints, base to tool, with node-IDs in a row.

    In lock-step each SYNC is a servo period, or as many as all drives have in their interpolation
    time 0x60C2: targets received before it hold from its beginning on, and what nodes send with it
    is what there was then. Else the owner calls `pass_period`.

    Attributes:
        scene: the machine.
        drives: their object dictionaries.
        nodes: one per joint.
        fault: why the machine stays where it is; None if it goes on.
        uneven: what was set of interpolation times that are not whole servo periods, in words.

    Args:
        drives: of a machine, made for CANopen.
        first: node-ID of the first joint.
        lockstep: whether SYNC lets time pass.

    Raises:
        Refusal: there are not so many node-IDs.
    """

    def __init__(self, drives: Drives, first: int = 1, *, lockstep: bool = True) -> None:
        self.scene = scene = drives.plant.scene
        largest = LARGEST_NODE + 1 - len(scene.joints)
        if not 1 <= first <= largest:
            raise Refusal("canopen", "first node-ID", f"be 1 to {largest}", first)
        self.drives = drives
        self._lockstep = lockstep
        self._period = round(scene.servo_period * 1e9)
        self.nodes = [Node(drives, k, first + k) for k in range(len(scene.joints))]
        self.fault: Diverged | None = None
        self.uneven: list[str] = []
        self._periods: dict[int, float] = {}  # in an interpolation time, of the newest of nodes

    @property
    def tick(self) -> int:
        """Number of servo periods so far."""
        return self.drives.tick

    @property
    def now(self) -> int:
        """Logical time [ns]."""
        return self.tick * self._period

    def boot(self) -> list[Frame]:
        """Start up, and return the frames sent."""
        return [frame for node in self.nodes for frame in node.boot()]

    def receive(self, frame: Frame) -> list[Frame]:
        """Take a frame from the bus, and return the frames sent."""
        now, frames, synced = self.now, [], False
        for node in self.nodes:
            if node.takes_sync(frame):
                synced = True
                frames += node.sync(now)
            else:
                frames += node.receive(frame, now)
                if frame.data[1:3] == _INTERPOLATION_TIME:
                    self._look_at_interpolation(node)
        if synced and self._lockstep:
            for _ in range(min(map(self.drives.periods_per_target, range(len(self.nodes))))):
                frames += self.pass_period()
        return frames

    def _look_at_interpolation(self, node: Node) -> None:
        """Report an interpolation time in lock-step that is not a multiple of the servo period."""
        value, exponent = (
            int.from_bytes(node.upload(0x60C2, sub), "little", signed=sub == 2) for sub in (1, 2)
        )
        periods = value * 10.0 ** (9 + exponent) / self._period
        if not self._lockstep or self._periods.get(node.number) == periods:
            return
        self._periods[node.number] = periods
        if periods > 1.0 and abs(periods - round(periods)) > 1e-9 * periods:
            taken = self.drives.periods_per_target(self.nodes.index(node))
            self.uneven.append(
                f"node {node.number}: 0x60C2 is {periods:g} servo periods: SYNC stands for {taken}"
            )

    def pass_period(self) -> list[Frame]:
        """Advance by a servo period, and return the frames sent after it.

        A diverged machine keeps its state, its drives in Fault.
        """
        if self.fault is None:
            try:
                self.drives.period()
            except Diverged as fault:
                self.fault = fault
        now = self.now
        return [frame for node in self.nodes for frame in node.after_period(now)]

    def heartbeats(self, now: int) -> list[Frame]:
        """Return the heartbeats that are due at a time of the bus's clock [ns]."""
        return [frame for node in self.nodes for frame in node.heartbeat(now)]

    @property
    def beat(self) -> int:
        """Shortest time between heartbeats of a node [ns]; 0: no node sends any."""
        return min((node.beat for node in self.nodes if node.beat), default=0)
