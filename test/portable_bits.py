"""Digests of what machines, fleets and servos compute, the same for every compiler and processor.

`FULL=1 python test/portable_bits.py` writes test/portable_bits.json anew, which is due with each
change of the physics, and of nothing else. Mixtures of parts and a machine with faults are those
of test/portable_scenes.json, so that a new part changes no digest. With a target and a level, such
as `native -O1`, the digests of code that $CXX compiles so are printed: with FULL=1 all, else the
first ones.
"""

import hashlib
import json
import os
import sys
import tempfile
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from draws import FULL, some
from machines import SENSED
from own_firmware import code

import arm_emulator.machine.plant.compiler as of_machines
from arm_emulator import Diverged, ExternalWrench, Plant, Scene, load_scene
from arm_emulator.core import BOUNDARY
from arm_emulator.machine.plant.outputs import KNOWN, list_outputs
from arm_emulator.machine.schemes.known import LOCATING_SCHEMES, SCHEMES
from arm_emulator.runs.table_run import load_table_run
from arm_emulator.toolchain.compile_unit import compile_units
from arm_emulator.toolchain.flags import C_FLAGS
from arm_emulator.toolchain.unit import Unit
from arm_emulator_fleet import Fleet
from arm_emulator_fleet.unit import build_fleet_unit

STORED = Path(__file__).with_suffix(".json")
SCENES = json.loads(Path(__file__).with_name("portable_scenes.json").read_text())
# Outputs whose zeros are in a digest where a scene has no such part; others came later.
OUTPUTS = {
    "encoder_counts", "current", "current_d", "applied_d", "applied_b", "applied", "faults",
    "brake_closed", "index_counts", "index_pulses", "link_encoder_counts", "link_index_counts",
    "link_index_pulses", "torque", "motor_speed", "link_position", "link_speed",
    "motor_temperature", "specific_force", "angular_rate",
}  # fmt: skip
ROWS, STEPS, ARMS = 100, 100, 3  # rows of commands, steps under each, arms of a fleet
UNPOWERED, CHANGED, REWOUND = range(20, 30), 40, 60  # rows
TICKS = 1000  # of servos

# Somebody's: voltages by what the encoders lack, held back by the currents.
OWN_SERVO = code(
    """
  for (int j = 0; in->q_target && j < 3; ++j) {
    const double lacks = in->q_target[j] - 1e-5 * (double)in->measured->joint[j].encoder;
    out->joint[j].value = 5.0 * lacks - 0.3 * in->measured->joint[j].current;
  }"""
)

BEARINGS = {
    f"joints.{place}": {"stiffness": stiffness, "damping": damping}
    for place, stiffness, damping in (
        ("waist.bearing.tilt_x", 2e4, 20.0),
        ("shoulder.bearing.tilt_z", 3e4, 30.0),
        ("elbow.bearing.shift_y", 1e6, 500.0),
    )
}

Drawing = Callable[[dict[str, Any]], Scene]


def drawings(folder: Path) -> dict[str, Drawing]:
    """Return scenes by name, the short run's first: shipped ones, and mixtures of all parts."""

    def stored(name: str, overrides: dict[str, Any]) -> Scene:
        place = folder / name
        place.mkdir(exist_ok=True)
        (place / "robot.urdf").write_text(SCENES[name]["urdf"])
        (place / "scene.yaml").write_text(yaml.safe_dump(SCENES[name]["scene"]))
        return load_scene(place / "scene.yaml", overrides)

    def sensed(overrides: dict[str, Any]) -> Scene:
        return load_scene("three_axis", SENSED | overrides)

    shipped = {name: partial(load_scene, name) for name in ("ur5", "panda", "manutec_r3")}
    return {
        "sensed": sensed,
        "ur5": shipped["ur5"],
        "mixture 0": partial(stored, "mixture 0"),
        **shipped,
        "kuka_kr300": partial(load_scene, "kuka_kr300"),
        **{name: partial(stored, name) for name in SCENES if name != "mixture 0"},
    }


def cases(folder: Path, count: int) -> Iterator[tuple[str, Scene]]:
    """Yield the first scenes with their names, with FULL=1 all in all schemes that they admit."""
    for name, draw_case in some(drawings(folder).items(), count):
        yield name, draw_case({})
        for scheme in SCHEMES if FULL else ():
            for events in ("step", "located") if scheme in LOCATING_SCHEMES else ("step",):
                integrator = {"integrator.scheme": scheme, "integrator.events": events}
                yield f"{name}, {scheme}, {events}", draw_case(integrator)
    if FULL:
        yield "three_axis in bearings", load_scene("three_axis", BEARINGS)


class Digest:
    """A digest of numbers in which the sign of zero is of no importance."""

    def __init__(self) -> None:
        self._digest = hashlib.sha256()

    def put(self, *rows: Any) -> None:
        """Add numbers."""
        for row in rows:
            self._digest.update((np.asarray(row) + 0).tobytes())

    def put_text(self, text: str) -> None:
        """Add words."""
        self._digest.update(text.encode())

    def __str__(self) -> str:
        return self._digest.hexdigest()[:16]


def commands_of(scene: Scene) -> np.ndarray:
    """Return random commands (ROWS, ARMS, N)."""
    return np.random.default_rng(7).uniform(-3.0, 3.0, (ROWS, ARMS, len(scene.joints)))


def disturb(arms: Plant | Fleet, row: int) -> None:
    """Let faults act, switch the power, change a number, push: each in its row, for every arm."""
    scene = arms.scene
    if row in (UNPOWERED.start, UNPOWERED.stop):
        arms.powered = row == UNPOWERED.stop
    for k, fault in enumerate(scene.faults):
        if k % ROWS in (row, row - 1):  # a few in each row, until the next
            now = float(fault.varied.number.default or 0.0) if k % ROWS == row else 0.0
            arms.set_parameter(fault.varied.name, now)
    if row == CHANGED and scene.varied and not scene.faults:
        arms.set_parameter(scene.varied[0].name, 1.1 * scene.varied[0].value)
    if row == CHANGED and scene.external_wrench:
        push = ExternalWrench((1.0, -2.0, 3.0), (0.1, 0.2, -0.3), axes="world")
        arms.set_external_wrench(scene.chain.joints[-1].link, push)


def names_of(scene: Scene) -> list[str]:
    """Return the outputs in a digest: those of `OUTPUTS`, and others that the scene has."""
    there = {output.name for output in list_outputs(scene)}
    return [name for name in KNOWN if name in there or name in OUTPUTS]


def digest_of_machine(scene: Scene, arm: int = 0) -> str:
    """Return a digest along a run of one arm that is wound back on its way."""
    plant, digest = Plant(scene), Digest()
    commands, saved, row, has_returned = commands_of(scene)[:, arm], b"", 0, False
    while row < ROWS:
        disturb(plant, row)
        if row == CHANGED + 1:
            saved = plant.save()
        try:
            plant.advance(commands[row], STEPS)
        except Diverged as reason:
            digest.put_text(str(reason))
            return str(digest)
        digest.put(plant.state.q, plant.state.v)
        row += 1
        if row == REWOUND and not has_returned:
            plant.restore(saved)
            row, has_returned = CHANGED + 1, True
    digest.put(plant.energy, *(getattr(plant.measured, name) for name in names_of(scene)))
    return str(digest)


def digests_of_fleet(scene: Scene) -> list[str]:
    """Return those of `digest_of_machine` of every arm of a fleet."""
    fleet, arm_digests = Fleet(scene, ARMS), [Digest() for _ in range(ARMS)]
    commands, saved, row, has_returned = commands_of(scene), b"", 0, False
    stopped: set[int] = set()
    while row < ROWS:
        disturb(fleet, row)
        if row == CHANGED + 1:
            saved = fleet.save()
        fleet.advance(commands[row], STEPS)
        for arm, reason in fleet.diverged.items():
            if arm not in stopped:
                arm_digests[arm].put_text(str(reason))
        stopped |= set(fleet.diverged)
        for arm in set(range(ARMS)) - stopped:
            arm_digests[arm].put(fleet.state.q[arm], fleet.state.v[arm])
        row += 1
        if row == REWOUND and not has_returned:
            fleet.restore(saved)
            row, has_returned = CHANGED + 1, True
    measured = fleet.measured
    for arm in set(range(ARMS)) - stopped:
        digest = arm_digests[arm]
        rows = (getattr(measured, name)[arm] for name in names_of(scene))
        digest.put(fleet[arm].energy, *rows)
    return [str(digest) for digest in arm_digests]


def digest_of_servo(name: str, folder: Path, own: str = "") -> str:
    """Return a digest of what a servo measures whose targets step to and fro.

    Args:
        name: the scene.
        folder: for its files.
        own: source of a servo; empty: ours.
    """
    scene, table = load_scene(name), folder / f"{name}.csv"
    lines = [",".join(["t", *scene.joint_names])]
    for t, swing in ((0.0, 0.0), (0.05, 0.1), (0.3, -0.1)):
        lines.append(",".join(map(repr, [t, *(scene.start + swing).tolist()])))
    table.write_text("\n".join(lines))
    library = None
    if own:
        about = "own", own, C_FLAGS, (BOUNDARY,), (), "own", "a servo", "own"
        (library,) = compile_units([Unit(*about, more=("arm_firmware",))], "native", None)
    run, _ = load_table_run(name, table, library)
    digest = Digest()
    for _ in range(20):
        run.advance(TICKS // 20)
        digest.put(run.session.measured.encoder_counts, run.session.measured.current)
    return str(digest)


def digests(target: str, level: str, count: int = 3) -> Iterator[tuple[str, str]]:
    """Yield all digests by name, of code that is compiled for a target at a level such as -O1.

    Args:
        target: "native" or a portable one.
        level: of optimisation.
        count: of scenes, 1 without a fleet; with FULL=1 there are all.

    Raises:
        AssertionError: an arm of a fleet has other bits than a single arm.
    """
    of_machines.FLAGS = tuple(level if flag == "-O3" else flag for flag in of_machines.FLAGS)
    with tempfile.TemporaryDirectory() as folder:
        for name, scene in cases(Path(folder), count):
            # Fleets of long arms compile for long: only as their scenes state them.
            is_quick = len(scene.joints) <= 3 or "," not in name
            has_fleet = is_quick if FULL else count > 1 and name in ("sensed", "ur5")
            units = [of_machines.build_machine_unit(scene)]
            units += [build_fleet_unit(scene)] if has_fleet else []
            if target != "native":
                compile_units(units, target, None)
            own = digest_of_machine(scene)
            if has_fleet:
                alone = [own, *(digest_of_machine(scene, arm) for arm in range(1, ARMS))]
                assert digests_of_fleet(scene) == alone, f"lanes of {name}"
            yield name, own
        for name in some(("three_axis", "ur5", "panda"), 1):
            yield f"{name}, servo", digest_of_servo(name, Path(folder))
        yield "three_axis, own servo", digest_of_servo("three_axis", Path(folder), OWN_SERVO)


if __name__ == "__main__":
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    if len(sys.argv) > 1:
        print(json.dumps(dict(digests(*sys.argv[1:])), indent=1))
    elif not FULL:
        sys.exit("with FULL=1, which every digest takes")
    else:
        STORED.write_text(json.dumps(dict(digests("native", "-O3")), indent=1) + "\n")
