"""Conversion of samples of the arm into Rerun columns."""

from __future__ import annotations

import itertools
from collections import deque
from collections.abc import Iterator, Mapping, Sequence
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from arm_emulator.base.arrays import Array
from arm_emulator.base.refusal import Refusal
from arm_emulator.base.urdf.shafts import Shafts
from arm_emulator.view.rerun_blueprint import (
    COLOURS,
    DEVIATION,
    EVENTS,
    TIMELINE,
    TOOL_PATH,
    TOOL_TARGET,
    TRANSFORMS,
    WORLD_AXES,
    make_blueprint,
)

if TYPE_CHECKING:
    import rerun as rr
    import rerun.blueprint as rrb
    from rerun.urdf import UrdfTree

# In the order in which `RerunStream.show_state` takes them.
QUANTITIES = ("q", "v", "gear_torque", "current", "applied", "q_measured")

AXIS_LENGTH = 0.2  # m, of the axes of the world at the base
SECOND = 1_000_000_000  # ns


class RerunBatches:
    """Sends batches of samples, used by one thread.

    Args:
        tree: the URDF.
        urdf_xml: its text.
        shafts: the N that are sampled, in the order of the samples, and the joints that they move.
        tool: the link whose path is drawn; None draws none.
        arm_rate: poses of the arm per second on the time line [Hz].
        further: names of quantities after `QUANTITIES`, with their units.

    Attributes:
        waiting: samples whose signals are still to be sent.

    Raises:
        Refusal: a joint or the tool is not in the URDF.
    """

    def __init__(
        self,
        tree: UrdfTree,
        urdf_xml: str,
        shafts: Shafts,
        tool: str | None,
        arm_rate: int,
        further: Mapping[str, str] = MappingProxyType({}),
    ) -> None:
        moving = [joint.name for joint in tree.joints() if joint.joint_type != "fixed"]
        for name in shafts.joints:
            if name not in moving:
                raise Refusal("URDF", "joint", "be a moving joint of it", name, ", ".join(moving))
        self._tree = tree
        self._names = shafts.names
        self._shafts = shafts
        self._further = further
        self._quantities = (*QUANTITIES, *further)
        self._links = [tree.root_link().name, *(joint.child_link for joint in tree.joints())]
        if tool not in (None, *self._links):
            valid = ", ".join(sorted(self._links))
            raise Refusal("URDF", "tool", "be a link of it", tool, valid)
        self._tool = tool
        self._positions = LinkPositions(urdf_xml, shafts.joints)
        self._arm_rate = arm_rate
        self._transform_columns = _transform_columns()
        self._start_over()

    def _start_over(self) -> None:
        self._shift = 0  # ns, from logical time to the time line
        self._last_time = -1  # ns, on the time line
        self._last_pose = -1  # number of the last pose shown, at `arm_rate`
        self._cuts: list[int] = []  # ns, on the time line: where logical time stepped back
        self._path_time = np.empty(0, np.int64)  # of the last pose shown, if there is one
        self._path_end = np.empty((0, 3))
        self._targets: list[tuple[int, tuple[float, ...]]] = []  # from when [ns, line], p_WT
        self._waiting: list[tuple[Times, Array]] = []
        self.waiting = 0

    def warm_up(self) -> None:
        """Send a batch to a null sink: Rerun's first calls take up to 30 ms, later ones 0.1 ms."""
        import rerun as rr

        nowhere = rr.RecordingStream("arm_emulator_warm_up")
        rows = np.zeros((2, len(self._quantities), len(self._names)))
        times = np.array([0, SECOND], np.int64)
        for steps in (
            self.send_targets(nowhere, [(0, (0.0, 0.0, 0.0))]),
            self.send_texts(nowhere, [(0, "", "INFO")]),
            self.send_poses(nowhere, times, rows),
            self.send_signals(nowhere),
        ):
            for _ in steps:
                pass
        self._start_over()

    def make_blueprint(self, q_start: ArrayLike | None, targets: bool) -> rrb.Blueprint:
        """Return the layout of the viewer, with its eyes set for the pose q_start (N,)."""
        q = np.zeros((1, len(self._names)))
        q[0] = 0.0 if q_start is None else q_start
        q = self._shafts.convert_to_joints(q)
        links = np.array([self._positions(name, q)[0] for name in self._links])
        tool = None if self._tool is None else links[self._links.index(self._tool)]
        about = self._tree.name, self._links[0], links, tool, self._further
        return make_blueprint(*about, targets=targets)

    def send_static(self, recording: rr.RecordingStream) -> None:
        """Send the static data: geometry, names and colours of the curves."""
        import rerun as rr

        self._tree.log_urdf_to_recording(recording)
        root = rr.CoordinateFrame(self._tree.root_link().name)
        # Negative radii are in points of the screen.
        line = rr.LineStrips3D.from_fields(radii=-1.5, colors=(250, 200, 60))
        point = rr.Points3D.from_fields(radii=-6.0, colors=(230, 60, 60))
        axes = rr.Arrows3D(
            vectors=AXIS_LENGTH * np.eye(3),
            colors=[(230, 80, 80), (90, 190, 90), (90, 140, 240)],
            labels=["x", "y", "z"],
            radii=-1.5,
        )
        recording.log(WORLD_AXES, root, axes, static=True)
        recording.log(TOOL_PATH, root, line, static=True)
        recording.log(TOOL_TARGET, root, point, static=True)
        curves = [
            (_make_path("signals", quantity, name), name, colour, quantity == "applied")
            for quantity in self._quantities
            for name, colour in zip(self._names, itertools.cycle(COLOURS), strict=False)
        ]
        if self._tool is not None:
            curves += [
                (f"{DEVIATION}/{axis}", axis, colour, False)
                for axis, colour in zip("xyz", COLOURS, strict=False)
            ]
        for path, name, colour, is_stepped in curves:
            mode = rr.components.InterpolationMode
            interpolation = mode.StepAfter if is_stepped else mode.Linear
            curve = rr.SeriesLines(names=name, colors=colour, interpolation_mode=interpolation)
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
                [_make_time_column(np.array([start]))],
                rr.Points3D.columns(positions=[p_WT]),
                strict=True,
            )
            yield

    def send_texts(
        self, recording: rr.RecordingStream, texts: list[tuple[int, str, str]]
    ) -> Iterator[None]:
        """Send events: when [ns, logical], text, and level such as "WARN"."""
        import rerun as rr

        if not texts:
            return
        at = np.array([time_ns + self._shift for time_ns, _, _ in texts], np.int64)
        columns = rr.TextLog.columns(
            text=[text for _, text, _ in texts], level=[level for _, _, level in texts]
        )
        recording.send_columns(EVENTS, [_make_time_column(at)], columns, strict=True)
        yield

    def send_poses(
        self, recording: rr.RecordingStream, times: Times, rows: Array
    ) -> Iterator[None]:
        """Send the arm's motion of samples, times (K,) [ns] and rows (K, quantities, N), K > 0.

        Their signals wait for `send_signals`.
        """
        import rerun as rr

        times = self._shift_times(times)
        self._waiting.append((times, rows))
        self.waiting += len(times)

        numbers = times * self._arm_rate // SECOND
        q = rows[:, 0]
        new = (np.diff(numbers, prepend=self._last_pose) > 0) & np.isfinite(q).all(axis=1)
        self._last_pose = int(numbers[-1])
        if not new.any():
            return
        times, q = times[new], self._shafts.convert_to_joints(q[new])
        yield
        yield from self._send_transforms(recording, times, q)
        if self._tool is None:
            return
        p_WT = self._positions(self._tool, q)
        yield
        ends, pieces = self._split_path(times, p_WT)
        if len(pieces):
            columns = rr.LineStrips3D.columns(strips=list(pieces))
            yield
            recording.send_columns(TOOL_PATH, [_make_time_column(ends)], columns, strict=True)
            yield
        yield from self._send_deviation(recording, times, p_WT)

    def send_signals(self, recording: rr.RecordingStream) -> Iterator[None]:
        """Send the signals of the waiting samples."""
        import rerun as rr

        waiting, self._waiting, self.waiting = self._waiting, [], 0
        if not waiting:
            return
        times = np.concatenate([times for times, _ in waiting])
        line = _make_time_column(times)
        rows = np.concatenate([rows for _, rows in waiting])
        for index, quantity in enumerate(self._quantities):
            if len(rows) == 0 or np.isnan(rows[:, index]).all():
                continue
            for column, name in enumerate(self._names):
                recording.send_columns(
                    _make_path("signals", quantity, name),
                    [line],
                    rr.Scalars.columns(scalars=np.ascontiguousarray(rows[:, index, column])),
                    strict=True,
                )
                yield

    def _split_path(self, times: Times, p_WT: Array) -> tuple[Times, Array]:
        """Return the pieces (P, 2, 3) [m] of the tool's path and their times (P,) [ns]."""
        times = np.append(self._path_time, times)
        points = np.vstack((self._path_end, p_WT))
        self._path_time, self._path_end = times[-1:], points[-1:]
        pieces = np.stack((points[:-1], points[1:]), axis=1)
        uncut = np.ones(len(pieces), bool)
        for cut in self._cuts:  # the tool did not travel through a reset
            uncut &= (times[1:] < cut) | (cut <= times[:-1])
        self._cuts = []
        return times[1:][uncut], pieces[uncut]

    def _send_deviation(
        self, recording: rr.RecordingStream, times: Times, p_WT: Array
    ) -> Iterator[None]:
        import rerun as rr

        starts = [start for start, _ in self._targets]
        current = np.searchsorted(starts, times, side="right") - 1
        has_target = current >= 0
        if not has_target.any():
            return
        deviation = np.array([p for _, p in self._targets])[current[has_target]] - p_WT[has_target]
        self._targets = self._targets[int(current[-1]) :]
        for axis, values in zip("xyz", deviation.T, strict=True):
            recording.send_columns(
                f"{DEVIATION}/{axis}",
                [_make_time_column(times[has_target])],
                rr.Scalars.columns(scalars=np.ascontiguousarray(values)),
                strict=True,
            )
            yield

    def _shift_times(self, times: Times) -> Times:
        """Return times on the time line, which continues where logical time steps back."""
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
        names = pa.ListArray.from_arrays(starts, pa.array(list(self._shafts.joints) * count))
        values = pa.ListArray.from_arrays(starts, pa.array(q.ravel()))
        yield
        transforms = self._tree.compute_joint_transform_batches(names, values).flatten()
        yield
        columns = [
            rr.ComponentColumn(descriptor, batch(transforms.field(field)))
            for field, descriptor, batch in self._transform_columns
        ]
        yield
        line = _make_time_column(np.repeat(times, joints))
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


def _make_time_column(times: Times) -> rr.TimeColumn:
    import rerun as rr

    return rr.TimeColumn(TIMELINE, duration=times.astype("timedelta64[ns]"))


def _make_path(*parts: str) -> str:
    import rerun as rr

    return rr.new_entity_path(list(parts))


Times = NDArray[np.int64]


class SampleQueue:
    """Samples of `width` quantities for `joints` joints, from one writer to one reader.

    `append_sample` never blocks and only copies the arrays. When the reader has fallen behind by
    `capacity` samples, new ones are dropped.

    Attributes:
        dropped: samples that found no room.
        newest: time of the last sample taken in [ns].
    """

    def __init__(self, capacity: int, width: int, joints: int) -> None:
        self.dropped = 0
        self.newest = 0
        self._capacity = capacity
        self._shape = (width, joints)
        # Appending and popping are safe between threads.
        self._samples: deque[tuple[int, list[Array]]] = deque()

    def __len__(self) -> int:
        return len(self._samples)

    def append_sample(self, time: int, quantities: Sequence[Array]) -> None:
        """Append one sample: its time [ns] and, per quantity, (joints,) values."""
        if len(self._samples) >= self._capacity:
            self.dropped += 1
            return
        self._samples.append((time, [values.copy() for values in quantities]))
        self.newest = time

    def take_samples(self, limit: int) -> tuple[Times, Array]:
        """Remove and return up to `limit` oldest samples: times (K,) [ns], rows (K, width, N)."""
        count = min(len(self._samples), limit)
        samples = [self._samples.popleft() for _ in range(count)]
        times = np.array([time for time, _ in samples], np.int64)
        rows = np.array([quantities for _, quantities in samples], np.float64)
        return times, rows.reshape(count, *self._shape)


class LinkPositions:
    """Forward kinematics of the origins of links, by Pinocchio.

    Args:
        urdf_xml: the URDF.
        joint_names: the moving joints, in the order of the columns of q.
    """

    def __init__(self, urdf_xml: str, joint_names: Sequence[str]) -> None:
        import pinocchio as pin

        self._model = model = pin.buildModelFromXML(urdf_xml)
        self._data = model.createData()
        self._places = [model.joints[model.getJointId(name)].idx_v for name in joint_names]

    def __call__(self, link: str, q: Array) -> Array:
        """Return p_WL (K, 3) [m], a link in the URDF's root frame, for q (K, N) [rad or m]."""
        import pinocchio as pin

        frame, neutral = self._model.getFrameId(link, pin.FrameType.BODY), pin.neutral(self._model)
        p, positions = np.empty((len(q), 3)), np.zeros(self._model.nv)
        for k, row in enumerate(q):
            positions[self._places] = row
            pin.framesForwardKinematics(
                self._model, self._data, pin.integrate(self._model, neutral, positions)
            )
            p[k] = self._data.oMf[frame].translation
        return p
