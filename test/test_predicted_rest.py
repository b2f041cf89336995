"""Prediction of the tool's rest before it moves, from the contributions of the parts."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import pytest
from draws import some

from arm_emulator import OfflineRun, Pose, Refusal, Scene, load_gains, load_scene
from arm_emulator.base.config_files import find_scene
from arm_emulator.cli.commands.demo import verdict
from arm_emulator.demo.demo_plan import DemoPlan
from arm_emulator.demo.predicted_rest import Arrival, predicted_rest, rest_shares
from arm_emulator.machine.parts.encoder import Encoder, LinkEncoder, unblurred
from arm_emulator.machine.parts.known import PARTS
from arm_emulator.machine.parts.part import Part
from arm_emulator.machine.parts.resting import Around, AtRest, Shape, Stuck, Unknown
from arm_emulator.machine.parts.sensors import ANALOG
from arm_emulator.motion.link_torques import LinkTorques
from arm_emulator.runs.gains import Gains
from bench.residuals import EFFECTS, left_by, rests

NOISY = {"varied": ["joints.*.encoder.noise"]}  # so that they share a library


def given(name: str, changes: dict[str, Any]) -> tuple[Scene, Gains, DemoPlan]:
    file = find_scene(name)
    gains = load_gains(file)
    plan = DemoPlan.load(file, round(gains.motion.period * 1e9))
    return load_scene(file, changes), gains, plan


@pytest.mark.parametrize("effect", some(list(EFFECTS), 4))
def test_the_tool_rests_where_it_was_predicted(effect: str) -> None:
    """From drawn poses; bench/residuals.py has 100 of each."""
    # Under noise each residual is a draw: medians of ten are 1.7 to 5 times less than the bound.
    poses = 100 if effect == "noisy encoders" else 10
    found = list(rests(*given("three_axis", EFFECTS[effect]), poses, seed=3))
    assert all(one.arrival == Arrival.REACHED.value for one in found)
    outside = [one for one in found if not one.inside]
    assert not outside, f"{len(outside)} of {poses} outside: {outside[0]}"
    # A prediction that is wide enough for anything states nothing. (3 over 100 poses.)
    median = float(np.median([one.residual for one in found]))
    assert np.median([one.bound for one in found]) < 4.0 * median


@pytest.mark.parametrize("effect", ["play", "payload"])
def test_all_parts_of_the_scene_are_in_the_prediction(effect: str) -> None:
    """Without its share the tool would be outside: the prediction of the arm without the effect."""
    scene, gains, plan = given("three_axis", EFFECTS[effect])
    bare = predicted_rest(*given("three_axis", {}))
    assert not bare.contains(left_by(scene, gains, plan))
    assert predicted_rest(scene, gains, plan).contains(left_by(scene, gains, plan))


def test_shares_are_those_of_closed_forms() -> None:
    """One number of each kind, by hand: gravity's wind-up, play, counts, friction at the link."""
    keys = {
        "gravity": [0.0, 0.0, -9.81],
        "joints.shoulder.gear.backlash": 1e-3,
        "joints.elbow.friction": {"coulomb": 1.0, "breakaway": 1.5},
        "joints.elbow.encoder.offset": 0.02,
    }
    scene, gains, _ = given("three_axis", keys)
    shares = rest_shares(scene, gains.servo, scene.start, 1.0)
    plain = rest_shares(load_scene("three_axis"), gains.servo, scene.start, 1.0)
    count = 2.0 * np.pi / 1024 * 0.01
    np.testing.assert_allclose(plain.centre, 0.0, atol=1e-12)
    np.testing.assert_allclose([one.within for one in plain.ahead], 0.5 * count)
    np.testing.assert_allclose([one.short for one in plain.stuck], 0.5 * count)
    np.testing.assert_allclose(plain.within, count)
    # By Pinocchio, which knows nothing of the core.
    weight = LinkTorques(scene.urdf, scene.joint_names, [0.0, 0.0, -9.81]).at(
        scene.start, np.zeros(3)
    )
    wound = weight / 1e4 + np.array([0.0, 0.5e-3 * np.sign(weight[1]), 0.01 * 0.02])
    np.testing.assert_allclose(shares.centre, wound, rtol=1e-6, atol=1e-10)
    assert shares.ahead[2].within == pytest.approx(0.5 * count + 1.5 / 1e4)


def known_parts() -> list[type[Part]]:
    return [*PARTS, Encoder, LinkEncoder, *ANALOG]


@pytest.mark.parametrize("part", known_parts(), ids=lambda part: part.__name__)
def test_every_part_states_its_share(part: type[Part]) -> None:
    """Its own, or its kind's: what inherits `Part`'s answer would make every demo decline."""
    assert part.rests is not Part.rests


def test_a_part_that_states_none_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    scene, gains, plan = given("three_axis", {"joints.elbow.encoder.missed": 0.01})
    with pytest.raises(Refusal, match=r"parts of elbow must state .* got encoder: misses edges"):
        predicted_rest(scene, gains, plan)
    monkeypatch.setattr(Encoder, "rests", Part.rests)
    with pytest.raises(Refusal, match=r"parts of waist .* got encoder: states no share"):
        predicted_rest(*given("three_axis", {}))


def test_out_of_reach_and_not_yet_there_are_reported_apart() -> None:
    scene, gains, plan = given("three_axis", {})
    way = dataclasses.replace(gains, motion=dataclasses.replace(gains.motion, method="way"))
    far = dataclasses.replace(plan, displacement=np.array([5.0, 0.0, 0.0]), instructions=400)
    found = predicted_rest(scene, way, far)
    assert found.arrival is Arrival.UNREACHABLE and np.linalg.norm(found.reference) > 1.0
    residual = left_by(scene, way, far)
    assert found.contains(residual), "it rests at the nearest point"
    words = verdict(found, np.tile(residual, (30, 1)))
    assert "out of reach" in words and "within" in words
    soon = dataclasses.replace(plan, instructions=3)
    found = predicted_rest(scene, way, soon)
    assert found.arrival is Arrival.NOT_YET
    near = predicted_rest(scene, way, plan)
    still = np.tile(near.centre[:3] + 3.0 * near.radius, (30, 1))
    assert "outside" in verdict(near, still)
    moving = still + np.linspace(1.0, 0.0, 30)[:, None] * 50.0 * near.radius
    assert "not yet there" in verdict(near, moving)


def test_noise_of_sensors_moves_the_links_as_computed() -> None:
    """The covariance of a loop, against the machine that stands still under noise."""
    from arm_emulator.analysis.servo_loop import ServoLoops
    from arm_emulator.servo.drives import Drives, Target

    scene = load_scene("three_axis", {"joints.*.encoder.noise": 0.05, **NOISY})
    gains = load_gains(find_scene("three_axis"))
    loop = ServoLoops(scene, gains.servo, [scene.start]).loops[0]
    expected = np.sqrt(np.diag(loop.unrest(np.full(3, 0.05), np.zeros(3))))
    from arm_emulator.machine.session import Session

    session, drives, rows = Session(scene, "lockstep", "first_answer"), Drives(gains.servo), []
    for tick in range(6000):
        seen = session.measured
        drives.measure(session.logical_ns, seen.encoder_counts, seen.current, seen.applied)
        drives.aim(Target(scene.start))
        session.offer(tick, scene.joint_names, drives.command(powered=True).tolist())
        session.advance()
        if tick >= 1000:
            rows.append(session.state.q)
    measured = np.array(rows).std(axis=0)
    # 5 s of noise that the loop makes slow report the deviation to some 15 %.
    np.testing.assert_allclose(measured, expected, rtol=0.35)


def test_one_of_two_hundred_rests_under_noise_is_outside() -> None:
    """No more, and hardly fewer: what is left of noise is known, and the bound no guess."""
    scene, gains, plan = given("three_axis", EFFECTS["noisy encoders"] | NOISY)
    predicted = predicted_rest(scene, gains, plan)
    run = OfflineRun(scene, gains.servo, gains.motion)
    kinematics = run.controller.kinematics
    R_WT, p_WT = kinematics.forward(scene.start)
    goal = p_WT + plan.displacement
    run.instructor.add(0, Pose.from_quaternion(goal, Pose(p_WT, R_WT).quaternion(), "goal"))
    run.advance(40 * run.motion_ticks)
    left = []
    for _ in range(2000):
        run.advance(5 * run.motion_ticks)  # in which the loop forgets
        left.append(goal - kinematics.forward(run.session.state.q)[1])
    outside = np.mean([not predicted.contains(one) for one in left])
    # 10 of 2000 are expected, give or take 3 (standard deviation).
    assert 1e-3 <= outside <= 1e-2


@pytest.mark.parametrize("noise", [0.05, 0.2, 0.4, 0.8])
def test_noise_blurs_counts(noise: float) -> None:
    """The mean of many counts at each angle within one, summed up count by count."""
    from scipy.stats import norm

    x, k = np.linspace(0.0, 1.0, 401)[:, None], np.arange(-8, 9)
    chances = norm.cdf((k + 1 - x) / noise) - norm.cdf((k - x) / noise)
    off = np.abs(((k + 0.5) * chances).sum(axis=1) - x[:, 0]).max()
    assert off <= 0.5 * unblurred(noise) * (1.0 + 1e-9) + 1e-12
    if noise > 0.3:  # one wave of the series is left
        assert off == pytest.approx(0.5 * unblurred(noise), rel=0.02)
    assert unblurred(0.0) == 1.0


def test_unknown_numbers_are_drawn_as_they_are_declared() -> None:
    rng, side = np.random.default_rng(0), np.where(np.arange(100_000) % 2, 1.0, -1.0)
    squares = {
        Shape.ANYWHERE: 1.0 / 3.0, Shape.WAVE: 0.5,
        Shape.ENDS: 0.5 * (1.0 + 1.0 / 3.0), Shape.SIDE: 0.5 * (1.0 + 1.0 / 3.0),
    }  # fmt: skip
    assert set(squares) == set(Shape)
    for shape, square in squares.items():
        drawn = Unknown(-3.0, shape).draw(rng, side)
        assert np.abs(drawn).max() <= 3.0
        assert np.mean(drawn**2) == pytest.approx(9.0 * square, rel=0.02)
        of_side = np.mean(drawn * side)
        assert of_side == pytest.approx(-1.5 if shape is Shape.SIDE else 0.0, abs=0.05)
    drawn = Unknown(3.0, Shape.SIDE, 2.0 / 3.0).draw(rng, side)
    assert np.mean(drawn * side > 2.0) == pytest.approx(0.5 + 0.5 / 6.0, abs=0.01)


def test_the_place_of_a_stuck_motor_follows_from_its_two_torques() -> None:
    """By hand, after a way that is short, long, and none."""
    at = AtRest(0.1, 10.0, 0.01, 0.0, 0.01, False, Around(5.0), 4e3, 1e4, 6e-5)
    one = at.stuck(3.0, 2.0)  # 0.1 rad: 400 N m in which the integral has lacked 2 * 2/400
    assert one.short == pytest.approx((1.0 + 2.0 * 2.0 / 400.0) / 1e4)
    assert one.beyond == pytest.approx(1.0 / 4e3 - 3e-5)
    assert at.stuck(2.0, 2.0).beyond == 0.0, "it creeps and never sticks before it is there"
    still = dataclasses.replace(at, start=10.0)
    assert still.stuck(3.0, 2.0).short == pytest.approx(3.0 / 1e4)
    assert Stuck(1.0, 2.0) | Stuck(3.0, 1.0) == Stuck(3.0, 2.0)
