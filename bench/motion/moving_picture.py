"""The moving picture of README.md: a UR5 leads its tool along a square, as the viewer shows it.

The target in it is the reference: where the tool shall be at that moment. Machine, servo and motion
control run in one process. The recording begins and ends with the tool at rest in the same corner,
so that the picture repeats without a jump.
"""

from __future__ import annotations

import contextlib
import io
import os
import socket
import subprocess
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from arm_emulator.machine.scene.urdf_file import find_example_robot_data
from arm_emulator.motion.model.pose import Pose
from arm_emulator.runs.offline import load_offline_run
from arm_emulator.view.rerun_stream import RerunStream

SCENE = "ur5"
SIDE = 0.3  # m, of the square across which the tool goes
EVERY = 10  # servo periods between samples
FRAMES = 40
SIZE = (960, 540)  # points
CROP = (0, 37, 960, 510)  # of these, without menu and time line
COLOURS = 96  # of the .gif
POLL = 0.1  # s
# Pictures until the viewer shows a moment as a whole: it draws meshes and curves some pictures
# later, and its words of welcome cover a part of the window for 1 to 3 s.
SETTLE_FIRST, SETTLE_NEXT = 8, 2
_SETTLING = 3.0  # s, for the way to the first corner


def record_run(rrd: Path) -> tuple[float, float]:
    """Write a recording of the run; return begin and end of the round [s]."""
    offline_run = load_offline_run(SCENE)
    scene, kinematics = offline_run.session.scene, offline_run.controller.kinematics
    robots = find_example_robot_data()
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
    offline_run.instructor.add_path(offline_run.controller, corners[:1])
    offline_run.advance(round(_SETTLING / scene.servo_period))
    begin = offline_run.session.logical_ns
    offline_run.instructor.add_path(offline_run.controller, corners)
    while offline_run.instructor.reports.waiting[-1].state.name in ("ACCEPTED", "MOVING"):
        offline_run.advance(EVERY)
        state = offline_run.session.state
        sensed = offline_run.session.measured
        reference = offline_run.controller.coming
        assert reference is not None, "a way is planned"
        stream.offer_target(
            offline_run.session.logical_ns, kinematics.forward(reference.q)[1].tolist()
        )
        stream.show_state(
            offline_run.session.logical_ns,
            state.q,
            state.v,
            state.gear_torque,
            sensed.current,
            sensed.applied,
            offline_run.drives.servo.q_measured,
        )
    end = offline_run.session.logical_ns
    stream.close(60.0)
    return begin * 1e-9, end * 1e-9


def draw_picture(out: Path) -> Path:
    """Draw the picture into a folder and return its file."""
    begin, end = record_run(out / "square.rrd")
    moments = np.linspace(begin, end, FRAMES, endpoint=False) + 0.5 * (end - begin) / FRAMES
    pictures = [
        frame.crop(CROP) for frame in take_screenshots(out / "square.rrd", moments.tolist())
    ]
    palette = pictures[FRAMES // 2].quantize(COLOURS)
    frames = [frame.quantize(palette=palette, dither=Image.Dither.NONE) for frame in pictures]
    each = round(1e3 * (end - begin) / FRAMES)
    frames[0].save(
        out / "arm.gif",
        save_all=True,
        append_images=frames[1:],
        duration=each,
        loop=0,
        optimize=True,
    )
    return out / "arm.gif"


def take_screenshots(rrd: Path, moments: Sequence[float]) -> Iterator[Image.Image]:
    """Yield what a viewer without a screen shows at each moment [s]; it needs a Vulkan driver."""
    with _start_viewer(rrd) as viewer:
        while viewer.get_state().loading:
            time.sleep(POLL)
        for number, at in enumerate(moments):
            viewer.set_time("t", duration=at, play_state="paused")
            for _ in range(SETTLE_FIRST if number == 0 else SETTLE_NEXT):
                viewer.take_screenshot()
                time.sleep(5.0 * POLL)
            yield Image.open(io.BytesIO(viewer.take_screenshot())).convert("RGB")


@contextlib.contextmanager
def _start_viewer(rrd: Path) -> Iterator[Any]:
    import rerun_cli  # type: ignore[import-untyped]
    from rerun.experimental import ViewerClient

    # The program itself: its Python wrapper, when ended, would leave it running.
    program = next(f for f in Path(rerun_cli.__file__).parent.iterdir() if f.stem == "rerun")
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    words = ["--headless", "--hide-welcome-screen", "--bind", "127.0.0.1", "--port", str(port),
             "--window-size", "x".join(map(str, SIZE)), str(rrd)]  # fmt: skip
    quiet = os.environ | {"RERUN_APP_ONLY": "true"}  # no questions about analytics
    process = subprocess.Popen([str(program), *words], env=quiet, stderr=subprocess.DEVNULL)
    try:
        while process.poll() is None:
            with contextlib.suppress(Exception):  # not listening yet
                client = ViewerClient.connect(f"rerun+http://127.0.0.1:{port}/proxy")
                client.get_state()
                break
            time.sleep(POLL)
        yield client
    finally:
        process.kill()
        process.wait()
