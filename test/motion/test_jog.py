"""Jogging: speeds of the tool and of joints, slowed down where they must be."""

from __future__ import annotations

import dataclasses
import pickle
from array import array
from typing import Any

import in_process as wires
import numpy as np
import pinocchio as pin
import pytest
from draws import some, with_slow
from geometry_msgs.msg import TwistStamped
from in_process import in_process
from kinematic_arms import NAMES, START, THREE_AXIS
from sensor_msgs.msg import JointState
from std_msgs.msg import Header, Int8

from arm_emulator import Kinematics, OfflineRun, Refusal, load_gains, load_scene
from arm_emulator.base.io.config_files import find_scene
from arm_emulator.motion.executor.controllers import make_jerk_limited_velocity
from arm_emulator.motion.executor.goal_status import GoalState, Kind
from arm_emulator.motion.executor.jog import (
    JogCommand,
    JogStatus,
    make_joint_command,
    make_twist_command,
)
from arm_emulator.motion.executor.tool_directions import ToolDirections
from arm_emulator.motion.model.joint_reference import Reference
from arm_emulator.motion.trajectory.jerk_limited_velocity import JerkLimitedVelocity
from arm_emulator_msgs.msg import MotionStatus
from motion_controller_node import order_topics


class Jogged:
    """An arm under jog commands in every motion period, through the whole machine."""

    def __init__(
        self, start: dict[str, float] | None = None, scene: str = "ur5", **parameters: object
    ) -> None:
        file = find_scene(scene)
        machine = load_scene(file, {f"joints.{n}.start": x for n, x in (start or {}).items()})
        gains = load_gains(file)
        motion = dataclasses.replace(
            gains.motion,
            jog_command_in_type="speed_units",
            **parameters,  # type: ignore[arg-type]
        )
        servo = dataclasses.replace(gains.servo, motion_period=motion.period)
        self.run = OfflineRun(machine, servo, motion)
        self.kinematics, self.config = self.run.controller.kinematics, motion
        self.q: list[np.ndarray] = []
        self.asked: list[np.ndarray] = []
        self.statuses: list[JogStatus] = []
        self.run.advance(1000)

    def jog(self, seconds: float, command: JogCommand | None, every: int = 1) -> None:
        """Send a command in every period, or so often, for so long; None: send nothing."""
        run = self.run
        for k in range(round(seconds / self.config.period)):
            if command is not None and k % every == 0:
                time_ns = run.session.logical_ns
                run.instructor.take_jog(dataclasses.replace(command, time_ns=time_ns))
            run.advance(run.motion_ticks)
            self.q.append(run.session.state.q.copy())
            self.asked.append(run.drives.servo.state["q_target"] - run.wind_up)
            jog = run.instructor.jogging
            self.statuses.append(JogStatus.NO_WARNING if jog is None else jog.status)

    def tool(self) -> np.ndarray:
        return np.array([self.kinematics.forward(q)[1] for q in self.q])

    def twist(self, *twist: float, link: str = "") -> JogCommand:
        return make_twist_command(0, twist, link, self.kinematics, self.config)


def test_a_twist_moves_the_tool_along_it() -> None:
    """0.1 m/s along y for a second: the true tool goes so fast, straight, and comes to rest."""
    jogged = Jogged()
    jogged.jog(1.0, jogged.twist(0.0, 0.1, 0.0, 0.0, 0.0, 0.0))
    jogged.jog(1.0, None)
    path = jogged.tool() - jogged.tool()[0]
    speed = np.diff(path[50:90], axis=0) / jogged.config.period
    np.testing.assert_allclose(speed.mean(axis=0), [0.0, 0.1, 0.0], atol=1e-3)
    assert np.abs(path[:, [0, 2]]).max() < 1e-3  # off the line
    # Held for the time-out after the last command, then at rest.
    assert path[-1, 1] == pytest.approx(0.1 * (1.0 + 0.1), abs=0.01)
    assert np.abs(np.diff(path[-50:], axis=0)).max() < 2e-6
    assert jogged.run.instructor.reports.waiting[-1].state is GoalState.REACHED
    turned = [jogged.kinematics.forward(q)[0] for q in (jogged.q[0], jogged.q[-1])]
    assert np.abs(turned[0] - turned[1]).max() < 2e-3


@pytest.mark.parametrize("period", [0.005, 0.01, 0.02, 0.05])
@pytest.mark.parametrize("direction", [(0.0, 1.0, 0.0), (-0.6, 0.0, 0.8), (-0.6, -0.6, 0.5)])
def test_a_jog_keeps_to_its_line(period: float, direction: tuple[float, float, float]) -> None:
    """three_axis at 0.3 m/s: on the whole way within 5 mm of the line; up to 7.6 without one."""
    start = {"waist": 0.3, "shoulder": 0.2, "elbow": 1.4}
    jogged = Jogged(start, "three_axis", period=period)
    along = np.array(direction) / np.linalg.norm(direction)
    jogged.jog(0.8, jogged.twist(*(0.3 * along), 0.0, 0.0, 0.0))
    path = jogged.tool() - jogged.tool()[0]
    assert np.linalg.norm(path - np.outer(path @ along, along), axis=1).max() < 5e-3
    assert path[-1] @ along > 0.15


@pytest.mark.parametrize("period", [0.01, 0.05])
def test_a_jog_rests_before_the_stretched_pose(period: float) -> None:
    """three_axis upwards: the elbow stays on its side (it went through 0), and rests."""
    jogged = Jogged(None, "three_axis", period=period)
    jogged.jog(3.0, jogged.twist(0.0, 0.0, 0.2, 0.0, 0.0, 0.0))
    elbow = np.array(jogged.q)[:, 2]
    assert elbow.min() > 0.1
    assert np.ptp(elbow[-round(0.3 / period) :]) < 2e-3


@pytest.mark.parametrize("link", ["tool0", "forearm_link", "wrist_1_link", "base_link", "world"])
def test_a_twist_is_along_any_link(link: str) -> None:
    """As MoveIt Servo takes any frame: Pinocchio's placement of the link at the start."""
    jogged = Jogged({"shoulder_pan_joint": 0.4, "elbow_joint": 1.2})
    q, model = jogged.run.session.state.q, pin.buildModelFromXML(jogged.kinematics.urdf_xml)
    data, at = model.createData(), np.zeros(model.nq)
    at[[model.joints[model.getJointId(n)].idx_q for n in jogged.kinematics.joint_names]] = q
    pin.framesForwardKinematics(model, data, at)
    R_WL = np.eye(3) if link == "world" else data.oMf[model.getFrameId(link)].rotation
    jogged.jog(0.3, jogged.twist(0.1, 0.0, 0.0, 0.0, 0.0, 0.0, link=link))
    path = jogged.tool()[-1] - jogged.tool()[0]
    np.testing.assert_allclose(path / np.linalg.norm(path), R_WL[:, 0], atol=0.08)
    # A turn about another axis of the link keeps to the direction as well.
    jogged = Jogged({"shoulder_pan_joint": 0.4, "elbow_joint": 1.2})
    jogged.jog(0.3, jogged.twist(0.0, 0.0, 0.0, 0.0, 0.4, 0.0, link=link))
    before, after = (jogged.kinematics.forward(jogged.q[k])[0] for k in (0, -1))
    turn = pin.log3(after @ before.T)
    np.testing.assert_allclose(turn / np.linalg.norm(turn), R_WL[:, 1], atol=0.08)


def test_commands_time_out() -> None:
    """A gap shorter than the time-out changes nothing; a longer one stops the arm."""
    jogged = Jogged()
    command = jogged.twist(0.0, 0.1, 0.0, 0.0, 0.0, 0.0)
    jogged.jog(1.0, command, every=9)
    tool = jogged.tool()
    assert np.diff(tool[50:, 1]).min() > 0.9e-3
    jogged.q.clear()
    jogged.jog(1.5, command, every=50)
    assert np.abs(np.diff(jogged.tool()[:, 1])).min() < 1e-5


@pytest.mark.parametrize("seed", with_slow(some(range(30), 4), 1))
def test_limits_hold_whatever_the_lever_does(seed: int) -> None:
    """Drawn twists and joint speeds that change all the time: every limit of every joint holds."""
    rng = np.random.default_rng(seed)
    jogged = Jogged(jog_scale_linear=2.0, jog_scale_rotational=4.0)
    names = jogged.kinematics.joint_names
    for _ in range(12):
        if rng.random() < 0.5:
            command = jogged.twist(
                *rng.normal(0.0, 1.0, 6), link=str(rng.choice(["", "tool0", "forearm_link"]))
            )
        else:
            command = make_joint_command(
                0, names, rng.normal(0.0, 3.0, 6), jogged.kinematics, jogged.config
            )
        jogged.jog(rng.uniform(0.1, 1.0), command)
    requested, T = np.array(jogged.asked), jogged.config.period
    margin = jogged.config.jog_joint_limit_margin
    assert (requested > jogged.kinematics.lower + 0.9 * margin).all()
    assert (requested < jogged.kinematics.upper - 0.9 * margin).all()
    v = np.diff(requested, axis=0) / T
    assert (np.abs(v) <= np.minimum(3.0, jogged.kinematics.velocity_limit) * (1.0 + 1e-9)).all()
    # Of 10 rad/s2 the rest is for links that swing on their gears.
    assert np.abs(np.diff(v, axis=0)).max() / T <= 0.72 * 10.0 * (1.0 + 1e-6)


def test_through_the_singular_pose_of_the_wrist() -> None:
    """A translation past q5 = 0: the tool goes on, at most slower, and not off its line."""
    jogged = Jogged({"wrist_2_joint": -0.2})
    towards = jogged.kinematics.jacobian(jogged.run.session.state.q) @ np.eye(6)[4]
    jogged.jog(3.0, jogged.twist(0.0, 0.0, 0.0, *(0.3 * towards[3:] / np.linalg.norm(towards[3:]))))
    wrist = np.array(jogged.q)[:, 4]
    assert wrist[0] < -0.1 and wrist[-1] > 0.3
    assert (np.diff(wrist) > -1e-4).all()
    speeds = np.abs(np.diff(np.array(jogged.asked), axis=0)) / jogged.config.period
    assert speeds.max() < 3.0


def test_out_of_reach_and_back() -> None:
    """Outward until the arm is nearly stretched: it slows down on its line, halts, and comes back.

    Joints that brake lead 2.6 mm aside here; a part of the twist that is slowed more than the rest
    of it led 7.7 mm aside, and farther with time.
    """
    jogged = Jogged({"shoulder_lift_joint": -0.5, "elbow_joint": 0.8, "wrist_1_joint": -1.87})
    _, p_WT = jogged.kinematics.forward(jogged.run.session.state.q)
    out = np.append(p_WT[:2] / np.linalg.norm(p_WT[:2]), 0.0)
    jogged.jog(6.0, jogged.twist(*(0.2 * out), 0.0, 0.0, 0.0))
    path = jogged.tool() - jogged.tool()[0]
    assert np.linalg.norm(path - np.outer(path @ out[:3], out[:3]), axis=1).max() < 3e-3
    assert JogStatus.DECELERATE_FOR_APPROACHING_SINGULARITY in jogged.statuses
    halted = jogged.tool()[-50:]
    assert np.abs(np.diff(halted, axis=0)).max() < 5e-5
    assert jogged.statuses[-1] in (
        JogStatus.HALT_FOR_SINGULARITY,
        JogStatus.DECELERATE_FOR_APPROACHING_SINGULARITY,
    )
    jogged.jog(1.0, jogged.twist(*(-0.2 * out), 0.0, 0.0, 0.0))
    back = float(out @ (jogged.tool()[-1] - halted[-1]))
    assert back < -0.15  # of 0.2 m in a second


@pytest.mark.parametrize("seed", some(range(40), 6))
def test_speeds_are_those_of_the_twist_away_from_singular_poses(seed: int) -> None:
    """Against the Jacobian itself; near singular poses no direction is turned round."""
    rng = np.random.default_rng(seed)
    scene = load_scene("ur5")
    config = load_gains(find_scene("ur5")).motion
    kinematics = Kinematics(scene.urdf, scene.joint_names, "tool0")
    q, twist = rng.uniform(-2.5, 2.5, 6), rng.normal(0.0, 0.1, 6)
    speeds = ToolDirections(kinematics, q).compute_speeds(twist, config)
    singular = kinematics.singular_values(q)
    reached = kinematics.jacobian(q) @ speeds.v
    if singular[0] / singular[-1] < config.jog_lower_singularity_threshold:
        assert speeds.status is JogStatus.NO_WARNING
        np.testing.assert_allclose(reached, twist, atol=1e-9)
    else:
        assert (kinematics.scale * reached) @ (kinematics.scale * twist) >= 0.0


@pytest.mark.parametrize("seed", some(range(60), 10))
def test_joints_stop_before_their_limits(seed: int) -> None:
    """Drawn limits, starts and wishes: position, speed, acceleration and jerk are kept."""
    rng = np.random.default_rng(seed)
    n, T = 3, 10.0 ** rng.uniform(-3, -1.5)
    limit, velocity = rng.uniform(0.3, 3.0, n), rng.uniform(0.5, 4.0, n)
    acceleration = rng.uniform(2.0, 20.0, n)
    jerk = acceleration / rng.uniform(0.02, 0.1)
    middle = rng.uniform(-4.0, 4.0, n)  # limits may lie on one side of 0
    joints = JerkLimitedVelocity(middle - limit, middle + limit, velocity, acceleration, jerk, T)
    joints.take_over(Reference.make_rest(middle + rng.uniform(-0.9, 0.9, n) * limit))
    moved = np.zeros(n)
    before = joints.now
    for _ in range(40):
        target = rng.normal(0.0, 3.0, n)
        for _ in range(rng.integers(1, 60)):
            now = joints.now
            joints.advance_towards(target * joints.limit_shares(now.q, target), alone=seed % 2 == 0)
            now = joints.now
            moved = np.maximum(moved, np.abs(now.v))
            assert (np.abs(now.q - middle) <= limit + 1e-8).all()
            assert (np.abs(now.v) <= velocity * (1.0 + 1e-6)).all()
            assert (np.abs(now.a) <= acceleration * (1.0 + 1e-6)).all()
            assert (np.abs(now.a - before.a) <= jerk * T * (1.0 + 1e-6) + 1e-9).all()
            before = now
    assert (moved > 0.1 * velocity).all()


def test_a_gripper_of_a_few_millimetres_is_jogged_from_end_to_end() -> None:
    """`jog_joint_limit_margin` of 0.1 is four times its range: it stops a tenth before its ends."""
    config = load_gains(find_scene("three_axis")).motion
    limit = '<limit lower="0.005" upper="0.03" effort="1" velocity="1"/></joint>'
    arm = Kinematics(
        THREE_AXIS.replace("</joint>", limit, 1).replace("continuous", "revolute", 1), NAMES, "tool"
    )
    short = (arm.upper - arm.lower) < 0.1
    assert short.sum() == 1
    joints = make_jerk_limited_velocity(arm, config, config.jog_joint_limit_margin)
    joints.take_over(Reference.make_rest(np.where(short, 0.01, START)))
    for velocity, end in ((0.02, 0.0275), (-0.02, 0.0075)):
        for _ in range(500):
            joints.advance_towards(
                velocity * joints.limit_shares(joints.now.q, velocity * short) * short, alone=True
            )
        # It halts where little of the speed is left.
        assert joints.now.q[short] == pytest.approx(end, abs=1e-3) and not joints.is_moving


def test_commands_are_refused() -> None:
    """Unknown joints, wrong lengths, numbers that are not finite, turns that no task rules."""
    scene = load_scene("ur5")
    config = load_gains(find_scene("ur5")).motion
    arm = Kinematics(scene.urdf, scene.joint_names, "tool0")
    place = Kinematics(scene.urdf, scene.joint_names, "tool0", task="position")
    with pytest.raises(Refusal, match=r"joint must be one of the arm, got elbow; valid"):
        make_joint_command(0, ["elbow"], [0.1], arm, config)
    with pytest.raises(Refusal, match="each once"):
        make_joint_command(0, ["elbow_joint"] * 2, [0.1, 0.2], arm, config)
    with pytest.raises(Refusal, match="velocities"):
        make_joint_command(0, ["elbow_joint"], [0.1, 0.2], arm, config)
    with pytest.raises(Refusal, match="twist"):
        make_twist_command(0, [0.0, np.nan, 0.0, 0.0, 0.0, 0.0], "", arm, config)
    with pytest.raises(Refusal, match=r"frame_id must be a link of the robot, got elbow; valid"):
        make_twist_command(0, [0.1, 0.0, 0.0, 0.0, 0.0, 0.0], "elbow", arm, config)
    with pytest.raises(Refusal, match=r"twist\.angular must be 0"):
        make_twist_command(0, [0.0, 0.0, 0.0, 0.0, 0.0, 0.1], "", place, config)
    unitless = dataclasses.replace(config, jog_command_in_type="unitless")
    half = make_twist_command(0, [0.5, 0.0, 0.0, 0.0, 0.0, -1.0], "", arm, unitless)
    np.testing.assert_allclose(half.twist, [0.2, 0.0, 0.0, 0.0, 0.0, -0.8])
    fast = dataclasses.replace(config, jog_command_in_type="speed_units")
    largest = make_twist_command(0, [3.0, 4.0, 0.0, 0.0, 0.0, 0.5], "", arm, fast)
    np.testing.assert_allclose(largest.twist, [0.24, 0.32, 0.0, 0.0, 0.0, 0.5])


@pytest.mark.slow
def test_the_node_takes_twists_and_publishes_their_limits() -> None:
    """By its topics, in lock-step: the tool moves, the status goes to a code and back, refusals."""
    with in_process() as nodes:
        nodes.run_to(5)
        heard: list[MotionStatus] = []
        nodes.listen_alone("motion/status", MotionStatus, heard.append)
        codes: list[int] = []
        nodes.listen_alone("~/status", Int8, lambda message: codes.append(message.data))
        wrong = TwistStamped()
        wrong.header.frame_id = "elsewhere"
        nodes.send("~/delta_twist_cmds", wrong)
        turn = TwistStamped()
        turn.twist.angular.z = 0.1
        nodes.send("~/delta_twist_cmds", turn)
        for tick in range(20, 620, 20):
            message = TwistStamped()
            message.twist.linear.z = 0.5  # of jog_scale_linear
            nodes.send("~/delta_twist_cmds", message)
            nodes.run_to(tick)
        nodes.run_to(1500)
    states = [(message.state, message.reason) for message in heard if message.kind == Kind.JOG]
    assert [state for state, _ in states[:2]] == [GoalState.REFUSED, GoalState.REFUSED]
    assert "frame_id" in states[0][1] and "twist.angular must be 0" in states[1][1]
    assert [state for state, _ in states[2:]] == [
        GoalState.ACCEPTED,
        GoalState.MOVING,
        GoalState.REACHED,
    ]
    # Upwards from its start three_axis comes nearer to its stretched pose; in the end no jog
    # arrives.
    assert codes[0] == JogStatus.DECELERATE_FOR_APPROACHING_SINGULARITY and codes[-1] == 0


@dataclasses.dataclass
class JointJog:
    """The fields of control_msgs/JointJog, whose package may be absent."""

    joint_names: list[str]
    velocities: array[float]
    displacements: array[float] = dataclasses.field(default_factory=lambda: array("d"))
    duration: float = 0.0
    header: Header = dataclasses.field(default_factory=Header)


def test_the_node_takes_joint_jogs(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of the same fields: the named joint moves at its speed, the others stand; refusals."""

    def read(data: bytes, kind: Any) -> Any:
        return pickle.loads(data) if kind is JointJog else deserialize(data, kind)

    def write(message: Any) -> bytes:
        return pickle.dumps(message) if isinstance(message, JointJog) else serialize(message)

    deserialize, serialize = wires.deserialize_message, wires.serialize_message
    monkeypatch.setattr(wires, "deserialize_message", read)
    monkeypatch.setattr(wires, "serialize_message", write)
    monkeypatch.setattr(order_topics, "JointJog", JointJog)
    with in_process() as nodes:
        nodes.run_to(5)
        heard: list[MotionStatus] = []
        nodes.listen_alone("motion/status", MotionStatus, heard.append)
        topic, states = "~/delta_joint_cmds", list[JointState]()
        nodes.listen_alone("emulator/joint_states", JointState, states.append)
        for names, speeds, more in (
            (["elbow", "knee"], [0.1, 0.1], []),
            (["elbow", "elbow"], [0.1, 0.1], []),
            (["elbow"], [0.1, 0.2], []),
            (["elbow"], [np.nan], []),
            (["elbow"], [], [0.1]),
            ([], [], []),
        ):
            nodes.send(topic, JointJog(names, array("d", speeds), array("d", more)))
        for tick in range(20, 1000, 20):
            nodes.send(topic, JointJog(["elbow"], array("d", [0.4])))  # of jog_scale_joint
            nodes.run_to(tick)
    of_jog = [status.state for status in heard if status.kind == Kind.JOG]
    assert of_jog == [GoalState.REFUSED] * 6 + [GoalState.ACCEPTED, GoalState.MOVING]
    speed = np.array(states[-1].velocity)
    j = list(states[-1].name).index("elbow")
    assert speed[j] == pytest.approx(0.4 * 0.5, abs=0.01)
    assert np.abs(np.delete(speed, j)).max() < 0.01
