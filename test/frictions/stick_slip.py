"""A mass that rubs, towed by a spring whose end moves on: links and rotors that stick and slip."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from machines import LINK_INERTIA, write_scene
from scipy.integrate import solve_ivp

from arm_emulator import Plant, load_scene
from arm_emulator.base.arrays import Array
from oracles.random_chain import LINK

RATIO = 0.05
STEPS = (40, 80, 160, 320)  # of a row
ROWS = 24


@dataclass(frozen=True)
class Towed:
    """In the coordinates of the link, which the end of the spring moves with at `speed`.

    `sliding(v, T)` and `holding(T)` are torques of friction under the torque T of the spring.
    """

    stiffness: float
    damping: float
    viscous: float
    speed: float
    sliding: Callable[[float, float], float]
    holding: Callable[[float], float]

    @property
    def swing(self) -> float:
        """Time of an undamped swing on the spring [s]."""
        return 2.0 * np.pi * float(np.sqrt(LINK_INERTIA / self.stiffness))

    def positions(self, t: Array) -> tuple[Array, int]:
        """Return where the mass is, and how often it stopped, by DOP853 from event to event.

        It begins at the speed of the spring's end.
        """
        out, begin, stops = np.full_like(t, np.nan), 0.0, 0
        w, v = 0.0, self.speed

        def pull(w: float, v: float) -> float:
            return self.stiffness * w + self.damping * (self.speed - v)

        def rates(_: float, x: Array) -> list[float]:
            T = pull(x[0], x[1])
            friction = self.viscous * x[1] + self.sliding(x[1], T)
            return [self.speed - x[1], (T - friction) / LINK_INERTIA]

        def stopped(_: float, x: Array) -> float:
            return float(x[1])

        stopped.terminal, stopped.direction = True, -1  # type: ignore[attr-defined]
        while begin < t[-1]:
            solution = solve_ivp(rates, (begin, t[-1]), [w, v], "DOP853", rtol=1e-12, atol=1e-14,
                              events=stopped, dense_output=True)  # fmt: skip
            end = solution.t[-1]
            here = (t >= begin) & (t <= end)
            if here.any():
                out[here] = self.speed * t[here] - solution.sol(t[here])[0]
            if end >= t[-1]:
                break
            stops, w, begin = stops + 1, solution.y[0, -1], end
            rest = self.speed * end - w
            # The spring's torque grows evenly until it is that of holding.
            low, high = w, w + 1e3
            for _ in range(200):
                middle = 0.5 * (low + high)
                T = pull(middle, 0.0)
                low, high = (middle, high) if T < self.holding(T) else (low, middle)
            away = begin + max(0.0, (high - w) / self.speed)
            out[(t >= end) & (t <= away)] = rest
            w, v, begin = max(high, w), 0.0, away
        return out, stops


def draw(rng: np.random.Generator) -> tuple[dict[str, float], Towed]:
    """Friction that falls by 20 to 60 %, and a spring that tows a mass at a part of its speed."""
    Dc, Kg = float(rng.uniform(0.5, 3.0)), float(10 ** rng.uniform(1.0, 2.0))
    Ds, viscous = Dc * float(rng.uniform(1.2, 1.6)), float(rng.uniform(0.0, 0.1))
    swing = Dc / float(np.sqrt(Kg * LINK_INERTIA))  # rad/s, of the mass on the spring
    speed, vs = swing * float(rng.uniform(0.2, 0.5)), swing * float(rng.uniform(0.3, 1.0))
    friction = {"viscous": viscous, "coulomb": Dc, "breakaway": Ds, "stribeck": vs}

    def sliding(v: float, _: float) -> float:
        return Dc + (Ds - Dc) * float(np.exp(-((v / vs) ** 2)))

    damping = float(rng.uniform(0.0, 0.05)) * float(np.sqrt(Kg * LINK_INERTIA))
    return friction, Towed(Kg, damping, viscous, speed, sliding, lambda T: Ds)


def scene_of(folder: Path, towed: Towed, friction: dict[str, float], **integrator: Any) -> Path:
    """Write two such masses, which do not feel each other; `friction` is the section of the link.

    The joint "rotor" has a rotor of the mass's inertia that rubs, before a heavy link that keeps
    its speed. The joint "link" has a link that rubs, behind a heavy rotor that keeps its speed.
    """
    gear = {"ratio": RATIO, "stiffness": towed.stiffness, "damping": towed.damping}
    times = {"viscous": RATIO**2, "coulomb": RATIO, "breakaway": RATIO, "stribeck": 1.0 / RATIO}
    at_motor = {key: value * times.get(key, 1.0) for key, value in friction.items()}
    motor = {"resistance": 1.0, "torque_constant": 0.1, "back_emf_constant": 0.0}
    light = {**motor, "rotor_inertia": LINK_INERTIA * RATIO**2, "friction": at_motor}
    heavy = {**motor, "rotor_inertia": 1e14 * RATIO**2}
    text, parent = '<robot name="two"><link name="base"/>', "base"
    for name, axis, mass in (("rotor", "1 0 0", 1e9), ("link", "0 1 0", LINK_INERTIA)):
        text += LINK.format(
            name=name, kind="prismatic", xyz="0 0 0", rpy="0 0 0", parent=parent, axis=axis,
            com="0 0 0", com_rpy="0 0 0", mass=mass, ixx=1, iyy=1, izz=1, ixy=0, ixz=0, iyz=0,
        )  # fmt: skip
        parent = f"{name}_link"
    joints = {
        "rotor": {"motor": light, "gear": gear},
        "link": {"motor": heavy, "gear": gear, "friction": friction},
    }
    return write_scene(
        folder, text + "</robot>", joints, servo_period=row(towed),
        integrator={"dt": row(towed) / STEPS[0], **integrator},
    )  # fmt: skip


def row(towed: Towed) -> float:
    """Return the time after which positions are compared [s]."""
    return float(round(towed.swing / 7.3, 9))


def assert_order_two(
    folder: Path, towed: Towed, friction: dict[str, float], scheme: str, stops: int
) -> None:
    """Compare both masses with the truth, which stops at least so often, at falling step sizes."""
    t = row(towed) * np.arange(1, ROWS + 1)
    truth, stopped = towed.positions(t)
    assert stopped >= stops, "the mass shall stick and slip"
    file, errors = scene_of(folder, towed, friction, scheme=scheme, events="located"), []
    for steps in STEPS:
        plant = Plant(load_scene(file, {"integrator.dt": row(towed) / steps}))
        plant.reset(v=[towed.speed, towed.speed])
        places = []
        for _ in t:
            plant.advance([0.0, 0.0], steps)
            places.append([plant.state.theta_m[0] * RATIO, plant.state.q[1]])
        errors.append(np.abs(np.array(places) - truth[:, None]).max(axis=0))
    orders = np.log2(np.array(errors[:-1]) / errors[1:])
    # The next term of the error's expansion is some per cent of it.
    assert orders[1:] == pytest.approx(2.0, abs=0.2), f"rotor, link: {errors}"
