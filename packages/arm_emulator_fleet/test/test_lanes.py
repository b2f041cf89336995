"""Arms in lanes of a fleet move as single arms do, whatever parts they have."""

import tempfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from draws import some
from machines import DC, GANTRY, PMSM, gantry_urdf, write_scene

from arm_emulator import Plant, Scene, load_scene
from arm_emulator.machine.parts.part import Part
from arm_emulator.machine.scene.known_parts import DEFLECTIONS, PARTS
from arm_emulator_fleet import Fleet
from oracles.mixtures import LARGEST, draw_alone

PERIOD, STEPS, ROWS, ROUNDS = 2e-3, 10, 8, 6
COUNT = 9  # more than a group
ELASTIC = {"ratio": 0.02, "stiffness": 2e4, "damping": 20.0}
DRY = {"coulomb": 0.5, "breakaway": 0.7, "viscous": 0.2}
ROTOR_DRY = {"coulomb": 5e-3, "breakaway": 8e-3, "viscous": 1e-5}
RIGID_DIRECTED = {"load": 0.1, "back_load": 0.3, "rest_load": 0.2, "stribeck": 3.0,
                  "rest_load_square": 0.5, "rest_motor_square": 0.2, "exponent": 1.6}  # fmt: skip
DIRECTED = {**RIGID_DIRECTED, "motor_load": 0.1}
WINDING = {"heat_capacity": 0.05, "thermal_resistance": 4.0, "magnet_coefficient": -0.002}
RIPPLE = {"waves": [[5.0, 0.2, 0.3], [12.0, -0.1, 1.0]]}
SHIFTS = {"stiffness": 5e4, "damping": 50.0}
TILTS = {"stiffness": 2e3, "damping": 2.0}
# Joints of two gantries, with every part at least once and gears of either sign; and what each
# motor is commanded at most; None: as in mixtures.
JOINTS: dict[str, list[tuple[dict[str, Any], float | None]]] = {
    "drives without usual modes": [
        ({"motor": {**DC, "current_limit": 4.0, "friction": {**ROTOR_DRY, "stribeck": 3.0}},
          "gear": ELASTIC}, 20.0),
        ({"motor": {**PMSM, "friction": {**ROTOR_DRY, "load": 0.2}},
          "gear": {**ELASTIC, "ratio": -0.02, "backlash": 0.01},
          "lugre": {"coulomb": 0.5, "breakaway": 0.7, "stribeck": 0.1, "bristle_stiffness": 500.0,
                    "bristle_damping": 5.0}}, 10.0),
        ({"motor": {"kind": "torque", "rotor_inertia": 1e-4, "torque_limit": 0.3,
                    "bandwidth": 100.0,
                    "lugre": {"coulomb": 5e-3, "breakaway": 8e-3, "stribeck": 3.0,
                              "bristle_stiffness": 0.1, "bristle_damping": 1e-3}},
          "gear": ELASTIC}, 0.4),
    ],
    "friction by the direction of power": [
        ({"motor": {**DC, "current_limit": 4.0}, "gear": ELASTIC,
          "friction": {**DRY, **DIRECTED, "stribeck": 0.1}}, 20.0),
        ({"motor": {"kind": "torque", "rotor_inertia": 1e-4, "torque_limit": 0.3},
          "gear": {**ELASTIC, "ratio": -0.02},
          "friction": {**DRY, **DIRECTED, "stribeck": 0.1}}, 0.4),
        ({"motor": {"kind": "torque", "rotor_inertia": 1e-4, "torque_limit": 0.3,
                    "friction": {**ROTOR_DRY, **RIGID_DIRECTED}}, "gear": {"ratio": -0.02}}, 0.4),
    ],
    "gears that are not linear": [
        ({"motor": {**DC, "current_limit": 4.0, "winding": WINDING, "ripple": RIPPLE},
          "gear": {**ELASTIC, "cubic_stiffness": 1e8},
          "friction": {**DRY, "stribeck": 0.1}}, 20.0),
        ({"motor": {**PMSM, "winding": WINDING, "current_loop": {"bandwidth": 300.0}},
          "gear": {**ELASTIC, "ratio": -0.02}}, 10.0),
        ({"motor": {"kind": "torque", "rotor_inertia": 1e-4, "torque_limit": 0.3,
                    "bandwidth": 100.0},
          "gear": {**ELASTIC, "kinematic_error": {"motor": [[2.0, 1e-3, 0.5]],
                                                  "link": [[3.0, 1e-2, 1.0]]}},
          "friction": {**DRY, "load": 0.2}}, 0.4),
    ],
    "bearings that give way": [
        ({"motor": {"kind": "torque", "rotor_inertia": 1e-4, "torque_limit": 0.3},
          "gear": {"ratio": 0.02}, "bearing": {"shift_y": SHIFTS, "shift_z": SHIFTS,
          "tilt_x": TILTS, "tilt_y": TILTS, "tilt_z": TILTS}}, 0.4),
        ({"motor": {**DC, "current_limit": 4.0}, "gear": ELASTIC, "friction": DRY}, 20.0),
        ({"motor": {**DC, "current_limit": 4.0}, "gear": ELASTIC, "bearing": {"shift_x": SHIFTS}},
         20.0),
    ],
    "brakes with stops and springs": [
        ({"motor": {"kind": "current", "torque_constant": 0.05, "current_limit": 5.0,
                    "rotor_inertia": 1e-4, "friction": ROTOR_DRY},
          "gear": {"ratio": -0.03}, "friction": DRY,
          "brake": {"torque": 0.5, "close_delay": 5e-3, "release_delay": 5e-3}}, 6.0),
        ({"motor": {**DC, "cogging": {"waves": [[8.0, 5e-3, 0.2], [12.0, 3e-3]]},
                    "current_limit": 20.0, "current_loop": {"bandwidth": 300.0}},
          "gear": ELASTIC,
          "counterbalance": {"base_distance": 0.4, "link_distance": 0.15, "angle": 0.6,
                             "force": -50.0, "length": 0.4, "gas_column": 0.3},
          "end_stops": {"lower": -0.005, "upper": 0.005, "stiffness": 3e3, "damping": 5.0}}, 20.0),
        ({"friction": {"viscous": 0.5}, "drag": {"coefficient": 2.0},
          "counterbalance": {"base_distance": 0.4, "link_distance": 0.15, "angle": -0.8,
                             "force": 300.0, "length": 0.5, "stiffness": 400.0},
          "torque_table": {"angles": [-1.0, -0.01, 0.01, 1.0], "torques": [2.0, -1.0, 3.0, 0.5]}},
         0.0),
    ],
}  # fmt: skip


def parts_of(joints: list[dict[str, Any]]) -> set[type[Part]]:
    with tempfile.TemporaryDirectory() as folder:
        sections = dict(zip(GANTRY, joints, strict=True))
        scene = load_scene(write_scene(Path(folder), gantry_urdf(), sections))
    return {type(part) for joint in scene.joints for part in joint.parts}


# A part without a line above comes in a drive that is drawn for it, commanded as mixtures are.
NAMED = set().union(*(parts_of([joint for joint, _ in value]) for value in JOINTS.values()))
OTHERS = [part for part in PARTS if part not in NAMED]
JOINTS = {
    "-".join(part.__name__ for part in three): [(draw_alone(part, 0), None) for part in three]
    for three in ([*OTHERS, *PARTS][k : k + 3] for k in range(0, len(OTHERS), 3))
} | JOINTS


# In a short run those whose modes change, which lanes take by masks.
@pytest.fixture(scope="module", params=some(reversed(list(JOINTS)), 1))
def machine(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Scene:
    """All numbers that may be are each arm's own."""
    joints = dict(zip(GANTRY, (joint for joint, _ in JOINTS[request.param]), strict=True))
    file = write_scene(
        tmp_path_factory.mktemp("gantry"), gantry_urdf(), joints, varied=["joints.*"],
        gravity=[0.5, -0.5, 1.0], servo_period=PERIOD, name=request.param,
        integrator={"scheme": "rosenbrock", "dt": PERIOD / STEPS},
    )  # fmt: skip
    return load_scene(file)


@pytest.mark.slow
def test_lanes_move_as_single_arms(machine: Scene) -> None:
    """With numbers, commands, power and starts of their own."""
    rng = np.random.default_rng(4)
    values = {
        part.name: np.clip(
            part.value * rng.uniform(0.8, 1.2, COUNT), part.number.least, part.number.most
        )
        for part in machine.varied
    }
    inputs = zip(JOINTS[machine.name], machine.joints, strict=True)
    largest = np.array(
        [LARGEST[part.unit] if largest is None else largest for (_, largest), part in inputs]
    )
    q, v = 0.005 * rng.normal(size=(2, COUNT, 3))
    fleet, alone = Fleet(machine, COUNT, varied=values, q=q, v=v), []
    assert (fleet.lanes > 1) == (machine.name != "drives without usual modes"), "lanes"
    for arm in range(COUNT):
        plant = Plant(machine)
        for name, of_arms in values.items():
            plant.set_parameter(name, float(of_arms[arm]))
        plant.reset(q[arm], v[arm])
        alone.append(plant)
    stuck = np.zeros((COUNT, 3), int)
    dry = machine.joints[0].rotor_friction is not None
    for _ in range(ROUNDS):
        rows = rng.uniform(-1.0, 1.0, (ROWS, COUNT, 3)) * largest
        for arm, plant in enumerate(alone):
            plant.powered = fleet[arm].powered = bool(rng.random() < 0.8)
        moved = fleet.run(rows, STEPS)
        for arm, plant in enumerate(alone):
            q_alone = plant.run(rows[:, arm], STEPS)
            # Of some 1e-16 in each of 480 steps, of which forces that change steeply make more.
            assert moved[:, arm] == pytest.approx(q_alone, rel=1e-9, abs=1e-12), f"q of arm {arm}"
            part, lane = plant.state, fleet[arm].state
            for name in ("v", "current", "theta_m", "omega_m"):
                actual, expected = getattr(lane, name), getattr(part, name)
                assert actual == pytest.approx(expected, rel=1e-9, abs=1e-10), (
                    f"{name} of arm {arm}"
                )
            assert ((lane.omega_m == 0.0) == (part.omega_m == 0.0)).all(), f"arm {arm} sticks"
            stuck[arm] += part.omega_m == 0.0
            hot = plant.winding_temperatures
            reported = fleet[arm].winding_temperatures
            assert reported == pytest.approx(hot, rel=1e-9, nan_ok=True), f"heat of arm {arm}"
            for name in (kind.outputs[0].name for kind in DEFLECTIONS):
                way, ways = getattr(plant.measured, name), getattr(fleet[arm].measured, name)
                assert ways == pytest.approx(way, rel=1e-9, abs=1e-12), f"{name} of arm {arm}"
            closed = plant.measured.brake_closed
            assert (fleet[arm].measured.brake_closed == closed).all(), f"brakes of arm {arm}"
    sticks = stuck[:, 0].any() and not stuck[:, 0].all()
    assert sticks == dry, "some rotors with dry friction stick, others do not"
    assert np.ptp(moved, axis=1).min() > 1e-4, "the arms move apart"
