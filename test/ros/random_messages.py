"""Seeded random messages for every topic that a node listens to, extreme finite numbers among them.

    message = bad_message(rng, topic, joint_names, tick, period_ns=1_000_000)
    message = random_message(rng, topic, joint_names, tick, period_ns=1_000_000)

- `rng` is a ``random.Random``: the same seed gives the same messages.
- `topic` is one of `TOPICS`; `RECEIVER[topic]` is the node that acts on it. (`clock` is taken,
  too: every node with ``use_sim_time`` listens to it.)
- `joint_names` are those of the scene, `tick` is where the emulator stands [servo periods], or any
  later one, `period_ns` is the servo period [ns].

`bad_message` breaks at least one rule of topics.md: its receiver must refuse it, count it, and
be as before, bit by bit, in both clocks. `random_message` is anything of the topic's type, from
sound to absurd: its receiver may take it, and must go on working.
"""

import math
import random
import sys
from collections.abc import Callable, Sequence
from typing import Any

from builtin_interfaces.msg import Duration, Time
from geometry_msgs.msg import PoseStamped
from nav_msgs.msg import Path
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState
from std_msgs.msg import String
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from arm_emulator_msgs.msg import MotorCommand, MotorState

TOPICS = (
    "motor_commands",
    "motor_states",
    "joint_targets",
    "joint_states",
    "tool_target",
    "joint_trajectory",
    "tool_path",
    "robot_description",
)
# Node that acts on each topic of reports.
RECEIVER = {
    "motor_commands": "emulator",
    "motor_states": "servo",
    "joint_targets": "servo",
    "joint_states": "motion_controller",
    "tool_target": "motion_controller",
    "joint_trajectory": "motion_controller",
    "tool_path": "motion_controller",
    "robot_description": "motion_controller",
}

LARGEST_FLOAT = sys.float_info.max
SMALLEST_FLOAT = 5e-324
# Beyond the bound of every quantity, see docs/reference/topics.md.
BEYOND = 2e9
BEYOND_COUNTS = 2**53
MOTION_PERIOD_NS = 50_000_000  # of the shipped scenes


def number(rng: random.Random) -> float:
    """Return any number: ordinary, tiny, huge, a special one."""
    sign = rng.choice((-1.0, 1.0))
    return sign * rng.choice(
        (
            rng.gauss(0.0, 1.0),
            10.0 ** rng.uniform(-323.0, 308.0),
            10.0 ** rng.uniform(0.0, 12.0),
            huge(rng),
            rng.choice((0.0, 1.0, SMALLEST_FLOAT, 2.0**53, 1e6, 1e9, LARGEST_FLOAT)),
            rng.choice((math.nan, math.inf)),
        )
    )


def huge(rng: random.Random) -> float:
    """Return a finite number beyond every bound."""
    size = rng.choice((10.0 ** rng.uniform(math.log10(BEYOND), 308.0), 1e308, LARGEST_FLOAT))
    return rng.choice((-size, size))


def _wrong(rng: random.Random) -> float:
    """Return a number that every receiver must refuse; mostly a finite one."""
    return rng.choice((huge(rng), huge(rng), huge(rng), math.nan, math.inf, -math.inf))


def _wrong_count(rng: random.Random) -> int:
    size = rng.choice((rng.randint(BEYOND_COUNTS, 2**63 - 1), 2**63 - 1, 2**62))
    return rng.choice((-size - 1, size))


def _wrong_time(rng: random.Random) -> Time:
    """Return a time stamp that no logical time has: before 0, or with more than a second of ns."""
    if rng.random() < 0.5:
        sec = rng.choice((-1, -(2**31), rng.randint(-(2**31), -1)))
        return Time(sec=sec, nanosec=rng.randrange(10**9))
    return Time(sec=rng.randint(0, 2**31 - 1), nanosec=rng.randint(10**9, 2**32 - 1))


def _any_time(rng: random.Random) -> Time:
    sec = rng.choice((0, 1, -1, 2**31 - 1, -(2**31), rng.randint(-(2**31), 2**31 - 1)))
    nanosec = rng.choice((0, 50_000_000 * rng.randrange(20), 10**9, 2**32 - 1, rng.getrandbits(32)))
    return Time(sec=sec, nanosec=nanosec)


def _time(nanoseconds: int) -> Time:
    return Time(sec=nanoseconds // 10**9, nanosec=nanoseconds % 10**9)


def _many(rng: random.Random) -> int:
    """Return a number of names or letters, seldom a very large one: those take long to send."""
    return rng.choice((20, 100, 1_000)) if rng.random() < 0.98 else 10_000


def _wrong_names(rng: random.Random, names: Sequence[str]) -> list[str]:
    """Return names that are not each of `names` once."""
    names = list(names)
    rng.shuffle(names)
    return rng.choice(
        (
            lambda: [],
            lambda: names[1:],
            lambda: [*names, names[0]],
            lambda: [names[0]] * (len(names) + 1),
            lambda: [*names[1:], rng.choice(("", " ", "joint", "a\nb", "é" * _many(rng)))],
            lambda: [text(rng) for _ in range(rng.randint(1, 20))] + ["no joint"],
            lambda: [f"joint_{index}" for index in range(_many(rng))],
        )
    )()


def text(rng: random.Random) -> str:
    """Return a short text of any characters but NUL and surrogates."""
    letters = (chr(rng.choice((rng.randint(1, 127), rng.randint(1, 0xD7FF)))) for _ in range(99))
    return "".join(letter for letter, _ in zip(letters, range(rng.randint(0, 30)), strict=False))


# --------------------------------------------------------------------------------- sound messages


def _sound(
    rng: random.Random, topic: str, joint_names: Sequence[str], tick: int, period_ns: int
) -> Any:
    names = list(joint_names)
    rng.shuffle(names)
    N = len(names)
    values = [rng.gauss(0.0, 0.5) for _ in names]
    if topic == "motor_commands":
        command = MotorCommand(tick=tick, joint_names=names, command=values)
        command.header.stamp = _time(tick * period_ns)
        return command
    if topic == "motor_states":
        counts = [rng.randint(-10_000, 10_000) for _ in names]
        state = MotorState(
            tick=tick, joint_names=names, encoder_counts=counts, current=values, powered=True
        )
        state.applied = [0.0] * N
        state.header.stamp = _time(tick * period_ns)
        return state
    if topic in ("joint_targets", "joint_states"):
        message = JointState(name=names, position=values)
        if rng.random() < 0.5:
            message.velocity, message.effort = [0.0] * N, [0.0] * N
        # A motion period begins there.
        message.header.stamp = _time(-(-tick * period_ns // MOTION_PERIOD_NS) * MOTION_PERIOD_NS)
        return message
    if topic == "tool_target":
        target = PoseStamped()
        p, o = target.pose.position, target.pose.orientation
        p.x, p.y, p.z = (rng.uniform(-0.5, 0.5) for _ in range(3))
        quaternion = [rng.gauss(0.0, 1.0) for _ in range(4)]
        if not any(quaternion):
            quaternion[3] = 1.0
        length = math.hypot(*quaternion)
        o.x, o.y, o.z, o.w = (x / length for x in quaternion)
        target.header.stamp = _time(tick * period_ns)
        return target
    if topic == "joint_trajectory":
        return _trajectory(rng, names, tick * period_ns)
    if topic == "tool_path":
        poses = [
            _sound(rng, "tool_target", joint_names, tick, period_ns)
            for _ in range(rng.randint(1, 5))
        ]
        path = Path(poses=poses)
        path.header.stamp = _time(tick * period_ns)
        if rng.random() < 0.5:
            for i, pose in enumerate(poses):
                pose.header.stamp = _time(tick * period_ns + 10**10 * (i + 1))
        return path
    if topic == "robot_description":
        return String(data=random_urdf(rng, names))
    assert topic == "clock", topic
    return Clock(clock=_time(tick * period_ns))


def _trajectory(rng: random.Random, names: list[str], at_ns: int) -> JointTrajectory:
    names = names[: rng.randint(1, len(names))]
    message = JointTrajectory(joint_names=names)
    message.header.stamp = _time(at_ns)
    fields = ("velocities", "accelerations")[: rng.randrange(3)]
    for i in range(rng.randint(1, 5)):
        values = [rng.gauss(0.0, 0.5) for _ in names]
        point = JointTrajectoryPoint(positions=values, time_from_start=Duration(sec=10 * (i + 1)))
        for field in fields:
            setattr(point, field, [0.0] * len(names))
        message.points.append(point)
    return message


def random_urdf(
    rng: random.Random, names: Sequence[str], number: Callable[[], float] = lambda: 0.5
) -> str:
    """Return a chain of revolute joints whose last link is `tool`."""
    links = ["base", *(f"link_{name}" for name in names[:-1]), "tool"]
    rows = ['<robot name="random">', *(f'<link name="{link}"/>' for link in links)]
    for name, parent, child in zip(names, links[:-1], links[1:], strict=True):
        xyz = " ".join(repr(number()) for _ in range(3))
        rows.append(
            f'<joint name="{name}" type="revolute"><parent link="{parent}"/>'
            f'<child link="{child}"/><origin xyz="{xyz}" rpy="0 0 {number()!r}"/>'
            f'<axis xyz="0 {rng.choice((0, 1))} 1"/>'
            f'<limit lower="-3" upper="3" effort="1" velocity="1"/></joint>'
        )
    return "\n".join([*rows, "</robot>"])


# ----------------------------------------------------------------------------------- bad messages


def bad_message(
    rng: random.Random,
    topic: str,
    joint_names: Sequence[str],
    tick: int,
    period_ns: int = 1_000_000,
) -> Any:
    """Return a message that its receiver must refuse; see the module for the arguments."""
    message = _sound(rng, topic, joint_names, tick, period_ns)
    changes = _CHANGES[topic]
    for change in rng.sample(changes, min(len(changes), rng.choice((1, 1, 1, 2, len(changes))))):
        change(rng, message, joint_names, tick)
    return message


Change = Callable[[random.Random, Any, Sequence[str], int], None]


def _wrong_in(field: str, wrong: Callable[[random.Random], Any] = _wrong) -> Change:
    """Put a number that every receiver must refuse at a random place of an array."""

    def spoil(rng: random.Random, message: Any, names: Sequence[str], tick: int) -> None:
        values = list(getattr(message, field)) or [0] * len(names)
        if rng.random() < 0.3:
            values = [wrong(rng) for _ in values]
        values[rng.randrange(len(values))] = wrong(rng)
        setattr(message, field, values)

    return spoil


def _wrong_length_of(field: str) -> Change:
    def spoil(rng: random.Random, message: Any, names: Sequence[str], tick: int) -> None:
        names_field, own = ("name", "joint_names")[hasattr(message, "joint_names")], field
        others = [
            n for n in (1, len(names) + 1, _many(rng)) if n != len(getattr(message, names_field))
        ]
        setattr(message, own, [0] * rng.choice(others))

    return spoil


def _rename_joints(field: str) -> Change:
    def spoil(rng: random.Random, message: Any, names: Sequence[str], tick: int) -> None:
        wrong = _wrong_names(rng, names)
        before = len(getattr(message, field))
        setattr(message, field, wrong)
        if rng.random() < 0.5:  # the arrays' lengths fit, and only the names are wrong
            for array in ("command", "applied", "encoder_counts", "current", "position"):
                if hasattr(message, array) and len(getattr(message, array)) == before:
                    setattr(message, array, [0] * len(wrong))

    return spoil


def _wrong_stamp(rng: random.Random, message: Any, names: Sequence[str], tick: int) -> None:
    message.header.stamp = _wrong_time(rng)


def _future_tick(rng: random.Random, message: Any, names: Sequence[str], tick: int) -> None:
    message.tick = rng.choice((2**64 - 1, 2**63 - 1, 2**63, rng.randint(tick + 10**7, 2**64 - 1)))


def _another_tick(rng: random.Random, message: Any, names: Sequence[str], tick: int) -> None:
    """Give a tick that the stamp does not fit."""
    message.tick = rng.choice((2**64 - 1, 2**63 - 1, tick + 1 + rng.getrandbits(62)))


def _wrong_position(rng: random.Random, message: Any, names: Sequence[str], tick: int) -> None:
    setattr(message.pose.position, rng.choice("xyz"), _wrong(rng))


def _wrong_orientation(rng: random.Random, message: Any, names: Sequence[str], tick: int) -> None:
    o = message.pose.orientation
    size = rng.choice((0.0, SMALLEST_FLOAT, 1e-300, 1e-3, 0.9, 1.1, 1e10, 1e155, 1e300))
    o.x, o.y, o.z, o.w = (size * x for x in (o.x, o.y, o.z, o.w))
    if rng.random() < 0.5:
        setattr(o, rng.choice("xyzw"), _wrong(rng))


def _wrong_frame(rng: random.Random, message: Any, names: Sequence[str], tick: int) -> None:
    message.header.frame_id = "no " + rng.choice((text(rng), "frame\n" * 3, "x" * _many(rng)))


def _wrong_clock(rng: random.Random, message: Any, names: Sequence[str], tick: int) -> None:
    message.clock = _wrong_time(rng)


def _point(spoil: Callable[[random.Random, Any, int], None]) -> Change:
    """Spoil a random point of a trajectory, with the number of its joints."""

    def change_point(rng: random.Random, message: Any, names: Sequence[str], tick: int) -> None:
        if message.points:
            spoil(rng, rng.choice(message.points), len(message.joint_names))

    return change_point


def _wrong_number(rng: random.Random, point: Any, count: int) -> None:
    point.velocities = list(point.velocities) or [0.0] * count
    field = rng.choice(("positions", "velocities", "accelerations", "effort"))
    values = list(getattr(point, field)) or [0.0] * max(1, count)
    values[rng.randrange(len(values))] = _wrong(rng)
    setattr(point, field, values)


def _wrong_count_of_values(rng: random.Random, point: Any, count: int) -> None:
    field = rng.choice(("positions", "velocities", "accelerations", "effort"))
    setattr(point, field, [0.0] * rng.choice((count + 1, _many(rng) + count)))


def _wrong_time_from_start(rng: random.Random, point: Any, count: int) -> None:
    sec = rng.choice((-1, -(2**31), rng.randint(-(2**31), -1)))
    point.time_from_start = rng.choice(
        (Duration(sec=sec), Duration(sec=1, nanosec=rng.randint(10**9, 2**32 - 1)))
    )


def _same_times(rng: random.Random, message: Any, names: Sequence[str], tick: int) -> None:
    message.points = [*message.points, message.points[-1]]


def _nobodys_joints(rng: random.Random, message: Any, names: Sequence[str], tick: int) -> None:
    wrong = rng.choice((["no joint"], [names[0], names[0]], [], [text(rng) + "!"] * 3))
    message.joint_names = wrong
    for point in message.points:
        point.positions = [0.0] * len(wrong)
        point.velocities, point.accelerations = [], []


def _wrong_pose(rng: random.Random, message: Any, names: Sequence[str], tick: int) -> None:
    if message.poses:
        change = rng.choice((_wrong_position, _wrong_orientation, _wrong_frame, _wrong_stamp))
        change(rng, rng.choice(message.poses), names, tick)


def _wrong_number_of_poses(
    rng: random.Random, message: Any, names: Sequence[str], tick: int
) -> None:
    message.poses = message.poses[:1] * 5001 if rng.random() < 0.03 else []


def _far_path(rng: random.Random, message: Any, names: Sequence[str], tick: int) -> None:
    far = PoseStamped()
    far.pose.position.x, far.pose.orientation.w = rng.choice((1e4, -9e5)), 1.0
    near = PoseStamped()
    near.pose.orientation.w = 1.0
    message.poses = [near, far]


def _no_urdf(rng: random.Random, message: Any, names: Sequence[str], tick: int) -> None:
    data = message.data
    message.data = rng.choice(
        (
            lambda: "",
            lambda: text(rng),
            lambda: data[: rng.randrange(len(data) - len("</robot>"))],
            lambda: data.replace('"tool"', '"hand"'),
            lambda: data.replace("<parent", "<father"),
            lambda: random_urdf(rng, names, lambda: huge(rng)),
        )
    )()


_CHANGES: dict[str, list[Change]] = {
    "motor_commands": [
        _wrong_in("command"),
        _wrong_length_of("command"),
        _rename_joints("joint_names"),
        _future_tick,
    ],
    "motor_states": [
        _wrong_in("encoder_counts", _wrong_count),
        _wrong_in("current"),
        _wrong_length_of("encoder_counts"),
        _wrong_length_of("current"),
        _rename_joints("joint_names"),
        _wrong_stamp,
        _another_tick,
    ],
    "joint_targets": [
        _wrong_in("position"),
        _wrong_in("velocity"),
        _wrong_in("effort"),
        _wrong_length_of("position"),
        _rename_joints("name"),
        _wrong_stamp,
    ],
    "joint_states": [
        _wrong_in("position"),
        _wrong_length_of("position"),
        _rename_joints("name"),
        _wrong_stamp,
    ],
    "tool_target": [_wrong_position, _wrong_orientation, _wrong_frame, _wrong_stamp],
    "joint_trajectory": [
        _point(_wrong_number),
        _point(_wrong_count_of_values),
        _point(_wrong_time_from_start),
        _same_times,
        _nobodys_joints,
        _wrong_stamp,
    ],
    "tool_path": [_wrong_pose, _wrong_number_of_poses, _far_path, _wrong_frame, _wrong_stamp],
    "robot_description": [_no_urdf],
    "clock": [_wrong_clock],
}


# -------------------------------------------------------------------------------- random messages


def random_message(
    rng: random.Random,
    topic: str,
    joint_names: Sequence[str],
    tick: int,
    period_ns: int = 1_000_000,
) -> Any:
    """Return any message of a topic; see the module for the arguments."""
    message = _sound(rng, topic, joint_names, tick, period_ns)
    if rng.random() < 0.3:
        return bad_message(rng, topic, joint_names, tick, period_ns)
    if topic == "clock":
        message.clock = _any_time(rng)
    elif topic == "robot_description":
        message.data = random_urdf(rng, joint_names, lambda: number(rng))
    else:
        _stir(rng, message)
    return message


def _stir(rng: random.Random, message: Any) -> None:
    """Replace some of the fields by anything of their type."""
    if rng.random() < 0.5:
        message.header.stamp = _any_time(rng)
    if rng.random() < 0.2:
        message.header.frame_id = text(rng)
    for field, kind in message.get_fields_and_field_types().items():
        if rng.random() < 0.5:
            continue
        values = getattr(message, field)
        if kind == "uint64":
            setattr(message, field, rng.choice((0, 2**63 - 1, 2**64 - 1, rng.getrandbits(64))))
        elif kind == "boolean":
            setattr(message, field, rng.random() < 0.5)
        elif kind == "sequence<double>":
            setattr(message, field, [number(rng) for _ in values])
        elif kind == "sequence<int64>":
            setattr(message, field, [_any_count(rng) for _ in values])
        elif kind == "sequence<trajectory_msgs/JointTrajectoryPoint>":
            for point in values:
                for name in ("positions", "velocities", "accelerations", "effort"):
                    if rng.random() < 0.3:
                        setattr(point, name, [number(rng) for _ in point.positions])
                if rng.random() < 0.3:
                    sec = rng.choice((0, 1, 5, 2**31 - 1, rng.randint(0, 100)))
                    point.time_from_start = Duration(sec=sec, nanosec=rng.randrange(10**9))
        elif kind == "sequence<geometry_msgs/PoseStamped>":
            for value in values:
                _stir(rng, value)
        elif kind == "geometry_msgs/Pose":
            for part, names in ((values.position, "xyz"), (values.orientation, "xyzw")):
                setattr(part, rng.choice(names), number(rng))


def _any_count(rng: random.Random) -> int:
    bits = rng.randint(1, 63)
    return rng.randint(-(2**bits), 2**bits - 1)
