"""The C++ of a unit: a scene's machine, the table of its variables, and the functions of FMI."""

import uuid
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from arm_emulator.extension.base import VELOCITY
from arm_emulator.extension.compiler import TICK_FOLDERS, Unit
from arm_emulator.extension.machine import (
    Scene,
    build_machine_unit,
    compute_largest_position,
    cxx_number,
    find_input,
    list_further_inputs,
    list_modes,
    list_readings,
)
from arm_emulator_fmu.variables import Variable

FOLDER = Path(__file__).resolve().parent
VERSIONS = ("3", "2")  # of FMI


def make_unit(scene: Scene, variables: Sequence[Variable], version: str) -> tuple[Unit, str]:
    """Return the unit, and the token that its binary expects.

    The functions of FMI are compiled beside the machine, and so leave it its bits.

    Args:
        scene: the machine.
        variables: of it, in the order of their value references.
        version: of FMI, one of `VERSIONS`.
    """
    machine = build_machine_unit(scene)
    table = _write_table(scene, variables)
    token = f"{{{uuid.uuid5(uuid.NAMESPACE_OID, f'{version} {machine.source} {table}')}}}"
    unit = replace(
        machine,
        name=f"{scene.name}-fmu{version}",
        beside=f'{table}inline constexpr char kToken[] = "{token}";\n}}\n'
        f'#include "tick.c"\n#include "fmi{version}.cpp"\n',
        folders=(*machine.folders, *TICK_FOLDERS, FOLDER),
        more=(f"fmi{version}GetVersion",),
        about=f"{machine.about} for FMI {version}.0",
    )
    return unit, token


def _write_table(scene: Scene, variables: Sequence[Variable]) -> str:
    """Return the constants of instance.hpp; the namespace is left open."""
    rows = ",\n".join(map(_format_row, variables))
    modes = ", ".join(map(str, list_modes(scene)))
    names = list_further_inputs(scene)
    at = [find_input(joint, name) for name in names for joint in scene.joints]
    has = ", ".join("true" if value else "false" for value in at)
    parameters = _format_numbers([*(number.value for number in scene.varied), 0.0])
    return f"""\
#include "variable.hpp"

namespace fmu {{
inline constexpr int kJoints = {len(scene.joints)}, kLinks = {len(scene.chain.links)};
inline constexpr int kParameters = {len(scene.varied)};
inline constexpr int kImus = {len(scene.imus)}, kReadings = {len(list_readings(scene))};
inline constexpr int kInputs = {len(names)};  // of motors beside their command
inline constexpr bool kHasInput[kInputs * kJoints + 1] = {{{has}}};
inline constexpr bool kExternalWrench = {"true" if scene.external_wrench else "false"};
inline constexpr double kPeriod = {cxx_number(scene.servo_period)};  // s, of the servo
inline constexpr double kIntegrationStep = {cxx_number(scene.integrator.dt)};  // s
inline constexpr long kStepsPerPeriod = {scene.steps_per_period};
inline constexpr int kModes[] = {{{modes}}};  // enum arm_mode
inline constexpr double kStartQ[] = {{{_format_numbers(scene.start)}}};
inline constexpr double kLargestQ[] = {{{_format_numbers(compute_largest_position(scene))}}};
inline constexpr double kLargestV = {_format_numbers(VELOCITY.most)};
inline constexpr double kParameterStart[] = {{{parameters}}};
}}

#include "data.hpp"

namespace fmu {{
inline constexpr Variable kVariables[] = {{
{rows}}};
"""


def _format_row(variable: Variable) -> str:
    array, brackets, field = variable.symbol.partition("[]")
    value = f"{array}[{variable.first}]{field}" if brackets else array
    element = f"{array}[0]" if brackets else array
    truth = "true" if variable.symbol.startswith("truth.") else "false"
    return (
        f"    {{Type::{variable.type.lower()}, Role::{variable.role}, Rule::{variable.rule}, "
        f"{truth}, FMU_PLACE({value}, {element}), {variable.first}, {variable.count}}}"
    )


def _format_numbers(values: ArrayLike) -> str:
    return ", ".join(map(cxx_number, np.atleast_1d(values)))
