"""Commands of a recorded motion, or of a table."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from arm_emulator.base.refusal import Refusal
from arm_emulator.machine.chain import Array
from arm_emulator.machine.measured import rows_of
from arm_emulator.machine.parts.output import FURTHER
from arm_emulator.machine.scene import Scene
from arm_emulator.runs.target_table import load_target_table


def read_commands(path: Path, scene: Scene) -> Array:
    """Return commands (K, N) in the scene's order of joints, a row per servo period from tick 0.

    Args:
        path: a bag's folder, whose `motor_states` are read, or a table with `t` and the joints'
            names, whose rows hold until the next one, in the units of the joints' commands.
        scene: the machine.

    Raises:
        Refusal: the file is missing, joints or servo period differ, or ticks are missing.
    """
    return _from_bag(path, scene) if path.is_dir() else _from_table(path, scene)


def _from_table(path: Path, scene: Scene) -> Array:
    table = load_target_table(path, scene.joint_names)
    ticks = table.ticks(scene.servo_period)
    last = ticks[-1] + (ticks[-1] - ticks[-2] if len(ticks) > 1 else 1)
    rows = np.zeros((last, len(scene.joints)))
    for begin, end, row in zip(ticks, [*ticks[1:], last], table.q, strict=True):
        rows[begin:end] = row
    return rows


def _from_bag(path: Path, scene: Scene) -> Array:
    """Return the applied commands in motor states: those of the servo period before each."""
    # They need ROS, which is optional here.
    from arm_emulator.bags.recorded_topics import RecordedTopics
    from arm_emulator.ros.bag import Bag

    applied_further = rows_of(scene)[FURTHER]
    rows, tick, gap = list[list[float]](), -1, ""  # of the newest run
    for _, state in RecordedTopics(Bag(path)).read("motor_states"):
        if state.tick == tick:
            continue  # published again, as no answer came
        if state.tick == 0:
            rows, gap = [], ""
        elif state.tick != tick + 1:
            gap = gap or f"{state.tick} after {tick}"
        names = list(state.joint_names)
        if sorted(names) != sorted(scene.joint_names):
            valid = ", ".join(scene.joint_names)
            raise Refusal(str(path), "joints", f"be those of {scene.where}", names, valid)
        tick = int(state.tick)
        at = state.header.stamp.sec + 1e-9 * state.header.stamp.nanosec
        if abs(at - tick * scene.servo_period) > 0.5 * scene.servo_period:
            rule = f"be {scene.servo_period:g} s apart, the scene's servo period"
            raise Refusal(str(path), "motor_states", rule, f"tick {tick} at {at:g} s")
        for name in set(state.reading_names) & set(applied_further):
            at = list(state.reading_names).index(name) * len(names)
            if any(state.readings[at : at + len(names)]):
                rule = "be 0: motions are judged under the commands alone"
                raise Refusal(str(path), name, rule, f"another at tick {tick}")
        rows.append([float(state.applied[names.index(joint)]) for joint in scene.joint_names])
    if gap:
        rule = "have every tick of the last run, from 0 on"
        raise Refusal(str(path), "motor_states", rule, gap)
    if len(rows) < 2:
        raise Refusal(str(path), "bag", "have motor_states of two ticks at least", len(rows))
    return np.array(rows[1:])
