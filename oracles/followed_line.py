"""Distance of the true tool from its reference on a fast line, with and without feed-forward.

The whole machine follows a line of the tool. Servo and motion controller know its gears, friction
and inertia right, wrong, or not at all. The truth is the emulated machine's own state. The
reference is the servo's target less the wind-up by which its motor leads.

Encoders at the motors measure the motors. Wrong numbers of stiffness, inertia and friction send the
motors to wrong places, by the difference between assumed and true wind-up; a servo that put every
motor exactly there would leave the tool off by that, at rest as well. `unseen` is this part.
"""

from __future__ import annotations

import dataclasses
import xml.etree.ElementTree as ET
from dataclasses import dataclass

import numpy as np

from arm_emulator import OfflineRun, Pose, Scene, load_gains, load_scene
from arm_emulator.base.arrays import Array
from arm_emulator.base.io.config_files import find_scene
from arm_emulator.design.new_scene import list_drive_parameters
from arm_emulator.motion.model.elastic_arm import ElasticArm
from arm_emulator.motion.model.link_torques import LinkTorques
from arm_emulator.motion.planner.tool_controller import make_controller

SETTLE = 5.0  # s, before the line begins: the integrals of heavy arms take 1 s
PRACTICE = 4.0  # s, for the line there and back
REST = 0.5  # s, after it ends
PATIENCE = 20.0  # s, of all of it


@dataclass(frozen=True)
class AssumedNumbers:
    """Assumed numbers of servo and motion controller, relative to the true ones."""

    feedforward: str
    stiffness: float = 1.0
    friction: float = 1.0
    inertia: float = 1.0
    """Factor of the inertias of links and rotors."""


@dataclass(frozen=True)
class ToolLine:
    """Line of the tool."""

    length: float = 0.3  # m
    speed: float = 1.0  # m/s
    acceleration: float = 6.0  # m/s2
    jerk: float = 80.0  # m/s3
    along: tuple[float, float, float] = (0.0, 1.0, 0.0)


@dataclass(frozen=True, eq=False)
class Followed:
    """Outcome of a line."""

    t: Array
    """Times (K,) [s]."""
    place: Array
    """Place of the reference along the line (K,) [m]."""
    deviation: Array
    """Deviation of the true tool from its reference (K, 3) [m]; first column: along the line."""

    astray: Array
    """Distance of the tool if every motor were where it is sent (K,) [m]."""

    @property
    def unseen(self) -> float:
        """Largest distance that no encoder at a motor can see [m]."""
        return float(self.astray.max())

    @property
    def off(self) -> float:
        """Largest distance of the tool from its reference [m]."""
        return float(np.linalg.norm(self.deviation, axis=1).max())

    @property
    def behind(self) -> float:
        """Largest part of it that is behind or ahead along the line [m]."""
        return float(np.abs(self.deviation[:, 0]).max())

    @property
    def past(self) -> float:
        """Overshoot of the tool past the farthest point of its reference [m]."""
        return float((self.place + self.deviation[:, 0]).max() - self.place.max())

    @property
    def peak_speed(self) -> float:
        """Largest speed of the reference [m/s]."""
        return float(np.gradient(self.place, self.t).max())


def follow_line(
    scene_name: str,
    assumed: AssumedNumbers,
    line: ToolLine | None = None,
    *,
    practised: bool = False,
) -> Followed:
    """Send a scene's tool along a line; where the scene starts the line begins.

    Args:
        scene_name: the machine.
        assumed: numbers that servo and motion controller assume.
        line: of the tool.
        practised: whether the tool goes there and back first, from which the servo learns.
    """
    line = line or ToolLine()
    file = find_scene(scene_name)
    scene, gains = load_scene(file), load_gains(file)
    motion = dataclasses.replace(
        gains.motion,
        feedforward=assumed.feedforward,
        drives={
            name: dataclasses.replace(
                drive,
                stiffness=assumed.stiffness * drive.stiffness,
                cubic_stiffness=assumed.stiffness * drive.cubic_stiffness,
                viscous=assumed.friction * drive.viscous,
                coulomb=assumed.friction * drive.coulomb,
            )
            for name, drive in list_drive_parameters(scene.joints).items()
        },
        tool_path_tolerance=0.0,  # a path that is followed badly is measured to its end
        tool_speed=line.speed,
        tool_acceleration=line.acceleration,
        tool_jerk=line.jerk,
    )
    joints = tuple(
        dataclasses.replace(joint, rotor_inertia=assumed.inertia * joint.rotor_inertia)
        for joint in gains.servo.joints
    )
    run = OfflineRun(scene, dataclasses.replace(gains.servo, joints=joints), motion)
    names = run.controller.kinematics.joint_names
    run.controller = make_controller(_scale_inertia(scene.urdf, assumed.inertia), names, motion)
    kinematics, along = run.controller.kinematics, np.array(line.along)
    run.advance(round(SETTLE / scene.servo_period))
    R_WT, start = kinematics.forward(_read_reference(run))
    ends = Pose(start, R_WT), Pose(start + line.length * along, R_WT)
    if practised:
        run.instructor.add_path(run.controller, (*ends, ends[0]))
        run.advance(round(PRACTICE / scene.servo_period))
    run.instructor.add_path(run.controller, ends)
    times: list[float] = []
    places: list[float] = []
    deviations, references, wind_ups = [], [], []
    latest, rests = round(PATIENCE / motion.period), round(REST / motion.period)
    frame = np.linalg.qr(np.column_stack([along, np.eye(3)]))[0]
    frame[:, 0] = along
    while len(times) < latest and (rests := rests - _is_at_end(places, line)) >= 0:
        tool = kinematics.forward(run.session.state.q)[1]
        times.append(run.session.logical_ns * 1e-9)
        run.advance(run.motion_ticks)
        references.append(_read_reference(run))
        wind_ups.append(run.wind_up)
        reference = kinematics.forward(references[-1])[1]
        places.append(float((reference - start) @ along))
        deviations.append((tool - reference) @ frame)
    ahead = np.array(wind_ups) - _compute_wind_up(scene, np.array(references), motion.period)
    astray = [
        np.linalg.norm(kinematics.forward(q + off)[1] - kinematics.forward(q)[1])
        for q, off in zip(references, ahead, strict=True)
    ]
    return Followed(np.array(times), np.array(places), np.array(deviations), np.array(astray))


def _is_at_end(places: list[float], line: ToolLine) -> bool:
    """Return whether the reference has come to the end of the line."""
    return bool(places) and places[-1] > line.length - 1e-6


def _compute_wind_up(scene: Scene, q: Array, period: float) -> Array:
    """Return by how much the scene's own gears are wound up along a motion of the links (K, N)."""
    drives = list_drive_parameters(scene.joints)
    arm = ElasticArm(
        LinkTorques(scene.urdf, scene.joint_names, scene.gravity or (0.0, 0.0, 0.0)),
        [drives[name] for name in scene.joint_names],
        np.full(len(scene.joints), np.inf),
    )
    v = np.gradient(q, period, axis=0)
    a = np.gradient(v, period, axis=0)
    still = np.zeros(q.shape[1])
    rows = zip(q, v, a, strict=True)
    return np.array([arm.compute_drive(*row, still).theta - row[0] for row in rows])


def _read_reference(run: OfflineRun) -> Array:
    """Return the angles of the links that the servo was asked for last (N,)."""
    target: Array = run.drives.servo.state["q_target"] - run.wind_up
    return target


def _scale_inertia(urdf: str, part: float) -> str:
    """Return a robot description whose links have a part of their mass and inertia."""
    robot = ET.fromstring(urdf)
    for inertial in robot.iter("inertial"):
        for tag in ("mass", "inertia"):
            for element in inertial.findall(tag):
                element.attrib.update(
                    {key: repr(part * float(value)) for key, value in element.attrib.items()}
                )
    return ET.tostring(robot, encoding="unicode")
