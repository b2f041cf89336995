"""Field-oriented control of six synchronous motors of a UR5, in the loop at 20 kHz.

    python -m bench.field_oriented [--seconds 1.0] [--out FOLDER]

The arm of config/ur5.yaml with synchronous motors in the place of its direct-current ones. Every
50 us each joint's controller takes the motor's angle and both currents and gives ud and uq: loops
of position and speed, currents of the largest torque per ampere, less flux where the voltage does
not suffice, and loops of both currents, decoupled. Published: how well the arm follows, how far the
motion is from one with steps of a sixteenth, and what a step costs.
"""

from __future__ import annotations

import argparse
import json
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from arm_emulator import Plant, Scene, load_scene
from arm_emulator.machine.chain import Array
from arm_emulator.machine.parts.pmsm import Pmsm

PERIOD = 5e-5  # s, of the control
RAISED = 0.9  # of the inverter's circle: beyond it the flux is weakened
# The motors of config/ur5.yaml with three phases: the same torque per ampere and winding.
LARGE = {
    "kind": "pmsm", "resistance": 0.3, "inductance_d": 3e-4, "inductance_q": 4e-4,
    "flux": 0.125 / 15.0, "pole_pairs": 10, "rotor_inertia": 1e-4,
}  # fmt: skip
SMALL = {
    "kind": "pmsm", "resistance": 1.2, "inductance_d": 7e-4, "inductance_q": 9e-4,
    "flux": 0.09 / 12.0, "pole_pairs": 8, "rotor_inertia": 2e-5,
}  # fmt: skip
REACH = np.array([0.9, 0.5, -0.7, 0.8, -0.6, 1.0])  # rad, of each joint's motion


def arm(**changes: Any) -> Scene:
    """Return the UR5 with synchronous motors."""
    joints = load_scene("ur5").joint_names
    motors = {f"joints.{name}.motor": LARGE if k < 3 else SMALL for k, name in enumerate(joints)}
    return load_scene("ur5", motors | {"servo_period": PERIOD, "integrator.dt": PERIOD, **changes})


@dataclass
class Controller:
    """Field-oriented control of all joints, arrays (N,); gains by pole placement."""

    scene: Scene

    def __post_init__(self) -> None:
        """Take the data sheets."""
        motors = [joint.motor for joint in self.scene.joints]
        assert all(isinstance(motor, Pmsm) for motor in motors)
        self.R, self.Ld, self.Lq, self.psi, self.p, self.Mm = (
            np.array([getattr(motor, name) for motor in motors], float)
            for name in (
                "resistance", "inductance_d", "inductance_q", "flux", "pole_pairs", "rotor_inertia"
            )
        )  # fmt: skip
        N = len(motors)
        self.U = self.scene.supply_voltage / np.sqrt(3.0)
        self.current_bandwidth = 2.0 * np.pi * 800.0  # rad/s, a 25th of the control's rate
        # Rotor and link turn together below the gear's resonance.
        ratio = self.scene.gear_ratios
        link = np.array([4.0, 4.0, 1.5, 0.2, 0.2, 0.02])  # kg m2, of the middle of the poses
        self.inertia = self.Mm + ratio**2 * link
        self.speed_bandwidth, self.position_bandwidth = 2.0 * np.pi * 15.0, 2.0 * np.pi * 4.0
        self.torque_sum, self.weakening = np.zeros(N), np.zeros(N)
        self.sum_d, self.sum_q = np.zeros(N), np.zeros(N)
        self.wanted_q = np.zeros(N)

    def voltages(
        self, angle: Array, speed: Array, i_d: Array, i_q: Array, goal: Array, goal_speed: Array
    ) -> tuple[Array, Array]:
        """Return ud and uq from what is measured and wanted at the motors."""
        wanted = goal_speed + self.position_bandwidth * (goal - angle)
        error = wanted - speed
        Kp = self.inertia * self.speed_bandwidth
        torque = Kp * error + self.torque_sum
        self.torque_sum += Kp * (self.speed_bandwidth / 4.0) * error * PERIOD
        d_wanted, q_wanted = self.currents(torque)
        self.wanted_q = q_wanted
        return self.current_loops(speed, i_d, i_q, d_wanted, q_wanted)

    def currents(self, torque: Array) -> tuple[Array, Array]:
        """Return the currents of a torque with the least losses, with the flux weakened."""
        q = torque / (1.5 * self.p * self.psi)
        gap = self.Lq - self.Ld
        d = (self.psi - np.sqrt(self.psi**2 + 4.0 * gap**2 * q**2)) / (2.0 * gap)
        d = np.maximum(d - self.weakening, -0.9 * self.psi / self.Ld)
        return d, torque / (1.5 * self.p * (self.psi - gap * d))

    def current_loops(
        self, speed: Array, i_d: Array, i_q: Array, d_wanted: Array, q_wanted: Array
    ) -> tuple[Array, Array]:
        """Return ud and uq that bring the currents there; integrals rest at the circle."""
        turn = self.p * speed
        error_d, error_q = d_wanted - i_d, q_wanted - i_q
        u_d = self.current_bandwidth * self.Ld * error_d + self.sum_d - turn * self.Lq * i_q
        u_q = self.current_bandwidth * self.Lq * error_q + self.sum_q
        u_q += turn * (self.Ld * i_d + self.psi)
        size = np.hypot(u_d, u_q)
        inside = size <= self.U
        self.sum_d += np.where(inside, self.current_bandwidth * self.R * error_d * PERIOD, 0.0)
        self.sum_q += np.where(inside, self.current_bandwidth * self.R * error_q * PERIOD, 0.0)
        rise = 200.0 * (size - RAISED * self.U) / self.U * self.psi / self.Ld
        self.weakening = np.maximum(0.0, self.weakening + rise * PERIOD)
        scale = np.minimum(1.0, self.U / np.maximum(size, 1e-9))
        return u_d * scale, u_q * scale


def goals(scene: Scene, seconds: float) -> tuple[Array, Array]:
    """Return motor angles and speeds (K, N) of a smooth motion there and back."""
    ratio = scene.gear_ratios
    t = np.arange(round(seconds / PERIOD))[:, None] * PERIOD
    swing = 2.0 * np.pi / seconds
    q = scene.start + REACH * 0.5 * (1.0 - np.cos(swing * t))
    v = REACH * 0.5 * swing * np.sin(swing * t)
    return q / ratio, v / ratio


def drive(scene: Scene, seconds: float) -> dict[str, Any]:
    """Run the loop; return what was seen."""
    plant, control = Plant(scene), Controller(scene)
    angles, speeds = goals(scene, seconds)
    ratio = scene.gear_ratios
    error = np.zeros_like(angles)
    off_q, d, u, q = (np.zeros_like(angles) for _ in range(4))
    began = time.process_time()
    in_core = 0.0
    for k, (angle, speed) in enumerate(zip(angles, speeds, strict=True)):
        x = plant.state
        i_d = plant.measured.current_d
        ud, uq = control.voltages(x.theta_m, x.omega_m, i_d, x.current, angle, speed)
        error[k] = (angle - x.theta_m) * ratio
        off_q[k], d[k], u[k], q[k] = control.wanted_q - x.current, i_d, np.hypot(ud, uq), x.q
        at = time.perf_counter()
        plant.exchange(uq, command_d=ud)
        in_core += time.perf_counter() - at
    return {
        "following_error_rad": float(np.abs(error[len(error) // 10 :]).max()),
        "iq_error_A": float(np.sqrt((off_q**2).mean())),
        "lowest_id_A": float(d.min()),
        "largest_voltage_of_circle": float(u.max() / control.U),
        "exchange_us": 1e6 * in_core / len(angles),
        "loop_us": 1e6 * (time.process_time() - began) / len(angles),
        "q": q,
    }


def ns_per_step(scene: Scene) -> float:
    """Return the cost of a step of the machine alone, the least of several runs [ns]."""
    plant, rows = Plant(scene), np.full((1, len(scene.joints)), 1.0)
    steps, least = 20_000, np.inf
    for _ in range(7):
        plant.reset()
        at = time.process_time()
        plant.run(rows, steps)
        least = min(least, (time.process_time() - at) / steps)
    return 1e9 * least


def main() -> int:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seconds", type=float, default=1.0, help="of the motion")
    parser.add_argument("--out", type=Path, help="folder for field_oriented.json")
    arguments = parser.parse_args()
    found: dict[str, Any] = {}
    fine = drive(arm(**{"integrator.dt": PERIOD / 16}), arguments.seconds).pop("q")
    for scheme in ("rosenbrock", "extrapolated"):
        scene = arm(**{"integrator.scheme": scheme})
        one = drive(scene, arguments.seconds)
        one["error_of_the_step_rad"] = float(np.abs(one.pop("q") - fine).max())
        one["ns_per_step"] = ns_per_step(scene)
        dc = load_scene("ur5", {"integrator.scheme": scheme, "integrator.dt": PERIOD})
        one["ns_per_step_dc"] = ns_per_step(dc)
        found[scheme] = one
        print(f"{scheme}, six synchronous motors of ur5, control and step every 50 us:")
        for name, value in one.items():
            print(f"  {name:28s} {value:.4g}")
    if arguments.out:
        arguments.out.mkdir(parents=True, exist_ok=True)
        (arguments.out / "field_oriented.json").write_text(json.dumps(found, indent=1) + "\n")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
