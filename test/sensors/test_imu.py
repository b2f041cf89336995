"""Inertial measurement units, against the equations of motion."""

import numpy as np
import pinocchio as pin
import pytest
from machines import GRAVITY, Oracle
from sensed_machine import FRICTION, POSE, draw_state, write

from arm_emulator import Plant, Scene, load_scene


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> Scene:
    return load_scene(write(tmp_path_factory.mktemp("sensed")))


def test_an_imu_measures_the_acceleration_of_the_equations_of_motion(scene: Scene) -> None:
    """Against Pinocchio: classical acceleration of the unit's frame, less that of free fall."""
    rng = np.random.default_rng(3)
    oracle, plant = Oracle(scene), Plant(scene)
    model, data = oracle.model, oracle.data
    R = pin.rpy.rpyToMatrix(*POSE["rpy"])
    frames = []
    for link, pose in (
        ("tip_link", pin.SE3(R, np.array(POSE["xyz"]))),
        ("turn_link", pin.SE3.Identity()),
    ):
        frame = model.frames[model.getFrameId(link)]
        frames.append(
            model.addFrame(
                pin.Frame(f"imu {link}", frame.parentJoint, frame.placement * pose, pin.OP_FRAME)
            )
        )
    data = model.createData()
    viscous, coulomb = FRICTION["viscous"], FRICTION["coulomb"]
    for _ in range(30):
        draw_state(rng, plant)
        x, measured = plant.state, plant.measured
        tau = x.gear_torque - viscous * x.v - coulomb * np.sign(x.v)
        at = oracle.configuration(x.q)
        a = pin.aba(model, data, at, x.v, tau)
        pin.forwardKinematics(model, data, at, x.v, a)
        for unit, frame in enumerate(frames):
            local = pin.ReferenceFrame.LOCAL
            acceleration = pin.getFrameClassicalAcceleration(model, data, frame, local).linear
            placement = pin.updateFramePlacement(model, data, frame)
            force = acceleration - placement.rotation.T @ np.array(GRAVITY)
            rate = pin.getFrameVelocity(model, data, frame, local).angular
            scale = 1.0 + np.abs(force).max()
            np.testing.assert_allclose(
                measured.specific_force[unit], force, rtol=0, atol=1e-9 * scale, err_msg="force"
            )
            np.testing.assert_allclose(
                measured.angular_rate[unit], rate, rtol=0, atol=1e-11 * scale, err_msg="rate"
            )


def test_an_imu_that_sticks_feels_gravity_alone(scene: Scene) -> None:
    rng, oracle, plant = np.random.default_rng(4), Oracle(scene), Plant(scene)
    for _ in range(10):
        q = rng.normal(0.0, 1.0, 3)
        plant.reset(q)
        plant.exchange(np.zeros(3))
        np.testing.assert_array_equal(plant.state.q, q, "the joints shall stick")
        pin.framesForwardKinematics(oracle.model, oracle.data, oracle.configuration(q))
        link = oracle.data.oMf[oracle.model.getFrameId("tip_link")].rotation
        R = link @ pin.rpy.rpyToMatrix(*POSE["rpy"])
        force = plant.measured.specific_force[0]
        np.testing.assert_allclose(force, -R.T @ np.array(GRAVITY), rtol=0, atol=1e-12)
        np.testing.assert_array_equal(plant.measured.angular_rate, 0.0)
