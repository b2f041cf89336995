"""Values of a machine at a tick, read once; those of a loop while it stands still."""

from arm_emulator.machine.plant.measured import Measured
from arm_emulator.machine.plant.plant import Plant
from arm_emulator.machine.plant.plant_state import PlantState
from arm_emulator.machine.session.clock import ReachedTick


class ReadCache:
    """State, measurement and energy of a plant at this tick.

    Args:
        plant: the machine.
        is_self_clocked: whether a loop drives it; `clear_values` then reads it at rest.
    """

    def __init__(self, plant: Plant, *, is_self_clocked: bool) -> None:
        self._plant, self._is_self_clocked = plant, is_self_clocked
        self._state: PlantState | None = None
        self._measured: Measured | None = None
        self._energy: float | None = None

    def clear_values(self) -> None:
        """Forget what was read: the machine is at another tick, or was changed."""
        self._state = self._measured = self._energy = None
        if self._is_self_clocked:
            plant = self._plant
            self._state, self._measured, self._energy = plant.state, plant.measured, plant.energy

    def take_values(self, reached: ReachedTick) -> PlantState:
        """Take the values of a tick that a loop has reached; return the state."""
        self._energy, self._measured = reached.energy, reached.measured
        t = reached.tick * self._plant.scene.servo_period
        current, theta_m, omega_m, q, v, gear_torque = reached.rows
        self._state = PlantState(t, current, theta_m, omega_m, q, v, gear_torque)
        return self._state

    @property
    def state(self) -> PlantState:
        """State at this tick."""
        if self._state is None:
            self._state = self._plant.state
        return self._state

    @property
    def measured(self) -> Measured:
        """Readings of the sensors at this tick."""
        if self._measured is None:
            self._measured = self._plant.measured
        return self._measured

    @property
    def energy(self) -> float:
        """Energy at this tick [J]."""
        return self._plant.energy if self._energy is None else self._energy
