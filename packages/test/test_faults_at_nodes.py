"""Each fault gives the same over ROS 2 as at every other door (test_faults_at_doors.py)."""

import re
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from draws import with_slow
from machines import own_three_axis
from network import User, user
from rclpy.serialization import deserialize_message

from arm_emulator.ros.process.bringup import Bringup
from arm_emulator_msgs.msg import EmulatorStatus, MotorCommand, MotorState
from arm_emulator_msgs.srv import BreakWhen, SetVaried
from faults_at_doors import (
    BREAK,
    ELBOW,
    FEW,
    JOINTS,
    LATE,
    LINES,
    VOLT,
    Door,
    Refused,
    check,
)


class ByRos(Door):
    """An emulator node and a client of its topics."""

    title = "ROS 2, lock-step"

    def __init__(self, client: User) -> None:
        self.user = client

    def _begin(self) -> None:
        ask, user = self.user.call, self.user
        assert ask("emulator/break_when", BreakWhen.Request()).success
        for line in LINES:
            self._set_fault(f"faults.elbow.{line}", 0.0)
        self._power(True)
        assert ask("emulator/pause", False).success
        user.forget()
        assert ask("emulator/reset").success
        user.wait("tick 0", lambda: user.tick == 0)

    def _set_fault(self, name: str, size: float) -> None:
        request = SetVaried.Request(name=name, value=size)
        assert self.user.call("emulator/set_varied", request).success

    def _power(self, on: bool) -> None:
        assert self.user.call("emulator/power", on).success

    def _send(self, volts: list[float], tick: int, name: str) -> None:
        names = [*JOINTS[:ELBOW], name]
        message = MotorCommand(tick=tick, joint_names=names, command=volts)
        self.user.publish(self.user.commands, message)

    def _give(self, volt: float, tick: int | None, name: str) -> None:
        before, refused = self.tick, self._refused()
        self._send([0.0, 0.0, volt], before if tick is None else tick, name)
        done = lambda: self.tick > before or self._refused() > refused  # noqa: E731
        self.user.wait("an answer", done)
        self._look(refused)

    def _refused(self) -> int:
        return self.user.refused("emulator", "motor_commands")

    def _look(self, refused: int) -> None:
        if self._refused() > refused:
            raise Refused(self.user.value("emulator", "newest refusal"))

    def wait(self) -> None:
        self.user.node.spin_until(lambda: False, 0.3)

    def break_at(self, condition: str) -> None:
        assert self.user.call("emulator/break_when", BreakWhen.Request(condition=condition)).success

    def run(self, periods: int) -> None:
        for _ in range(BREAK + FEW):
            before = self.tick
            self._send([0.0, 0.0, VOLT], before, "elbow")
            self.user.node.spin_until(lambda before=before: self.tick > before, 0.5)
        assert self.user.status is not None
        assert self.user.status.phase == EmulatorStatus.PHASE_PAUSED

    @property
    def state(self) -> MotorState:
        return deserialize_message(self.user._raw_states[-1], MotorState)

    @property
    def tick(self) -> int:
        return self.user.tick

    @property
    def applied(self) -> float:
        return float(self.state.applied[ELBOW])

    def measured(self) -> list[float]:
        return [*map(float, self.state.encoder_counts), *map(float, self.state.current)]


class ByRosInRealTime(ByRos):
    """The waist's command, another one each time, shows when a command has come."""

    title = "ROS 2, wall clock"
    raw = False
    ahead = 20

    def _begin(self) -> None:
        super()._begin()
        self._count, self._on = 0, True

    def _power(self, on: bool) -> None:
        super()._power(on)
        self._on = on
        if not on:
            self.user.wait("a state without power", lambda: not self.state.powered)

    def kept(self) -> object:
        return self.state.applied.tolist()

    def _give(self, volt: float, tick: int | None, name: str) -> None:
        before, refused = self.tick, self._refused()
        self._count += 1
        waist = 0.01 * self._count
        self._send([waist, 0.0, volt], before if tick is None else tick, name)

        def done() -> bool:
            has_arrived = self.state.applied[0] == waist if self._on else self.tick > before + FEW
            return has_arrived or self._refused() > refused

        self.user.wait("an answer", done)
        self._look(refused)

    def stale(self) -> str:
        self.give(VOLT)
        self.give(VOLT)
        answered = self.tick  # or later
        self.give(VOLT)
        words = self._refusal(lambda: self.give(2.0 * VOLT, tick=answered - 1))
        return re.sub(r"\d+", "k", words)

    def nan(self) -> str:
        return super().nan().replace("0.01", "0.0")  # the waist's

    def late(self) -> str:
        self.set_fault("command_late", LATE)
        self.give(VOLT)
        self.user.wait("the elbow's command", lambda: self.comes)
        states = [deserialize_message(raw, MotorState) for raw in self.user._raw_states]
        begins = [next(state.tick for state in states if state.applied[j]) for j in (0, ELBOW)]
        if not {begin - 1 for begin in begins} <= {state.tick for state in states}:
            self.begin()  # a busy listener has missed a state
            return self.late()
        return f"{begins[1] - begins[0]} periods later"

    def breakpoint(self) -> str:
        self.give(VOLT)
        assert self.user.call("emulator/pause", True).success  # or time would pass the breakpoint
        self.user.wait("a pause", self._stands)
        return super().breakpoint()

    def run(self, periods: int) -> None:
        begun = self.tick
        assert self.user.call("emulator/pause", False).success
        self.user.wait("the breakpoint", lambda: self.tick > begun and self._stands())

    def _stands(self) -> bool:
        """Whether time stands, and the listener has heard of its last tick."""
        status = self.user.status
        if status is None or status.phase != EmulatorStatus.PHASE_PAUSED:
            return False
        return bool(self.tick == status.tick)


@contextmanager
def emulator(folder: Path, clock: str) -> Iterator[User]:
    """Run an emulator node, and a client that receives every state."""
    faults = ", ".join(f"elbow.{line}" for line in LINES)
    scene = str(own_three_axis(folder / "scene", f"faults: [{faults}]"))
    how = {"clock": clock, "start": "first_answer", "only": ("emulator",)}
    with user() as emulator_user, Bringup(scene, log=folder, **how) as nodes:
        emulator_user.wait("an active emulator", lambda: emulator_user.status)
        yield emulator_user
        assert set(nodes.stop_nodes().values()) == {0}


@pytest.mark.parametrize(
    ("door", "clock"), with_slow([(ByRos, "lockstep"), (ByRosInRealTime, "realtime")], 1)
)
def test_an_emulator_node(door: Callable[[User], Door], clock: str, tmp_path: Path) -> None:
    with emulator(tmp_path, clock) as client:
        check(door(client))
