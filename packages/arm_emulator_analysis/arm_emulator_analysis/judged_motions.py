"""Test motions for schemes and steps: commands for a machine, in its motors' units.

Some drive the motors to their limits, others lead the arm along a reference: a computed-torque
controller on a finely integrated machine generates the commands, which are recorded. Played back
in open loop, they show the errors of the integration alone, without the effect of a controller.
"""

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from arm_emulator.extension.base import Array
from arm_emulator.extension.machine import SCHEMES, Diverged, Plant, Scene

SECONDS = 1.0
FINE = 20  # steps per servo period while commands are generated
RATE = 2.0 * np.pi * 3.0  # rad/s, bandwidth of the controller
OF_EACH = 4  # motions of each kind per scene
TURN, SLIDE = 0.4, 0.1  # rad, m: size of references
# rad/s2, m/s2: of a joint at rest, where a motor takes any command.
ACCELERATION = 50.0

Rng = np.random.Generator


@dataclass(frozen=True)
class JudgedMotion:
    """Commands (K, N) [V, N m, A], each row held over a servo period, from rest at the start."""

    name: str
    commands: Array


class ExcitationMotions:
    """Generates random motions of a scene: leads the arm along references, records the commands.

    Args:
        scene: the machine.
        seconds: length of each.
    """

    def __init__(self, scene: Scene, seconds: float = SECONDS) -> None:
        self.scene = scene
        self.rows = max(2, round(seconds / scene.servo_period))
        self.t: Array = scene.servo_period * np.arange(self.rows, dtype=np.float64)
        self._size = np.array(
            [SLIDE if joint.kind == "prismatic" else TURN for joint in scene.chain.joints]
        )
        self._gain = np.array([joint.torque_per_command for joint in scene.joints])
        limits = [joint.compute_largest_command(scene.supply_voltage) for joint in scene.joints]
        self._limit = np.array([np.inf if limit is None else limit for limit in limits])
        motors = [(joint.motor, joint.gear.ratio) for joint in scene.joints]
        self._rotors = np.array(
            [m.reflect_to_link(ratio)["rotor inertia"] if m else 0.0 for m, ratio in motors]
        )
        self._plant = self._make_plant(FINE)

    def draw_motion(self, kind: str, rng: Rng) -> JudgedMotion:
        """Return a motion of one of the `KINDS`.

        Raises:
            Diverged: the machine diverges at every step tried.
        """
        shape = np.column_stack([KINDS[kind](self.t, rng) for _ in self.scene.joints])
        if kind == "limits":
            return JudgedMotion(kind, shape * self.pushed)
        q_ref = self.scene.start + (shape - shape[0]) * self._size
        try:
            commands = self._compute_commands_along(q_ref, self._plant)
        except Diverged:
            commands = self._compute_commands_along(q_ref, self._make_plant(20 * FINE))
        if kind == "stop":
            commands[self.rows // 2 :] = 0.0
        return JudgedMotion(kind, commands)

    @property
    def pushed(self) -> Array:
        """Largest commands of the drives, or those that move a joint briskly from rest (N,)."""
        M, bias = self._compute_equation(self.scene.start, np.zeros(len(self._size)))
        brisk = self._compute_commands(np.abs(bias) + ACCELERATION * np.diag(M))
        return np.where(np.isfinite(self._limit), self._limit, np.abs(brisk))

    def _compute_commands_along(self, q_ref: Array, plant: Plant) -> Array:
        """Return the commands (K, N) that lead the arm along q_ref (K, N), by computed torques."""
        v_ref = np.gradient(q_ref, self.scene.servo_period, axis=0)
        commands, steps = np.zeros_like(q_ref), plant.scene.steps_per_period
        plant.reset()
        for k, (position, speed) in enumerate(zip(q_ref, v_ref, strict=True)):
            x = plant.state
            M, bias = self._compute_equation(x.q, x.v)
            a = RATE**2 * (position - x.q) + 2.0 * RATE * (speed - x.v)
            commands[k] = np.clip(self._compute_commands(M @ a + bias), -self._limit, self._limit)
            plant.advance(commands[k], steps)
        return commands

    def _compute_commands(self, torque: Array) -> Array:
        out: Array = np.zeros_like(torque)
        np.divide(torque, self._gain, out=out, where=self._gain != 0.0)
        return out

    def _compute_equation(self, q: Array, v: Array) -> tuple[Array, Array]:
        """Return M with rotors (N, N) and the torques of motion at constant speed (N,)."""
        N = len(q)
        at, torques = np.tile(q, (N + 1, 1)), np.vstack([np.zeros(N), np.eye(N)])
        a = self._plant.links.accelerations(at, np.tile(v, (N + 1, 1)), torques)
        M = np.linalg.inv((a[1:] - a[0]).T)
        return M + np.diag(self._rotors), -M @ a[0]

    def _make_plant(self, steps: int) -> Plant:
        scene = self.scene
        integrator = dataclasses.replace(
            scene.integrator, scheme=SCHEMES[0], events="located", dt=scene.servo_period / steps
        )
        return Plant(dataclasses.replace(scene, integrator=integrator, threads=1))


def list_motions(scene: Scene, seconds: float = SECONDS) -> list[JudgedMotion]:
    """Return the default test motions of a scene, always the same."""
    excitation = ExcitationMotions(scene, seconds)
    kinds = [*OF_EACH * list(KINDS), *OF_EACH * ["limits"]]  # often of the largest errors
    return [
        excitation.draw_motion(kind, np.random.default_rng([7, number]))
        for number, kind in enumerate(kinds)
    ]


# References of one joint over the times t (K,), in units of its size


def _make_telegraph(t: Array, rng: Rng) -> Array:
    """Reversals after 20 to 150 ms each."""
    changes = np.cumsum(rng.uniform(0.02, 0.15, 2 + int(t[-1] / 0.02)))
    sign: Array = rng.choice([-1.0, 1.0]) * (-1.0) ** np.searchsorted(changes, t)
    return sign


def _make_steps(t: Array, rng: Rng) -> Array:
    """Jumps to random positions, after 0.1 to 0.4 s each."""
    changes = np.cumsum(rng.uniform(0.1, 0.4, 2 + int(t[-1] / 0.1)))
    places: Array = rng.uniform(-1.0, 1.0, len(changes) + 1)
    return places[np.searchsorted(changes, t)]


def _make_sweep(t: Array, rng: Rng) -> Array:
    """A sine swept from 0.3 to 4 Hz, with falling amplitude."""
    low, high = rng.uniform(0.3, 0.5), rng.uniform(2.0, 4.0)
    rate = low + (high - low) * t / t[-1]
    phase = 2.0 * np.pi * (low * t + 0.5 * (high - low) * t**2 / t[-1]) + rng.uniform(0.0, 6.3)
    wave: Array = np.sin(phase) * np.minimum(1.0, 1.0 / rate)
    return wave


def _make_reversals(t: Array, rng: Rng) -> Array:
    """Back and forth at constant speed, with sharp turns."""
    phase = rng.uniform(1.0, 3.0) * t + rng.uniform(0.0, 1.0)
    wave: Array = 0.5 * (4.0 * np.abs(phase % 1.0 - 0.5) - 1.0)
    return wave


def _make_creep(t: Array, rng: Rng) -> Array:
    """The same at a twentieth of the distance, after a rest."""
    begun = t - rng.uniform(0.05, 0.2) * t[-1]
    return 0.05 * _make_reversals(np.maximum(begun, 0.0), rng)


KINDS: dict[str, Callable[[Array, Rng], Array]] = {
    "limits": _make_telegraph,
    "steps": _make_steps,
    "sweep": _make_sweep,
    "reversals": _make_reversals,
    "creep": _make_creep,
    "stop": _make_sweep,  # without commands from the middle on
}
