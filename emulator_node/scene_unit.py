"""A scene as C++: the constants that the core is compiled over, as a data sheet."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np

from emulator_node.chain import Array, ChainJoint
from emulator_node.scene import Joint, Scene


def scene_unit(scene: Scene) -> str:
    """Return the C++ unit of a scene: its constants, then the core's C interface.

    The step size is no constant, so that scenes that differ in it alone share a library.
    """
    R_BW = scene.chain.R_BW
    gravity = R_BW @ scene.gravity if scene.gravity is not None else (0.0, 0.0, 0.0)
    links = ",\n".join(_link(geometry) for geometry in scene.chain.joints)
    drives = ",\n".join(_drive(joint) for joint in scene.joints)
    return f"""\
#include "scene.hpp"

struct Scene {{
  static constexpr int N = {len(scene.joints)};
  static constexpr arm::Scheme scheme = arm::Scheme::{scene.integrator.scheme};
  static constexpr int threads = {scene.threads};
  static constexpr arm::Exchange exchange = arm::Exchange::{scene.integrator.exchange};
  static constexpr double supply_voltage = {_number(scene.supply_voltage)};
  static constexpr arm::Vec3<double> gravity = {_vector(gravity)};
  static constexpr arm::Link link[N] = {{
{links}}};
  static constexpr std::tuple drive = {{
{drives}}};
}};

#include "abi.hpp"
"""


def _link(geometry: ChainJoint) -> str:
    theta_0 = geometry.theta_0
    numbers = {
        "cos_alpha": geometry.cos_alpha,
        "sin_alpha": geometry.sin_alpha,
        "theta_0": theta_0,
        "cos_theta_0": math.cos(theta_0),
        "sin_theta_0": math.sin(theta_0),
    }
    body = geometry.body
    I = body.inertia  # noqa: E741
    tensor = dict(zip(("xx", "yy", "zz"), np.diag(I), strict=True))
    tensor |= {"xy": I[0, 1], "xz": I[0, 2], "yz": I[1, 2]}
    return f"""\
      {{.kind = arm::JointKind::{geometry.kind},
       {_fields(numbers)},
       .p = {_vector(geometry.p)},
       .body = {{.m = {_number(body.mass)},
                .h = {_vector(body.moment)},
                .I = {{{_fields(tensor)}}}}}}}"""


def _drive(joint: Joint) -> str:
    gear = _part("RigidGear", Ng=joint.gear.ratio)
    if joint.motor is not None:
        motor = _part(
            "DcMotor",
            R=joint.motor.resistance,
            L=joint.motor.inductance,
            Kt=joint.motor.torque_constant,
            Kb=joint.motor.back_emf_constant,
            Mm=joint.motor.rotor_inertia,
            current_limit=joint.motor.current_limit or 0.0,
        )
    else:
        motor = _part("NoMotor")
    if joint.gear.stiffness is not None:
        gear = _part(
            "ElasticGear",
            Ng=joint.gear.ratio,
            Kg=joint.gear.stiffness,
            Dg=joint.gear.damping,
        )
    friction = _fields(
        {
            "Dl": joint.friction.viscous,
            "Dc": joint.friction.coulomb,
            "Ds": joint.friction.breakaway,
        }
    )
    kinds = ", ".join(part.partition("{")[0] for part in (motor, gear))
    return f"""\
      arm::Drive<{kinds}>{{
          .motor = {motor},
          .gear = {gear},
          .friction = {{{friction}}}}}"""


def _part(kind: str, **numbers: float) -> str:
    return f"arm::{kind}{{{_fields(numbers)}}}"


def _fields(numbers: Mapping[str, float]) -> str:
    return ", ".join(f".{name} = {_number(value)}" for name, value in numbers.items())


def _vector(values: Sequence[float] | Array) -> str:
    return f"{{{_fields(dict(zip('xyz', values, strict=True)))}}}"


def _number(value: float) -> str:
    return repr(float(value) + 0.0)


# What a library is called
