"""The programs of examples/ for a card, on the processor: their laws, against plain loops."""

import copy
from typing import Any

import numpy as np
import pytest
from draws import with_slow
from test_library_examples import EXAMPLES

from arm_emulator import Plant, load_scene
from arm_emulator_fleet import Fleet


@pytest.fixture(autouse=True)
def _examples(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(str(EXAMPLES))


def rolled_out(mppi: Any, controller: Any, plant: Plant, seed: int) -> tuple[Any, Any]:
    """Return shares of the commands and costs of rollouts, by copies of a single machine."""
    rng, count = np.random.default_rng(seed), len(controller.fleet)
    N = len(plant.scene.joints)
    noise = rng.normal(0.0, mppi.SPREAD, (mppi.HORIZON // mppi.HELD, count, N))
    shifts = rng.integers(count, size=len(noise))
    shares, costs = np.zeros((count, mppi.HORIZON, N)), np.zeros(count)
    for rollout in range(count):
        arm = copy.copy(plant)
        for k, mean in enumerate(controller.plan):
            own = noise[k // mppi.HELD, (rollout - shifts[k // mppi.HELD]) % count]
            share = shares[rollout, k] = np.clip(mean + own, -1.0, 1.0)
            for _ in range(controller.periods):
                arm.exchange(plant.scene.largest_commands * share)
            off = np.abs(arm.state.q - controller.target) + mppi.SLOW * np.abs(arm.state.v)
            control = mppi.TEMPERATURE * (mean / mppi.SPREAD**2) @ share
            costs[rollout] += off.sum() + control
    return shares, costs


@pytest.mark.parametrize("device", with_slow([None, "processor"], 1))
@pytest.mark.parametrize("library", with_slow(["numpy", "torch"], 1))
def test_a_decision_is_the_weighed_mean_of_rollouts(
    device: str | None, library: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Williams et al. 2017: weights exp(-S / lambda), S with the cost of the control."""
    xp = pytest.importorskip(library)
    import mppi  # type: ignore[import-not-found]

    monkeypatch.setattr(mppi, "TEMPERATURE", 20.0)  # several of few rollouts have a weight
    monkeypatch.setattr(mppi, "SPREAD", 0.3)
    scene = load_scene("three_axis")
    plan = np.random.default_rng(4).uniform(-0.2, 0.2, (mppi.HORIZON, 3))
    plan[3, 1] = 1.0  # at the largest command: shares are clipped
    arm, plant = Fleet(scene, 1, device=device), Plant(scene)
    began = np.array([9.0, -7.0, 5.0])
    arm.exchange(began)
    plant.exchange(began)
    controller = mppi.Mppi(scene, scene.start + 0.1, 7, device, xp, seed=8)
    controller.plan = xp.asarray(plan.copy())
    command = np.asarray(controller.decide(arm))
    reference = copy.copy(controller)
    reference.plan = plan
    reference.target = scene.start + 0.1
    shares, costs = rolled_out(mppi, reference, plant, seed=8)
    weights = np.exp(-(costs - costs.min()) / mppi.TEMPERATURE)
    assert 1.05 < weights.sum() < 6.0, "one alone decides, or all do alike"
    mean = (weights[:, None, None] * shares).sum(axis=0) / weights.sum()
    # Costs of 25 terms of some 1 rad, in units of a temperature of 20: 1e-15 of a weight.
    np.testing.assert_allclose(command, scene.largest_commands * mean[:1], rtol=1e-11)
    np.testing.assert_allclose(np.asarray(controller.plan)[:-1], mean[1:], rtol=1e-11, atol=1e-13)


@pytest.mark.slow
def test_rollouts_bring_an_arm_to_its_target() -> None:
    import mppi

    lanes, _ = mppi.main(rollouts=64, seconds=1.0)
    on_device, _ = mppi.main(rollouts=64, seconds=1.0, device="processor")
    assert lanes.tobytes() == on_device.tobytes()
    # 0.4 rad away at first; shares of 0.03 at a supply of 48 V, over 0.02 s, move a link by some
    # 0.01 rad, and 64 rollouts leave a part of that in their mean.
    assert lanes[0] > 0.35 and lanes[-10:].mean() < 0.08


@pytest.mark.slow
@pytest.mark.parametrize("device", with_slow([None, "processor"], 1))
@pytest.mark.parametrize("library", with_slow(["numpy", "torch"], 1))
def test_a_search_follows_its_rule(device: str | None, library: str) -> None:
    """Mania et al. 2018, V1: the step is the mean of differences times what was tried."""
    xp = pytest.importorskip(library)
    import train_reach  # type: ignore[import-not-found]

    scene = load_scene("three_axis", train_reach.MACHINE)
    search = train_reach.Search(scene, 4, device, xp, seed=2)
    tried = np.random.default_rng(2).normal(0.0, train_reach.TRIED, (4, 12, 3))
    rewards_of_both = []
    for side in (1.0, -1.0):
        rewards = np.zeros(4)
        for arm in range(4):  # each by the same weights for all arms
            rewards[arm] = np.asarray(search.play(search.put(side * tried[arm]), 1))[arm]
        rewards_of_both.append(rewards)
    more, less = rewards_of_both
    mean = float(search.improve())
    assert mean == pytest.approx(0.5 * (more + less).mean(), rel=1e-12)
    deviation = np.concatenate(rewards_of_both).std()
    slope = np.tensordot(more - less, tried, 1) / (4 * train_reach.TRIED * deviation)
    # Differences of rewards lose 1e3 of their last place.
    np.testing.assert_allclose(np.asarray(search.weights), train_reach.RATE * slope, rtol=1e-9)


def test_a_search_learns(tmp_path: Any) -> None:
    import train_reach

    picture = tmp_path / "reach.png"
    how = {"arms": 32, "rounds": 25, "picture": picture}
    search, curve = train_reach.main("three_axis", **how)
    assert len(curve) == 25 and picture.stat().st_size > 1000
    without, learnt = (
        search.play(weights, 99).mean() for weights in (0.0 * search.weights, search.weights)
    )
    # Arms without a policy stay 0.33 rad a joint away in the mean, or fall further.
    assert learnt > 0.75 * without, (without, learnt)
