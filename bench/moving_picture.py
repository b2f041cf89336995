"""The moving picture of README.md: a UR5 leads its tool along a square, as the viewer shows it.

The target in it is the reference: where the tool shall be at that moment. Machine, servo and motion
control run in one process. The recording begins and ends with the tool at rest in the same corner,
so that the picture repeats without a jump.
"""

from __future__ import annotations

import io
from pathlib import Path

import numpy as np
from PIL import Image

from arm_emulator.machine.urdf_file import example_robot_data
from arm_emulator.motion.pose import Pose
from arm_emulator.runs.offline import load_offline_run
from arm_emulator.view.film import take_screenshots, write_gif
from arm_emulator.view.rerun_stream import RerunStream

SCENE = "ur5"
SIDE = 0.3  # m, of the square across which the tool goes
EVERY = 10  # servo periods between samples
FRAMES = 40
SIZE = (960, 540)  # points
SHOWN = (0, 37, 960, 510)  # of these, without menu and time line
_SETTLING = 3.0  # s, for the way to the first corner


def record(rrd: Path) -> tuple[float, float]:
    """Write a recording of the run; return begin and end of the round [s]."""
    one = load_offline_run(SCENE)
    scene, kinematics = one.session.scene, one.controller.kinematics
    robots = example_robot_data()
    stream = RerunStream(
        scene.urdf,
        scene.joint_names,
        q_start=scene.start,
        tool=scene.tool,
        package_dirs=[robots.parents[1]] if robots else [],
        file=rrd,
    )
    R_WT, p_WT = kinematics.forward(scene.start)
    y, z = np.array([0.0, SIDE, 0.0]), np.array([0.0, 0.0, SIDE])
    corners = [Pose(p_WT - 0.5 * y + at, R_WT) for at in (0.0 * y, y, y + z, z, 0.0 * y)]
    one.instructor.add_path(one.controller, corners[:1])
    one.advance(round(_SETTLING / scene.servo_period))
    begin = one.session.logical_ns
    one.instructor.add_path(one.controller, corners)
    while one.instructor.reports.waiting[-1].state.name in ("ACCEPTED", "MOVING"):
        one.advance(EVERY)
        state = one.session.state
        sensed = one.session.measured
        reference = one.controller.coming
        assert reference is not None, "a way is planned"
        stream.offer_target(one.session.logical_ns, kinematics.forward(reference.q)[1].tolist())
        stream.offer(
            one.session.logical_ns,
            state.q,
            state.v,
            state.gear_torque,
            sensed.current,
            sensed.applied,
            one.drives.servo.q_measured,
        )
    end = one.session.logical_ns
    stream.close(60.0)
    return begin * 1e-9, end * 1e-9


def picture(out: Path) -> Path:
    """Draw the picture into a folder and return its file."""
    begin, end = record(out / "square.rrd")
    moments = np.linspace(begin, end, FRAMES, endpoint=False) + 0.5 * (end - begin) / FRAMES
    shots = take_screenshots(out / "square.rrd", moments.tolist(), size=SIZE, patience=600.0)
    pictures = [Image.open(io.BytesIO(shot)).convert("RGB").crop(SHOWN) for shot in shots]
    write_gif(pictures, out / "arm.gif", FRAMES / (end - begin))
    return out / "arm.gif"
