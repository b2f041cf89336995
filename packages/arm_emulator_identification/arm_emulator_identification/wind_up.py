"""Stiffness of gears from encoders at the links: compliance under load.

q_motor - q_link = T / Kg + zero + ripple     with the torque T on the link

Zero and ripple are those of the encoder at the link, in this record. The ripple is a wave over the
angle, with some hundred periods per turn.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from arm_emulator.extension.base import Array
from arm_emulator.extension.machine import Scene
from arm_emulator_identification.filtered import EDGE, filter_low_pass, smooth_motion
from arm_emulator_identification.found import Found
from arm_emulator_identification.link_regressor import compute_link_torques
from arm_emulator_identification.measured_run import MeasuredRun
from arm_emulator_identification.torque_model import has_match

BELOW = 10.0  # Hz: bandwidth of the load of rigid links
ORDERS = np.arange(20.0, 2000.0, 0.5)  # waves per turn searched for the ripple
SLOW = 1.0  # Hz: errors slower than this are no ripple
SURE = 5.0  # times its deviation: less certain compliance is not identifiable


@dataclass(frozen=True)
class WindUp:
    """Wind-up of each joint with an encoder at the link and an elastic gear; else NaN. (N,)."""

    residual: Array  # rad, root of mean square
    ripple: Array  # rad, amplitude of the encoder's largest wave within the residual
    order: Array  # its waves per turn
    rest: Array  # rad, root of mean square of the residual without it
    unexplained: Array  # rad, the same without any wind-up
    stiffness: Array  # N m/rad that fits best
    deviation: Array  # N m/rad, of it
    t: Array  # s (K,)
    measured: Array  # rad (K, N), its zero taken out
    computed: Array  # rad (K, N), of the scene's gears


def compute_wind_up(run: MeasuredRun, scene: Scene) -> WindUp:
    """Compare measured wind-up with that of a scene's gears under its links' torques."""
    period, N = run.period, len(scene.joints)
    frequency = min(BELOW, 0.1 / period)
    q, v, a = smooth_motion(run.q_motor, period, frequency)
    edge = int(EDGE / (frequency * period))
    inside = slice(edge, len(q) - edge)
    load = compute_link_torques(scene, run.t, q, v, a)[inside]
    K = len(load)
    measured, computed = np.full((K, N), np.nan), np.full((K, N), np.nan)
    residual, unexplained, stiffness, deviation = (np.full(N, np.nan) for _ in range(4))
    ripple, order, rest = (np.full(N, np.nan) for _ in range(3))
    for j, joint in enumerate(scene.joints):
        if run.q_link is None or joint.gear.stiffness is None:
            continue
        if np.isnan(run.q_link[:, j]).any():
            continue
        give = (run.q_motor - run.q_link)[inside, j]
        own = np.array([joint.gear.compute_wind_up(torque) for torque in load[:, j]])
        zero = np.mean(give - own)
        measured[:, j], computed[:, j] = give - zero, own
        residual[j] = np.sqrt(np.mean((give - own - zero) ** 2))
        unexplained[j] = give.std()
        error = give - own - zero
        ripple[j], order[j], rest[j] = _find_largest_wave(error, run.q_motor[inside, j], period)
        A = np.column_stack([load[:, j], np.ones(K)])
        (compliance, _), *_ = np.linalg.lstsq(A, give, rcond=None)
        error = give - A @ np.linalg.lstsq(A, give, rcond=None)[0]
        samples_per_period = max(1.0, 1.0 / (frequency * period))
        of_compliance = np.sqrt(
            samples_per_period * error @ error / K / max(K * load[:, j].var(), 1e-300)
        )
        if compliance > SURE * of_compliance:
            stiffness[j] = 1.0 / compliance
            deviation[j] = of_compliance / compliance**2
    return WindUp(
        residual, ripple, order, rest, unexplained, stiffness, deviation, run.t[inside], measured,
        computed,
    )  # fmt: skip


def list_stiffness(
    scene: Scene, run: MeasuredRun, names: Sequence[str], hold: Sequence[str]
) -> list[Found]:
    """Return the stiffness of gears whose links have encoders."""
    if run.q_link is None or not names:
        return []
    of = compute_wind_up(run, scene)
    numbers = []
    for j, joint in enumerate(scene.joints):
        name, before = f"joints.{joint.name}.gear.stiffness", joint.gear.stiffness
        if before is None or name not in names or has_match(name, hold):
            continue
        if any(part.loop_keys for part in joint.parts):
            continue  # see `list_loops`
        reported = bool(np.isfinite(of.stiffness[j]))
        value = float(of.stiffness[j]) if reported else before
        numbers.append(Found(name, "N m/rad", before, value, float(of.deviation[j]), reported))
    return numbers


def _find_largest_wave(error: Array, q: Array, period: float) -> tuple[float, float, float]:
    """Return amplitude and order of the largest wave in an error, and the remainder."""
    quick = error - filter_low_pass(error[:, None], period, SLOW)[:, 0]
    amplitudes = [abs(np.mean(quick * np.exp(1j * n * q))) for n in ORDERS]
    n = float(ORDERS[int(np.argmax(amplitudes))])
    A = np.column_stack([np.sin(n * q), np.cos(n * q), np.ones(len(q))])
    wave = np.linalg.lstsq(A, error, rcond=None)[0]
    rest = error - A @ wave
    return float(np.hypot(wave[0], wave[1])), n, float(np.sqrt(np.mean(rest**2)))
