"""The Rerun stream writes what it was offered, and no failure of Rerun reaches the emulator."""

import contextlib
import importlib.util
import os
import random
import signal
import socket
import subprocess
import sys
import threading
import time
import warnings
from pathlib import Path

import numpy as np
import pinocchio as pin
import psutil
import pytest

from arm_emulator.base.refusal import Refusal
from arm_emulator.view.rerun_batches import QUANTITIES
from arm_emulator.view.rerun_stream import RerunStream

NAMES = ("turn", "lift", "swing")
MS = 1_000_000  # ns

# A base turned against the world, a slide, oblique axes, fixed joints between and at the end.
URDF = """<robot name="odd_arm">
  <link name="world"/> <link name="base"/> <link name="a"/> <link name="a_plate"/>
  <link name="b"/> <link name="c"/> <link name="tool"/>
  <joint name="base_mount" type="fixed"><parent link="world"/><child link="base"/>
    <origin xyz="0.1 -0.2 0.3" rpy="0.1 0.2 0.3"/></joint>
  <joint name="turn" type="revolute"><parent link="base"/><child link="a"/>
    <origin xyz="0 0 0.3" rpy="0.3 0 0.5"/><axis xyz="0 0.6 0.8"/>
    <limit lower="-0.1" upper="0.1" effort="1" velocity="1"/></joint>
  <joint name="plate" type="fixed"><parent link="a"/><child link="a_plate"/>
    <origin xyz="0.05 0 0" rpy="0 0.4 0"/></joint>
  <joint name="lift" type="prismatic"><parent link="a_plate"/><child link="b"/>
    <origin xyz="0 0.1 0.1"/><axis xyz="0 0 1"/>
    <limit lower="-1" upper="1" effort="1" velocity="1"/></joint>
  <joint name="swing" type="continuous"><parent link="b"/><child link="c"/>
    <origin xyz="0.2 0 0" rpy="0 0 1"/><axis xyz="1 0 0"/></joint>
  <joint name="tool_mount" type="fixed"><parent link="c"/><child link="tool"/>
    <origin xyz="0 0.1 0.3" rpy="0 1 0"/></joint>
</robot>"""


class Oracle:
    """The same arm by Pinocchio."""

    def __init__(self):
        self.model = pin.buildModelFromXML(URDF)
        self.data = self.model.createData()
        self.tool = self.model.getFrameId("tool")

    def place(self, q):
        """Move the arm. A continuous joint's configuration is its cosine and sine."""
        full = np.array([q[0], q[1], np.cos(q[2]), np.sin(q[2])])
        pin.framesForwardKinematics(self.model, self.data, full)

    def p_WT(self, q):
        self.place(q)
        return self.data.oMf[self.tool].translation.copy()

    def in_parent_link(self, joint, q):
        """The child link's frame in the URDF's parent link, as a homogeneous matrix."""
        self.place(q)
        frames = self.model.frames
        child = {"turn": "a", "lift": "b", "swing": "c"}[joint]
        parent = {"turn": "base", "lift": "a_plate", "swing": "b"}[joint]
        assert frames[self.model.getFrameId(child)].name == child
        oMf = self.data.oMf
        at = oMf[self.model.getFrameId(parent)].inverse() * oMf[self.model.getFrameId(child)]
        return at.homogeneous


@pytest.fixture
def oracle():
    return Oracle()


def samples(count, seed=3):
    """Made-up samples: times every millisecond [ns], rows (count, quantities, N)."""
    rng = np.random.default_rng(seed)
    return np.arange(count) * MS, rng.normal(size=(count, len(QUANTITIES), len(NAMES)))


def read(file, path, component):
    """Return times [ns] and values of an entity's component, in the order of time."""
    from rerun.chunk import RrdReader

    times, values = [], []
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # a file without its end is reported so by a warning
        stream = RrdReader(file).stream()
    for chunk in stream.filter(content=path, is_static=False):
        batch = chunk.to_record_batch()
        if component in batch.schema.names:
            times += batch.column("t").cast("int64").to_pylist()
            values += batch.column(component).to_pylist()
    order = np.argsort(times, kind="stable")
    return np.array(times)[order], np.array([values[i][0] for i in order])


def signal_of(file, quantity, joint):
    return read(file, f"/signals/{quantity}/{joint}", "Scalars:scalars")


def offer_all(stream, times, rows):
    for time_ns, row in zip(times, rows, strict=True):
        stream.show_state(int(time_ns), *row)


# Content of the recording


def test_every_sample_is_read_back_to_the_bit(tmp_path):
    file = tmp_path / "new" / "a.rrd"
    stream = RerunStream(URDF, NAMES, file=file)
    times, rows = samples(5000)
    times = times * 7 // 3  # whole nanoseconds that no float of seconds holds
    offer_all(stream, times, rows)
    assert stream.close()
    assert stream.dropped == 0
    assert stream.trouble is None
    for index, quantity in enumerate(QUANTITIES):
        for column, name in enumerate(NAMES):
            at, values = signal_of(file, quantity, name)
            assert np.array_equal(at, times)
            assert np.array_equal(values, rows[:, index, column])


def test_the_arm_moves_as_pinocchio_states(tmp_path, oracle):
    file = tmp_path / "a.rrd"
    stream = RerunStream(URDF, NAMES, tool="tool", file=file, arm_rate=50)
    times, rows = samples(500)
    offer_all(stream, times, rows)
    assert stream.close()
    logged = np.arange(0, 500, 20)  # 50 Hz of 1 kHz
    frames = read(file, "/transforms", "Transform3D:child_frame")
    p = read(file, "/transforms", "Transform3D:translation")[1]
    xyzw = read(file, "/transforms", "Transform3D:quaternion")[1]
    for joint, link in zip(NAMES, "abc", strict=True):
        own = frames[1] == link
        assert np.array_equal(frames[0][own], times[logged])
        for k, sample in enumerate(logged):
            T = oracle.in_parent_link(joint, rows[sample, 0])
            # Rerun keeps transforms in single precision: 6e-8 relative, some roundings.
            assert p[own][k] == pytest.approx(T[:3, 3], abs=1e-6)
            assert pin.Quaternion(xyzw[own][k]).matrix() == pytest.approx(T[:3, :3], abs=1e-6)
    ends = read(file, "/tool/path", "LineStrips3D:strips")
    assert np.array_equal(ends[0], times[logged][1:])
    p_WT = np.array([oracle.p_WT(rows[sample, 0]) for sample in logged])
    assert ends[1][:, 0] == pytest.approx(p_WT[:-1], abs=1e-6)
    assert ends[1][:, 1] == pytest.approx(p_WT[1:], abs=1e-6)


def test_deviation_is_target_minus_tool_from_the_targets_time(tmp_path, oracle):
    file = tmp_path / "a.rrd"
    stream = RerunStream(URDF, NAMES, tool="tool", file=file, arm_rate=1000)
    times, rows = samples(300)
    first, later = np.array([0.5, 0.25, 1.0]), np.array([-0.5, 0.25, 1.0])
    offer_all(stream, times[:100], rows[:100])
    stream.offer_target(200 * MS, later)  # ahead of time
    stream.offer_target(0, first)  # at once, which is now t = 99 ms
    offer_all(stream, times[100:], rows[100:])
    assert stream.close()
    p_WT = np.array([oracle.p_WT(row[0]) for row in rows])
    expected = np.vstack((first - p_WT[99:200], later - p_WT[200:]))
    for axis, name in enumerate("xyz"):
        at, values = read(file, f"/signals/tool_deviation/{name}", "Scalars:scalars")
        assert np.array_equal(at, times[99:])
        assert values == pytest.approx(expected[:, axis], abs=1e-14)  # as for the position
    at, points = read(file, "/tool/target", "Points3D:positions")
    assert at.tolist() == [99 * MS, 200 * MS]
    assert points.tolist() == [first.tolist(), later.tolist()]  # halves are exact


def test_events_are_texts_at_their_times(tmp_path):
    file = tmp_path / "a.rrd"
    stream = RerunStream(URDF, NAMES, file=file)
    times, rows = samples(50)
    offer_all(stream, times[:20], rows[:20])
    stream.offer_text(19 * MS, "power off")
    stream.offer_text(30 * MS, "refused: too much", "WARN")
    offer_all(stream, times[20:], rows[20:])
    assert stream.close()
    at, texts = read(file, "/events", "TextLog:text")
    assert at.tolist() == [19 * MS, 30 * MS]
    assert [str(text) for text in texts] == ["power off", "refused: too much"]
    assert [str(level) for level in read(file, "/events", "TextLog:level")[1]] == ["INFO", "WARN"]
    closed = RerunStream(URDF, NAMES)
    closed.offer_text(0, "nobody looks")


def test_the_line_goes_on_at_an_integer_second_after_a_reset(tmp_path):
    file = tmp_path / "a.rrd"
    stream = RerunStream(URDF, NAMES, tool="tool", file=file, arm_rate=1000)
    times, rows = samples(1200)
    offer_all(stream, times, rows)
    offer_all(stream, times[:300], rows[:300])
    offer_all(stream, times[:10], rows[:10])
    assert stream.close()
    expected = [*times, *(times[:300] + 2000 * MS), *(times[:10] + 3000 * MS)]
    at, values = signal_of(file, "q", "lift")
    assert at.tolist() == expected
    assert np.array_equal(values, np.concatenate((rows, rows[:300], rows[:10]))[:, 0, 1])
    # The tool did not travel through the reset: no piece of path ends at its first pose.
    ends, _ = read(file, "/tool/path", "LineStrips3D:strips")
    assert sorted({*expected} - {*ends.tolist()}) == [0, 2000 * MS, 3000 * MS]


def test_values_not_measured_or_not_finite_are_left_out(tmp_path):
    file = tmp_path / "a.rrd"
    stream = RerunStream(URDF, NAMES, tool="tool", file=file, arm_rate=1000)
    times, rows = samples(5)
    rows[2, 0, 1] = np.nan
    for time_ns, row in zip(times, rows, strict=True):
        stream.show_state(int(time_ns), *row[:5])
    assert stream.close()
    assert len(signal_of(file, "q_measured", "turn")[0]) == 0
    assert np.array_equal(signal_of(file, "q", "lift")[1], rows[:, 0, 1], equal_nan=True)
    poses = set(read(file, "/transforms", "Transform3D:translation")[0].tolist())
    assert poses == {0, 1 * MS, 3 * MS, 4 * MS}  # the viewer has no place for a broken pose


def test_layout_names_and_meshes_are_in_the_stream(tmp_path):
    from rerun.chunk import RrdReader

    (tmp_path / "some_robot").mkdir()
    triangle = "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n"
    (tmp_path / "some_robot" / "plate.obj").write_text(triangle)
    mesh = '<mesh filename="package://some_robot/plate.obj"/>'
    visual = f'<link name="a"><visual><geometry>{mesh}</geometry></visual></link>'
    file = tmp_path / "a.rrd"
    urdf = URDF.replace('<link name="a"/>', visual)
    assert RerunStream(urdf, NAMES, file=file, package_dirs=[tmp_path]).close()
    reader = RrdReader(file)
    assert len(reader.blueprints()) == 1
    static = list(reader.stream().filter(is_static=True))
    columns = [
        (chunk.entity_path, name)
        for chunk in static
        for name in chunk.to_record_batch().schema.names
    ]
    assert ("/signals/current/swing", "SeriesLines:names") in columns
    assert ("/odd_arm/visual_geometries/a/visual_0", "Asset3D:blob") in columns


def test_the_viewers_command_is_executable_in_a_shell(monkeypatch, tmp_path):
    """In a shell of the project by its name, in any other one by its path."""
    from arm_emulator.runs.recorder import get_viewer_command

    viewer = tmp_path / "bin" / "rerun"
    viewer.parent.mkdir()
    viewer.touch(mode=0o755)
    monkeypatch.setattr("sys.executable", str(viewer.with_name("python")))
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("PATH", str(viewer.parent))
    assert get_viewer_command("my run.rrd") == "rerun 'my run.rrd'"
    stream = "rerun+http://127.0.0.1:9876/proxy"  # of the port that rerun itself would listen at
    assert get_viewer_command(stream) == f"rerun --connect {stream}"
    monkeypatch.setenv("PATH", "/nowhere")
    assert get_viewer_command(tmp_path / "a.rrd") == f"bin/rerun {tmp_path}/a.rrd"


# Isolation of the control path


def test_without_a_sink_nothing_is_started():
    code = f"""
import sys, threading
from arm_emulator.view.rerun_stream import RerunStream
stream = RerunStream("not read", {NAMES})
stream.show_state(0, *[None] * 5)
stream.offer_target(0, (0.0, 0.0, 0.0))
assert stream.close() and stream.dropped == 0 and stream.url is None
assert threading.active_count() == 1
assert "rerun" not in sys.modules
"""
    run(code)


@pytest.mark.slow
def test_a_file_that_does_not_take_data_costs_samples_and_nothing_else(tmp_path):
    """A pipe without a reader stands for a disk that hangs."""
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    code = f"""
import os, threading, time
import numpy as np
from arm_emulator.view.rerun_stream import RerunStream
pipe = os.open({str(pipe)!r}, os.O_RDWR)
ready = threading.Event()
def drain():
    while not ready.is_set():
        os.read(pipe, 1 << 16)
threading.Thread(target=drain, daemon=True).start()
stream = RerunStream({URDF!r}, {NAMES}, file={str(pipe)!r}, capacity=3000)
ready.set()
x = np.random.default_rng(1).random(3)
deadline = time.monotonic() + 100.0
k = 0
while stream.dropped == 0:
    stream.show_state(k * 1000000, x, x, x, x, x, x)
    k += 1
    if k % 100 == 0:
        time.sleep(0.002)
    assert time.monotonic() < deadline
start = time.monotonic()
assert not stream.close(timeout=0.5)
assert time.monotonic() - start < 60.0  # 0.5 s and two last waits, on an idle machine
assert "Flush timed out" in stream.trouble, stream.trouble
"""
    run(code)  # and the process ends


@pytest.mark.slow
def test_a_killed_process_leaves_a_readable_file(tmp_path):
    file = tmp_path / "a.rrd"
    code = f"""
import time
import numpy as np
from arm_emulator.view.rerun_stream import RerunStream
stream = RerunStream({URDF!r}, {NAMES}, file={str(file)!r})
x = np.full(3, 0.5)
k = 0
while True:
    stream.show_state(k * 1000000, x, x, x, x, x)
    k += 1
    time.sleep(0.001)
"""
    with started(code) as process:
        deadline = time.monotonic() + 100.0
        written = 0
        while written < 100:
            with contextlib.suppress(RuntimeError, ValueError):  # no file yet, or half a one
                written = len(signal_of(file, "applied", "swing")[0])
            assert process.poll() is None
            assert time.monotonic() < deadline
        process.send_signal(signal.SIGKILL)
        process.wait()
    at, values = signal_of(file, "applied", "swing")
    assert len(at) >= written
    assert np.array_equal(at, np.arange(len(at)) * MS)
    assert (values == 0.5).all()


@pytest.mark.slow
def test_a_process_that_forgets_to_close_writes_everything(tmp_path):
    file = tmp_path / "a.rrd"
    code = f"""
import numpy as np
from arm_emulator.view.rerun_stream import RerunStream
stream = RerunStream({URDF!r}, {NAMES}, file={str(file)!r})
for k in range(500):
    stream.show_state(k * 1000000, *[np.full(3, float(k))] * 5)
"""
    run(code)
    assert signal_of(file, "q", "turn")[1].tolist() == list(range(500))


def test_the_server_listens_on_this_machine_only_and_frees_its_port():
    port = free_port()
    stream = RerunStream(URDF, NAMES, port=port)
    assert str(port) in stream.url
    heard = [c.laddr.ip for c in psutil.Process().net_connections("tcp") if c.laddr.port == port]
    assert heard == ["127.0.0.1"]
    socket.create_connection(("127.0.0.1", port), timeout=60.0).close()
    with pytest.raises(Refusal, match=rf"^Rerun: port must be a free TCP port.* got {port} \("):
        RerunStream(URDF, NAMES, port=port)
    offer_all(stream, *samples(100))
    assert stream.close()
    assert "rerun" not in [thread.name for thread in threading.enumerate()]
    RerunStream(URDF, NAMES, port=port).close()


def test_a_closed_stream_takes_no_samples(tmp_path):
    file = tmp_path / "a.rrd"
    stream = RerunStream(URDF, NAMES, file=file)
    assert stream.close()
    before = file.read_bytes()
    offer_all(stream, *samples(10))
    assert stream.close()
    assert file.read_bytes() == before
    assert stream.dropped == 0


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ({"port": 0}, r"Rerun: port must be a free TCP port of this machine, .* got 0$"),
        ({"port": 65536}, r"Rerun: port must be .* got 65536$"),
        ({"file": "/proc/none/a.rrd"}, r"Rerun: file must be one that can be written, got /proc"),
        ({"file": "."}, r"Rerun: file must be one that can be written, got \. \("),
        ({"tool": "hand"}, r"URDF: tool must be a link of it, got hand; valid: a, a_plate, b"),
        ({"joint_names": ("turn", "plate")}, r"URDF: joint must be .* got plate; valid: turn, l"),
        ({"urdf_xml": "<robot"}, r"URDF: text must be valid for Rerun, got "),
    ],
)
def test_refusals(tmp_path, arguments, words):
    right = {"urdf_xml": URDF, "joint_names": NAMES, "file": tmp_path / "a.rrd"}
    threads = threading.active_count()
    with pytest.raises(Refusal, match=f"^{words}"):
        RerunStream(**(right | arguments))
    assert threading.active_count() == threads


# Helpers


def free_port():
    """Return a port below those that the system gives to connections: none takes it meanwhile."""
    draw = random.Random()
    while True:
        port = draw.randrange(20_000, 32_000)
        with socket.socket() as probe, contextlib.suppress(OSError):
            probe.bind(("127.0.0.1", port))
            return port


@contextlib.contextmanager
def started(code):
    root = Path(__file__).parents[2]
    with subprocess.Popen(
        [sys.executable, "-c", code], cwd=root, stderr=subprocess.PIPE
    ) as process:
        try:
            yield process
        finally:
            process.kill()


def run(code):
    """Run code in a process of its own, which must end well and by itself."""
    with started(code) as process:
        _, errors = process.communicate(timeout=200.0)
        assert process.returncode == 0, errors.decode()


def test_a_machine_without_rerun_is_refused_in_a_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    rule = "Rerun: Python package rerun-sdk must be installed, got none; valid: pip install"
    with pytest.raises(Refusal, match=rule):
        RerunStream("<robot/>", ["joint"], file=tmp_path / "x.rrd")
