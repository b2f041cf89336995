"""Arms that meet an event go through a queue to a kernel of their own, and nothing shows it."""

import ctypes
from typing import Any

import numpy as np
import pytest
from draws import some
from test_fleet_on_device import Pair, device, located

from arm_emulator import Scene
from arm_emulator_fleet import Fleet
from arm_emulator_fleet.device import Module
from arm_emulator_fleet.unit import KERNELS

__all__ = ["device", "located"]
pytest_plugins = ["devices"]

COUNT = 38  # all groups of a device are full: others always queue
GROUPS = COUNT // 2
BLOCKS = 1, 32, 64, 1024


@pytest.fixture
def queued(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """How many groups have queued in each period; their order is shuffled."""
    lengths: list[int] = []
    rng = np.random.default_rng(7)
    launch = Module.launch

    def launch_and_shuffle(self: Module, kernel: str, threads: int, *given: Any, block: int) -> None:
        launch(self, kernel, threads, *given, block=block)
        if kernel != "fleet_advance_smoothly":
            return
        call = KERNELS.ffi.from_buffer("fleet_advance_call *", given[0])
        begin = KERNELS.constant("FLEET_QUEUE_BEGINS")
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
    located: Scene, device: str, queued: list[int], block: int, seed: int
) -> None:
    """Brakes, arms without power, arms that diverge, events in time, and arms that have none."""
    pair = Pair(located, COUNT, device, seed)
    pair.fleets[1].core.block = block
    rng = np.random.default_rng(seed)
    disturb = pair.power, pair.throw, pair.reset, pair.set_parameter, pair.push, pair.aim
    for _ in range(6):
        disturb[rng.integers(len(disturb))]()
        for advance in (pair.follow, pair.step, pair.run, pair.advance):
            advance()
            pair.assert_alike(advance.__name__)
    assert any(0 < length < GROUPS for length in queued) and max(queued) == GROUPS


def test_arms_without_events_do_not_queue(
    located: Scene, device: str, queued: list[int]
) -> None:
    """Joints that slide at constant voltages; then one arm of many loses its power."""
    fleets = [Fleet(located, COUNT, device=place) for place in (None, device)]
    for fleet in fleets:
        fleet.exchange(rows := np.tile([6.0, 2.0, 2.0], (COUNT, 1)))
        fleet.step(rows, 60)
    queued.clear()
    for fleet in fleets:
        frame = fleet.step(rows, 20)
    assert queued == 20 * [0]
    on = np.arange(COUNT) != 5
    for fleet in fleets:
        fleet.powered = on
        frame = fleet.step(rows, 20)
    assert queued[20:] == 20 * [1]
    first, second = (fleet.save() for fleet in fleets)
    assert first == second and frame.q.numpy().any()
