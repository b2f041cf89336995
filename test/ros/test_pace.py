"""A limit of how fast logical time passes: never faster, and at most 0.1 s is made up for."""

import numpy as np
import pytest
from test_command_line import run

from arm_emulator.base.refusal import Refusal
from arm_emulator.machine.session.pace import UNLIMITED, Pace, parse_factor
from emulator_node.node import EmulatorParameters, check_pace

PERIOD = 1e-3
# s, wall: lost time that is made up for, and the interval at which short periods are left.
BEHIND, GRAIN = 0.1, 5e-3


class Wall:
    """A clock that stands until it is moved."""

    def __init__(self) -> None:
        self.now = 100.0

    def __call__(self) -> float:
        return self.now


@pytest.mark.parametrize("seed", range(20))
def test_ticks_pass_at_the_factor_whatever_a_tick_takes(seed: int) -> None:
    rng = np.random.default_rng(seed)
    factor = float(10.0 ** rng.uniform(-2, 2))
    wall = Wall()
    pace = Pace(PERIOD, wall)
    pace.factor = factor
    pace.compute_wait(0)  # it begins
    begun, tick, wall_period = wall.now, 0, PERIOD / factor
    while tick < 400:
        room = pace.count_ticks_left(tick)
        if not room:
            assert pace.compute_wait(tick) > 0.0
            # A timer that comes too late now and then, by at most half of what is made up for.
            wall.now += pace.compute_wait(tick) + rng.uniform(0.0, 0.5) * BEHIND * (
                rng.random() < 0.1
            )
            continue
        tick += int(rng.integers(1, room + 1))
        assert tick * wall_period <= wall.now - begun + 1e-9, "never faster"
    # Periods below the grain are left together at its end.
    assert wall.now - begun <= tick * wall_period + BEHIND + GRAIN, "lost time was made up for"


def test_longer_stops_are_not_caught_up() -> None:
    wall = Wall()
    pace = Pace(PERIOD, wall)
    pace.factor = 1.0
    pace.compute_wait(0)
    wall.now += 60.0  # paused
    assert pace.count_ticks_left(0) <= 1 and pace.compute_wait(0) == pytest.approx(GRAIN)
    wall.now += 0.02
    assert 18 <= pace.count_ticks_left(0) <= 20
    assert pace.compute_wait(-100) <= GRAIN + BEHIND, (
        "reset: tick 0 does not wait for the former one"
    )


def test_a_new_factor_holds_from_now_on() -> None:
    wall = Wall()
    pace = Pace(PERIOD, wall)
    assert pace.count_ticks_left(5) == UNLIMITED and pace.compute_wait(5) == 0.0
    pace.factor = 0.01
    assert pace.compute_wait(5) == pytest.approx(0.1)
    pace.factor = 2.0
    assert pace.compute_wait(5) == pytest.approx(GRAIN)


@pytest.mark.parametrize("factor", [0.05, 0.3, 1.0, 7.3])
def test_an_idle_network_wakes_once_a_grain_at_the_mean_rate_of_its_pace(factor: float) -> None:
    wall = Wall()
    pace = Pace(PERIOD, wall)
    pace.factor = factor
    pace.compute_wait(0)
    begun, tick, wakes = wall.now, 0, 0
    while wall.now - begun < 10.0:
        wall.now += max(0.0, pace.compute_wait(tick))
        tick += pace.count_ticks_left(tick)
        wakes += 1
    assert abs(tick * PERIOD / (wall.now - begun) - factor) <= 1e-3 * factor
    assert wakes <= 2 + 10.0 / max(GRAIN, PERIOD / factor)


def test_a_pace_is_a_factor_or_max() -> None:
    assert parse_factor("up", "max") == 0.0 and parse_factor("up", "2.5") == 2.5
    assert EmulatorParameters().real_time_factor == 1.0, "real pace, for people"
    for text in ("0", "-1", "nan", "inf", "fast", "", "1001", "1e-15"):
        with pytest.raises(Refusal, match="up: pace must be max, or times real time, at least"):
            parse_factor("up", text)


def test_real_time_has_the_pace_of_the_wall_clock() -> None:
    for factor in (0.0, 1.0):
        check_pace(EmulatorParameters(clock="realtime", real_time_factor=factor))
    check_pace(EmulatorParameters(clock="lockstep", real_time_factor=3.0))
    with pytest.raises(Refusal, match="real_time_factor must be 0 or 1 with clock realtime"):
        check_pace(EmulatorParameters(clock="realtime", real_time_factor=3.0))


def test_a_pace_at_which_a_tick_would_not_end_is_refused() -> None:
    """A timer cannot wait for 2^63 ns, and no user for days."""
    check_pace(EmulatorParameters(real_time_factor=1e-6))
    for factor in (9e-7, 1e-15, 5e-324):
        with pytest.raises(Refusal, match="real_time_factor must be 0, or at least 1e-06"):
            check_pace(EmulatorParameters(real_time_factor=factor))


@pytest.mark.parametrize(("words", "reason"), [
    (("--pace", "0"), "up: pace must be max, or times real time"),
    (("--pace", "max", "--clock", "realtime"), "up: --pace must be 1 with --clock realtime"),
])  # fmt: skip
def test_up_refuses_a_pace_that_cannot_be(words: tuple[str, ...], reason: str) -> None:
    code, out, errors = run("up", *words)
    assert code == 2 and not out and errors.startswith(reason), errors
