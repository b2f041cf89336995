"""Drives behind field buses: dictionary, state machine, modes, limits, stops, faults, homing."""

from __future__ import annotations

import itertools
import math
import random
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from emulator_node.plant import Diverged, Plant
from emulator_node.scene import Scene, load_scene
from fieldbus.drives import CANOPEN, ETHERCAT, Aborted, Drives, Entry, dictionary
from servo_node.servo import Servo, load_servo_config
from words.refusal import Refusal

ROOT = Path(__file__).resolve().parents[1]
SERVO = load_servo_config(ROOT / "config/servo/three_axis.yaml")
PLAIN = load_scene("three_axis")
N, T = len(PLAIN.joints), PLAIN.servo_period
CLOSE, RELEASE = 0.012, 0.025  # s
# Everything that a drive may know of: under gravity, between stops, with brakes and index pulses.
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
        "joints.*.motor.winding": {
            "heat_capacity": 20.0,
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
    for j in range(N):
        drives.write(j, CONTROL, word)
    drives.period(periods)


def enable(drives: Drives, mode: int) -> None:
    """All drives, as masters do it; the targets are where the motors are."""
    for j in range(N):
        drives.write(j, MODE, mode)
        drives.write(j, TARGET, drives.read(j, ACTUAL))
    for word in (SHUTDOWN, SWITCH_ON, ENABLE):
        command(drives, word)
    for _ in range(1000):
        if all(state(drives, j) == "operation enabled" for j in range(N)):
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


def expected_abort(one: Entry | None, known_object: bool, size: int, value: int) -> int:
    """What CiA 301 says of a write."""
    if one is None:
        return 0x06090011 if known_object else 0x06020000
    if one.access in ("const", "ro"):
        return 0x06010002
    if size != one.bits // 8:
        return 0x06070012 if size > one.bits // 8 else 0x06070013
    if value > one.most:
        return 0x06090031
    return 0x06090032 if value < one.least else 0


# What the drive has a say in, beside the range: mappings, histories, stores, modes, methods.
SPECIAL = {0x1003, 0x1010, 0x1011, 0x1C12, 0x1C13, MODE, 0x6098, *range(0x1600, 0x1604)} | {
    *range(0x1A00, 0x1A04)
}


def test_random_accesses_crash_nothing_and_refused_ones_change_nothing() -> None:
    """100 000 reads and writes: codes by the rules of CiA 301, values as a model has them."""
    rng = random.Random(402)
    drives = make()
    known = {(one.index, one.sub): one for one in dictionary() if one.buses & ETHERCAT}
    objects = {index for index, _ in known}
    model = {key: drives.upload(0, *key) for key in known}
    writable = [key for key, one in known.items() if one.access == "rw"]
    keys, taken, refused = list(known), 0, 0
    for k in range(100_000):
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
        expected = expected_abort(one, key[0] in objects, size, value)
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
    assert min(taken, refused) > 10_000, f"{taken} taken, {refused} refused"
    # Whatever was set, the drive goes on.
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
        "fault": (SHUTDOWN,),
    }[where]
    for word in words:
        command(drives, word)
    if where == "fault":
        drives.lost()
    assert {state(drives, j) for j in range(N)} == {where}, "where the drives were brought"


def test_every_state_takes_every_command_as_the_table_says() -> None:
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
                    command(drives, before | SHUTDOWN)
                    drives.lost()
                    drives.write(0, CONTROL, before)
                    drives.period()
            told = command_of(word, before, where)
            drives.write(0, CONTROL, word)
            drives.period()
            transition, after = TABLE.get((where, told), (0, where))
            assert state(drives) == after, f"from {where} by 0x{word:02x} after 0x{before:02x}"
            seen.add(transition)
    assert seen == {0, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 15, 16}, "transitions that were taken"


class Model:
    """The state machine as CiA 402 tells it, of a drive that stands still, for random walks."""

    def __init__(self) -> None:
        self.state, self.word, self.powered = "switch on disabled", 0, True
        self.options = {0x605A: 2, 0x605B: 0, 0x605C: 1, 0x6007: 1}

    def take(self, word: int) -> None:
        """Go on under one word until nothing changes any more."""
        for _ in range(4):
            told = command_of(word, self.word, self.state)
            self.word = word
            transition, after = TABLE.get((self.state, told), (0, self.state))
            if transition == 3 and not self.powered:
                after = "ready"
            if self.state == "switched on" and not self.powered and transition in (0, 4):
                after = "ready"
            if transition == 11 and self.options[0x605A] < 5:
                after = "switch on disabled"  # when it stands
            self.state = after

    def lose_master(self) -> None:
        reaction = self.options[0x6007]
        if reaction == 1:
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
def test_random_commands_options_and_losses_lead_where_a_model_says(seed: int) -> None:
    """3000 words and events on a drive that stands still: every stop is over in a few periods."""
    rng = random.Random(seed)
    drives, model, seen = make(), Model(), set()
    drives.write(0, MODE, CSV)
    likely = (SHUTDOWN, SWITCH_ON, ENABLE, ENABLE, RESET, 0, 0x0B, SHUTDOWN | RESET)
    for k in range(3000):
        event = rng.random()
        if event < 0.05 and model.state not in ("operation enabled", "quick stop"):
            index = rng.choice(list(model.options))
            model.options[index] = rng.randrange({0x605A: 8, 0x6007: 4}.get(index, 2))
            drives.write(0, index, model.options[index])
        elif 0.05 < event < 0.07:
            drives.lost(0)
            model.lose_master()
        elif 0.07 < event < 0.09:
            drives.plant.powered = model.powered = not model.powered
            if not model.powered:
                model.lose_power()
            drives.period()
        drives.period(4)
        word = rng.choice(likely) if rng.random() < 0.8 else rng.randrange(256)
        drives.write(0, CONTROL, word)
        drives.period(5)
        model.take(word)
        assert state(drives) == model.state, f"after word {k}, 0x{word:02x}, {model.options}"
        seen.add(model.state)
    assert len(seen) == 6, f"states that it was in: {seen}"


# -------------------------------------------------------------------------------------- the modes


def truth(drives: Drives, name: str) -> np.ndarray:
    return np.array(getattr(drives.plant.state, name))


@pytest.mark.parametrize("feedforward", [0, 1000])
def test_cyclic_position_is_our_own_servo_to_the_last_bit(feedforward: int) -> None:
    """The same targets to the servo, in counts as their middles, give the same voltages."""
    drives, plant, servo = make(), Plant(PLAIN), Servo(SERVO)
    ratio = np.array([joint.gear_ratio for joint in SERVO.joints])
    count_angle = 2.0 * math.pi / np.array([joint.counts_per_turn for joint in SERVO.joints])
    for j in range(N):
        drives.write(j, 0x2001, feedforward)
    enable(drives, CSP)
    measured = plant.measured
    servo.observe(measured.encoder_counts, measured.current)
    for _ in range(2):  # two words, then Operation enabled
        servo.release()
        plant.exchange(np.zeros(N))
        servo.observe(plant.measured.encoder_counts, plant.measured.current, plant.voltage)
    position = plant.measured.encoder_counts.astype(float)
    speed, start = np.zeros(N), position.copy()
    smoothing = 1e-4 * drives.read(0, 0x2002)
    worst = 0.0
    for k in range(1500):
        target = start + np.round(900.0 * (1.0 - math.cos(0.003 * k)) * np.array([1.0, -1.0, 0.5]))
        if k:
            for j in range(N):
                drives.write(j, TARGET, int(target[j]))
            drives.period()
        else:
            target = start  # that of `enable`
        speed = speed + ((target - position) / T - speed) * (T / (T + smoothing))
        position = target
        q = (position + 0.5) * count_angle * ratio
        v = 1e-3 * feedforward * speed * count_angle * ratio
        plant.exchange(servo.control(q, v))
        assert (drives.plant.voltage == plant.voltage).all(), f"voltages in period {k}"
        servo.observe(plant.measured.encoder_counts, plant.measured.current, plant.voltage)
        worst = max(worst, abs(drives.read(0, 0x60F4)))
    assert (truth(drives, "q") == plant.state.q).all(), "link angles"
    # Without feed-forward it lags by speed / Kp: 900 * 3 rad/s / 30 1/s.
    lag = 90.0 if feedforward == 0 else 0.0
    assert worst == pytest.approx(lag, abs=25.0), "following error, the swing of the arm in it"


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
        told = np.mean([drives.read(j, 0x606C) for _ in range(50) if not drives.period()])
        assert told == pytest.approx(speed, rel=0.02), "velocity actual value, a mean of 50"
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
        told = [drives.read(j, 0x6077) for j in range(N)]
        np.testing.assert_allclose(told, at, atol=0.51, err_msg="torque actual value")
    np.testing.assert_allclose(np.mean(off, axis=0), 0.0, atol=1.0, err_msg="mean of what is off")


def trapezoid(way: float, speed: float, up: float, down: float) -> float:
    """Duration of a motion from rest to rest."""
    peak = min(speed, math.sqrt(2.0 * up * down * way / (up + down)))
    even = way - 0.5 * peak * peak * (1.0 / up + 1.0 / down)
    return peak / up + peak / down + max(0.0, even) / peak


def set_point(drives: Drives, target: int, bits: int = 0, j: int = 0) -> None:
    """The handshake of profile position."""
    drives.write(j, CONTROL, ENABLE | bits)
    drives.period()
    assert not drives.read(j, STATUS) & BIT12, "set-point acknowledge before"
    drives.write(j, TARGET, target)
    drives.write(j, CONTROL, ENABLE | bits | 0x10)
    drives.period()
    assert drives.read(j, STATUS) & BIT12, "set-point acknowledge"


@pytest.mark.parametrize("seed", range(6))
def test_a_profile_arrives_when_its_trapezoid_says(seed: int) -> None:
    rng = np.random.default_rng([seed, 1])
    drives = make()
    enable(drives, PP)
    start = drives.read(0, ACTUAL)
    way = int(rng.choice([-1, 1])) * int(10 ** rng.uniform(1, 4.2))
    speed, up, down = (int(10 ** rng.uniform(3.0, 4.3)) for _ in range(3))
    up, down = 4 * up, 4 * down
    for index, value in ((0x6081, speed), (0x6083, up), (0x6084, down)):
        drives.write(0, index, value)
    drives.write(0, 0x6065, 0xFFFFFFFF)  # the arm may swing
    if seed % 2:
        set_point(drives, way, 0x40)
    else:
        set_point(drives, start + way)
    demands = [drives.read(0, 0x6062)]
    periods = 1 + until(drives, lambda: drives.read(0, 0x6062) == start + way, 60000)
    predicted = trapezoid(abs(way), speed, up, down) / T
    # The last half count takes the square root of 2 * 0.5 / down; periods are whole.
    early = math.sqrt(1.0 / down) / T
    assert predicted - early - 1 <= periods <= predicted + 1, f"periods of {way} counts"
    until(drives, lambda: bool(drives.read(0, STATUS) & REACHED))
    assert abs(drives.read(0, ACTUAL) - start - way) <= 10, "position, within its window"
    assert demands, "demands were read"


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
