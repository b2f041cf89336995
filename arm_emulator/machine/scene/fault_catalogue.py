"""Numbers of a scene that may be varied, and faults that it may have."""

from collections.abc import Collection

from arm_emulator.machine.chain import Chain
from arm_emulator.machine.faults.scene_faults import SceneFault, list_scene_faults
from arm_emulator.machine.parts.line import list_line_numbers
from arm_emulator.machine.parts.measuring.imu import Imu
from arm_emulator.machine.scene.joint import Joint
from arm_emulator.machine.varied import Varied, vary_body


def list_variable_numbers(
    joints: tuple[Joint, ...], chain: Chain, imus: tuple[Imu, ...]
) -> list[Varied]:
    """Return the numbers of joints, measurement units and links that may be varied."""
    of_joints = [
        number
        for joint in joints
        for part in (*joint.parts, *joint.sensors.parts.values())
        for number in part.list_variable_numbers(joint.name)
    ]
    of_imus = [number for imu in imus for number in imu.list_variable_numbers()]
    of_links = [number for link in chain.bodies.values() for number in vary_body(link)]
    return of_joints + of_imus + of_links


def list_faults(
    joints: tuple[Joint, ...],
    chain: Chain,
    imus: tuple[Imu, ...],
    payload: float | None,
    gravity: tuple[float, ...] | None,
    varied: Collection[str],
) -> dict[str, SceneFault]:
    """Return the faults that a scene could list, by their names.

    Args:
        joints: of the scene.
        chain: its links.
        imus: its measurement units.
        payload: mass of the payload [kg]; None: there is no payload.
        gravity: of the scene [m/s2]; None: there is no gravity.
        varied: names of the numbers that it lists as varied.
    """
    # Only where they are asked for: most scenes have none and are loaded in less time.
    from arm_emulator.machine.faults.known import FAULTS

    parts = [
        *((joint.name, part) for joint in joints
          for part in (*joint.parts, *joint.sensors.parts.values())),
        *((imu.name, part) for imu in imus for part in imu.parts),
    ]  # fmt: skip
    hidden = {
        f"joints.{joint.name}.{joint.motor.section}.{decorator.hides}"
        for joint in joints if joint.motor for decorator in joint.decorators if decorator.hides
    }  # fmt: skip
    hidden |= {
        f"joints.{joint.name}.{place}"
        for joint in joints if joint.motor for place in joint.motor.hides
    }  # fmt: skip
    numbers = {
        place: value
        for name, part in parts
        for key, value in part.list_fault_numbers().items()
        if (place := f"{part.owners}.{name}.{part.section}.{key}") not in hidden
    }
    bodies = chain.bodies.values()
    numbers |= {number.name: number.value for link in bodies for number in vary_body(link)}
    numbers |= list_line_numbers({joint.name: joint.motor is not None for joint in joints})
    if any(joint.motor and joint.motor.has_winding for joint in joints):
        numbers["supply.share"] = 1.0
    if gravity is not None:
        numbers["base.tilt"] = 0.0
    if payload is not None:
        numbers["payload.mass"] = payload
    owners = {
        "joints": [joint.name for joint in joints],
        "links": [link.link for link in bodies],
        "imus": [imu.name for imu in imus],
    }
    return list_scene_faults(FAULTS, owners, numbers, varied)
