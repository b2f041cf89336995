"""Arms that meet an event go through a queue to a kernel of their own, and nothing shows it."""

import ctypes
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from draws import some
from fleet_pairs import Pair, device, find_servo, located
from test_fleet_follow import ROWS
from test_fleet_step import LOCATED

from arm_emulator import Refusal, Scene, load_scene
from arm_emulator.extension.machine import PowerChange
from arm_emulator_fleet import Fleet, FleetControl
from arm_emulator_fleet.device import Module
from arm_emulator_fleet.fleet_schedule import FleetWay
from arm_emulator_fleet.servo_fleet import ServoFleet
from arm_emulator_fleet.unit import KERNELS

__all__ = ["device", "located"]
pytest_plugins = ["devices"]

COUNT = 38  # all groups of a device are full: others always queue
GROUPS = COUNT // 2
BLOCKS = 1, 32, 64, 1024
# A device has the states of arms whose drives are alike in rows, of others in their groups.
DRIVES = {"drives vary": LOCATED, "drives alike": {**LOCATED, "varied": ["links.forearm.mass"]}}


@pytest.fixture(scope="module", params=list(DRIVES))
def scene(request: pytest.FixtureRequest) -> Scene:
    return load_scene("three_axis", overrides=DRIVES[request.param])


@pytest.fixture
def queued(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """Return numbers of the groups that queue in each period; their order is shuffled."""
    lengths: list[int] = []
    rng = np.random.default_rng(7)
    launch = Module.launch

    def launch_and_shuffle(
        self: Module, kernel: str, threads: int, *given: Any, block: int
    ) -> None:
        launch(self, kernel, threads, *given, block=block)
        if kernel != "fleet_advance_to_event":
            return
        call = KERNELS.ffi.from_buffer("fleet_advance_call *", given[0])
        begin = KERNELS.get_constant("FLEET_QUEUE_BEGINS")
        address = int(KERNELS.ffi.cast("uintptr_t", call.queue))
        queue = np.ctypeslib.as_array((ctypes.c_int32 * (begin + threads)).from_address(address))
        length = int(queue[call.period % 2])
        lengths.append(length)
        groups = queue[begin : begin + length]
        assert len(set(groups)) == length and ((groups >= 0) & (groups < threads)).all()
        rng.shuffle(groups)

    monkeypatch.setattr(Module, "launch", launch_and_shuffle)
    return lengths


@pytest.mark.parametrize("block", some(BLOCKS, 2))
@pytest.mark.parametrize("seed", some(range(6), 1))
def test_any_groups_in_any_order_give_the_bits_of_lanes(
    scene: Scene, device: str, queued: list[int], block: int, seed: int
) -> None:
    """Brakes, arms without power, arms that diverge, events in time, and arms that have none."""
    pair = Pair(scene, COUNT, device, seed)
    pair.fleets[1].core.block = block
    rng = np.random.default_rng(seed)
    disturb = pair.power, pair.throw, pair.reset, pair.set_parameter, pair.push, pair.aim
    for _ in range(6):
        disturb[rng.integers(len(disturb))]()
        for advance in (pair.follow, pair.step, pair.run, pair.advance):
            advance()
            pair.assert_alike(advance.__name__)
    assert any(0 < length < GROUPS for length in queued) and max(queued) == GROUPS


def test_arms_without_events_do_not_queue(scene: Scene, device: str, queued: list[int]) -> None:
    """Joints slide at constant voltages; then one arm of many loses its power."""
    fleets = [Fleet(scene, COUNT, device=place) for place in (None, device)]
    for fleet in fleets:
        fleet.exchange(rows := np.tile([6.0, 2.0, 2.0], (COUNT, 1)))
        fleet.step(rows, 60)
    queued.clear()
    for fleet in fleets:
        fleet.step(rows, 20)
    assert queued == 20 * [0]
    on = np.arange(COUNT) != 5
    for fleet in fleets:
        fleet.powered = on
        fleet.step(rows, 20)
    assert queued[20:] == [GROUPS, *(19 * [1])], "all have been changed before the first period"
    first, second = (fleet.save() for fleet in fleets)
    assert first == second and fleets[0].state.q.any()


def test_a_change_waits_for_its_tick_if_an_event_is_late_in_the_first_period(
    located: Scene, device: str
) -> None:
    """A call begins amid a period; its first step reaches a tick, and arms stop in the second."""
    assert located.steps_per_period == 2
    v, servo = np.zeros((COUNT, len(located.joints))), find_servo(located)
    v[:, 0] = np.linspace(1e-4, 3e-4, COUNT)  # friction stops them after one step to four
    fleet, way = Fleet(located, COUNT, device=device), FleetWay(located, COUNT)
    way.set_changes([[(2, PowerChange(on=False))]] * COUNT)
    assert servo
    servos = ServoFleet(fleet, servo)

    def follow_after_a_step(periods: int) -> None:
        fleet.reset(v=v)
        servos.reset()
        servos.aim(np.asarray(located.start)[np.newaxis])
        fleet.advance(np.zeros(len(located.joints)), 1)
        fleet.follow(servos, periods, way=way)

    follow_after_a_step(1)
    stopped = fleet.state.v[:, 0] == 0.0
    assert stopped.any() and not stopped.all()
    follow_after_a_step(2)
    assert fleet.powered.all()
    follow_after_a_step(3)
    assert not fleet.powered.any()


def test_code_of_users_is_in_both_kernels_and_refuses_in_its_period(
    tmp_path: Path, located: Scene, device: str, queued: list[int]
) -> None:
    """Arm by arm it does not queue; over rows of lanes it is called once in every period."""
    count, file = 16, tmp_path / "law.c"
    file.write_text(ROWS)
    start = np.random.default_rng(2).uniform(-0.05, 0.05, (count, len(located.joints)))
    fleet = Fleet(located, count, device=device, kernels=[file], q=start)
    numbers = np.array([len(located.joints), -1, *[0] * count], np.int32)
    data, links = fleet.to_device(numbers), np.zeros((2, 40, count, len(located.joints)))
    fleet.follow(FleetControl("law_by_arm", data), 40, links=links[0])
    assert not queued
    fleet.reset(q=start)
    by_rows = FleetControl("law_by_rows", data, in_lanes=True)
    fleet.follow(by_rows, 40, links=links[1])
    np.testing.assert_array_equal(links[1], links[0])
    assert (data.numpy()[2:] == 40).all()
    assert len(queued) == 40 and any(0 < length < count // 2 for length in queued)
    numbers[1] = 9
    with pytest.raises(Refusal, match=r"Fleet\.follow: arm 9: .* must be finite, got nan"):
        fleet.follow(FleetControl("law_by_rows", fleet.to_device(numbers), in_lanes=True), 5)
    ticks = np.where(np.arange(count) // 2 == 4, 40, 45)
    np.testing.assert_allclose(fleet.state.t, ticks * located.servo_period, rtol=1e-12)
