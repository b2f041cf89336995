"""Random machines whose compiled core watches itself: AddressSanitizer and UBSan.

python -m fuzz.cores SEED FIRST STEP: machine FIRST, FIRST + STEP, ... of a seed, until it is ended.

A machine answers any call, refuses it or reports a divergence; what it refuses changes
nothing, and its state is always finite.
"""

import itertools
import math
import os
import subprocess
import sys
import tempfile
import time
import traceback
import zlib
from pathlib import Path
from typing import Any

import numpy as np
from machines import list_moving_joints, write_random_chain, write_scene

from arm_emulator import Diverged, Plant, Refusal, Scene, load_scene
from arm_emulator.machine.scene.integrator import DEEPEST_EXCHANGE
from arm_emulator.machine.schemes.known import SCHEMES
from arm_emulator.machine.session.real_time import open_real_time_session
from fuzz.line import FAILED, REFUSED, TAKEN, report

HERE = Path(__file__).resolve().parent
CALLS = 200  # of one machine
LARGEST = 1.7e308


def environment(cache: Path) -> dict[str, str]:
    """Return the environment of a process whose machines are compiled by `sanitizing_cxx`."""
    libraries = [
        subprocess.run(
            [os.environ.get("SANITIZED_CXX", "c++"), f"-print-file-name={name}"],
            capture_output=True,
            text=True,
            check=True,
        ).stdout.strip()
        for name in ("libasan.so", "libubsan.so")
    ]
    return {
        **os.environ,
        "CXX": str(HERE / "sanitizing_cxx"),
        "ARM_EMULATOR_CACHE": str(cache),  # apart from the machines that people use
        "LD_PRELOAD": " ".join(libraries),
        "ASAN_OPTIONS": "detect_leaks=0",  # Python's
        "UBSAN_OPTIONS": "print_stacktrace=1",
    }


def size(rng: np.random.Generator, ordinary: float) -> float:
    """Return a number > 0, mostly near an ordinary one, now and then far away from it."""
    span = 1.0 if rng.random() < 0.8 else 8.0
    return float(ordinary * 10.0 ** rng.uniform(-span, span))


def random_joint(rng: np.random.Generator) -> dict[str, Any]:
    """Return a random section of a joint."""
    joint: dict[str, Any] = {"start": float(rng.normal())}
    if rng.random() < 0.85:
        joint["motor"] = {
            "resistance": size(rng, 1.0),
            "torque_constant": size(rng, 0.05),
            "back_emf_constant": size(rng, 0.05),
            "rotor_inertia": size(rng, 1e-4),
            **({"inductance": size(rng, 1e-3)} if rng.random() < 0.6 else {}),
            **({"current_limit": size(rng, 10.0)} if rng.random() < 0.4 else {}),
        }
        if "inductance" in joint["motor"] and rng.random() < 0.4:
            gains = {"proportional_gain": size(rng, 3.0), "integral_gain": size(rng, 1e3)}
            bandwidth = {"bandwidth": size(rng, 500.0)}
            joint["motor"]["current_loop"] = gains if rng.random() < 0.5 else bandwidth
        if rng.random() < 0.8:
            joint["gear"] = {"ratio": float(min(size(rng, 0.01), 1000.0))}
            if rng.random() < 0.7:
                joint["gear"] |= {"stiffness": size(rng, 1e4), "damping": size(rng, 10.0)}
                if rng.random() < 0.4:
                    joint["gear"]["cubic_stiffness"] = size(rng, 1e9)
        if rng.random() < 0.7:
            joint["encoder"] = {"counts_per_turn": int(rng.integers(1, 100_000))}
    if rng.random() < 0.5:
        joint["friction"] = {"viscous": size(rng, 0.1)}
        if rng.random() < 0.5:
            joint["friction"]["coulomb"] = size(rng, 0.5)
    return joint


def random_encoder(rng: np.random.Generator) -> dict[str, Any]:
    """Return a random section of an encoder."""
    counts = int(min(size(rng, 1e4) + 1.0, 1e9))
    encoder: dict[str, Any] = {"counts_per_turn": counts, "delay": int(rng.integers(0, 4))}
    if rng.random() < 0.4:
        encoder |= {
            "kind": "absolute",
            "bits": int(rng.integers((counts - 1).bit_length() + 1, 49)),
        }
    else:
        encoder["index"] = str(rng.choice(["none", "latch", "correct"]))
    errors = {
        "offset": float(rng.normal()),
        "eccentricity": min(size(rng, 1e-3), 1.0),
        "ripple": min(size(rng, 1e-3), 1.0),
        "noise": min(size(rng, 1e-3), 1.0),
        "missed": min(size(rng, 1e-3), 0.5),
    }
    return encoder | {key: value for key, value in errors.items() if rng.random() < 0.5}


def random_converter(rng: np.random.Generator) -> dict[str, Any]:
    """Return a random section of a sensor of currents, torques, accelerations or rates."""
    numbers = {
        "gain_error": float(rng.uniform(-1.0, 1.0)),
        "noise": min(size(rng, 0.1), 1e6),
        "range": size(rng, 10.0),
        "resolution": size(rng, 0.01),
    }
    return {key: value for key, value in numbers.items() if rng.random() < 0.5}


def random_sensors(rng: np.random.Generator, joints: dict[str, Any], link: str) -> dict[str, Any]:
    """Give some joints sensors; return further keys of the scene, with a unit on that link."""
    for joint in joints.values():
        of_motor = ("encoder", "current_sensor", "torque_sensor") if "motor" in joint else ()
        for key in (*of_motor, "link_encoder"):
            if rng.random() < 0.4:
                kind = random_encoder if key.endswith("encoder") else random_converter
                joint[key] = kind(rng)
    if rng.random() < 0.5:
        return {}
    axes = {key: random_converter(rng) for key in ("accelerometer", "gyroscope")}
    pose = {"xyz": rng.normal(size=3).tolist(), "rpy": rng.normal(size=3).tolist()}
    unit = {"link": link, "delay": int(rng.integers(0, 3)), **pose, **axes}
    return {"imus": {"unit": unit}, "seed": int(rng.integers(0, 2**53))}


def random_machine(rng: np.random.Generator, folder: Path, joints: int) -> Path:
    """Write a random scene of so many joints and return its path."""
    urdf = write_random_chain(rng, joints)
    names = list_moving_joints(urdf)
    scheme = str(rng.choice(SCHEMES))
    dt = float(rng.choice([1e-3, 5e-4, 1e-4, 2e-5]))
    keys: dict[str, Any] = {"integrator": {"scheme": scheme, "dt": dt}}
    if scheme != "rosenbrock" and rng.random() < 0.4:
        keys["threads"] = 2
        keys["integrator"]["exchange"] = str(rng.choice(["predict", "lag"]))
        keys["integrator"]["exchange_depth"] = 1 + zlib.crc32(urdf.encode()) % DEEPEST_EXCHANGE
    if rng.random() < 0.7:
        keys["gravity"] = [0.0, 0.0, -9.81]
    if rng.random() < 0.3:
        keys["payload"] = {"mass": size(rng, 1.0)}
    folder.mkdir(parents=True)
    sections = {name: random_joint(rng) for name in names}
    of_sensors = np.random.default_rng(zlib.crc32(urdf.encode()))
    if of_sensors.random() < 0.6:
        keys |= random_sensors(of_sensors, sections, f"{names[-1]}_link")
    return write_scene(folder, urdf, sections, **keys)


def numbers(rng: np.random.Generator, count: int, ordinary: float) -> Any:
    """Return numbers as somebody may give them: mostly sound, now and then absurd."""
    values = rng.normal(0.0, ordinary, count)
    kind = rng.random()
    if kind < 0.15:
        at = rng.integers(count)
        values[at] = rng.choice([LARGEST, -LARGEST, 1e200, -1e160, 5e-324, -0.0, 1e18, 2.0**63])
    elif kind < 0.25:
        values[rng.integers(count)] = rng.choice([math.nan, math.inf, -math.inf])
    elif kind < 0.3:
        return rng.normal(size=int(rng.integers(0, 2 * count + 2)))
    elif kind < 0.33:
        return rng.choice(np.array([None, "one", [[]]], dtype=object))
    return values


def steps(rng: np.random.Generator) -> int:
    """Return a number of steps, now and then an absurd one."""
    if rng.random() < 0.1:
        return int(rng.choice(np.array([-1, 2**62, 2**63, 2**64, -(2**63)], dtype=object)))
    return int(rng.choice([0, 1, 2, 10, 300]))


def ask(rng: np.random.Generator, plant: Plant) -> None:
    """Ask anything of a machine."""
    N = len(plant.scene.joints)
    choice = rng.random()
    if choice < 0.55:
        plant.advance(numbers(rng, N, 30.0), steps(rng))
    elif choice < 0.7:
        plant.run([numbers(rng, N, 30.0) for _ in range(int(rng.integers(0, 6)))], steps(rng))
    elif choice < 0.85:
        plant.reset(numbers(rng, N, 1.0), numbers(rng, N, 1.0) if rng.random() < 0.5 else None)
    elif choice < 0.9:
        plant.reset()
    else:
        plant.links.accelerations(*rng.normal(size=(3, int(rng.integers(1, 5)), N)))


def drive(rng: np.random.Generator, scene: Scene) -> dict[str, int]:
    """Ask a machine many things; return how often it answered and refused."""
    plant = Plant(scene)
    count = {TAKEN: 0, REFUSED: 0}
    for _ in range(CALLS):
        before = plant.save()
        try:
            ask(rng, plant)
        except Refusal as refusal:
            count[REFUSED] += 1
            assert plant.save() == before, f"refused, and yet the state changed: {refusal}"
            assert "\n" not in str(refusal), f"more than one line: {refusal}"
        except Diverged:
            count[REFUSED] += 1
        else:
            count[TAKEN] += 1
        state = plant.state
        values = np.concatenate((state.current, state.omega_m, state.q, state.v))
        assert np.isfinite(values).all(), f"a state that is not finite: {state}"
        reported = plant.measured
        for quantity in (
            reported.current,
            reported.torque,
            reported.specific_force,
            reported.angular_rate,
        ):
            assert np.isfinite(quantity).all(), f"a reading that is not finite: {quantity}"
        assert not math.isnan(plant.energy), f"energy {plant.energy} in state {state}"
    return count


def drive_in_real_time(rng: np.random.Generator, scene: Scene) -> None:
    """Let the real-time loop run for a moment, under commands, power cuts, pauses and resets."""
    session = open_real_time_session(scene, "free_run")
    names = scene.joint_names
    try:
        end = time.monotonic() + 0.1
        while time.monotonic() < end:
            session.wait(timeout=0.005)
            while session.take():
                pass
            try:
                session.offer(session.tick, names, rng.normal(0.0, 30.0, len(names)).tolist())
            except Refusal:
                pass
            if rng.random() < 0.2:
                session.powered = bool(rng.integers(2))
            if rng.random() < 0.1:
                session.paused = bool(rng.integers(2))
            if rng.random() < 0.05:
                session.reset()
    finally:
        session.close()


def case(seed: int, number: int, folder: Path, largest: int = 4) -> dict[str, int]:
    """Make and drive machine `number` of a seed; return how often it answered and refused."""
    rng = np.random.default_rng([seed, number])
    path = random_machine(rng, folder, int(rng.integers(1, largest + 1)))
    try:
        scene = load_scene(path)
    except Refusal:
        return {TAKEN: 0, REFUSED: 1}
    count = drive(rng, scene)
    drive_in_real_time(rng, scene)
    return count


def main() -> None:
    """Report of each machine before and after it."""
    seed, first, step = map(int, sys.argv[1:])
    with tempfile.TemporaryDirectory(prefix="fuzz-cores-") as scratch:
        for number in itertools.count(first, step):
            report(begin=number)
            try:
                count = case(seed, number, Path(scratch, str(number)))
            except Exception:  # whatever it is, it is what is looked for
                report(outcome=FAILED, count=1, what=traceback.format_exc(limit=-4))
            else:
                for outcome, much in count.items():
                    report(outcome=outcome, count=much)
                report(done=1)


if __name__ == "__main__":
    main()
