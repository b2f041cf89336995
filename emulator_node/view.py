"""The arm in Rerun: ticks and targets as they arrive."""

from geometry_msgs.msg import PoseStamped

from arm_emulator.machine.session.session import Session
from arm_emulator.ros.messages.event_words import describe_motion
from arm_emulator.ros.messages.time_stamp import convert_to_nanoseconds
from arm_emulator.runs.view_of import get_view
from arm_emulator.view.rerun_stream import RerunStream
from arm_emulator_msgs.msg import MotionStatus


class MachineView:
    """Display of a session.

    Args:
        session: the machine.
        file: Rerun recording to write, none if empty.
        port: port for a viewer, 0 for none.

    Raises:
        Refusal: see `RerunStream`.
    """

    def __init__(self, session: Session, file: str, port: int) -> None:
        self._session = session
        view = get_view(session.scene)
        self._further = list(view["further"])
        self._stream = RerunStream(**view, file=file or None, port=port or None)

    @property
    def dropped(self) -> int:
        """Samples dropped for lack of time."""
        return self._stream.dropped

    @property
    def is_open(self) -> bool:
        """Whether ticks are shown."""
        return self._stream.is_open

    def show_tick(self) -> None:
        """Show this tick."""
        if not self.is_open:
            return
        session, state = self._session, self._session.state
        self._stream.show_state(
            session.logical_ns,
            state.q,
            state.v,
            state.gear_torque,
            state.current,
            session.measured.applied,
            (session.measured.encoder_counts + 0.5) * session.plant.link_angle_per_count,
            [getattr(session.measured, name) for name in self._further],
        )

    def show_target(self, target: PoseStamped) -> None:
        """Show a target beside the arm; the machine does not use it."""
        p = target.pose.position
        self._stream.offer_target(convert_to_nanoseconds(target.header.stamp), (p.x, p.y, p.z))

    def show_motion(self, status: MotionStatus) -> None:
        """Show the state of a motion as an event."""
        text, stamp = describe_motion(status), status.header.stamp
        self._stream.offer_text(convert_to_nanoseconds(stamp), text)

    def show_event(self, text: str, level: str = "INFO") -> None:
        """Show an event at this tick."""
        self._stream.offer_text(self._session.logical_ns, text, level)

    def close(self) -> None:
        """Finish the recording."""
        self._stream.close()
