"""The topic-based hardware component of ros2_control in our motion controller's place.

`JointStateTopicSystem` of joint_state_topic_hardware_interface 1.1 is stated here by its messages:
it takes the newest joint states, by name, at the rate of its controllers. It publishes the commands
of all joints if they differ from the states by more than a threshold in sum. The true angles judge
the arm.
"""

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest
from draws import with_slow
from in_process import InProcess, in_process
from sensor_msgs.msg import JointState

from arm_emulator import load_scene
from arm_emulator.base.io.config_files import find_config
from arm_emulator.servo.watchdog import WatchdogState

PERIOD = 10  # ticks of 1 ms: controllers at 100 Hz
SECONDS = 1.0
AFTER = 4.0  # s, longer than the servo's watchdog waits
AWAY = 0.3  # rad
DEFAULT, ALWAYS = 1e-5, -1.0  # of trigger_joint_command_threshold


class TopicSystem:
    """The component, with joints in an order of its own."""

    def __init__(self, joints: list[str], commands: tuple[str, ...], threshold: float) -> None:
        self.joints, self.commands, self.threshold = joints, commands, threshold
        self.state = dict.fromkeys(joints, np.nan)
        self.speed = dict.fromkeys(joints, np.nan)
        self.sent = 0

    def read(self, message: JointState) -> None:
        for name, position, velocity in zip(
            message.name, message.position, message.velocity, strict=True
        ):
            if name in self.state:
                self.state[name], self.speed[name] = position, velocity

    def write(self, q: dict[str, float], v: dict[str, float], time_ns: int) -> JointState | None:
        """Return its message; None: nothing differs by more than the threshold."""
        signals = {"position": (q, self.state), "velocity": (v, self.speed)}
        difference = sum(
            abs(signals[kind][1][name] - signals[kind][0][name])
            for name in self.joints
            for kind in self.commands
        )
        if difference <= self.threshold:
            return None
        message = JointState(name=self.joints)
        message.header.stamp.sec, message.header.stamp.nanosec = divmod(time_ns, 10**9)
        for kind in self.commands:
            setattr(message, kind, [signals[kind][0][name] for name in self.joints])
        self.sent += 1
        return message


def gains(folder: Path, scene: str) -> Path:
    """Return the scene's gains with targets that come at any time."""
    text = find_config(scene, ".yaml", "servo").read_text()
    file = folder / f"{scene}.yaml"
    file.write_text(text.replace("motion_period: 0.05", "motion_period: 0.0"))
    assert file.read_text() != text
    return file


@pytest.fixture
def nodes(tmp_path: Path) -> Iterator[InProcess]:
    with in_process(servo=gains(tmp_path, "three_axis")) as inside:
        yield inside


def quintic(part: float) -> tuple[float, float]:
    """Return place and slope of a motion from 0 to 1 that rests at both ends."""
    t = min(max(part, 0.0), 1.0)
    return t**3 * (10.0 - 15.0 * t + 6.0 * t * t), 30.0 * t * t * (1.0 - t) ** 2


@pytest.mark.parametrize(
    ("threshold", "commands"),
    with_slow(
        [
            (DEFAULT, ("position", "velocity")),
            (ALWAYS, ("position",)),
            (DEFAULT, ("position",)),
            (ALWAYS, ("position", "velocity")),
        ],
        1,
    ),
)
def test_a_trajectory_is_followed_and_then_its_end_stays(
    nodes: InProcess, commands: tuple[str, ...], threshold: float
) -> None:
    scene = load_scene("three_axis")
    names = list(scene.joint_names)
    system = TopicSystem(names[::-1], commands, threshold)
    nodes.listen_alone("joint_states", JointState, system.read)
    start = dict(zip(names, map(float, scene.start), strict=True))
    off: list[npt.NDArray[np.float64]] = []
    for tick in range(0, round(1000 * (SECONDS + AFTER)), PERIOD):
        nodes.run_to(tick + 1)
        place, slope = quintic(1e-3 * tick / SECONDS)
        q = {name: start[name] + AWAY * place for name in names}
        message = system.write(q, dict.fromkeys(names, AWAY * slope / SECONDS), tick * 10**6)
        if message is not None:
            nodes.send("joint_targets", message)
        true = nodes.newest("emulator/joint_states")
        positions = dict(zip(true.name, true.position, strict=True))
        off.append(np.array([abs(positions[name] - q[name]) for name in names]))
    assert nodes.refused("servo") == nodes.refused("emulator") == 0
    # At 30 AWAY / 16 SECONDS = 0.56 rad/s a period of 10 ms is 6 mrad late, a servo of some 10 1/s
    # without the speed 60 mrad; a gear that carries the arm's weight is wound up by some mrad.
    assert np.max(off) < (0.1 if commands == ("position",) else 0.03)
    assert np.max(off[-1]) < 5e-3
    assert nodes.nodes["servo"]._drives.state is WatchdogState.OK


@pytest.mark.slow
def test_a_threshold_above_the_error_at_rest_leads_to_a_cut(nodes: InProcess) -> None:
    """The component is silent then, as a dead controller is."""
    scene = load_scene("three_axis")
    goal = {joint.name: joint.start + AWAY for joint in scene.joints}
    system = TopicSystem(list(goal), ("position",), 0.1)
    nodes.listen_alone("joint_states", JointState, system.read)
    states = list[WatchdogState]()
    for tick in range(0, round(1000 * AFTER), PERIOD):
        nodes.run_to(tick + 1)
        message = system.write(goal, {}, tick * 10**6)
        if message is not None:
            nodes.send("joint_targets", message)
        states.append(nodes.nodes["servo"]._drives.state)
    # It is silent from when the arm has come near, not from the start.
    assert 5 < system.sent < 100
    assert states[system.sent - 1] is WatchdogState.OK
    assert states[system.sent + 50] is WatchdogState.HOLD and states[-1] is WatchdogState.CUT


def test_positions_that_are_not_commanded_are_refused(nodes: InProcess) -> None:
    """So they are until a controller is active: the arm holds, and nothing else happens."""
    scene = load_scene("three_axis")
    names = list(scene.joint_names)
    system = TopicSystem(names, ("position",), DEFAULT)
    nodes.listen_alone("joint_states", JointState, system.read)
    for tick in range(0, 1000, PERIOD):
        nodes.run_to(tick + 1)
        message = system.write(dict.fromkeys(names, np.nan), {}, tick * 10**6)
        assert message is not None, "a difference that is not a number is not below a threshold"
        nodes.send("joint_targets", message)
    assert nodes.refused("servo") == system.sent
    true = nodes.newest("emulator/joint_states")
    assert np.allclose(true.position, scene.start, atol=5e-3)
