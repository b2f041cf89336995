"""Two fleets of the same arms, in lanes and on a device, of which everything is asked."""

import contextlib
import copy
import dataclasses
import pickle
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from test_fleet_step import LOCATED

from arm_emulator import Diverged, ExternalWrench, Scene, load_scene
from arm_emulator.extension.machine import (
    NumberChange,
    PowerChange,
    WrenchChange,
    list_further_inputs,
)
from arm_emulator.machine.plant.outputs import KNOWN
from arm_emulator.runs.gains import load_gains
from arm_emulator.servo.servo_config import ServoConfig
from arm_emulator_fleet import Fleet
from arm_emulator_fleet.device_array import DeviceArray
from arm_emulator_fleet.fleet_schedule import FleetWay
from arm_emulator_fleet.servo_fleet import ServoFleet

LARGEST = 20.0  # V, A, N m; commands beyond a motor's limits are clamped
WRENCHED = "forearm"
FRAME = "t", "q", "v", "current", "theta_m", "omega_m"


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
