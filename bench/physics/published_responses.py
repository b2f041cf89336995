"""Frequency responses of published arms beside ours: a picture and its table.

python -m bench.physics.published_responses
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from arm_emulator import LinearMachine, Plant, linearise, load_scene
from arm_emulator.analysis.stability import compute_rest
from arm_emulator.base.arrays import Array
from bench.pictures import make_figure, save_picture
from bench.tables import format_table

TITLE = "Published frequency responses"

ROOT = Path(__file__).resolve().parents[2] / "config" / "validation"
PICTURE = "published_responses"


@dataclass(frozen=True)
class Masses:
    """A published axis as masses in a row, the motor first, all at its side.

    Attributes:
        inertias: (K,) [kg m2].
        springs: stiffness and damping between them, (K - 1, 2) [N m/rad, N m s/rad].
        friction: of each against the ground, viscous (K,) [N m s/rad].
    """

    name: str
    inertias: tuple[float, ...]
    springs: tuple[tuple[float, float], ...]
    friction: tuple[float, ...]

    @property
    def scene(self) -> str:
        """File of our scene of it."""
        return str(ROOT / self.name / f"{self.name}.yaml")

    def compute_response(self, frequencies: Array) -> Array:
        """Return the motor's speed per torque, complex (F,) [rad/s per N m]."""
        count, out = len(self.inertias), []
        for w in 2.0 * np.pi * frequencies:
            s = 1j * w
            table = np.diag(np.array(self.inertias) * s**2 + s * np.array(self.friction))
            for k, (stiffness, damping) in enumerate(self.springs):
                pair = np.ix_((k, k + 1), (k, k + 1))
                table[pair] += (stiffness + s * damping) * np.array([[1.0, -1.0], [-1.0, 1.0]])
            out.append(s * np.linalg.solve(table, np.eye(count)[0])[0])
        return np.array(out)


# Sources: SOURCE.md beside the scenes.
_J, _OF_MOTOR, _OF_GEAR = 0.03291699877416, 0.17910964111956, 0.61206166914114
ABB = (
    Masses(
        "abb_axis_1",
        (_J * _OF_MOTOR, _J * _OF_GEAR, _J * (1.0 - _OF_MOTOR - _OF_GEAR)),
        ((20.59269827430799, 0.0624181404729), (20.23072060978318, 0.00987527995798)),
        (0.00986346744839, 0.0, 0.0),
    ),
    Masses(
        "abb_benchmark",
        (5e-3, 2e-3, 0.02, 0.02),
        ((100.0, 0.08), (110.0, 0.06), (80.0, 0.08)),
        (6e-3, 1e-3, 1e-3, 1e-3),
    ),
)
FREQUENCIES = np.geomspace(1.0, 100.0, 4001)  # Hz
RUNS = ("A", "B")
AXES = 3  # of the KR 300 with a known stiffness
LOWEST, HIGHEST = 4.0, 30.0  # Hz, between the commanded motion and the noise
SAMPLES = 1024  # of a piece of the spectrum
EVERY = 50  # samples from one pose to the next


def run_bench(quick: bool) -> dict[str, Any]:
    """Compute the responses of the ABB axes, and the modes of the KR 300 beside its record."""
    spectra = {name: _read_spectrum(name) for name in RUNS}
    scene = load_scene("kuka_kr300")
    plant = Plant(scene)
    stiffness = np.diag([joint.gear.stiffness for joint in scene.joints[:AXES]])
    modes = np.array([_find_locked_modes(plant, stiffness, q) for q in _read_poses()])
    return {
        "abb": {axis.name: _compare_responses(axis) for axis in ABB},
        "kr300": {"spectra": spectra, "least": modes.min(axis=0).tolist(),
                  "most": modes.max(axis=0).tolist()},
    }  # fmt: skip


def _compare_responses(axis: Masses) -> dict[str, Any]:
    """Return the published response, ours, and their peaks."""
    machine = load_scene(axis.scene)
    theirs = axis.compute_response(FREQUENCIES)
    ours = _compute_response(linearise(machine, machine.start), FREQUENCIES)
    return {
        "theirs": np.abs(theirs).tolist(),
        "ours": np.abs(ours).tolist(),
        "off": float(np.abs(np.abs(ours / theirs) - 1.0).max()),
        "resonances": [_find_peaks(row, 1.0) for row in (theirs, ours)],
        "antiresonances": [_find_peaks(row, -1.0) for row in (theirs, ours)],
    }


def _compute_response(linear: LinearMachine, frequencies: Array) -> Array:
    """Return the machine's motor speed per command of the first joint, complex (K,)."""
    s = 2j * np.pi * frequencies
    x = np.linalg.solve(s[:, None, None] * np.eye(len(linear.A)) - linear.A, linear.B[:, [0]])
    return np.asarray(s * (x[..., 0] @ linear.theta_m[0]))


def _find_peaks(response: Array, sign: float) -> list[float]:
    from scipy import signal

    peaks, _ = signal.find_peaks(sign * np.log(np.abs(response)), prominence=0.1)
    return [float(frequency) for frequency in FREQUENCIES[peaks]]


def _read_run(name: str) -> Any:
    return np.load(ROOT / "kuka_kr300" / f"run_{name}.npz")


def _read_spectrum(name: str) -> dict[str, Any]:
    """Return the spectrum of the motor torques of a measured run, and its largest peak per axis."""
    from scipy import signal

    record = _read_run(name)
    rate = 1.0 / (record["t"][1] - record["t"][0])
    f, power = signal.welch(record["tau_abs"][:, :AXES], rate, nperseg=SAMPLES, axis=0)
    band = (f >= LOWEST) & (f <= HIGHEST)
    peaks = [float(f[band][np.argmax(row[band])]) for row in power.T]
    return {"f": f.tolist(), "power": power.T.tolist(), "peaks": peaks}


def _read_poses() -> Array:
    return np.concatenate([np.radians(_read_run(name)["q_mot"][::EVERY]) for name in RUNS])


def _find_locked_modes(plant: Plant, stiffness: Array, q: Array) -> Array:
    """Return the frequencies of the first axes with all rotors held (3,) [Hz]."""
    M = np.linalg.inv(compute_rest(plant, q)[0])[:AXES, :AXES]
    squares = np.linalg.eigvals(np.linalg.solve(M, stiffness)).real
    return np.asarray(np.sort(np.sqrt(squares)) / (2.0 * np.pi))


def write_report(figures: dict[str, Any]) -> str:
    """Return the table."""
    kr300 = figures["kr300"]

    def show_values(values: list[float]) -> str:
        return ", ".join(f"{value:.2f}" for value in values) + " Hz"

    rows: list[tuple[str, ...]] = []
    for name, abb in figures["abb"].items():
        for key in ("antiresonances", "resonances"):
            theirs, ours = abb[key]
            off = max(abs(b / a - 1.0) for a, b in zip(theirs, ours, strict=True))
            rows.append(
                (f"`{name}`", key, show_values(theirs), show_values(ours), f"{100 * off:.2f} %")
            )
        rows.append((f"`{name}`", "gain, 1 to 100 Hz", "", "", f"{100 * abb['off']:.2g} %"))
    ranges = [f"{a:.1f} to {b:.1f}" for a, b in zip(kr300["least"], kr300["most"], strict=True)]
    for name, spectrum in kr300["spectra"].items():
        rows.append((f"`kuka_kr300`, run {name}", "largest swing of the torques, axes 1 to 3",
                     show_values(spectrum["peaks"]), ", ".join(ranges) + " Hz", ""))  # fmt: skip
    heads = ("arm", "quantity", "published", "ours", "off")
    return format_table(heads, rows)


def draw_figures(figures: dict[str, Any], folder: Path) -> None:
    """Draw the responses of the ABB axes, and torques of the KR 300 beside its first mode."""
    figure = make_figure(12.0, 3.6)
    *left, right = figure.subplots(1, 1 + len(ABB))
    for axes, (name, abb) in zip(left, figures["abb"].items(), strict=True):
        axes.loglog(FREQUENCIES, abb["theirs"], color="C1", lw=3.0, label="published")
        axes.loglog(FREQUENCIES, abb["ours"], "--", color="C0", label="ours")
        for key, colour in (("antiresonances", "grey"), ("resonances", "black")):
            for frequency in abb[key][1]:
                axes.axvline(frequency, color=colour, lw=0.6)
        axes.set(title=name, xlabel="Hz", ylabel="motor's speed, rad/s per N m")
    left[0].legend()
    kr300 = figures["kr300"]
    for axis in range(AXES):
        for name, line in zip(RUNS, ("-", "--"), strict=True):
            spectrum = kr300["spectra"][name]
            right.semilogy(spectrum["f"], spectrum["power"][axis], line, color=f"C{axis}", lw=1.0,
                           label=f"axis {axis + 1}" if name == RUNS[0] else None)  # fmt: skip
    right.axvspan(kr300["least"][0], kr300["most"][0], color="grey", alpha=0.3, label="first mode")
    right.set(title="kuka_kr300: measured torques", xlabel="Hz",
              ylabel="(N m)²/Hz at the motors", xlim=(2.0, 40.0), ylim=(1e-4, 1.0))  # fmt: skip
    right.legend()
    save_picture(figure, folder, PICTURE)


if __name__ == "__main__":
    print(write_report(run_bench(False)))
