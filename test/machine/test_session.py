"""Ticks and answers: what a session takes, what it refuses, when it moves on."""

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
    run = session()
    assert run.phase is Phase.FREE_RUNNING and run.may_advance
    run.offer(0, NAMES, [1.0, 2.0, 3.0])
    assert run.phase is Phase.RUNNING and run.may_advance and run.is_answered
    run.advance()
    assert run.tick == 1 and run.plant.t == 1e-3
    assert run.phase is Phase.WAITING and not run.may_advance
    assert np.array_equal(run.measured.applied, [1.0, 2.0, 3.0])


def test_start_on_first_answer_and_paused_stand_still() -> None:
    run = session(start="first_answer")
    assert run.phase is Phase.WAITING and not run.may_advance
    run.offer(0, NAMES, ZERO)
    assert run.may_advance
    run = session(start="paused")
    run.offer(0, NAMES, ZERO)
    assert run.phase is Phase.PAUSED and not run.may_advance
    run.paused = False
    assert run.phase is Phase.RUNNING


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
    run = session(clock)
    with pytest.raises(Refusal, match=f"motor_commands: {words}"):
        run.offer(tick, names, voltage)
    assert run.phase is Phase.FREE_RUNNING and not run.is_answered
    run.offer(0, NAMES, [4.0, 5.0, 6.0])
    with pytest.raises(Refusal):
        run.offer(tick, names, voltage)
    run.advance()
    assert np.array_equal(run.measured.applied, [4.0, 5.0, 6.0])


def test_an_answer_is_the_same_if_its_bits_are_whatever_the_order_of_joints() -> None:
    """Repeats and answers of another tick: the random offers below."""
    run = session()
    run.offer(0, NAMES, [1.0, 2.0, 3.0])
    with pytest.raises(DuplicateCommand, match=r"tick must be answered once, got 0 \(repeated\)"):
        run.offer(0, ["elbow", "waist", "shoulder"], [3.0, 1.0, 2.0])
    run.advance()
    assert np.array_equal(run.measured.applied, [1.0, 2.0, 3.0])
    with pytest.raises(Refusal, match=r"\(stale\)") as refusal:
        run.offer(0, NAMES, [1.0, 2.0, 3.0000000000000004])
    assert not isinstance(refusal.value, DuplicateCommand)


def test_step_moves_a_paused_session_by_a_tick() -> None:
    run = session()
    assert run.step() == "not paused, pause first"
    run.paused = True
    assert run.step() == "" and run.tick == 1  # nobody has answered yet: at 0 V
    run.offer(1, NAMES, ZERO)
    assert run.step() == "" and run.tick == 2
    assert run.step() == "no motor command answers tick 2 yet"
    assert run.tick == 2


def test_reset_restarts() -> None:
    run = session(start="paused")
    run.paused = False
    first = run.state.q.copy()
    run.offer(0, NAMES, [40.0, 40.0, 40.0])
    run.advance()
    run.reset()
    assert run.tick == 0 and run.phase is Phase.PAUSED and not run.is_answered
    assert np.array_equal(run.state.q, first) and run.plant.t == 0.0


def test_logical_time_ends_where_the_stamps_of_messages_end() -> None:
    run = session()
    run.plant.ticks.tick = 2**31 * 1000 - 3  # servo periods of 1 ms
    for tick in range(run.tick, run.tick + 2):
        run.offer(tick, NAMES, [1.0, 0.0, 0.0])
        run.advance()
    before = run.state.q.copy()
    run.offer(run.tick, NAMES, [1.0, 0.0, 0.0])
    run.advance()
    assert run.phase is Phase.STOPPED and run.logical_ns < 2**31 * 10**9
    assert np.array_equal(run.state.q, before), "the machine has moved without time"
    assert str(run.fault).startswith("logical time ends at 2**31 s")
    run.reset()
    assert run.may_advance


def test_a_diverged_machine_stops_until_reset() -> None:
    overrides = {"integrator.scheme": "paper", "integrator.dt": 1e-2, "servo_period": 1e-2}
    run = Session(load_scene("three_axis", overrides=overrides), "realtime", "free_run")
    run.offer(0, NAMES, [20.0, -20.0, 10.0])
    for _ in range(10_000):
        if not run.may_advance:
            break
        run.advance()
    assert run.phase is Phase.STOPPED and run.fault is not None
    assert np.isfinite(run.state.q).all()
    run.paused = True
    assert run.step().startswith("stopped, reset first: Plant.advance: joint ")
    run.reset()
    assert run.may_advance


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
def test_random_offers_are_classified_by_their_ticks_and_bits(clock: str) -> None:
    """Against a list of the accepted commands of the run, of which the last two are known."""
    rng, run = np.random.default_rng(7), session(clock, "first_answer")
    accepted: list[tuple[int, float]] = []
    left, kinds = -1, set()
    for _ in range(3000):
        now, tick = run.tick, run.tick + int(rng.integers(-4, 3))
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
        kinds.add(kind)
        if kind == "new":
            run.offer(tick, NAMES, [volt, 0.0, 0.0])
            accepted[-1:] = [*accepted[-1:], (tick, volt)] if tick != newest else [(tick, volt)]
        else:
            with pytest.raises(Refusal, match=rf"tick must be .* \({kind}\)") as refusal:
                run.offer(tick, NAMES, [volt, 0.0, 0.0])
            assert isinstance(refusal.value, DuplicateCommand) == (
                kind in ("repeated", "before the reset")
            )
        if rng.random() < 0.01:
            left, accepted = run.tick, []
            run.reset()
        elif run.may_advance and rng.random() < 0.5:
            run.advance()
            assert run.measured.applied[0] == (accepted[-1][1] if accepted else 0.0)
    assert kinds == {"new", "repeated", "stale", "future", "before the reset"}
