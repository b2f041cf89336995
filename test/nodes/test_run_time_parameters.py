"""Gains, weight and timeout are set while the network runs: as a whole, between two ticks."""

import dataclasses
import math
import os
import random
import time
from collections.abc import Iterator
from contextlib import closing

import numpy as np
import pytest
from network import SharedNetwork, assert_same_bits, offline_states
from node_parameters import Parameters
from rcl_interfaces.msg import ParameterType
from test_network import go, pause_at

from arm_emulator import JacobianController, Pose
from arm_emulator.runs.offline import load_offline_run
from arm_emulator.servo.servo_config import SETTABLE, JointServo

JOINTS = ("waist", "shoulder", "elbow")
GAINS = ("position_gain", "velocity_gain", "integral_time", "observer_bandwidth")
BAD = (0.0, -1.0, math.nan, math.inf, -math.inf, 1e308, "fast", True, [1.0])


@pytest.fixture(scope="module")
def three_nodes(tmp_path_factory: pytest.TempPathFactory) -> Iterator[SharedNetwork]:
    with closing(SharedNetwork(tmp_path_factory.mktemp("three_nodes"))) as shared:
        yield shared


def test_parameters_are_set_atomically_between_two_ticks_or_refused(
    three_nodes: SharedNetwork,
) -> None:
    rng = random.Random(os.environ.get("SEED", "4"))
    run = load_offline_run("three_axis")
    R_WT, p_WT = run.controller.kinematics.forward(run.session.scene.start)
    target = Pose(np.add(p_WT, [0.0, 0.01, 0.0]), R_WT)
    with three_nodes() as (user, _):
        parameters = Parameters(user)
        x, y, z, w = map(float, target.quaternion())
        user.send_tool_target(tuple(map(float, target.p_WT)), 0.1, (x, y, z, w))
        user.wait("it", lambda: user.value("motion_controller", "tool targets") == "1")
        run.instructor.add(
            100_000_000, Pose.from_quaternion(tuple(map(float, target.p_WT)), (x, y, z, w))
        )
        go(user)
        tick = pause_at(user, rng.randint(120, 180))
        states = offline_states(run, tick + 1)  # this tick is answered already

        refused_bad_values(parameters, rng)
        joint, gain = rng.choice(JOINTS), rng.choice(GAINS)
        name = f"joints__{joint}__{gain}"
        old = parameters.get("servo", name.replace("__", "."))
        # One that is bad takes the good one with it.
        assert "hold_after" in parameters.set("servo", **{name: 0.7 * old}, cut_after=1e-3)
        assert parameters.get("servo", name.replace("__", ".")) == old
        new = (1.5 if gain == "integral_time" else 0.8) * old
        weight = rng.uniform(0.1, 1.0)
        assert parameters.set("servo", **{name: new}) == ""
        assert parameters.set("motion_controller", weight=weight) == ""
        assert parameters.set("emulator", timeout=7) == ""
        joints = tuple(
            dataclasses.replace(gains, **{gain: new}) if gains.name == joint else gains
            for gains in run.drives.servo.config.joints
        )
        run.drives.set_config(dataclasses.replace(run.drives.servo.config, joints=joints))
        assert isinstance(run.controller, JacobianController)
        run.controller.weight = weight
        states |= offline_states(run, tick + 200)
        assert user.call("emulator/pause", False).success
        user.wait("the run", lambda: user.tick >= tick + 200)
        assert_same_bits(user.motor_states(), states, tick + 200)


@pytest.mark.slow
def test_a_pace_slows_lock_step_down_without_changing_a_bit(three_nodes: SharedNetwork) -> None:
    states = offline_states(load_offline_run("three_axis"), 400)
    with three_nodes() as (user, _):
        parameters = Parameters(user)
        assert parameters.set("emulator", real_time_factor=0.5) == ""
        begun = time.monotonic()
        go(user)
        user.wait("the run", lambda: user.tick >= 100)
        assert time.monotonic() - begun > 0.1, "0.1 s of logical time take 0.2 s"
        assert user.status is not None and user.status.real_time_factor < 0.9
        # Another pace, and none, at once.
        assert parameters.set("emulator", real_time_factor=1000.0) == ""
        user.wait("the run", lambda: user.tick >= 200)
        assert parameters.set("emulator", real_time_factor=0.0) == ""
        user.wait("the run", lambda: user.tick >= 400)
        assert_same_bits(user.motor_states(), states, 400)


def refused_bad_values(parameters: Parameters, rng: random.Random) -> None:
    """Draw values that are not taken: nothing is half applied, and the reason is one line."""
    settable = {
        "servo": [f"joints.{rng.choice(JOINTS)}.{gain}" for gain in GAINS] + ["hold_after"],
        "motion_controller": ["weight", "step_limit", "singular_below"],
        "emulator": ["timeout"],
    }
    for node, names in settable.items():
        before = {name: parameters.get(node, name) for name in names}
        for name in names:
            bad = rng.choice(BAD)
            if bad == 1e308 and name.endswith("velocity_gain"):
                bad = 0.0  # which would be an absurd gain, but a number
            reason = parameters.set(node, **{name.replace(".", "__"): bad})
            assert name.rsplit(".", 1)[-1] in reason and "\n" not in reason, (name, bad, reason)
        assert before == {name: parameters.get(node, name) for name in names}, node
    for node, name, value in (
        ("servo", "period", 0.002),
        ("servo", "joints__elbow__resistance", 1.0),
        ("motion_controller", "period", 0.1),
        ("emulator", "scene", "ur5"),
    ):
        words = "must be set while the node is unconfigured, got active"
        assert words in parameters.set(node, **{name: value})


def test_every_number_has_a_range_and_words(three_nodes: SharedNetwork) -> None:
    floats, wholes = ParameterType.PARAMETER_DOUBLE, ParameterType.PARAMETER_INTEGER
    with three_nodes() as (user, _):
        parameters = Parameters(user)
        for node in ("emulator", "servo", "motion_controller"):
            names = [n for n in parameters.names(node) if not n.startswith("qos_")]
            about = parameters.describe(node, names)
            assert set(about) == set(names), node
            for name, descriptor in about.items():
                if name in ("use_sim_time", "start_type_description_service"):
                    continue
                assert descriptor.description, (node, name)
                if descriptor.type in (floats, wholes):
                    ranges = [*descriptor.floating_point_range, *descriptor.integer_range]
                    assert len(ranges) == 1 and ranges[0].from_value < ranges[0].to_value, name
        about = parameters.describe("servo", ["joints.elbow.gear_ratio", "joints.elbow.resistance"])
        words = {name: descriptor.description for name, descriptor in about.items()}
        assert words["joints.elbow.gear_ratio"].startswith("link turns per motor turn")
        assert words["joints.elbow.resistance"].endswith("(number >= 0 ohm)")
        assert set(SETTABLE) > {f.name for f in dataclasses.fields(JointServo)} & set(GAINS)
        user.wait("the nodes to meet", lambda: user.status and user.status.answered)
