"""Ticks and answers: what a session takes, what it refuses, when it moves on."""

from __future__ import annotations

import time

import numpy as np
import pytest

from arm_emulator import Refusal, Session, load_scene
from arm_emulator.machine.session.command_buffer import DuplicateCommand
from arm_emulator.machine.session.phase import Phase

NAMES = ["waist", "shoulder", "elbow"]
ZERO = [0.0, 0.0, 0.0]


def session(clock: str = "lockstep", start: str = "free_run") -> Session:
    return Session(load_scene("three_axis"), clock, start)


def test_lockstep_leaves_a_tick_only_with_its_answer() -> None:
    one = session()
    assert one.phase is Phase.FREE_RUNNING and one.may_advance
    one.offer(0, NAMES, [1.0, 2.0, 3.0])
    assert one.phase is Phase.RUNNING and one.may_advance and one.answered
    one.advance()
    assert one.tick == 1 and one.plant.t == 1e-3
    assert one.phase is Phase.WAITING and not one.may_advance
    assert np.array_equal(one.measured.applied, [1.0, 2.0, 3.0])


def test_start_on_first_answer_and_paused_stand_still() -> None:
    one = session(start="first_answer")
    assert one.phase is Phase.WAITING and not one.may_advance
    one.offer(0, NAMES, ZERO)
    assert one.may_advance
    one = session(start="paused")
    one.offer(0, NAMES, ZERO)
    assert one.phase is Phase.PAUSED and not one.may_advance
    one.paused = False
    assert one.phase is Phase.RUNNING


@pytest.mark.parametrize("clock", ["lockstep", "realtime"])
@pytest.mark.parametrize(
    ("tick", "names", "voltage", "words"),
    [
        (
            0,
            ["waist", "shoulder", "hand"],
            ZERO,
            "joint must be one of the arm, got hand; valid: waist, shoulder, elbow",
        ),
        (0, ["waist", "waist", "elbow"], ZERO, "joint names must name every joint once"),
        (0, [], [], "joint names must name every joint once, got none; valid: waist"),
        (0, NAMES, [1.0, 2.0], r"command must have one value per joint name \(3\), got 2 values"),
        (0, NAMES, [1.0, float("nan"), 0.0], "command of shoulder must be finite, got nan"),
        (0, NAMES, [1.0, float("-inf"), 0.0], "command of shoulder must be finite, got -inf"),
        (1, NAMES, ZERO, r"tick must be at most 0, got 1 \(future\)"),
        (2**63, NAMES, ZERO, "tick must be at most 0"),
    ],
)
def test_bad_commands_change_nothing(
    clock: str, tick: int, names: list[str], voltage: list[float], words: str
) -> None:
    one = session(clock)
    with pytest.raises(Refusal, match=f"motor_commands: {words}"):
        one.offer(tick, names, voltage)
    assert one.phase is Phase.FREE_RUNNING and not one.answered
    one.offer(0, NAMES, [4.0, 5.0, 6.0])
    with pytest.raises(Refusal):
        one.offer(tick, names, voltage)
    one.advance()
    assert np.array_equal(one.measured.applied, [4.0, 5.0, 6.0])


def test_an_answer_is_the_same_if_its_bits_are_whatever_the_order_of_joints() -> None:
    """Repeats and answers of another tick: the random offers below."""
    one = session()
    one.offer(0, NAMES, [1.0, 2.0, 3.0])
    with pytest.raises(DuplicateCommand, match=r"tick must be answered once, got 0 \(repeated\)"):
        one.offer(0, ["elbow", "waist", "shoulder"], [3.0, 1.0, 2.0])
    one.advance()
    assert np.array_equal(one.measured.applied, [1.0, 2.0, 3.0])
    with pytest.raises(Refusal, match=r"\(stale\)") as refusal:
        one.offer(0, NAMES, [1.0, 2.0, 3.0000000000000004])
    assert not isinstance(refusal.value, DuplicateCommand)


def test_step_moves_a_paused_session_by_one_tick() -> None:
    one = session()
    assert one.step() == "not paused, pause first"
    one.paused = True
    assert one.step() == "" and one.tick == 1  # nobody has answered yet: at 0 V
    one.offer(1, NAMES, ZERO)
    assert one.step() == "" and one.tick == 2
    assert one.step() == "no motor command answers tick 2 yet"
    assert one.tick == 2


def test_reset_begins_anew() -> None:
    one = session(start="paused")
    one.paused = False
    first = one.state.q.copy()
    one.offer(0, NAMES, [40.0, 40.0, 40.0])
    one.advance()
    one.reset()
    assert one.tick == 0 and one.phase is Phase.PAUSED and not one.answered
    assert np.array_equal(one.state.q, first) and one.plant.t == 0.0


def test_logical_time_ends_where_the_stamps_of_messages_end() -> None:
    one = session()
    one.plant.ticks.tick = 2**31 * 1000 - 3  # servo periods of 1 ms
    for tick in range(one.tick, one.tick + 2):
        one.offer(tick, NAMES, [1.0, 0.0, 0.0])
        one.advance()
    before = one.state.q.copy()
    one.offer(one.tick, NAMES, [1.0, 0.0, 0.0])
    one.advance()
    assert one.phase is Phase.STOPPED and one.logical_ns < 2**31 * 10**9
    assert np.array_equal(one.state.q, before), "the machine has moved without time"
    assert str(one.fault).startswith("logical time ends at 2**31 s")
    one.reset()
    assert one.may_advance


def test_a_diverged_machine_stops_until_reset() -> None:
    overrides = {"integrator.scheme": "paper", "integrator.dt": 1e-2, "servo_period": 1e-2}
    one = Session(load_scene("three_axis", overrides=overrides), "realtime", "free_run")
    one.offer(0, NAMES, [20.0, -20.0, 10.0])
    for _ in range(10_000):
        if not one.may_advance:
            break
        one.advance()
    assert one.phase is Phase.STOPPED and one.fault is not None
    assert np.isfinite(one.state.q).all()
    one.paused = True
    assert one.step().startswith("stopped, reset first: Plant.advance: joint ")
    one.reset()
    assert one.may_advance


def test_the_time_of_steps_is_that_of_the_core_alone() -> None:
    session = Session(load_scene("three_axis"), "lockstep", "first_answer")
    assert session.step_wall_ns == 0
    began = time.perf_counter_ns()
    for _ in range(20):
        session.offer(session.tick, list(session.scene.joint_names), [1.0, 0.0, 0.0])
        session.advance()
    assert 0 < session.step_wall_ns < time.perf_counter_ns() - began
    spent = session.step_wall_ns
    session.plant.exchange([0.0, 0.0, 0.0])
    assert session.step_wall_ns > spent, "each exchange counts"
    spent = session.step_wall_ns
    _ = session.state, session.measured, session.energy, session.plant.save()
    assert session.step_wall_ns == spent, "looking at the machine does not"


@pytest.mark.parametrize("clock", ["lockstep", "realtime"])
def test_random_offers_are_what_their_ticks_and_bits_make_them(clock: str) -> None:
    """Against a list of the accepted commands of the run, of which the last two are known."""
    rng, one = np.random.default_rng(7), session(clock, "first_answer")
    accepted: list[tuple[int, float]] = []
    left, found = -1, set()
    for _ in range(3000):
        now, tick = one.tick, one.tick + int(rng.integers(-4, 3))
        volt = float(rng.integers(0, 2))
        newest = accepted[-1][0] if accepted else -1
        if tick > now:
            kind = "before the reset" if not accepted and tick <= left else "future"
        elif (tick, volt) in accepted[-2:]:
            kind = "repeated"
        elif tick < newest or (clock == "lockstep" and accepted and tick < now):
            kind = "stale"
        else:
            kind = "new"
        found.add(kind)
        if kind == "new":
            one.offer(tick, NAMES, [volt, 0.0, 0.0])
            accepted[-1:] = [*accepted[-1:], (tick, volt)] if tick != newest else [(tick, volt)]
        else:
            with pytest.raises(Refusal, match=rf"tick must be .* \({kind}\)") as refusal:
                one.offer(tick, NAMES, [volt, 0.0, 0.0])
            assert isinstance(refusal.value, DuplicateCommand) == (
                kind in ("repeated", "before the reset")
            )
        if rng.random() < 0.01:
            left, accepted = one.tick, []
            one.reset()
        elif one.may_advance and rng.random() < 0.5:
            one.advance()
            assert one.measured.applied[0] == (accepted[-1][1] if accepted else 0.0)
    assert found == {"new", "repeated", "stale", "future", "before the reset"}
