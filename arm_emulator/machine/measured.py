"""What the drive electronics measured at one tick."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from arm_emulator.machine.chain import Array
from arm_emulator.machine.core_calls import IMU_MEASUREMENT, JOINT_MEASUREMENT, JOINT_SENSORS
from arm_emulator.machine.scene import Scene

Counts = NDArray[np.int64]

# What further sensors tell, as MotorState has it, with the kind of its array.
MORE_SENSORS = {
    "brake_closed": "q",
    "index_counts": "q",
    "index_pulses": "q",
    "link_encoder_counts": "q",
    "link_index_counts": "q",
    "link_index_pulses": "q",
    "torque": "d",
    "specific_force": "d",
    "angular_rate": "d",
}


def told_by(scene: Scene) -> list[str]:
    """Return the names in MORE_SENSORS of what some sensor of a scene tells."""
    joints = [joint.sensors for joint in scene.joints]
    link = [one.link_encoder for one in joints if one.link_encoder is not None]
    there = {
        "brake": any(joint.brake for joint in scene.joints),
        "index": any(one.encoder is not None and one.encoder.index != "none" for one in joints),
        "link_encoder": bool(link),
        "link_index": any(one.index != "none" for one in link),
        "torque": any(one.torque is not None for one in joints),
        "specific_force": bool(scene.imus),
        "angular_rate": bool(scene.imus),
    }
    return [
        name
        for name in MORE_SENSORS
        if there[name.removesuffix("_counts").removesuffix("_pulses").removesuffix("_closed")]
    ]


@dataclass(frozen=True)
class Measured:
    """What sensors told at one tick. Arrays are (N,), base to tool; 0 where a joint has no such.

    Args:
        joints: array of JOINT_MEASUREMENT.
        sensors: array of JOINT_SENSORS.
        imus: array of IMU_MEASUREMENT.
    """

    joints: NDArray[np.void]
    sensors: NDArray[np.void]
    imus: NDArray[np.void]

    @property
    def encoder_counts(self) -> Counts:
        """Of the encoders at the motors."""
        return self.joints["encoder"]

    @property
    def current(self) -> Array:
        """By the current sensors [A]."""
        return self.joints["current"]

    @property
    def voltage(self) -> Array:
        """Applied in the servo period that ends here [V]."""
        return self.joints["voltage"]

    @property
    def brake_closed(self) -> Counts:
        """1 where a brake is closed."""
        return self.joints["brake"].astype(np.int64)

    @property
    def index_counts(self) -> Counts:
        """Counts of the encoders at the motors when their newest index pulses came."""
        return self.sensors["index"]

    @property
    def index_pulses(self) -> Counts:
        """How many have come since the reset."""
        return self.sensors["index_pulses"]

    @property
    def link_encoder_counts(self) -> Counts:
        """Of the encoders at the links."""
        return self.sensors["link_encoder"]

    @property
    def link_index_counts(self) -> Counts:
        """As `index_counts`, at the links."""
        return self.sensors["link_index"]

    @property
    def link_index_pulses(self) -> Counts:
        """As `index_pulses`, at the links."""
        return self.sensors["link_index_pulses"]

    @property
    def torque(self) -> Array:
        """Of the gears on their links, by the torque sensors [N m or N]."""
        return self.sensors["torque"]

    @property
    def specific_force(self) -> Array:
        """By the IMUs of the scene, (M, 3), in their frames [m/s2]."""
        return self.imus["specific_force"]

    @property
    def angular_rate(self) -> Array:
        """By the IMUs of the scene, (M, 3), in their frames [rad/s]."""
        return self.imus["angular_rate"]


class MeasuredPlace:
    """Where the core writes what was measured.

    Attributes:
        addresses: of the arrays, by their names in ``arm_measurement``.
    """

    def __init__(self, scene: Scene) -> None:
        N = len(scene.joints)
        self.joints = np.zeros(N, JOINT_MEASUREMENT)
        self._sensors = np.zeros(N, JOINT_SENSORS)
        self._imus = np.zeros(len(scene.imus), IMU_MEASUREMENT)
        arrays = {"joint": self.joints, "sensors": self._sensors, "imu": self._imus}
        self.addresses = {name: array.ctypes.data for name, array in arrays.items()}

    def read(self) -> Measured:
        """Return what is there now, as a copy."""
        return Measured(self.joints.copy(), self._sensors.copy(), self._imus.copy())
