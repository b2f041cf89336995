"""Effects of faults beside what is sent and what is true: closed forms of lines and sensors."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from test_faults import BEGIN, Begun, begun, scene

from arm_emulator import Plant, Scene
from arm_emulator.machine.faults.known import FAULTS
from arm_emulator.machine.faults.scene_faults import SceneFault

__all__ = ["begun", "scene"]
TICKS = 200
Rows = list[Any]


def sent(tick: int) -> np.ndarray:
    """Commands that no motor limits, another one at every tick."""
    return 0.3 * np.sin(0.37 * tick + np.arange(3.0)) + 1e-6 * tick


def run(plant: Plant, saved: bytes, fault: str, magnitude: float) -> Rows:
    """Measurements after each period from the beginning of the fault on, power on."""
    plant.restore(saved)
    plant.powered = True
    plant.set_parameter(fault, magnitude)
    rows = []
    for tick in range(BEGIN, BEGIN + TICKS):
        plant.exchange(sent(tick), tick)
        rows.append(plant.measured)
    return rows


def joint_of(fault: SceneFault, scene: Scene) -> int:
    return scene.joint_names.index(fault.name.split(".")[0])


def share_is(count: int, of: int, p: float) -> bool:
    """Whether so many of independent draws are within 5 standard deviations."""
    return abs(count - p * of) <= 5.0 * np.sqrt(of * p * (1.0 - p)) + 1e-9


def through(delivery: str, rows: list[Any], source: list[Any], m: float) -> bool:
    """Whether received rows are those that a line makes of the sent ones.

    The first rows, which may be of before the fault, are left out.
    """
    n = len(rows)
    if delivery == "late":
        return all(rows[k] == source[k - int(m)] for k in range(int(m), n))
    if delivery == "lost":
        saved = [k for k in range(1, n) if rows[k] == rows[k - 1] != source[k]]
        fresh = all(rows[k] == source[k] for k in range(1, n) if k not in saved)
        return fresh and share_is(len(saved), n - 1, m)
    if delivery == "repeated":
        again = [k for k in range(1, n) if rows[k] == source[k - 1] != source[k]]
        fresh = all(rows[k] == source[k] for k in range(1, n) if k not in again)
        return fresh and share_is(len(again), n - 1, m)
    # Overtaken: at tick k the one before comes last if it was; else k comes unless it is overtaken.
    before = {k for k in range(2, n) if rows[k] == source[k - 1] != source[k]}
    holding = {k for k in range(2, n) if rows[k] == rows[k - 1] != source[k]} - before
    fresh = all(rows[k] == source[k] for k in set(range(2, n)) - before - holding)
    # A frame that is held at its tick comes at the next, behind that one's.
    after = all(k + 1 in before for k in holding if k + 1 < n)
    return fresh and after and share_is(len(before), n - 2, m)


def line(delivery: str, field: str) -> Callable[..., None]:
    def check(plant: Plant, saved: bytes, fault: SceneFault, scene: Scene) -> None:
        j, m = joint_of(fault, scene), fault.varied.number.default
        sound = run(plant, saved, fault.varied.name, 0.0)
        spoiled = run(plant, saved, fault.varied.name, m)
        if field == "applied":
            actual = [float(row.applied[j]) for row in spoiled]
            assert through(delivery, actual, [float(sent(BEGIN + k)[j]) for k in range(TICKS)], m)
        else:
            actual = [(int(r.encoder_counts[j]), float(r.current[j])) for r in spoiled]
            truth = [(int(r.encoder_counts[j]), float(r.current[j])) for r in sound]
            assert len(set(truth)) > 0.9 * TICKS, "it must be seen which one came"
            assert through(delivery, actual, truth, m)

    return check


def command_corrupted(plant: Plant, saved: bytes, fault: SceneFault, scene: Scene) -> None:
    j, m = joint_of(fault, scene), fault.varied.number.default
    rows = run(plant, saved, fault.varied.name, m)
    words = np.array([[row.applied[j], sent(BEGIN + k)[j]] for k, row in enumerate(rows)])
    differ = np.bitwise_xor(*words.T.copy().view(np.uint64))
    wrong = differ[differ != 0]
    allowed = {1 << 63, *(1 << bit for bit in range(29, 52))}
    assert {int(word) for word in wrong} <= allowed and share_is(len(wrong), TICKS, m)


def counts_with_wrong_bits(field: str, bits: range) -> Callable[..., None]:
    def check(plant: Plant, saved: bytes, fault: SceneFault, scene: Scene) -> None:
        j, m = joint_of(fault, scene), fault.varied.number.default
        sound = run(plant, saved, fault.varied.name, 0.0)
        spoiled = run(plant, saved, fault.varied.name, m)
        differ = [int(getattr(a, field)[j] ^ getattr(b, field)[j])
                  for a, b in zip(sound, spoiled, strict=True)]  # fmt: skip
        wrong = [word for word in differ if word]
        assert set(wrong) <= {1 << bit for bit in bits} and share_is(len(wrong), TICKS, m)
        assert len(set(wrong)) > 3, "other bits at other ticks"

    return check


def frozen(plant: Plant, saved: bytes, fault: SceneFault, scene: Scene) -> None:
    j = joint_of(fault, scene)
    plant.restore(saved)
    before = plant.commanded[0, j]
    rows = run(plant, saved, fault.varied.name, 1.0)
    assert len({float(row.applied[j]) for row in rows}) == 1 and rows[0].applied[j] != 0.0, before


def restarts(plant: Plant, saved: bytes, fault: SceneFault, scene: Scene) -> None:
    j = joint_of(fault, scene)
    rows = run(plant, saved, fault.varied.name, 1.0)
    assert all(row.applied[j] == 0.0 for row in rows)
    assert rows[-1].brake_closed[j] or scene.joints[j].brake is None


def displaced(field: str, turn: float) -> Callable[..., None]:
    def check(plant: Plant, saved: bytes, fault: SceneFault, scene: Scene) -> None:
        j, m = joint_of(fault, scene), fault.varied.number.default
        rows = (run(plant, saved, fault.varied.name, size) for size in (0.0, m))
        for a, b in zip(*rows, strict=True):
            moved = int(getattr(b, field)[j] - getattr(a, field)[j])
            assert abs(moved - m / (2.0 * np.pi) * turn) <= 1.0  # of a count

    return check


def swapped(plant: Plant, saved: bytes, fault: SceneFault, scene: Scene) -> None:
    j = joint_of(fault, scene)
    sound = run(plant, saved, fault.varied.name, 0.0)
    spoiled = run(plant, saved, fault.varied.name, 1.0)
    for a, b in zip(sound, spoiled, strict=True):
        for field in ("encoder_counts", "link_encoder_counts", "index_pulses"):
            x, y = getattr(a, field), getattr(b, field)
            assert (x[j], x[j + 1]) == (y[j + 1], y[j]), field


def analog(effect: str) -> Callable[..., None]:
    """The sensor's reading beside that without the fault, which has the same noise."""

    def check(plant: Plant, saved: bytes, fault: SceneFault, scene: Scene) -> None:
        section = fault.changes[0].number.split(".")[-2]
        field = {"current_sensor": "current", "torque_sensor": "torque",
                 "accelerometer": "specific_force", "gyroscope": "angular_rate"}.get(
                     section, section)  # fmt: skip
        number = fault.varied.number
        rows = []
        for m in (0.0, number.default):
            readings = run(plant, saved, fault.varied.name, m)
            name = field if hasattr(readings[0], field) else BESIDE[section]
            at = 0 if fault.kind.of == "imus" else joint_of(fault, scene)
            rows.append(np.array([np.ravel(getattr(r, name)[at]) for r in readings]))
        (y, z), m = rows, number.default
        limit = RANGE.get(section, 1.0 if fault.kind.of == "imus" else 4.0)
        inside = (np.abs(y) < 0.99 * limit) & (np.abs(z) < 0.99 * limit)
        grid = 2e-3  # of the converter, twice
        t = scene.servo_period * np.arange(1, TICKS + 1)[:, None]
        if effect == "stuck":
            assert (z == z[0]).all() and not (y == y[0]).all()
        elif effect == "saturates":
            assert np.abs(z).max() <= (1.0 - m) * limit + grid
            same = np.clip(y, -(1.0 - m) * limit, (1.0 - m) * limit)
            np.testing.assert_allclose(z, same, rtol=0.0, atol=grid)
        elif effect == "noisy":
            noise = (z - y)[inside]
            assert len(noise) > 20 and 0.5 * m < noise.std() < 1.5 * m
        else:
            axes = np.arange(y.shape[1]) == 0 if effect == "offset" else np.ones(y.shape[1], bool)
            # Of the gain, noise of 0.01 that is not amplified; else the same noise.
            off = {"offset": m * axes, "drifts": m * t, "gain": m * y}[effect]
            within = np.broadcast_to(off, y.shape) + 0.0
            close = np.abs(z - y - within) <= grid + (0.06 * m if effect == "gain" else 0.0)
            assert close[inside].all() and inside.any()

    return check


BESIDE = {"tachometer": "link_speed", "thermometer": "motor_temperature"}
RANGE = {"thermometer": 40.0}

CHECKS: dict[str, Callable[..., None]] = {
    **{f"{direction}_{quantity}": line(quantity, field)
       for direction, field in (("command", "applied"), ("measurement", "encoder"))
       for quantity in ("late", "lost", "repeated", "overtaken")},
    "command_corrupted": command_corrupted,
    "measurement_corrupted": counts_with_wrong_bits("encoder_counts", range(16)),
    "encoder_flips_bits": counts_with_wrong_bits("encoder_counts", range(16)),
    "link_encoder_flips_bits": counts_with_wrong_bits("link_encoder_counts", range(20)),
    "controller_frozen": frozen,
    "controller_restarts": restarts,
    "encoders_swapped": swapped,
    "encoder_slips": displaced("encoder_counts", 1000.0),
    "link_encoder_slips": displaced("link_encoder_counts", 65536.0),
    **{f"{sensor}_{effect}": analog(effect)
       for sensor in ("current_sensor", "torque_sensor", "tachometer", "thermometer",
                      "accelerometer", "gyroscope")
       for effect in ("offset", "drifts", "gain", "stuck", "saturates", "noisy")},
}  # fmt: skip


@pytest.mark.parametrize("kind", CHECKS)
def test_effect(kind: str, begun: Begun, scene: Scene) -> None:
    plant, saved, _ = begun
    scene_fault = next(fault for fault in scene.faults if fault.kind.name == kind)
    CHECKS[kind](plant, saved, scene_fault, scene)


def test_all_faults_of_lines_have_a_check() -> None:
    of_lines = {fault.name for fault in FAULTS if "line" in fault.sections}
    assert of_lines <= CHECKS.keys()
