"""A mass that rubs, towed by a spring whose end moves on: links and rotors that stick and slip."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from machines import LINK_INERTIA, one_link_urdf, write_scene
from scipy.integrate import solve_ivp

from emulator_node.chain import Array

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
            found = solve_ivp(rates, (begin, t[-1]), [w, v], "DOP853", rtol=1e-12, atol=1e-14,
                              events=stopped, dense_output=True)  # fmt: skip
            end = found.t[-1]
            here = (t >= begin) & (t <= end)
            if here.any():
                out[here] = self.speed * t[here] - found.sol(t[here])[0]
            if end >= t[-1]:
                break
            stops, w, begin = stops + 1, found.y[0, -1], end
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


def scene_of(
    folder: Path, towed: Towed, friction: dict[str, float], side: str, **integrator: Any
) -> Path:
    """Write the machine: the link rubs behind a rotor that nothing slows down, or the other way.

    Args:
        folder: for the files.
        towed: the motion.
        friction: the scene's section, of the link.
        side: "link" or "rotor".
        integrator: its keys.
    """
    gear = {"ratio": RATIO, "stiffness": towed.stiffness, "damping": towed.damping}
    motor: dict[str, Any] = {"resistance": 1.0, "torque_constant": 0.1, "back_emf_constant": 0.0}
    joint: dict[str, Any] = {"motor": motor, "gear": gear}
    urdf, period = one_link_urdf(), row(towed)
    if side == "link":
        motor["rotor_inertia"], joint["friction"] = 1e14 * RATIO**2, friction
    else:  # of the rotor's own size at the motor's shaft
        times = {"viscous": RATIO**2, "coulomb": RATIO, "breakaway": RATIO, "stribeck": 1.0 / RATIO}
        motor["rotor_inertia"] = LINK_INERTIA * RATIO**2
        motor["friction"] = {key: value * times.get(key, 1.0) for key, value in friction.items()}
        urdf = one_link_urdf(inertia=1e12)
    return write_scene(
        folder, urdf, {"joint": joint}, servo_period=period, varied=["joints.*"],
        integrator={"dt": period / STEPS[0], **integrator},
    )  # fmt: skip


def row(towed: Towed) -> float:
    """Return the time after which positions are compared [s]."""
    return float(round(towed.swing / 7.3, 9))
