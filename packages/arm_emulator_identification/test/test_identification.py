"""Numbers of machines found from records of their motion, and records that cannot be right."""

import dataclasses
from pathlib import Path

import numpy as np
import pytest
from draws import some
from machines import make_link_urdf, write_scene

from arm_emulator import Refusal, Scene, load_scene
from arm_emulator.base.io.config_files import find_scene
from arm_emulator_identification import inertia
from arm_emulator_identification.commands.identify import identify_scene
from arm_emulator_identification.filtered import filter_run
from arm_emulator_identification.found import list_numbers
from arm_emulator_identification.identified import add_followers, write_fitted
from arm_emulator_identification.measured_run import MeasuredRun, check_samples
from arm_emulator_identification.plausibility import filter_record
from arm_emulator_identification.read_run import read_run
from arm_emulator_identification.torque_fit import fit_torques
from arm_emulator_identification.torque_model import TorqueModel
from arm_emulator_identification.validation.kuka_kr300 import DATA, DELAYS, SHIPPED
from bench.identification import judge_numbers, load_truth
from oracles.synthetic_record import make_record

START = load_scene(DATA / "given.yaml")
RATIO = START.gear_ratios
RUN_A = read_run(SHIPPED[0], START, angles="deg").shift_back(DELAYS)


def look_over(run: MeasuredRun) -> list[str]:
    """All that `identify` asks of a record before it fits; its doubts."""
    check_samples(run)
    return filter_record(START, run, 10.0)[2]


def change(**changes: object) -> MeasuredRun:
    return dataclasses.replace(RUN_A, **{"v_motor": None, **changes})


def swapped(rows: np.ndarray, i: int, j: int) -> np.ndarray:
    order = np.arange(rows.shape[1])
    order[[i, j]] = j, i
    return rows[:, order]


def make_mistakes() -> dict[str, MeasuredRun]:
    """Every sign, every pair of axes, and units, in an order drawn at random."""
    q, tau = RUN_A.q_motor, RUN_A.tau
    mistakes = {
        "degrees reported as radians": change(q_motor=np.degrees(q)),
        "radians reported as degrees": change(q_motor=np.radians(q)),
        "torques at the links": change(tau=tau / RATIO),
        "torques in N mm": change(tau=1e3 * tau),
    }
    for j in range(6):
        flip = np.where(np.arange(6) == j, -1.0, 1.0)
        mistakes[f"torque {j} turned round"] = change(tau=flip * tau)
        mistakes[f"angle {j} turned round"] = change(q_motor=flip * q)
        for i in range(j):
            mistakes[f"torques {i} {j} swapped"] = change(tau=swapped(tau, i, j))
            mistakes[f"angles {i} {j} swapped"] = change(q_motor=swapped(q, i, j))
            both = change(tau=swapped(tau, i, j), q_motor=swapped(q, i, j))
            mistakes[f"columns {i} {j} swapped"] = both
    names = np.random.default_rng(3).permutation(sorted(mistakes))
    return {str(name): mistakes[str(name)] for name in names}


@pytest.mark.slow
def test_the_record_as_it_is_passes() -> None:
    assert look_over(RUN_A) == []


MISTAKES = make_mistakes()


@pytest.mark.slow
@pytest.mark.parametrize("slip", some(MISTAKES, 3))
def test_a_record_with_a_slip_is_refused_by_its_name(slip: str) -> None:
    with pytest.raises(Refusal) as refusal:
        look_over(MISTAKES[slip])
    answer = str(refusal.value)
    quantities = {"degrees": "angles", "radians": "angles", "torques": "torques", "torque": "axis"}
    assert quantities.get(slip.split(maxsplit=1)[0], "axis") in answer, f"{slip}: {answer}"
    if slip.endswith("swapped"):
        i, j = (int(number) + 1 for number in slip.split()[1:3])
        assert f"axis_{i}" in answer or f"axis_{j}" in answer, f"{slip}: {answer}"


def broken(rng: np.random.Generator) -> dict[str, tuple[MeasuredRun, str]]:
    """Records that are no measurement, each at places drawn at random, and what must be stated."""
    K, j = len(RUN_A.t), int(rng.integers(6))
    moving = np.flatnonzero(np.abs(np.gradient(RUN_A.q_motor[:, j], 0.004)) > 0.1)
    at = int(rng.choice(moving[(moving > 300) & (moving < K - 300)]))
    remaining = np.delete(np.arange(K), slice(at, at + int(rng.integers(1, 200))))
    nan, frozen, still = RUN_A.tau.copy(), RUN_A.q_motor.copy(), RUN_A.q_motor.copy()
    nan[at, j], frozen[at : at + 40, j], still[:, j] = np.nan, frozen[at, j], 0.3
    cut = {n: getattr(RUN_A, n)[remaining] for n in ("t", "q_motor", "tau", "q_link")}
    speeds = RUN_A.v_motor * np.where(np.arange(6) == j, -1.0, 1.0)
    huge = RUN_A.tau.copy()
    huge[at, j] = 10.0 ** rng.integers(10, 300)
    back = RUN_A.t.copy()
    back[at] = back[at - 1]
    name = f"axis_{j + 1}"
    return {
        "NaN": (change(tau=nan), f"tau of {name} must be finite"),
        "huge": (change(tau=huge), f"tau of {name} must be numbers within"),
        "nothing drives": (
            change(tau=np.where(np.arange(6) == j, 0.0, RUN_A.tau)),
            f"torque of {name} must change",
        ),
        "clock": (change(t=RUN_A.t * 10.0 ** rng.choice([-9, 3, 6])), "t must be in s"),
        "gap": (change(**cut), "without gaps"),
        "frozen": (change(q_motor=frozen), f"q_motor of {name} must change"),
        "at rest": (change(q_motor=still), f"{name} must move"),
        "time": (change(t=back), "t must increase"),
        "speeds": (dataclasses.replace(RUN_A, v_motor=speeds), f"v_mot of {name} must be the rate"),
        "units": (dataclasses.replace(RUN_A, v_motor=57.3 * RUN_A.v_motor), "are units the same"),
    }


@pytest.mark.parametrize("kind", broken(np.random.default_rng(0)))
def test_a_malformed_record_is_refused_with_its_place(kind: str) -> None:
    for seed in some(range(20), 2):
        run, answer = broken(np.random.default_rng(seed))[kind]
        with pytest.raises(Refusal, match=answer):
            look_over(run)


def test_files_that_are_no_records_are_refused_in_a_line(tmp_path: Path) -> None:
    np.savez(tmp_path / "no_torque.npz", t=RUN_A.t, q_mot=RUN_A.q_motor)
    np.savez(tmp_path / "five.npz", t=RUN_A.t, q_mot=RUN_A.q_motor[:, :5], tau=RUN_A.tau[:, :5])
    np.savez(tmp_path / "objects.npz", t=np.array([{}], dtype=object))
    (tmp_path / "cut.npz").write_bytes(SHIPPED[0].read_bytes()[:1000])
    (tmp_path / "text.csv").write_text("t,q_mot.axis_1\n0,much\n")
    (tmp_path / "what.mat").write_text("")
    (tmp_path / "bag").mkdir()
    for name in ("no_torque.npz", "five.npz", "objects.npz", "cut.npz", "text.csv", "what.mat",
                 "bag", "absent.npz"):  # fmt: skip
        with pytest.raises(Refusal) as refusal:
            read_run(tmp_path / name, START)
        assert len(str(refusal.value).splitlines()) == 1, refusal.value


def test_a_table_reads_as_the_archive(tmp_path: Path) -> None:
    columns = {"t": RUN_A.t}
    for j, joint in enumerate(START.joint_names):
        columns[f"tau.{joint}"] = RUN_A.tau[:, j]
        columns[f"q_mot.{joint}"] = np.degrees(RUN_A.q_motor[:, j] / RATIO[j])
    rows = np.column_stack(list(columns.values())).tolist()
    text = "\n".join([",".join(columns), *(",".join(map(repr, row)) for row in rows)])
    (tmp_path / "run.csv").write_text(text)
    run = read_run(tmp_path / "run.csv", START, angles="deg", side="motor")
    np.testing.assert_allclose(run.q_motor, RUN_A.q_motor, atol=1e-12, err_msg="motor to link")
    np.testing.assert_array_equal(run.tau, RUN_A.tau)


@pytest.mark.slow
def test_the_shipped_machine_is_near_the_identification_of_run_a(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """From run A alone; free runs have moved the shipped one a little since."""
    late = [f"{name}={value}" for name, value in DELAYS.items()]
    out, start = tmp_path / "kuka_kr300.yaml", str(DATA / "given.yaml")
    identify_scene(
        start, SHIPPED[0], hold="links.link_6.x,links.link_6.y", out=out, angles="deg", delay=late
    )
    assert "not identifiable" in capsys.readouterr().out
    identified, shipped = load_scene(out), load_scene("kuka_kr300")
    friction, stiffness = 0.2, 0.05
    for identified_joint, same in zip(identified.joints, shipped.joints, strict=True):
        for name in ("viscous", "coulomb"):
            values = (getattr(joint.rotor_friction, name) for joint in (identified_joint, same))
            assert next(values) == pytest.approx(next(values), rel=friction), (
                f"{identified_joint.name} {name}"
            )
        if identified_joint.gear.stiffness is not None:
            assert identified_joint.gear.stiffness == pytest.approx(
                same.gear.stiffness, rel=stiffness
            )


def test_truth_lies_within_the_confidence_reported() -> None:
    """Of records that the emulator made; bench/identification.py takes 50 of them."""
    scene = load_truth()
    every = np.concatenate([judge_numbers(scene, seed) for seed in some(range(50), 6)])
    # 95.4 % are expected; errors of a record go together, but less than 87 % is a fault.
    assert np.mean(np.abs(every) < 2.0) > 0.87, f"{np.mean(np.abs(every) < 2.0)} within 2 sigma"
    assert np.sqrt(np.mean(every**2)) < 1.5, "root of mean square, in deviations"


def fitted(folder: Path, scene: Scene, file: Path, seed: int) -> tuple[Scene, dict[str, float]]:
    """Numbers drawn from the range of fits are read back as written."""
    rng = np.random.default_rng(seed)
    N = len(scene.joints)
    model = TorqueModel(scene, (10.0 * np.ones(N), np.ones(N)), 0.5)
    values = model.start + model.widths * rng.standard_normal(len(model.start))
    values = np.clip(values, [unknown.least for unknown in model.unknowns],
                     [unknown.most for unknown in model.unknowns])  # fmt: skip
    pairs = zip(model.unknowns, values, strict=True)
    numbers = {
        unknown.name: float(value)
        for unknown, value in pairs
        if unknown.name.startswith("joints.") and not unknown.name.endswith("offset")
    }
    bodies = [
        inertia.make_body(row) if inertia.is_body(bare) else bare
        for row, bare in zip(model.compute_bodies(values), scene.bare, strict=True)
    ]
    out = folder / f"fitted_{seed}.yaml"
    write_fitted(out, file, scene, add_followers(scene, numbers), bodies, "found")
    return load_scene(out), numbers


@pytest.mark.parametrize("name", ["three_axis", "ur5", "panda", "kuka_kr300", "manutec_r3"])
def test_the_identified_scene_loads_with_the_identified_numbers(tmp_path: Path, name: str) -> None:
    """Of scenes with payloads, breakaway, aliases, and sections that are not there."""
    scene = load_scene(name)
    for seed in some(range(10), 2):
        again, numbers = fitted(tmp_path, scene, find_scene(name), seed)
        for joint in again.joints:
            for part in joint.parts:
                for key in part.list_numbers():
                    expected = numbers.get(f"joints.{joint.name}.{part.section}.{key}")
                    if expected is not None:
                        assert getattr(part, key) == pytest.approx(expected, rel=1e-8), (
                            f"{joint.name}: {part.section}.{key}"
                        )
        for loaded, was in zip(again.joints, scene.joints, strict=True):
            assert [type(part) for part in loaded.parts] == [type(part) for part in was.parts]


@pytest.mark.slow
def test_a_rotor_without_inertia_in_the_record_is_left_as_it_was(tmp_path: Path) -> None:
    """The bound of what must be above 0 is no finding."""
    motor = {"kind": "torque", "rotor_inertia": 1e-6, "friction": {"viscous": 0.01}}
    files = {}
    for name, inertia_m in (("true", 1e-6), ("known", 1e-3)):
        (tmp_path / name).mkdir()
        files[name] = write_scene(
            tmp_path / name, make_link_urdf(2.0), {"joint": {
                "motor": motor | {"rotor_inertia": inertia_m}, "gear": {"ratio": 0.05},
            }}, gravity=[0.0, 0.0, -9.81], servo_period=4e-3,
            integrator={"scheme": "rosenbrock", "dt": 1e-3},
        )  # fmt: skip
    record = make_record(load_scene(files["true"]), 3, 10.0, 1e-6, 0.01)
    nominal = load_scene(files["known"])
    data = filter_run(record, np.array([0.05]), 10.0)
    model = TorqueModel(nominal, (data.tau.std(axis=0), np.abs(data.v).max(axis=0)), 0.5)
    fit = fit_torques(model, data, model.choose_unknowns(["motor"], "test"))
    numbers = {number.name: number for number in list_numbers(nominal, fit)}
    number = numbers["joints.joint.motor.rotor_inertia"]
    assert number.value == 1e-3
    assert "left as it was: this record drives it to 5e-05" in number.line
