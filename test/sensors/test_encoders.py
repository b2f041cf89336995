"""Encoders: counts of known motions with each error, index pulses, words, losses."""

import math
from typing import Any

import numpy as np
import pytest
from draws import with_slow
from sensed_machine import (
    DRAWS,
    SIGMAS,
    TURN,
    draw_state,
    late,
    motion,
    rows,
    same,
    set_all,
    truth,
    write,
)

from arm_emulator import Plant, Refusal, Scene, load_scene


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> Scene:
    return load_scene(write(tmp_path_factory.mktemp("sensed")))


@pytest.mark.parametrize("direction", with_slow([1.0, -1.0], 1), ids=["up", "down"])
def test_index_pulses_come_where_a_turn_is_full(scene: Scene, direction: float) -> None:
    """As often as the disc passes a multiple of a turn between ticks; the newest is latched."""
    plant = Plant(scene)
    plant.reset(v=direction * np.array([6.0, 6.0, 6.0]))
    reported = motion(plant, np.random.default_rng(2), 400)
    for joint, per_turn, delay, names in (
        (0, 1000, 0, ("encoder_counts", "index_counts", "index_pulses")),
        (1, 1024, 0, ("encoder_counts", "index_counts", "index_pulses")),
        (1, 100_000, 4, ("link_encoder_counts", "link_index_counts", "link_index_pulses")),
    ):
        counts, index, pulses = (rows(reported, name)[:, joint] for name in names)
        revolutions = counts // per_turn
        passed = np.abs(np.diff(revolutions)).cumsum()
        np.testing.assert_array_equal(pulses[1:], passed, f"pulses of {names[0]} {joint}")
        up = np.diff(revolutions) > 0
        newest = np.where(up, revolutions[1:], revolutions[:-1] + 0) * per_turn
        newest = np.where(~up, (revolutions[1:] + 1) * per_turn, newest)
        arrived = np.diff(revolutions) != 0
        np.testing.assert_array_equal(index[1:][arrived], newest[arrived], f"{names[1]} at a pulse")
        holding = ~arrived
        np.testing.assert_array_equal(
            index[1:][holding], index[:-1][holding], f"{names[1]} between"
        )
        assert delay or arrived.sum() > 4, f"{arrived.sum()} pulses"


def test_a_word_has_as_many_bits_as_a_servo_computes_with() -> None:
    """Up to 48; and as many as a turn takes, 12 for 4096 counts."""
    encoder = {"kind": "absolute", "counts_per_turn": 4096}
    for bits in (12, 48):
        scene = load_scene("three_axis", {"joints.elbow.encoder": encoder | {"bits": bits}})
        assert scene.joints[2].encoder is not None and scene.joints[2].encoder.wrap == 2**bits
    for bits in (11, 49, 64):
        with pytest.raises(
            Refusal, match=r"elbow.encoder.bits must be a whole number from 12 to 48"
        ):
            load_scene("three_axis", {"joints.elbow.encoder": encoder | {"bits": bits}})


ENCODERS = (
    # joint, section, what is measured, true angle, counts per turn, what a turn is, word, delay
    ("turn", "encoder", "encoder_counts", "theta_m", 1000, TURN, 0, 0),
    ("turn", "link_encoder", "link_encoder_counts", "q", 4096, TURN, 2**14, 0),
    ("slide", "encoder", "encoder_counts", "theta_m", 1024, TURN, 0, 0),
    ("hand", "encoder", "encoder_counts", "theta_m", 1000, TURN, 2**10, 1),
)


of_every_encoder = pytest.mark.parametrize("which", ENCODERS, ids=lambda e: f"{e[0]} {e[1]}")


@of_every_encoder
def test_a_disc_that_sits_badly_shows_the_angle_that_its_errors_state(
    scene: Scene, which: tuple[Any, ...]
) -> None:
    joint, section, named_by, angle, per_turn, turn, word, delay = which
    rng = np.random.default_rng(len(joint + section))
    plant, j = Plant(scene), scene.joint_names.index(joint)
    errors = {"offset": rng.normal(), "eccentricity": 0.02, "eccentricity_phase": rng.normal(),
              "ripple": 0.01, "ripple_phase": rng.normal()}  # fmt: skip
    set_all(plant, {f"joints.{joint}.{section}.{key}": float(x) for key, x in errors.items()})
    plant.reset()
    reported = motion(plant, rng, 300)
    theta = truth(reported, angle)[:, j]
    t = theta * TURN / turn
    alpha = theta + errors["offset"] + 0.02 * np.sin(t + errors["eccentricity_phase"])
    alpha += 0.01 * np.sin(5 * t + errors["ripple_phase"])
    exact = late(alpha * per_turn / turn, delay)
    disc = np.floor(exact)
    counts = rows(reported, named_by)[:, j]
    off = counts - (disc % word if word else disc)
    near_edge = np.abs(exact - np.rint(exact)) < 1e-9 * np.abs(exact).max()
    assert np.ptp(disc) > 50, "it shall turn"
    assert (off[~near_edge] == 0).all(), f"counts off: {off[off != 0]}"
    assert near_edge.sum() <= 2, "angles at the very edge of a count"


@of_every_encoder
def test_noise_of_an_encoder_has_its_deviation(scene: Scene, which: tuple[Any, ...]) -> None:
    """At rest: normal noise of the angle, rounded down to counts."""
    joint, section, named_by, _, per_turn, turn, word, _ = which
    plant, j = Plant(scene), scene.joint_names.index(joint)
    sigma = 3.0 * turn / per_turn  # of three counts
    set_all(plant, {f"joints.{joint}.{section}.noise": sigma, "seed": 5.0})
    start = plant.scene.start
    plant.reset(start + 0.4 * turn * (1.0 if section == "link_encoder" else 0.02))
    counts = np.empty(DRAWS)
    for k in range(DRAWS):
        plant.exchange(np.zeros(3))
        counts[k] = getattr(plant.measured, named_by)[j]
    if word:
        counts = (counts - counts[0] + word // 2) % word
    # Rounding adds a twelfth of a count to the variance.
    expected = math.sqrt(9.0 + 1.0 / 12.0)
    assert np.std(counts) == pytest.approx(expected, rel=SIGMAS / math.sqrt(2 * DRAWS)), "deviation"
    white = np.corrcoef(counts[1:], counts[:-1])[0, 1]
    assert abs(white) < SIGMAS / math.sqrt(DRAWS), "correlation from tick to tick"


def test_edges_are_missed_as_often_as_is_stated(scene: Scene) -> None:
    """The counter lags by a binomial number; an index pulse reports, or sets it right."""
    for missed in (1e-3, 0.05):
        plant = Plant(scene)
        set_all(plant, {f"joints.{name}.encoder.missed": missed for name in ("turn", "slide")})
        set_all(plant, {"seed": 11.0})
        plant.reset(v=np.array([3.0, 3.0, 0.0]))
        reported = [(plant.measured, plant.state)]
        for _ in range(300):
            plant.exchange(np.array([24.0, 30.0, 0.0]))
            reported.append((plant.measured, plant.state))
        per_turn = np.array([1000, 1024])
        disc = np.floor(truth(reported, "theta_m")[:, :2] * per_turn / TURN)
        assert (np.diff(disc, axis=0) >= 0).all(), "one way only"
        lag = disc - rows(reported, "encoder_counts")[:, :2]
        edges = disc[-1] - disc[0]
        assert (edges > 8_000).all(), f"{edges} edges"
        expected, sigma = missed * edges, np.sqrt(edges * missed * (1 - missed))
        assert abs(lag[-1, 0] - expected[0]) < SIGMAS * sigma[0], "missed and not made up for"
        assert (np.diff(lag[:, 0]) >= 0).all(), "a counter that nobody sets right"
        index, pulses = rows(reported, "index_counts")[:, :2], rows(reported, "index_pulses")[:, :2]
        arrived = np.diff(pulses, axis=0) > 0
        # The index reports by how much the counter lags.
        latched = -index[1:, 0][arrived[:, 0]] % 1000
        assert (latched >= lag[:-1, 0][arrived[:, 0]]).all() and (
            latched <= lag[1:, 0][arrived[:, 0]]
        ).all()
        # Since the newest pulse about as many were missed as edges have passed.
        since = disc[1:, 1] % 1024
        bound = missed * 1024 + SIGMAS * math.sqrt(1024 * missed) + 5.0
        assert (lag[1:, 1] <= np.minimum(since, bound)).all() and (lag[:, 1] >= 0).all(), (
            "set right"
        )


def test_a_lost_word_repeats_the_word_before(scene: Scene) -> None:
    plant = Plant(scene)
    set_all(plant, {"joints.turn.link_encoder.missed": 0.3, "seed": 3.0})
    plant.reset(v=np.array([4.0, 0.0, 0.0]))
    reported = [(plant.measured, plant.state)]
    for _ in range(2000):
        plant.exchange(np.array([30.0, 0.0, 0.0]))
        reported.append((plant.measured, plant.state))
    word = np.floor(truth(reported, "q")[:, 0] * 4096 / TURN) % 2**14
    inputs = rows(reported, "link_encoder_counts")[:, 0]
    moved = np.diff(word) != 0
    repeated = inputs[1:] == inputs[:-1]
    assert (repeated | (inputs[1:] == word[1:])).all(), "either the word or the one before"
    share, sigma = repeated[moved].mean(), math.sqrt(0.3 * 0.7 / moved.sum())
    assert moved.sum() > 500, "it shall turn"
    assert share == pytest.approx(0.3, abs=SIGMAS * sigma), "share of words that did not come"


def test_an_encoder_is_displaced_while_the_machine_runs(scene: Scene) -> None:
    plant, second = Plant(scene), Plant(scene)
    for machine in (plant, second):
        motion(machine, np.random.default_rng(1), 60)
    before = plant.measured
    plant.set_parameter("joints.turn.encoder.offset", TURN / 8.0)
    assert same(plant.measured, before), "what was measured at this tick stays"
    for machine in (plant, second):
        machine.exchange(np.ones(3))
    np.testing.assert_array_equal(plant.state.q, second.state.q, "the motion is the same")
    slipped = plant.measured.encoder_counts - second.measured.encoder_counts
    assert slipped.tolist() == [125, 0, 0], "an eighth of 1000 counts"


def test_a_machine_put_elsewhere_is_measured_there_with_its_missed_edges(scene: Scene) -> None:
    plant = Plant(scene)
    set_all(plant, {"joints.turn.encoder.missed": 0.05})
    plant.reset()
    motion(plant, np.random.default_rng(5), 200)
    lag = math.floor(plant.state.theta_m[0] * 1000 / TURN) - plant.measured.encoder_counts[0]
    pulses = plant.measured.index_pulses.tolist()
    assert lag != 0, "some shall be missed"
    draw_state(np.random.default_rng(6), plant)
    x, measured = plant.state, plant.measured
    counts = np.floor(x.theta_m * np.array([1000, 1024, 1000]) / TURN)
    expected = [counts[0] - lag, counts[1], counts[2] % 1024]
    assert measured.encoder_counts.tolist() == expected, "no count was passed on the way"
    assert measured.index_pulses.tolist() == pulses, "nor an index"
    np.testing.assert_allclose(
        measured.current, x.current, atol=1e-12, err_msg="as if it had been so for long"
    )
    assert measured.link_encoder_counts[1] == math.floor(x.q[1] * 100_000)
    plant.reset()
    assert not plant.measured.index_pulses.any(), "a reset forgets"
    assert plant.measured.encoder_counts[0] == 0, "what was missed, too"
