"""Friction of published joints, measured by motions of ours and drawn over the published curves.

python -m bench.physics.published_joints
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from scipy.optimize import brentq

from arm_emulator import ExternalWrench, Plant, load_scene
from arm_emulator.base.arrays import Array
from arm_emulator.base.io.config_files import find_config_folder
from bench.measure import show_progress
from bench.pictures import make_figure, save_picture
from bench.tables import format_table
from oracles.bam import Bam
from oracles.random_chain import LINK

TITLE = "Friction of published joints"
PICTURE = "published_joints"

NAME, DT, STEPS = "joint", 1e-4, 10
PERIOD = DT * STEPS
SETTLED = 2000  # periods at rest under a load, before anything is measured
RAMP = 1e-4  # of the largest load, each period
MOVED, MEASURED = 4000, 500  # periods of a motion at constant speed; at their end it is measured
BANDWIDTH, RESET = 40.0, 10.0  # rad/s, of the servo of the speed
POINTS, CURVE = 6, 61


@dataclass(frozen=True)
class Published(Bam):
    """Friction of a joint at its output.

    Attributes:
        Kv: viscous friction [N m s/rad].
        load: largest torque of the load here [N m].
    """

    Kv: float
    load: float

    def compute_torque(self, w: float, tau: float, load: float) -> float:
        """Return the torque against motion at the speed w, of the motor's torque and the load.

        Both count positive where the motor holds the load.
        """
        return self(1.0, w, tau, load, abs(tau) > abs(load)) + self.Kv * w

    def solve_balance(self, kind: str, w: float, load: float) -> float:
        """Return the friction where joint, motor and load are in balance [N m].

        Args:
            kind: `drives`, the motor lifts the load; `driven`, the load moves the motor; `off`, it
                does so while the motor has no torque, and is what the friction is.
            w: the speed, 0 where the joint just breaks away [rad/s].
            load: of the joint [N m].
        """
        balance: dict[str, Callable[[float], float]] = {
            "drives": lambda x: x - self.compute_torque(w, load + x, load),
            "driven": lambda x: x - self.compute_torque(w, load - x, load),
            "off": lambda x: x - self.compute_torque(w, 0.0, x),
        }
        grid = np.linspace(0.0, 4.0 * self.load, 4001)
        first = next(k for k, x in enumerate(grid) if balance[kind](x) > 0.0)
        return float(brentq(balance[kind], grid[first - 1], grid[first], xtol=1e-12))


# Rhoban/bam (Apache-2.0), bam/params/*/m6.json, commit 1b5a1cee2e.
JOINTS = {
    "erob80_50": Published(3.25894, 0.320431, 0.0356619, 0.000843166, 0.00377099, 0.041438,
                           0.00187212, 0.0015991, 2.83039, 1.78644, 1.40339, 40.0),
    "erob80_100": Published(0.000477967, 5.22642, 0.0488877, 7.62632e-08, 8.82328e-06, 0.0511666,
                            0.00270292, 0.00255626, 2.03303, 2.99992, 9.70933, 50.0),
    "mx64": Published(6.21792e-07, 0.122695, 0.311472, 2.0462e-08, 0.187744, 0.0140659,
                      0.00690851, 0.00999998, 2.57528, 0.840902, 0.025337, 2.5),
    "mx106": Published(1.02325e-05, 0.121954, 0.198006, 0.0222155, 0.1986, 0.0871033, 0.00999993,
                       7.32692e-05, 1.74633, 1.14283, 0.0507157, 4.0),
    "xl320": Published(4.33378e-07, 0.0163055, 3.08821e-06, 0.158325, 5.96572e-09, 0.245483,
                       0.00361641, 0.00471093, 2.30105, 1.70674, 0.00722517, 0.08),
    "xl330": Published(0.00477118, 0.00467635, 0.266786, 8.51587e-06, 1.07229e-05, 0.0807793,
                       0.00997247, 0.00490257, 2.89037, 8.68326, 0.00535967, 0.4),
}  # fmt: skip
SPEEDS = {"at rest": 0.0, "at half Stribeck's speed": 0.5, "at Stribeck's speed": 1.0}
WORDS = {"drives": "motor drives", "driven": "load drives", "off": "motor off"}


class Stand:
    """One joint of a data file, with a disk as heavy as its rotor, and a torque on the disk."""

    def __init__(self, name: str, folder: Path) -> None:
        data = yaml.safe_load((find_config_folder() / "joints" / f"{name}.yaml").read_text())
        joint = data["joints"][name]
        motor = joint["motor"]
        self.ratio = float(joint["gear"]["ratio"])
        self.constant = float(motor["torque_constant"]) / self.ratio
        # A drive without a current loop takes volts.
        self.resistance = None if "current_loop" in motor else motor["resistance"]
        self.inertia = motor["rotor_inertia"] / self.ratio**2
        disk = LINK.format(
            name=NAME, kind="continuous", xyz="0 0 0", rpy="0 0 0", parent="base", axis="0 0 1",
            com="0 0 0", com_rpy="0 0 0", mass=1.0, ixx=self.inertia, iyy=self.inertia,
            izz=self.inertia, ixy=0, ixz=0, iyz=0,
        )  # fmt: skip
        (folder / f"{name}.urdf").write_text(
            f'<robot name="{name}"><link name="base"/>{disk}</robot>'
        )
        scene = {
            "name": name,
            "urdf": f"{name}.urdf",
            "tool": f"{NAME}_link",
            "supply_voltage": data["supply_voltage"],
            "joints": {NAME: joint},
            "integrator": {"scheme": "rosenbrock", "dt": DT, "events": "located"},
            "servo_period": PERIOD,
            "external_wrench": True,
        }
        (folder / f"{name}.yaml").write_text(yaml.safe_dump(scene))
        self.plant = Plant(load_scene(str(folder / f"{name}.yaml")))

    @property
    def speed(self) -> float:
        """Return the speed of the rotor, seen at the output [rad/s]."""
        return float(self.plant.state.omega_m[0]) * self.ratio

    @property
    def torque(self) -> float:
        """Return the torque of the motor by its current, seen at the output [N m]."""
        return float(self.plant.state.current[0]) * self.constant

    def advance_period(self, torque: float, load: float) -> None:
        """Advance by a period with a torque of the motor, and one of the load against it."""
        command = torque / self.constant
        if self.resistance is not None:
            command = command * self.resistance + self.constant * self.speed
        self.plant.set_external_wrench(f"{NAME}_link", ExternalWrench(moment=[0.0, 0.0, -load]))
        self.plant.advance(np.array([command]), STEPS)

    def hold_load(self, load: float) -> None:
        """Load the joint and wait; the motor balances the load."""
        self.plant.reset()
        for k in range(1, SETTLED):
            part = load * min(1.0, 2.0 * k / SETTLED)
            self.advance_period(part, part)
        assert self.speed == 0.0, "the load is balanced"

    def measure_breakaway(self, kind: str, load: float, largest: float) -> float:
        """Return the friction at rest by a slow ramp, until the rotor moves [N m]."""
        self.hold_load(0.0 if kind == "off" else load)
        by = RAMP * largest * (1.0 if kind == "drives" else -1.0)
        torque, ramp, stiction = load, 0.0, 0.0
        while self.speed == 0.0:
            stiction = abs(ramp if kind == "off" else self.torque - load)
            ramp += by
            if kind == "off":
                self.advance_period(0.0, abs(ramp))
            else:
                self.advance_period(torque + ramp, load)
        return stiction

    def measure_motion(self, kind: str, w: float, load: float) -> float:
        """Return the friction at a constant speed that a servo holds, by what it takes [N m].

        Its torque is that of the motor, by the rotor's speed, or, while the motor has none, that of
        the load, by the disk's speed.
        """
        off = kind == "off"
        self.hold_load(0.0 if off else load)
        goal = w if kind == "drives" else -w
        gain = 2.0 * self.inertia * BANDWIDTH
        integral, torques = 0.0, []
        for k in range(MOVED):
            error = goal - (float(self.plant.state.v[0]) if off else self.speed)
            integral += RESET * PERIOD * error
            torque = gain * (error + integral)
            if off:
                self.advance_period(0.0, -torque)
            else:
                self.advance_period(load + torque, load)
            if k >= MOVED - MEASURED:
                torques.append(abs(torque) if off else abs(self.torque - load))
        assert abs(error) < 1e-6 * w, "the speed is constant"
        return float(np.mean(torques))

    def measure_friction(self, kind: str, w: float, load: float, largest: float) -> float:
        """Return the friction at a speed, or at rest [N m]."""
        if w == 0.0:
            return self.measure_breakaway(kind, load, largest)
        return self.measure_motion(kind, w, load)


def run_bench(quick: bool) -> dict[str, Any]:
    """Measure the friction of all joints."""
    chosen = list(JOINTS)[: 1 if quick else None]
    with tempfile.TemporaryDirectory() as folder, show_progress("joints", len(chosen)) as done:
        joints = {}
        for name in chosen:
            joints[name] = _measure_joint(JOINTS[name], Stand(name, Path(folder)))
            done(name)
    return {"joints": joints}


def _measure_joint(published: Published, stand: Stand) -> list[dict[str, Any]]:
    rows = []
    for where, part in SPEEDS.items():
        w = part * published.speed
        for kind in WORDS:
            loads = np.linspace(0.0, published.load, POINTS)
            if kind == "off":  # the load is what the friction is
                loads = np.array([published.solve_balance("off", w, 0.0)])
            ours = [stand.measure_friction(kind, w, load, published.load) for load in loads]
            theirs = [published.solve_balance(kind, w, load) for load in loads]
            rows.append({"where": where, "w": w, "kind": kind, "loads": loads.tolist(),
                         "ours": ours, "theirs": theirs})  # fmt: skip
    return rows


def write_report(figures: dict[str, Any]) -> str:
    """Return the table of errors."""
    rows = []
    for name, cases in figures["joints"].items():
        theirs = _join_cases(cases, "theirs")
        off = _join_cases(cases, "ours") - theirs
        at_rest = _join_cases([case for case in cases if case["w"] == 0.0], "theirs")
        rest_off = _join_cases([case for case in cases if case["w"] == 0.0], "ours") - at_rest
        rows.append((
            f"`{name}`", f"0 to {JOINTS[name].load:g} N m",
            f"{theirs.min():.3g} to {theirs.max():.3g} N m", len(off),
            *(f"{1e3 * np.abs(row).max():.2g} mN m, {1e3 * np.sqrt(np.mean(row**2)):.2g} mN m"
              for row in (rest_off, off[len(rest_off):])),
            f"{100 * np.abs(off / theirs).max():.2g} %",
        ))  # fmt: skip
    heads = ("joint", "load", "friction", "points", "at rest: largest, rms error",
             "in motion: largest, rms error", "largest, of the friction there")  # fmt: skip
    return format_table(heads, rows)


def _join_cases(cases: list[dict[str, Any]], key: str) -> Array:
    return np.concatenate([case[key] for case in cases])


def draw_figures(figures: dict[str, Any], folder: Path) -> None:
    """Draw the measured points over the published curves."""
    figure = make_figure(12.0, 6.6)
    joints = figures["joints"].items()
    for axes, (name, cases) in zip(figure.subplots(2, 3).flat, joints, strict=False):
        published = JOINTS[name]
        loads = np.linspace(0.0, published.load, CURVE)
        axes.plot(loads, loads, ":", color="grey", lw=1.0, label="friction = load")
        for case in cases:
            kind, style = case["kind"], ("-", "--", "-.")[list(SPEEDS).index(case["where"])]
            colour = f"C{list(WORDS).index(kind)}"
            if kind != "off":
                curve = [published.solve_balance(kind, case["w"], load) for load in loads]
                axes.plot(loads, curve, style, color=colour, lw=1.2,
                          label=f"{WORDS[kind]}, {case['where']}")  # fmt: skip
            label = None
            if case["w"] == 0.0:
                label = f"measured: {WORDS[kind]}"
            axes.plot(case["loads"], case["ours"], "s" if kind == "off" else "o", color=colour,
                      ms=4.5, mfc="none", label=label)  # fmt: skip
        axes.set(title=name, xlabel="load, N m", ylabel="friction, N m",
                 xlim=(0.0, 1.04 * published.load))  # fmt: skip
        axes.set_ylim(0.0, 1.15 * max(_join_cases(cases, "theirs")))
    lines, labels = figure.axes[0].get_legend_handles_labels()
    figure.legend(lines, labels, loc="outside lower center", ncols=3)
    save_picture(figure, folder, PICTURE)


if __name__ == "__main__":
    print(write_report(run_bench(False)))
