"""Drives against the text of CiA 402 and CiA 301, a claim per test.

The profiles are quoted by makers' manuals; each test names the manual whose wording it follows.
"""

from dataclasses import replace
from typing import Any

import pytest
from cia402 import (
    ACTUAL,
    BIT12,
    BIT13,
    CONTROL,
    CSP,
    CSV,
    ENABLE,
    ERROR,
    HALT,
    HM,
    PLAIN,
    PP,
    REACHED,
    RICH,
    SERVO,
    STATUS,
    TARGET,
    TQ,
    command,
    enable,
    make,
    set_point,
    state,
    until,
)
from draws import with_slow
from ethercat_master import master

from arm_emulator import Plant, Refusal, Scene, load_scene
from arm_emulator_fieldbus.drives import Drives
from arm_emulator_fieldbus.drives_unit import ETHERCAT
from arm_emulator_fieldbus.object_dictionary import Aborted

__all__ = ["master"]  # a fixture

LARGEST = 2**31 - 1

# ---------------------------------------------------------------------------------------- homing


@pytest.mark.parametrize("choice", ["home_to_zero", "zero_to_home"])
def test_the_zero_position_is_the_home_position_plus_the_home_offset(choice: str) -> None:
    """0x607C is added to the home position to get the zero position, or the reverse by choice.

    Elmo, CANopen DSP 402 Implementation Guide, 9.2; Parker TPDM, 12.1.7.1.
    """
    drives = make(load_scene("three_axis", overrides={"home_offset": choice}))
    drives.write(0, 0x6098, 35)
    drives.write(0, 0x607C, 1000)
    enable(drives, HM)
    home = drives.read(0, 0x6063)
    command(drives, ENABLE | 0x10, 2)
    zero = drives.read(0, 0x6063) - drives.read(0, ACTUAL)
    assert zero - home == (1000 if choice == "home_to_zero" else -1000)
    assert PLAIN.home_offset == "home_to_zero", "the profile's text is the default"


def test_another_meaning_of_the_home_offset_is_refused() -> None:
    with pytest.raises(Refusal, match=r"home_offset must be one of .* valid: home_to_zero, zero_"):
        load_scene("three_axis", overrides={"home_offset": "plus"})


def test_homing_method_0_is_accepted_and_a_start_with_it_fails() -> None:
    """0x6098 = 0: no homing method is assigned. Nothing moves, and bit 13 reports the start."""
    drives = make()
    drives.write(0, 0x6098, 0)
    enable(drives, HM)
    before = drives.read(0, ACTUAL)
    command(drives, ENABLE | 0x10, 20)
    assert drives.read(0, STATUS) & (BIT12 | BIT13) == BIT13
    assert abs(drives.read(0, ACTUAL) - before) <= 1
    assert 0 not in [drives.read(0, 0x60E3, k + 1) for k in range(drives.read(0, 0x60E3))]


# ---------------------------------------------------------------------------------- bit 10, stops


@pytest.mark.parametrize("option", [1, 2, 3, 5, 6, 7, 8])
@pytest.mark.parametrize("mode", [CSV, HM, TQ])
def test_a_quick_stop_sets_target_reached_when_the_drive_has_halted(mode: int, option: int) -> None:
    """With 0x605A = 5 to 8, bit 10 is set when the quick stop is finished and the drive halted.

    Parker, TWIN-N/SPD-N user's manual, bit 10 of the statusword.
    """
    drives = make(RICH)
    drives.write(0, 0x605A, option)
    drives.write(0, 0x6098, -3)
    drives.write(0, 0x6099, 20000, 1)
    enable(drives, mode)
    drives.write(0, 0x60FF, 20000)
    drives.write(0, 0x6071, 100)
    drives.write(0, CONTROL, ENABLE | 0x10)
    until(drives, lambda: drives.read(0, 0x606C) > 12000)
    drives.write(0, CONTROL, 0x02)
    drives.period()
    assert state(drives) == "quick stop"
    threshold = drives.read(0, 0x606F) * drives.read(0, 0x2007)
    reached, before = False, drives.read(0, 0x606C)
    for _ in range(3000):
        if state(drives) != "quick stop":
            break
        if drives.read(0, STATUS) & REACHED and not reached:
            reached = True  # at the speed that the period began with; the link may swing on
            assert abs(before) <= threshold
        before = drives.read(0, 0x606C)
        drives.period()
    if option >= 5:
        assert state(drives) == "quick stop" and drives.read(0, STATUS) & REACHED
    else:
        assert state(drives) == "switch on disabled" and not reached


def test_halt_in_profile_torque_sets_target_reached_once_the_axis_stands() -> None:
    """With halt, bit 10 is 0 while the axis decelerates, and 1 when its velocity is 0.

    Danfoss, VLT servo drive programming guide, table 7.27; Festo CMMP-AS, controlword, bit 8:
    the torque is lowered to zero with the torque slope.
    """
    drives = make()
    enable(drives, TQ)
    drives.write(0, 0x6071, 300)
    until(drives, lambda: drives.read(0, 0x606C) > 30000)
    assert drives.read(0, STATUS) & REACHED, "the torque is reached"
    command(drives, ENABLE | HALT)
    threshold = drives.read(0, 0x606F) * drives.read(0, 0x2007)
    assert not drives.read(0, STATUS) & REACHED, "it decelerates"
    for _ in range(20000):
        stands = abs(drives.read(0, 0x606C)) <= threshold  # as the next period begins
        drives.period()
        assert bool(drives.read(0, STATUS) & REACHED) == (stands and not drives.read(0, 0x6074))
        if drives.read(0, STATUS) & REACHED:
            break
    assert drives.read(0, STATUS) & REACHED, "it has come to rest"
    command(drives, ENABLE, 100)
    assert drives.read(0, 0x6074) == 300, "the motion goes on without halt"


# ------------------------------------------------------------------------------- profile position


@pytest.mark.parametrize("relative", [False, True])
def test_change_immediately_takes_a_set_point_while_the_buffer_is_full(relative: bool) -> None:
    """Bit 5: the next positioning starts immediately; else after the present one is completed.

    Applied Motion ST10, appendix K. The set-point that waits is overwritten; a relative one counts
    from the target in progress.
    """
    drives = make()
    enable(drives, PP)
    start = drives.read(0, ACTUAL)
    set_point(drives, start + 60000)
    set_point(drives, start - 60000)
    drives.write(0, CONTROL, ENABLE)
    drives.period()
    assert drives.read(0, STATUS) & BIT12, "the buffer is full"
    drives.write(0, TARGET, start)
    command(drives, ENABLE | 0x10, 2)
    command(drives, ENABLE, 2)
    assert drives.read(0, 0x606B) > 0, "a further one that waits is not taken"
    drives.write(0, TARGET, -30000 if relative else start + 30000)
    command(drives, ENABLE | 0x30 | (0x40 if relative else 0), 1)
    assert drives.read(0, STATUS) & BIT12, "acknowledged"
    command(drives, ENABLE, 1)
    assert not drives.read(0, STATUS) & BIT12, "the buffer is free"
    until(drives, lambda: bool(drives.read(0, STATUS) & REACHED), 30000)
    drives.period(2000)
    assert drives.read(0, 0x6062) == start + 30000, "it ends at the newest, and nowhere else"


# ----------------------------------------------------------------------------------------- limits


@pytest.mark.parametrize("mode", [CSP, CSV, PP])
def test_an_endless_joint_rotates_beyond_31_bits(mode: int) -> None:
    """The position wraps at the ends of 0x607B, where 0x607D limits nothing."""
    drives = make()
    assert [drives.read(0, 0x607D, k) for k in (1, 2)] == [-LARGEST - 1, LARGEST]
    drives.write(0, 0x607C, 200 - LARGEST)
    enable(drives, HM)
    command(drives, ENABLE | 0x10, 3)
    assert drives.read(0, ACTUAL) == LARGEST - 200
    enable(drives, mode)
    if mode == CSP:
        for k in range(300):
            drives.write(0, TARGET, ((LARGEST - 200 + 3 * k) + 2**31) % 2**32 - 2**31)
            drives.period()
    elif mode == CSV:
        drives.write(0, 0x60FF, 9000)
    else:
        drives.write(0, TARGET, 2000)
        command(drives, ENABLE | 0x70)
    until(drives, lambda: drives.read(0, ACTUAL) < 0, 3000)
    drives.period(100)
    assert -(2**31) <= drives.read(0, ACTUAL) < -(2**31) + 5000
    assert drives.read(0, ERROR) == 0


def test_a_limit_on_a_single_side_still_holds() -> None:
    drives = make()
    enable(drives, CSP)
    drives.write(0, 0x607D, 500, 2)
    at = drives.read(0, ACTUAL)
    for k in range(1000):
        drives.write(0, TARGET, at + k)
        drives.period()
    assert drives.read(0, 0x6062) == 500


@pytest.mark.parametrize("bits", with_slow([10, 24, 14, 17, 20, 23], 1))
def test_windows_and_decelerations_scale_with_the_encoder(bits: int) -> None:
    """Angles at the motor are those of 10 bits, and the motor stops in the same time.

    0x606D and 0x606F have 16 bits by the profile; 0x2007 and 0x2008 are the units that keep them,
    and accelerations of 32 bits, from saturating. They are 1 for encoders up to 16 bits.
    """
    coarse, fine = encoder(10), encoder(bits)
    factor = 2.0 ** (bits - 10)
    units = {0x6067: 1, 0x606D: 0x2007, 0x606F: 0x2007}
    units |= dict.fromkeys((0x6083, 0x6084, 0x6085, 0x609A), 0x2008)
    for index, unit in units.items():
        was, now = (
            drive_set.read(0, index) * (1 if unit == 1 else drive_set.read(0, unit))
            for drive_set in (coarse, fine)
        )
        # Rounded to whole counts, of 10 for the position window.
        tolerance = 0.03 if index == 0x6067 else 1e-3
        assert now == pytest.approx(was * factor, rel=tolerance), hex(index)
    if bits <= 14:
        assert fine.read(0, 0x2007) == fine.read(0, 0x2008) == 1
    times = []
    for drives, scale in ((coarse, 1.0), (fine, factor)):
        enable(drives, CSV)
        drives.write(0, 0x60FF, round(30000 * scale))
        drives.period(1000)
        drives.write(0, 0x605A, 6)
        drives.write(0, CONTROL, 0x02)
        times.append(until(drives, lambda d=drives: bool(d.read(0, STATUS) & REACHED)))
    # The speeds are observed through counts: the coarse encoder decides some periods later.
    assert times[1] == pytest.approx(times[0], abs=15)


def encoder(bits: int) -> Drives:
    counts = 2**bits
    scene = load_scene("three_axis", overrides={"joints.*.encoder.counts_per_turn": counts})
    joints = tuple(replace(joint, counts_per_turn=counts) for joint in SERVO.joints)
    return Drives(Plant(scene), replace(SERVO, joints=joints), ETHERCAT)


# ------------------------------------------------------------------------------------ touch probes


@pytest.mark.parametrize("probe", [0, 1])
def test_a_touch_probe_that_would_never_trigger_is_refused(probe: int) -> None:
    """0x60B8 bits 2 and 3: 0 is the probe's input, 1 the zero impulse, 2 the source 0x60D0.

    Beckhoff TF5500, ETouchProbeTriggerSource. Drives have no input, an index pulse one edge.
    """
    drives, without = make(RICH), make()
    for function in (0x11, 0x13, 0x19, 0x1D, 0x25, 0x35):
        with pytest.raises(Aborted, match="06090030"):
            drives.write(0, 0x60B8, function << 8 * probe)
    for function in (0x15, 0x17, 0x05, 0x00, 0x10, 0x38):  # bit 0 enables the probe
        drives.write(0, 0x60B8, function << 8 * probe)
    without.write(0, 0x60B8, 0x3838)
    with pytest.raises(Aborted, match="06090030"):
        without.write(0, 0x60B8, 0x15 << 8 * probe)


# ------------------------------------------------------------------------- properties of the drive

MOTORS: dict[str, tuple[dict[str, Any], int]] = {
    "dc": ({}, 13),
    "pmsm": (
        {
            "kind": "pmsm",
            "resistance": 1.0,
            "inductance_d": 1e-3,
            "inductance_q": 1e-3,
            "flux": 0.0125,
            "pole_pairs": 4,
            "rotor_inertia": 1e-4,
        },
        10,
    ),
    "torque": ({"kind": "torque", "torque_limit": 1.0, "rotor_inertia": 1e-4}, 0),
}


def test_the_motor_type_is_that_of_the_motor() -> None:
    """0x6402: 13 commutator and permanent magnets, 10 sinusoidal brushless, 0 non-standard.

    Table of 0x6402 at techoverflow.net, "CiA 402: How to write the motor type".
    """
    from arm_emulator.machine.scene.known_parts import MOTORS as ALL

    types = {kind.kind: kind.cia_type for kind in ALL}
    assert types == {"dc": 13, "pmsm": 10, "stepper": 9, "torque": 0, "current": 0}
    drives = make(load_scene("three_axis", {"joints.elbow.motor": MOTORS["pmsm"][0]}))
    assert [drives.read(j, 0x6402) for j in range(3)] == [13, 13, 10]


@pytest.mark.parametrize(
    ("index", "sub"),
    [
        *((index, sub) for index in (0x607B, 0x608F, 0x6091, 0x6092) for sub in (1, 2)),
        *((index, 0) for index in (0x6075, 0x6076, 0x6402)),
    ],
)
def test_properties_of_the_machine_may_be_written_as_they_are(index: int, sub: int) -> None:
    """The profile has these as rw; start-up lists of masters write them."""
    drives = make()
    value = drives.upload_entry(0, index, sub)
    drives.download_entry(0, index, sub, value)
    changed = bytes([value[0] ^ 1]) + value[1:]
    with pytest.raises(Aborted, match="06090030"):
        drives.download_entry(0, index, sub, changed)
    assert drives.upload_entry(0, index, sub) == value


def test_scenes_keep_the_choice_of_the_home_offset() -> None:
    scene: Scene = load_scene("three_axis", overrides={"home_offset": "zero_to_home"})
    assert scene != PLAIN and scene.home_offset == "zero_to_home"
