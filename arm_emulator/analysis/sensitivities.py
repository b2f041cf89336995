"""Motions of a scene's machine with exact derivatives by its numbers and by its start.

The machine's own source runs over dual numbers (core/numerics/dual.hpp). Where a scene locates
events, the instant of each has derivatives, too: a stop, a breakaway, a limit that is met.
"""

import dataclasses
import os
from collections.abc import Iterable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from arm_emulator.base.array_equality import ArrayEquality
from arm_emulator.base.arrays import Array
from arm_emulator.base.refusal import Refusal
from arm_emulator.base.validation.bound import ANY_COMMANDS, ANY_STATE, POSITION, VELOCITY
from arm_emulator.base.validation.count import check_count
from arm_emulator.machine.parts.measuring.sensors import JointSensors
from arm_emulator.machine.plant.call_arguments import LARGEST_STEPS
from arm_emulator.machine.plant.compiler import DIRECTIONS, load_sensitivities
from arm_emulator.machine.plant.core_calls import SENSITIVITY
from arm_emulator.machine.scene.fault_catalogue import list_variable_numbers
from arm_emulator.machine.scene.scene import Scene, coerce_scene
from arm_emulator.machine.varied import Varied, choose_names
from arm_emulator.machine.varied_places import SECTION as CALIBRATION

WHERE = "sensitivities"
MASS = "payload.mass"
QUANTITIES = ("q", "v", "current", "theta_m", "omega_m")


@dataclass(frozen=True, eq=False)
class Sensitivities(ArrayEquality):
    """A motion after each of K rows of commands, and its derivatives by n numbers.

    Attributes:
        names: of the n numbers.
        t: times (K,) [s].
        q, v: links (K, N) [rad, rad/s; m, m/s at prismatic joints].
        current: of the motors (K, N) [A].
        theta_m, omega_m: of the motors (K, N) [rad, rad/s].
        by: for each of these its derivatives (K, N, n), in its unit per unit of the number.
    """

    names: tuple[str, ...]
    t: Array
    q: Array
    v: Array
    current: Array
    theta_m: Array
    omega_m: Array
    by: Mapping[str, Array]


class SensitiveMachine:
    """A scene's machine that runs with its derivatives; it is compiled at the first use.

    Attributes:
        names: of the numbers by which it is differentiated.

    Args:
        scene: the machine; its sensors and faults are left out.
        by: names or patterns as in `sensitivities`.

    Raises:
        Refusal: an unknown name.
    """

    def __init__(self, scene: Scene, by: Sequence[str]) -> None:
        possible = list_varied_numbers(scene)
        starts = [f"start.{which}.{joint}" for which in "qv" for joint in scene.joint_names]
        rule = "name numbers of the scene, or start.q.JOINT and start.v.JOINT"
        every = {name: name for name in (*possible, *starts)}
        self.names = choose_names(by, every, WHERE, "by", rule)
        self._scene = scene
        self._varied = tuple(possible[name] for name in self.names if name in possible)
        self._core = load_sensitivities(make_differentiable(scene, self._varied))
        seeded = [*(number.name for number in self._varied), *starts]
        self._places = [seeded.index(name) for name in self.names]

    def run_motion(
        self,
        commands: ArrayLike,
        steps: int | None = None,
        q: ArrayLike | None = None,
        v: ArrayLike | None = None,
        motors: tuple[ArrayLike, ArrayLike] | None = None,
        values: Mapping[str, float] | None = None,
    ) -> Sensitivities:
        """Return a motion with its derivatives.

        Args:
            commands: rows (K, N) [V, N m, A], each held for `steps`.
            steps: integration steps under each row; None: a servo period.
            q: link positions at the start (N,) [rad or m]; None: the scene's.
            v: link speeds at the start (N,) [rad/s or m/s]; None: zero.
            motors: angles and speeds of the motors at the start (N,) [rad, rad/s]; None: they
                follow the links, which is what the derivatives by the start contain.
            values: of numbers in `names`, by name; None: the scene's.

        Raises:
            Refusal: a wrong shape, not finite, or the motion diverged.
        """
        scene, N, dt = self._scene, len(self._scene.joints), self._scene.integrator.dt
        steps = scene.steps_per_period if steps is None else steps
        steps = check_count(WHERE, "steps", steps, 1, LARGEST_STEPS)
        rows = np.atleast_2d(ANY_COMMANDS.check_numbers(WHERE, commands))
        if rows.ndim != 2 or rows.shape[1] != N:
            raise Refusal(WHERE, ANY_COMMANDS.name, f"have shape (K, {N})", rows.shape)
        ANY_COMMANDS.check_values(WHERE, rows)
        inputs = {
            "parameters": np.array([(values or {}).get(o.name, o.value) for o in self._varied]),
            "q": POSITION.check_row(WHERE, scene.start if q is None else q, N),
            "v": VELOCITY.check_row(WHERE, np.zeros(N) if v is None else v, N),
            "commands": np.ascontiguousarray(rows),
        }
        if motors is not None:
            pairs = zip(("theta_m", "omega_m"), motors, strict=True)
            inputs |= {name: ANY_STATE.check_row(WHERE, row, N) for name, row in pairs}
        places = np.array(self._places, dtype=int)
        parts = max(1, -(-len(places) // DIRECTIONS))
        seeds = np.zeros((parts, len(self._varied) + 2 * N, DIRECTIONS))
        which = np.arange(len(places))
        seeds[which // DIRECTIONS, places, which % DIRECTIONS] = 1.0
        of_names = np.split(seeds, np.cumsum([len(self._varied), N]), axis=1)
        slopes = np.empty((len(rows), len(QUANTITIES), N, parts * DIRECTIONS))

        def select_derivatives(some: slice) -> Array:
            quantities = np.empty(slopes.shape[:-1])
            names = ("parameter_seeds", "q_seeds", "v_seeds")
            of = {n: np.ascontiguousarray(o[some]) for n, o in zip(names, of_names, strict=True)}
            request = SENSITIVITY.make_struct(
                "arm_sensitive_run", step=dt, rows=len(rows), steps=steps,
                parts=some.stop - some.start, values=quantities,
                slopes=slopes.ravel()[some.start * DIRECTIONS :], stride=slopes.shape[-1],
                **inputs, **of,
            )  # fmt: skip
            done = self._core.arm_run_with_sensitivities(request)
            if done < len(rows):
                actual = f"a divergence after {done * steps * dt:g} s"
                raise Refusal(WHERE, "motion", "stay within bounds", actual)
            return quantities

        threads = min(len(os.sched_getaffinity(0)), parts)
        ends = np.linspace(0, parts, threads + 1).astype(int).tolist()
        with ThreadPoolExecutor(threads) as pool:
            at_ends, *_ = pool.map(select_derivatives, map(slice, ends, ends[1:]))
        motion = {name: at_ends[:, k] for k, name in enumerate(QUANTITIES)}
        slopes = slopes[..., : len(places)]
        t = np.arange(1.0, len(rows) + 1.0) * (steps * dt)
        by = {name: slopes[:, k] for k, name in enumerate(QUANTITIES)}
        return Sensitivities(self.names, t, **motion, by=by)


def sensitivities(
    scene: Scene | str | Path,
    commands: ArrayLike,
    by: str | Sequence[str],
    *,
    steps: int | None = None,
    q: ArrayLike | None = None,
    v: ArrayLike | None = None,
) -> Sensitivities:
    """Return a motion with its derivatives.

    The first use of a scene with these numbers compiles for 2 to 20 s. Up to 8 derivatives cost
    some ten runs of a `Plant`; runs for more are shared by the cores.

    A derivative is that of the motion as the scheme computes it. It is one-sided where the motion
    has none, as by the speed of a joint that sticks at the start. Without `events: located` modes
    change at the ends of steps, and the derivatives do not contain that these move.

    Args:
        scene: the machine, or what `load_scene` takes: a name or a file; its sensors and faults are
            left out.
        commands: rows (K, N) [V, N m, A], each held for `steps`.
        by: names or patterns of numbers as in `varied` of a scene, such as
            ``joints.*.gear.stiffness``. ``start.q.JOINT`` and ``start.v.JOINT`` are the links'
            positions and speeds at the start, which the motors follow.
        steps: integration steps under each row; None: a servo period.
        q: link positions at the start (N,) [rad or m]; None: the scene's.
        v: link speeds at the start (N,) [rad/s or m/s]; None: zero.

    Raises:
        Refusal: an unknown name, a wrong shape, not finite, or the motion diverged.
    """
    names = (by,) if isinstance(by, str) else by
    if not isinstance(names, Iterable):
        raise Refusal(WHERE, "by", "be names of numbers", by)
    return SensitiveMachine(coerce_scene(scene, WHERE), names).run_motion(commands, steps, q, v)


def list_varied_numbers(scene: Scene) -> dict[str, Varied]:
    """Return the numbers of a machine that its motion may depend on, by their names."""
    here = {
        number.name: number
        for number in list_variable_numbers(_remove_sensors(scene).joints, scene.chain, ())
    }
    listed = (MASS, f"{CALIBRATION}.")
    return here | {number.name: number for number in scene.varied if number.name.startswith(listed)}


def _remove_sensors(scene: Scene) -> Scene:
    joints = tuple(dataclasses.replace(joint, sensors=JointSensors()) for joint in scene.joints)
    return dataclasses.replace(scene, joints=joints, imus=(), faults=())


def make_differentiable(scene: Scene, varied: tuple[Varied, ...]) -> Scene:
    """Return a scene in which these numbers are varied and nothing but motion is computed.

    Raises:
        Refusal: they are of the payload and of the link that carries it.
    """
    load = scene.load if any(number.name == MASS for number in varied) else None
    if load is not None:
        carrier = f"links.{scene.chain.links[load.link].link}."
        for number in varied:
            if number.name.startswith(carrier):
                rule = f"not name both {MASS} and numbers of the link that carries it"
                raise Refusal(WHERE, "by", rule, number.name)
    return dataclasses.replace(
        _remove_sensors(scene), varied=varied, load=load, threads=1, external_wrench=False,
        energy_flow=False,
    )  # fmt: skip
