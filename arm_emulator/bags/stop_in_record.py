"""Vibration after the last stop of a recorded run."""

import numpy as np

from arm_emulator.analysis.residual_vibration import (
    ResidualVibration,
    find_reference_end,
    measure_vibration,
)
from arm_emulator.bags.explanation import arrange_joints
from arm_emulator.bags.recorded_machine import RecordedMachine
from arm_emulator.base.arrays import Array
from arm_emulator.base.refusal import Refusal
from arm_emulator.machine.plant.plant_state import compute_count_angle
from arm_emulator.machine.session.tool_chain import ToolChain, list_tool_signals

_NANOSECONDS = 1e9


def measure_stop(
    machine: RecordedMachine, band: float, end: int | None = None
) -> tuple[int, ResidualVibration, ResidualVibration]:
    """Return the tick at which the last motion's targets end, and the tool's vibration after it.

    The machine is driven to the end of its record.

    Args:
        machine: at any tick before the end of its targets.
        band: distance from its rest that counts as rest [m].
        end: tick from which it is measured; None: that at which the joint targets end.

    Returns:
        The tick; the vibration by the true links; that by the encoders.

    Raises:
        Refusal: a scene whose tool no joint carries, or a record without targets, or that ends with
            them.
    """
    scene, where = machine.scene, str(machine.topics.bag.path)
    if not list_tool_signals(scene):
        raise Refusal(where, "the scene", "have a tool that a joint carries", scene.name)
    if end is None:
        ticks, targets = _read_targets(machine)
        if not len(ticks):
            valid = "--at, the time at which the motion ends"
            raise Refusal(where, "joint_targets", "be recorded", "none", valid)
        every = np.arange(machine.last + 1)
        rows = targets[np.maximum(0, np.searchsorted(ticks, every, side="right") - 1)]
        end = find_reference_end(rows)
    machine.advance(max(0, end - machine.tick))
    scale = compute_count_angle(scene)
    true, measured = [], []
    while True:
        true.append(machine.session.state.q)
        measured.append(scale * machine.session.measured.encoder_counts)
        if machine.tick == machine.last:
            break
        machine.advance(1)
    chain, period = ToolChain(scene), scene.servo_period
    by_truth, by_encoders = (
        measure_vibration(chain.compute_positions(np.array(q).T).T, period, band)
        for q in (true, measured)
    )
    return end, by_truth, by_encoders


def _read_targets(machine: RecordedMachine) -> tuple[Array, Array]:
    """Return the ticks from which targets hold (T,), and the targets (T, N)."""
    names, period = machine.scene.joint_names, machine.scene.servo_period
    first, last = machine.ticks[0].published, machine.ticks[-1].published
    ticks, rows = [], []
    for _, message, at in machine.topics.read_with_time("joint_targets"):
        row = arrange_joints(message.name, message.position, names, None)
        if row is None or not first <= at <= last:
            continue
        stamp = message.header.stamp
        ticks.append(round((stamp.sec + stamp.nanosec / _NANOSECONDS) / period))
        rows.append(row)
    return np.array(ticks), np.array(rows)
