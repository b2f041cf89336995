"""Data files of joints that exist, and new scenes with them."""

import json
from dataclasses import astuple
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from draws import some, with_slow
from machines import CONFIG
from test_new_drives import untuned

from arm_emulator import Plant, Refusal, load_scene
from arm_emulator.analysis.torque_terms import TorqueTerms
from arm_emulator.cli.command_line import main
from arm_emulator.design.joint_data import JointData, list_joint_names, load_joint_data
from arm_emulator.design.new_scene import write_new
from arm_emulator.machine.parts.frictions.friction import Friction
from arm_emulator.machine.parts.shaft_motion import ShaftMotion
from bench.physics.origins import list_origins
from bench.physics.published_joints import JOINTS
from oracles.bam import Bam

# At the output; of the servo of model M1 Coulomb's and viscous friction alone.
PUBLISHED = {name: astuple(joint)[:-1] for name, joint in JOINTS.items()} | {
    "sts3215": (0.0523929, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0, 2.0, 0.0590852),
}  # fmt: skip
# N m/A, kg m2 and A or V/ohm at the output.
MOTORS = {
    "erob80_50": (4.89677, 0.36174), "erob80_100": (9.3963, 1.1351), "mx64": (1.60168, 0.0122659),
    "mx106": (2.20983, 0.0260162), "xl320": (1.00883, 0.00116299), "xl330": (0.366013, 0.00180774),
    "sts3215": (1.21164, 0.0284034),
}  # fmt: skip

__all__ = ["untuned"]  # a fixture

TWO = """<robot name="two"><link name="base"/>{}</robot>"""
LINK = """
<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{name}_link"/>
<origin xyz="0 0 {z}"/><axis xyz="0 1 0"/></joint>
<link name="{name}_link"><inertial><origin xyz="0 0 {com}"/><mass value="{mass}"/>
<inertia ixx="{i}" iyy="{i}" izz="{i}" ixy="0" ixz="0" iyz="0"/></inertial></link>"""


def robot_of(folder: Path, kind: str = "continuous", mass: float = 0.5) -> Path:
    """Write a description of an upper arm and a forearm."""
    links = LINK.format(name="shoulder", kind="continuous", parent="base", z=0.0, com=0.1,
                        mass=2.0 * mass, i=0.01 * mass)  # fmt: skip
    links += LINK.format(name="elbow", kind=kind, parent="shoulder_link", z=0.2, com=0.1,
                         mass=mass, i=0.01 * mass)  # fmt: skip
    file = folder / "two.urdf"
    file.write_text(TWO.format(links))
    return file


def law_of(name: str) -> tuple[Bam, float]:
    """Return the budget of a joint at its output, and its viscous friction."""
    *budget, viscous = PUBLISHED[name]
    return Bam(*budget), viscous


def test_the_joints_are_those_of_the_source() -> None:
    assert list_joint_names() == sorted(PUBLISHED)


@pytest.mark.parametrize("name", PUBLISHED)
def test_every_figure_of_a_joint_has_a_source_or_a_range(name: str) -> None:
    figures = list_origins(CONFIG / "joints" / f"{name}.yaml")
    assert {figure.section for figure in figures} >= {"motor", "motor.friction", "gear"}
    published = {figure.key for figure in figures if figure.assumed is None}
    assert {"torque_constant", "rotor_inertia", "coulomb", "viscous"} <= published
    assert "Apache-2.0" in (CONFIG / "joints" / f"{name}.yaml").read_text(), "the licence"


@pytest.mark.parametrize("name", PUBLISHED)
def test_a_joint_has_the_published_friction_and_motor(name: str) -> None:
    """Behind the gear, at rest, in motion, driving and driven."""
    joint = load_joint_data(name).joint
    (law, viscous), Ng, friction = law_of(name), joint.gear.ratio, joint.rotor_friction
    assert isinstance(friction, Friction)
    rng = np.random.default_rng(7)
    size = 50.0 if name.startswith("erob") else 2.0
    tau, outside = rng.uniform(-size, size, (2, 300))
    speed = rng.choice([-1.0, 1.0], 300) * 10 ** rng.uniform(-3.0, 1.0, 300)
    none = np.zeros(300)
    at = ShaftMotion(none, none, speed / Ng, none, Ng * outside, Ng * tau, Ng)
    budget = [
        float(np.sign(w) * (law(1.0, w, A, S, abs(A) > abs(S)) + viscous * abs(w)))
        for w, A, S in zip(speed, tau, outside, strict=True)
    ]
    # The figures have six digits.
    assert friction.compute_effort(at) / Ng == pytest.approx(np.array(budget), rel=2e-5)
    numbers = vars(joint.motor)
    constant, inertia = MOTORS[name]
    assert numbers["torque_constant"] / Ng == pytest.approx(constant, rel=2e-5)
    assert numbers["back_emf_constant"] == numbers["torque_constant"], "SI"
    assert numbers["rotor_inertia"] / Ng**2 == pytest.approx(inertia, rel=2e-5)


@pytest.mark.slow
@pytest.mark.usefixtures("untuned")
@pytest.mark.parametrize(
    "name", with_slow(some(["erob80_100", "mx106", "sts3215", *PUBLISHED], 2), 1)
)
def test_a_new_arm_of_such_joints_moves_with_their_friction(tmp_path: Path, name: str) -> None:
    written = write_new(robot_of(tmp_path, mass=0.1), tmp_path / "arm", joint_data=[name])
    scene = load_scene(written.file)
    data = load_joint_data(name)
    assert scene.supply_voltage == data.supply
    for joint in scene.joints:
        assert (joint.motor, joint.gear, joint.rotor_friction, joint.decorators) == (
            data.joint.motor, data.joint.gear, data.joint.rotor_friction, data.joint.decorators,
        )  # fmt: skip
    text = written.file.read_text()
    assert "Apache-2.0" in text, "the licence is in the scene"
    assert f"stiffness: {data.joint.gear.stiffness}  # N m/rad; assumed " in text, (
        "its mark is in the scene"
    )
    plant, terms, rng = Plant(scene), TorqueTerms(scene), np.random.default_rng(8)
    law, viscous = law_of(name)
    Ng, K = data.joint.gear.ratio, data.joint.gear.stiffness
    assert K is not None
    units = 1.0 / data.joint.torque_per_command
    for _ in range(40):
        tau, gear = rng.uniform(-1.0, 1.0, (2, 2)) * 0.3 * data.torque
        w = rng.choice([-1.0, 1.0], 2) * 10 ** rng.uniform(-2.0, 0.0, 2)
        plant.reset()
        q = plant.state.q.copy()
        # Currents as the torques call for; voltages beyond the induced ones.
        current = tau * Ng / vars(data.joint.motor)["torque_constant"]
        plant.put("test", {"q": q, "v": w, "theta_m": (q + gear / K) / Ng, "omega_m": w / Ng,
                           "current": current})  # fmt: skip
        command = tau * units
        if data.joint.unit == "V":
            command = command + vars(data.joint.motor)["back_emf_constant"] * w / Ng
        now = terms.evaluate_torques(plant.save(), command).rotor["friction"] / Ng
        for j in range(2):
            budget = law(1.0, w[j], tau[j], gear[j], abs(tau[j]) > abs(gear[j]))
            expected = -np.sign(w[j]) * (budget + viscous * abs(w[j]))
            assert now[j] == pytest.approx(expected, rel=1e-4), f"{name}: {tau}, {gear}, {w}"
    plant.reset()
    plant.run(np.zeros((200, 2)), 2)
    assert plant.diverged is None and np.isfinite(plant.state.q).all()


@pytest.mark.usefixtures("untuned")
def test_one_joint_may_be_another_one(tmp_path: Path) -> None:
    written = write_new(robot_of(tmp_path), tmp_path / "arm", joint_data=["mx64", "elbow=mx106"])
    shoulder, elbow = load_scene(written.file).joints
    assert shoulder.gear.ratio == 1 / 200 and elbow.gear.ratio == 1 / 225
    # A joint that is not named is sized by the rules.
    written = write_new(robot_of(tmp_path), tmp_path / "one", joint_data=["elbow=mx64"])
    shoulder, elbow = load_scene(written.file).joints
    assert elbow.gear.ratio == 1 / 200 and shoulder.rotor_friction is None


def test_a_joint_is_asked_for_what_its_motor_gives() -> None:
    for name in list_joint_names():
        data: JointData = load_joint_data(name)
        motor: dict[str, Any] = vars(data.joint.motor)
        Ng = data.joint.gear.ratio
        at_speed = data.supply - motor["back_emf_constant"] * data.speed / Ng
        current = data.torque * Ng / motor["torque_constant"]
        assert 0.0 < current * motor["resistance"] <= at_speed, f"{name}: volts for both at a time"
        assert current <= (motor["current_limit"] or np.inf)


@pytest.mark.parametrize(
    ("data_files", "kind", "refusal"),
    [
        (["mx65"], "continuous",
         "--joint must name a joint with a data file, got mx65; valid: erob80_100"),
        (["wrist=mx64"], "continuous",
         "--joint must be JOINT=NAME of a moving joint, got wrist=mx64; valid: shoulder, elbow"),
        (["mx64", "elbow=xl330"], "continuous",
         "--joint must name joints for one supply voltage, got mx64 for 15 V, xl330 for 7.5 V"),
        (["elbow=mx64"], "prismatic",
         "--joint must be of a joint that turns, got elbow, a prismatic one"),
        (["mx64", "mx106"], "continuous",
         "--joint must be given once for all joints, got mx64 mx106"),
        (["elbow=mx64", "mx106", "elbow=mx106"], "continuous",
         "--joint must be given once for elbow, got elbow=mx64 mx106 elbow=mx106"),
    ],
)  # fmt: skip
def test_joints_that_do_not_fit_are_refused(
    tmp_path: Path, data_files: list[str], kind: str, refusal: str
) -> None:
    robot = robot_of(tmp_path, kind)
    robot.write_text(robot.read_text().replace(
        '<axis xyz="0 1 0"/></joint>',
        '<axis xyz="0 1 0"/><limit lower="-1" upper="1" effort="10" velocity="1"/></joint>',
    ))  # fmt: skip
    with pytest.raises(Refusal) as caught:
        write_new(robot, tmp_path / "arm", joint_data=data_files)
    assert refusal in str(caught.value)


@pytest.mark.parametrize("data_files", [["mx64"], ["elbow=mx64", "shoulder=mx106"]])
def test_a_kind_of_motor_that_no_joint_would_have_is_refused(
    tmp_path: Path, data_files: list[str]
) -> None:
    rule = "--motor must be left out where --joint names the motor of each joint, got pmsm"
    with pytest.raises(Refusal, match=rule):
        write_new(robot_of(tmp_path, "continuous"), tmp_path, joint_data=data_files, motor="pmsm")


@pytest.mark.usefixtures("untuned")
def test_the_command_takes_joints(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    robot, out = robot_of(tmp_path), tmp_path / "arm"
    words = ["new", str(robot), "--joint", "mx64", "--out", str(out), "--json"]
    monkeypatch.setattr("sys.argv", ["arm_emulator", *words])
    with pytest.raises(SystemExit) as end:
        main()
    assert end.value.code in (0, None)
    text = capsys.readouterr().out
    assert json.loads(text)["sources"] == ["config/joints/mx64.yaml"]
    assert yaml.safe_load((out / "two.yaml").read_text())["supply_voltage"] == 15.0
