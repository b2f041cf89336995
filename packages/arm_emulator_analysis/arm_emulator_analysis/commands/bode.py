"""Show how each joint answers to commands over frequency: resonances, modes, Bode plot, table."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np
import numpy.typing as npt
from cyclopts import Parameter

from arm_emulator import LinearMachine, linearise
from arm_emulator.extension.base import POSITION, Array, Number, Refusal
from arm_emulator.extension.commands import SceneName, command, output
from arm_emulator.extension.machine import (
    Plant,
    Scene,
    draw_poses,
    find_vibration_modes,
    load_scene,
)
from arm_emulator.extension.runs import check_servo, load_gains

FREQUENCY = Number("--low and --high", "Hz", at_least=1e-3, at_most=1e6)
POSE = POSITION.rename("--pose")
PER_DECADE = 2000  # frequencies
ROWS = slice(None, None, 20)  # of them in tables
MODES = 8  # that are listed
SHAPED = 2  # of them, for the shaper


@command(
    keys="`scene`, `pose`, `frequency` [Hz], `joints`: by name `unit` of the command, `resonances` "
    "and `antiresonances` [Hz], and of the speeds of `motor` and `link` the `gain` [rad/s or m/s "
    "per unit] and the `phase` [rad]; with the option closed, `modes`: `frequency` [Hz], "
    "`damping`, `swing` [m/(m/s2)], and `range`: least and largest first frequency over poses [Hz]"
)
def show_frequency_responses(
    scene: SceneName = "three_axis",
    /,
    *,
    pose: Annotated[tuple[float, ...] | None, Parameter(consume_multiple=True)] = None,
    low: Annotated[float, Parameter(metavar="HZ")] = 1.0,
    high: Annotated[float | None, Parameter(metavar="HZ")] = None,
    picture: Annotated[Path | None, Parameter(metavar="PNG")] = None,
    table: Annotated[Path | None, Parameter(metavar="CSV")] = None,
    closed: bool = False,
) -> int:
    """Show the frequency response from the command of each joint to its speeds.

    The arm is linearised about rest in a pose, without dry friction; other commands are held.

    Args:
        pose: of the joints, base to tool (rad or m; default: the scene's start).
        low: lowest frequency.
        high: highest frequency (default: half that of the servo).
        picture: gains and phases as a picture.
        table: gains and phases as a table.
        closed: add the modes of the machine under its servos, for the input shaper.
    """
    machine = load_scene(scene)
    highest = 0.5 / machine.servo_period if high is None else FREQUENCY.check_value("bode", high)
    if FREQUENCY.check_value("bode", low) >= highest:
        raise Refusal("bode", "--low", f"be below the highest frequency, {highest:g} Hz", low)
    count = 1 + round(PER_DECADE * np.log10(highest / low))
    frequency = np.geomspace(low, highest, max(2, count))
    q = machine.start if pose is None else POSE.check_row("bode", pose, len(machine.joints))
    linear = linearise(machine, q)
    responses = {
        joint.name: compute_frequency_response(linear, j, frequency)
        for j, joint in enumerate(machine.joints)
        if joint.motor is not None
    }
    width = max(map(len, responses))
    for name, response in responses.items():
        listed = (
            _format_frequencies(values) for values in (response.antiresonances, response.resonances)
        )
        output.print_line("{:{}}  antiresonances {:24} resonances {}".format(name, width, *listed))
    for file, write in ((picture, _draw_responses), (table, _write_responses)):
        if file is not None:
            try:
                write(machine, responses, file)
            except (OSError, ValueError) as error:
                raise Refusal("bode", str(file), "be writable", error) from None
            output.print_line(str(file))
    units = {joint.name: joint.unit for joint in machine.joints}
    output.add_facts({
        "scene": machine.name, "pose": linear.x0[linear.q], "frequency": frequency[ROWS],
        "joints": {name: _list_facts(of, units[name]) for name, of in responses.items()},
    })  # fmt: skip
    if closed:
        _list_modes(scene, machine, linear.x0[linear.q])
    return 0


def _list_modes(name: str, machine: Scene, q: Array) -> None:
    """Print the modes of the machine under the servos that belong to it."""
    servo, plant = load_gains(name).servo, Plant(machine)
    check_servo(machine, servo)
    modes = find_vibration_modes(plant, servo, q)
    if not modes:
        output.print_line("under its servos no mode swings")
    rows = [
        (f"{mode.frequency:.2f}", f"{mode.damping:.3f}", f"{1e3 * mode.swing:.2g}")
        for mode in modes[:MODES]
    ]
    heads = "Hz", "damping", "tool, mm per m/s² that begins at once"
    output.print_table(heads, rows, title="modes under the servos")
    firsts = [find_vibration_modes(plant, servo, pose)[:1] for pose in draw_poses(machine)]
    frequencies = [first[0].frequency for first in firsts if first]
    ends = [min(frequencies), max(frequencies)] if frequencies else None
    if ends is not None:
        output.print_line(f"the first over {len(firsts)} poses: {ends[0]:.3g} to {ends[1]:.3g} Hz")
        output.print_line("for the motion controller's file:")
        output.print_line("    shaper: zvd\n    modes:")
        for count, mode in enumerate(modes[:SHAPED], 1):
            numbers = f"{{frequency: {mode.frequency:.4g}, damping: {mode.damping:.3g}}}"
            output.print_line(f"      mode_{count}: {numbers}")
    facts = [{"frequency": m.frequency, "damping": m.damping, "swing": m.swing} for m in modes]
    output.add_facts({"modes": facts, "range": ends})


def _format_frequencies(frequencies: np.ndarray) -> str:
    return (
        ", ".join(f"{frequency:.4g}" for frequency in frequencies) + " Hz"
        if len(frequencies)
        else "none"
    )


def _list_facts(of: FrequencyResponse, unit: str) -> dict[str, object]:
    return {
        "unit": unit, "resonances": of.resonances, "antiresonances": of.antiresonances,
        **{
            name: {"gain": np.abs(response[ROWS]), "phase": np.unwrap(np.angle(response))[ROWS]}
            for name, response in (("motor", of.motor), ("link", of.link))
        },
    }  # fmt: skip


def _write_responses(scene: Scene, responses: dict[str, FrequencyResponse], file: Path) -> None:
    columns = {"frequency": next(iter(responses.values())).frequency}
    for name, response in responses.items():
        for of, values in (("motor", response.motor), ("link", response.link)):
            columns[f"{name}.{of}.gain"] = np.abs(values)
            columns[f"{name}.{of}.phase"] = np.unwrap(np.angle(values))
    rows = np.column_stack(list(columns.values()))[ROWS]
    np.savetxt(file, rows, delimiter=",", header=",".join(columns), comments="", fmt="%.9g")


def _draw_responses(scene: Scene, responses: dict[str, FrequencyResponse], file: Path) -> None:
    """Draw gains above phases, a colour per joint, links dashed."""
    from matplotlib.figure import Figure  # not pyplot: no screen, no global state

    figure = Figure(figsize=(8, 6.5), layout="constrained")
    gain, phase = figure.subplots(2, 1, sharex=True)
    ratios = {joint.name: joint.gear.ratio for joint in scene.joints}
    for k, (name, response) in enumerate(responses.items()):
        for values, line, label in (
            (response.motor * ratios[name], "-", name),
            (response.link, "--", None),
        ):
            gain.loglog(
                response.frequency, np.abs(values), line, color=f"C{k}", label=label, lw=1.3
            )
            degrees = np.degrees(np.unwrap(np.angle(values)))
            phase.semilogx(response.frequency, degrees, line, color=f"C{k}", lw=1.3)
    units = " or ".join(dict.fromkeys(joint.unit for joint in scene.joints))
    gain.set(ylabel=f"rad/s (m/s) per {units}", title=f"{scene.name}: motors over their gears, "
             "links dashed")  # fmt: skip
    gain.legend(frameon=False, fontsize="small")
    phase.set(xlabel="Hz", ylabel="degrees")
    for axes in (gain, phase):
        axes.grid(alpha=0.3)
    figure.savefig(file, dpi=110)


ComplexArray = npt.NDArray[np.complex128]
PROMINENCE = 1.0  # dB, of a peak or a dip against its surroundings


@dataclass(frozen=True, eq=False)
class FrequencyResponse:
    """Speeds per unit of one joint's command, the other commands held.

    Attributes:
        frequency: (K,) [Hz].
        motor: of the motor [rad/s per V, N m or A], complex (K,).
        link: of the link [rad/s or m/s per V, N m or A], complex (K,).
    """

    frequency: Array
    motor: ComplexArray
    link: ComplexArray

    @property
    def resonances(self) -> Array:
        """Frequencies at which the motor moves more than at neighbouring frequencies [Hz]."""
        return self._find_peaks(1.0)

    @property
    def antiresonances(self) -> Array:
        """Frequencies at which the links hold the motor [Hz]."""
        return self._find_peaks(-1.0)

    def _find_peaks(self, sign: float) -> Array:
        from scipy import signal  # takes long to import

        decibels = sign * 20.0 * np.log10(np.abs(self.motor))
        at, _ = signal.find_peaks(decibels, prominence=PROMINENCE)
        peaks: Array = self.frequency[at]
        return peaks


def compute_frequency_response(
    machine: LinearMachine, joint: int, frequency: Array
) -> FrequencyResponse:
    """Return the response to the command of a joint, at frequencies (K,) [Hz], above 0."""
    A, B = machine.A, machine.B[:, [joint]]
    s: ComplexArray = (2j * np.pi * frequency).astype(np.complex128)
    x = np.linalg.solve(s[:, None, None] * np.eye(len(A)) - A, B)[..., 0].astype(np.complex128)
    angle: ComplexArray = x @ machine.theta_m[joint] + machine.theta_m_by_u[joint, joint]
    return FrequencyResponse(frequency, s * angle, x[:, machine.v.start + joint])
