"""Feed-forward: the motors' motion that follows from that of the links, and what it is good for."""

import dataclasses
import math

import numpy as np
import pytest
import yaml
from draws import some, with_slow
from machines import make_link_urdf

from arm_emulator import Kinematics, Refusal, load_scene, load_servo_config
from arm_emulator.base.io.config_files import find_beside, find_scene
from arm_emulator.design.new_scene import list_drive_parameters
from arm_emulator.motion.executor.feedforward import Feedforward
from arm_emulator.motion.model.config import MotionConfig, load_motion_config
from arm_emulator.motion.model.drive_parameters import DriveParameters
from arm_emulator.motion.model.elastic_arm import ElasticArm
from arm_emulator.motion.model.joint_reference import JointSetpoint, Reference
from arm_emulator.motion.model.link_torques import LinkTorques
from arm_emulator.motion.model.rest_load import RestLoad
from arm_emulator.motion.planner.tool_controller import make_controller
from arm_emulator.servo.servo_arm import ServoArm, Target
from oracles.followed_line import AssumedNumbers, follow_line

GRAVITY = (0.0, 0.0, -9.81)
NONE = np.full(6, np.inf)


def sample_drive(rng: np.random.Generator, damping: float = 0.0) -> DriveParameters:
    stiffness = 10.0 ** rng.uniform(3, 6)
    return DriveParameters(
        stiffness=stiffness,
        cubic_stiffness=float(rng.choice([0.0, 1e4 * stiffness])),
        damping=damping * stiffness,
        viscous=rng.uniform(0.0, 20.0),
        coulomb=float(rng.choice([0.0, 5.0])),
    )


class Motion:
    """A sum of two sines in every joint, with all derivatives."""

    def __init__(self, rng: np.random.Generator, joints: int) -> None:
        self.size = rng.uniform(0.2, 0.8, (2, joints))
        self.rate = rng.uniform(1.0, 6.0, (2, joints))
        self.phase = rng.uniform(0.0, 2.0 * np.pi, (2, joints))

    def at(self, t: float) -> list[np.ndarray]:
        angle = self.rate * t + self.phase
        waves = np.sin(angle), np.cos(angle), -np.sin(angle), -np.cos(angle)
        return [(self.size * self.rate**k * wave).sum(axis=0) for k, wave in enumerate(waves)]


@pytest.mark.parametrize("seed", some(range(40), 6))
def test_rates_are_those_of_finite_differences(seed: int) -> None:
    """Speeds of the motors and rates of torques, of drawn drives along drawn motions."""
    rng = np.random.default_rng(seed)
    scene = load_scene("ur5")
    links = LinkTorques(scene.urdf, scene.joint_names, GRAVITY)
    arm = ElasticArm(links, [sample_drive(rng) for _ in range(6)], NONE)
    motion, t, h = Motion(rng, 6), rng.uniform(0.0, 5.0), 1e-5
    before, now, after = (arm.compute_drive(*motion.at(t + dt)) for dt in (-h, 0.0, h))
    # Central differences: of the second order in h, and rounding of 1e-16 / h.
    speeds = (after.theta - before.theta) / (2.0 * h)
    rates = (after.torque - before.torque) / (2.0 * h)
    # Coulomb's friction bends within milliradians per second, over which h is not short.
    away = np.abs(motion.at(t)[1]) > 0.1
    np.testing.assert_allclose(now.omega[away], speeds[away], rtol=1e-6, atol=1e-7)
    np.testing.assert_allclose(now.torque_rate[away], rates[away], rtol=1e-5, atol=1e-3)


@pytest.mark.parametrize("seed", some(range(40), 6))
def test_gears_carry_the_torque_of_the_links(seed: int) -> None:
    """K w + K3 w^3 + D w' is the torque of the links and their friction."""
    rng = np.random.default_rng(seed)
    scene = load_scene("ur5")
    drives = [sample_drive(rng, 4e-4) for _ in range(6)]
    links = LinkTorques(scene.urdf, scene.joint_names, GRAVITY)
    arm = ElasticArm(links, drives, NONE)
    q, v, a, jerk = Motion(rng, 6).at(rng.uniform(0.0, 5.0))
    drive = arm.compute_drive(q, v, a, jerk)
    w, rate = drive.theta - q, drive.omega - v
    for j, parameters in enumerate(drives):
        carried = (
            parameters.stiffness * w[j]
            + parameters.cubic_stiffness * w[j] ** 3
            + parameters.damping * rate[j]
        )
        friction = parameters.viscous * v[j] + parameters.coulomb * np.sign(v[j])
        if abs(v[j]) < 0.1:
            continue
        taken = links.compute_torques(q, v, a)[j] + friction
        # The damper's part of the second order: (D / K)^2 w'', 1.6e-7 s2 of torques of 6 rad/s.
        assert carried == pytest.approx(taken, rel=2e-4, abs=2e-2), j


def test_a_single_elastic_joint_is_that_of_the_closed_form() -> None:
    """An inertia I behind K and D that swings as A sin(wt)."""
    inertia, K, D, size, rate = 0.5, 2000.0, 0.6, 0.4, 7.0
    urdf = make_link_urdf(mass=1e-9, com=0.0, inertia=inertia)
    links = LinkTorques(urdf, ("joint",), (0.0, 0.0, 0.0))
    arm = ElasticArm(links, [DriveParameters(stiffness=K, damping=D)], np.array([np.inf]))
    period, slip = 0.01, math.atan2(D * rate, K)
    wind_up = inertia * rate**2 * size / math.hypot(K, D * rate)  # of K w + D w' = I a

    def motion(t: float) -> list[np.ndarray]:
        s, c = size * math.sin(rate * t), size * math.cos(rate * t)
        return [np.array([x]) for x in (s, rate * c, -(rate**2) * s, -(rate**3) * c)]

    for t in np.linspace(0.0, 1.0, 23):
        begins, ends = arm.compute_drive(*motion(t)), arm.compute_drive(*motion(t + period))
        theta = size * math.sin(rate * t) - wind_up * math.sin(rate * t - slip)
        omega = rate * (size * math.cos(rate * t) - wind_up * math.cos(rate * t - slip))
        lag = (D * rate / K) ** 2 * wind_up  # what the law leaves out
        assert begins.theta[0] == pytest.approx(theta, abs=2.0 * lag)
        assert begins.omega[0] == pytest.approx(omega, abs=2.0 * rate * D * rate / K * wind_up)
        mean = inertia * rate * size * (math.cos(rate * (t + period)) - math.cos(rate * t)) / period
        # The cubic over a period is off by (rate period)^4 / 720 of the torque.
        assert arm.compute_mean_torques(begins, ends, period)[0] == pytest.approx(
            mean, abs=1e-6 * inertia * rate**2
        )


def test_motors_continue_without_a_jump_for_any_derivatives() -> None:
    """The motors' targets of one period end where those of the next begin."""
    rng = np.random.default_rng(3)
    scene = load_scene("ur5")
    config = MotionConfig(
        tool="tool0", period=0.01, feedforward="full", drives=list_drive_parameters(scene.joints)
    )
    kinematics = Kinematics(scene.urdf, scene.joint_names, "tool0")
    motion, T = Motion(rng, 6), config.period
    arm = ElasticArm(
        LinkTorques(scene.urdf, scene.joint_names, GRAVITY),
        list(list_drive_parameters(scene.joints).values()),
        kinematics.velocity_limit,
    )
    for derivatives in (5, 4, 3, 0):  # those at the end, too, all derivatives, no jerk, none
        feedforward = Feedforward(kinematics, config)
        end = q_before = None
        for k in range(60):
            q, q_end = motion.at(k * T)[0], motion.at((k + 1) * T)[0]
            now = Reference(*motion.at(k * T)[:derivatives]) if derivatives else None
            then = Reference(*motion.at((k + 1) * T)) if derivatives == 5 else None
            q = q if q_before is None else q_before
            setpoint = feedforward.complete_setpoint(
                JointSetpoint(q, (q_end - q) / T, None, now, then)
            )
            assert setpoint.v is not None
            if derivatives == 5:  # however the jerk changes within the period
                np.testing.assert_allclose(
                    setpoint.q, arm.compute_drive(*motion.at(k * T)).theta, atol=1e-9
                )
            if end is not None:
                np.testing.assert_allclose(setpoint.q, end, atol=1e-12)
            end, q_before = setpoint.q + T * setpoint.v, q + T * ((q_end - q) / T)
            if derivatives >= 4 and k > 2:
                wind_up = setpoint.q - q
                np.testing.assert_allclose(
                    feedforward.compute_link_angles(setpoint.q), q, atol=1e-15
                )
                assert 0.0 < np.abs(wind_up).max() < 0.02


class Weighed:
    """A link on an elastic gear, of which motion control knows other numbers.

    Its motor gives the true weight, less what friction holds of it.
    """

    STIFFNESS, MASS, COM = 2e3, 5.0, 0.4  # N m/rad, kg, m

    def __init__(
        self, heavier: float, softer: float, dry: float = 0.0, holding: float = 0.0
    ) -> None:
        self.assumed = softer * self.STIFFNESS
        drive = DriveParameters(stiffness=self.assumed, coulomb=dry)
        config = MotionConfig(
            tool="joint_link", period=0.01, feedforward="full", drives={"joint": drive}
        )
        urdf = make_link_urdf(self.MASS * heavier, self.COM, 0.05 * heavier)
        self.feedforward = Feedforward(Kinematics(urdf, ["joint"], "joint_link"), config)
        self.load_at_rest = holding

    def weight(self, q: float) -> float:
        return -self.MASS * 9.81 * self.COM * math.cos(q)

    def period(self, q: float, v: float = 0.0, can: bool = True) -> tuple[float, float]:
        """Return by how much the motor is sent ahead, and the torque that is announced."""
        tau = np.array([self.weight(q) - self.load_at_rest])
        self.feedforward.observe_torques(tau, np.array([can]))
        setpoint = self.feedforward.complete_setpoint(JointSetpoint(np.array([q]), np.array([v])))
        assert setpoint.tau is not None
        return float(setpoint.q[0] - q), float(setpoint.tau[0])


@pytest.mark.parametrize("seed", with_slow(range(12), 4))
def test_wind_up_under_weight_is_that_of_the_load_at_rest(seed: int) -> None:
    """Links, gear and friction wrong by 30 %, alone and mixed: the residual is the gear's."""
    rng = np.random.default_rng(seed)
    heavier, softer, of_dry = rng.choice([0.7, 1.0, 1.3], 3)
    dry, q = rng.choice([0.0, 1.0]), rng.uniform(-1.0, 1.0)
    arm = Weighed(heavier, softer, of_dry * dry, dry * rng.uniform(-1.0, 1.0))
    weight, first = arm.weight(q), arm.period(q)
    assert first[0] == pytest.approx(heavier * weight / arm.assumed, rel=1e-9)
    rest = [first, *(arm.period(q) for _ in range(400))]
    assert all(tau == first[1] for _, tau in rest), "integrals hold what was not announced"
    wind_ups = np.array([wind_up for wind_up, _ in rest])
    steps = np.abs(np.diff(wind_ups))
    assert steps.max() <= 0.04 * abs(wind_ups[-1] - wind_ups[0]), "in 0.3 s, a period has 10 ms"
    # Friction may hold either way, known as 1.5 times what is assumed; 10 urad are not visible. A
    # weight of that size is no evidence: what it leaves is of second order. exp(-4 / 0.3) is left.
    unsure = 1.5 * of_dry * dry + 1e-5 * arm.assumed
    surplus = (1.0 - heavier) * weight - arm.load_at_rest
    if abs(surplus) < unsure:
        assert wind_ups[-1] == wind_ups[0], "the prediction may be right"
    off = abs(wind_ups[-1] * arm.assumed - weight)
    assert (
        off
        <= abs(arm.load_at_rest) + unsure + abs(surplus) * (unsure / (heavier * weight)) ** 2 + 1e-4
    )


def test_the_load_at_rest_multiplies_torques_in_motion_without_a_jump() -> None:
    """Announced torques go on from the rest's by the observed factor; brakes end the held part."""
    arm, q = Weighed(1.3, 1.0), 0.5
    at_rest = [arm.period(q) for _ in range(400)][-1][1]
    assert at_rest == pytest.approx(1.3 * arm.weight(0.5), rel=1e-12)
    moving = []
    for k in range(40):
        v = 0.4 * math.sin(math.pi * (k + 0.5) / 40) ** 2
        moving.append(arm.period(q, v)[1])
        q += 0.01 * v
    end = [arm.period(q)[1] for _ in range(4)][-1]
    change = arm.weight(q) - arm.weight(0.5)
    # 10 urad of the gear are 0.02 N m of 17.
    assert end - at_rest == pytest.approx(change, rel=2e-3)
    assert np.abs(np.diff([at_rest, *moving, end])).max() < 1.0, "5 N m are held"
    assert arm.period(q, can=False)[1] == pytest.approx(arm.weight(q), rel=2e-3)


def test_a_joint_without_weight_is_taken_to_be_as_wrong_as_those_that_it_carries() -> None:
    """Random trees of which each joint turns about a vertical axis or carries weight, all wrong.

    A joint that carries weight has its own factor; another one the mean of the next ones' factors,
    farther out, whatever the order of the names; one with nothing beyond it, 1.
    """
    for seed in range(20):
        rng, n = np.random.default_rng(seed), 7
        text = [
            '<robot name="tree"><link name="l-1"><inertial><mass value="1"/>'
            '<inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link>'
        ]
        above = [int(rng.integers(max(-1, j - 2), j)) for j in range(n)]
        for j, parent in enumerate(above):
            text.append(
                f'<link name="l{j}"><inertial><origin xyz="0.3 0 0"/><mass value="1"/>'
                '<inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link>'
                f'<joint name="j{j}" type="revolute"><parent link="l{parent}"/>'
                f'<child link="l{j}"/><origin xyz="0.1 0 0"/><axis xyz="0 {rng.integers(2)} 1"/>'
                '<limit lower="-3" upper="3" effort="9" velocity="2"/></joint>'
            )
        order = rng.permutation(n)
        urdf = "".join(text) + "</robot>"
        links = LinkTorques(urdf, [f"j{j}" for j in order], (0.0, 0.0, -9.81))
        weight, wrong = links.compute_torques(np.zeros(n), np.zeros(n)), rng.uniform(0.6, 1.9, n)
        load = RestLoad(np.zeros(n), np.full(n, 0.1), 0.01, links.outboard)
        for _ in range(1000):
            load.observe_rest(wrong * weight, weight)
        expected = np.ones(n)
        for j in reversed(range(n)):
            here = int(np.flatnonzero(order == j)[0])
            further = [expected[k] for k in range(n) if above[k] == j]
            if abs(weight[here]) > 1e-9:
                expected[j] = wrong[here]
            elif further:
                expected[j] = np.mean(further)
        # 10 urad, 1e-4 N m here, are uncertain.
        np.testing.assert_allclose(load.factor, expected[order], atol=1e-3)


@pytest.mark.parametrize(
    ("knowledge", "bound"),
    with_slow(
        [
            (AssumedNumbers("full"), 0.5e-3),
            # Claimed bounds for numbers that are 30 % off, to either side.
            (AssumedNumbers("full", stiffness=0.7, friction=0.7, inertia=0.7), 2e-3),
            (AssumedNumbers("full", stiffness=1.3, friction=1.3, inertia=1.3), 2e-3),
        ],
        1,
    ),
)
def test_the_tool_follows_a_fast_line(knowledge: AssumedNumbers, bound: float) -> None:
    """300 mm at 1 m/s with ur5: the true tool beside its reference, through the whole machine."""
    result = follow_line("ur5", knowledge)
    assert result.peak_speed == pytest.approx(1.0, rel=0.02)
    assert result.off < bound
    assert result.past < bound


@pytest.mark.slow
def test_better_numbers_reduce_the_error() -> None:
    """Each mode of feed-forward leaves less than the one before, and 50 % off is between."""
    modes = "none", "speed", "torque", "full"
    off = {mode: follow_line("ur5", AssumedNumbers(mode)).off for mode in modes}
    half = follow_line("ur5", AssumedNumbers("full", stiffness=1.5, friction=1.5, inertia=0.5)).off
    assert off["none"] > 10.0 * off["speed"]
    assert off["full"] < half < off["torque"] <= 1.05 * off["speed"]


def test_files_state_the_drives_of_their_scenes() -> None:
    """The shipped motion controllers have the scenes' numbers of gears and friction."""
    for name in ("ur5", "panda"):
        scene = load_scene(name)
        assert load_motion_config(
            find_beside(find_scene(name), "motion")
        ).drives == list_drive_parameters(scene.joints)


def test_numbers_of_drives_are_refused(tmp_path) -> None:  # type: ignore[no-untyped-def]
    for table, words in (
        (
            {"elbow_joint": {"stifness": 1.0}},
            r"joints\.elbow_joint\.stifness must be a known key.*",
        ),
        (
            {"elbow_joint": {"stiffness": 0.0}},
            r"joints\.elbow_joint\.stiffness must be a number > 0",
        ),
        ({"elbow_joint": {"viscous": -1}}, r"viscous must be a number >= 0"),
        ({"elbow_joint": 3.0}, r"joints\.elbow_joint must be a mapping"),
        (3.0, r"section joints must be a mapping"),
    ):
        file = tmp_path / "motion.yaml"
        node = {"motion_controller": {"ros__parameters": {"tool": "tool0", "joints": table}}}
        file.write_text(yaml.safe_dump(node))
        with pytest.raises(Refusal, match=words):
            load_motion_config(file)
    scene = load_scene("ur5")
    config = dataclasses.replace(MotionConfig(tool="tool0"), drives={"elbow": DriveParameters()})
    with pytest.raises(Refusal, match=r"joints\.elbow must be a joint of the arm"):
        make_controller(scene.urdf, scene.joint_names, config)


PERIOD = 0.001  # s, of the servo of ur5


def drives_of(motion_period: float) -> ServoArm:
    servo = load_servo_config(find_beside(find_scene("ur5"), "servo"))
    return ServoArm(dataclasses.replace(servo, motion_period=motion_period))


def test_targets_are_followed_along_their_curve() -> None:
    """With even accelerations, targets every 10 ms are the same as targets every 1 ms."""
    a = np.array([3.0, -2.0, 1.0, 4.0, -5.0, 2.0])
    counts = np.zeros((200, 6))
    for k in range(len(counts)):  # motors that follow somehow
        ratio = 1.0 / 101.0
        counts[k] = np.floor(0.5 * a * (k * PERIOD) ** 2 / ratio * 8192 / (2.0 * np.pi))

    def voltages(motion_period: float) -> list[np.ndarray]:
        drives, result = drives_of(motion_period), []
        every = round(motion_period / PERIOD)
        for k in range(len(counts)):
            drives.take_measurement(k * 1_000_000, counts[k], np.zeros(6))
            if k % every == 0:
                t = k * PERIOD
                drives.set_target(Target(0.5 * a * t**2, a * (t + 0.5 * motion_period)))
            result.append(drives.compute_commands(True))
        return result

    coarse, fine = voltages(0.01), voltages(PERIOD)
    # The first period has no acceleration yet, and what it left fades.
    np.testing.assert_allclose(coarse[12], fine[12], atol=0.5)
    np.testing.assert_allclose(
        np.diff(coarse[150:], axis=0), np.diff(fine[150:], axis=0), atol=2e-3
    )


def test_the_observer_expects_the_load_that_is_announced() -> None:
    """A rotor under a load that grows: its observed speed lags only where nobody knows."""
    joint = load_servo_config(find_beside(find_scene("ur5"), "servo")).joints[0]
    growth = 4.0  # N m/s at the motor

    def worst(announced: bool) -> float:
        drives = drives_of(0.01)
        theta = omega = 0.0
        errors = []
        for k in range(300):
            t = k * PERIOD
            count = math.floor(theta / (2.0 * math.pi) * joint.counts_per_turn)
            current = growth * t / joint.torque_constant
            drives.take_measurement(
                round(t * 1e9), [count] + 5 * [0], [current] + 5 * [0.0], 6 * [current]
            )
            errors.append(abs(float(drives.servo.state["omega"][0]) - omega))
            if k % 10 == 0:
                tau = np.zeros(6)
                tau[0] = growth * (t + 0.005) / joint.gear_ratio if announced else 0.0
                drives.set_target(Target(np.zeros(6), np.zeros(6), tau))
            drives.compute_commands(True)
            omega += 0.0  # the load and the current's torque balance: the rotor stands
        return max(errors[100:])

    assert worst(True) < 0.2 * worst(False)
