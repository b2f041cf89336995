"""Parameters of the servo: how they may be written, and what is refused."""

import dataclasses
import math
from pathlib import Path
from typing import Any

import pytest
import yaml
from one_motor import CONFIG, JOINT

from arm_emulator.base.refusal import Refusal
from arm_emulator.motion.model.config import load_motion_config
from arm_emulator.servo.servo import ServoConfig, load_servo_config


def parameters() -> dict[str, Any]:
    """The parameters of a servo with one joint."""
    joint = dataclasses.asdict(JOINT)
    name = joint.pop("name")
    return {
        "period": 1e-3,
        "motion_period": 0.05,
        "hold_after": 0.2,
        "cut_after": 2.0,
        "supply_voltage": 48.0,
        "joint_names": [name],
        "joints": {name: joint},
    }


def test_parameters_may_be_nested_or_dotted_and_bring_ros_parameters() -> None:
    nested = parameters()
    dotted = {k: v for k, v in nested.items() if k != "joints"}
    dotted |= {f"joints.joint.{k}": v for k, v in nested["joints"]["joint"].items()}
    dotted |= {"use_sim_time": False, "qos_overrides./clock.subscription.depth": 1}
    expected = ServoConfig(1e-3, 0.05, 0.2, 2.0, 48.0, (JOINT,))
    assert ServoConfig.from_mapping(nested, "test") == expected
    assert ServoConfig.from_mapping(dotted, "test") == expected


def test_inductance_and_current_limit_may_be_left_out() -> None:
    mapping = parameters()
    del mapping["joints"]["joint"]["inductance"], mapping["joints"]["joint"]["current_limit"]
    (joint,) = ServoConfig.from_mapping(mapping, "test").joints
    assert joint.inductance == 0.0
    assert joint.current_limit == math.inf


@pytest.mark.parametrize(
    ("path", "value", "words"),
    [
        ("period", 0.0, "period must be a number > 0 s, got 0.0"),
        ("period", None, "period must be given"),
        ("motion_period", 0.0505, "motion_period must be a whole multiple of period"),
        ("cut_after", 0.2, "cut_after must be > hold_after"),
        ("gravity", 9.81, "gravity must be a known key, got an unknown one; valid: period"),
        ("joint_names", [], "joint_names must be a list of different joint names"),
        ("joint_names", ["joint", "joint"], "joint_names must be a list of different joint"),
        ("joint_names", ["other"], "joints.joint must be a known key"),
        ("joint_names", ["joint", "more"], "joints.more must be given"),
        ("joints", 3, "joints must be a mapping"),
        ("joints.joint", 3, "joints.joint must be a mapping"),
        ("joints.joint.torque_constant", None, "joints.joint.torque_constant must be given"),
        ("joints.joint.stiffness", 1e4, "joints.joint.stiffness must be a known key"),
        ("joints.joint.observer_bandwidth", 2000.0, "observer_bandwidth must be <= 1/period"),
        ("joints.joint.position_gain", 2000.0, "position_gain must be <= 1/period"),
        ("joints.joint.integral_time", 1e-4, "integral_time must be >= period"),
    ],
)
def test_bad_parameters_are_refused(path: str, value: object, words: str) -> None:
    mapping = parameters()
    *parents, leaf = path.split(".")
    table = mapping
    for parent in parents:
        table = table[parent]
    if value is None:
        del table[leaf]
    else:
        table[leaf] = value
    with pytest.raises(Refusal) as refusal:
        ServoConfig.from_mapping(mapping, "servo.yaml")
    assert words in str(refusal.value)
    assert str(refusal.value).startswith("servo.yaml: ")
    assert "\n" not in str(refusal.value)


def test_parameters_that_are_no_mapping_or_repeated_are_refused() -> None:
    with pytest.raises(Refusal, match="the parameters must be a mapping"):
        ServoConfig.from_mapping([1], "test")  # type: ignore[arg-type]
    with pytest.raises(Refusal, match=r"period\.x must be given once"):
        ServoConfig.from_mapping({"period": 1e-3, "period.x": 2.0}, "test")


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (None, "servo.yaml must exist, got no such file"),
        ("other: {ros__parameters: {}}", "hold the parameters of the node servo, got other"),
        ("servo: 1", "hold the parameters of the node servo, got servo; valid: servo: ros__para"),
    ],
)
def test_bad_parameter_files_are_refused(tmp_path: Path, text: str | None, words: str) -> None:
    file = tmp_path / "servo.yaml"
    if text is not None:
        file.write_text(text)
    with pytest.raises(Refusal, match=words):
        load_servo_config(file)


@pytest.mark.parametrize("node", ["servo", "/servo", "/**/servo", "/**"])
def test_parameter_files_may_name_the_node_or_all_nodes(tmp_path: Path, node: str) -> None:
    file = tmp_path / "servo.yaml"
    file.write_text(yaml.safe_dump({node: {"ros__parameters": parameters()}}))
    assert load_servo_config(file).joint_names == tuple(parameters()["joint_names"])
    motion = tmp_path / "motion.yaml"
    name = node.replace("servo", "motion_controller")
    motion.write_text(yaml.safe_dump({name: {"ros__parameters": {"weight": 0.25}}}))
    assert load_motion_config(motion).weight == 0.25


@pytest.mark.parametrize("scene", ["three_axis", "ur5", "panda", "so_arm100"])
def test_drives_know_the_motors_of_their_scene(scene: str) -> None:
    config = load_servo_config(CONFIG / "servo" / f"{scene}.yaml")
    machine = yaml.safe_load((CONFIG / f"{scene}.yaml").read_text())
    assert config.joint_names == tuple(machine["joints"])
    assert config.period == machine["servo_period"]
    assert config.supply_voltage == machine["supply_voltage"]
    for joint in config.joints:
        section = machine["joints"][joint.name]
        assert joint.gear_ratio == section["gear"]["ratio"]
        assert joint.counts_per_turn == section["encoder"]["counts_per_turn"]
        for name, value in section["motor"].items():
            if name == "current_loop":
                assert joint.current_bandwidth == value["bandwidth"]
            elif name not in ("current_limit", "friction"):
                assert getattr(joint, name) == float(value)
