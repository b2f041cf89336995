"""Frequency responses of published arms beside ours: a picture and its table.

python -m bench.published_responses
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from scipy import signal

from arm_emulator import LinearMachine, Plant, linearise, load_scene
from arm_emulator.analysis.stability import at_rest
from arm_emulator.base.arrays import Array
from bench.pictures import new_figure, save
from bench.tables import table

TITLE = "Published frequency responses"

ROOT = Path(__file__).resolve().parents[1] / "config" / "validation"
ABB = ROOT / "abb_axis_1" / "abb_axis_1.yaml"
PICTURE = "published_responses"
# E. Wernholt, S. Gunnarsson, 2006: config/validation/abb_axis_1/SOURCE.md.
J, SHARES = 0.03291699877416, (0.17910964111956, 0.61206166914114)
GEAR, ARM = (20.59269827430799, 0.0624181404729), (20.23072060978318, 0.00987527995798)
VISCOUS = 0.00986346744839
FREQUENCIES = np.geomspace(1.0, 100.0, 4001)  # Hz
RUNS = ("A", "B")
AXES = 3  # of the KR 300 with a known stiffness
LEAST, MOST = 4.0, 30.0  # Hz, between the commanded motion and the noise
SAMPLES = 1024  # of a piece of the spectrum
EVERY = 50  # samples from one pose to the next


def run(quick: bool) -> dict[str, Any]:
    """Compute the response of the ABB axis, and the modes of the KR 300 beside its record."""
    machine = load_scene(str(ABB))
    linear = linearise(machine, machine.start)
    theirs, ours = respond(FREQUENCIES), _respond(linear, FREQUENCIES)
    spectra = {name: _read_spectrum(name) for name in RUNS}
    scene = load_scene("kuka_kr300")
    plant = Plant(scene)
    stiffness = np.diag([joint.gear.stiffness for joint in scene.joints[:AXES]])
    modes = np.array([_find_locked_modes(plant, stiffness, q) for q in _read_poses()])
    return {
        "abb": {
            "theirs": np.abs(theirs).tolist(),
            "ours": np.abs(ours).tolist(),
            "off": float(np.abs(ours / theirs - 1.0).max()),
            "resonances": [_find_peaks(row, 1.0) for row in (theirs, ours)],
            "antiresonances": [_find_peaks(row, -1.0) for row in (theirs, ours)],
        },
        "kr300": {"spectra": spectra, "least": modes.min(axis=0).tolist(),
                  "most": modes.max(axis=0).tolist()},
    }  # fmt: skip


def respond(frequencies: Array) -> Array:
    """Return the published axis's motor speed per torque, complex (K,) [rad/s per N m]."""
    inertias = J * np.array([*SHARES, 1.0 - sum(SHARES)])
    out = []
    for w in 2.0 * np.pi * frequencies:
        s = 1j * w
        gear, arm = GEAR[0] + s * GEAR[1], ARM[0] + s * ARM[1]
        springs = np.array([[gear, -gear, 0.0], [-gear, gear + arm, -arm], [0.0, -arm, arm]])
        springs[0, 0] += s * VISCOUS
        out.append(s * np.linalg.solve(np.diag(inertias) * s**2 + springs, [1.0, 0.0, 0.0])[0])
    return np.array(out)


def _respond(linear: LinearMachine, frequencies: Array) -> Array:
    """Return the machine's motor speed per command of the first joint, complex (K,)."""
    s = 2j * np.pi * frequencies
    x = np.linalg.solve(s[:, None, None] * np.eye(len(linear.A)) - linear.A, linear.B[:, [0]])
    return np.asarray(s * (x[..., 0] @ linear.theta_m[0]))


def _find_peaks(response: Array, sign: float) -> list[float]:
    peaks, _ = signal.find_peaks(sign * np.log(np.abs(response)), prominence=0.1)
    return [float(one) for one in FREQUENCIES[peaks]]


def _read_run(name: str) -> Any:
    return np.load(ROOT / "kuka_kr300" / f"run_{name}.npz")


def _read_spectrum(name: str) -> dict[str, Any]:
    """Return the spectrum of the motor torques of a measured run, and its largest peak per axis."""
    record = _read_run(name)
    rate = 1.0 / (record["t"][1] - record["t"][0])
    f, power = signal.welch(record["tau_abs"][:, :AXES], rate, nperseg=SAMPLES, axis=0)
    band = (f >= LEAST) & (f <= MOST)
    peaks = [float(f[band][np.argmax(row[band])]) for row in power.T]
    return {"f": f.tolist(), "power": power.T.tolist(), "peaks": peaks}


def _read_poses() -> Array:
    return np.concatenate([np.radians(_read_run(name)["q_mot"][::EVERY]) for name in RUNS])


def _find_locked_modes(plant: Plant, stiffness: Array, q: Array) -> Array:
    """Return the frequencies of the first axes with all rotors held (3,) [Hz]."""
    M = np.linalg.inv(at_rest(plant, q)[0])[:AXES, :AXES]
    squares = np.linalg.eigvals(np.linalg.solve(M, stiffness)).real
    return np.asarray(np.sort(np.sqrt(squares)) / (2.0 * np.pi))


def report(figures: dict[str, Any]) -> str:
    """Return the table."""
    abb, kr300 = figures["abb"], figures["kr300"]

    def show(values: list[float]) -> str:
        return ", ".join(f"{one:.2f}" for one in values) + " Hz"

    rows: list[tuple[str, ...]] = []
    for key in ("antiresonances", "resonances"):
        theirs, ours = abb[key]
        off = max(abs(b / a - 1.0) for a, b in zip(theirs, ours, strict=True))
        rows.append(
            ("ABB, axis 1, three masses", key, show(theirs), show(ours), f"{100 * off:.2f} %")
        )
    off = f"{abb['off']:.1e}"
    rows.append(("ABB, axis 1, three masses", "response, 1 to 100 Hz", "", "", off))
    ranges = [f"{a:.1f} to {b:.1f}" for a, b in zip(kr300["least"], kr300["most"], strict=True)]
    for name, spectrum in kr300["spectra"].items():
        rows.append((f"KUKA KR 300, run {name}", "largest swing of the torques, axes 1 to 3",
                     show(spectrum["peaks"]), ", ".join(ranges) + " Hz", ""))  # fmt: skip
    heads = ("arm", "quantity", "published", "ours", "off")
    return table(heads, rows)


def draw(figures: dict[str, Any], folder: Path) -> None:
    """Draw the ABB axis's response, and the KR 300's torques beside the modes of its scene."""
    figure = new_figure(9.5, 3.6)
    left, right = figure.subplots(1, 2)
    abb = figures["abb"]
    left.loglog(FREQUENCIES, abb["theirs"], color="C1", lw=3.0, label="published")
    left.loglog(FREQUENCIES, abb["ours"], "--", color="C0", label="ours")
    for key, colour in (("antiresonances", "grey"), ("resonances", "black")):
        for frequency in abb[key][1]:
            left.axvline(frequency, color=colour, lw=0.6)
    left.set(title="ABB, axis 1", xlabel="Hz", ylabel="motor's speed, rad/s per N m")
    left.legend()
    kr300 = figures["kr300"]
    for axis in range(AXES):
        for name, line in zip(RUNS, ("-", "--"), strict=True):
            spectrum = kr300["spectra"][name]
            right.semilogy(spectrum["f"], spectrum["power"][axis], line, color=f"C{axis}", lw=1.0,
                           label=f"axis {axis + 1}" if name == RUNS[0] else None)  # fmt: skip
    right.axvspan(kr300["least"][0], kr300["most"][0], color="grey", alpha=0.3, label="first mode")
    right.set(title="KUKA KR 300: measured torques", xlabel="Hz",
              ylabel="(N m)²/Hz at the motors", xlim=(2.0, 40.0), ylim=(1e-4, 1.0))  # fmt: skip
    right.legend()
    save(figure, folder, PICTURE)


if __name__ == "__main__":
    print(report(run(False)))
