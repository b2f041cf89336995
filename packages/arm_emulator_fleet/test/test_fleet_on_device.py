"""A fleet on a device gives the results of a fleet in lanes, to the last bit, for all calls."""

import gc
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from devices import Stub
from draws import some, with_slow
from fleet_pairs import ACTIONS, WRENCHED, Pair, device, find_servo, located, show
from machines import GANTRY, SENSED, gantry_urdf, write_scene
from test_fleet import BACKLASH, one_arm_after_the_other
from test_fleet_step import BRAKED, LOCATED
from test_lanes import JOINTS

from arm_emulator import ExternalWrench, Refusal, Scene, load_scene
from arm_emulator.extension.machine import PowerChange
from arm_emulator_fleet import Fleet, open_device
from arm_emulator_fleet.cuda_device import DRIVER, CudaDevice
from arm_emulator_fleet.device_core import STACK_WITH_EVENTS
from arm_emulator_fleet.fleet_schedule import FleetWay
from arm_emulator_fleet.processor_device import ProcessorDevice
from arm_emulator_fleet.servo_fleet import ServoFleet
from oracles.coupled_arms import ARMS
from oracles.mixtures import write_mixture

__all__ = ["device", "located"]
pytest_plugins = ["devices"]
COUNT = 11  # more than one group of lanes, and no number of groups of a device


def three_axis(keys: dict[str, Any]) -> Callable[[Path], Scene]:
    return lambda folder: load_scene("three_axis", overrides=keys)


def gantry(name: str) -> Callable[[Path], Scene]:
    """Return a scene of test_lanes.py; one has motors with inputs of their own and temperatures."""

    def write(folder: Path) -> Scene:
        joints = dict(zip(GANTRY, (joint for joint, _ in JOINTS[name]), strict=True))
        file = write_scene(
            folder, gantry_urdf(), joints, varied=["joints.*"], gravity=[0.5, -0.5, 1.0],
            servo_period=2e-3, integrator={"scheme": "rosenbrock", "dt": 2e-4},
        )  # fmt: skip
        return load_scene(file)

    return write


def coupled(folder: Path) -> Scene:
    from test_couplings import machine

    return machine(folder, *ARMS["palletizer"], varied=["joints.*.friction.viscous"])


SCENES: dict[str, Callable[[Path], Scene]] = {
    "located events, brake, wrench": three_axis(LOCATED),
    "further inputs, temperatures, noise, seeds, no lanes": one_arm_after_the_other,
    "noise, seeds": three_axis(SENSED),
    "further inputs, temperatures": gantry("gears that are not linear"),
    "no lanes": three_axis(BACKLASH),
    "ur5": lambda folder: load_scene("ur5"),
    "events in steps, brake": three_axis(BRAKED),
    "drives without usual modes": gantry("drives without usual modes"),
    "brakes with stops and springs": gantry("brakes with stops and springs"),
    "couplings": coupled,
    "panda": lambda folder: load_scene("panda"),
    **{
        f"mixture {seed}": (lambda folder, seed=seed: load_scene(write_mixture(folder, seed)))
        for seed in (2, 3)
    },
}


@pytest.fixture(scope="module", params=with_slow(some(SCENES, 5), 1))
def scene(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Scene:
    return SCENES[request.param](tmp_path_factory.mktemp("scene"))


@pytest.mark.parametrize("seed", with_slow(some(range(12), 2), 1))
def test_every_call_gives_the_bits_of_lanes(scene: Scene, seed: int) -> None:
    """In any order: what is returned, states and measurements, and what is saved at the end."""
    walk(scene, "processor", seed)


@pytest.mark.parametrize("seed", with_slow(some(range(12, 18), 2), 1))
def test_every_call_of_a_fleet_of_a_card_gives_the_bits_of_lanes(
    located: Scene, fleet_cards: Stub, seed: int
) -> None:
    """Arms stay within the memory of their start, in any motion."""
    walk(located, "gpu", seed)


def walk(scene: Scene, device: str, seed: int) -> None:
    pair = Pair(scene, COUNT, device, seed)
    order = np.random.default_rng(100 + seed)
    pair.assert_alike("start")
    for _ in range(100):
        action = ACTIONS[order.integers(len(ACTIONS))]
        action(pair)
        if order.random() < 0.5:
            pair.assert_alike(action.__name__)
    pair.assert_alike("the last")
    pair.save()


def test_arms_that_diverge(located: Scene, device: str) -> None:
    """They stay where they are and are reported alike; their neighbours go on."""
    pair = Pair(located, COUNT, device, 3)
    v, wild = np.zeros((3, 3)), [0, 4, 5]
    v[:, 1] = 1.1 * np.pi / located.integrator.dt
    pair.both(lambda fleet: fleet.reset(wild, v=v))
    rows = pair.commands()
    pair.both(lambda fleet: fleet.advance(rows, 100))
    reported = [
        {arm: (why.joint, why.t, str(why)) for arm, why in fleet.diverged.items()}
        for fleet in pair.fleets
    ]
    assert reported[0] == reported[1] and sorted(reported[1]) == wild
    assert (pair.fleets[1].state.t > 0.0).sum() == COUNT - len(wild)


def test_servos_of_some_arms_forget_and_change(located: Scene, device: str) -> None:
    pair = Pair(located, COUNT, device, 9)
    for aim in (pair.aim, pair.aim_at):
        for change in (pair.reset_servos, pair.retune, pair.reset_servos):
            aim()
            for action in (pair.follow, change, pair.follow):
                action()
                pair.assert_alike(action.__name__)


@pytest.mark.parametrize("count", [1, 2, 7, 16, 1000])
def test_any_number_of_arms(located: Scene, device: str, count: int) -> None:
    pair = Pair(located, count, device, count)
    for action in (
        pair.aim,
        pair.follow,
        pair.exchange,
        pair.step,
        pair.reset,
        pair.run,
        pair.set_parameters,
        pair.push,
        pair.power,
        pair.follow,
        pair.save,
        pair.restore,
        pair.advance,
    ):
        action()
        pair.assert_alike(action.__name__)


@pytest.mark.parametrize("workers", [1, 2, 3])
def test_however_the_processor_divides_its_threads(
    located: Scene, monkeypatch: pytest.MonkeyPatch, workers: int
) -> None:
    chosen = ProcessorDevice(workers)
    monkeypatch.setattr(open_device, "PROCESSOR", lambda: chosen)
    pair = Pair(located, 200, "processor", 5)
    for _ in range(3):
        for action in (pair.exchange, pair.step, pair.run, pair.follow):
            action()
            pair.assert_alike(action.__name__)


def test_pieces_change_no_bit(located: Scene, device: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Between pieces of long calls there are looks for Ctrl-C."""
    fleet = Fleet(located, COUNT, device=device)
    monkeypatch.setattr("arm_emulator_fleet.fleet.PIECE", 3 * located.steps_per_period + 1)
    pieces = Fleet(located, COUNT, device=device)
    rng, servo = np.random.default_rng(6), find_servo(located)
    assert servo
    rows = rng.uniform(-9.0, 9.0, (7, COUNT, 3))
    q = located.start + np.cumsum(0.01 * rng.normal(size=(20, 3)), axis=0)
    links = np.zeros((2, 20, COUNT, 3))
    schedule = FleetWay(located, COUNT)
    schedule.set_changes([[(5, PowerChange(on=False)), (9, PowerChange(on=True))]] * COUNT)
    for stepped, of_links in zip((fleet, pieces), links, strict=True):
        servos = ServoFleet(stepped, servo)
        servos.aim(q)
        stepped.follow(servos, 20, links=of_links, way=schedule)
    assert links[0].tobytes() == links[1].tobytes() and links[0, -1].any()
    assert fleet.run(rows, 25).tobytes() == pieces.run(rows, 25).tobytes()
    assert fleet.advance(rows[0], 333).tobytes() == pieces.advance(rows[0], 333).tobytes()
    assert (
        show(fleet.step(rows[1], 31))["q"].tobytes()
        == show(pieces.step(rows[1], 31))["q"].tobytes()
    )
    assert fleet.save() == pieces.save()


def refusals(scene: Scene) -> Iterator[Callable[[Fleet, ServoFleet], Any]]:
    """Calls that make no sense."""
    three, name = np.zeros(3), scene.varied[0].name
    below = scene.varied[0].number.least - 1.0
    nan = np.full((COUNT, 3), np.nan)
    yield lambda fleet, servos: fleet.exchange(np.zeros(4))
    yield lambda fleet, servos: fleet.exchange(nan)
    yield lambda fleet, servos: fleet.exchange(three, -2)
    yield lambda fleet, servos: fleet.exchange(three, command_d=three)
    yield lambda fleet, servos: fleet.advance(three, -1)
    yield lambda fleet, servos: fleet.advance({"waist": 1.0}, 1)
    yield lambda fleet, servos: fleet.run(nan[np.newaxis], 3)
    yield lambda fleet, servos: fleet.run(np.zeros((2, 5, 3)), 3)
    yield lambda fleet, servos: fleet.step(three, 1.5)
    yield lambda fleet, servos: fleet.step(three, out=Fleet(scene, 3).frame())
    yield lambda fleet, servos: fleet.reset([COUNT])
    yield lambda fleet, servos: fleet.reset([1, 1])
    yield lambda fleet, servos: fleet.reset(q=[1e300] * 3)
    yield lambda fleet, servos: fleet.reset([0, 1], q=np.zeros((3, 3)))
    yield lambda fleet, servos: fleet.reset(varied={name: below})
    yield lambda fleet, servos: fleet.set_parameter(name, below, arms=[2])
    yield lambda fleet, servos: fleet.set_parameter("gravity", 1.0)
    yield lambda fleet, servos: fleet.set_parameters(spoil_rows(fleet, below))
    yield lambda fleet, servos: fleet.set_parameters(spoil_rows(fleet, np.nan))
    yield lambda fleet, servos: fleet.set_parameters(np.zeros((COUNT, 1)))
    yield lambda fleet, servos: fleet.set_external_wrench("nothing", ExternalWrench())
    yield lambda fleet, servos: fleet.set_external_wrench(WRENCHED, ExternalWrench([np.inf] * 3))
    yield lambda fleet, servos: setattr(fleet, "powered", [True])
    yield lambda fleet, servos: fleet.restore(b"")
    yield lambda fleet, servos: fleet.restore(spoil(fleet.save(), [9]))
    yield lambda fleet, servos: fleet.restore(spoil(fleet.save(), [3, 9]))
    yield lambda fleet, servos: fleet.restore(spoil(fleet.save(), [3, 9]), arms=[8, 9])
    yield lambda fleet, servos: fleet.restore(spoil(fleet.save(), [5], 0))
    yield lambda fleet, servos: fleet.copy_arm(COUNT)
    yield lambda fleet, servos: fleet.follow(7, 1)  # type: ignore[arg-type]
    yield lambda fleet, servos: fleet.follow(servos, 1, arms=0)
    yield lambda fleet, servos: fleet.follow(servos, 1, links=np.zeros((1, 2, 3)))
    yield lambda fleet, servos: fleet.follow(servos, 1, way=FleetWay(scene, 3))
    yield lambda fleet, servos: servos.aim(np.zeros((4, 2)))
    yield lambda fleet, servos: servos.aim(np.zeros((4, 3)), every=1000)
    yield lambda fleet, servos: servos.aim_at([0], np.zeros((2, 3)), [0] * COUNT)
    yield lambda fleet, servos: servos.retune(COUNT, find_servo(scene))  # type: ignore[arg-type]
    yield lambda fleet, servos: servos.reset([COUNT])


def spoil(saved: bytes, arms: list[int], place: int = -20) -> bytes:
    """Flip a bit of arms in what a fleet has saved."""
    size, spoiled = len(saved) // COUNT, bytearray(saved)
    for arm in arms:
        spoiled[arm * size + place % size] ^= 1
    return bytes(spoiled)


def spoil_rows(fleet: Fleet, value: float) -> np.ndarray:
    rows = np.column_stack(list(fleet.parameters.values()))
    rows[[4, 8], 0] = value
    return rows


def test_senseless_calls_are_refused_alike_and_change_nothing(located: Scene, device: str) -> None:
    pair = Pair(located, COUNT, device, 4)
    pair.exchange()
    before = pair.fleets[1].save()
    for index, attempt in enumerate(refusals(located)):
        lines = []
        for fleet, servos in zip(pair.fleets, pair.servos, strict=True):
            with pytest.raises(Refusal) as refused:
                attempt(fleet, servos)
            lines.append(str(refused.value))
        assert lines[0] == lines[1], f"attempt {index}"
        assert pair.fleets[1].save() == before, f"attempt {index}: {lines[1]}"
    pair.follow()
    pair.assert_alike("refusals")


def test_impossible_calls_of_a_device_are_refused(located: Scene, device: str) -> None:
    on, lanes = Fleet(located, 3, device=device), Fleet(located, 3)
    servo = find_servo(located)
    assert servo
    with pytest.raises(Refusal, match=f"arms on {device}; valid: copy_arm"):
        on[0]
    for fleet, servo_fleet, words in ((on, lanes, "the processor"), (lanes, on, device)):
        with pytest.raises(
            Refusal, match=f"control must run where the fleet is, .* got on {words}"
        ):
            fleet.follow(ServoFleet(servo_fleet, servo), 1)
    with pytest.raises(Refusal, match=r"Fleet: workers must be .* on a device"):
        Fleet(located, 3, workers=2, device=device)
    for files, words in (
        ("a.c", "be a list of files"),
        (["/none.c"], "be files"),
        ([5], "be files"),
    ):
        with pytest.raises(Refusal, match=f"Fleet: kernels must {words}"):
            Fleet(located, 3, device=device, kernels=files)  # type: ignore[arg-type]
    with pytest.raises(Refusal, match=r"threads must be 1 on a device"):
        scene = load_scene("three_axis", {"threads": 2, "integrator.scheme": "paper"})
        Fleet(scene, 3, device=device)


def test_fleets_leave_nothing_on_a_card(located: Scene, fleet_cards: Stub) -> None:
    servo, in_use = find_servo(located), fleet_cards.calls.stub_memory_in_use
    assert servo
    before = in_use()
    for _ in range(50):
        fleet_cards.calls.stub_forget()
        fleet = Fleet(located, 5, device="gpu")
        schedule = FleetWay(located, 5)
        schedule.set_changes([[(1, PowerChange(on=False))]] * 5)
        fleet.follow(ServoFleet(fleet, servo), 2, way=schedule)
        assert in_use() > before
        del fleet
        gc.collect()
        assert in_use() == before
        assert dict(fleet_cards.notes)["cuModuleUnload"] == 0


def test_more_arms_than_a_card_has_room_for(located: Scene, fleet_cards: Stub) -> None:
    """The fleet that is there already goes on."""
    pair, calls = Pair(located, COUNT, "gpu", 8), fleet_cards.calls
    before = calls.stub_memory_in_use()
    calls.stub_set_memory(before + (4 << 20))
    words = r"^Device\.allocate: size must fit into the memory of stub 0 \[byte\], got \d+; valid: "
    with pytest.raises(Refusal, match=words + r"\d+ are free$"):
        Fleet(located, 2000, device="gpu")
    gc.collect()
    assert calls.stub_memory_in_use() == before
    pair.follow()
    pair.step()
    pair.assert_alike("a fleet that did not fit")


def test_fleets_on_the_same_card_and_on_two_are_independent(
    located: Scene, fleet_cards: Stub
) -> None:
    pairs = [
        Pair(located, COUNT + k, place, k) for k, place in enumerate(["gpu", "gpu:0", "gpu:1"])
    ]
    order = np.random.default_rng(7)
    for _ in range(40):
        pair = pairs[order.integers(3)]
        action = ACTIONS[order.integers(len(ACTIONS))]
        action(pair)
        pair.assert_alike(action.__name__)
    for pair in pairs:
        pair.save()


def test_a_thread_gets_the_stack_that_the_kernels_need(located: Scene, fleet_cards: Stub) -> None:
    Fleet(located, 1, device="gpu")
    card = open_device.open_device("test", "gpu")
    assert isinstance(card, CudaDevice)
    with card.enter_context():
        limit = DRIVER.get_constant("CU_LIMIT_STACK_SIZE")
        assert card.driver.read_result("cuCtxGetLimit", "size_t *", limit) >= STACK_WITH_EVENTS
