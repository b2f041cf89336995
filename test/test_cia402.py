"""Drives behind field buses: dictionary, state machine, modes, limits, stops, faults, homing."""

from __future__ import annotations

import contextlib
import dataclasses
import itertools
import math
import random
import struct
from collections.abc import Callable, Iterable
from pathlib import Path

import numpy as np
import pytest
from documents import page_of
from draws import FULL

from arm_emulator.base.refusal import Refusal
from arm_emulator.build.unit import Unit
from arm_emulator.cli.command_line import main
from arm_emulator.doors.fieldbus.declared import COUNT, FIRST
from arm_emulator.doors.fieldbus.drives import CANOPEN, ETHERCAT, Aborted, Drives, Entry, dictionary
from arm_emulator.machine.diverged import Diverged
from arm_emulator.machine.plant import Plant
from arm_emulator.machine.scene import Scene, load_scene
from arm_emulator.servo.servo import Servo, load_servo_config

ROOT = Path(__file__).resolve().parents[1]
SERVO = load_servo_config(ROOT / "config/servo/three_axis.yaml")
PLAIN = load_scene("three_axis")
N, T = len(PLAIN.joints), PLAIN.servo_period
CLOSE, RELEASE = 0.012, 0.025  # s
# Scene with all features of a drive: gravity, stops, brakes and index pulses.
RICH = load_scene(
    "three_axis",
    overrides={
        "gravity": [0.0, 0.0, -9.81],
        "joints.*.brake": {"torque": 1.2, "close_delay": CLOSE, "release_delay": RELEASE},
        "joints.*.encoder": {"counts_per_turn": 1024, "index": "latch"},
        "joints.*.end_stops": {
            "lower": -2.0,
            "upper": 2.0,
            "stiffness": 3000.0,
            "damping": 50.0,
        },
        "joints.waist.motor.winding": {
            "heat_capacity": 3.0,
            "thermal_resistance": 2.0,
            "limit": 40.0,
        },
    },
)

CONTROL, STATUS, MODE, SHOWN = 0x6040, 0x6041, 0x6060, 0x6061
TARGET, ACTUAL, ERROR = 0x607A, 0x6064, 0x603F
PP, PV, TQ, HM, CSP, CSV, CST = 1, 3, 4, 6, 8, 9, 10
SHUTDOWN, SWITCH_ON, ENABLE, RESET, HALT = 0x06, 0x07, 0x0F, 0x80, 0x100
REACHED, INTERNAL_LIMIT, BIT12, BIT13 = 0x400, 0x800, 0x1000, 0x2000

STATES = {  # masks and values of the statusword, CiA 402
    "not ready": (0x4F, 0x00),
    "switch on disabled": (0x4F, 0x40),
    "ready": (0x6F, 0x21),
    "switched on": (0x6F, 0x23),
    "operation enabled": (0x6F, 0x27),
    "quick stop": (0x6F, 0x07),
    "fault reaction": (0x4F, 0x0F),
    "fault": (0x4F, 0x08),
}


def make(scene: Scene = PLAIN, bus: int = ETHERCAT) -> Drives:
    return Drives(Plant(scene), SERVO, bus)


def state(drives: Drives, j: int = 0) -> str:
    word = drives.read(j, STATUS)
    found = [name for name, (mask, value) in STATES.items() if word & mask == value]
    assert len(found) == 1, f"states of the statusword 0x{word:04x}"
    return found[0]


def command(drives: Drives, word: int, periods: int = 1) -> None:
    for j in range(len(drives.plant.scene.joints)):
        drives.write(j, CONTROL, word)
    drives.period(periods)


def enable(drives: Drives, mode: int) -> None:
    """All drives, as masters do it; the targets are where the motors are."""
    joints = range(len(drives.plant.scene.joints))
    for j in joints:
        drives.write(j, MODE, mode)
        drives.write(j, TARGET, drives.read(j, ACTUAL))
    for word in (SHUTDOWN, SWITCH_ON, ENABLE):
        command(drives, word)
    for _ in range(1000):
        if all(state(drives, j) == "operation enabled" for j in joints):
            return
        drives.period()
    raise AssertionError("the drives are not enabled after a second")


def until(drives: Drives, done: Callable[[], bool], most: int = 5000) -> int:
    """Go on until something is so; return how many periods that took."""
    for periods in range(most):
        if done():
            return periods
        drives.period()
    raise AssertionError(f"it is not so after {most} periods")


# --------------------------------------------------------------------------------- the dictionary


def test_every_entry_can_be_read_and_begins_within_its_range() -> None:
    for bus in (ETHERCAT, CANOPEN):
        drives = make(bus=bus)
        for one in dictionary():
            if not one.buses & bus:
                with pytest.raises(Aborted, match="06020000"):
                    drives.upload(0, one.index, one.sub)
                continue
            raw = drives.upload(0, one.index, one.sub)
            if one.bits:
                assert len(raw) == one.bits // 8, f"bytes of {one}"
                value = drives.read(0, one.index, one.sub)
                assert one.least <= value <= one.most, f"value of {one}"
        assert drives.upload(1, 0x1008) == b"three_axis", "name of the device"
        assert drives.read(2, 0x1018, 4) == 3, "serial number of the third drive"


def test_units_are_those_of_the_scene() -> None:
    drives = make()
    assert drives.read(0, 0x608F, 1) == 1024, "counts in a turn of the motor"
    assert drives.read(0, 0x6076) == 1000, "rated torque [mN m]: 20 A at 0.05 N m/A"
    assert drives.read(0, 0x6075) == 20000, "rated current [mA]"
    most = 3.0 / 0.01 * 1024 / (2 * math.pi)  # of the link's 3 rad/s
    assert drives.read(0, 0x607F) == math.floor(most), "largest speed [counts/s]"
    assert drives.read(1, ACTUAL) == math.floor(0.5 / 0.01 * 1024 / (2 * math.pi)), (
        "counts at start"
    )
    assert drives.read(0, 0x60C2, 1) == 1, "interpolation time"
    assert drives.read(0, 0x60C2, 2) == -3, "interpolation time is in ms"


def expected_abort(one: Entry | None, known_object: bool, raw: bytes, value: int) -> int:
    """Return the result of a write by CiA 301."""
    if one is None:
        return 0x06090011 if known_object else 0x06020000
    if one.access in ("const", "ro"):
        return 0x06010002
    size = len(raw)
    if size != one.bits // 8:
        return 0x06070012 if size > one.bits // 8 else 0x06070013
    if one.type == "REAL32" and not math.isfinite(*struct.unpack("<f", raw)):
        return 0x06090030
    if value > one.most:
        return 0x06090031
    return 0x06090032 if value < one.least else 0


OF_PARTS = range(FIRST, FIRST + COUNT)
# Objects with rules beside the range: mappings, histories, stores, modes, methods, inputs that not
# every motor has.
SPECIAL = {0x1003, 0x1010, 0x1011, 0x1C12, 0x1C13, MODE, 0x6098, *range(0x1600, 0x1604)} | {
    *range(0x1A00, 0x1A04), *OF_PARTS
}  # fmt: skip


def test_random_accesses_crash_nothing_and_refused_ones_change_nothing() -> None:
    """100 000 reads and writes: codes by the rules of CiA 301, values as a model has them.

    Of these, 20 000 in the tests of every day.
    """
    rng = random.Random(402)
    drives = make()
    known = {(one.index, one.sub): one for one in dictionary() if one.buses & ETHERCAT}
    objects = {index for index, _ in known}
    model = {key: drives.upload(0, *key) for key in known}
    writable = [key for key, one in known.items() if one.access == "rw"]
    keys, taken, refused = list(known), 0, 0
    for k in range(100_000 if FULL else 20_000):
        key = rng.choice(writable if rng.random() < 0.5 else keys)
        if rng.random() < 0.1:
            key = (rng.choice((key[0], rng.randrange(0x10000))), rng.randrange(256))
        one = known.get(key)
        if rng.random() < 0.3:
            if one is None:
                code = 0x06090011 if key[0] in objects else 0x06020000
                with pytest.raises(Aborted) as no:
                    drives.upload(0, *key)
                assert no.value.code == code, f"reading {key}"
            else:
                assert drives.upload(0, *key) == model[key], f"value of {one}"
            continue
        size = one.bits // 8 if one and rng.random() < 0.9 else rng.randrange(9)
        raw = rng.choice((rng.randbytes(size), bytes(size), b"\x01" + bytes(max(0, size - 1))))
        raw = raw[:size]
        value = int.from_bytes(raw, "little", signed=bool(one and one.type.startswith("INT")))
        expected = expected_abort(one, key[0] in objects, raw, value)
        try:
            drives.download(0, *key, raw)
            code = 0
        except Aborted as no:
            code = no.code
        if key[0] not in SPECIAL:
            assert code == expected, f"writing {raw.hex()} to {one or key}"
        if code == 0:
            taken += 1
            if key[0] not in (0x1003, 0x1011):
                model[key] = raw
        else:
            refused += 1
        if k % 5000 == 0:
            assert {key: drives.upload(0, *key) for key in known} == model, "the whole dictionary"
    assert {key: drives.upload(0, *key) for key in known} == model, "the whole dictionary"
    assert min(taken, refused) > 2_000, f"{taken} taken, {refused} refused"
    # The drive runs with any settings.
    drives.period(100)


def test_a_mapping_is_taken_only_whole_and_only_of_what_can_be_mapped() -> None:
    for bus, locked in ((ETHERCAT, 0x06010003), (CANOPEN, 0x08000022)):
        drives = make(bus=bus)

        def code(index: int, sub: int, value: int, drives: Drives = drives) -> int:
            try:
                drives.write(0, index, value, sub)
            except Aborted as no:
                return no.code
            return 0

        assert code(0x1600, 1, 0x60400010) == locked, "a mapping that is in use"
        assert code(0x1600, 0, 0) == 0, "a mapping is opened"
        assert code(0x1600, 1, 0x60410010) == 0x06040041, "the statusword cannot be received"
        assert code(0x1600, 1, 0x60400020) == 0x06040041, "the controlword has 16 bits"
        assert code(0x1600, 1, 0x70000010) == 0x06020000, "there is no such object"
        assert code(0x1600, 1, 0x60FE0520) == 0x06090011, "there is no such sub-index"
        assert code(0x1600, 1, 0x60400010) == 0, "the controlword"
        assert code(0x1600, 2, 0x00000008) == 0, "a gap"
        assert code(0x1600, 0, 9) == 0x06040041, "there is no ninth object"
        assert code(0x1600, 0, 2) == 0, "a mapping is closed"
        drives.lock_mapping(True)
        assert code(0x1600, 0, 0) == 0x08000022, "EtherCAT beyond pre-operational"
        drives.lock_mapping(False)
        for sub in range(1, 4):
            assert code(0x1A00, 0, 0) == 0, "a mapping is opened"
            assert code(0x1A00, sub, 0x60640020) == 0, "a position"
        assert code(0x1A00, 0, 3) == (0 if bus == ETHERCAT else 0x06040042), "12 bytes in a PDO"


# ------------------------------------------------------------------------------ the state machine

# By state and command: transition and next state. What is not here does nothing.
TABLE = {
    ("switch on disabled", "shutdown"): (2, "ready"),
    ("ready", "switch on"): (3, "switched on"),
    ("ready", "enable"): (3, "switched on"),
    ("ready", "disable voltage"): (7, "switch on disabled"),
    ("ready", "quick stop"): (7, "switch on disabled"),
    ("switched on", "enable"): (4, "operation enabled"),
    ("switched on", "shutdown"): (6, "ready"),
    ("switched on", "disable voltage"): (10, "switch on disabled"),
    ("switched on", "quick stop"): (10, "switch on disabled"),
    ("operation enabled", "switch on"): (5, "switched on"),
    ("operation enabled", "shutdown"): (8, "ready"),
    ("operation enabled", "disable voltage"): (9, "switch on disabled"),
    ("operation enabled", "quick stop"): (11, "quick stop"),
    ("quick stop", "disable voltage"): (12, "switch on disabled"),
    ("quick stop", "enable"): (16, "operation enabled"),
    ("fault", "reset"): (15, "switch on disabled"),
}


def command_of(word: int, before: int, where: str) -> str:
    if where == "fault":
        return "reset" if word & 0x80 and not before & 0x80 else "nothing"
    if not word & 2:
        return "disable voltage"
    if not word & 4:
        return "quick stop"
    if not word & 1:
        return "shutdown"
    return "enable" if word & 8 else "switch on"


def bring(drives: Drives, where: str) -> None:
    """Every drive to a state, in cyclic velocity, with stops that end where they begin."""
    drives.restart()
    for j in range(N):
        drives.write(j, MODE, CSV)
        drives.write(j, 0x605A, 6)  # stay in Quick stop active
        drives.write(j, 0x605C, 0)
        drives.write(j, 0x605B, 0)
    words = {
        "switch on disabled": (),
        "ready": (SHUTDOWN,),
        "switched on": (SHUTDOWN, SWITCH_ON),
        "operation enabled": (SHUTDOWN, SWITCH_ON, ENABLE),
        "quick stop": (SHUTDOWN, SWITCH_ON, ENABLE, 0x0B),
        "fault": (SHUTDOWN, SWITCH_ON, ENABLE),
    }[where]
    for word in words:
        command(drives, word)
    if where == "fault":
        drives.lost()
        drives.period(2)  # to a stand
    assert {state(drives, j) for j in range(N)} == {where}, "where the drives were brought"


def test_every_state_takes_every_command_as_the_table_states() -> None:
    """All 32 words of bits 0 to 3 and 7, bit 7 with and without an edge, in every state."""
    drives = make()
    seen = set()
    low = [bits | reset for bits in range(16) for reset in (0, RESET)]
    for where in (name for name in STATES if name not in ("not ready", "fault reaction")):
        for word, before in itertools.product(low, (0, RESET)):
            bring(drives, where)
            if where == "fault":
                command(drives, before)
                if before:  # it was an edge: to the fault once more, with the bit set
                    for step in (SHUTDOWN, SWITCH_ON, ENABLE):
                        command(drives, before | step)
                    drives.lost()
                    drives.period(2)
            reported = command_of(word, before, where)
            drives.write(0, CONTROL, word)
            drives.period()
            transition, after = TABLE.get((where, reported), (0, where))
            assert state(drives) == after, f"from {where} by 0x{word:02x} after 0x{before:02x}"
            seen.add(transition)
    assert seen == {0, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 15, 16}, "transitions that were taken"


class Model:
    """The state machine as CiA 402 reports it, of a drive that stands still, for random walks."""

    def __init__(self) -> None:
        self.state, self.word, self.powered = "switch on disabled", 0, True
        self.options = {0x605A: 2, 0x605B: 0, 0x605C: 1, 0x6007: 1}

    def take(self, word: int) -> None:
        """Go on under one word until nothing changes any more."""
        for _ in range(4):
            reported = command_of(word, self.word, self.state)
            self.word = word
            transition, after = TABLE.get((self.state, reported), (0, self.state))
            if transition == 3 and not self.powered:
                after = "ready"
            if self.state == "switched on" and not self.powered and transition in (0, 4):
                after = "ready"
            if transition == 11 and self.options[0x605A] < 5:
                after = "switch on disabled"  # when it stands
            self.state = after

    def lose_master(self) -> None:
        reaction = self.options[0x6007]
        if reaction and self.state in ("ready", "switched on"):
            self.state = "switch on disabled"
        elif reaction == 1 and self.state in ("operation enabled", "quick stop"):
            self.state = "fault"
        elif reaction == 2 and self.state != "fault":
            self.state = "switch on disabled"
        elif reaction == 3 and self.state == "operation enabled":
            stays = self.options[0x605A] >= 5
            self.state = "quick stop" if stays else "switch on disabled"

    def lose_power(self) -> None:
        if self.state in ("operation enabled", "quick stop"):
            self.state = "fault"


@pytest.mark.parametrize("seed", range(3))
def test_random_commands_options_and_losses_lead_where_a_model_states(seed: int) -> None:
    """3000 words and events on a drive that stands still: every stop is over in a few periods."""
    rng = random.Random(seed)
    drives, model, seen = make(), Model(), set()
    drives.write(0, MODE, CSV)
    likely = (SHUTDOWN, SWITCH_ON, ENABLE, ENABLE, RESET, 0, 0x0B, SHUTDOWN | RESET)
    for k in range(3000):
        event = rng.random()
        if event < 0.05 and model.state not in ("operation enabled", "quick stop"):
            index = rng.choice(list(model.options))
            model.options[index] = rng.randrange({0x605A: 9, 0x6007: 4}.get(index, 2))
            drives.write(0, index, model.options[index])
        elif 0.05 < event < 0.07:
            drives.lost(0)
            model.lose_master()
        elif 0.07 < event < 0.09:
            drives.plant.powered = model.powered = not model.powered
            if not model.powered:
                model.lose_power()
            model.take(model.word)  # which is still there
            drives.period()
        drives.period(4)
        word = rng.choice(likely) if rng.random() < 0.8 else rng.randrange(256)
        drives.write(0, CONTROL, word)
        drives.period(5)
        model.take(word)
        assert state(drives) == model.state, f"after word {k}, 0x{word:02x}, {model.options}"
        seen.add(model.state)
    assert len(seen) >= 5, f"states that it was in: {seen}"


# -------------------------------------------------------------------------------------- the modes


def truth(drives: Drives, name: str) -> np.ndarray:
    return np.array(getattr(drives.plant.state, name))


@pytest.mark.parametrize("feedforward", [0, 1000])
@pytest.mark.parametrize("name", ["three_axis", "ur5"])
def test_cyclic_position_is_our_own_servo_to_the_last_bit(name: str, feedforward: int) -> None:
    """The same targets to the servo, in counts as their middles, give the same voltages."""
    scene = load_scene(name)
    config = load_servo_config(ROOT / f"config/servo/{name}.yaml")
    plant, servo = Plant(scene), Servo(config)
    drives = Drives(Plant(scene), config, ETHERCAT)
    joints = range(len(scene.joints))
    ratio = np.array([joint.gear_ratio for joint in config.joints])
    counts = np.array([joint.counts_per_turn for joint in config.joints])
    count_angle = 2.0 * math.pi / counts
    for j in joints:
        drives.write(j, 0x2001, feedforward)
    enable(drives, CSP)

    def observe() -> None:
        measured = plant.measured
        servo.observe(measured.encoder_counts, measured.current, plant.measured.applied)

    observe()
    for _ in range(2):  # two words, then Operation enabled
        servo.release()
        plant.exchange(np.zeros(len(joints)))
        observe()
    speed, smoothing = np.zeros(len(joints)), 1e-4 * drives.read(0, 0x2002)
    target = position = start = plant.measured.encoder_counts.astype(float)
    swing = np.round(counts * 0.9 * np.resize([1.0, -1.0, 0.5], len(joints)))
    lag = 0.0
    for k in range(1500 if name == "three_axis" else 500):
        if k:  # the first target is that of `enable`
            target = start + np.round(swing * (1.0 - math.cos(0.003 * k)))
            for j in joints:
                drives.write(j, TARGET, int(target[j]))
            drives.period()
        speed = speed + ((target - position) / T - speed) * (T / (T + smoothing))
        position = target
        q = (position + 0.5) * count_angle * ratio
        v = 1e-3 * feedforward * speed * count_angle * ratio
        plant.exchange(servo.control(q, v))
        assert (drives.plant.measured.applied == plant.measured.applied).all(), (
            f"commands in period {k}"
        )
        observe()
        lag = max(lag, abs(drives.read(0, 0x60F4)))
    assert (truth(drives, "q") == plant.state.q).all(), "link angles"
    # Without feed-forward it lags by speed / Kp: 0.9 turns * 3 rad/s / Kp.
    gain = config.joints[0].position_gain
    expected = 0.0 if feedforward else swing[0] * 3.0 / gain
    assert lag == pytest.approx(expected, abs=0.03 * counts[0]), "following error, with its swing"


def test_targets_that_come_slower_are_joined_by_lines() -> None:
    drives = make()
    drives.write(0, 0x60C2, 8, 1)
    enable(drives, CSP)
    start, rng = drives.read(0, ACTUAL), random.Random(8)
    assert drives.periods_per_target(0) == 8, "periods in the interpolation time"
    before = start
    for _ in range(40):
        goal = before + rng.randrange(-200, 200)
        drives.write(0, TARGET, goal)
        for k in range(1, 9):
            drives.period()
            line = before + (goal - before) * k / 8
            assert abs(drives.read(0, 0x6062) - line) <= 0.5 + 1e-9, "demand, a whole number"
        before = goal


def test_cyclic_position_goes_on_beyond_32_bits() -> None:
    """Counts are read modulo 2**32, and targets are taken as those that are next."""
    scene = load_scene("three_axis", overrides={"joints.*.start": 9999.0})
    per_rad = 1024 / (2 * math.pi) / 0.01
    drives = make(scene)
    drives.write(0, 0x607D, 0, 1)
    drives.write(0, 0x607D, 0, 2)
    assert abs(drives.read(0, 0x6063) - 9999.0 * per_rad) <= 1, "counts at the start"
    for j in range(N):  # homing puts the zero so that the positions are about to wrap
        drives.write(j, 0x607D, 0, 1)
        drives.write(j, 0x607D, 0, 2)
        drives.write(j, 0x607C, 2**31 - 50)
    enable(drives, HM)
    command(drives, ENABLE | 0x10, 3)
    assert drives.read(0, ACTUAL) == 2**31 - 50, "position at the home is the home offset"
    enable(drives, CSP)
    for k in range(400):
        at = 2**31 - 50 + k
        drives.write(0, TARGET, at if at < 2**31 else at - 2**32)
        drives.period()
    until(drives, lambda: drives.read(0, ACTUAL) == -(2**31) + 349)
    assert drives.read(0, ERROR) == 0, "no following error on the way"


def test_cyclic_velocity_turns_the_motor_at_the_speed() -> None:
    drives = make()
    enable(drives, CSV)
    per_rad = 1024 / (2 * math.pi)
    for j, speed in enumerate((9000, -6000, 3000)):
        drives.write(j, 0x60FF, speed - 500)
        drives.write(j, 0x60B1, 500)
    drives.period(2000)
    turned = truth(drives, "theta_m")
    drives.period(1000)
    mean = (truth(drives, "theta_m") - turned) * per_rad
    # Over a second the arm's elasticity swings by less than a hundredth of the speed.
    np.testing.assert_allclose(mean, [9000, -6000, 3000], rtol=0.01, err_msg="mean speeds")
    for j, speed in enumerate((9000, -6000, 3000)):
        reported = np.mean([drives.read(j, 0x606C) for _ in range(50) if not drives.period()])
        assert reported == pytest.approx(speed, rel=0.02), "velocity actual value, a mean of 50"
        assert drives.read(j, STATUS) & BIT12, "the drive follows"


def test_cyclic_torque_gives_that_torque() -> None:
    """0.1 % of 1 N m at 0.05 N m/A are 0.02 A; the current is at the reference within a period."""
    drives = make()
    enable(drives, CST)
    rng, off = random.Random(10), []
    for _ in range(60):
        torque = [rng.randrange(-120, 120) for _ in range(N)]
        for j in range(N):
            drives.write(j, 0x6071, torque[j] + 10)
            drives.write(j, 0x60B2, -10)
        drives.period(12)
        at = truth(drives, "current") / 0.02
        # Speeds are observed through a coarse encoder: 1 rad/s of the motor is 0.05 V, 0.05 A.
        np.testing.assert_allclose(at, torque, atol=12.0, err_msg="current in 0.1 %")
        off.append(at - torque)
        reported = [drives.read(j, 0x6077) for j in range(N)]
        np.testing.assert_allclose(reported, at, atol=0.51, err_msg="torque actual value")
    np.testing.assert_allclose(np.mean(off, axis=0), 0.0, atol=1.0, err_msg="mean of what is off")


def duration(way: float, begin: float, speed: float, up: float, down: float) -> float:
    """Of the shortest motion over a way >= 0 that begins with a speed along it and ends at rest.

    The peak is found by halving: the way that it takes to speed up and to slow down grows with it.
    """

    def covered(peak: float) -> float:
        return (peak * peak - begin * begin) / (2.0 * up) + peak * peak / (2.0 * down)

    low, high = begin, speed
    for _ in range(100):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if covered(middle) < way else (low, middle)
    return (low - begin) / up + low / down + max(0.0, way - covered(low)) / low


def set_point(drives: Drives, target: int, bits: int = 0, j: int = 0) -> None:
    """The handshake of profile position."""
    drives.write(j, CONTROL, ENABLE | bits)
    drives.period()
    assert not drives.read(j, STATUS) & BIT12, "set-point acknowledge before"
    drives.write(j, TARGET, target)
    drives.write(j, CONTROL, ENABLE | bits | 0x10)
    drives.period()
    assert drives.read(j, STATUS) & BIT12, "set-point acknowledge"


@pytest.mark.parametrize("seed", range(16))
def test_a_profile_arrives_when_its_trapezoid_states(seed: int) -> None:
    """From rest, and from a random moment of its speeding up: on, back, or by less than it needs
    to stop."""
    rng = np.random.default_rng([seed, 1])
    drives = make()
    drives.write(0, 0x6065, 0xFFFFFFFF)  # the arm may swing
    enable(drives, PP)
    start, sign = drives.read(0, ACTUAL), int(rng.choice([-1, 1]))
    speed, up, down = (
        int(10 ** rng.uniform(3.3, 4.3)),
        *(int(10 ** rng.uniform(4, 5)) for _ in "ud"),
    )
    for index, value in ((0x6081, speed), (0x6083, up), (0x6084, down)):
        drives.write(0, index, value)
    # With and without a part at full speed.
    way = int(speed * speed * (0.5 / up + 0.5 / down) * rng.choice([0.3, 3.0])) + 100
    if seed % 2:
        set_point(drives, sign * way, 0x40)  # relative
    else:
        set_point(drives, start + sign * way)
    spent = 1
    predicted = duration(way, 0.0, speed, up, down)
    if seed >= 4:
        spent += (some := int(rng.uniform(0.1, 0.9) * predicted * speed / (speed + up) / T))
        drives.period(some)
        x, v = 0.5 * up * (spent * T) ** 2, up * spent * T
        if v > speed or x + v * v / (2.0 * down) > way:
            pytest.skip("it does not speed up any more")
        stop = v * v / (2.0 * down)
        ahead = stop + way * rng.choice([0.1, 1.0]), stop - way, 0.5 * stop
        new = float(round(x + ahead[seed % 3]))
        # A period passes until the bit is low, another until the set-point is taken.
        drives.write(0, CONTROL, ENABLE | 0x20)
        drives.write(0, TARGET, start + sign * int(new))
        drives.period()
        spent += 1
        x, v = 0.5 * up * (spent * T) ** 2, up * spent * T
        stop = v * v / (2.0 * down)
        assert v < speed, "it still speeds up"
        if seed % 3 == 0:
            predicted = spent * T + duration(new - x, v, speed, up, down)
        else:
            back = duration(x + stop - new, 0.0, speed, up, down)
            predicted = spent * T + v / down + back
        drives.write(0, CONTROL, ENABLE | 0x30)
        drives.period()
        spent += 1
        way = int(new)
    end = start + sign * way
    periods = spent + until(
        drives, lambda: drives.read(0, 0x6062) == end and drives.read(0, 0x606B) == 0, 60000
    )
    # The first one that is whole, or one before: speeds are asked to half a count/s.
    assert predicted / T - 1 <= periods <= predicted / T + 1, "periods on the way"
    until(drives, lambda: bool(drives.read(0, STATUS) & REACHED))
    assert abs(drives.read(0, ACTUAL) - start - sign * way) <= 10, "position, within its window"


def test_profiles_follow_one_another_or_change_at_once() -> None:
    drives = make()
    enable(drives, PP)
    start = drives.read(0, ACTUAL)
    drives.write(0, 0x6065, 0xFFFFFFFF)
    set_point(drives, start + 3000)
    drives.period(50)
    set_point(drives, start + 1000)  # waits for the first
    assert not drives.read(0, STATUS) & REACHED, "target reached, with one more to go"
    highest = 0
    for _ in range(4000):
        drives.period()
        highest = max(highest, drives.read(0, 0x6062))
    assert highest == start + 3000, "the first is reached"
    assert drives.read(0, 0x6062) == start + 1000, "then the second"
    set_point(drives, start + 5000)
    drives.period(50)
    set_point(drives, start - 200, 0x20)
    at = drives.read(0, 0x6062)
    assert at < start + 4000, "it is on its way"
    way = [drives.read(0, 0x6062) for _ in range(4000) if not drives.period()]
    assert max(way) < start + 4900, "it turns round before the first is reached"
    assert way[-1] == start - 200, "and goes to the second"
    # No jump in speed: its differences change by the accelerations at most.
    most = max(drives.read(0, 0x6083), drives.read(0, 0x6084)) * T * T
    assert np.abs(np.diff(way, 2)).max() <= most + 2, "change of speed, rounding in it"


def test_halt_interrupts_a_profile_and_lets_it_go_on() -> None:
    drives = make()
    enable(drives, PP)
    start = drives.read(0, ACTUAL)
    set_point(drives, start + 6000)
    drives.period(100)
    drives.write(0, CONTROL, ENABLE | 0x10 | HALT)
    drives.period(2000)
    rest = drives.read(0, 0x6062)
    assert start < rest < start + 5900, "where it halts"
    assert drives.read(0, STATUS) & REACHED, "it stands"
    drives.period(100)
    assert drives.read(0, 0x6062) == rest, "it goes on standing"
    drives.write(0, CONTROL, ENABLE | 0x10)
    drives.period(4000)
    assert drives.read(0, 0x6062) == start + 6000, "it has gone on"


@pytest.mark.parametrize("option", [1, 2, 3])
@pytest.mark.parametrize("mode", [PV, TQ, CSP, CSV, CST])
def test_halt_stops_every_mode_and_lets_it_go_on(mode: int, option: int) -> None:
    drives = make()
    drives.write(0, 0x605D, option)
    drives.write(0, 0x6065, 0xFFFFFFFF)
    enable(drives, mode)
    at = drives.read(0, ACTUAL)

    def go(periods: int) -> None:
        nonlocal at
        for _ in range(periods):
            at += 4
            drives.write(0, TARGET, at)
            drives.period()

    drives.write(0, 0x60FF, 4000)
    drives.write(0, 0x6071, 60)
    go(400)
    assert drives.read(0, 0x606C) > 2000, "speed before [counts/s]"
    drives.write(0, CONTROL, ENABLE | HALT)
    # Profile torque lets the torque go instead: the friction of the arm slows it down.
    until(drives, lambda: bool(drives.read(0, STATUS) & REACHED))
    drives.period(500)
    rest = drives.read(0, ACTUAL)
    drives.period(500)
    moved = abs(drives.read(0, ACTUAL) - rest)
    assert moved < 20 or mode == TQ, "counts by which it still moves"
    assert drives.read(0, STATUS) & BIT12 == 0 or mode == PV, "it follows no command, or stands"
    if mode == TQ:
        assert drives.read(0, 0x6074) == 0, "torque demand"
    drives.write(0, CONTROL, ENABLE)
    at = drives.read(0, ACTUAL)
    go(400)
    assert drives.read(0, 0x606C) > 2000, "speed when it goes on [counts/s]"


def test_profile_velocity_and_torque_follow_their_slopes() -> None:
    drives = make()
    drives.write(0, 0x6083, 20000)
    drives.write(0, 0x6084, 40000)
    enable(drives, PV)
    drives.write(0, 0x60FF, 8000)
    up = until(drives, lambda: drives.read(0, 0x606B) == 8000)
    assert up == pytest.approx(8000 / 20000 / T, abs=1), "periods of speeding up"
    until(drives, lambda: bool(drives.read(0, STATUS) & REACHED))
    drives.write(0, 0x60FF, -4000)
    down = until(drives, lambda: drives.read(0, 0x606B) == -4000)
    assert down == pytest.approx((8000 / 40000 + 4000 / 20000) / T, abs=1), "periods of turning"
    assert not drives.read(0, STATUS) & BIT12, "it does not stand"
    drives.write(0, CONTROL, ENABLE | HALT)
    until(drives, lambda: drives.read(0, 0x606B) == 0 and bool(drives.read(0, STATUS) & REACHED))
    until(drives, lambda: bool(drives.read(0, STATUS) & BIT12))
    drives.write(0, CONTROL, ENABLE)
    drives.write(0, MODE, TQ)
    drives.write(0, 0x6087, 500)
    drives.write(0, 0x6071, 100)
    begins = drives.read(0, 0x6074)
    drives.period()
    slope = until(drives, lambda: bool(drives.read(0, STATUS) & REACHED))
    assert drives.read(0, SHOWN) == TQ, "mode that is shown"
    assert slope == pytest.approx((100 - begins) / 500 / T, abs=2), "periods to the torque"


@pytest.mark.parametrize("seed", range(4))
def test_modes_change_without_a_jump_of_the_arm(seed: int) -> None:
    """Random modes in motion: the demand begins where the motor is, no fault, no wild current."""
    rng = random.Random(seed)
    drives = make()
    enable(drives, CSV)
    worst = 0.0
    for _ in range(30):
        mode = rng.choice((PP, PV, TQ, CSP, CSV, CST, 0))
        for j in range(N):
            drives.write(j, 0x60FF, rng.randrange(-3000, 3000))
            drives.write(j, 0x6071, rng.randrange(-20, 20))
            drives.write(j, TARGET, drives.read(j, ACTUAL))
            drives.write(j, MODE, mode)
        drives.period(2)
        assert {drives.read(j, SHOWN) for j in range(N)} == {mode}, "mode that is shown"
        for _ in range(20):
            for j in range(N):
                drives.write(j, TARGET, drives.read(j, ACTUAL))
            drives.period()
            worst = max(worst, *np.abs(truth(drives, "current")))
        assert {state(drives, j) for j in range(N)} == {"operation enabled"}, "states"
    # A step of 6000 counts/s takes Kv * 37 rad/s = 11 A; a jump of the demand would take all 20 A.
    assert worst < 16.0, "largest current [A]"


# -------------------------------------------------------------------------- limits, stops, faults


def test_torque_and_speed_stay_within_their_limits_and_state_so() -> None:
    drives = make()
    enable(drives, CSP)
    drives.write(0, 0x6065, 0xFFFFFFFF)
    drives.write(0, 0x6072, 400)
    drives.write(0, 0x60E0, 300)
    drives.write(0, 0x60E1, 250)
    start, torques, limited = drives.read(0, ACTUAL), [], 0
    for k in range(1000):
        drives.write(0, TARGET, start + (2500 if k // 250 % 2 else -2500))
        drives.period()
        torques.append(truth(drives, "current")[0] / 0.02)
        limited += bool(drives.read(0, STATUS) & INTERNAL_LIMIT)
    # The limit is on what is asked for; speeds are observed through counts, see above.
    assert 250 < max(torques) < 312, "largest torque [0.1 %]"
    assert -262 < min(torques) < -220, "smallest torque [0.1 %]"
    assert limited > 200, "periods with the internal limit bit"
    drives = make()
    enable(drives, CSV)
    drives.write(0, 0x6080, 500)  # rpm
    drives.write(0, 0x60FF, 40000)
    drives.period(1500)
    rpm = truth(drives, "omega_m")[0] * 60 / (2 * math.pi)
    assert rpm == pytest.approx(500, rel=0.02), "speed, as limited"
    assert drives.read(0, STATUS) & INTERNAL_LIMIT, "the internal limit bit"
    drives.write(0, 0x6071, 200)
    drives.write(0, MODE, CST)
    drives.period(1500)
    # The torque goes as the speed comes near, see 0x6080 in docs/reference/drives.md.
    assert truth(drives, "omega_m")[0] * 60 / (2 * math.pi) < 510, "speed under a torque"


@pytest.mark.parametrize("mode", [PP, PV, TQ, CSP, CSV, CST])
def test_no_mode_leaves_the_software_limits(mode: int) -> None:
    drives = make()
    at = drives.read(0, ACTUAL)
    drives.write(0, 0x607D, at - 1500, 1)
    drives.write(0, 0x607D, at + 2000, 2)
    drives.write(0, 0x6065, 0xFFFFFFFF)
    enable(drives, mode)
    for sign, limit in ((1, at + 2000), (-1, at - 1500)):
        drives.write(0, 0x60FF, sign * 12000)
        drives.write(0, 0x6071, sign * 60)
        if mode == PP:
            set_point(drives, sign * 10**6)
        farthest = 0
        for k in range(3000):
            step = min(10**6, 12 * k)
            drives.write(0, TARGET, at + sign * step)
            drives.period()
            farthest = max(farthest, sign * (drives.read(0, ACTUAL) - limit))
        # The arm swings when it is stopped: by 12000 counts/s for 10 ms where it is stopped dead,
        # by a third of that where it has slowed down before.
        most = 130 if mode == CSP else 40
        assert -40 <= farthest <= most, f"how far beyond the limit on side {sign} [counts]"
        if mode not in (PV, TQ, CST):
            assert drives.read(0, STATUS) & INTERNAL_LIMIT or mode == CSV, "internal limit"


def test_a_following_error_is_a_fault_after_its_time() -> None:
    drives = make()
    enable(drives, CSP)
    drives.write(0, 0x6065, 300)
    drives.write(0, 0x6066, 60)
    drives.write(0, 0x6085, 40000)
    target = drives.read(0, ACTUAL) + 40000
    drives.write(0, TARGET, target)
    drives.period()
    assert drives.read(0, STATUS) & BIT13, "following error"
    assert drives.read(0, STATUS) & 0x80, "warning"
    after = until(drives, lambda: state(drives) != "operation enabled")
    assert after == 60, "periods [ms] in which it is beyond its window"
    assert state(drives) == "fault reaction", "it slows down"
    assert drives.read(0, ERROR) == 0x8611, "error code"
    assert drives.read(0, 0x1001) == 0x21, "error register"
    speed = abs(drives.read(0, 0x606C))
    took = until(drives, lambda: state(drives) == "fault")
    assert took == pytest.approx(speed / 40000 / T, rel=0.1), "periods of slowing down"
    assert drives.read(0, 0x1003, 0) == 1, "errors that are kept"
    assert drives.read(0, 0x1003, 1) == 0x8611, "the newest of them"
    assert state(drives, 1) == "operation enabled", "the others go on"
    assert drives.plant.measured.applied[0] == 0.0, "the motor has no voltage"
    drives.write(0, CONTROL, RESET)
    drives.period()
    assert state(drives) == "switch on disabled", "after the reset"
    assert drives.read(0, ERROR) == drives.read(0, 0x1001) == 0, "no error"
    assert drives.read(0, 0x1003, 0) == 1, "the history stays"
    drives.write(0, 0x1003, 0)
    assert drives.read(0, 0x1003, 1) == 0, "until it is taken away"
    drives.write(0, MODE, CSV)  # the target is still far away
    command(drives, SHUTDOWN)
    command(drives, ENABLE, 2)
    assert state(drives) == "operation enabled", "enabled once more"


@pytest.mark.parametrize("option", range(9))
@pytest.mark.parametrize("mode", [PP, CSP, CSV, CST])
def test_a_quick_stop_ends_as_its_option_states(option: int, mode: int) -> None:
    drives = make()
    for j in range(N):
        drives.write(j, 0x605A, option)
    drives.write(0, 0x6084, 20000)
    drives.write(0, 0x6085, 60000)
    drives.write(0, 0x6065, 0xFFFFFFFF)
    enable(drives, mode)
    at = drives.read(0, ACTUAL)
    drives.write(0, 0x60FF, 10000)
    drives.write(0, 0x6071, 50)
    drives.write(0, 0x6081, 10000)
    if mode == PP:
        set_point(drives, at + 50000)
    for k in range(800):
        if mode == CSP:
            drives.write(0, TARGET, at + 10 * k)
        drives.period()
    speed = drives.read(0, 0x606B)
    assert speed > 5000, "speed before [counts/s]"
    drives.write(0, CONTROL, 0x0B)
    drives.period()
    stays = option >= 5
    if option == 0:
        assert state(drives) == "switch on disabled", "no stop at all"
        return
    assert state(drives) == "quick stop", "it slows down"
    if not stays:
        drives.write(0, CONTROL, ENABLE)
        drives.period()
        assert state(drives) == "quick stop", "no way back"
        drives.write(0, CONTROL, 0x0B)
    if mode in (PP, CSP, CSV) and option % 4 in (1, 2):
        ramp = speed / (20000 if option % 4 == 1 else 60000) / T
        took = 2 - stays + until(drives, lambda: drives.read(0, 0x606B) == 0)
        assert took == pytest.approx(ramp, abs=2), "periods of slowing down"
    drives.period(3000)
    assert abs(drives.read(0, 0x606C)) < 300, "it stands, but for the swing of the arm"
    assert state(drives) == ("quick stop" if stays else "switch on disabled"), "where it ends"
    drives.write(0, CONTROL, ENABLE)
    drives.write(0, TARGET, drives.read(0, ACTUAL))
    drives.period()
    assert state(drives) == ("operation enabled" if stays else "switch on disabled"), "T16 or not"


@pytest.mark.parametrize("reaction", range(4))
def test_a_lost_master_leads_where_0x6007_states(reaction: int) -> None:
    drives = make()
    for j in range(N):
        drives.write(j, 0x6007, reaction)
        drives.write(j, 0x60FF, 5000)
    enable(drives, CSV)
    drives.period(500)
    drives.lost(error=0x821B)
    drives.period(2000)
    names = ("operation enabled", "fault", "switch on disabled", "switch on disabled")
    assert {state(drives, j) for j in range(N)} == {names[reaction]}, "states"
    assert drives.read(0, ERROR) == (0x821B if reaction == 1 else 0), "error code"
    if reaction:
        command(drives, RESET)
        command(drives, SHUTDOWN)
        assert state(drives) == "ready", "the master is back"


def test_without_power_the_drives_fail_and_wait() -> None:
    drives = make()
    enable(drives, CSP)
    assert drives.read(0, STATUS) & 0x10, "voltage is there"
    drives.plant.powered = False
    drives.period(2)
    assert state(drives) == "fault", "without voltage"
    assert drives.read(0, ERROR) == 0x3220, "undervoltage"
    assert drives.read(0, 0x6079) == 0, "DC link"
    assert not drives.read(0, STATUS) & 0x10, "no voltage"
    command(drives, RESET)
    command(drives, SHUTDOWN)
    command(drives, ENABLE, 5)
    assert state(drives) == "ready", "it waits for voltage"
    drives.plant.powered = True
    drives.period(3)
    assert state(drives) == "operation enabled", "it goes on by itself: the command is still there"


def test_a_machine_that_diverges_is_a_fault_that_stays_until_it_is_reset() -> None:
    drives = make()
    enable(drives, CSV)
    drives.plant.state = dataclasses.replace(drives.plant.state, v=np.full(N, 1e6))
    with pytest.raises(Diverged):
        drives.period(10)
    assert {state(drives, j) for j in range(N)} == {"fault"}, "states"
    assert drives.read(0, ERROR) == 0x6100, "error code"
    for j in range(N):
        drives.write(j, CONTROL, RESET)
    with pytest.raises(Diverged):
        drives.period()
    assert state(drives) == "fault", "the cause is still there"
    drives.plant.reset()
    drives.begin()
    command(drives, SHUTDOWN)
    assert state(drives) == "ready", "after a reset of the machine"


def test_a_hot_motor_is_a_fault_until_it_is_cool() -> None:
    drives = make(RICH)
    enable(drives, CSP)
    drives.write(0, 0x6065, 0xFFFFFFFF)
    drives.write(0, 0x607D, 0, 1)
    drives.write(0, 0x607D, 0, 2)
    drives.write(0, TARGET, 200000)
    until(drives, lambda: state(drives) == "fault")  # at its stop, at full current
    assert drives.read(0, ERROR) == 0x4310, "motor too hot"
    assert drives.read(0, 0x1001) == 0x09, "error register"
    drives.write(0, CONTROL, RESET)
    drives.period()
    assert state(drives) == "fault", "it is still hot"
    drives.period(200)
    assert drives.read(0, 0x2004) == 1, "the brake"
    drives.write(0, CONTROL, 0)
    drives.period()
    drives.write(0, CONTROL, RESET)
    drives.period()
    assert state(drives) == "switch on disabled", "it has cooled down"


# ------------------------------------------------------------------- brakes, homing, touch probes


def test_brakes_open_before_and_close_behind_the_motion() -> None:
    """The arm does not sag under gravity while a brake is on its way."""
    drives = make(RICH)
    drives.period(60)  # closed by now
    assert drives.read(1, 0x2004) == 1, "a drive that is not enabled is braked"
    held = truth(drives, "theta_m").copy()
    for j in range(N):
        drives.write(j, MODE, CSP)
        drives.write(j, TARGET, drives.read(j, ACTUAL))
    command(drives, SHUTDOWN)
    command(drives, ENABLE)
    waited = until(drives, lambda: state(drives, 1) == "operation enabled")
    assert waited == pytest.approx(RELEASE / T, abs=2), "periods until the brake is open"
    drives.period(500)
    command(drives, SWITCH_ON)
    closed = until(drives, lambda: drives.read(1, 0x2004) == 1)
    assert closed == pytest.approx(CLOSE / T, abs=2), "periods until the brake is closed"
    drives.period(50)
    assert drives.plant.measured.applied[1] == 0.0, "the motor is let go once it is braked"
    turned = (truth(drives, "theta_m") - held) * 1024 / (2 * math.pi)
    # The weight moves from the brake to the motor, which finds it by its integral: some counts.
    assert np.abs(turned).max() < 12, "counts by which the motors have turned"
    enable(drives, CSP)
    drives.write(1, CONTROL, 0)  # disable voltage: at once, and it sags
    drives.period()
    assert drives.plant.measured.applied[1] == 0.0, "no voltage at once"


def test_homing_here_puts_the_offset_there() -> None:
    drives = make()
    for j, method in enumerate((35, 37, 37)):
        drives.write(j, 0x6098, method)
        drives.write(j, 0x607C, 1000 * (j + 1))
    enable(drives, HM)
    assert not drives.read(0, STATUS) & BIT12, "home is not attained yet"
    command(drives, ENABLE | 0x10, 2)
    for j in range(N):
        assert drives.read(j, ACTUAL) == 1000 * (j + 1), "position at the home"
        assert drives.read(j, STATUS) & (BIT12 | BIT13 | REACHED) == BIT12 | REACHED, "attained"
    with pytest.raises(Aborted, match="06090030"):
        drives.write(0, 0x6098, 33)  # no index pulse here
    assert [drives.read(0, 0x60E3, k) for k in range(3)] == [2, 35, 37], "supported methods"


@pytest.mark.parametrize("method", [33, 34, -1, -2, -3, -4])
def test_homing_finds_index_pulses_and_stops(method: int) -> None:
    drives = make(RICH)
    enable(drives, HM)
    j = 0  # the waist, which gravity leaves alone
    drives.write(j, 0x6098, method)
    drives.write(j, 0x607C, 77)
    drives.write(j, 0x6099, 20000, 1)
    before = drives.read(j, 0x6063)
    drives.write(j, CONTROL, ENABLE | 0x10)
    drives.period(2)
    assert not drives.read(j, STATUS) & (BIT12 | REACHED), "it is under way"
    until(drives, lambda: bool(drives.read(j, STATUS) & BIT12), 20000)
    drives.period(300)
    home = drives.read(j, 0x6063) - (drives.read(j, ACTUAL) - 77)
    per_rad = 1024 / (2 * math.pi) / 0.01
    forward = method in (34, -1, -3)
    if method in (33, 34):
        pulse = 1024 * (before // 1024 + (1 if forward else 0))
        assert abs(home - pulse) <= 1, "the next index pulse"
    else:
        stop = (2.0 if forward else -2.0) * per_rad
        # Pressed by 30 % of 1 N m behind 1:100 into 3000 N/m rad, and the gear is wound up by it.
        pressed = 1.2 * (30.0 / 3000.0 + 30.0 / 1e4) * per_rad
        turn = 1024 if method >= -2 else 0
        if forward:
            assert stop - turn <= home <= stop + pressed, "home at the stop ahead"
        else:
            assert stop - pressed <= home <= stop + turn, "home at the stop behind"
        if turn:
            assert home % 1024 in (0, 1023), "an index pulse"


def test_homing_that_finds_nothing_or_is_broken_off_states_so() -> None:
    drives = make(RICH)
    enable(drives, HM)
    drives.write(0, 0x6098, 34)
    drives.write(0, 0x6072, 0)  # it cannot move
    drives.write(0, CONTROL, ENABLE | 0x10)
    drives.period(100)
    assert not drives.read(0, STATUS) & (BIT12 | REACHED), "it is looking"
    drives.write(0, CONTROL, ENABLE)
    drives.period(100)
    assert drives.read(0, STATUS) & (BIT12 | REACHED) == REACHED, "broken off"


def test_touch_probes_store_the_position_of_index_pulses() -> None:
    drives = make(RICH)
    enable(drives, CSV)
    drives.write(0, 0x60FF, 8000)
    drives.write(0, 0x60B8, 0x0015 | 0x17 << 8)  # 1: the first one, 2: every one
    drives.period()
    assert drives.read(0, 0x60B9) == 0x0101, "both are on"
    until(drives, lambda: drives.read(0, 0x60B9) == 0x0303)
    first = drives.read(0, 0x60BA)
    assert first % 1024 == 0, "position of an index pulse"
    until(drives, lambda: drives.read(0, 0x60BC) == first + 2048)
    assert drives.read(0, 0x60BA) == first, "the first one stays"
    drives.write(0, 0x60B8, 0)
    drives.period()
    assert drives.read(0, 0x60B9) == 0, "off"


@pytest.mark.parametrize("seed", range(4))
def test_a_master_that_writes_at_random_never_breaks_a_drive(seed: int) -> None:
    """Any value in any entry of the drive in motion: one state, no voltage unless it controls."""
    rng = random.Random(seed)
    drives = make(RICH if seed % 2 else PLAIN)
    entries = [one for one in dictionary() if one.index >= 0x2000 and one.access == "rw"]
    lively = [one for one in entries if one.rx and one.index != CONTROL]
    likely = [
        SHUTDOWN,
        SWITCH_ON,
        RESET,
        0x0B,
        *(ENABLE | bits for bits in (0, 0, 0x10, 0x30, HALT)),
    ]
    seen, before = set(), [""] * N
    for k in range(1500):
        for j in range(N):
            if rng.random() < 0.05:
                drives.write(j, CONTROL, rng.choice(likely))
            one = rng.choice(lively if rng.random() < 0.8 else entries)
            value = rng.choice((one.least, one.most, rng.randint(one.least, one.most), k % 128))
            if one.index == TARGET:
                value = drives.read(j, ACTUAL) + rng.randrange(-2000, 2000)
            with contextlib.suppress(Aborted):
                drives.download(j, one.index, one.sub, value.to_bytes(9, "little", signed=True)
                                [: one.bits // 8])  # fmt: skip
        if k % 100 == 0:
            drives.lost(rng.randrange(-1, N))
        drives.period()
        for j in range(N):
            now = state(drives, j)
            seen.add(now)
            # A fault comes at the end of a period. Brakes: the motor is held while they move.
            off = now in ("switch on disabled", "ready", "switched on", "fault")
            if off and before[j] == now and drives.plant.scene is PLAIN:
                assert drives.plant.measured.applied[j] == 0.0, f"command in {now}, period {k}"
            assert abs(drives.plant.measured.applied[j]) <= PLAIN.supply_voltage, (
                f"command, period {k}"
            )
            before[j] = now
    assert len(seen) >= 4, f"states that were seen: {seen}"
    assert "operation enabled" in seen, "it was enabled"
    assert np.isfinite(drives.plant.state.q).all(), "the arm"


def test_what_field_buses_need_is_compiled_ahead_on_request(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    units: list[str] = []

    def note(some: Iterable[Unit], *_: object) -> list[Path]:
        units.extend(unit.name for unit in some)
        return []

    monkeypatch.setattr("arm_emulator.build.unit.compile_units", note)
    monkeypatch.setattr("sys.argv", ["arm_emulator", "compile", "three_axis", "--fieldbus"])
    with pytest.raises(SystemExit) as end:
        main()
    assert end.value.code == 0, "exit code"
    assert {"drives", "ethercat"} < set(units), "what is compiled"


def test_what_has_no_drive_is_refused_in_one_line() -> None:
    with pytest.raises(Refusal, match=r"servo.joint_names must name every moving joint"):
        Drives(Plant(PLAIN), load_servo_config(ROOT / "config/servo/ur5.yaml"), ETHERCAT)


def test_the_same_words_give_the_same_bits() -> None:
    def run() -> tuple[bytes, list[bytes]]:
        rng, drives = random.Random(5), make()
        enable(drives, CSP)
        reported = []
        for _ in range(500):
            for j in range(N):
                drives.write(j, MODE, rng.choice((CSP, CSP, CSV, CST)))
                drives.write(j, TARGET, drives.read(j, ACTUAL) + rng.randrange(-50, 50))
                drives.write(j, 0x60FF, rng.randrange(-2000, 2000))
                drives.write(j, 0x6071, rng.randrange(-50, 50))
            drives.period()
            reported.append(drives.upload(0, ACTUAL) + drives.upload(1, STATUS))
        return drives.plant.save(), reported

    assert run() == run(), "the whole machine and what the drives report"


# ---------------------------------------------------------------------------------- documentation


def dictionary_rows() -> list[str]:
    """The dictionary as drives.md lists it: objects of the buses, entries of the drive.

    Objects that parts declare stand on the page of quantities.
    """
    drives = make()
    rows = ["| index | object | sub-indices | on |", "|---|---|---|---|"]
    for one in dictionary():
        if one.index < 0x2000 and one.sub == 0:
            on = {1: "EtherCAT", 2: "CANopen", 3: "both"}[one.buses]
            rows.append(f"| 0x{one.index:04X} | {one.object} | {one.last_sub or ''} | {on} |")
    rows += [
        "",
        "| index | entry | type | access | PDO | unit | at first | range |",
        "|---|---|---|---|---|---|---|---|",
    ]
    for one in dictionary():
        if one.index < 0x2000 or one.index in OF_PARTS:
            continue
        where = f"0x{one.index:04X}" + (f":{one.sub}" if one.last_sub else "")
        name = one.object if not one.sub else f"{one.object}: {one.name}"
        pdo = " ".join(word for word, may in (("rx", one.rx), ("tx", one.tx)) if may)
        value = drives.read(0, one.index, one.sub)
        live = one.access == "ro" and one.tx
        first = "" if live else str(one.standard) if value == one.standard else "scene"
        signed = one.type.startswith("I")
        whole = one.least == (-(1 << one.bits - 1) if signed else 0)
        whole &= one.most == (1 << one.bits - signed) - 1
        bounds = "" if whole or "w" not in one.access else f"{one.least} to {one.most}"
        cells = (where, name, one.type, one.access, pdo, one.unit, first, bounds)
        rows.append(f"| {' | '.join(cells)} |")
    return rows


def test_the_page_lists_the_dictionary() -> None:
    page = page_of("drives").read_text()
    rows = "\n".join(dictionary_rows())
    assert page.endswith(f"\n{rows}\n"), f"the end of drives.md; it should be\n{rows}"
