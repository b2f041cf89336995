"""The arm and its signals, shown live and recorded by Rerun, without disturbing the control path.

The control path puts samples into a bounded queue and continues. One background thread takes them
out in batches and hands them to Rerun as columns. It works in small steps and sleeps between
them, so that it never holds Python's lock for long.
"""

from __future__ import annotations

import atexit
import contextlib
import errno
import itertools
import os
import re
import socket
import tempfile
import threading
import time
from collections import deque
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from arm_emulator.base.arrays import Array
from arm_emulator.base.refusal import Refusal
from arm_emulator.base.required_package import require_package
from arm_emulator.base.urdf.shafts import Shafts
from arm_emulator.base.validation.bound import TOOL_POSITION
from arm_emulator.view.rerun_batches import QUANTITIES, RerunBatches, SampleQueue

if TYPE_CHECKING:
    import rerun as rr
    from rerun.urdf import UrdfTree

BATCH_PERIOD = 0.1  # s, real time: how far the picture of the arm is behind
SIGNAL_BATCHES = 5  # the curves come once in so many batches: fewer, longer columns cost less
BATCH_ROWS = 500  # about the most in one column: keeps a single call short
BREATH = 1e-4  # s, after each small step: lets the control path have Python's lock
FLUSH_WAIT = 0.5  # s, real time: longest wait in one call for a slow disk
WAITING_LIMIT = 10_000  # samples that wait before one that may wait, too
ROOM_BREATH = 1e-3  # s, real time, between two looks for room
SERVER_MEMORY = "512MiB"  # of the server, for viewers that connect late
LONGEST_END = 60.0  # s, real time, for all samples of a whole run


class RerunStream:
    """A Rerun recording of one arm: its geometry in motion, its signals, its tool and target.

    With neither `file` nor `port` nothing is started and every call returns at once. Otherwise the
    constructor prepares everything that takes long (import, meshes, server: 0.5 s and more);
    construct it before real time begins.

    Logical time stands on the time line `t` in whole nanoseconds. When it steps back (a reset), the
    line goes on at its next whole second.

    Entities: `signals/<quantity>/<joint>` for each of `QUANTITIES` and the further ones;
    `signals/tool_deviation/<axis>` (target minus tool [m]); `transforms` (of all joints);
    `tool/path`, `tool/target`, `events`; the geometry of the URDF under the robot's name.

    Attributes:
        url: where a viewer may connect, None without `port`.
        trouble: newest error between here and Rerun; None: no error.

    Args:
        urdf_xml: the URDF; joints that are not in `joint_names` rest at 0. Meshes are named by
            absolute path or `package://`.
        joint_names: the N shafts, called after joints, in the order of all arrays offered.
        q_start: joint angles (N,) [rad or m] for the eye's position; None is 0.
        tool: the link whose path is drawn; None draws none.
        package_dirs: folders in which `package://NAME` is looked for as NAME, before those of
            ROS_PACKAGE_PATH and AMENT_PREFIX_PATH.
        file: the .rrd file to write.
        port: the TCP port at which a viewer on this machine may connect.
        capacity: capacity of the queue [samples].
        arm_rate: poses of the arm per second of logical time [Hz].
        further: quantities that are offered beside the usual ones, with their units.
        targets: whether targets of the tool may come, see `offer_target`: the layout has a plot for
            them.

    Raises:
        Refusal: rerun-sdk is missing, the port is taken, the file cannot be written, or a joint,
            the tool or the URDF does not fit.
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
        further: Mapping[str, str] = MappingProxyType({}),
        targets: bool = True,
    ) -> None:
        self.url: str | None = None
        self.trouble: str | None = None
        self._lost = 0
        self._finished = False
        self._open = file is not None or port is not None
        self._file, self._broken = file, False
        width = len(QUANTITIES) + len(further)
        self._queue = SampleQueue(capacity if self._open else 0, width, len(joint_names))
        self._not_measured = np.full(len(joint_names), np.nan)
        self._targets: deque[tuple[int, tuple[float, ...]]] = deque(maxlen=1000)
        self._texts: deque[tuple[int, str, str]] = deque(maxlen=1000)
        if not self._open:
            return
        if file is not None:
            _check_file(Path(file))
        if port is not None:
            _check_port(port)
        require_package("Rerun", "rerun", "rerun-sdk")

        import rerun as rr

        tree = _read_urdf(urdf_xml, package_dirs)
        self._batches = RerunBatches(
            tree,
            urdf_xml,
            Shafts(urdf_xml, joint_names),
            tool,
            arm_rate,
            further,
        )
        self._batches.warm_up()
        recording = rr.RecordingStream("arm_emulator")
        sinks = self._list_sinks(file, port)
        blueprint = self._batches.make_blueprint(q_start, targets)
        try:
            recording.set_sinks(*sinks, default_blueprint=blueprint)
        except Exception as error:  # Rerun has no class for what a disk refuses
            rule = "be one that can be written"
            actual = f"{file} ({error})" if file is not None else error
            raise Refusal("Rerun", "file", rule, actual) from None
        self._batches.send_static(recording)

        self._stop = threading.Event()
        self._done = threading.Event()
        self._deadline = float("inf")
        # Only the thread keeps the recording: a daemon's frame is never torn down, and tearing down
        # a recording waits for its file without end.
        self._thread = threading.Thread(
            target=self._run_thread, args=(recording,), name="rerun", daemon=True
        )
        self._thread.start()
        # Before Rerun's own handler, which does not know this queue.
        atexit.register(self.close)

    def _list_sinks(
        self, file: str | Path | None, port: int | None
    ) -> list[rr.FileSink | rr.GrpcServerSink]:
        """Return where the recording goes."""
        import rerun as rr

        sinks: list[rr.FileSink | rr.GrpcServerSink] = []
        if file is not None:
            sinks.append(rr.FileSink(str(file)))
        if port is not None:
            # The default address would be every interface of the machine.
            server = rr.GrpcServerSink("127.0.0.1", port, server_memory_limit=SERVER_MEMORY)
            sinks.append(server)
            self.url = server.uri
        return sinks

    @property
    def is_open(self) -> bool:
        """Whether offered samples are sent anywhere."""
        return self._open

    @property
    def waiting(self) -> int:
        """Samples in the queue."""
        return len(self._queue)

    @property
    def dropped(self) -> int:
        """Samples that were not shown, because the queue was full or Rerun refused them."""
        return self._queue.dropped + self._lost

    def show_state(
        self,
        time_ns: int,
        q: Array,
        v: Array,
        gear_torque: Array,
        current: Array,
        applied: Array,
        q_measured: Array | None = None,
        further: Sequence[Array] = (),
    ) -> None:
        """Show the state at a logical time. Never blocks; call it from one thread.

        The arrays are copied.

        Args:
            time_ns: logical time [ns].
            q: true joint angles (N,) [rad or m].
            v: true joint speeds (N,) [rad/s or m/s].
            gear_torque: (N,) [N m or N].
            current: motor currents (N,) [A].
            applied: applied motor commands (N,) [V, N m, A].
            q_measured: joint angles measured through encoders (N,) [rad or m]; None: not measured.
            further: the further quantities, (N,) each.
        """
        if self._open:
            measured = self._not_measured if q_measured is None else q_measured
            self._queue.append_sample(
                time_ns, (q, v, gear_torque, current, applied, measured, *further)
            )

    def wait_for_room(self) -> None:
        """Wait until the queue has room, before a sample of a run that can wait is offered."""
        while self._open and self.waiting >= WAITING_LIMIT:
            time.sleep(ROOM_BREATH)

    def close_complete(self) -> str:
        """Write all waiting samples and end the recording; return what is missing, or ""."""
        self.close(LONGEST_END)
        return self.trouble or (f"{self.dropped} samples are missing" if self.dropped else "")

    def offer_target(self, time_ns: int, p_WT: Sequence[float]) -> None:
        """Show the tool's target p_WT (3,) [m] in the root frame, from a logical time on.

        A past time means now. Never blocks and never raises.
        """
        if self._open:
            try:
                x, y, z = TOOL_POSITION.check_row("Rerun", p_WT, 3).tolist()
                start = max(int(time_ns), self._queue.newest)
                self._targets.append((start, (x, y, z)))
            except (TypeError, ValueError, OverflowError):  # a Refusal among them
                self._lost += 1

    def offer_text(self, time_ns: int, text: str, level: str = "INFO") -> None:
        """Show an event at a logical time [ns]. Never blocks and never raises."""
        if self._open:
            self._texts.append((time_ns, text, level))

    def close(self, timeout: float = 5.0) -> bool:
        """Write the waiting samples and end the recording; return whether both succeeded in time
        [s].

        After a time-out the file contains the samples written so far and remains readable.
        """
        if not self._open:
            return not self._broken
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

    def _run_thread(self, recording: rr.RecordingStream) -> None:
        for turn in itertools.count():
            stopping = self._stop.wait(BATCH_PERIOD)
            self._send_samples(recording, signals=stopping or turn % SIGNAL_BATCHES == 0)
            # A flush per batch puts the data into the file, even if this process is killed. While
            # the file does not take it nothing more is sent: the queue is what bounds the memory.
            while not self._flush_recording(recording):
                if self._broken:
                    self._give_up()
                    return
                if time.monotonic() > self._deadline:
                    self._done.set()
                    threading.Event().wait()  # keeps the recording from being torn down
            if stopping:
                break
        recording.disconnect()
        self._finished = True
        self._done.set()

    def _send_samples(self, recording: rr.RecordingStream, *, signals: bool) -> None:
        # Only the samples that wait now: more arrive meanwhile.
        waiting = len(self._queue)
        targets = [self._targets.popleft() for _ in range(len(self._targets))]
        self._send_in_parts(self._batches.send_targets(recording, targets), 0)
        texts = [self._texts.popleft() for _ in range(len(self._texts))]
        while waiting and time.monotonic() < self._deadline:
            count = min(waiting, BATCH_ROWS)
            waiting -= count
            times, rows = self._queue.take_samples(count)
            time.sleep(BREATH)
            if len(times):
                self._send_in_parts(self._batches.send_poses(recording, times, rows), 0)
            if self._batches.waiting >= BATCH_ROWS:
                self._send_in_parts(self._batches.send_signals(recording), self._batches.waiting)
        self._send_in_parts(self._batches.send_texts(recording, texts), 0)
        if signals:
            self._send_in_parts(self._batches.send_signals(recording), self._batches.waiting)

    def _send_in_parts(self, steps: Iterator[None], samples: int) -> None:
        """Take the steps with pauses between; when Rerun refuses one, `samples` are lost."""
        try:
            for _ in steps:
                time.sleep(BREATH)
        except Exception as error:  # whatever Rerun dislikes, the arm goes on
            self._lost += samples
            self.trouble = f"Rerun refused samples: {error}"

    def _flush_recording(self, recording: rr.RecordingStream) -> bool:
        begun = time.monotonic()
        try:
            recording.flush(timeout_sec=FLUSH_WAIT)
        except Exception as error:  # whatever it is, the arm goes on
            self.trouble = f"Rerun cannot write: {error}"
            # A slow file makes a flush time out. One that fails sooner has no writer any more.
            self._broken = time.monotonic() - begun < FLUSH_WAIT
            time.sleep(0.1)
            return False
        return True

    def _give_up(self) -> None:
        """Take no more samples, since Rerun ends its writer at the first error of a file."""
        import rerun as rr

        with contextlib.suppress(OSError, TypeError):
            if self._file is not None and os.statvfs(self._file).f_bavail == 0:
                self.trouble = f"the disk takes no more: {os.strerror(errno.ENOSPC)}"
        rr.unregister_shutdown()  # which would wait for the writer
        self._open = False
        self._lost += len(self._queue)
        self._done.set()


def _check_file(file: Path) -> None:
    try:
        file.parent.mkdir(parents=True, exist_ok=True)
        with file.open("ab"):
            pass
    except OSError as error:
        raise Refusal(
            "Rerun", "file", "be one that can be written", f"{file} ({error.strerror})"
        ) from None


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

    def locate_mesh(match: re.Match[str]) -> str:
        package = match.group(1)
        at = next((folder for folder in folders if (folder / package).is_dir()), None)
        return match.group(0) if at is None else str(at / package)

    with tempfile.TemporaryDirectory() as folder:
        path = os.path.join(folder, "robot.urdf")
        Path(path).write_text(re.sub(r"package://([^/\"'<>]+)", locate_mesh, urdf_xml))
        try:
            return rerun.urdf.UrdfTree.from_file_path(path)
        except Exception as error:  # the binding raises bare exceptions
            raise Refusal("URDF", "text", "be valid for Rerun", error) from None
