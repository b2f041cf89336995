"""Bags of our own network as records of motion."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from arm_emulator.bags.recorded_topics import RecordedTopics
from arm_emulator.base.refusal import Refusal
from arm_emulator.identification.measured_run import MeasuredRun
from arm_emulator.identification.read_run import run_of
from arm_emulator.machine.plant_state import link_angle_per_count
from arm_emulator.machine.scene import Scene
from arm_emulator.ros.bag import Bag


def read_bag_run(path: Path, scene: Scene) -> MeasuredRun:
    """Read the motor states of a bag: counts and currents, or commanded torques.

    Raises:
        Refusal: it cannot be read, something is missing, or samples are not sound.
    """
    t = list[float]()
    counts, current, command, at_link = (list[list[float]]() for _ in range(4))
    tick = -1
    for _, state in RecordedTopics(Bag(path)).read("motor_states"):
        if state.tick == tick:
            continue  # published again, as no answer came
        tick = state.tick
        names = list(state.joint_names)
        for joint in scene.joint_names:
            if joint not in names:
                raise Refusal(str(path), "joints", f"be those of {scene.where}", ", ".join(names))
        order = [names.index(joint) for joint in scene.joint_names]
        t.append(state.header.stamp.sec + 1e-9 * state.header.stamp.nanosec)
        for into, of in (
            (counts, state.encoder_counts), (current, state.current),
            (command, state.applied), (at_link, state.link_encoder_counts),
        ):  # fmt: skip
            into.append([of[k] if len(of) else 0 for k in order])
    if not t:
        raise Refusal(str(path), "bag", "have motor_states", "none")
    q_motor = (np.array(counts, np.float64) + 0.5) * link_angle_per_count(scene)
    units = np.array([joint.unit == "N m" for joint in scene.joints])
    Kt = np.array([getattr(joint.motor, "torque_constant", np.nan) for joint in scene.joints])
    tau = np.array(current, np.float64) * np.nan_to_num(Kt)
    # A command is reported at the end of the period in which it held: here, half of it before.
    applied = np.array(command, np.float64)
    later = np.vstack([applied[1:], applied[-1:]])
    tau = np.where(units, 0.5 * (applied + later), tau)
    signals = {"t": np.array(t), "q_motor": q_motor, "tau": tau}
    link = np.array(at_link, np.float64)
    if link.any():
        per = [joint.sensors.link_encoder for joint in scene.joints]
        scale = [2.0 * np.pi / one.counts_per_turn if one else np.nan for one in per]
        signals["q_link"] = (link + 0.5) * np.array(scale)
    return run_of(signals, scene, str(path))
