"""A scene as C++: the constants that the core is compiled over, as a data sheet."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np

from emulator_node.chain import Array, Body, ChainJoint
from emulator_node.scene import Joint, Scene
from emulator_node.varied import Varied


def scene_unit(scene: Scene, boundary: str = "boundary.hpp") -> str:
    """Return the C++ unit of a scene: its constants, then the core's C interface.

    Neither the step size nor the values of varied numbers, which stand as p[k], are part of it, so
    that scenes that differ in these alone share a library.

    Args:
        scene: the scene.
        boundary: the header of the core that has the functions of the library.
    """
    threads, threads_header = {
        1: ("OneThread", "one_thread.hpp"),
        2: ("TwoThreads", "two_threads.hpp"),
    }[scene.threads]
    R_BW = scene.chain.R_BW
    gravity = R_BW @ scene.gravity if scene.gravity is not None else (0.0, 0.0, 0.0)
    places = {one.name: f"p[{k}]" for k, one in enumerate(scene.varied)}
    bodies = [_body(geometry.body) for geometry in scene.chain.joints]
    if (load := scene.load) is not None:
        bare, per_kg = _body(load.bare), _body(load.per_kg)
        bodies[load.link] = f"arm::loaded({bare}, {places['payload.mass']}, {per_kg})"
    links = ",\n".join(map(_link, scene.chain.joints, bodies))
    devices = ",\n".join(_device(joint) for joint in scene.joints)
    drives = ",\n".join(_drive(joint, places) for joint in scene.joints)
    parameters = "".join(f"      {_parameter(one)},\n" for one in scene.varied)
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
  static constexpr int parameters = {len(scene.varied)};
  static constexpr arm::Parameter parameter[parameters + 1] = {{
{parameters}  }};
  static constexpr arm::LinkRow<N> links([[maybe_unused]] const double* p) {{
    return {{{{
{links}}}}};
  }}
  static constexpr auto drives([[maybe_unused]] const double* p) {{
    return std::tuple{{
{drives}}};
  }}
  static constexpr arm::Device device[N] = {{
{devices}}};
}};

#include "{boundary}"
"""


def _parameter(one: Varied) -> str:
    numbers = _fields({"least": one.least, "most": one.most})
    return f"{{.name = {_text(one.name)}, {numbers}}}"


def _body(body: Body) -> str:
    I = body.inertia  # noqa: E741
    tensor = dict(zip(("xx", "yy", "zz"), np.diag(I), strict=True))
    tensor |= {"xy": I[0, 1], "xz": I[0, 2], "yz": I[1, 2]}
    m, h = _number(body.mass), _vector(body.moment)
    return f"arm::Body<double>{{.m = {m}, .h = {h}, .I = {{{_fields(tensor)}}}}}"


def _link(geometry: ChainJoint, body: str) -> str:
    theta_0 = geometry.theta_0
    numbers = {
        "cos_alpha": geometry.cos_alpha,
        "sin_alpha": geometry.sin_alpha,
        "theta_0": theta_0,
        "cos_theta_0": math.cos(theta_0),
        "sin_theta_0": math.sin(theta_0),
    }
    return f"""\
      {{.kind = arm::JointKind::{geometry.kind},
       {_fields(numbers)},
       .p = {_vector(geometry.p)},
       .body = {body}}}"""


def _drive(joint: Joint, places: Mapping[str, str]) -> str:
    def part(section: str, **numbers: tuple[str, float | None]) -> str:
        """Return designated initialisers; each from its key in that section of the joint."""
        return ", ".join(
            f".{symbol} = {places.get(f'joints.{joint.name}.{section}.{key}') or _number(value)}"
            for symbol, (key, value) in numbers.items()
            if value is not None
        )

    motor = "arm::NoMotor{}"
    gear = f"arm::RigidGear{{{part('gear', Ng=('ratio', joint.gear.ratio))}}}"
    if (m := joint.motor) is not None:
        numbers = part(
            "motor",
            R=("resistance", m.resistance),
            L=("inductance", m.inductance),
            Kt=("torque_constant", m.torque_constant),
            Kb=("back_emf_constant", m.back_emf_constant),
            Mm=("rotor_inertia", m.rotor_inertia),
            current_limit=("current_limit", m.current_limit),
        )
        motor = f"arm::DcMotor{{{numbers}}}"
    if (g := joint.gear).stiffness is not None:
        numbers = part(
            "gear",
            Ng=("ratio", g.ratio),
            Kg=("stiffness", g.stiffness),
            Kg3=("cubic_stiffness", g.cubic_stiffness),
            Dg=("damping", g.damping),
        )
        kind = "ElasticGear" if g.cubic_stiffness is None else "ProgressiveGear"
        gear = f"arm::{kind}{{{numbers}}}"
    f = joint.friction
    friction = part("friction", Dl=("viscous", f.viscous), Dc=("coulomb", f.coulomb))
    coulomb = places.get(f"joints.{joint.name}.friction.coulomb")
    if coulomb is None:
        friction += f", .Ds = {_number(f.breakaway)}"
    else:  # the breakaway torque goes with it
        ratio = f.breakaway / f.coulomb if f.coulomb > 0.0 else 1.0
        friction += f", .Ds = {_number(ratio)} * {coulomb}"
    kinds = ", ".join(kind.partition("{")[0] for kind in (motor, gear))
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


def _fields(numbers: Mapping[str, float]) -> str:
    return ", ".join(f".{name} = {_number(value)}" for name, value in numbers.items())


def _vector(values: Sequence[float] | Array) -> str:
    return f"{{{_fields(dict(zip('xyz', values, strict=True)))}}}"


def _number(value: float) -> str:
    return repr(float(value) + 0.0)


# What a library is called
