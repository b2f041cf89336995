"""From a scene to its compiled machine: one shared library per scene, cached by content."""

from __future__ import annotations

import contextlib
import ctypes
import hashlib
import os
import platform
import shlex
import shutil
import subprocess
import sys
import tempfile
import time
from functools import cache
from pathlib import Path

from arm_emulator.refusal import Refusal
from emulator_node.chain import Body, ChainJoint
from emulator_node.library_cache import cache_folders, locked, writable_cache
from emulator_node.scene import Gear, Joint, Scene

CORE = Path(__file__).resolve().parent / "core"

# The stepping code never asks for errno, traps or the sign of zero, and may reassociate.
# Finiteness is checked on bit patterns (core/machine.hpp).
FLAGS = (
    "-std=c++20 -O3 -shared -fPIC -fvisibility=hidden -fno-math-errno -fno-trapping-math "
    "-pthread -fno-signed-zeros -fassociative-math -ffinite-math-only -freciprocal-math"
).split()

# Targets that `arm_emulator compile` can build for, best first; "native" is this machine's.
PORTABLE_TARGETS = ("x86-64-v4", "x86-64-v3", "x86-64-v2", "x86-64")


def library_of(scene: Scene) -> ctypes.CDLL:
    """Return the scene's compiled core, compiling it if no cached library fits.

    Raises:
        Refusal: there is neither a cached library nor a working compiler.
    """
    unit = scene_unit(scene)
    for folder in cache_folders():
        for target in ("native", *PORTABLE_TARGETS):
            file = folder / _library_name(scene, unit, target)
            if file.is_file() and (target == "native" or _runs_here(target)):
                return ctypes.CDLL(str(file))
    return ctypes.CDLL(str(compile_scene(scene, "native", writable_cache())))


def compile_scene(scene: Scene, target: str, folder: Path) -> Path:
    """Compile a scene's core for `target` into `folder` and return the library's path.

    Several processes may do this at once: one compiles, the others wait for it.

    Raises:
        Refusal: no compiler, or it fails.
    """
    unit = scene_unit(scene)
    library = folder / _library_name(scene, unit, target)
    with locked(library.with_suffix(".lock")):
        if library.is_file():
            return library
        compiler = find_compiler()
        print(f"compiling scene {scene.name} ({len(scene.joints)} joints) ... ",
              end="", file=sys.stderr, flush=True)  # fmt: skip
        started = time.perf_counter()
        with tempfile.TemporaryDirectory(dir=folder) as scratch:
            source, built = Path(scratch) / "scene.cpp", Path(scratch) / library.name
            source.write_text(unit, encoding="utf-8")
            command = [*compiler, *FLAGS, f"-march={target}", f"-I{CORE}", str(source)]
            done = subprocess.run(
                [*command, "-o", str(built)], capture_output=True, text=True, check=False
            )
            if done.returncode != 0:
                print("failed", file=sys.stderr)
                raise Refusal(
                    scene.where, f"compiler {compiler[0]}", "compile the scene's core", done.stderr
                )
            os.replace(built, library)
        print(f"{time.perf_counter() - started:.1f} s", file=sys.stderr)
    return library


def compile_ahead(scene: Scene, target: str, folder: Path | None) -> Path:
    """Compile for `target` into `folder` (None: the cache), for machines without a compiler.

    Raises:
        Refusal: an unknown target, no compiler, or it fails.
    """
    targets = ("native", *PORTABLE_TARGETS)
    if target not in targets:
        raise Refusal("compile", "target", "be known", target, ", ".join(targets))
    if folder is None:
        folder = writable_cache()
    folder.mkdir(parents=True, exist_ok=True)
    return compile_scene(scene, target, folder)


def find_compiler() -> list[str]:
    """Return the C++ compiler's command: $CXX, or the first of c++, g++, clang++ on the path.

    Raises:
        Refusal: there is none.
    """
    named = shlex.split(os.environ.get("CXX", ""))
    for words in [named] if named else [["c++"], ["g++"], ["clang++"]]:
        if shutil.which(words[0]):
            return words
    raise Refusal(
        "arm_emulator",
        "C++ compiler",
        "be on the path, a scene is compiled when first used",
        named[0] if named else "none of c++, g++, clang++",
        "install one, set CXX, or compile ahead with `arm_emulator compile SCENE` elsewhere",
    )


# The scene as C++


def scene_unit(scene: Scene) -> str:
    """Return the C++ unit of a scene: its constants, then the core's C interface.

    The step size is no constant, so that scenes that differ in it alone share a library.
    """
    R_BW = scene.chain.R_BW
    gravity = R_BW @ scene.gravity if scene.gravity is not None else (0.0, 0.0, 0.0)
    joints = ",\n".join(
        _joint(geometry, joint)
        for geometry, joint in zip(scene.chain.joints, scene.joints, strict=True)
    )
    return f"""\
#include "scene.hpp"

struct Scene {{
  static constexpr int N = {len(scene.joints)};
  static constexpr arm::Scheme scheme = arm::Scheme::{scene.integrator.scheme};
  static constexpr int threads = {scene.threads};
  static constexpr arm::Exchange exchange = arm::Exchange::{scene.integrator.exchange};
  static constexpr double supply_voltage = {_number(scene.supply_voltage)};
  static constexpr arm::Vec3 gravity = {_list(gravity)};
  static constexpr arm::Joint joint[N] = {{
{joints}
  }};
}};

#include "abi.hpp"
"""


def _joint(geometry: ChainJoint, joint: Joint) -> str:
    motor = joint.motor
    motor_values = (
        "{}"
        if motor is None
        else "{true, "
        + ", ".join(
            map(
                _number,
                (
                    motor.resistance,
                    motor.inductance,
                    motor.torque_constant,
                    motor.back_emf_constant,
                    motor.rotor_inertia,
                    motor.current_limit or 0.0,
                ),
            )
        )
        + "}"
    )
    friction = (joint.friction.viscous, joint.friction.coulomb, joint.friction.breakaway)
    turn = (geometry.cos_alpha, geometry.sin_alpha, geometry.theta_0)
    return f"""\
    {{arm::JointKind::{geometry.kind}, {", ".join(map(_number, turn))}, {_list(geometry.p)},
     {_body(geometry.body)},
     {motor_values}, {_gear(joint.gear)}, {", ".join(map(_number, friction))}}}"""


def _body(body: Body) -> str:
    I = body.inertia  # noqa: E741
    tensor = (I[0, 0], I[1, 1], I[2, 2], I[0, 1], I[0, 2], I[1, 2])
    return f"{{{_number(body.mass)}, {_list(body.moment)}, {_list(tensor)}}}"


def _gear(gear: Gear) -> str:
    rigid = "true" if gear.stiffness is None else "false"
    values = (gear.ratio, gear.stiffness or 0.0, gear.damping)
    return f"{{{rigid}, {', '.join(map(_number, values))}}}"


def _list(values: object) -> str:
    return f"{{{', '.join(map(_number, values))}}}"  # type: ignore[call-overload]


def _number(value: float) -> str:
    return repr(float(value) + 0.0)


# What a library is called


def _library_name(scene: Scene, unit: str, target: str) -> str:
    digest = hashlib.sha256(_core_digest())
    for part in (unit, " ".join(FLAGS), target, _processor() if target == "native" else ""):
        digest.update(part.encode())
        digest.update(b"\0")
    name = "".join(c if c.isalnum() or c in "-_" else "_" for c in scene.name)
    return f"{name}-{digest.hexdigest()[:20]}.so"


@cache
def _core_digest() -> bytes:
    digest = hashlib.sha256()
    for header in sorted(CORE.glob("*.hpp")):
        digest.update(header.name.encode())
        digest.update(header.read_bytes())
    return digest.digest()


@cache
def _processor() -> str:
    """Return what decides whether code compiled for one machine runs on another."""
    with contextlib.suppress(OSError):
        for line in Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines():
            if line.startswith(("flags", "Features")):
                return f"{platform.machine()} {line}"
    return f"{platform.machine()} {platform.processor()}"


def _runs_here(target: str) -> bool:
    """Whether this processor has what the x86-64 level `target` names."""
    needed = {
        "x86-64": {"sse2"},
        "x86-64-v2": {"sse4_2", "popcnt", "ssse3"},
        "x86-64-v3": {"avx2", "fma", "bmi2"},
        "x86-64-v4": {"avx512f", "avx512dq", "avx512vl", "avx512bw"},
    }[target]
    return platform.machine() in ("x86_64", "AMD64") and needed <= set(_processor().split())
