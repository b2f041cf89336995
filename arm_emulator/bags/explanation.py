"""One moment of a recorded run: commands, limits, energy flow, and torques term by term."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from arm_emulator.analysis.torque_terms import TermsNow, TorqueTerms
from arm_emulator.bags.recorded_machine import RecordedMachine
from arm_emulator.bags.recorded_topics import RecordedTopics
from arm_emulator.bags.repetition import KINDS
from arm_emulator.base.arrays import Array
from arm_emulator.machine.plant.core_machine import EnergyFlow
from arm_emulator.machine.plant.measured import Measured
from arm_emulator.machine.plant.plant import Plant
from arm_emulator.machine.plant.plant_state import PlantState
from arm_emulator.machine.scene.scene import Scene
from arm_emulator.ros.messages.event_words import describe_motion

AT_LIMIT = 1.0 - 1e-9  # share of the largest command from which a drive is at its limit


@dataclass(frozen=True)
class Explanation:
    """A moment of a run: the start of a servo period.

    Attributes:
        tick: of the run.
        t: logical time [s].
        powered: whether the drives have power.
        rows: of the joints (N,): `q_target`, the newest joint targets [rad or m]; the true `q`, `v`
            and `current`; `commanded` by the motor command that answers this tick; `applied`, what
            the motors get from now on [V, N m or A]. None: the bag has none, or it ends here.
        orders: newest report on targets, paths and trajectories, as text; empty: none.
        active: limits, modes and events that act now, a sentence each.
        flow: powers that joints get and dissipate [W]; None: the scene has no `energy_flow`.
        terms: torques on links and rotors.
    """

    tick: int
    t: float
    powered: bool
    rows: dict[str, Array | None]
    orders: str
    active: list[str]
    flow: EnergyFlow | None
    terms: TermsNow


def explain_moment(machine: RecordedMachine) -> Explanation:
    """Return commands, torques and limits that act on a machine at its present tick.

    Raises:
        Refusal: there is no compiler, or a message cannot be read.
    """
    scene, session, tick = machine.scene, machine.session, machine.tick
    here = machine.ticks[tick]
    following = machine.ticks[tick + 1] if tick < machine.last else None
    applied = None if following is None else following.applied[0]
    powered = session.powered if following is None else following.powered
    acts = np.zeros(len(scene.joints)) if applied is None else applied
    terms = TorqueTerms(scene).evaluate_torques(session.plant.save(), acts)
    ends = following.published if following is not None else here.published + 1
    commanded, q_target, orders = _find_newest(machine.topics, scene, tick, here.published, ends)
    active = [
        *_list_changes(machine, tick),
        *_list_limits(scene, session.plant, session.measured, acts, commanded),
        *_list_modes(scene, session.state, terms),
    ]
    return Explanation(
        tick=tick,
        t=tick * scene.servo_period,
        powered=powered,
        rows={
            "q_target": q_target,
            "q": session.state.q,
            "v": session.state.v,
            "current": session.state.current,
            "commanded": commanded,
            "applied": applied,
        },
        orders=orders,
        active=active,
        flow=session.plant.powers(acts) if scene.energy_flow else None,
        terms=terms,
    )


def _find_newest(
    topics: RecordedTopics, scene: Scene, tick: int, published: int, ends: int
) -> tuple[Array | None, Array | None, str]:
    """Return the command of a tick, and the newest targets and report before its end."""
    names = scene.joint_names
    commanded: Array | None = None
    q_target: Array | None = None
    orders = ""
    topics_read = "motor_commands", "joint_targets", "motion/status"
    for name, message, at in topics.read_with_time(*topics_read):
        if at > ends:
            break
        if name == "joint_targets":
            q_target = arrange_joints(message.name, message.position, names, q_target)
        elif name == "motion/status":
            orders = describe_motion(message)
        elif message.tick == tick and at >= published:
            commanded = arrange_joints(message.joint_names, message.command, names, commanded)
    return commanded, q_target, orders


def arrange_joints(
    recorded_names: list[str], values: Any, names: tuple[str, ...], before: Array | None
) -> Array | None:
    """Return values in the scene's order of joints; `before` if joints are missing."""
    if sorted(recorded_names) != sorted(names) or len(values) != len(names):
        return before
    return np.array([values[list(recorded_names).index(name)] for name in names], np.float64)


def _list_changes(machine: RecordedMachine, tick: int) -> Iterator[str]:
    """Yield the changes by hand here, and the last one before."""
    for change in machine.changes.get(tick, ()):
        yield f"changed by hand at this tick: {KINDS.get(change.kind, change.kind)}"
    before = max((at for at in machine.changes if at < tick), default=None)
    if before is not None:
        kind = machine.changes[before][-1].kind
        t = before * machine.scene.servo_period
        yield f"changed by hand last at tick {before} ({t:g} s): {KINDS.get(kind, kind)}"


def _list_limits(
    scene: Scene, plant: Plant, measured: Measured, applied: Array, commanded: Array | None
) -> Iterator[str]:
    """Yield the limits that act on the motors now."""
    if not plant.powered:
        yield "the drives have no power"
    largest = scene.largest_commands
    closed, faults = getattr(measured, "brake_closed", None), getattr(measured, "faults", None)
    for j, (name, joint) in enumerate(zip(scene.joint_names, scene.joints, strict=True)):
        if commanded is not None and commanded[j] != applied[j] and plant.powered:
            yield (
                f"{name}: commanded {commanded[j]:g} {joint.unit}, the motor gets {applied[j]:g}"
            )
        elif abs(applied[j]) >= AT_LIMIT * largest[j]:
            yield f"{name}: at the largest command, {largest[j]:g} {joint.unit}"
        if closed is not None and joint.brake is not None and closed[j]:
            yield f"{name}: the brake is closed"
        if faults is not None and faults[j]:
            yield f"{name}: the drive reports faults, bits 0x{int(faults[j]):x}"
    for fault in scene.faults:
        value = plant.parameters[fault.varied.name]
        if value != 0.0:
            yield f"fault {fault.varied.name.removeprefix('faults.')}: {value:g}"


def _list_modes(scene: Scene, state: PlantState, terms: TermsNow) -> Iterator[str]:
    """Yield joints that stick, and those in their end stops."""
    dry = terms.link.get("dry friction")
    stops = terms.link.get("end stops")
    for j, name in enumerate(scene.joint_names):
        if dry is not None and state.v[j] == 0.0 and dry[j] != 0.0:
            yield f"{name}: sticks, its friction holds {-dry[j]:.4g}"
        if stops is not None and np.isfinite(stops[j]) and stops[j] != 0.0:
            yield f"{name}: in its end stop, which pushes with {stops[j]:.4g}"
