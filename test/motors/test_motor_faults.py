"""Faults of every kind of motor: by the motion each has an effect, or a scene refuses it."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from draws import FULL
from machines import write_scene

from arm_emulator import Plant, Refusal, Scene, load_scene
from arm_emulator.machine.faults.known import FAULTS
from arm_emulator.machine.plant.inputs import find_input, list_further_inputs
from arm_emulator.machine.plant.outputs import KNOWN
from arm_emulator.machine.scene.known_parts import MOTORS
from oracles.random_chain import write_slides

ROTOR = {"rotor_inertia": 1e-4}
DC = {"resistance": 1.0, "torque_constant": 0.05, "back_emf_constant": 0.05, **ROTOR}
PMSM = {
    "kind": "pmsm", "resistance": 0.5, "inductance_d": 1e-3, "inductance_q": 2e-3, "flux": 0.01,
    "pole_pairs": 4, **ROTOR,
}  # fmt: skip
LOOP = {"current_limit": 10.0, "current_loop": {"bandwidth": 500.0}}
INVERTER = {"inverter": {"voltage_error": 1.0, "knee": 0.5}}
WINDING = {"winding": {"heat_capacity": 1.0, "thermal_resistance": 2.0}}
CIRCUIT = {**INVERTER, **WINDING}
BEARING = {"friction": {"viscous": 1e-4, "coulomb": 0.01}}
AT_DRIVER = {"torque_constant": 0.05, "resistance": 1.0, "current_limit": 10.0, **ROTOR}
KINDS: dict[str, dict[str, Any]] = {
    "dc_at_once": {**DC, "current_limit": 10.0, **BEARING},
    "dc_in_loop": {**DC, "inductance": 1e-3, **LOOP, **CIRCUIT, **BEARING},
    "pmsm": {**PMSM, **CIRCUIT, **BEARING},
    "pmsm_in_loop": {**PMSM, **LOOP, **CIRCUIT, **BEARING},
    "current": {"kind": "current", "bandwidth": 300.0, **AT_DRIVER, **BEARING},
    "current_at_once": {"kind": "current", **AT_DRIVER, **BEARING},
    "stepper": {
        "kind": "stepper", "torque_per_current": 0.05, "resistance": 1.0, "teeth": 4,
        "bandwidth": 300.0, "current_limit": 10.0, **BEARING, **ROTOR,
    },
    "torque": {"kind": "torque", "torque_limit": 0.5, "bandwidth": 300.0, **BEARING, **ROTOR},
    "torque_at_once": {"kind": "torque", "torque_limit": 0.5, **BEARING, **ROTOR},
}  # fmt: skip

CONTACTS = ("dc_at_once", "dc_in_loop", "pmsm", "pmsm_in_loop")  # at a voltage

# Physics decides which faults of motors act: a drive that regulates the current of an ideal
# source overcomes a resistance, one that regulates the torque weaker magnets and fewer turns.
OF_MAGNETS = {"magnets_weaken", "turns_short"}
OF_CIRCUIT = {"contact_resistance", *OF_MAGNETS, "inverter_ages", "cooling_fails", "ambient_rises"}
EFFECTIVE = {
    "dc_at_once": {"contact_resistance", *OF_MAGNETS, "drive_limit_falls"},
    "dc_in_loop": {*OF_CIRCUIT, "drive_limit_falls", "current_loop_slows"},
    "pmsm": {*OF_CIRCUIT, "phase_lost"},
    "pmsm_in_loop": {*OF_CIRCUIT, "phase_lost", "drive_limit_falls", "current_loop_slows"},
    "current": {*OF_MAGNETS, "drive_limit_falls", "current_loop_slows"},
    "stepper": {*OF_MAGNETS, "drive_limit_falls", "current_loop_slows"},
    "torque": {"drive_limit_falls", "current_loop_slows"},
}
BARE_ONLY = ("current_at_once", "torque_at_once")  # as "current" and "torque" beside their winding
ALWAYS = {"winding_opens", "bearing_binds", "bearing_drags", "gear_runs_dry"}
BEGIN, END = 20, 80  # of faults and of the motion [servo periods]


def scene_of(folder: Path, motors: dict[str, Any], parts: dict[str, Any], **keys: Any) -> Scene:
    joints = {name: {"motor": motor, **parts} for name, motor in motors.items()}
    keys = {"integrator": {"scheme": "rosenbrock", "dt": 2e-4}, "supply_voltage": 24.0, **keys}
    return load_scene(write_scene(folder, write_slides(motors), joints, **keys))


def machine(folder: Path, **keys: Any) -> Scene:
    """Return a machine with a joint of each kind, all with the same other parts."""
    parts = {
        "gear": {"ratio": 0.02, "stiffness": 3e3, "damping": 5.0},
        "friction": {"viscous": 1.0, "coulomb": 0.3, "load": 0.02},
        "brake": {"torque": 1.0},
        "encoder": {"counts_per_turn": 4000, "index": "latch"},
        "current_sensor": {"noise": 0.01, "range": 4.0},
    }
    motors = {name: motor for name, motor in KINDS.items() if name not in BARE_ONLY}
    return scene_of(folder, motors, parts, **keys)


def bare(folder: Path) -> Scene:
    """Return a machine with a joint of each kind, without friction."""
    loaded = ("friction", "inverter", "winding")
    motors = {
        name: {key: value for key, value in motor.items() if key not in loaded}
        for name, motor in KINDS.items()
    }
    return scene_of(
        folder, motors, {"gear": {"ratio": 0.02}},
        faults=["*.winding_opens", "*.contact_resistance"],
        varied=[f"joints.{name}.motor.resistance" for name in CONTACTS],
    )  # fmt: skip


def drive(plant: Plant, ticks: range) -> tuple[np.ndarray, np.ndarray]:
    """Return the positions (K, N), and the bits of what is measured at each joint (K, N, values).

    Commands jump and exceed every limit on the way; those of the motors' further inputs are a third
    of the first.
    """
    joints = plant.scene.joints
    size = np.array([{"V": 40.0, "A": 15.0, "N m": 0.8}[joint.unit] for joint in joints])
    shares = {
        name: np.array([0.0 if find_input(joint, name) is None else 1.0 / 3.0 for joint in joints])
        for name in list_further_inputs(plant.scene)
    }
    q, rows = [], []
    for tick in ticks:
        plant.powered = tick % 40 < 30
        row = size * np.sin(0.11 * tick)
        plant.exchange(row, tick, **{name: share * row for name, share in shares.items()})
        q.append(plant.state.q)
        measured = plant.measured
        fields = [getattr(measured, name) for name in KNOWN]
        columns = [field for field in fields if np.shape(field)[:1] == row.shape]
        rows.append(np.column_stack(columns).astype(float))
    return np.array(q), np.array(rows).view(np.int64)


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> Scene:
    return machine(tmp_path_factory.mktemp("motors"), faults=["*"])


def test_every_kind_of_motor_is_tried() -> None:
    assert {motor.get("kind", "dc") for motor in KINDS.values()} == {motor.kind for motor in MOTORS}


@pytest.mark.slow
def test_each_fault_of_each_kind_of_motor_acts_or_is_refused(scene: Scene, tmp_path: Path) -> None:
    plant = Plant(scene)
    drive(plant, range(BEGIN))
    saved, warm = plant.save(), plant.winding_temperatures
    sound_q, sound = drive(plant, range(BEGIN, END))
    listed = {fault.name: fault for fault in scene.faults}
    of_motors = {
        fault.name
        for fault in FAULTS
        if fault.of == "joints" and any("motor" in at for at in fault.sections)
    }
    for j, joint in enumerate(scene.joint_names):
        is_refused = False
        for kind in FAULTS:
            if kind.of != "joints":
                continue
            name = f"{joint}.{kind.name}"
            if kind.name in of_motors:
                expected = kind.name in EFFECTIVE[joint] | ALWAYS
                assert (name in listed) == expected, f"{name} is possible: {name in listed}"
            if name not in listed:
                if is_refused and not FULL:
                    continue  # as the first one of this joint
                is_refused = True
                with pytest.raises(Refusal, match="faults that this scene can have"):
                    machine(tmp_path, faults=[name])
                continue
            plant.restore(saved)
            plant.set_parameter(f"faults.{name}", listed[name].varied.number.default)
            q, rows = drive(plant, range(BEGIN, END))
            if kind.name == "winding_opens":
                # Nothing heats the winding but the 10 ms in which the slowest currents decay.
                warmer = plant.winding_temperatures[j] - warm[j]
                assert not warmer > 0.1, f"{name} heats the winding by {warmer} K"
            if kind.name in of_motors:
                # Rounding of positions of some dm is 1e-16 m a step.
                assert np.abs(q - sound_q)[:, j].max() > 1e-9, f"{name} changes no motion"
            else:
                moved = (q != sound_q)[:, j].any()
                read = (rows != sound)[:, j].any()
                assert moved or read, f"{name} changes nothing"


def test_a_supply_that_only_regulated_drives_have_cannot_sag(tmp_path: Path) -> None:
    """Their commands are no voltages, and their limits are numbers of their own."""
    regulated = {name: KINDS[name] for name in ("current", "stepper", "torque")}
    with pytest.raises(Refusal, match="faults that this scene can have"):
        scene_of(tmp_path, regulated, {}, faults=["supply_sags"])
    scene_of(tmp_path, {**regulated, "dc": KINDS["dc_at_once"]}, {}, faults=["supply_sags"])


def test_a_contact_is_a_resistance_in_series(tmp_path: Path) -> None:
    """Without heat it is as a winding of so much more resistance, whose loops are set up before."""
    plant, reference = Plant(bare(tmp_path)), Plant(bare(tmp_path))
    for name in CONTACTS:
        plant.set_parameter(f"faults.{name}.contact_resistance", 0.7)
        resistance = f"joints.{name}.motor.resistance"
        reference.set_parameter(resistance, reference.parameters[resistance] + 0.7)
    q, _ = drive(plant, range(END))
    by_hand, _ = drive(reference, range(END))
    # Sums round otherwise, 1e-16 each, in 600 steps of a motion of 0.1 m.
    np.testing.assert_allclose(q, by_hand, rtol=0.0, atol=1e-12)


def test_an_open_winding_removes_the_torque_of_every_kind(tmp_path: Path) -> None:
    """From rest without friction: a millionth of the current is left."""
    plant = Plant(bare(tmp_path))
    moved = np.abs(drive(plant, range(END))[0]).max(axis=0)
    assert moved.min() > 1e-3
    plant.reset()
    for name in KINDS:
        plant.set_parameter(f"faults.{name}.winding_opens", 1.0)
    left = np.abs(drive(plant, range(END))[0]).max(axis=0)
    # A voltage of 24 V gives 24e-6 A, where 10 A flow in a sound motor at its limit.
    assert (left < 1e-5 * moved).all(), left / moved
