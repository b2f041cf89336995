"""Messages that nodes refuse, and the words in which they do."""

import math
from collections.abc import Callable
from typing import Any

from geometry_msgs.msg import PoseStamped
from network import JOINTS
from sensor_msgs.msg import JointState

from arm_emulator.ros.messages.time_stamp import convert_to_stamp
from arm_emulator_msgs.msg import MotorCommand, MotorState

ZERO = [0.0, 0.0, 0.0]
NAN, INF = math.nan, math.inf


def motor_command(tick: int, voltage: list[float] = ZERO, names: list[str] = JOINTS) -> Any:
    return MotorCommand(tick=tick, joint_names=names, command=voltage)


def joint_state(
    time_ns: int, position: list[float], names: list[str] = JOINTS, **more: list[float]
) -> Any:
    message = JointState(name=names, position=position, **more)
    message.header.stamp = convert_to_stamp(time_ns)
    return message


def motor_state(at: int, **change: Any) -> Any:
    message = MotorState(
        tick=at, joint_names=JOINTS, encoder_counts=[0, 0, 0], current=ZERO, powered=True
    )
    message.header.stamp = convert_to_stamp(at * 1_000_000)
    for field, value in change.items():
        setattr(message, field, value)
    return message


def pose(position: list[float], orientation: list[float], frame: str = "") -> Any:
    message = PoseStamped()
    message.header.frame_id = frame
    p, o = message.pose.position, message.pose.orientation
    p.x, p.y, p.z = position
    o.x, o.y, o.z, o.w = orientation
    return message


NAMES_RULE = "joint names must name every joint once"
UNKNOWN = "joint must be one of the arm, got {}; valid: waist, shoulder, elbow"
# Of each topic: what is sent at tick k of a paused run, and the beginning of the refusal.
Maker = Callable[[int], Any]
BAD: dict[str, list[tuple[Maker, str]]] = {
    "motor_commands": [
        (
            lambda k: motor_command(k - 1, [9.0, 9.0, 9.0]),
            "tick must be at least {k}, got {k-1} (stale)",
        ),
        (lambda k: motor_command(k + 1), "tick must be at most {k}, got {k+1} (future)"),
        (lambda k: motor_command(2**64 - 1), "tick must be at most {k}, got 18446744073709551615"),
        (lambda k: motor_command(k, names=["waist", "shoulder", "hand"]), UNKNOWN.format("hand")),
        (lambda k: motor_command(k, names=["waist", "waist", "elbow"]), NAMES_RULE),
        (lambda k: motor_command(k, [1.0, 2.0]), "command must have one value per joint name (3)"),
        (
            lambda k: motor_command(k, [1.0, NAN, 2.0]),
            "command of shoulder must be finite, got nan",
        ),
        (
            lambda k: motor_command(k, [1.0, 2.0, -INF]),
            "command of elbow must be finite, got -inf",
        ),
        (lambda k: motor_command(k, [], []), NAMES_RULE),
    ],
    "joint_targets": [
        (lambda k: joint_state(k * 10**6, [0.0, 0.5]), "position must have one value per joint"),
        (
            lambda k: joint_state(k * 10**6, [0.0, NAN, 0.5]),
            "position of shoulder must be finite, got nan",
        ),
        (
            lambda k: joint_state(k * 10**6, ZERO, velocity=[INF, 0.0, 0.0]),
            "velocity of waist must be finite, got inf",
        ),
        (lambda k: joint_state(k * 10**6, ZERO, effort=[1.0]), "effort must have one value per"),
        (
            lambda k: joint_state(k * 10**6, ZERO, ["waist", "elbow", "knee"]),
            UNKNOWN.format("knee"),
        ),
        (lambda k: joint_state(10**18, ZERO), "header.stamp must be that of the joint states it"),
    ],
    "motor_states": [
        (lambda k: motor_state(k + 1, joint_names=["a", "b", "c"]), UNKNOWN.format("a")),
        (lambda k: motor_state(k + 1, encoder_counts=[1, 2]), "encoder_counts must have one value"),
        (lambda k: motor_state(k + 1, current=[0.0] * 4), "current must have one value per joint"),
        (
            lambda k: motor_state(k + 1, current=[0.0, NAN, 0.0]),
            "current of shoulder must be finite, got nan",
        ),
        (lambda k: motor_state(k + 1, tick=k + 2), "header.stamp must be tick x servo period"),
    ],
    "tool_target": [
        (
            lambda _: pose([NAN, 0.0, 0.5], [0.0, 0.0, 0.0, 1.0]),
            "position must be numbers within +-1e+06 m",
        ),
        (
            lambda _: pose([0.1, 0.0, INF], [0.0, 0.0, 0.0, 1.0]),
            "position must be numbers within +-1e+06 m",
        ),
        (lambda _: pose([0.1, 0.0, 0.5], [0.0, 0.0, 0.0, 0.0]), "orientation must be a quaternion"),
        (
            lambda _: pose([0.1, 0.0, 0.5], [0.0, NAN, 0.0, 1.0]),
            "orientation must be finite numbers",
        ),
        (
            lambda _: pose([0.1, 0.0, 0.5], [0.0, 0.0, 0.0, 1.0], "camera"),
            "header.frame_id must be the arm's base, got camera; valid: world",
        ),
    ],
    "joint_states": [
        (lambda _: joint_state(10**18, [0.0, 0.5], ["waist", "elbow"]), NAMES_RULE),
        (
            lambda _: joint_state(10**18, [0.0, NAN, 0.5]),
            "position of shoulder must be finite, got nan",
        ),
        (lambda _: joint_state(10**18, []), "position must have one value per joint name (3)"),
    ],
}


def at_tick(words: str, tick: int) -> str:
    """Return the beginning of a refusal with the ticks that it has."""
    words = words.replace("{k}", f"{tick}")
    return words.replace("{k-1}", f"{tick - 1}").replace("{k+1}", f"{tick + 1}")
