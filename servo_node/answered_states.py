"""The servo's hot path in C (c/answered_states.h)."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from rclpy.subscription import Subscription

from arm_emulator.base.bound import BRAKE_CLOSED, COMMAND, CURRENT, EFFORT, POSITION, VELOCITY
from arm_emulator.build.c_header import CData, pointer
from arm_emulator.build.unit import compiled_once
from arm_emulator.ros.fixed_layout import FixedLayout, Taking
from arm_emulator.ros.middleware import Outgoing, middleware, pattern_of
from arm_emulator.servo.drives import Drives
from arm_emulator.servo.servo_config import ServoConfig
from arm_emulator.servo.servo_law import servo_law
from servo_node.c import ANSWERED_STATES, answered_states_unit

# Where C finds the numbers of a message: names in answered_states.h, and in the message.
STATES = {
    "stamp_at": "header.stamp.sec", "tick_at": "tick", "powered_at": "powered",
    "machine_at": "machine", "counts_at": "encoder_counts", "current_at": "current",
    "applied_at": "applied", "brakes_at": "brake_closed",
}  # fmt: skip
TARGETS = {
    "stamp_at": "header.stamp.sec", "q_at": "position", "v_at": "velocity", "tau_at": "effort",
}  # fmt: skip

answered_states = compiled_once(answered_states_unit)


OPTIONAL = ("applied", "brake_closed", "velocity", "effort")  # arrays that may be empty


class AnsweredStates:
    """The hot path of the servo.

    States of the next tick and targets that are due, in the form that Python has taken before, are
    taken and answered in C; all others are Python's.

    Attributes:
        at: ``answered_states *``: where the servo is, for both.
        movable, q, v, tau: what C publishes of the joints, (N,) each.
        takes, outgoing: see `HotPath`.

    Args:
        config: of the servo.
        drives: the drives.
        lockstep: whether each motion period waits for its targets.
        motion_ticks: servo periods in a motion period.
        report_ticks: servo periods between joint states.
    """

    def __init__(
        self,
        config: ServoConfig,
        drives: Drives,
        *,
        lockstep: bool,
        motion_ticks: int,
        report_ticks: int,
    ) -> None:
        law, servo, N = servo_law(), drives.servo, len(config.joint_names)
        self._names = list(config.joint_names)
        self.movable = np.zeros(N, np.int64)
        self.q, self.v, self.tau = np.zeros((3, N))
        self._brake = np.zeros(N, np.int64)
        self._kept: dict[str, list[object]] = {}  # what the patterns of C need
        self._layouts: dict[str, FixedLayout | None] = {}
        self.takes: list[tuple[Subscription, CData, CData]] = []
        self.outgoing: tuple[Outgoing, ...] = ()
        places = ("counts", "current", "applied", "q", "v", "tau", "volts")
        self.at = ANSWERED_STATES.new(
            "answered_states",
            lockstep=lockstep,
            arm=servo.arm,
            measure=law.servo_measure,
            brakes=law.servo_brakes,
            aim=law.servo_aim,
            command=law.servo_command,
            publish=middleware().ros_publish,
            brake=self._brake,
            movable=self.movable,
            q_measured=self.q,
            v_measured=self.v,
            tau_measured=self.tau,
            period=round(config.period * 1e9),
            motion_ticks=motion_ticks,
            report_ticks=report_ticks,
            **dict(zip(places, servo.places, strict=True)),
        )
        bounds = {
            "counts": config.counts, "current": CURRENT, "applied": COMMAND,
            "brake": BRAKE_CLOSED, "q": POSITION, "v": VELOCITY, "tau": EFFORT,
        }  # fmt: skip
        self._most = {
            name: np.broadcast_to(np.float64(bound.most), N).copy()
            for name, bound in bounds.items()
        }
        for name, most in self._most.items():
            setattr(self.at.most, name, pointer(most))

    def connect(
        self,
        states: tuple[Taking, Subscription],
        targets: tuple[Taking, Subscription],
        outgoing: tuple[Outgoing, Outgoing, Outgoing],
    ) -> None:
        """Take messages of motor states and joint targets.

        Args:
            states: Python's taker of motor states, and its subscription.
            targets: the same of joint targets.
            outgoing: motor commands, servo states and joint states.
        """
        code, argument = answered_states(), ANSWERED_STATES.ffi.cast("void *", self.at)
        self._taking = {"in": states[0], "wanted": targets[0]}
        self.takes.append((states[1], code.answered_states_take, argument))
        self.takes.append((targets[1], code.answered_states_aim, argument))
        self.outgoing = outgoing
        self.at.motor_command, self.at.servo_state, self.at.joint_state = (
            one.struct for one in outgoing
        )

    def begin(self, open_: bool) -> None:
        """Let C take messages, if it may."""
        for name, names, places in (("in", "joint_names", STATES), ("wanted", "name", TARGETS)):
            self._describe(name, names, places)
        self.at.open = open_
        self.at.states = self.at.answers = 0

    def _describe(self, name: str, names: str, places: Mapping[str, str]) -> None:
        """Describe to C the messages that Python has taken on a topic."""
        layout, known = self._taking[name].layout, self._names
        if layout is None or layout is self._layouts.get(name):
            return
        keep = self._kept[name] = []
        self._layouts[name] = layout
        form, fields = getattr(self.at, name), vars(layout.message)
        form.pattern = pattern_of(layout, keep)[0]
        given = list(fields[names])
        lengths = {path: len(fields[path]) for path in places.values() if np.ndim(fields.get(path))}
        fits = sorted(given) == sorted(known) and all(
            length == len(known) or (length == 0 and path in OPTIONAL)
            for path, length in lengths.items()
        )
        if not fits:
            form.pattern.size = 0
            return
        place = np.array([known.index(one) for one in given], np.int64)
        keep.append(place)
        form.place = pointer(place)
        for field, path in places.items():
            setattr(form, field, layout.places[path])
