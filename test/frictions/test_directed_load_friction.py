"""Friction that knows the direction of power: published joints, lossy gears, worms."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from balance import balance_of
from draws import FULL, some, with_slow
from lossy_joint import Law, LossyGear, LossyGearDriven, Rotor
from machines import write_scene
from scipy.optimize import brentq

from arm_emulator import Plant, Refusal, Scene, load_scene
from arm_emulator.analysis.torque_terms import TorqueTerms
from arm_emulator.base.arrays import Array
from arm_emulator.machine.parts.frictions.load_friction import DIRECTED, RotorLoadFriction
from arm_emulator.machine.parts.shaft_motion import ShaftMotion
from arm_emulator.machine.plant.scene_unit import write_scene_unit
from bench.physics.published_joints import JOINTS, Published
from oracles.bam import Bam
from oracles.random_chain import write_slides

MASS, WEIGHT = 2.0, 19.62  # kg, N
PERIOD, ROWS = 0.02, 15
EROB80_100, EROB80_50 = JOINTS["erob80_100"], JOINTS["erob80_50"]
OUTSIDE = 50.0  # N m, at the output of these

Friction = dict[str, float]
Case = tuple[Rotor, Friction, bool]  # whether the section of friction is that of the rotor


def scene_of(folder: Path, *cases: Case, weight: float = WEIGHT, **integrator: Any) -> Scene:
    """Return the machine of joints that do not feel each other, under the same weight each."""
    sections = {}
    for k, (joint, friction, at_rotor) in enumerate(cases):
        motor: dict[str, Any] = {"kind": "torque", "rotor_inertia": joint.Jm}
        gear = {"ratio": joint.Ng}
        if joint.Kg:
            gear |= {"stiffness": joint.Kg, "damping": joint.Dg}
        section: dict[str, Any] = {"motor": motor, "gear": gear}
        (motor if at_rotor else section)["friction"] = friction
        sections[f"joint{k}"] = section
    file = write_scene(
        folder, write_slides(sections), sections, servo_period=PERIOD,
        gravity=[-weight / MASS, 0.0, 0.0], energy_flow=True,
        integrator={"scheme": "rosenbrock", "dt": PERIOD / 40, "events": "located", **integrator},
        varied=["joints.*"],  # one library for all draws
    )  # fmt: skip
    return load_scene(file)


def vary(plant: Plant, k: int, joint: Rotor, friction: Friction) -> None:
    """Give joint k of a machine the numbers of another joint of its ratio."""
    numbers = {"motor.rotor_inertia": joint.Jm, "gear.stiffness": joint.Kg,
               "gear.damping": joint.Dg}  # fmt: skip
    friction = {key: value for key, value in friction.items() if key != "breakaway"}  # follows
    numbers |= {f"motor.friction.{key}": value for key, value in friction.items()}
    for name, value in numbers.items():
        plant.set_parameter(f"joints.joint{k}.{name}", value)


def states(plant: Plant, rows: Array, steps: int) -> Array:
    """Return angles of rotors and positions of links (2, N) after each command."""
    reached = []
    for row in rows:
        plant.advance(row, steps)
        reached.append([plant.state.theta_m, plant.state.q])
    return np.array(reached)


RATIOS = -0.02, 0.02  # a library has one ratio for each joint


def sample_joint(
    rng: np.random.Generator, at_link: bool = False, ratio: float = 0.0
) -> tuple[Rotor, Array]:
    """A weight behind a spring, and commands that lift it, let it down and hold it."""
    ratio = ratio or float(rng.choice(RATIOS))
    stiffness = float(10 ** rng.uniform(3.0, 4.3))
    joint = Rotor(
        Jm=float(10 ** rng.uniform(-4.3, -3.3)), Ng=ratio, Kg=stiffness,
        Dg=0.02 * float(np.sqrt(MASS * stiffness)), mass=MASS, weight=WEIGHT,
        viscous=0.0, law=lambda *_: 0.0, at_link=at_link,
    )  # fmt: skip
    return joint, ratio * joint.weight * (1.0 + rng.uniform(-1.2, 1.2, ROWS))


def sample_bam(rng: np.random.Generator, scale: float, speed: float) -> Bam:
    """A budget of some tenths of a torque, of the class of the published ones."""
    Kc = float(rng.uniform(0.02, 0.1)) * scale
    Km, Ke, Kms, Kes, Kmq, Keq = rng.uniform(0.0, 0.2, 6).tolist()
    return Bam(Kc, 0.5 * Kc, Km, Ke, Kms, Kes, Kmq / scale, Keq / scale,
               speed * float(rng.uniform(0.3, 2.0)), float(rng.uniform(1.2, 3.5)))  # fmt: skip


def sample_lossy(rng: np.random.Generator, scale: float) -> tuple[LossyGear, Friction]:
    """LossyGear of a rotor, its bearing at flange a, and the section of the scene for it."""
    eta1, eta2 = rng.uniform(0.5, 0.95, 2).tolist()
    bearing = float(rng.uniform(0.02, 0.1)) * scale
    law = LossyGear(eta1, eta2, eta1 * bearing, bearing / eta2)
    return law, {"coulomb": bearing, "load": 1.0 / eta1 - 1.0, "back_load": 1.0 - eta2}


def sample_driven(rng: np.random.Generator, scale: float) -> tuple[LossyGear, Friction]:
    """LossyGear of a link, or behind a rigid gear: its bearing at flange b."""
    eta1, eta2 = rng.uniform(0.5, 0.95, 2).tolist()
    bearing = float(rng.uniform(0.02, 0.1)) * scale
    law = LossyGearDriven(eta1, eta2, bearing, bearing)
    return law, {"coulomb": bearing, "load": 1.0 - eta1, "back_load": 1.0 / eta2 - 1.0}


def sample_case(kind: str, seed: int, ratio: float = 0.0) -> tuple[Case, Array]:
    """A joint and its commands."""
    rng = np.random.default_rng([seed, 91])
    joint, rows = sample_joint(rng, kind.endswith(("link", "rigid")), ratio)
    if is_rigid := kind.endswith("rigid"):
        joint = replace(joint, Kg=0.0, Dg=0.0)
    scale, speed = abs(joint.Ng) * joint.weight, 10.0
    if joint.at_link:
        scale, speed = joint.weight, 0.3
    viscous = float(rng.uniform(0.0, 0.05)) * scale / speed
    law: Law
    if kind.startswith("budget"):
        law = sample_bam(rng, scale, speed)
        if is_rigid:  # where the motor's torque is the gear's
            law = replace(law, Ke=law.Ke + law.Km, Kes=law.Kes + law.Kms, Km=0.0, Kms=0.0)
        friction = law.make_section(viscous)
    else:
        law, friction = (sample_driven if joint.at_link else sample_lossy)(rng, scale)
        friction["viscous"] = viscous
    at_rotor = "rotor" in kind
    if is_rigid:
        friction = {key: value for key, value in friction.items() if "motor_load" not in key}
        if at_rotor:  # as one of the rotor that turns with the link
            torque = abs(joint.Ng)
            by = {"viscous": torque**2, "coulomb": torque, "breakaway": torque,
                  "stribeck": 1.0 / torque, "rest_load_square": 1.0 / torque,
                  "rest_motor_square": 1.0 / torque}  # fmt: skip
            friction = {key: value * by.get(key, 1.0) for key, value in friction.items()}
    return (replace(joint, law=law, viscous=viscous), friction, at_rotor), rows


KINDS = ("budget of a rotor", "lossy gear of a rotor", "budget of a link", "lossy gear of a link",
         "budget, rigid", "lossy gear, rigid", "budget of a rotor, rigid",
         "lossy gear of a rotor, rigid")  # fmt: skip
# Kinds beside each other. Machines of even seeds and of odd ones move by different schemes, and
# each kind by one of them in `make test`.
BESIDE = [(seed, KINDS[(seed + half) % 2 :: 2]) for half in (0, 1) for seed in some(range(10), 2)]


def compare(
    folder: Path, samples: Sequence[tuple[Case, Array]], **integrator: Any
) -> tuple[Array, Array]:
    """Return the largest errors (N,) of 40 and 640 steps a period, by the sizes of the motions."""
    solved = [case[0].run(rows, PERIOD, np.zeros(4)) for case, rows in samples]
    assert all(stops for _, stops in solved), "each joint shall stop on its way"
    truth = np.stack([states[:, [0, 2]] for states, _ in solved], axis=2)
    cases, commands = [case for case, _ in samples], np.stack([rows for _, rows in samples], axis=1)
    errors = []
    for steps in (40, 640):
        plant = Plant(scene_of(folder, *cases, **integrator, dt=PERIOD / steps))
        off = np.abs(states(plant, commands, steps) - truth) / np.abs(truth).max(axis=0)
        errors.append(off.max(axis=(0, 1)))
    return errors[0], errors[1]


@pytest.mark.parametrize(("seed", "kinds"), with_slow(BESIDE, 1))
def test_motion_is_that_of_the_published_law_with_order_two(
    tmp_path: Path, seed: int, kinds: tuple[str, ...]
) -> None:
    samples = [sample_case(kind, seed) for kind in kinds]
    errors = compare(tmp_path, samples, scheme=("rosenbrock", "extrapolated")[seed % 2])
    for kind, coarse, fine in zip(kinds, *errors, strict=True):
        # A constant pull and no spring: the scheme has no error, but that of its event times.
        if coarse < 1e-7:
            continue
        # Events come and go where a step resolves the swing badly; the mean order hardly varies.
        assert np.log2(coarse / fine) / 4.0 > 1.75, f"{kind}: {coarse} {fine}"
        assert fine < 1e-3, f"{kind}: {coarse} {fine}"


@pytest.mark.slow
@pytest.mark.parametrize("kind", some(KINDS, 3))
def test_without_located_events_the_motion_is_that_of_the_law_too(
    tmp_path: Path, kind: str
) -> None:
    samples = [sample_case(kind, 1, ratio) for ratio in RATIOS]
    coarse, fine = compare(tmp_path, samples, events="step")
    # Of order 1 it falls by 16, but each event lies well or badly within a step.
    assert (fine < np.maximum(coarse / 2.0, 1e-7)).all() and (fine < 0.02).all(), (coarse, fine)


def erob_case(law: Bam, viscous: float) -> Case:
    """The actuator by its output, with a spring that is stiff against what is measured."""
    joint = Rotor(Jm=1.1350955632532613, Ng=1.0, Kg=1e4, Dg=200.0, mass=MASS, weight=OUTSIDE,
                  viscous=viscous, law=law)  # fmt: skip
    return joint, law.make_section(viscous), True


def settled(plant: Plant, torque: float) -> None:
    """Wind the spring up to the load, without motion of the rotor."""
    plant.advance(np.array([torque]), 4000)
    assert plant.state.omega_m[0] == 0.0, "the load shall be held"


def ramped(plant: Plant, begin: float, by: float) -> float:
    """Return the torque of the motor at which the rotor begins to move, of a slow ramp."""
    settled(plant, begin)
    torque = begin
    for _ in range(4000):
        if plant.state.omega_m[0] != 0.0:
            return torque
        torque += by
        plant.advance(np.array([torque]), 100)
    raise AssertionError("it never moves")


@pytest.mark.slow
@pytest.mark.parametrize("law", [EROB80_100, EROB80_50])
def test_a_published_actuator_breaks_away_where_its_budget_states(
    tmp_path: Path, law: Published
) -> None:
    """Under a torque from outside, by a motor whose torque grows, and falls, until it moves."""
    scene = scene_of(tmp_path, erob_case(law, law.Kv), weight=OUTSIDE, dt=5e-4)
    drives = brentq(lambda tau: tau - OUTSIDE - law(1.0, 0.0, tau, OUTSIDE, True), 50.0, 90.0)
    driven = brentq(lambda tau: OUTSIDE - tau - law(-1.0, 0.0, tau, OUTSIDE, False), 1.0, 50.0)
    step = 0.01
    assert ramped(Plant(scene), OUTSIDE, step) == pytest.approx(drives, abs=2.0 * step)
    assert ramped(Plant(scene), OUTSIDE, -step) == pytest.approx(driven, abs=2.0 * step)


def slowed(plant: Plant, torque: float, speed: float, outside: float) -> float:
    """Return the friction on the rotor that turns at a speed, from how it slows down [N m].

    The spring carries what is outside: the link moves with the rotor.
    """
    inertia, wind_up, step = 1.1350955632532613, outside / 1e4, 1e-6
    plant.put("test", {"q": [0.0], "v": [speed], "theta_m": [wind_up], "omega_m": [speed]})
    plant.advance(np.array([torque]), 1)
    return torque - outside - inertia * float(plant.state.omega_m[0] - speed) / step


@pytest.mark.slow
def test_erob80_100_has_the_published_friction_at_rest_and_in_motion(tmp_path: Path) -> None:
    """50 N m from outside: 45 N m of the motor hold it, or none."""
    case = erob_case(EROB80_100, EROB80_100.Kv)
    plant = Plant(scene_of(tmp_path, case, weight=OUTSIDE, dt=1e-6, events="step"))
    nearly_at_rest = 1e-4  # rad/s
    measured = [
        slowed(plant, 45.0, nearly_at_rest, 50.0),
        slowed(plant, 45.0, 10.0, 50.0) - 10.0 * EROB80_100.Kv,
        slowed(plant, 0.0, nearly_at_rest, 50.0),
    ]
    assert measured == pytest.approx([15.5, 2.2, 7.8], abs=0.06), "N m, as published"


@pytest.mark.slow
def test_friction_of_the_machine_is_the_budget_at_random_torques_and_speeds(
    tmp_path: Path,
) -> None:
    rng = np.random.default_rng(92)
    for law in (EROB80_100, EROB80_50):
        scene = scene_of(tmp_path, erob_case(law, 0.5), weight=OUTSIDE, dt=5e-4)
        plant, terms = Plant(scene), TorqueTerms(scene)
        for _ in range(150):
            tau, gear = rng.uniform(-60.0, 60.0, 2)
            speed = float(rng.choice([-1.0, 1.0]) * 10 ** rng.uniform(-3.0, 1.0))
            plant.put("test", {"q": [0.0], "v": [speed], "theta_m": [gear / 1e4],
                               "omega_m": [speed]})  # fmt: skip
            now = terms.evaluate_torques(plant.save(), np.array([tau])).rotor["friction"][0]
            budget = law(1.0, speed, tau, gear, abs(tau) > abs(gear)) + 0.5 * abs(speed)
            assert -now * np.sign(speed) == pytest.approx(budget, rel=1e-9), (tau, gear, speed)


def test_the_law_in_python_is_the_budget_at_random_torques_and_speeds() -> None:
    """Identification fits it to measured motions."""
    rng = np.random.default_rng(95)
    tau, gear, speed = rng.uniform(-60.0, 60.0, (3, 200))
    none = np.zeros(200)
    at = ShaftMotion(none, none, 0.1 * speed, none, gear, tau, 1.0)
    for law in (EROB80_100, EROB80_50):
        budget = [
            law(np.sign(w), w, A, S, abs(A) > abs(S))
            for w, A, S in zip(at.speed, tau, gear, strict=True)
        ]
        dry = RotorLoadFriction(**law.make_section(0.5)).compute_dry_torque(at)
        assert dry == pytest.approx(np.array(budget), rel=1e-12)


def sample_budgets(
    rng: np.random.Generator, back_load: float = 0.0
) -> tuple[list[Case], list[Bam], Array]:
    """A rotor of each ratio with its budget, and their commands (ROWS, 2).

    Up to `back_load` of what is let down rubs beside it; the sections have all keys, so that the
    machines share a library.
    """
    cases, laws, commands = list[Case](), list[Bam](), []
    for ratio in RATIOS:
        joint, rows = sample_joint(rng, ratio=ratio)
        scale = abs(ratio) * joint.weight
        laws.append(sample_bam(rng, scale, 10.0))
        friction = laws[-1].make_section(0.01 * scale)
        friction |= {"back_load": friction["load"], "rest_back_load": friction["rest_load"]}
        if back_load:
            friction |= {key: float(rng.uniform(0.0, back_load)) for key in friction
                         if "back_load" in key}  # fmt: skip
        cases.append((joint, friction, True))
        commands.append(rows)
    return cases, laws, np.stack(commands, axis=1)


@pytest.mark.slow
def test_friction_only_takes_energy(tmp_path: Path) -> None:
    """Draws of the law, of its load and of the direction, two at a time."""
    rng, worst, plant = np.random.default_rng(93), 0.0, None
    for draw in range(250 if FULL else 60):
        cases, _, rows = sample_budgets(rng, back_load=2.0)
        plant = plant or Plant(scene_of(tmp_path, *cases, dt=PERIOD / 160))
        plant.reset()
        for k, (joint, friction, _) in enumerate(cases):
            vary(plant, k, joint, friction)
        for row in rows[:4]:
            flow = plant.powers(row)
            assert (flow.dissipated >= 0.0).all(), f"draw {draw}: {flow}"
            plant.advance(row, 40)
        balance = balance_of(plant, rows[4:6], 160)
        worst = max(worst, balance.left / balance.exchanged)
    # The error of the scheme, of order 2, of what went to and fro.
    assert worst < 1e-3, f"{worst} of what was exchanged came from nowhere"


def find_torque(rng: np.random.Generator, law: Bam, joint: Rotor) -> float:
    """Return a torque inside the cone, under which a joint at rest remains there."""
    S = joint.Ng * joint.weight
    share = float(rng.uniform(-0.98, 0.98))
    direction = float(np.sign(share))

    def excess(tau: float) -> float:
        return direction * (tau - S) - law(direction, 0.0, tau, S, abs(tau) > abs(S))

    far = S + direction * 20.0 * abs(S)
    end = brentq(excess, S + direction * 1e-9 * abs(S), far)
    return S + abs(share) * (end - S)


def creep(folder: Path, draws: int, seconds: float, modes: Sequence[str]) -> None:
    """Hold random joints for so long at random loads inside the cone: they do not move at all."""
    rng, dt = np.random.default_rng(94), 0.01
    plants = dict[str, Plant]()
    for draw in range(draws // 2):
        cases, laws, _ = sample_budgets(rng)
        events = modes[draw % len(modes)]
        if events not in plants:
            plants[events] = Plant(scene_of(folder, *cases, events=events, dt=dt))
        plant = plants[events]
        plant.reset()
        for k, (joint, friction, _) in enumerate(cases):
            vary(plant, k, joint, friction)
        before = np.array([joint.weight / joint.Kg / joint.Ng for joint, *_ in cases])
        plant.put("test", {"q": [0.0, 0.0], "v": [0.0, 0.0], "omega_m": [0.0, 0.0],
                           "theta_m": before})  # fmt: skip
        torques = [find_torque(rng, law, case[0]) for law, case in zip(laws, cases, strict=True)]
        plant.advance(np.array(torques), round(seconds / dt))
        assert (plant.state.theta_m == before).all(), f"draw {draw} creeps under {torques} N m"


def test_a_joint_that_holds_does_not_creep(tmp_path: Path) -> None:
    creep(tmp_path, 20, 60.0, ["located"])


@pytest.mark.slow
def test_a_thousand_joints_do_not_creep_in_an_hour(tmp_path: Path) -> None:
    creep(tmp_path, 1000, 3600.0, ["located", "step"])


WORM = {"coulomb": 0.005, "load": 1.5}  # of the motor's shaft: 40 % of efficiency forward


@pytest.mark.slow
@pytest.mark.parametrize(
    ("events", "backward", "locks"),
    with_slow(
        [
            ("located", -0.1, True),
            ("located", 0.25, False),
            ("located", -0.3, True),
            ("step", -0.3, True),
            ("step", -0.1, True),
            ("step", 0.25, False),
        ],
        2,
    ),
)
def test_a_worm_holds_without_power_where_its_lead_is_small(
    tmp_path: Path, events: str, backward: float, locks: bool
) -> None:
    """Emergency stop of a weight on its way up, and on its way down: no power, and no brake."""
    joint = Rotor(Jm=2e-4, Ng=0.02, Kg=2e4, Dg=20.0, mass=MASS, weight=WEIGHT,
                  viscous=0.0, law=lambda *_: 0.0)  # fmt: skip
    friction = {**WORM, "back_load": 1.0 - backward}
    S = joint.Ng * joint.weight
    for torque in (3.0 * S, -0.9 * S):
        plant = Plant(scene_of(tmp_path, (joint, friction, True), events=events, dt=1e-4))
        plant.advance(np.array([torque]), 1500)
        moving = plant.state.omega_m[0]
        assert moving * torque > 0.0, "it shall move when the stop comes"
        plant.powered = False
        plant.advance(np.array([0.0]), 5000)
        at = plant.state.theta_m[0]
        plant.advance(np.array([0.0]), 50_000)
        if locks:
            assert plant.state.theta_m[0] == at and plant.state.omega_m[0] == 0.0, "held exactly"
        else:
            assert plant.state.theta_m[0] < at - 1.0, "the weight drives the worm back"


@pytest.mark.parametrize("events", with_slow(["located", "step"], 1))
def test_a_worm_without_power_stops_where_the_closed_form_states(
    tmp_path: Path, events: str
) -> None:
    """Random worms that lock, on their way up and down: both equations of a rigid hoist."""
    rng, plant = np.random.default_rng(96), None
    for _ in range(10):
        lead = np.radians(rng.uniform(2.0, 8.0))
        rub = lead * rng.uniform(1.1, 2.0)
        load = float(np.tan(lead + rub) / np.tan(lead) - 1.0)
        back_load = float(1.0 - np.tan(lead - rub) / np.tan(lead))
        carried = MASS * back_load * rng.uniform(1.0, 3.0)
        joint = Rotor(Jm=carried * 0.02**2, Ng=0.02, Kg=3e6, Dg=800.0, mass=MASS,
                      weight=WEIGHT, viscous=0.0, law=lambda *_: 0.0)  # fmt: skip
        friction = {"coulomb": 0.0, "load": load, "back_load": back_load}
        if plant is None:
            plant = Plant(scene_of(tmp_path, (joint, friction, True), events=events, dt=2e-4))
        vary(plant, 0, joint, friction)
        for speed in (0.2, -0.2):
            # The rotor's equation is carried a = -share T, the load's T = WEIGHT + MASS a.
            share = 1.0 + load if speed > 0.0 else 1.0 - back_load
            a = share * joint.weight / (carried + share * MASS)
            at_rest = joint.weight / joint.Kg / joint.Ng
            plant.put("test", {"q": [0.0], "v": [speed], "omega_m": [speed / joint.Ng],
                               "theta_m": [at_rest]})  # fmt: skip
            plant.advance(np.array([0.0]), 5000)
            assert plant.state.omega_m[0] == 0.0
            distance = 0.02 * (plant.state.theta_m[0] - at_rest)
            # The gear swings at 1 kHz and more, and stops take 5 ms and more.
            assert distance == pytest.approx(np.sign(speed) * speed**2 / (2.0 * abs(a)), rel=0.02)


@pytest.mark.parametrize(("friction", "at_rotor", "line"), [
    ({"load": 0.1, "motor_load": 0.1}, True,
     r"motor\.friction\.motor_load must come with an elastic gear .*: load\), got 0\.1"),
    ({"load": 0.1, "rest_motor_load": 0.0}, True,
     r"motor\.friction\.rest_motor_load must come with an elastic gear .*: rest_load\), got 0"),
    ({"load": 1.0}, True, r"motor\.friction\.load must be below 1 behind a rigid gear"),
    ({"load": 1.5, "back_load": 1.7}, False,
     r"joint0\.friction\.load must be below 1 behind .* efficiency is 1 - load, got 1\.5"),
])  # fmt: skip
def test_loads_that_a_rigid_gear_has_not_are_refused(
    tmp_path: Path, friction: Friction, at_rotor: bool, line: str
) -> None:
    joint = replace(sample_joint(np.random.default_rng(2), at_link=True)[0], Kg=0.0, Dg=0.0)
    with pytest.raises(Refusal, match=line):
        scene_of(tmp_path, (joint, friction, at_rotor))


def test_load_friction_of_a_joint_without_a_motor_is_refused(tmp_path: Path) -> None:
    file = write_scene(tmp_path, write_slides(["joint"]), {"joint": {"friction": {"load": 0.1}}})
    with pytest.raises(Refusal, match=r"friction\.load must belong to a joint with a motor"):
        load_scene(file)


def test_an_exponent_without_a_speed_is_refused(tmp_path: Path) -> None:
    joint, _ = sample_joint(np.random.default_rng(1))
    with pytest.raises(Refusal, match=r"motor\.friction\.exponent must come with a stribeck speed"):
        scene_of(tmp_path, (joint, {"load": 0.1, "exponent": 1.5}, True))


@pytest.mark.parametrize("key", DIRECTED)
@pytest.mark.parametrize("place", ["elbow.friction", "elbow.motor.friction"])
def test_each_key_names_the_law_without_load(place: str, key: str) -> None:
    """A published joint with K_e = 0 has no `load`, which is then 0."""
    given = {"coulomb": 0.1, "stribeck": 1.0, key: 0.6}
    with_zero, without = (
        write_scene_unit(load_scene("three_axis", {f"joints.{place}": friction}))
        for friction in (given | {"load": 0.0}, given)
    )
    assert without == with_zero
    assert "DirectedLoadFriction" in without
