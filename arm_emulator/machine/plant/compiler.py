"""From scenes to shared libraries, cached by content: machines, equations, real time."""

import struct
from dataclasses import replace
from pathlib import Path

from arm_emulator.core import CORE
from arm_emulator.machine.plant.core_calls import ARM, EQUATIONS, SENSITIVITY
from arm_emulator.machine.plant.scene_unit import write_scene_unit
from arm_emulator.machine.scene.scene import Scene
from arm_emulator.tick.c import FOLDERS, REAL_TIME
from arm_emulator.toolchain.c_header import Header, Library
from arm_emulator.toolchain.compile_unit import compile_units, load_library
from arm_emulator.toolchain.flags import CPP_FLAGS
from arm_emulator.toolchain.unit import Unit

# Directions of derivatives that one run follows. With 16, whose numbers fill more registers than
# there are, one direction takes twice as long.
DIRECTIONS = 8

# The stepping code never asks for infinities: products with constants that are 0 vanish. Finiteness
# is checked on bit patterns (core/numerics/finite.hpp).
FLAGS = (*CPP_FLAGS, "-ffinite-math-only", "-fvisibility=hidden", "-pthread")


# The same machine of plain numbers in a library for sensitivities, under names of its own.
OF_PRIMAL = (
    "#undef ARM_DIRECTIONS\n#define ARM_RECORDS\n"
    "#define arm primal_arm\n#define Scene PrimalScene\n"
)


def load_machine(scene: Scene) -> Library:
    """Return the scene's compiled machine, compiling it if no cached library fits.

    Raises:
        Refusal: there is neither a sound cached library nor a working compiler.
    """
    return load_library(build_machine_unit(scene))


def build_machine_unit(scene: Scene, boundary: str = "boundary/boundary.hpp") -> Unit:
    """Return the sources of `load_machine`.

    Args:
        scene: the scene.
        boundary: the header with the functions of the library; it includes the default.
    """
    about = f"scene {scene.name} ({len(scene.joints)} joints)"
    unit = _build_unit(scene.name, write_scene_unit(scene, boundary), (ARM,), scene.where, about)
    return replace(unit, data=_pack_periods(scene))


def _pack_periods(scene: Scene) -> dict[str, bytes]:
    """Return ``arm_scene_periods`` of core/boundary/boundary.hpp."""
    numbers = scene.servo_period, scene.integrator.dt, scene.steps_per_period
    return {"arm_scene_periods": struct.pack("<ddq", *numbers)}


def load_machine_with(scene: Scene, name: str, source: str, header: Header) -> Library:
    """Return the scene's compiled machine with more C++ in the same unit, see `load_machine`.

    It restores what a machine of `load_machine` has saved.

    Args:
        scene: the scene.
        name: what is added, for the name of the library.
        source: C++ that may use core/boundary/arm.h.
        header: declares the functions that it adds.
    """
    unit = build_machine_unit(scene)
    return load_library(
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


def load_equations(scene: Scene) -> Library:
    """Return the compiled equations of a scene's machines, see `load_machine`."""
    return load_library(build_equations_unit(scene))


def load_sensitivities(scene: Scene) -> Library:
    """Return the scene's machine over dual numbers, see `load_machine`."""
    about = f"derivatives of {scene.name} ({len(scene.joints)} joints)"
    source = write_scene_unit(scene, "boundary/sensitivity.hpp")
    unit = _build_unit(f"{scene.name}-derivatives", source, (SENSITIVITY,), scene.where, about)
    primal = OF_PRIMAL + write_scene_unit(scene, "boundary/primal_run.hpp")
    flags = (*FLAGS, f"-DARM_DIRECTIONS={DIRECTIONS}")
    return load_library(replace(unit, flags=flags, beside=primal))


def load_real_time() -> Library:
    """Return the compiled loop of tick/c/real_time.h, see `load_machine`."""
    return load_library(build_real_time_unit())


def compile_ahead(scene: Scene, target: str, folder: Path | None) -> list[Path]:
    """Compile machine, equations and real-time loop, see
    `arm_emulator.extension.compiler.compile_units`.

    Args:
        scene: the scene.
        target: see there.
        folder: see there.

    Raises:
        Refusal: see there.
    """
    units = [build_machine_unit(scene), build_equations_unit(scene), build_real_time_unit()]
    return compile_units(units, target, folder)


def build_equations_unit(scene: Scene) -> Unit:
    """Return the sources of `load_equations`."""
    about = f"equations of {scene.name} ({len(scene.joints)} joints)"
    source = write_scene_unit(scene, "boundary/equations.hpp")
    return _build_unit(f"{scene.name}-equations", source, (EQUATIONS,), scene.where, about)


def build_real_time_unit() -> Unit:
    """Return the sources of `load_real_time`."""
    source, about = '#include "real_time.cpp"\n', "the real-time loop"
    headers, where, part = (REAL_TIME,), "real time", "real_time.cpp"
    return Unit("real_time", source, FLAGS, FOLDERS, headers, where, about, part)


def _build_unit(
    name: str, source: str, headers: tuple[Header, ...], where: str, about: str
) -> Unit:
    return Unit(name, source, FLAGS, (CORE,), headers, where, about, "the scene's core")
