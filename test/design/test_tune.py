"""The command `tune`, and the gains that it writes."""

import dataclasses
import re
import xml.etree.ElementTree as ET
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from draws import some
from machines import CONFIG, Oracle, write_scene

from arm_emulator import Refusal, load_scene, load_servo_config
from arm_emulator.analysis.servo_loop import draw_poses
from arm_emulator.cli.commands.tune import tune_scene
from arm_emulator.design import tuned
from arm_emulator.design.gain_text import write_gains
from arm_emulator.design.tuned import (
    compute_falls,
    compute_group_gains,
    compute_link_inertias,
    compute_servo,
    hold_falling_link,
)
from arm_emulator.servo.servo_config import ServoConfig


def change_gains(servo: ServoConfig, rng: np.random.Generator, rigid: bool) -> ServoConfig:
    joints = tuple(
        dataclasses.replace(
            joint,
            position_gain=float(f"{rng.uniform(1, 100):.3g}"),
            velocity_gain=float(f"{rng.uniform(1, 1e4):.3g}"),
            integral_time=float(f"{rng.uniform(0.01, 1):.3g}"),
            observer_bandwidth=float(f"{rng.uniform(10, 900):.3g}"),
            link_inertia=float(f"{rng.uniform(0.1, 9):.3g}") if rigid else joint.link_inertia,
        )
        for joint in servo.joints
    )
    return dataclasses.replace(servo, joints=joints)


@pytest.mark.parametrize("rigid", [False, True])
@pytest.mark.parametrize("name", ["three_axis", "ur5", "panda", "so_arm100"])
def test_gains_are_written_and_nothing_else_changes(name: str, rigid: bool, tmp_path: Path) -> None:
    rng = np.random.default_rng([rigid, len(name)])
    file = tmp_path / "servo.yaml"
    before = (CONFIG / "servo" / f"{name}.yaml").read_text()
    file.write_text(before)
    expected = change_gains(load_servo_config(file), rng, rigid)
    write_gains(file, expected)
    assert load_servo_config(file) == expected
    comments = re.compile(r"#.*")
    after = file.read_text()
    assert comments.findall(after) == comments.findall(before), "comments"
    assert list(tmp_path.iterdir()) == [file], "nothing is left over"
    gains = "position_gain|velocity_gain|integral_time|observer_bandwidth|link_inertia"
    others = [
        [line for line in text.splitlines() if not re.search(gains, line)]
        for text in (before, after)
    ]
    assert others[0] == others[1], "lines that are no gains"
    again = change_gains(expected, rng, rigid)
    write_gains(file, again)  # a link_inertia that is there is replaced
    assert load_servo_config(file) == again


def test_a_dotted_file_is_written_too(tmp_path: Path) -> None:
    file = tmp_path / "servo.yaml"
    text = (CONFIG / "servo" / "three_axis.yaml").read_text()
    head, joints = text.split("    joints:\n")
    lines, name = [], ""
    for line in joints.splitlines():
        if line.rstrip().endswith(":"):
            name = line.strip()[:-1]
        else:
            lines.append(f"    joints.{name}.{line.strip()}")
    file.write_text(head + "\n".join(lines) + "\n")
    expected = change_gains(load_servo_config(file), np.random.default_rng(0), rigid=True)
    write_gains(file, expected)
    assert load_servo_config(file) == expected


def test_values_that_joints_share_are_refused_and_stay(tmp_path: Path) -> None:
    file = tmp_path / "servo.yaml"
    text = (CONFIG / "servo" / "three_axis.yaml").read_text()
    shared = text.replace("      waist:\n", "      waist: &one\n")
    start = shared.index("      shoulder:\n")
    shared = shared[:start] + "      shoulder: *one\n      elbow: *one\n"
    file.write_text(shared)
    expected = change_gains(load_servo_config(file), np.random.default_rng(0), rigid=False)
    with pytest.raises(Refusal, match="have values of its own for each joint"):
        write_gains(file, expected)
    assert file.read_text() == shared


def test_inertias_are_those_of_the_mass_matrix() -> None:
    """Against Pinocchio over the same poses: M_jj, and 1 / (M^-1)_jj."""
    scene = load_scene("ur5")
    oracle = Oracle(scene)
    lowest, highest = [], []
    for q in draw_poses(scene, tuned.POSES):
        M = pin.crba(oracle.model, oracle.data, oracle.configuration(q))
        M = np.triu(M) + np.triu(M, 1).T
        lowest.append(1.0 / np.diag(np.linalg.inv(M)))
        highest.append(np.diag(M))
    expected = np.array([np.min(lowest, axis=0), np.max(highest, axis=0)]).T
    ranges = np.array(compute_link_inertias([scene]))
    assert np.abs(ranges / expected - 1.0).max() < 1e-9, "kg m2, least and largest per joint"


def test_links_fall_as_the_derivative_of_their_weight() -> None:
    """Against Pinocchio's derivatives of the weight, over the same poses."""
    scene = load_scene("ur5")
    oracle = Oracle(scene)
    highest = np.zeros(6)
    for q in draw_poses(scene, tuned.POSES):
        at = oracle.configuration(q)
        slope = pin.computeGeneralizedGravityDerivatives(oracle.model, oracle.data, at)
        highest = np.maximum(highest, -np.diag(slope))
    np.testing.assert_allclose(compute_falls(scene), highest, atol=1e-4)  # N m/rad, of up to 58


def test_poses_on_a_slide_without_end_are_near() -> None:
    """Not a kilometre away, where what turns the slide would feel 1e8 kg m2."""
    scene = load_scene("three_axis")
    robot = ET.fromstring(scene.urdf)
    joint = next(
        element for element in robot.iter("joint") if element.get("name") == scene.joint_names[0]
    )
    joint.set("type", "prismatic")
    for limit in joint.findall("limit"):
        joint.remove(limit)
    ET.SubElement(joint, "limit", {"lower": "-1e9", "upper": "1e9"})
    text = ET.tostring(robot, encoding="unicode")
    samples = np.array(draw_poses(dataclasses.replace(scene, urdf=text), 50))[1:]
    assert 0.3 < np.abs(samples[:, 0]).max() <= 0.5


@pytest.mark.parametrize("seed", some(range(200), 30))
def test_a_loop_holds_a_link_that_falls(seed: int) -> None:
    """Poles of M s^3 + K s^2 + (K kp - G) s + K kp / Ti: stable, with half the gain, too."""
    rng = np.random.default_rng(seed)
    file = CONFIG / "servo" / "ur5.yaml"
    M, K = 10.0 ** rng.uniform(-2, 2), 10.0 ** rng.uniform(-1, 3)
    kp = K / (3.0 * M)
    G = K * kp * 10.0 ** rng.uniform(-3.0, 0.0)
    joint = dataclasses.replace(
        load_servo_config(file).joints[0], velocity_gain=K, position_gain=kp, integral_time=5.0 / kp
    )
    shared = dataclasses.replace(joint, position_gain=kp * rng.uniform(0.05, 1.0))
    stiffened = hold_falling_link(shared, G, kp)
    assert (stiffened == shared) == (2.0 * G <= K * shared.position_gain)
    for share in (0.6, 1.0, 2.0):
        k, stiff = share * K, share * K * stiffened.position_gain
        poles = np.roots([M, k, stiff - G, stiff / stiffened.integral_time])
        assert poles.real.max() < 0.0, (share, M, K, G)


@pytest.mark.slow
def test_gains_of_an_arm_exceed_the_growth_of_its_falling_links(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """As if ur5 had a tower on its shoulder: that joint alone gets more stiffness."""
    scene, servo = load_scene("ur5"), load_servo_config(CONFIG / "servo" / "ur5.yaml")
    inertias = compute_link_inertias([scene])
    before = compute_servo(scene, servo, inertias)
    fall = 3.0 * before.joints[1].position_gain * before.joints[1].velocity_gain
    monkeypatch.setattr(tuned, "compute_falls", lambda scene: fall * np.eye(6)[1])
    after = compute_servo(scene, servo, inertias)
    shoulder = after.joints[1]
    assert shoulder.position_gain * shoulder.velocity_gain >= 0.99 * 2.0 * fall
    assert [*after.joints[:1], *after.joints[2:]] == [*before.joints[:1], *before.joints[2:]]


def test_a_slow_joint_does_not_make_all_others_slow() -> None:
    """As the base of Fetch, whose arm then took 12 s to come to rest."""
    arm = [20.7, 21.2, 41.3, 33.9, 34.0, 96.2]
    assert compute_group_gains(arm) == [20.7] * 6
    assert compute_group_gains([0.75, *arm]) == [0.75, *[20.7] * 6]
    assert compute_group_gains([0.75, 4.6, *arm]) == [0.75, 0.75, *[20.7] * 6]
    assert compute_group_gains([arm[5], 0.75]) == [arm[5], 0.75]


def test_tune_shows_draws_and_writes(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    scene = tmp_path / "arm.yaml"
    text = (CONFIG / "three_axis.yaml").read_text()
    urdf = (CONFIG / "urdf" / "three_axis.urdf").resolve()
    scene.write_text(text.replace("urdf/three_axis.urdf", str(urdf)))
    (tmp_path / "servo").mkdir()
    file = tmp_path / "servo" / "arm.yaml"
    file.write_text((CONFIG / "servo" / "three_axis.yaml").read_text())
    before = load_servo_config(file)
    assert tune_scene(str(scene), out=tmp_path / "out", write=True) == 0
    printed = capsys.readouterr().out
    for words in ("margins, worst pose", "overshoot", "at rest", "written: "):
        assert words in printed, f"{words!r} is not in\\n{printed}"
    assert (tmp_path / "out" / "tune_three_axis.png").stat().st_size > 10_000, "bytes of a picture"
    after = load_servo_config(file)
    assert after != before
    alike = {joint.position_gain for joint in after.joints}
    assert len(alike) == 1, "the joints of a tool path keep together"


def test_tune_refuses_a_joint_without_a_motor(tmp_path: Path) -> None:
    urdf = (CONFIG / "urdf" / "three_axis.urdf").read_text()
    scene = write_scene(tmp_path, urdf, {"waist": {}, "shoulder": {}, "elbow": {}})
    (tmp_path / "servo").mkdir()
    servo = (CONFIG / "servo" / "three_axis.yaml").read_text()
    (tmp_path / "servo" / scene.name).write_text(servo)
    with pytest.raises(Refusal, match=r"joints\.waist must have a motor to be tuned, got none"):
        tune_scene(str(scene))
