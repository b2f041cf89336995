"""The arm and its signals, shown live and recorded by Rerun, without disturbing the control path.

The control path puts samples into a bounded queue and goes on. One background thread takes them
out in batches and hands them to Rerun as columns. It does so in small steps and sleeps between
them, so that it never holds Python's lock for long.
"""

from __future__ import annotations

import atexit
import itertools
import os
import re
import socket
import tempfile
import threading
import time
from collections import deque
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from arm_emulator.refusal import Refusal
from emulator_node.rerun_blueprint import (
    COLOURS,
    DEVIATION,
    TIMELINE,
    TOOL_PATH,
    TOOL_TARGET,
    TRANSFORMS,
    blueprint,
)
from emulator_node.sample_queue import SampleQueue
from emulator_node.tool_position import ToolPosition

if TYPE_CHECKING:
    import rerun as rr
    import rerun.blueprint as rrb
    from rerun.urdf import UrdfTree

Array = NDArray[np.float64]
Times = NDArray[np.int64]

# In the order in which `RerunStream.offer` takes them.
QUANTITIES = ("q", "v", "gear_torque", "current", "voltage", "q_measured")

BATCH_PERIOD = 0.1  # s, real time: how far the picture of the arm is behind
SIGNAL_BATCHES = 5  # the curves come once in so many batches: fewer, longer columns cost less
BATCH_ROWS = 1000  # about the most in one column: keeps a single call short
BREATH = 1e-4  # s, after each small step: lets the control path have Python's lock
FLUSH_WAIT = 0.5  # s, real time: longest wait in one call for a slow disk
SECOND = 1_000_000_000  # ns


class RerunStream:
    """A Rerun recording of one arm: its geometry in motion, its signals, its tool and target.

    With neither `file` nor `port` nothing is started and every call returns at once. Otherwise the
    constructor prepares everything that takes long (import, meshes, server: 0.5 s and more);
    construct it before real time begins.

    Logical time stands on the time line `t` in whole nanoseconds. When it steps back (a reset), the
    line goes on at its next whole second.

    Entities: `signals/<quantity>/<joint>` for each of `QUANTITIES`, `signals/tool_deviation/<axis>`
    (target minus tool [m]), `transforms` (of all joints), `tool/path`, `tool/target`, and the
    geometry of the URDF under the robot's name.

    Attributes:
        url: where a viewer may connect, None without `port`.
        trouble: what went wrong last between here and Rerun, in words; None if nothing did.

    Args:
        urdf_xml: the URDF; joints that are not in `joint_names` rest at 0. Meshes are named by
            absolute path or `package://`.
        joint_names: the N moving joints, in the order of all arrays offered.
        q_start: joint angles (N,) [rad or m] for which the eye is set; None is 0.
        tool: the link whose path is drawn; None draws none.
        package_dirs: folders in which `package://NAME` is looked for as NAME, before those of
            ROS_PACKAGE_PATH and AMENT_PREFIX_PATH.
        file: the .rrd file to write.
        port: the TCP port at which a viewer on this machine may connect.
        capacity: samples that may wait.
        arm_rate: poses of the arm per second of logical time [Hz].
        signal_every: of so many samples one goes into the signals.
        server_memory: how much the server keeps for viewers that come late.

    Raises:
        Refusal: the port is taken, the file cannot be written, a number is below 1, or a joint, the
            tool or the URDF does not fit.
    """

    def __init__(
        self,
        urdf_xml: str,
        joint_names: Sequence[str],
        *,
        q_start: ArrayLike | None = None,
        tool: str | None = None,
        package_dirs: Iterable[str | Path] = (),
        file: str | Path | None = None,
        port: int | None = None,
        capacity: int = 20_000,
        arm_rate: int = 60,
        signal_every: int = 1,
        server_memory: str = "512MiB",
    ) -> None:
        self.url: str | None = None
        self.trouble: str | None = None
        self._lost = 0
        self._finished = False
        self._open = file is not None or port is not None
        self._queue = SampleQueue(capacity if self._open else 0, len(QUANTITIES), len(joint_names))
        self._targets: deque[tuple[int, tuple[float, ...]]] = deque(maxlen=1000)
        if not self._open:
            return
        _check_numbers(capacity=capacity, arm_rate=arm_rate, signal_every=signal_every)
        if file is not None:
            _check_file(Path(file))
        if port is not None:
            _check_port(port)

        import rerun as rr

        tree = _read_urdf(urdf_xml, package_dirs)
        self._batches = _Batches(tree, tuple(joint_names), tool, arm_rate, signal_every)
        self._batches.warm_up()
        recording = rr.RecordingStream("arm_emulator")
        sinks: list[rr.FileSink | rr.GrpcServerSink] = []
        if file is not None:
            sinks.append(rr.FileSink(str(file)))
        if port is not None:
            # The default address would be every interface of the machine.
            server = rr.GrpcServerSink("127.0.0.1", port, server_memory_limit=server_memory)
            sinks.append(server)
            self.url = server.uri
        recording.set_sinks(*sinks, default_blueprint=self._batches.blueprint(q_start))
        self._batches.send_static(recording)

        self._stop = threading.Event()
        self._done = threading.Event()
        self._deadline = float("inf")
        # Only the thread keeps the recording: a daemon's frame is never torn down, and tearing down
        # a recording waits for its file without end.
        self._thread = threading.Thread(
            target=self._run, args=(recording,), name="rerun", daemon=True
        )
        self._thread.start()
        # Before Rerun's own handler, which does not know what waits here.
        atexit.register(self.close)

    @property
    def dropped(self) -> int:
        """Samples that were not shown, because the queue was full or Rerun refused them."""
        return self._queue.dropped + self._lost

    def offer(
        self,
        time_ns: int,
        q: ArrayLike,
        v: ArrayLike,
        gear_torque: ArrayLike,
        current: ArrayLike,
        voltage: ArrayLike,
        q_measured: ArrayLike | None = None,
    ) -> None:
        """Show the state at a logical time. Never blocks and never raises; call it from one thread.

        Args:
            time_ns: logical time [ns].
            q: true joint angles (N,) [rad or m].
            v: true joint speeds (N,) [rad/s or m/s].
            gear_torque: (N,) [N m or N].
            current: motor currents (N,) [A].
            voltage: motor voltages (N,) [V].
            q_measured: joint angles as encoders tell them (N,) [rad or m]; None: not measured.
        """
        if self._open:
            self._queue.put(time_ns, q, v, gear_torque, current, voltage, q_measured)

    def offer_target(self, time_ns: int, p_WT: Sequence[float]) -> None:
        """Show where the tool shall be, p_WT (3,) [m] in the root frame, from a logical time on.

        A time already past means at once. Never blocks and never raises.
        """
        if self._open:
            try:
                x, y, z = p_WT
                start = max(int(time_ns), self._queue.newest)
                self._targets.append((start, (float(x), float(y), float(z))))
            except (TypeError, ValueError, OverflowError):
                self._lost += 1

    def close(self, timeout: float = 5.0) -> bool:
        """Write what is waiting and end the recording; return whether that was done in time [s].

        After a time-out the file holds what was written so far and can still be read.
        """
        if not self._open:
            return True
        self._open = False
        atexit.unregister(self.close)
        self._deadline = time.monotonic() + timeout
        self._stop.set()
        # The thread watches the deadline; the margin is for its last wait.
        self._done.wait(timeout + 2.0 * FLUSH_WAIT)
        if self._done.is_set() and self._finished:
            self._thread.join()
            return True
        import rerun as rr

        rr.unregister_shutdown()  # at exit it would wait for the file without end
        self._lost += len(self._queue)
        self.trouble = self.trouble or f"Rerun did not finish within {timeout:g} s"
        return False

    # The background thread

    def _run(self, recording: rr.RecordingStream) -> None:
        for turn in itertools.count():
            stopping = self._stop.wait(BATCH_PERIOD)
            self._send(recording, signals=stopping or turn % SIGNAL_BATCHES == 0)
            # A flush per batch puts the data into the file, whatever becomes of this process. While
            # the file does not take it nothing more is sent: the queue is what bounds the memory.
            while not self._flush(recording):
                if time.monotonic() > self._deadline:
                    self._done.set()
                    threading.Event().wait()  # keeps the recording from being torn down
            if stopping:
                break
        recording.disconnect()
        self._finished = True
        self._done.set()

    def _send(self, recording: rr.RecordingStream, *, signals: bool) -> None:
        # Only what waits now: while this is sent more comes in.
        waiting = len(self._queue)
        targets = [self._targets.popleft() for _ in range(len(self._targets))]
        self._spread(self._batches.send_targets(recording, targets), 0)
        while waiting and time.monotonic() < self._deadline:
            times, rows = self._queue.take(min(waiting, BATCH_ROWS))
            waiting -= len(times)
            self._spread(self._batches.send_poses(recording, times, rows), 0)
            if self._batches.waiting >= BATCH_ROWS:
                self._spread(self._batches.send_signals(recording), self._batches.waiting)
        if signals:
            self._spread(self._batches.send_signals(recording), self._batches.waiting)

    def _spread(self, steps: Iterator[None], samples: int) -> None:
        """Take the steps with pauses between; when Rerun refuses one, `samples` are lost."""
        try:
            for _ in steps:
                time.sleep(BREATH)
        except Exception as error:  # whatever Rerun dislikes, the arm goes on
            self._lost += samples
            self.trouble = f"Rerun refused samples: {error}"

    def _flush(self, recording: rr.RecordingStream) -> bool:
        try:
            recording.flush(timeout_sec=FLUSH_WAIT)
        except Exception as error:  # whatever it is, the arm goes on
            self.trouble = f"Rerun cannot write: {error}"
            time.sleep(0.1)
            return False
        return True


class _Batches:
    """Turns samples into columns of Rerun. Used by one thread."""

    def __init__(
        self,
        tree: UrdfTree,
        joint_names: tuple[str, ...],
        tool: str | None,
        arm_rate: int,
        signal_every: int,
    ) -> None:
        known = [joint.name for joint in tree.joints() if joint.joint_type != "fixed"]
        for name in joint_names:
            if name not in known:
                raise Refusal("URDF", "joint", "be a moving joint of it", name, ", ".join(known))
        self._tree = tree
        self._names = joint_names
        self._tool = None if tool is None else ToolPosition(tree, joint_names, tool)
        self._arm_rate = arm_rate
        self._signal_every = signal_every
        self._transform_columns = _transform_columns()
        self._start_over()

    def _start_over(self) -> None:
        self._count = 0  # samples seen
        self._shift = 0  # ns, from logical time to the time line
        self._last_time = -1  # ns, on the time line
        self._last_pose = -1  # number of the last pose shown, at `arm_rate`
        self._cuts: list[int] = []  # ns, on the time line: where logical time stepped back
        self._path_time = np.empty(0, np.int64)  # of the last pose shown, if there is one
        self._path_end = np.empty((0, 3))
        self._targets: list[tuple[int, tuple[float, ...]]] = []  # from when [ns, line], p_WT
        self._waiting: list[tuple[Times, Array]] = []
        self.waiting = 0  # samples whose signals are still to be sent

    def warm_up(self) -> None:
        """Send a batch into nowhere: Rerun's first calls take up to 30 ms, later ones 0.1 ms."""
        import rerun as rr

        nowhere = rr.RecordingStream("arm_emulator_warm_up")
        rows = np.zeros((2, len(QUANTITIES), len(self._names)))
        times = np.array([0, SECOND], np.int64)
        for steps in (
            self.send_targets(nowhere, [(0, (0.0, 0.0, 0.0))]),
            self.send_poses(nowhere, times, rows),
            self.send_signals(nowhere),
        ):
            for _ in steps:
                pass
        self._start_over()

    def blueprint(self, q_start: ArrayLike | None) -> rrb.Blueprint:
        """Return the layout of the viewer, its eyes set for the pose q_start (N,)."""
        q = np.zeros((1, len(self._names)))
        q[0] = 0.0 if q_start is None else q_start
        names = [self._tree.root_link().name, *(j.child_link for j in self._tree.joints())]
        links = [ToolPosition(self._tree, self._names, name)(q)[0] for name in names]
        tool = None if self._tool is None else self._tool(q)[0]
        return blueprint(self._tree.name, names[0], np.array(links), tool)

    def send_static(self, recording: rr.RecordingStream) -> None:
        """Send what does not change: geometry, names and colours of the curves."""
        import rerun as rr

        self._tree.log_urdf_to_recording(recording)
        root = rr.CoordinateFrame(self._tree.root_link().name)
        # Radii below zero are in points of the screen.
        line = rr.LineStrips3D.from_fields(radii=-1.5, colors=(250, 200, 60))
        point = rr.Points3D.from_fields(radii=-6.0, colors=(230, 60, 60))
        recording.log(TOOL_PATH, root, line, static=True)
        recording.log(TOOL_TARGET, root, point, static=True)
        curves = [
            (_path("signals", quantity, name), name, colour, quantity == "voltage")
            for quantity in QUANTITIES
            for name, colour in zip(self._names, itertools.cycle(COLOURS), strict=False)
        ]
        if self._tool is not None:
            curves += [
                (f"{DEVIATION}/{axis}", axis, colour, False)
                for axis, colour in zip("xyz", COLOURS, strict=False)
            ]
        for path, name, colour, held in curves:
            mode = rr.components.InterpolationMode
            drawn = mode.StepAfter if held else mode.Linear
            curve = rr.SeriesLines(names=name, colors=colour, interpolation_mode=drawn)
            recording.log(path, curve, static=True)

    # Each of these yields wherever Python's lock may be given up.

    def send_targets(
        self, recording: rr.RecordingStream, targets: list[tuple[int, tuple[float, ...]]]
    ) -> Iterator[None]:
        """Send targets: from when [ns, logical], p_WT [m]."""
        import rerun as rr

        for time_ns, p_WT in targets:
            start = max(time_ns + self._shift, self._last_time)
            self._targets = sorted([*self._targets, (start, p_WT)], key=lambda target: target[0])
            recording.send_columns(
                TOOL_TARGET,
                [_line(np.array([start]))],
                rr.Points3D.columns(positions=[p_WT]),
                strict=True,
            )
            yield

    def send_poses(
        self, recording: rr.RecordingStream, times: Times, rows: Array
    ) -> Iterator[None]:
        """Send the arm's motion of samples, times (K,) [ns] and rows (K, quantities, N), K > 0.

        Their signals wait for `send_signals`.
        """
        import rerun as rr

        times = self._on_the_line(times)
        chosen = slice((-self._count) % self._signal_every, None, self._signal_every)
        self._count += len(times)
        self._waiting.append((times[chosen], rows[chosen]))
        self.waiting += len(times[chosen])

        numbers = times * self._arm_rate // SECOND
        q = rows[:, 0]
        new = (np.diff(numbers, prepend=self._last_pose) > 0) & np.isfinite(q).all(axis=1)
        self._last_pose = int(numbers[-1])
        if not new.any():
            return
        times, q = times[new], q[new]
        yield
        yield from self._send_transforms(recording, times, q)
        if self._tool is None:
            return
        p_WT = self._tool(q)
        yield
        ends, pieces = self._pieces_of_path(times, p_WT)
        if len(pieces):
            columns = rr.LineStrips3D.columns(strips=list(pieces))
            yield
            recording.send_columns(TOOL_PATH, [_line(ends)], columns, strict=True)
            yield
        yield from self._send_deviation(recording, times, p_WT)

    def send_signals(self, recording: rr.RecordingStream) -> Iterator[None]:
        """Send the signals of the samples that wait."""
        import rerun as rr

        waiting, self._waiting, self.waiting = self._waiting, [], 0
        if not waiting:
            return
        line = _line(np.concatenate([times for times, _ in waiting]))
        rows = np.concatenate([rows for _, rows in waiting])
        for index, quantity in enumerate(QUANTITIES):
            if len(rows) == 0 or np.isnan(rows[:, index]).all():
                continue
            for column, name in enumerate(self._names):
                recording.send_columns(
                    _path("signals", quantity, name),
                    [line],
                    rr.Scalars.columns(scalars=np.ascontiguousarray(rows[:, index, column])),
                    strict=True,
                )
                yield

    def _pieces_of_path(self, times: Times, p_WT: Array) -> tuple[Times, Array]:
        """Return the pieces (P, 2, 3) [m] of the tool's path and when each is done (P,) [ns]."""
        times = np.append(self._path_time, times)
        points = np.vstack((self._path_end, p_WT))
        self._path_time, self._path_end = times[-1:], points[-1:]
        pieces = np.stack((points[:-1], points[1:]), axis=1)
        whole = np.ones(len(pieces), bool)
        for cut in self._cuts:  # the tool did not travel through a reset
            whole &= (times[1:] < cut) | (cut <= times[:-1])
        self._cuts = []
        return times[1:][whole], pieces[whole]

    def _send_deviation(
        self, recording: rr.RecordingStream, times: Times, p_WT: Array
    ) -> Iterator[None]:
        import rerun as rr

        starts = [start for start, _ in self._targets]
        current = np.searchsorted(starts, times, side="right") - 1
        given = current >= 0
        if not given.any():
            return
        deviation = np.array([p for _, p in self._targets])[current[given]] - p_WT[given]
        self._targets = self._targets[int(current[-1]) :]
        for axis, values in zip("xyz", deviation.T, strict=True):
            recording.send_columns(
                f"{DEVIATION}/{axis}",
                [_line(times[given])],
                rr.Scalars.columns(scalars=np.ascontiguousarray(values)),
                strict=True,
            )
            yield

    def _on_the_line(self, times: Times) -> Times:
        """Return the times on the time line, which goes on where logical time steps back."""
        times = times + self._shift
        before = np.concatenate(([self._last_time], times[:-1]))
        for index in np.flatnonzero(times < before):
            last = self._last_time if index == 0 else int(times[index - 1])
            start = int(times[index]) - self._shift  # logical
            shift = ((last - start) // SECOND + 1) * SECOND
            times[index:] += shift - self._shift
            self._shift = shift
            self._cuts.append(int(times[index]))
        self._last_time = int(times[-1])
        return times

    def _send_transforms(
        self, recording: rr.RecordingStream, times: Times, q: Array
    ) -> Iterator[None]:
        """Send the joints' transforms for q (K, N): one row per joint and time, in one entity."""
        import pyarrow as pa
        import rerun as rr

        count, joints = q.shape
        starts = np.arange(0, count * joints + 1, joints, dtype=np.int32)
        names = pa.ListArray.from_arrays(starts, pa.array(list(self._names) * count))
        values = pa.ListArray.from_arrays(starts, pa.array(q.ravel()))
        yield
        transforms = self._tree.compute_joint_transform_batches(names, values).flatten()
        yield
        columns = [
            rr.ComponentColumn(descriptor, batch(transforms.field(field)))
            for field, descriptor, batch in self._transform_columns
        ]
        yield
        line = _line(np.repeat(times, joints))
        recording.send_columns(TRANSFORMS, [line], columns, strict=True)
        yield


def _transform_columns() -> list[tuple[str, rr.ComponentDescriptor, Any]]:
    """Return field, descriptor and batch type of each column of a joint's transform."""
    import rerun as rr

    batches = {
        "translation": rr.components.Translation3DBatch,
        "quaternion": rr.components.RotationQuatBatch,
        "parent_frame": rr.components.TransformFrameIdBatch,
        "child_frame": rr.components.TransformFrameIdBatch,
    }
    example = rr.Transform3D.columns(
        translation=[(0.0, 0.0, 0.0)],
        quaternion=[(0.0, 0.0, 0.0, 1.0)],
        parent_frame=["parent"],
        child_frame=["child"],
    )
    descriptors = [column.component_descriptor() for column in example]
    fields = [descriptor.component.split(":")[1] for descriptor in descriptors]
    return [(f, d, batches[f]) for f, d in zip(fields, descriptors, strict=True)]


def _line(times: Times) -> rr.TimeColumn:
    import rerun as rr

    return rr.TimeColumn(TIMELINE, duration=times.astype("timedelta64[ns]"))


def _path(*parts: str) -> str:
    import rerun as rr

    return rr.new_entity_path(list(parts))


def _check_file(file: Path) -> None:
    try:
        file.parent.mkdir(parents=True, exist_ok=True)
        with file.open("ab"):
            pass
    except OSError as error:
        raise Refusal(
            "Rerun", "file", "be one that can be written", f"{file} ({error.strerror})"
        ) from None


def _check_numbers(**numbers: int) -> None:
    for name, number in numbers.items():
        if number < 1:
            raise Refusal("Rerun", name, "be >= 1", number)


def _check_port(port: int) -> None:
    # Rerun only logs an error when its port is taken.
    rule = "be a free TCP port of this machine, 1 to 65535"
    if not 1 <= port <= 65535:
        raise Refusal("Rerun", "port", rule, port)
    with socket.socket() as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind(("127.0.0.1", port))
        except OSError as error:
            raise Refusal("Rerun", "port", rule, f"{port} ({error.strerror})") from None


def _read_urdf(urdf_xml: str, package_dirs: Iterable[str | Path]) -> UrdfTree:
    """Read the URDF with its `package://NAME` made paths where NAME is found."""
    import rerun.urdf

    folders = [Path(folder).resolve() for folder in package_dirs]

    def found(match: re.Match[str]) -> str:
        package = match.group(1)
        at = next((folder for folder in folders if (folder / package).is_dir()), None)
        return match.group(0) if at is None else str(at / package)

    with tempfile.TemporaryDirectory() as folder:
        path = os.path.join(folder, "robot.urdf")
        Path(path).write_text(re.sub(r"package://([^/\"'<>]+)", found, urdf_xml))
        try:
            return rerun.urdf.UrdfTree.from_file_path(path)
        except Exception as error:  # the binding raises bare exceptions
            raise Refusal("URDF", "text", "be one that Rerun can draw", error) from None
