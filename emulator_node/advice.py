"""Which scheme and step are the cheapest for a wanted error, found by step doubling.

Take the motion with n steps per servo period, with 2 n, 4 n, ... The differences d(n) between two
of them in a row sum up to the error of the first:

    error(n) <= d(n) + d(2 n) + d(4 n) + ...

The first two terms are measured; the others are taken as a geometric series, whose ratio is that of
the first two, within what the scheme's order and good sense allow.
"""

from __future__ import annotations

import dataclasses
import time
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np
import yaml

from emulator_node.chain import Array
from emulator_node.plant import Diverged, Plant
from emulator_node.scene import SCHEMES, Scene, load_scene
from words.refusal import Refusal
from words.text_file import read_bytes
from words.yaml_edit import edited
from words.yaml_file import MOST_BYTES

ORDERS = {"paper": 1, "implicit": 1, "rosenbrock": 2, "extrapolated": 2}
MOST_STEPS = 3e7  # of one motion: some seconds of computing
# Of the differences. They may stay for a while what they are where a fast motion is not resolved,
# such as the ringing of a stiff gear; they do not sum up then.
SLOWEST_DECAY = 0.8


@dataclass(frozen=True)
class Setting:
    """A scheme at a step, what it costs and how far it is from the truth."""

    scheme: str
    dt: float  # s
    estimate: float  # rad or m, largest error of a link on the way, by step doubling
    cost: float  # s, wall per simulated second


class Motion:
    """One motion of a scene, open loop, with any scheme and step.

    Args:
        scene: the machine; its own integrator plays no part.
        voltages: (K, N) [V], each row held over a servo period.
    """

    def __init__(self, scene: Scene, voltages: Array) -> None:
        self.scene = scene
        self.voltages = np.ascontiguousarray(voltages)
        self.seconds = len(voltages) * scene.servo_period
        self._done: dict[tuple[str, int], Array | None] = {}

    def plant(self, scheme: str, steps: int) -> Plant:
        """Return the machine with `steps` steps per servo period."""
        integrator = dataclasses.replace(
            self.scene.integrator, scheme=scheme, dt=self.scene.servo_period / steps
        )
        return Plant(dataclasses.replace(self.scene, integrator=integrator, threads=1))

    def q(self, scheme: str, steps: int) -> Array | None:
        """Return link positions after each period (K, N) [rad or m]; None if it diverges."""
        if (scheme, steps) not in self._done:
            try:
                motion = self.plant(scheme, steps).run(self.voltages, steps)
            except Diverged:
                motion = None
            self._done[scheme, steps] = motion
        return self._done[scheme, steps]

    def estimate(self, scheme: str, steps: int) -> float:
        """Return the error by step doubling; infinite where the motion diverges."""
        runs = [q for factor in (1, 2, 4) if (q := self.q(scheme, factor * steps)) is not None]
        if len(runs) < 3:
            return float("inf")
        first, second = (float(np.abs(one - other).max()) for one, other in pairwise(runs))
        if second == 0.0:
            return first
        ratio = max(second / first, 0.5 ** ORDERS[scheme]) if first > 0.0 else SLOWEST_DECAY
        return first + second / (1.0 - min(ratio, SLOWEST_DECAY))

    def cost(self, scheme: str, steps: int) -> float:
        """Return the wall time per simulated second [s], the least of some runs."""
        plant, best = self.plant(scheme, steps), float("inf")
        for _ in range(5):
            plant.reset()
            started = time.perf_counter()
            plant.run(self.voltages, steps)
            best = min(best, time.perf_counter() - started)
        return best / self.seconds

    def setting(self, scheme: str, steps: int) -> Setting:
        """Return what a scheme gives and costs at one step."""
        dt, estimate = self.scene.servo_period / steps, self.estimate(scheme, steps)
        cost = self.cost(scheme, steps) if np.isfinite(estimate) else float("inf")
        return Setting(scheme, dt, estimate, cost)

    def cheapest(self, scheme: str, error: float) -> Setting | None:
        """Return a scheme's largest step that keeps the error; None if none within reach does.

        Steps per servo period are products of 2s and 5s, so that dt is a short decimal.
        """
        most = MOST_STEPS / (4.0 * len(self.voltages))
        steps = 1
        while self.estimate(scheme, steps) > error:
            steps *= 2
            if steps > most:
                return None
        for between in round_numbers(steps // 2 + 1, steps):
            if self.estimate(scheme, between) <= error:
                return self.setting(scheme, between)
        return self.setting(scheme, steps)


def advise(motion: Motion, error: float) -> list[Setting]:
    """Return each scheme's cheapest setting for an error, the cheapest of all first.

    Args:
        motion: on which the error is judged.
        error: largest error of a link on the way [rad or m].

    Raises:
        Refusal: an error that cannot be asked for.
    """
    if not 1e-11 <= error <= 1.0:
        raise Refusal("advise", "error", "be from 1e-11 to 1 rad", error)
    settings = [motion.cheapest(scheme, error) for scheme in SCHEMES]
    return sorted((s for s in settings if s is not None), key=lambda s: s.cost)


def round_numbers(low: int, high: int) -> list[int]:
    """Return the numbers 2^a 5^b from `low` to below `high`."""
    found = []
    five = 1
    while five < high:
        number = five
        while number < high:
            if number >= low:
                found.append(number)
            number *= 2
        five *= 5
    return sorted(found)


# Into the scene file


def write_integrator(file: Path, scheme: str, dt: float) -> None:
    """Put scheme and step into a scene file, where everything else stays as it is written.

    Raises:
        Refusal: a file that cannot be read or written, or that is built so that the change would
            reach further; the file is as before then.
    """
    before = load_scene(file)
    # Bytes, so that line ends stay what they are.
    text = read_bytes(file, MOST_BYTES).decode("utf-8")
    number = np.format_float_scientific(dt, trim="0", exp_digits=1)
    new = _replaced(text, {"scheme": scheme, "dt": number}).encode("utf-8")
    # Tried in a file beside the scene first: the URDF is named relative to it.
    trial = file.with_name(f".{file.stem}.advised.yaml")
    try:
        try:
            trial.write_bytes(new)
            after = load_scene(trial)
        finally:
            trial.unlink(missing_ok=True)
        wanted = dataclasses.replace(before.integrator, scheme=scheme, dt=dt)
        if after.integrator != wanted or _rest(after) != _rest(before):
            raise Refusal(
                file.name,
                "integrator",
                "stand for itself in the file",
                "a section that others use too",
                f"change it by hand: scheme: {scheme}, dt: {number}",
            )
        file.write_bytes(new)
    except OSError as reason:
        raise Refusal(file.name, "file", "be writable", reason.strerror or reason) from None


def _rest(scene: Scene) -> tuple[object, ...]:
    """Return what of a scene has nothing to do with its integrator."""
    return (
        scene.name, scene.urdf, scene.tool, scene.gravity, scene.supply_voltage, scene.joints,
        scene.servo_period, scene.threads, scene.cores,
    )  # fmt: skip


def _replaced(text: str, values: dict[str, str]) -> str:
    """Return YAML text with values of the section `integrator` replaced, or added at its end."""
    root = yaml.compose(text, yaml.SafeLoader)
    assert isinstance(root, yaml.MappingNode)
    section = next(value for key, value in root.value if key.value == "integrator")
    assert isinstance(section, yaml.MappingNode)
    found = {key.value: value for key, value in section.value}
    edits = []
    for key, value in values.items():
        if key in found:
            node = found[key]
            edits.append((node.start_mark.index, node.end_mark.index, value))
        else:
            first, _ = section.value[0]
            at = first.start_mark.index
            gap = ", " if section.flow_style else "\n" + " " * first.start_mark.column
            edits.append((at, at, f"{key}: {value}{gap}"))
    return edited(text, edits)
