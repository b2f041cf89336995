"""Digests of what machines, fleets and servos compute, the same for every compiler and processor.

`python test/portable_bits.py` prints them as test/portable_bits.json keeps them: they change with
each change of the physics, and of nothing else.
"""

from __future__ import annotations

import hashlib
import json
import os
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
from draws import FULL, some

import arm_emulator.machine.compiler as of_machines
from arm_emulator import Diverged, Fleet, Plant, Scene, load_scene
from arm_emulator.build.unit import compile_units
from arm_emulator.machine.schemes.known import LOCATING_SCHEMES, SCHEMES
from arm_emulator.runs.offline import load_offline_run
from oracles.mixtures import write_mixture

KEPT = Path(__file__).with_suffix(".json")
SHIPPED = ("three_axis", "ur5", "panda", "manutec_r3", "kuka_kr300")
STEPS, ARMS = 1000, 3


def cases(folder: Path) -> dict[str, Scene]:
    """Return scenes by name: shipped ones, every scheme, random mixtures of all parts."""
    found = {name: load_scene(name) for name in some(SHIPPED, 3)}
    for scheme in SCHEMES if FULL else ():
        events = "located" if scheme in LOCATING_SCHEMES else "step"
        integrator = {"integrator.scheme": scheme, "integrator.events": events}
        for name in SHIPPED:
            found[f"{name} {scheme}"] = load_scene(name, overrides=integrator)
    for seed in some(range(8), 1):
        (folder / str(seed)).mkdir()
        found[f"mixture {seed}"] = load_scene(write_mixture(folder / str(seed), seed))
    return found


def measured_bytes(measured: Any) -> bytes:
    """Return counts and currents; the sign of zero is of no importance."""
    counts, currents = np.asarray(measured.encoder_counts), np.asarray(measured.current)
    return counts.tobytes() + (currents + 0.0).tobytes()


def digest_of_machine(scene: Scene, fleet: bool) -> str:
    """Return a digest of states and measurements along a run under random commands."""
    rng = np.random.default_rng(7)
    digest = hashlib.sha256()
    arms = Fleet(scene, ARMS) if fleet else Plant(scene)
    for _ in range(25):
        commands = rng.uniform(-3.0, 3.0, (ARMS, len(scene.joints)))
        try:
            arms.advance(commands if fleet else commands[0], STEPS // 25)
        except Diverged as reason:
            digest.update(str(reason).encode())
            break
        for rows in (arms.state.q, arms.state.v):
            digest.update((np.asarray(rows) + 0.0).tobytes())
    if isinstance(arms, Plant):
        digest.update(measured_bytes(arms.measured))
    return digest.hexdigest()[:16]


def digest_of_loop(name: str) -> str:
    """Return a digest of what a servo measures that holds the arm and follows its start."""
    run, digest = load_offline_run(name), hashlib.sha256()
    for _ in range(20):
        run.advance(25)
        digest.update(measured_bytes(run.session.measured))
    return digest.hexdigest()[:16]


def digests(target: str, level: str) -> dict[str, str]:
    """Return all digests, of code that is compiled for a target at a level such as -O1."""
    of_machines.FLAGS = tuple(level if one == "-O3" else one for one in of_machines.FLAGS)
    found = {}
    with tempfile.TemporaryDirectory() as folder:
        for name, scene in cases(Path(folder)).items():
            units = [of_machines.machine_unit(scene)]
            has_fleet = FULL or name in ("three_axis", "ur5")
            units += [of_machines.fleet_unit(scene)] if has_fleet else []
            if target != "native":
                compile_units(units, target, None)
            found[name] = digest_of_machine(scene, fleet=False)
            if has_fleet:
                found[f"{name}, fleet"] = digest_of_machine(scene, fleet=True)
    for name in some(("three_axis", "ur5", "panda"), 1):
        found[f"{name}, servo"] = digest_of_loop(name)
    return found


if __name__ == "__main__":
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    given = [*sys.argv[1:], "native", "-O3"][:2]
    print(json.dumps(digests(*given), indent=1))
