"""The Manutec r3 with its published controllers, against an independent solution."""

import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.progress import track
from rich.table import Table
from scipy.interpolate import CubicHermiteSpline, PchipInterpolator

from arm_emulator.extension.base import Array, find_config_folder
from arm_emulator.extension.compiler import TICK_FOLDERS, Header, c_pointer
from arm_emulator.extension.machine import ARM_OK, SCHEMES, Plant, load_machine_with, load_scene

AXES = 6
END = 1.8560450019  # s
# Largest speeds and accelerations of the axes on the path, and its end.
Q_BEGIN = np.radians([-60.0, 20.0, 90.0, 0.0, -110.0, 0.0])
Q_END = np.radians([60.0, -70.0, -35.0, 45.0, 110.0, 45.0])
LARGEST_SPEED = np.array([3.0, 1.5, 5.0, 3.1, 3.1, 4.1])  # rad/s
LARGEST_ACCELERATION = np.array([15.0, 15.0, 15.0, 60.0, 60.0, 60.0])  # rad/s2
# Of the current regulators.
REGULATOR_W = np.array([4590.0, 5500.0, 5500.0, 6250.0, 6250.0, 7400.0])  # rad/s
REGULATOR_D = np.array([0.6, 0.6, 0.6, 0.55, 0.55, 0.27])

CONTROLLERS = Path(__file__).with_suffix(".hpp")
ELASTIC = slice(0, 3)  # axes with elastic gears


@dataclass(frozen=True)
class SimulatedMotion:
    """A motion of all axes: rows of time. Motor quantities of rigid gears are the links'."""

    t: Array  # s, (K,)
    current: Array  # A, (K, 6)
    theta_m: Array  # rad
    omega_m: Array  # rad/s
    q: Array  # rad
    v: Array  # rad/s
    seconds: float = 0.0  # that it took to compute

    @property
    def friction_mode(self) -> Array:
        """-1, 0 where an axis is stuck, 1; at the motor of axes 1 to 3, at the link of the rest."""
        return np.sign(np.hstack([self.omega_m[:, ELASTIC], self.v[:, 3:]]))


@cache
def get_gear_ratios() -> Array:
    """Return the motor angles per unit link angles."""
    return 1.0 / load_scene("manutec_r3").gear_ratios


@cache
def load_solution() -> tuple[SimulatedMotion, Array, Array, Array]:
    """Return the independent solution, its friction modes, and the controllers' initial states.

    Runge-Kutta with located events, by a program of others; 2e-11 is the error of a step. It agrees
    with Dymola's published one to 4.7e-9 rad.
    """
    data = np.load(find_config_folder() / "validation" / "manutec_r3" / "solution.npz")
    ratios = get_gear_ratios()
    theta_m, omega_m = data["q"] * ratios, data["v"] * ratios
    theta_m[:, ELASTIC], omega_m[:, ELASTIC] = data["motor_angle"], data["motor_speed"]
    motion = SimulatedMotion(data["t"], data["current"], theta_m, omega_m, data["q"], data["v"])
    modes = data["friction_mode"].astype(float)
    return motion, modes, data["pi_state"][0], data["regulator_state"][0]


def simulate(
    period: float = 5e-5, scheme: str = SCHEMES[0], events: str = "located"
) -> SimulatedMotion:
    """Compute the whole motion.

    Args:
        period: of the controllers, and step of the integrator [s].
        scheme: of the integrator.
        events: located, or at the ends of steps.

    Raises:
        Diverged: the scheme does not hold at this step.
    """
    integrator = {"scheme": scheme, "dt": period, "events": events}
    scene = load_scene("manutec_r3", {"servo_period": period, "integrator": integrator})
    header = Header(CONTROLLERS.with_suffix(".h"), TICK_FOLDERS)
    plant = Plant(
        scene, core=load_machine_with(scene, "controllers", CONTROLLERS.read_text(), header)
    )
    truth, _, x, C = load_solution()
    plant.put("manutec_r3", {
        "current": truth.current[0], "theta_m": truth.theta_m[0], "omega_m": truth.omega_m[0],
        "q": truth.q[0], "v": truth.v[0],
    })  # fmt: skip
    travel = Q_END - Q_BEGIN
    axes = header.make_rows("manutec_axis", AXES)
    for name, values in {
        "n": get_gear_ratios(), "w": REGULATOR_W, "D": REGULATOR_D, "begin": Q_BEGIN, "way": travel,
        "x": x, "C": C,
    }.items():  # fmt: skip
        axes[name] = values
    # All axes begin and end together (Modelica's KinematicPTP2).
    rate, change = (
        1.0 / (abs(travel) / LARGEST_SPEED).max(),
        1.0 / (abs(travel) / LARGEST_ACCELERATION).max(),
    )
    path = header.make_struct("manutec_path", rate=rate, change=change)
    periods = int(END / period + 1e-6)
    out = np.empty((periods + 1, 5, AXES))
    began = time.perf_counter()
    result = plant.core.manutec_run(
        plant.ticks,
        header.make_pointer("manutec_axis", axes),
        path,
        period,
        periods,
        c_pointer(out),
    )
    seconds = time.perf_counter() - began
    if result != ARM_OK:
        raise plant.diverged or RuntimeError("manutec_run: refused")
    i, theta_m, omega_m, q, v = np.moveaxis(out, 1, 0)
    t: Array = period * np.arange(periods + 1.0)
    return SimulatedMotion(t, i, theta_m, omega_m, q, v, seconds)


@dataclass(frozen=True)
class SolutionErrors:
    """Largest deviations of a motion from the solution, by axis."""

    q: Array  # rad
    v: Array  # rad/s
    current: Array  # A
    wind_up: Array  # rad at the motor, axes 1 to 3
    other_modes: int  # rows in which an axis sticks or slides otherwise
    rows: int


def compare(motion: SimulatedMotion) -> SolutionErrors:
    """Compare a motion with the solution, at the solution's instants."""
    truth, modes, _, _ = load_solution()
    inside = truth.t <= motion.t[-1]
    t = truth.t[inside]
    q = CubicHermiteSpline(motion.t, motion.q, motion.v)(t)
    others = {
        name: PchipInterpolator(motion.t, getattr(motion, name))(t)
        for name in ("v", "current", "theta_m")
    }

    def find_largest(differences: Array) -> Array:
        maximum: Array = np.abs(differences).max(axis=0)
        return maximum

    ratios = get_gear_ratios()
    wind_up = (ratios * q - others["theta_m"])[:, ELASTIC]
    expected_wind_up = (ratios * truth.q - truth.theta_m)[inside][:, ELASTIC]
    now = np.searchsorted(motion.t, t + 1e-9, side="right") - 1
    same = motion.friction_mode[now] == modes[inside]
    return SolutionErrors(
        find_largest(q - truth.q[inside]),
        find_largest(others["v"] - truth.v[inside]),
        find_largest(others["current"] - truth.current[inside]),
        find_largest(wind_up - expected_wind_up),
        int((~same).any(axis=1).sum()),
        len(t),
    )


WIDTH = 110  # characters of the table
PERIODS = (2e-4, 1e-4, 5e-5, 2e-5, 1e-5, 5e-6, 2e-6)  # s, servo period and step
PICTURED = 5e-5  # s, of which angles and currents are drawn


# Limits at the drawn period; the solution itself is accurate to 5e-9 rad.
LIMITS = {"q": 1e-6, "v": 1e-3, "current": 5e-3, "wind_up": 5e-5}
MAX_FURTHER_MODES = 0.01  # of the rows: the solution has two at each instant of change
ORDER = (1.8, 2.2)  # of the angles' error, over the periods from 50 to 5 us
MIN_SPEED = 1.0  # times real time


def validate_manutec(folder: Path, console: Console) -> dict[str, Any]:
    """Compare, print, draw into a folder, and return the same for programs."""
    table = Table(title="Manutec r3 against the independent solution, largest differences")
    for heading in ("period, us", "angles, rad", "speeds, rad/s", "currents, A",
                    "wind-up at the motor, rad", "rows in other friction modes",
                    "times real time"):  # fmt: skip
        table.add_column(heading, justify="right")
    comparisons: dict[float, tuple[SolutionErrors, float]] = {}
    longest_motion = None
    for period in track(PERIODS, "manutec_r3", console=Console(stderr=True)):
        motion = min((simulate(period) for _ in range(3)), key=lambda run: run.seconds)
        comparison, speed = compare(motion), END / motion.seconds
        comparisons[period] = comparison, speed
        if period == PICTURED:
            longest_motion = motion
        table.add_row(
            f"{1e6 * period:g}", f"{comparison.q.max():.2g}", f"{comparison.v.max():.2g}",
            f"{comparison.current.max():.2g}", f"{comparison.wind_up.max():.2g}",
            f"{comparison.other_modes} of {comparison.rows}", f"{speed:.0f}",
        )  # fmt: skip
    console.print(table)
    assert longest_motion is not None
    picture = folder / "manutec_r3.png"
    draw(
        longest_motion,
        [(period, comparison) for period, (comparison, _) in comparisons.items()],
        picture,
    )
    failures = list(list_failures(comparisons))
    for failure in failures:
        console.print(f"[red]{failure}")
    order = order_of(comparisons)
    verdict = "NOT GOOD" if failures else "good"
    console.print(f"order of the angles' error {order:.2f}; {verdict}; picture: {picture}")
    rows = [
        {
            "period": period,
            **{name: float(getattr(comparison, name).max()) for name in LIMITS},
            "other_modes": comparison.other_modes,
            "rows": comparison.rows,
            "speed": speed,
        }
        for period, (comparison, speed) in comparisons.items()
    ]
    return {
        "good": not failures,
        "failures": failures,
        "order": order,
        "rows": rows,
        "pictures": [picture],
    }


def order_of(by_period: Mapping[float, tuple[SolutionErrors, float]]) -> float:
    """Return the slope of the angles' error over the period, both as logarithms."""
    periods = [period for period in by_period if 5e-6 <= period <= PICTURED]
    errors = [by_period[period][0].q.max() for period in periods]
    return float(np.polyfit(np.log(periods), np.log(errors), 1)[0])


def list_failures(
    by_period: Mapping[float, tuple[SolutionErrors, float]],
) -> Iterator[str]:
    """Yield each exceeded limit, as a line: figures at `PICTURED`, order, and modes."""
    at, speed = by_period[PICTURED]
    where = f"at {1e6 * PICTURED:g} us"
    for name, limit in LIMITS.items():
        value = float(getattr(at, name).max())
        if not value <= limit:
            yield f"{where}: {name} must be within {limit:g}, got {value:.3g}"
    if not speed >= MIN_SPEED:
        yield f"{where}: speed must be >= {MIN_SPEED:g} times real time, got {speed:.3g}"
    for period, (comparison, _) in by_period.items():
        if not comparison.other_modes <= MAX_FURTHER_MODES * comparison.rows:
            yield (
                f"at {1e6 * period:g} us: rows in other friction modes must be <= "
                f"{MAX_FURTHER_MODES:.0%}, got {comparison.other_modes} of {comparison.rows}"
            )
    order = order_of(by_period)
    if not ORDER[0] <= order <= ORDER[1]:
        yield f"order of the angles' error must be {ORDER[0]:g} to {ORDER[1]:g}, got {order:.2f}"


def draw(
    motion: SimulatedMotion, by_period: Sequence[tuple[float, SolutionErrors]], file: Path
) -> None:
    """Draw angles, currents, friction modes, and the error over the period."""
    from matplotlib.figure import Figure  # not pyplot: no screen, no global state

    truth, modes, _, _ = load_solution()
    figure = Figure(figsize=(12, 7.5), layout="constrained")
    (angles, currents), (sticking, errors) = figure.subplots(2, 2)
    for j in range(AXES):
        colour = f"C{j}"
        for axes, name in ((angles, "q"), (currents, "current")):
            values = getattr(motion, name)[:, j]
            axes.plot(motion.t, values, color=colour, label=f"axis {j + 1}")
            axes.plot(truth.t[::60], getattr(truth, name)[::60, j], ".", color=colour, ms=4)
        lift = 2.5 * j
        sticking.plot(motion.t, motion.friction_mode[:, j] + lift, color=colour, lw=1)
        sticking.plot(truth.t[::20], modes[::20, j] + lift, ".", color=colour, ms=3)
    angles.set(title="link angles (points: the solution)", xlabel="s", ylabel="rad")
    angles.legend(loc="upper right", fontsize="small", ncols=2)  # "best" is slow
    currents.set(title="motor currents", xlabel="s", ylabel="A")
    sticking.set(title="slides back, sticks, slides on", xlabel="s")
    sticking.set(yticks=2.5 * np.arange(AXES), yticklabels=[f"axis {j + 1}" for j in range(AXES)])
    period = np.array([period_of for period_of, _ in by_period])
    off = np.array([[c.q.max(), c.current.max()] for _, c in by_period])
    errors.loglog(1e6 * period, off[:, 0], "o-", label="angles, rad")
    errors.loglog(1e6 * period, off[:, 1], "s-", label="currents, A")
    errors.loglog(1e6 * period, off[-1, 0] * (period / period[-1]) ** 2, "k:", label="order 2")
    errors.set(title="largest difference", xlabel="servo period = step, us")
    errors.legend(loc="lower right", fontsize="small")
    for axes in (angles, currents, sticking, errors):
        axes.grid(alpha=0.3)
    file.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(file, dpi=110)
