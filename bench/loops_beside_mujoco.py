"""A closed loop of ur5 for a second: ours in lanes, and MuJoCo's with the same servo in C.

    python -m bench.loops_beside_mujoco

The servo samples encoders each millisecond and follows the same swings. Ours has the scene as
shipped. The peer has it bare (bench/bare.py), also without the current loops of the drives, so that
its servo commands voltages. MuJoCo takes the integrator and the largest step with which the links
stay within `TARGET` of its own motion at a fine step, and of these the quickest; ours is compared
with its own motion at a fine step, too. Times are of the processor, of one core, in turns.
"""

from __future__ import annotations

import ctypes
import dataclasses
import time
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np

from arm_emulator import Fleet, Scene, ServoFleet, load_gains, load_scene
from arm_emulator.build.c_header import Header, pointer
from arm_emulator.build.flags import C_FLAGS
from arm_emulator.build.unit import Unit, library
from arm_emulator.servo.c import FOLDER
from arm_emulator.servo.servo_numbers import servo_numbers
from bench.bare import BARE
from bench.fleet_loops import COUNT, NAME, PERIODS, Motion
from bench.motion import Array
from bench.mujoco_peer import INTEGRATORS, MujocoArm, mujoco

TARGET = 1e-5  # rad, the largest error of a link on the way
STEPS = (1, 2, 3, 4, 5, 6, 8, 10, 12, 16, 20, 25, 32, 40)  # in a servo period
FINE = 400  # of the solution
FINE_STEP = 2e-5  # s, of ours
ROUNDS = 5
HERE = Path(__file__).resolve().parent
LOOP = Header(HERE / "mujoco_loop.h", (FOLDER,))


class PeerLoop:
    """The servo on MuJoCo's arm, in C.

    Args:
        scene: the peer's.
        integrator: one of `INTEGRATORS`.
        steps: in a servo period.
    """

    def __init__(self, scene: Scene, integrator: str, steps: int) -> None:
        servo = load_gains(NAME).servo
        self._arm = MujocoArm(scene, integrator, scene.servo_period / steps)
        self._steps, data = steps, self._arm.data
        joints = tuple(dataclasses.replace(one, current_bandwidth=0.0) for one in servo.joints)
        self._numbers = servo_numbers(joints, servo.period, servo.supply_voltage)
        self._states = LOOP.rows("servo_state", len(joints))
        source = '#include "servo.c"\n' + (HERE / "mujoco_loop.c").read_text(encoding="utf-8")
        about = "a loop for MuJoCo"
        unit = Unit("mujoco_loop", source, C_FLAGS, (FOLDER, HERE), (LOOP,), "bench", about, "")
        self._calls = library(unit)
        (shared,) = Path(mujoco().__file__).parent.glob("libmujoco.so*")
        step: Any = ctypes.cast(ctypes.CDLL(str(shared)).mj_step, ctypes.c_void_p).value
        self._struct = LOOP.new(
            "mujoco_arm",
            joints=len(joints),
            step=LOOP.ffi.cast("void(*)(void*, void*)", step),
            model=LOOP.ffi.cast("void*", self._arm.model._address),  # noqa: SLF001
            data=LOOP.ffi.cast("void*", data._address),  # noqa: SLF001
            angle=pointer(data.qpos[: len(joints)]),
            current=pointer(data.act),
            q=pointer(data.qpos[len(joints) :]),
            command=pointer(data.ctrl),
        )
        t = scene.servo_period * np.arange(PERIODS)[:, np.newaxis, np.newaxis]
        self._targets = [np.ascontiguousarray(rows[:, 0]) for rows in Motion(scene.start).at(t)]

    def run(self) -> tuple[Array, float]:
        """Follow the first arm's targets; return angles on the way, and processor time [s]."""
        self._arm.reset()
        self._states[:] = np.zeros_like(self._states)
        way, began = np.empty_like(self._targets[0]), time.process_time()
        self._calls.run_mujoco(
            self._struct, LOOP.pointer("servo_joint", self._numbers),
            LOOP.pointer("servo_state", self._states), *map(pointer, self._targets), PERIODS,
            self._steps, pointer(way),
        )  # fmt: skip
        return way, time.process_time() - began


class OwnLoop:
    """The servo on ours, in lanes on one core.

    Args:
        scene: as shipped, or with another step.
        count: of arms.
    """

    def __init__(self, scene: Scene, count: int) -> None:
        self._fleet = Fleet(scene, count, workers=1)
        self._servos = ServoFleet(self._fleet, load_gains(NAME).servo)
        t = scene.servo_period * np.arange(PERIODS)[:, np.newaxis, np.newaxis]
        q, v = Motion(scene.start).at(t)
        self._servos.aim(q[:, :count].copy(), v[:, :count].copy(), every=1)
        self._worth = count * PERIODS * scene.servo_period

    def run(self, links: Array | None = None) -> float:
        """Follow targets; return processor time of an arm's second [s]."""
        self._fleet.reset()
        self._servos.reset()
        began = time.process_time()
        self._fleet.follow(self._servos, PERIODS, links=links)
        return (time.process_time() - began) / self._worth

    def way(self) -> Array:
        """Return the links' angles on the way (K, count, N) [rad]."""
        links = np.empty((PERIODS, len(self._fleet), len(self._fleet.scene.joints)))
        self.run(links)
        return links


def report() -> str:
    """Measure, and return lines of Markdown."""
    scene, lanes = load_scene(NAME, BARE), 8
    solution = PeerLoop(scene, "RK4", FINE).run()[0]
    rows, chosen = [], list[tuple[float, PeerLoop, str]]()
    for integrator in INTEGRATORS:
        for steps in STEPS:
            loop = PeerLoop(scene, integrator, steps)
            way, spent = loop.run()
            off = float(np.abs(way - solution).max())
            print(
                f"MuJoCo, {integrator}, {steps} steps a period: {off:.1e} rad, {spent:.3f} s",
                flush=True,
            )
            if off <= TARGET:
                chosen.append((spent, loop, f"{integrator}, {steps} steps a period, {off:.1e} rad"))
                break
    fine = load_scene(NAME, {"integrator.dt": FINE_STEP})
    shipped = load_scene(NAME)
    ways = [OwnLoop(one, lanes).way() for one in (shipped, fine)]
    off = float(np.abs(ways[0] - ways[1]).max())
    _, peer, words = min(chosen, key=lambda one: one[0])
    ours, theirs = OwnLoop(shipped, COUNT), []
    own = []
    for _ in range(ROUNDS):
        own.append(ours.run())
        theirs.append(peer.run()[1])
    ratio = median(b / a for a, b in zip(own, theirs, strict=True))
    rows = [
        f"| a second of {NAME} in its loop | CPU | error |",
        "|---|---|---|",
        f"| ours as shipped, {COUNT} arms in lanes | {1e6 * median(own):.0f} us | {off:.1e} rad |",
        f"| MuJoCo: {words.rpartition(',')[0]} | {1e3 * median(theirs):.1f} ms |"
        f"{words.rpartition(',')[2]} |",
        f"| ratio | {ratio:.0f} | |",
    ]
    return "\n".join(rows)


if __name__ == "__main__":
    print(report())
