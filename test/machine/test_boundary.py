"""The C boundary: pieces of a motion, saved machines, states that are set, a client in C."""

import ctypes
import dataclasses
import math
import os
import re
import shutil
import struct
import subprocess
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from draws import some, with_slow
from fuzz.cores import random_machine

from arm_emulator import Diverged, Plant, PlantState, Refusal, Scene, load_scene
from arm_emulator.core import BOUNDARY
from arm_emulator.machine.plant.compiler import compile_ahead
from arm_emulator.toolchain import library_cache

MACHINES = some([0, 1, 3, 4, 2, 5, 6, 7], 2)  # their seeds
Piece = tuple[np.ndarray, int]  # voltages, and for how many steps


@pytest.fixture(scope="module", params=with_slow(MACHINES, 1))
def sample_machine(
    request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory
) -> tuple[Scene, np.random.Generator]:
    """A random machine: any scheme, one or two threads, limits, friction, any gear."""
    rng = np.random.default_rng([request.param, 4])
    while True:  # some draws are no scene
        folder = tmp_path_factory.mktemp("drawn") / "machine"
        try:
            return load_scene(str(random_machine(rng, folder, int(rng.integers(1, 5))))), rng
        except Refusal:
            pass


def random_motion(rng: np.random.Generator, joints: int) -> list[Piece]:
    return [(rng.normal(0.0, 15.0, joints), int(rng.integers(1, 100))) for _ in range(6)]


def move(plant: Plant, motion: list[Piece], advance: Callable[[Plant, Piece], None]) -> str:
    """Go through a motion; return how it ended."""
    try:
        for piece in motion:
            advance(plant, piece)
    except Diverged as fault:
        return f"{fault.joint} {fault.t!r}"
    return "whole"


def at_once(plant: Plant, piece: Piece) -> None:
    plant.advance(*piece)


def test_a_motion_has_the_same_bits_in_any_pieces(
    sample_machine: tuple[Scene, np.random.Generator],
) -> None:
    scene, rng = sample_machine
    motion = random_motion(rng, len(scene.joints))
    reference = Plant(scene)
    reported = move(reference, motion, at_once)
    for _ in range(4):
        cut = float(rng.choice([1.0, 0.5, 0.1, 0.02]))

        def in_pieces(plant: Plant, piece: Piece, cut: float = cut) -> None:
            voltage, steps = piece
            while steps:
                some = min(steps, int(rng.geometric(cut)))
                if rng.random() < 0.5:
                    plant.advance(voltage, some)
                else:
                    plant.run([voltage], some)
                steps -= some

        second = Plant(scene)
        assert move(second, motion, in_pieces) == reported, "how it ended"
        assert second.save() == reference.save(), (
            f"all that the machine is, in pieces of about {1 / cut}"
        )


def test_a_restored_machine_goes_on_to_the_last_bit(
    sample_machine: tuple[Scene, np.random.Generator],
) -> None:
    scene, rng = sample_machine
    before, after = (random_motion(rng, len(scene.joints)) for _ in range(2))
    first, second = Plant(scene), Plant(scene)
    move(first, before, at_once)
    saved = first.save()
    move(second, after, at_once)  # another past
    second.restore(saved)
    assert second.save() == saved, "a restored machine is the saved one"
    for plant in (first, second):
        plant.powered = False
        plant.powered = True
    assert move(first, after, at_once) == move(second, after, at_once), "how it ended"
    assert first.save() == second.save(), "all that the machine is"


def test_saved_machines_of_others_are_refused(
    sample_machine: tuple[Scene, np.random.Generator],
) -> None:
    scene, _ = sample_machine
    plant = Plant(scene)
    saved = plant.save()
    integrator = dataclasses.replace(scene.integrator, dt=scene.integrator.dt / 2)
    second = Plant(dataclasses.replace(scene, integrator=integrator))
    for foreign, words in (
        (second.save(), "step"),
        (saved[:-1], "size"),
        (b"", "size"),
        (bytes([saved[0] ^ 1]) + saved[1:], "library"),
    ):
        with pytest.raises(Refusal, match=words):
            plant.restore(foreign)
        assert plant.save() == saved, "a refused state has changed something"


def test_a_state_that_is_set_is_the_state(
    sample_machine: tuple[Scene, np.random.Generator],
) -> None:
    """Motors and links anywhere, where the drive leaves them free."""
    scene, rng = sample_machine
    plant = Plant(scene)
    N = len(scene.joints)
    q, v = rng.normal(0, 1, N), rng.normal(0, 0.5, N)
    ratio = scene.gear_ratios
    elastic = np.array([j.motor is not None and j.gear.stiffness is not None for j in scene.joints])
    driven = np.array([j.motor is not None for j in scene.joints])
    limit = np.array([getattr(j.motor, "current_limit", None) or math.inf for j in scene.joints])
    state = PlantState(
        t=0.0,
        current=np.where(driven, rng.uniform(-1, 1, N) * np.minimum(limit, 5.0), 0.0),
        theta_m=(q + np.where(elastic, rng.normal(0, 1e-3, N), 0.0)) / ratio,
        omega_m=(v + np.where(elastic, rng.normal(0, 1e-2, N), 0.0)) / ratio,
        q=q,
        v=v,
        gear_torque=np.zeros(N),
    )
    move(plant, random_motion(rng, N), at_once)  # whatever its past
    t = plant.t
    plant.state = state
    now = plant.state
    for name in ("current", "theta_m", "omega_m", "q", "v"):
        # A motor behind a rigid gear is where its link is, to the rounding of one division.
        np.testing.assert_allclose(
            getattr(now, name), getattr(state, name), rtol=1e-14, err_msg=name
        )
    assert now.t == t, "time goes on"
    counts_per_rad = np.array([joint.counts_per_turn for joint in scene.joints]) / (2 * math.pi)
    plain = [joint.encoder is None or joint.encoder.is_ideal for joint in scene.joints]
    counts = np.floor(now.theta_m * counts_per_rad)
    np.testing.assert_array_equal(plant.measured.encoder_counts[plain], counts[plain])

    saved, first_joint = plant.save(), np.eye(N)[0]
    wrong = [
        {"q": np.full(N, math.nan)},
        {"v": np.zeros(N + 1)},
        {"q": np.full(N, 1e300)},
    ]
    if not elastic[0]:
        wrong += [
            {"theta_m": state.theta_m + first_joint},
            {"omega_m": state.omega_m + first_joint},
        ]
    if not driven[0] or math.isfinite(limit[0]):
        wrong += [{"current": state.current + first_joint * 10.0 * min(limit[0], 1e3)}]
    for change in wrong:
        with pytest.raises(Refusal):
            plant.state = dataclasses.replace(state, **change)
        assert plant.save() == saved, "a refused state has changed something"


def test_a_library_for_others_describes_its_periods(tmp_path: Path) -> None:
    """Scenes that differ in them alone share the library in the cache, and its fingerprint."""
    fingerprints = set()
    for dt in (1e-4, 2.5e-4):
        scene = load_scene("three_axis", overrides={"integrator.dt": dt})
        copy, *_ = compile_ahead(scene, "native", tmp_path / str(dt))
        cached, *_ = compile_ahead(scene, "native", None)
        for file, periods in ((copy, (1e-3, dt, round(1e-3 / dt))), (cached, (0.0, 0.0, 0))):
            library_cache.read_library(file)
            described = ctypes.create_string_buffer(bytes([64]), 64)
            assert ctypes.CDLL(str(file)).arm_describe(described) == 0
            size, version, joints, _, fingerprint, *_ = struct.unpack_from("<IIiiQd", described)
            assert (size, version, joints) == (64, 7, 3)
            assert struct.unpack_from("<ddq", described, 40) == periods, file
            fingerprints.add(fingerprint)
    assert len(fingerprints) == 1, "saved machines go from one to the other"
    version_2 = ctypes.create_string_buffer(b"\x28\0\0\0" + 60 * b"\x5a")
    assert ctypes.CDLL(str(copy)).arm_describe(version_2) == 0
    assert version_2.raw[40:63] == 23 * b"\x5a", "no more is written than a client has room for"


def test_a_client_in_c_gets_the_bits_of_python(tmp_path: Path) -> None:
    compiler = shutil.which(os.environ.get("CC", "cc"))
    if compiler is None:
        pytest.skip("no C compiler")
    client, ticks = tmp_path / "client", 50
    source = Path(__file__).with_name("boundary_client.c")
    words = [
        "-std=c99",
        "-D_POSIX_C_SOURCE=200809L",
        "-Wall",
        "-Wextra",
        "-Werror",
        f"-I{BOUNDARY}",
    ]
    subprocess.run([compiler, *words, str(source), "-o", str(client), "-ldl"], check=True)
    scene = load_scene("three_axis", overrides={"integrator.dt": 1e-4})
    library = compile_ahead(scene, "native", None)[0]
    reported = subprocess.run(
        [str(client), str(library), str(ticks)], capture_output=True, text=True, check=True
    ).stdout.splitlines()
    plant = Plant(scene)
    plant.reset(np.zeros(3))
    for k in range(ticks):
        plant.exchange(np.array([1.0, 2.0, 3.0]) * (k % 7 - 3), k)
    for line, joint in zip(reported, scene.joints, strict=False):
        assert line == f"{joint.name} {joint.counts_per_turn / (2 * math.pi):.17g}"
    pairs = zip(plant.measured.encoder_counts, plant.measured.current, strict=True)
    expected = f"{ticks} " + " ".join(f"{counts} {current:.17g}" for counts, current in pairs)
    first, again = reported[3:]
    assert first == expected, "tick, counts, currents"
    # From half the way on, the same voltages from their beginning: another motion, further on.
    assert re.match(rf"{ticks // 2 + 1 + ticks} ", again), again
