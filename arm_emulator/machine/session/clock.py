"""The clock of a session: advanced by its owner, or by a loop."""

from dataclasses import dataclass

from arm_emulator.base.arrays import Array
from arm_emulator.machine.plant.measured import Measured
from arm_emulator.machine.plant.plant import Plant


@dataclass(frozen=True)
class RealTimeFigures:
    """Punctuality of a loop since its reset; times in ns."""

    tick: int = 0
    lost_periods: int = 0  # deadlines missed by whole periods, which logical time has lost
    old_commands: int = 0  # periods under a command that answers a state more than two periods old
    worst_lateness: int = 0
    median_lateness: int = 0
    p99_lateness: int = 0
    unread: int = 0  # snapshots that were not fetched in time
    fifo: int = 0  # 1: the core's threads run under SCHED_FIFO
    locked: int = 0  # 1: memory is locked


@dataclass(frozen=True)
class ReachedTick:
    """The machine at a tick that a loop has reached."""

    tick: int
    lateness: int  # ns, of the wake-up that computed it
    spent: int  # ns, on the periods since the one that was taken before
    fault: int  # joint that diverged; -1: none
    energy: float  # J
    rows: Array  # (len(ROWS), N), see `PlantState`
    measured: Measured


class Clock:
    """Advances a machine by servo periods. This one leaves that to the owner of the session.

    Attributes:
        is_self_clocked: whether ticks come without the owner, and are to be taken.
        running: whether time passes now, or the owner lets it pass.
    """

    is_self_clocked, running = False, True

    def __init__(self, plant: Plant) -> None:
        self._plant = plant

    @property
    def spent_ns(self) -> int:
        """Wall time that integration steps have taken since this was first read [ns].

        It is not measured before: reading the processor's clock costs a quarter of a small step.
        """
        self._plant.measure_time()
        return self._plant.spent_ns

    @property
    def figures(self) -> RealTimeFigures:
        """Punctuality; zeros if no deadline is kept."""
        return RealTimeFigures()

    def restart_clock(self) -> None:
        """Restart at tick 0, without the commands and ticks of the last run."""

    def hold_command(self, answered: int, command: Array, further: Array | None = None) -> None:
        """Hold commands (N,) [V, N m, A] that answer a tick, from now on.

        Further inputs (I, N) are 0 if None.
        """

    def start_time(self, tick: int) -> None:
        """Start time at a tick."""

    def stop_time(self) -> None:
        """Stop time. Ticks not taken yet stay."""

    def go_on(self) -> None:
        """Continue as if time had not been stopped."""

    def wait_for_tick(self, timeout: float) -> bool:
        """Wait at most `timeout` [s] for a tick."""
        return False

    def take_tick(self, *, newest: bool = False) -> ReachedTick | None:
        """Return the oldest tick not taken yet, or the newest; None after the last."""
        return None
