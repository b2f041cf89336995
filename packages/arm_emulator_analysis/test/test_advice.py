"""Advice on schemes and steps: for an error, into the scene file, and where a machine diverges."""

import math
import re
import sys
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from draws import FULL, some
from in_process import in_process
from machines import CONFIG, DC, GANTRY, PMSM, ROTOR, gantry_urdf, write_scene
from test_written_integrator import add_demo, scene_copy

from arm_emulator import Diverged, Plant, Refusal, Scene, load_scene
from arm_emulator.analysis.stability import describe_divergence
from arm_emulator.base.arrays import Array
from arm_emulator.cli.command_line import main
from arm_emulator_analysis.advice import Judge, compute_reserve, find_cheapest_settings, step_counts
from arm_emulator_analysis.commands.advise import find_cheapest_setting as advise_scene
from arm_emulator_analysis.commands.advise import read_commands, record_demo_commands
from arm_emulator_analysis.judged_motions import (
    KINDS,
    ExcitationMotions,
    JudgedMotion,
    list_motions,
)
from arm_emulator_analysis.true_motion import (
    IntegrationMethod,
    Runs,
    estimate_remainder,
    find_truth,
    is_confirmed,
)
from bench.advice import CLASSES, judge_scene
from oracles.event_reference import solve_with_events
from oracles.random_machines import write_machine
from oracles.reference import solve_positions

STEP = "step"
SHARE = 0.05  # of the requested error, to which docs/how_to/advice.md promises the truth


@cache
def demo() -> tuple[Judge, Array]:
    """The first 0.4 s of three_axis' demo (its target holds from 0.2 s on), and the true motion."""
    scene = load_scene("three_axis")
    commands = record_demo_commands(scene, CONFIG / "three_axis.yaml")
    assert commands is not None, "a demo"
    judge = Judge(scene, [JudgedMotion("demo", commands[:400])])
    truth = solve_positions(scene, commands[:400], scene.servo_period)
    assert np.ptp(truth, axis=0).max() > 1e-2, "10 mm of the tool at 0.6 m [rad]"
    return judge, truth


def try_only(monkeypatch: pytest.MonkeyPatch, *schemes: str) -> None:
    """Let advice try these schemes alone, unless all cases are asked for: each is compiled."""
    if not FULL:
        monkeypatch.setattr("arm_emulator_analysis.advice.SCHEMES", schemes)


def true_error(method: IntegrationMethod, steps: int) -> float:
    judge, truth = demo()
    q = judge.runs.simulate_q(method, steps, judge.motions[0].commands)
    assert q is not None, f"{method} diverges with {steps} steps"
    return float(np.abs(q - truth).max())


@pytest.mark.slow
@pytest.mark.parametrize("expected", some([1e-5, 1e-4, 3e-6, 1e-7, 1e-8], 1))
def test_settings_keep_the_error_by_an_independent_solution(expected: float) -> None:
    judge, _ = demo()
    result = find_cheapest_settings(judge, expected)
    assert result.settings == sorted(result.settings, key=lambda setting: setting.cost), (
        "the cheapest first"
    )
    assert {setting.method.events for setting in result.settings} == {STEP}, (
        "nothing here to locate"
    )
    for setting in result.settings:
        steps = round(1e-3 / setting.dt)
        true = true_error(setting.method, steps)
        # Off by the truth's own error, a share of what is wanted.
        assert setting.error - 2.0 * SHARE * expected <= true <= setting.error <= expected, (
            f"{setting}, {true}"
        )
        assert np.isinf(setting.others), "one motion reports nothing of others"
        for fewer in step_counts(max(1, steps // 2), steps):
            assert true_error(setting.method, fewer) > (1.0 - 2.0 * SHARE) * expected, (
                f"{fewer} will do"
            )


@pytest.mark.parametrize("seed", some([31, 10, 381, 138, 1, 470, 3, 0, 2], 1))
def test_truths_of_machines_that_stick_are_as_good_as_is_stated(seed: int, tmp_path: Path) -> None:
    """Dry friction and limits of currents, against SciPy from event to event."""
    file, rows = write_machine(tmp_path, seed)
    scene = load_scene(file, {"integrator.dt": 1e-3})
    expected, events = solve_with_events(scene, rows, scene.servo_period)
    assert events > 0, "nothing sticks, and nothing is limited"
    runs = Runs(scene)
    for target in (1e-4, 1e-7):
        result = find_truth(runs, rows, target, 100_000)
        assert not isinstance(result, str), result
        assert is_confirmed(runs, rows, result, target / SHARE, 100_000), (
            "by events at the ends of steps"
        )
        off = np.abs(result.q - expected).max()
        # The reference's own error, some 1e-12 a step.
        assert off <= result.error + 1e-10 and result.error <= target, f"{off:.1e}: {result}"


def test_the_remaining_error_follows_from_the_ratio_of_differences() -> None:
    assert estimate_remainder([1.0, 0.25]) == np.inf, "two differences show nothing"
    assert estimate_remainder([16.0, 4.0, 1.0]) == pytest.approx(1.0 / 3.0), "order 2"
    assert estimate_remainder([4.0, 2.0, 1.0]) == pytest.approx(1.0), "order 1"
    assert estimate_remainder([1.0, 1.0, 0.9]) == np.inf, "no order"
    assert estimate_remainder([1.0, 0.3, 1e-9]) > 1e-2, "a difference that is small by chance"
    assert estimate_remainder([0.0, 0.0, 0.0]) == 0.0, "nothing moves"


def test_a_truth_that_events_at_the_ends_of_steps_deny_is_dropped() -> None:
    """As if the code that locates events had them at other places than there are."""
    judge, _ = demo()
    commands = judge.motions[0].commands
    result = find_truth(judge.runs, commands, 1e-6, 4096)
    assert not isinstance(result, str), result
    assert is_confirmed(judge.runs, commands, result, 1e-6, 4096)
    result.q[-1] += 1e-3
    assert not is_confirmed(judge.runs, commands, result, 1e-6, 4096), "off by 1 mrad at the end"


# Every fifth scene is of the same class (bench/advice.py of this package): these are one each.
@pytest.mark.slow
@pytest.mark.parametrize("seed", some(range(len(CLASSES)), 1))
def test_the_stated_errors_hold_and_hardly_any_setting_is_cheaper(
    seed: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """`python -m bench.claims advice` has more scenes, longer motions and more errors."""
    try_only(monkeypatch, "implicit", "rosenbrock")
    verdicts = judge_scene(seed, seconds=0.2 if FULL else 0.1, errors=some([1e-5, 1e-6], 1))
    for verdict in verdicts:
        assert not verdict.none, verdict
        assert verdict.is_true, f"beyond what was reported: {verdict}"
        # 1.3 is the claim without a disturbance of the clock.
        assert verdict.cost < 2.0, f"dear: {verdict}"


def test_a_reserve_grows_where_a_motion_stands_out() -> None:
    even = np.linspace(0.5, 1.0, 20)
    assert compute_reserve(even) == 5.0, "the least"
    assert compute_reserve(np.append(even, 10.0)) == 10.0, "the next one may stand out as much"
    assert compute_reserve(even[:5]) == np.inf, "too few"
    assert compute_reserve(np.append(even, np.inf)) == np.inf, "one diverges"


@pytest.mark.slow
def test_divergence_is_an_infinite_error(monkeypatch: pytest.MonkeyPatch) -> None:
    """Stiff undamped gears: `paper` diverges down to very small steps."""
    try_only(monkeypatch, "paper", "rosenbrock")
    gear = {"joints.*.gear.stiffness": 1e7, "joints.*.gear.damping": 0.0}
    # With the libraries of other machines that differ in numbers only.
    scene = load_scene("three_axis", overrides={**gear, "varied": ["joints.*"]})
    judge = Judge(scene, [JudgedMotion("push", np.full((20, 3), 5.0))])
    assert judge.find_truths(1e-3) == "", "a truth"
    assert judge.compute_max_error(IntegrationMethod("paper", STEP), 1) == np.inf, (
        "an error of what diverges"
    )
    settings = {
        str(setting.method): setting for setting in find_cheapest_settings(judge, 1e-3).settings
    }
    assert "paper" not in settings or settings["paper"].dt < 1e-5, settings
    assert "rosenbrock" in settings, settings


def test_senseless_errors_and_missing_motions_are_refused() -> None:
    for expected in (0.0, -1.0, 1e-13, 2.0, float("nan")):
        with pytest.raises(Refusal, match="advise: error must be from 1e-11 to 1 rad"):
            find_cheapest_settings(demo()[0], expected)
    with pytest.raises(Refusal, match=r"nowhere.csv"):
        advise_scene("three_axis", motion=Path("nowhere.csv"))


# The motions


MOTORS: dict[str, dict[str, Any]] = {
    "dc": DC,
    "loop": DC | {"current_loop": {"bandwidth": 500.0}},
    "pmsm": PMSM,
    "torque": {"kind": "torque", "rotor_inertia": ROTOR, "torque_limit": 0.2},
    "current": {"kind": "current", "torque_constant": 0.05, "rotor_inertia": ROTOR,
                "current_limit": 3.0},
    "unlimited": {"kind": "torque", "rotor_inertia": ROTOR},
}  # fmt: skip


def three_motors(folder: Path, kinds: tuple[str, ...]) -> Scene:
    gear = {"ratio": -0.01, "stiffness": 1e5, "damping": 100.0}
    joints = {
        name: {"motor": MOTORS[kind], "gear": gear}
        for name, kind in zip(GANTRY, kinds, strict=True)
    }
    integrator = {"scheme": "rosenbrock", "dt": 1e-4}
    return load_scene(write_scene(folder, gantry_urdf(1e6), joints, integrator=integrator))


@pytest.mark.slow
@pytest.mark.parametrize(
    "kinds", some([("dc", "loop", "pmsm"), ("torque", "current", "unlimited")], 1)
)
def test_commands_are_in_the_unit_of_each_motor(kinds: tuple[str, ...], tmp_path: Path) -> None:
    """The torque and limit declared by a part are those of the machine."""
    scene = three_motors(tmp_path, kinds)
    plant = Plant(scene)
    commands = np.array([0.05, -0.02, 0.03])
    plant.advance(commands, 3000)  # until currents and gears have settled; the links are heavy
    expected = commands * [joint.torque_per_command for joint in scene.joints]
    assert plant.state.gear_torque == pytest.approx(expected, rel=2e-2), "torques of the links"
    limits = [joint.compute_largest_command(scene.supply_voltage) for joint in scene.joints]
    amplitude = 48.0 / math.sqrt(3.0)  # of which the core clamps commands of a pmsm
    target = {"dc": 48.0, "loop": 48.0, "pmsm": amplitude, "torque": 0.2, "current": 3.0}
    assert limits == [target.get(kind) for kind in kinds], "limits [V, A, N m]"
    motions = list_motions(scene, 0.1)
    assert {motion.name for motion in motions} == set(KINDS), "kinds of motions"
    largest = np.max([np.abs(motion.commands).max(axis=0) for motion in motions], axis=0)
    for j, limit in enumerate(limits):
        if limit is not None:
            assert largest[j] == pytest.approx(limit), "motions to the limit, and not beyond"
        else:
            assert 0.0 < largest[j] < np.inf, "what moves the joint briskly"


def test_motions_are_the_same_every_time_and_begin_at_rest() -> None:
    scene = load_scene("three_axis")
    for first, second in zip(list_motions(scene, 0.1), list_motions(scene, 0.1), strict=True):
        assert np.array_equal(first.commands, second.commands), first.name
    stop = ExcitationMotions(scene, 0.1).draw_motion("stop", np.random.default_rng(3)).commands
    assert (stop[50:] == 0.0).all() and np.abs(stop[:50]).max() > 0.0, "no commands from the middle"


def test_a_table_and_a_bag_are_motions(tmp_path: Path) -> None:
    scene = load_scene("three_axis")
    table = tmp_path / "mine.csv"
    table.write_text("t,elbow,waist,shoulder\n0,1,2,3\n0.003,4,5,6\n0.005,0,0,0\n")
    rows = read_commands(table, scene)
    expected = 3 * [[2, 3, 1]] + 2 * [[5, 6, 4]] + 2 * [[0, 0, 0]]
    assert rows.tolist() == expected, "rows hold until the next"
    with in_process("lockstep") as nodes:
        nodes.begin_record()
        nodes.run_to(20)
        assert nodes.call("emulator/reset").success  # the run that counts
        nodes.run_to(60)
        state = nodes.nodes["emulator"]._session.state
        nodes.write(tmp_path / "bag")
    read = read_commands(tmp_path / "bag", scene)[: round(state.t / scene.servo_period)]
    q = Plant(scene).run(read, scene.steps_per_period)
    assert np.array_equal(q[-1], state.q), "the motion again"
    assert np.abs(read).max() > 0.0, "a servo that holds the arm"
    with pytest.raises(Refusal, match="joints must be those of"):
        read_commands(tmp_path / "bag", load_scene("ur5"))


# Divergence of a machine


def diverged(plant: Plant, volts: np.ndarray) -> Diverged:
    with pytest.raises(Diverged) as reported:
        for row in volts:
            plant.advance(row, plant.scene.steps_per_period)
    return reported.value


@pytest.mark.parametrize("seed", some(range(4), 1))
def test_advice_is_on_the_values_that_a_machine_has_of_varied_numbers(seed: int) -> None:
    """Stiffer gears are set on an arm that holds: advice is that for an arm made with them."""
    rng = np.random.default_rng([seed, 9])
    common = {"varied": ["joints.*"], "integrator.scheme": "paper", "integrator.dt": 1e-3}
    scene = load_scene("three_axis", overrides=common)
    values = {}
    for number in scene.varied:
        kind = number.name.split(".", 2)[2]
        decades = {"gear.stiffness": (1.0, 3.0), "gear.damping": (-1.0, 0.3)}.get(kind, (-0.1, 0.1))
        values[number.name] = float(number.value * 10.0 ** rng.uniform(*decades))
    volts = rng.uniform(-20.0, 20.0, (1000, 3))
    plant = Plant(scene)
    plant.advance(volts[0], 100)  # with the scene's own values it holds
    for name, value in values.items():
        plant.set_parameter(name, value)
    plant.reset()
    reported_divergence = diverged(plant, volts)
    assert {number.name: number.value for number in reported_divergence.scene.varied} == values, (
        "values at the divergence"
    )
    reference_plant = Plant(load_scene("three_axis", overrides={**common, **values}))
    expected = diverged(reference_plant, volts)
    assert reported_divergence.t == expected.t, "when it diverged"
    hint = describe_divergence(reported_divergence)
    assert hint == describe_divergence(expected), "what would hold for small motions"
    assert "each step multiplies a small motion" in hint, hint


def test_command_shows_the_worth_of_errors_and_writes(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    file = scene_copy(tmp_path)
    add_demo(file)
    monkeypatch.setattr("arm_emulator_analysis.commands.advise.SECONDS", 0.2)
    monkeypatch.setattr(
        sys, "argv", ["arm_emulator", "advise", str(file), "--error", "1e-5", "--write"]
    )
    with pytest.raises(SystemExit) as end:
        main()
    assert not end.value.code, "exit code"
    printed = capsys.readouterr().out
    lines = printed.splitlines()
    now = next(line.split() for line in lines if line.startswith("now  "))
    shipped = load_scene("three_axis").integrator
    assert now[1:3] == [shipped.scheme, f"{shipped.dt:g}"], "what the scene has, beside"
    words = "scene three_axis, 28 motions of 0.2 s and 0.4 s of its demo; wanted: error <= 1e-05"
    assert lines[0].startswith(words), printed
    cheapest = next(line.split() for line in lines if line.startswith("cheapest  "))
    _, scheme, dt, judged, others, _ = cheapest
    assert float(judged) <= 1e-5 and float(others) >= 5.0 * float(judged) * 0.98, cheapest
    worth = next(line for line in lines if line.startswith("errors: a bound for the 29 motions"))
    assert "an estimate, with a reserve of" in worth, worth
    integrator = load_scene(file).integrator
    assert (integrator.scheme, f"{integrator.dt:.6g}") == (scheme, dt), "reported, and written"


def test_a_motion_of_the_user_is_judged_alone(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    table = tmp_path / "mine.csv"
    rows = "t,waist,shoulder,elbow\n0,1,2,3\n{},-4,5,-6\n{},0,0,0\n"
    table.write_text(rows.format(0.03, 0.05))
    assert advise_scene("three_axis", error=1e-5, motion=table) == 0
    printed = capsys.readouterr().out
    assert "scene three_axis, 0.07 s of mine.csv; wanted" in printed, printed
    assert "errors: a bound for the motions that were judged, not for others" in printed, printed
    turned = scene_copy(tmp_path)
    text = re.sub(r"start: [-0-9.]+", "start: 10000.0", turned.read_text())
    turned.write_text(text)
    table.write_text(rows.format(0.004, 0.006))
    # After many turns an angle is rounded to 2e-12 rad in every step.
    assert advise_scene(str(turned), error=1e-11, motion=table) == 1, "exit code"
    printed = capsys.readouterr().out
    assert "no setting keeps it: motion mine.csv: steps that are halved agree to" in printed


def test_a_scene_without_a_demo_is_judged_all_the_same(tmp_path: Path) -> None:
    file = scene_copy(tmp_path).rename(tmp_path / "mine.yaml")
    assert record_demo_commands(load_scene(file), file) is None, "it has none"
