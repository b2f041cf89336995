"""A fleet on a device does what a fleet in lanes does, to the last bit, whatever it is asked."""

import contextlib
import copy
import dataclasses
import gc
import pickle
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from devices import Stub
from draws import some, with_slow
from machines import GANTRY, SENSED, gantry_urdf, write_scene
from test_fleet import BACKLASH, one_arm_after_the_other
from test_fleet_step import BRAKED, LOCATED
from test_lanes import JOINTS

from arm_emulator import Diverged, ExternalWrench, Refusal, Scene, load_scene
from arm_emulator.extension.machine import (
    NumberChange,
    PowerChange,
    WrenchChange,
    list_further_inputs,
)
from arm_emulator.machine.plant.outputs import KNOWN
from arm_emulator.runs.gains import load_gains
from arm_emulator.servo.servo_config import ServoConfig
from arm_emulator_fleet import Fleet, open_device
from arm_emulator_fleet.cuda_device import DRIVER, CudaDevice
from arm_emulator_fleet.device_array import DeviceArray
from arm_emulator_fleet.device_core import STACK_WITH_EVENTS
from arm_emulator_fleet.fleet_schedule import FleetWay
from arm_emulator_fleet.processor_device import ProcessorDevice
from arm_emulator_fleet.servo_fleet import ServoFleet
from oracles.coupled_arms import ARMS
from oracles.mixtures import write_mixture

pytest_plugins = ["devices"]

COUNT = 11  # more than one group of lanes, and no number of groups of a device
LARGEST = 20.0  # V, A, N m; commands beyond a motor's limits are clamped
WRENCHED = "forearm"
FRAME = "t", "q", "v", "current", "theta_m", "omega_m"


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


@pytest.fixture(scope="module")
def located() -> Scene:
    return load_scene("three_axis", overrides=LOCATED)


@pytest.fixture(params=["processor", "gpu"])
def device(request: pytest.FixtureRequest) -> str:
    """The processor, and a card of the stub, on which a fleet has its memory."""
    if request.param == "gpu":
        request.getfixturevalue("fleet_cards")
    return str(request.param)


def find_servo(scene: Scene) -> ServoConfig | None:
    """Return the servo of a scene that is shipped."""
    name = scene.where.removesuffix(".yaml")
    return load_gains(name).servo if name in ("three_axis", "ur5", "panda") else None


def name_results(results: Any) -> dict[str, np.ndarray]:
    """Return what a call returned as arrays by name."""
    if isinstance(results, dict):
        return results
    rows = results if isinstance(results, tuple) else (results,)
    return {str(place): np.asarray(row) for place, row in enumerate(rows)}


def assert_bits(actual: np.ndarray, expected: np.ndarray, context: str) -> None:
    np.testing.assert_array_equal(actual, expected, err_msg=context)
    assert actual.tobytes() == expected.tobytes(), f"signs of 0 in {context}"


class Pair:
    """Two fleets of the same arms, in lanes and on a device, of which everything is asked."""

    def __init__(self, scene: Scene, count: int, device: str, seed: int) -> None:
        self.scene, self.count, self.N = scene, count, len(scene.joints)
        self.rng = np.random.default_rng(seed)
        self.varied = {
            number.name: np.clip(
                np.round(number.value * self.rng.uniform(0.7, 1.4, count))
                if number.name == "seed"
                else number.value * self.rng.uniform(0.7, 1.4, count),
                number.number.least,
                number.number.most,
            )
            for number in scene.varied
        }
        began = self.starts(count), 0.1 * self.rng.normal(size=(count, self.N))
        self.fleets = [
            Fleet(scene, count, varied=self.varied, q=began[0], v=began[1], device=place)
            for place in (None, device)
        ]
        servo = find_servo(scene)
        self.servos = [ServoFleet(fleet, servo) for fleet in self.fleets] if servo else []
        self.servo = servo
        self.saved = [fleet.save() for fleet in self.fleets]

    def starts(self, count: int) -> np.ndarray:
        return np.asarray(self.scene.start) + 0.01 * self.rng.normal(size=(count, self.N))

    def commands(self, *rows: int) -> np.ndarray:
        return self.rng.uniform(-LARGEST, LARGEST, (*rows, self.count, self.N))

    def has_input(self, name: str) -> np.ndarray:
        """Return whether the motor of each joint has a further input."""
        return np.array(
            [name in [joint_input.name for joint_input in j.inputs[1:]] for j in self.scene.joints]
        )

    def mask(self) -> np.ndarray:
        return self.rng.random(self.count) < 0.4

    def both(self, act: Callable[..., Any], *of_each: Any) -> None:
        """Let both do something, which must return the same bits."""
        first, second = (
            name_results(act(*arguments)) for arguments in zip(self.fleets, *of_each, strict=True)
        )
        assert first.keys() >= second.keys()
        for name, rows in second.items():
            assert_bits(rows, first[name], f"{name} of {act.__name__}")

    def assert_alike(self, after: str) -> None:
        first, second = (everything(fleet) for fleet in self.fleets)
        for name, rows in first.items():
            assert_bits(second[name], rows, f"{name} after {after}")

    # Calls of fleets.

    def exchange(self) -> None:
        rows, tick = self.commands(), int(self.rng.integers(-1, 9))
        names = list_further_inputs(self.scene) if self.rng.random() < 0.7 else ()
        further = {name: self.commands() * self.has_input(name) for name in names}
        self.both(lambda fleet: fleet.exchange(rows, tick, **further))

    def step(self) -> None:
        rows, periods = self.commands(), int(self.rng.integers(0, 20))
        frames = [fleet.frame() for fleet in self.fleets]
        self.both(lambda fleet, frame: show(fleet.step(rows, periods, out=frame)), frames)
        more = self.commands()
        self.both(lambda fleet, frame: show(fleet.step(more, 1, out=frame)), frames)

    def advance(self) -> None:
        rows, steps = self.commands(), int(self.rng.integers(0, 40))
        self.both(lambda fleet: fleet.advance(rows, steps))

    def run(self) -> None:
        rows, steps = self.commands(3), int(self.rng.integers(1, 20))
        self.both(lambda fleet: fleet.run(rows, steps))

    def reset(self) -> None:
        which = self.mask()
        many = int(which.sum())
        q, v = self.starts(many), 0.1 * self.rng.normal(size=(many, self.N))
        numbers = {
            name: self.rng.permutation(values)[:many]
            for name, values in self.varied.items()
            if self.rng.random() < 0.3
        }
        self.both(lambda fleet: fleet.reset(which, q=q, v=v, varied=numbers))

    def throw(self) -> None:
        """So quick that an arm turns by more than half a turn in a step: it diverges."""
        arm, v = [int(self.rng.integers(self.count))], np.zeros(self.N)
        v[0] = 1.1 * np.pi / self.scene.integrator.dt
        self.both(lambda fleet: fleet.reset(arm, v=v))

    def set_parameter(self) -> None:
        if self.varied:
            name, which = str(self.rng.choice(list(self.varied))), self.mask()
            values = self.rng.permutation(self.varied[name])
            self.both(lambda fleet: fleet.set_parameter(name, values, arms=which))

    def set_parameters(self) -> None:
        order = self.rng.permutation(self.count)
        rows = np.column_stack([np.zeros((self.count, 0)), *self.varied.values()])[order]
        self.both(lambda fleet: fleet.set_parameters(rows))

    def draw_wrench(self, *arms: int) -> ExternalWrench:
        force, moment = self.rng.normal(size=(2, *arms, 3))
        axes = str(self.rng.choice(["link", "world"]))
        return ExternalWrench(20.0 * force, moment, 0.1 * force, axes)

    def push(self) -> None:
        if self.scene.external_wrench:
            which, wrench = self.mask(), self.draw_wrench(self.count)
            self.both(lambda fleet: fleet.set_external_wrench(WRENCHED, wrench, arms=which))

    def power(self) -> None:
        on = ~self.mask() if self.rng.random() < 0.6 else np.ones(self.count, bool)
        self.both(lambda fleet: setattr(fleet, "powered", on))

    def save(self) -> None:
        self.saved = [fleet.save() for fleet in self.fleets]
        assert self.saved[0] == self.saved[1], "saved"

    def restore(self) -> None:
        """Each what the other has saved."""
        which = self.mask() if self.rng.random() < 0.6 else None
        self.both(lambda fleet, saved: fleet.restore(saved, arms=which), self.saved[::-1])

    def copy(self) -> None:
        """Go on with copies; servos remember what they did with the fleets before."""
        self.fleets = [copy.copy(fleet) for fleet in self.fleets]

    def pickle(self) -> None:
        """Go on with fleets that were pickled; they have scenes of their own, and need servos."""
        self.fleets = [pickle.loads(pickle.dumps(fleet)) for fleet in self.fleets]
        if self.servo:
            self.servos = [ServoFleet(fleet, self.servo) for fleet in self.fleets]

    def take_arm(self) -> None:
        arm, row = int(self.rng.integers(-self.count, self.count)), self.commands()[0]

        def use(fleet: Fleet) -> tuple[Any, ...]:
            plant = fleet.copy_arm(arm)
            try:
                plant.advance(row, 30)
            except Diverged as diverged:
                assert str(diverged)
            return plant.state.q, np.frombuffer(plant.save(), np.uint8)

        self.both(use)

    def draw_changes(self) -> list[list[tuple[int, Any]]]:
        """Some arms change at ticks of the call to come, others not."""
        ticks = np.round(self.fleets[0].state.t / self.scene.servo_period).astype(int)
        changes: list[list[tuple[int, Any]]] = []
        for tick in ticks:
            own = []
            for at in np.sort(self.rng.integers(0, 30, self.rng.integers(0, 5))):
                kinds: list[Any] = [PowerChange(bool(self.rng.random() < 0.5))]
                if self.varied:
                    name = str(self.rng.choice(list(self.varied)))
                    kinds.append(NumberChange(name, float(self.rng.choice(self.varied[name]))))
                if self.scene.external_wrench:
                    kinds.append(WrenchChange(WRENCHED, self.draw_wrench()))
                own.append((int(tick + at), kinds[self.rng.integers(len(kinds))]))
            changes.append(own)
        return changes

    def follow(self) -> None:
        if not self.servos:
            return
        periods = int(self.rng.integers(0, 40))
        schedules: list[FleetWay | None] = [None, None]
        if self.rng.random() < 0.7:
            changes = self.draw_changes()
            schedules = [FleetWay(fleet.scene, self.count) for fleet in self.fleets]
            for schedule in schedules:
                schedule.set_changes(changes)
        links = np.zeros((2, periods, self.count, self.N))
        some_arms = int(self.rng.integers(1, self.count + 1)) if self.rng.random() < 0.2 else None
        if some_arms is not None:  # whole groups of either
            lanes = max(fleet.lanes for fleet in self.fleets)
            some_arms = min(self.count, -(-some_arms // lanes) * lanes)
        frames = [fleet.frame() for fleet in self.fleets]
        if self.rng.random() < 0.5:  # it keeps what it has of arms that stay behind
            for frame in frames:
                frame.q[:], frame.t[:] = (
                    np.full((self.count, self.N), 7.0),
                    np.full(self.count, 9.0),
                )

        def go(fleet: Fleet, servos: ServoFleet, way: FleetWay, rows: Any, frame: Any) -> Any:
            fleet.follow(servos, periods, frame, links=rows, way=way, arms=some_arms)
            return show(frame) | {"links": rows}

        self.both(go, self.servos, schedules, links, frames)
        assert periods == 0 or some_arms is not None or links[0, -1].any()

    def aim(self) -> None:
        if self.servos:
            rows, every = int(self.rng.integers(1, 30)), int(self.rng.integers(1, 4))
            shape = (rows, self.count, self.N) if self.rng.random() < 0.7 else (rows, self.N)
            swing = np.cumsum(0.01 * self.rng.normal(size=shape), axis=0)
            v, tau = self.rng.normal(size=(2, *shape))
            of = (v if self.rng.random() < 0.5 else None, tau if self.rng.random() < 0.5 else None)
            self.both(
                lambda fleet, servos: servos.aim(self.scene.start + swing, *of, every=every),
                self.servos,
            )

    def aim_at(self) -> None:
        if self.servos:
            rows = self.rng.integers(1, 5, self.count)
            first = np.concatenate([[0], np.cumsum(rows)])
            since = [np.cumsum(self.rng.integers(1, 9, n)) for n in rows]
            since = [row - row[0] for row in since]
            q = self.scene.start + 0.1 * self.rng.normal(size=(first[-1], self.N))
            self.both(
                lambda fleet, servos: servos.aim_at(np.concatenate(since), q, first), self.servos
            )

    def retune(self) -> None:
        if self.servo:
            factor, arm = self.rng.uniform(0.3, 1.5), int(self.rng.integers(self.count))
            joints = tuple(
                dataclasses.replace(joint, position_gain=factor * joint.position_gain)
                for joint in self.servo.joints
            )
            config = dataclasses.replace(self.servo, joints=joints)
            self.both(lambda fleet, servos: servos.retune(arm, config), self.servos)

    def reset_servos(self) -> None:
        if self.servos:
            which = self.mask() if self.rng.random() < 0.7 else None
            self.both(lambda fleet, servos: servos.reset(which), self.servos)


ACTIONS = [
    *(2 * (Pair.exchange, Pair.step, Pair.reset)),
    *(3 * (Pair.follow,)),
    *(Pair.advance, Pair.run, Pair.throw, Pair.set_parameter, Pair.set_parameters, Pair.push),
    *(Pair.power, Pair.save, Pair.restore, Pair.copy, Pair.pickle, Pair.take_arm),
    *(Pair.aim, Pair.aim_at, Pair.retune, Pair.reset_servos),
]


def show(frame: Any) -> dict[str, np.ndarray]:
    """Return all arrays of a frame, wherever it is."""
    rows = {name: getattr(frame, name) for name in (*FRAME, "faults", "powered")}
    for name in KNOWN:
        with contextlib.suppress(AttributeError):  # frames of a device have no outputs of nothing
            rows[f"measured {name}"] = getattr(frame.measured, name)
    return {
        name: row.numpy() if isinstance(row, DeviceArray) else row.copy()
        for name, row in rows.items()
    }


def everything(fleet: Fleet) -> dict[str, Any]:
    state, measured = fleet.state, fleet.measured
    return {
        **{name: getattr(state, name) for name in state.__dataclass_fields__},
        **{f"measured {name}": getattr(measured, name) for name in KNOWN},
        **fleet.parameters,
        "powered": fleet.powered,
        "faults": fleet.faults,
    }


@pytest.mark.parametrize("seed", with_slow(some(range(12), 2), 1))
def test_every_call_gives_the_bits_of_lanes(scene: Scene, seed: int) -> None:
    """In any order: what is returned, states and measurements, and what is saved at the end."""
    walk(scene, "processor", seed)


@pytest.mark.parametrize("seed", with_slow(some(range(12, 18), 2), 1))
def test_every_call_of_a_fleet_of_a_card_gives_the_bits_of_lanes(
    located: Scene, fleet_cards: Stub, seed: int
) -> None:
    """Arms stay within the memory that they got at first, whatever they do."""
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


# Memory of a card


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
