"""Coupled arms all through: sent on moves, on field buses, as a unit, identified, drawn.

For any motion of the shafts, the joints have the limits and carry the tool: both are looked at by
q = C p and Pinocchio's model of the bare chain, which knows nothing of couplings.
"""

import dataclasses
import struct
import xml.etree.ElementTree as ET
from pathlib import Path

import canopen_master
import numpy as np
import pinocchio as pin
import pytest
from cia402 import CSP, TARGET, enable, truth
from draws import FULL, some
from fmu_client import OK, Fmu, Instance
from test_rerun_stream import read

from arm_emulator import OfflineRun, Plant, Pose, Refusal, Scene, load_gains, load_scene
from arm_emulator.base.urdf.shafts import Shafts, read_shaft_limits
from arm_emulator.base.urdf.urdf_text import read_limits
from arm_emulator.design.new_scene import write_new
from arm_emulator.design.scene_text import STOPS_BEYOND, STOPS_BEYOND_OF_SLIDE
from arm_emulator.machine.parts.joint_effects.end_stops import EndStops
from arm_emulator.machine.plant.core_calls import ARM
from arm_emulator.motion.collision.collisions import Collisions
from arm_emulator.motion.executor.goal_status import GoalState
from arm_emulator.motion.executor.jog import make_joint_command, make_twist_command
from arm_emulator.motion.model.obstacles import Obstacle
from arm_emulator.motion.trajectory.joint_trajectory import TrajectoryPoint
from arm_emulator.runs.gains import Gains
from arm_emulator.toolchain.c_header import Library
from arm_emulator.view.rerun_batches import QUANTITIES
from arm_emulator.view.rerun_stream import RerunStream
from arm_emulator_fieldbus.canopen_node import CanFrame
from arm_emulator_fieldbus.canopen_segment import CanSegment
from arm_emulator_fieldbus.drives import Drives
from arm_emulator_fieldbus.drives_unit import CANOPEN
from arm_emulator_fmu.export import export
from arm_emulator_identification.link_regressor import compute_link_torques
from oracles.coupled_arms import (
    ARMS,
    GRAVITY,
    Lagrange,
    make_coupling_matrix,
    write_description,
    write_mimic,
)
from oracles.own_robots import RobotPart, write_serial

NS = 1_000_000_000
SWING = [RobotPart("0 1 0", (0.5, 0.0, 0.0)), RobotPart("0 1 0", (0.5, 0.0, 0.0))]
NAMES = some(["palletizer", "telescope", "bevel wrist", "differential"], 1)


class Machine:
    """A coupled arm as `new` makes it, and what its joints do."""

    def __init__(self, name: str, folder: Path) -> None:
        parts, shares = ARMS[name]
        if name == "telescope":  # with room to move in: the slides of ARMS keep each other at 0
            shares = {"j4": {"j3": 0.8}, "j5": {"j3": 0.4}}
        file = folder / "arm.urdf"
        text = write_description(name)
        if name == "telescope":
            text = write_mimic(write_serial("arm", parts), "j4", "j3", 0.8, 0.0)
            text = write_mimic(text, "j5", "j3", 0.4, 0.0)
        file.write_text(text)
        new_machine = write_new(file, folder / "new")
        self.scene, self.gains = load_scene(new_machine.file), load_gains(new_machine.file)
        self.truth = Lagrange(
            write_serial("arm", parts), make_coupling_matrix(parts, shares), np.zeros(len(parts))
        )
        robot = ET.fromstring(self.scene.urdf)
        self.limits = read_limits(robot)
        self.torque = np.array([drive.peak_torque for drive in new_machine.drives])
        self.speed = {
            joint.get("name"): float(limit.get("velocity", "0")) or np.inf
            for joint in robot.findall("joint")
            if (limit := joint.find("limit")) is not None
        }

    def tool(self, p: np.ndarray) -> pin.SE3:
        """Return the position of the tool, from the joints."""
        model, data = self.truth.model, self.truth.data
        pin.framesForwardKinematics(model, data, self.truth.C @ p)
        return data.oMf[model.getFrameId("tool0")].copy()

    def keeps_its_limits(self, q: np.ndarray, v: np.ndarray, torque: np.ndarray) -> None:
        """All joints, also those that no drive is called after; torques are those of shafts."""
        for k, name in enumerate(f"j{k + 1}" for k in range(len(self.truth.C))):
            low, high = self.limits.get(name, (-np.inf, np.inf))
            joint, rate = q @ self.truth.C[k], np.abs(v @ self.truth.C[k]).max()
            assert low - 1e-3 < joint.min() and joint.max() < high + 1e-3, name
            assert rate < 1.01 * self.speed.get(name, np.inf), (name, rate)
        assert (np.abs(torque).max(axis=0) < 1.02 * self.torque).all()


@pytest.fixture(scope="module", params=NAMES)
def machine(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Machine:
    return Machine(request.param, tmp_path_factory.mktemp("coupled"))


class Monitored(OfflineRun):
    """A run whose shafts are looked at every 5 ms."""

    def __init__(self, scene: Scene, gains: Gains) -> None:
        super().__init__(scene, gains.servo, gains.motion)
        self.rows: list[tuple[np.ndarray, ...]] = []

    def go(self, seconds: float) -> None:
        for _ in range(round(seconds / 0.005)):
            self.advance(5)
            state = self.session.state
            self.rows.append((state.q.copy(), state.v.copy(), state.gear_torque.copy()))

    @property
    def columns(self) -> tuple[np.ndarray, ...]:
        return tuple(np.array(rows) for rows in zip(*self.rows, strict=True))


def test_targets_trajectories_and_jogs_keep_the_joints_limits(machine: Machine) -> None:
    """Tool targets in a straight line, a trajectory from corner to corner, jogs of both kinds."""
    scene, motion = machine.scene, machine.gains.motion
    gains = dataclasses.replace(
        machine.gains, motion=dataclasses.replace(motion, jog_command_in_type="speed_units")
    )
    run = Monitored(scene, gains)
    kinematics, names = run.controller.kinematics, scene.joint_names
    low, high = np.maximum(kinematics.lower, -1.5), np.minimum(kinematics.upper, 1.5)
    draw = np.random.default_rng(4)
    run.advance(1000)
    for _ in range(3):
        goal = low + (high - low) * draw.uniform(0.1, 0.9, len(low))
        place = machine.tool(goal)
        run.instructor.add(run.session.logical_ns, Pose(place.translation, place.rotation))
        run.go(4.0)
        reached = machine.tool(run.session.state.q)
        assert np.linalg.norm(reached.translation - place.translation) < 1e-3
    run.go(0.5)
    corner = np.where(draw.random(len(low)) < 0.5, low, high)
    points = [
        TrajectoryPoint(seconds * NS, tuple(q.tolist()))
        for seconds, q in ((4, corner), (8, scene.start))
    ]
    run.instructor.add_trajectory(run.controller, names, points)
    run.go(9.0)
    assert run.instructor.reports.waiting[-1].state is GoalState.REACHED
    np.testing.assert_allclose(run.session.state.q, scene.start, atol=2e-3)
    before = machine.tool(run.session.state.q).translation
    along = make_twist_command(0, (0.0, 0.0, 0.05, 0.0, 0.0, 0.0), "", kinematics, gains.motion)
    for command in (along, make_joint_command(0, names[:1], (0.2,), kinematics, gains.motion)):
        for _ in range(100):
            run.instructor.take_jog(dataclasses.replace(command, time_ns=run.session.logical_ns))
            run.go(0.01)
        run.go(1.0)
    assert np.linalg.norm(machine.tool(run.session.state.q).translation - before) > 0.02
    machine.keeps_its_limits(*run.columns)


def test_position_limits_of_drives_keep_the_joints_within_theirs(machine: Machine) -> None:
    """The software limits of CiA 402."""
    scene, C = machine.scene, machine.truth.C
    drives = Drives(Plant(scene), machine.gains.servo, CANOPEN)
    per_count = 2.0 * np.pi * scene.gear_ratios / [joint.counts_per_turn for joint in scene.joints]
    N = len(scene.joints)
    ends = np.array([[drives.read(j, 0x607D, sub) for j in range(N)] for sub in (1, 2)])
    shafts = ends * per_count
    named = read_shaft_limits(scene.urdf, scene.joint_names)
    for j, name in enumerate(scene.joint_names):
        if name in named:
            np.testing.assert_allclose(shafts[:, j], named[name], atol=2.0 * abs(per_count[j]))
    for joint, link in zip(scene.joints, scene.chain.joints, strict=True):
        for part in joint.parts:
            if isinstance(part, EndStops):
                lower, upper = named[joint.name]
                slide = link.kind == "prismatic"
                beyond = STOPS_BEYOND_OF_SLIDE if slide else STOPS_BEYOND
                stops = lower - beyond, upper + beyond
                assert (part.lower, part.upper) == pytest.approx(stops)
    for k, name in enumerate(f"j{k + 1}" for k in range(len(C))):
        low, high = machine.limits.get(name, (-np.inf, np.inf))
        up, down = np.maximum(C[k], 0.0), np.minimum(C[k], 0.0)
        assert up @ shafts[0] + down @ shafts[1] > low - 1e-6, name
        assert up @ shafts[1] + down @ shafts[0] < high + 1e-6, name


def test_targets_of_drives_are_those_of_shafts(machine: Machine) -> None:
    """Cyclic positions over a field bus, in counts of the motors: each shaft goes where its drive
    is sent, 0.1 rad or m, at most to its software limit, and no other shaft with it. Links are
    seen behind gears that the weight winds up by 0.01.
    """
    scene = machine.scene
    drives = Drives(Plant(scene), machine.gains.servo, CANOPEN)
    per_count = 2.0 * np.pi * scene.gear_ratios / [joint.counts_per_turn for joint in scene.joints]
    joints = range(len(scene.joints))
    enable(drives, CSP)
    drives.period(500)
    begun = np.array([drives.read(j, TARGET) for j in joints])
    assert begun * per_count == pytest.approx(truth(drives, "q"), abs=0.02)
    for j in joints:
        drives.write(j, 0x6065, 0xFFFFFFFF)  # no following error
        before = truth(drives, "q")
        limit = drives.read(j, 0x607D, 2 if per_count[j] > 0 else 1)
        goal = begun[j] + round(0.1 / per_count[j])
        for k in range(1, 401):
            drives.write(j, TARGET, begun[j] + round(0.1 * k / 400 / per_count[j]))
            drives.period()
        drives.period(600)
        reached = min(goal, limit) if per_count[j] > 0 else max(goal, limit)
        assert truth(drives, "q")[j] == pytest.approx(reached * per_count[j], abs=0.02)
        assert np.abs(np.delete(truth(drives, "q") - before, j)).max() < 0.02


def test_a_master_leads_all_shafts_at_once_by_frames(machine: Machine) -> None:
    """CANopen, cyclic positions by PDOs: counts are the motors', the links go by the matrix.

    Positions, speeds and torques that come back are those of the shafts' drives.
    """
    scene, rng = machine.scene, np.random.default_rng(4)
    drives = Drives(Plant(scene), machine.gains.servo, CANOPEN)
    segment = CanSegment(drives, 1)
    segment.boot_nodes()
    canopen_master.enable(segment, CSP)
    N = len(scene.joints)
    per_count = 2.0 * np.pi * scene.gear_ratios / [joint.counts_per_turn for joint in scene.joints]
    begun = np.array([drives.read(j, 0x6064) for j in range(N)])
    ends = np.sort([[drives.read(j, 0x607D, sub) for j in range(N)] for sub in (1, 2)], axis=0)
    travel = np.clip(begun + rng.choice([-0.06, 0.06], N) / per_count, *ends) - begun
    before, tool = truth(drives, "q"), machine.tool(truth(drives, "q"))
    actual = np.zeros(N)
    for k in range(900):
        part = min(k / 600.0, 1.0)
        goal = begun + np.rint(travel * part**3 * (10.0 - 15.0 * part + 6.0 * part**2)).astype(int)
        for j, target in enumerate(goal.tolist()):
            segment.receive_frame(CanFrame(0x301 + j, struct.pack("<Hi", 15, target)))
        frames = segment.receive_frame(canopen_master.SYNC)
        (rows,) = zip(*(canopen_master.sent(frames, 0x281 + j) for j in range(N)), strict=True)
        status, actual = np.array([struct.unpack("<Hi", row) for row in rows]).T
        assert (status & 0x6F == 0x27).all(), "Operation enabled"
        assert np.abs((actual - goal) * per_count).max() < 0.05
    moved = truth(drives, "q") - before
    np.testing.assert_allclose(actual * per_count, truth(drives, "q"), atol=0.02)  # wind-up
    np.testing.assert_allclose(moved, travel * per_count, atol=0.02)
    assert np.linalg.norm(machine.tool(before + moved).translation - tool.translation) > 0.005
    torques = np.array([drives.read(j, 0x6077) for j in range(N)])
    assert (np.abs(torques) < 1000).all() and torques.any(), "parts in a thousand of rated torque"


def test_numbers_of_its_links_explain_the_torques_that_its_gears_carry(machine: Machine) -> None:
    """The torque model of `identify` agrees with the independent solution."""
    draw, C = np.random.default_rng(6), machine.truth.C
    v, a = (draw.normal(size=(20, C.shape[1])) * size for size in (1.0, 2.0))
    q = machine.scene.start + draw.uniform(-0.05, 0.05, v.shape)  # off the stops
    scene = dataclasses.replace(machine.scene, gravity=GRAVITY)
    viscous = [getattr(joint.friction, "viscous", 0.0) for joint in scene.joints]
    torques = compute_link_torques(scene, np.arange(20.0), q, v, a) - v * viscous
    for k in range(20):
        accelerations = machine.truth.compute_accelerations(q[k], v[k], torques[k])
        np.testing.assert_allclose(accelerations, a[k], rtol=1e-9, atol=1e-9)


def test_the_picture_shows_the_joints(machine: Machine, tmp_path: Path) -> None:
    """Transforms and the tool's path in a recording of Rerun are those of all joints."""
    scene = machine.scene
    stream = RerunStream(
        scene.urdf, scene.joint_names, tool=scene.tool, file=tmp_path / "a.rrd", arm_rate=50
    )
    q = scene.start + np.linspace(0.0, 0.3, 30)[:, None]
    none = np.full(len(scene.joints), np.nan)
    for k, row in enumerate(q):
        stream.show_state(k * NS // 50, row, *[none] * (len(QUANTITIES) - 1))
    assert stream.close() and stream.trouble is None
    strips = read(tmp_path / "a.rrd", "/tool/path", "LineStrips3D:strips")[1]
    expected = [machine.tool(row).translation for row in q]
    np.testing.assert_allclose(strips[:, 1], expected[1:], atol=1e-6)


def test_joints_that_follow_touch_obstacles() -> None:
    """A second link that keeps its direction in the world: its ball stays level with its elbow."""
    robot = ET.fromstring(write_serial("arm", SWING))
    for joint in robot.findall("joint"):
        if joint.get("name") == "j2":
            ET.SubElement(joint, "coupling", joint="j1", multiplier="-1.0")
        limit = joint.find("limit")
        if limit is not None:
            limit.attrib |= {"effort": "1", "velocity": "1"}
    for link in robot.findall("link"):
        if link.get("name") == "l2":
            ball = ET.SubElement(link, "collision")
            ET.SubElement(ball, "origin", xyz="0.5 0 0")
            ET.SubElement(ET.SubElement(ball, "geometry"), "sphere", radius="0.05")
    text = ET.tostring(robot, encoding="unicode")
    for angle in np.linspace(-1.5, 1.5, 31):
        lowest = 0.1 - 0.5 * np.sin(angle) - 0.05
        for height in (lowest - 0.02, lowest):
            collisions = Collisions(text, ("j1",), [Obstacle("floor", height)], 0.01)
            assert bool(collisions.find_first_contact(np.array([angle]))) == (
                height > lowest - 0.01
            )


@pytest.mark.skipif(not FULL, reason="a unit is compiled for it: make test-in-full")
def test_a_unit_moves_as_the_machine(machine: Machine, tmp_path: Path) -> None:
    export(machine.scene, tmp_path / "arm.fmu", "native")
    fmu = Fmu(tmp_path / "arm.fmu", tmp_path / "unpacked")
    instance, plant = Instance(fmu), Plant(machine.scene, core=Library(fmu.binary._name, (ARM,)))
    instance.start()
    draw = np.random.default_rng(2)
    for _ in range(20):
        u = draw.normal(0.0, 5.0, len(machine.scene.joints))
        assert instance.set("command", u) == OK
        instance.step(machine.scene.servo_period)
        plant.exchange(u)
        np.testing.assert_array_equal(instance.get("truth.q"), plant.state.q)
        np.testing.assert_array_equal(instance.get("encoder_counts"), plant.measured.encoder_counts)


@pytest.mark.parametrize(
    ("multiplier", "offset"), [(1.0, 2.0), (1.0, -0.9), (-1.0, -0.2), (0.5, 0.5)]
)
def test_limits_that_couplings_cannot_keep_are_refused(multiplier: float, offset: float) -> None:
    """The leader goes from 0 to 0.6 m, the follower from 0 to 0.4 m."""
    text = write_mimic(write_serial("arm", ARMS["telescope"][0]), "j4", "j3", multiplier, offset)
    shafts = Shafts(text, ("j1", "j2", "j3"), "tool0")
    ends = [read_limits(ET.fromstring(text)).get(name, (-9.0, 9.0)) for name in shafts.joints]
    with pytest.raises(Refusal, match=r"joint j[34] must have limits that its couplings can keep"):
        shafts.bound_positions(*np.array(ends).T)
