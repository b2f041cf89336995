"""From scenes to shared libraries, cached by content: machines, equations, real time."""

from __future__ import annotations

import struct
from dataclasses import replace
from pathlib import Path

from arm_emulator.core import CORE
from arm_emulator.machine.plant.core_calls import ARM, EQUATIONS, SENSITIVITY
from arm_emulator.machine.plant.scene_unit import scene_unit
from arm_emulator.machine.scene.scene import Scene
from arm_emulator.tick.c import FOLDERS, REAL_TIME
from arm_emulator.toolchain.c_header import Header, Library
from arm_emulator.toolchain.flags import CPP_FLAGS
from arm_emulator.toolchain.unit import Unit, compile_units, library

# Directions of derivatives that one run follows. With 16, whose numbers fill more registers than
# there are, one direction takes twice as long.
DIRECTIONS = 8

# The stepping code never asks for infinities: products with constants that are 0 vanish. Finiteness
# is checked on bit patterns (core/numerics/finite.hpp).
FLAGS = (*CPP_FLAGS, "-ffinite-math-only", "-fvisibility=hidden", "-pthread")


# The same machine of plain numbers in a library for sensitivities, under names of its own.
OF_LEADER = (
    "#undef ARM_DIRECTIONS\n#define ARM_RECORDS\n#define arm leading\n#define Scene Leader\n"
)


def library_of(scene: Scene) -> Library:
    """Return the scene's compiled machine, compiling it if no cached library fits.

    Raises:
        Refusal: there is neither a sound cached library nor a working compiler.
    """
    return library(machine_unit(scene))


def machine_unit(scene: Scene, boundary: str = "boundary/boundary.hpp") -> Unit:
    """Return the sources of `library_of`.

    Args:
        scene: the scene.
        boundary: the header with the functions of the library; it includes the default.
    """
    about = f"scene {scene.name} ({len(scene.joints)} joints)"
    unit = _unit(scene.name, scene_unit(scene, boundary), (ARM,), scene.where, about)
    return replace(unit, data=_periods(scene))


def _periods(scene: Scene) -> dict[str, bytes]:
    """Return ``arm_scene_periods`` of core/boundary/boundary.hpp."""
    numbers = scene.servo_period, scene.integrator.dt, scene.steps_per_period
    return {"arm_scene_periods": struct.pack("<ddq", *numbers)}


def library_with(scene: Scene, name: str, source: str, header: Header) -> Library:
    """Return the scene's compiled machine with more C++ in the same unit, see `library_of`.

    It restores what a machine of `library_of` has saved.

    Args:
        scene: the scene.
        name: what is added, for the name of the library.
        source: C++ that may use core/boundary/arm.h.
        header: declares the functions that it adds.
    """
    unit = machine_unit(scene)
    return library(
        replace(
            unit,
            name=f"{scene.name}-{name}",
            source=unit.source + source,
            headers=(*unit.headers, header),
            folders=(*unit.folders, header.path.parent, *header.folders),
            about=f"{unit.about} with {name}",
            saves_as=unit,
        )
    )


def equations_library_of(scene: Scene) -> Library:
    """Return the compiled equations of a scene's machines, see `library_of`."""
    return library(equations_unit(scene))


def sensitivity_library_of(scene: Scene) -> Library:
    """Return the scene's machine over dual numbers, see `library_of`."""
    about = f"derivatives of {scene.name} ({len(scene.joints)} joints)"
    source = scene_unit(scene, "boundary/sensitivity.hpp")
    unit = _unit(f"{scene.name}-derivatives", source, (SENSITIVITY,), scene.where, about)
    leader = OF_LEADER + scene_unit(scene, "boundary/primal_run.hpp")
    flags = (*FLAGS, f"-DARM_DIRECTIONS={DIRECTIONS}")
    return library(replace(unit, flags=flags, beside=leader))


def real_time_library() -> Library:
    """Return the compiled loop of tick/c/real_time.h, see `library_of`."""
    return library(real_time_unit())


def compile_ahead(scene: Scene, target: str, folder: Path | None) -> list[Path]:
    """Compile machine, equations and real-time loop, see
    `arm_emulator.toolchain.unit.compile_units`.

    Args:
        scene: the scene.
        target: see there.
        folder: see there.

    Raises:
        Refusal: see there.
    """
    units = [machine_unit(scene), equations_unit(scene), real_time_unit()]
    return compile_units(units, target, folder)


def equations_unit(scene: Scene) -> Unit:
    """Return the sources of `equations_library_of`."""
    about = f"equations of {scene.name} ({len(scene.joints)} joints)"
    source = scene_unit(scene, "boundary/equations.hpp")
    return _unit(f"{scene.name}-equations", source, (EQUATIONS,), scene.where, about)


def real_time_unit() -> Unit:
    """Return the sources of `real_time_library`."""
    source, about = '#include "real_time.cpp"\n', "the real-time loop"
    headers, where, part = (REAL_TIME,), "real time", "real_time.cpp"
    return Unit("real_time", source, FLAGS, FOLDERS, headers, where, about, part)


def _unit(name: str, source: str, headers: tuple[Header, ...], where: str, about: str) -> Unit:
    return Unit(name, source, FLAGS, (CORE,), headers, where, about, "the scene's core")
