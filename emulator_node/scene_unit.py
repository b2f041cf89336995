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
    threads, threads_header = {
        1: ("OneThread", "one_thread.hpp"),
        2: ("TwoThreads", "two_threads.hpp"),
    }[scene.threads]
    R_BW = scene.chain.R_BW
    gravity = R_BW @ scene.gravity if scene.gravity is not None else (0.0, 0.0, 0.0)
    links = ",\n".join(_link(geometry) for geometry in scene.chain.joints)
    devices = ",\n".join(_device(joint) for joint in scene.joints)
    drives = ",\n".join(_drive(joint) for joint in scene.joints)
    return f"""\
#include "device.hpp"
#include "scene.hpp"
#include "{threads_header}"

struct Scene {{
  static constexpr int N = {len(scene.joints)};
  static constexpr arm::Scheme scheme = arm::Scheme::{scene.integrator.scheme};
  template <class Stepper>
  using Threads = arm::{threads}<Scene, Stepper>;
  static constexpr arm::Exchange exchange = arm::Exchange::{scene.integrator.exchange};
  static constexpr bool energy_flow = {"true" if scene.energy_flow else "false"};
  static constexpr arm::Events events = arm::Events::{scene.integrator.events};
  static constexpr double supply_voltage = {_number(scene.supply_voltage)};
  static constexpr arm::Vec3<double> gravity = {_vector(gravity)};
  static constexpr arm::Link link[N] = {{
{links}}};
  static constexpr std::tuple drive = {{
{drives}}};
  static constexpr arm::Device device[N] = {{
{devices}}};
}};

#include "boundary.hpp"
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


def _device(joint: Joint) -> str:
    counts_per_rad = _number(joint.counts_per_turn / (2.0 * math.pi))
    return f"      {{.name = {_text(joint.name)}, .counts_per_rad = {counts_per_rad}}}"


def _text(words: str) -> str:
    plain = "".join(c if c.isascii() and c.isalnum() else _octal(c) for c in words)
    return f'"{plain}"'


def _octal(character: str) -> str:
    return "".join(f"\\{byte:03o}" for byte in character.encode())


def _part(kind: str, **numbers: float) -> str:
    return f"arm::{kind}{{{_fields(numbers)}}}"


def _fields(numbers: Mapping[str, float]) -> str:
    return ", ".join(f".{name} = {_number(value)}" for name, value in numbers.items())


def _vector(values: Sequence[float] | Array) -> str:
    return f"{{{_fields(dict(zip('xyz', values, strict=True)))}}}"


def _number(value: float) -> str:
    return repr(float(value) + 0.0)


# What a library is called
