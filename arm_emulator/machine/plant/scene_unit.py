"""A scene as C++: the constants that the core is compiled over, as a data sheet."""

import math
from collections.abc import Mapping

import numpy as np

from arm_emulator.base.arrays import Array
from arm_emulator.base.escape import escape_c_string
from arm_emulator.base.products import apply_matrix
from arm_emulator.machine.chain import Body, Chain, ChainJoint
from arm_emulator.machine.cxx_literals import format_fields, format_number, format_vector
from arm_emulator.machine.faults.scene_faults import put_faults
from arm_emulator.machine.parts.bearing import name_deflection
from arm_emulator.machine.parts.drive_stages.drive_stage import Supply
from arm_emulator.machine.parts.line import write_lines
from arm_emulator.machine.parts.measuring.sensors import (
    list_measured_kinds,
    write_quantities,
    write_suite,
)
from arm_emulator.machine.parts.motors.motor import CxxMotor
from arm_emulator.machine.parts.part import Part
from arm_emulator.machine.plant.inputs import find_input, list_further_inputs
from arm_emulator.machine.plant.outputs import list_readings
from arm_emulator.machine.scene.joint import Joint
from arm_emulator.machine.scene.known_parts import DEFLECTIONS, make_rotor_friction
from arm_emulator.machine.scene.scene import Scene
from arm_emulator.machine.varied import AXES, TENSOR, Varied, write_expressions
from arm_emulator.machine.varied_places import SECTION as CALIBRATION
from arm_emulator.machine.varied_places import write_place


def write_scene_unit(scene: Scene, boundary: str = "boundary/boundary.hpp") -> str:
    """Return the C++ unit of a scene: its constants, then the core's C interface.

    It contains neither the step size nor the values of varied numbers, which stand as p[k]. Scenes
    that differ in these alone therefore share a library.

    Args:
        scene: the scene.
        boundary: the header of the core that has the functions of the library.
    """
    kind = "OneThread" if scene.threads == 1 else "TwoThreads"
    places = _name_places(scene)
    R_BW = scene.chain.R_BW
    gravity = apply_matrix(R_BW, scene.gravity) if scene.gravity is not None else (0.0, 0.0, 0.0)
    links = ",\n".join(map(_write_link, scene.chain.links, _write_bodies(scene, places)))
    axes = _write_axes(scene.chain) if scene.external_wrench else ""
    joints = scene.machine_joints.values()
    devices = ",\n".join(map(_write_device, joints))
    drives = ",\n".join(_write_drive(joint, places, scene.supply_voltage) for joint in joints)
    around = _write_surroundings(scene, places)
    read, sensors = _write_sensors(scene, places)
    braked = sum(joint.brake is not None for joint in scene.joints)
    parameters = "".join(f"      {_write_parameter(number)},\n" for number in scene.varied)
    return f"""\
{_write_includes(scene, places)}

{read}struct Scene {{
  static constexpr int N = {len(joints)};
  static constexpr int L = {len(scene.chain.links)};
{_write_coupling(scene.chain)}{_write_joints(scene)}\
  using Scheme = {scene.integrator.method.write_cxx_type()};
  template <class Stepper>
  using Threads = arm::{kind}<Scene, Stepper>;
  static constexpr arm::Exchange exchange = arm::Exchange::{scene.integrator.exchange};
  static constexpr int exchange_depth = {scene.integrator.exchange_depth};
  static constexpr bool energy_flow = {"true" if scene.energy_flow else "false"};
  static constexpr bool external_wrench = {"true" if scene.external_wrench else "false"};
{axes}\
  static constexpr arm::Events events = arm::Events::{scene.integrator.events};
  static constexpr arm::Real supply_voltage = {format_number(scene.supply_voltage)};
  static constexpr arm::Vec3<arm::Real> gravity = {format_vector(gravity)};
{around}\
  static constexpr int brakes = {braked};
{_write_brakes(scene)}\
  static constexpr int parameters = {len(scene.varied)};
  static constexpr arm::Parameter parameter[parameters + 1] = {{
{parameters}  }};
  static constexpr arm::LinkRow<L> links([[maybe_unused]] const arm::Real* p) {{
    return {{{{
{links}}}}};
  }}
{_write_places(scene, places)}\
  static constexpr auto drives([[maybe_unused]] const arm::Real* p) {{
    return std::tuple{{
{drives}}};
  }}
  static constexpr arm::Device device[N] = {{
{devices}}};
{_write_inputs(scene)}{_write_readings(scene)}{sensors}}};

#include "{boundary}"
"""


def _name_places(scene: Scene) -> dict[str, str]:
    """Return what stands for the numbers that are data of a machine, by name."""
    places = {number.name: f"p[{k}]" for k, number in enumerate(scene.varied)}
    braked = [joint for joint in scene.joints if joint.brake]
    closed = {f"joints.{joint.name}.brake.closed": f"p[{len(places) + k}]"
              for k, joint in enumerate(braked)}  # fmt: skip
    places |= closed
    put_faults(scene.faults, places)
    return places


def _write_bodies(scene: Scene, places: Mapping[str, str]) -> list[str]:
    """Return the bodies of the links, the one that carries the payload with it."""
    bodies = [_write_link_body(geometry, places) for geometry in scene.chain.links]
    if (load := scene.load) is not None and "payload.mass" in places:
        bare, per_kg = _write_body(load.bare), _write_body(load.per_kg)
        bodies[load.link] = f"arm::add_load({bare}, {places['payload.mass']}, {per_kg})"
    return bodies


def _write_includes(scene: Scene, places: Mapping[str, str]) -> str:
    """Return the headers of the parts, of the scheme and of the threads."""
    headers = sorted(
        {
            f"parts/{header}"
            for joint in scene.joints
            for part in joint.parts
            for header in part.list_headers(joint.name, places)
        }
    )
    if scene.has_sensor_errors:
        headers.append("mechanics/sensors.hpp")
    if _write_lines(scene, places):
        headers.append("parts/line.hpp")
    threads = {1: "one_thread", 2: "two_threads"}[scene.threads]
    headers += ["parts/device.hpp", "mechanics/scene.hpp"]
    headers += [f"schemes/{scene.integrator.method.header}", f"schemes/{threads}.hpp"]
    return "\n".join(f'#include "{header}"' for header in headers)


def _write_sensors(scene: Scene, places: Mapping[str, str]) -> tuple[str, str]:
    """Return the quantities that sensors read, and the sensors and lines."""
    read, sensors = "", ""
    if scene.has_sensor_errors:
        read = write_quantities(list_measured_kinds(joint.sensors for joint in scene.joints))
        of_joints = {name: joint.sensors for name, joint in scene.machine_joints.items()}
        sensors = write_suite(_write_seed(scene, places), of_joints, scene.imus, places)
    return read, sensors + _write_lines(scene, places)


def _write_lines(scene: Scene, places: Mapping[str, str]) -> str:
    return write_lines(_write_seed(scene, places), scene.joint_names, places)


def _write_seed(scene: Scene, places: Mapping[str, str]) -> str:
    return places.get("seed") or format_number(scene.seed)


def _write_surroundings(scene: Scene, places: Mapping[str, str]) -> str:
    """Return gravity and supply where faults change them."""
    text = ""
    if tilt := places.get("base.tilt"):
        axis = format_vector(scene.chain.R_BW[:, 0])
        text += f"""\
  static constexpr arm::Vec3<arm::Real> field(const arm::Real* p) {{
    return arm::rotate_field(gravity, {axis}, {tilt});
  }}
"""
    if share := places.get("supply.share"):
        text += f"""\
  static constexpr arm::Real supply(const arm::Real* p) {{ return supply_voltage * {share}; }}
"""
    return text


def _write_inputs(scene: Scene) -> str:
    """Return the motors' further inputs."""
    names, joints, rows = list_further_inputs(scene), scene.machine_joints.values(), []
    for name in names:
        at = [find_input(joint, name) for joint in joints]
        pairs = zip(joints, at, strict=True)
        of = ", ".join(
            str(joint.inputs[1:].index(input_) if input_ else -1) for joint, input_ in pairs
        )
        units = ", ".join(escape_c_string(input_.unit if input_ else "") for input_ in at)
        rows.append(f"      {{{escape_c_string(name)}, {{{of}}}, {{{units}}}}},\n")
    return f"""\
  static constexpr int inputs = {len(names)};
  static constexpr arm::FurtherInput<N> input[inputs + 1] = {{
{"".join(rows)}  }};
"""


def _write_readings(scene: Scene) -> str:
    rows = list_readings(scene)
    if not rows:
        return "  static constexpr int readings = 0;\n"
    texts = ((row.name, row.unit, row.choose_unit("prismatic")) for row in rows)
    lines = ",\n".join(f"      {{{', '.join(map(escape_c_string, row))}}}" for row in texts)
    return f"""\
  static constexpr int readings = {len(rows)};
  static constexpr arm::Reading reading[readings] = {{
{lines}}};
"""


def _write_coupling(chain: Chain) -> str:
    """Return the coupling of joints and shafts, if there is one."""
    coupling = chain.coupling
    if coupling.is_identity:
        return ""
    rows = ",\n".join(f"      {{{', '.join(map(format_number, row))}}}" for row in coupling.C)
    offsets = ", ".join(map(format_number, coupling.offset))
    return f"""\
  static constexpr arm::Real coupling[L][N] = {{
{rows}}};
  static constexpr arm::Real coupling_offset[L] = {{{offsets}}};
  static constexpr int link_of[N] = {{{", ".join(map(str, chain.link_of))}}};
"""


def _write_joints(scene: Scene) -> str:
    """Return the joints that controllers know and their deflections, if bearings give way."""
    names = list(scene.machine_joints)
    if not scene.chain.deflections:
        return ""
    places = ", ".join(map(str, scene.joint_places))
    rows = []
    for kind in DEFLECTIONS:
        at = [name_deflection(joint.name, kind) for joint in scene.joints]
        row = [names.index(name) if name in names else -1 for name in at]
        if set(row) != {-1}:
            rows.append(f"      {{{', '.join(map(str, row))}}}")
    table = ",\n".join(rows)
    return f"""\
  static constexpr int J = {len(scene.joints)};
  static constexpr int drive_of[J] = {{{places}}};
  static constexpr int deflections = {len(rows)};  // the first of the readings
  static constexpr int deflection[deflections][J] = {{
{table}}};
"""


def _write_axes(chain: Chain) -> str:
    """Return rotations of vectors from the URDF's links and the world to the core."""
    links = ",\n".join(f"      {{{_write_matrix(joint.axes)}}}" for joint in chain.links)
    return f"""\
  static constexpr arm::Real link_axes[L][3][3] = {{
{links}}};
  static constexpr arm::Real world_axes[3][3] = {{{_write_matrix(chain.R_BW)}}};
"""


def _write_matrix(rows: Array) -> str:
    return ", ".join(f"{{{', '.join(map(format_number, row))}}}" for row in rows)


def _write_parameter(number: Varied) -> str:
    lower, upper = number.number.ends
    numbers = format_fields({"least": lower, "most": upper})
    return f"{{.name = {escape_c_string(number.name)}, {numbers}}}"


def _write_body(body: Body) -> str:
    I = body.inertia  # noqa: E741
    tensor = dict(zip(("xx", "yy", "zz"), np.diag(I), strict=True))
    tensor |= {"xy": I[0, 1], "xz": I[0, 2], "yz": I[1, 2]}
    m, h = format_number(body.mass), format_vector(body.moment)
    return f"arm::Body<arm::Real>{{.m = {m}, .h = {h}, .I = {{{format_fields(tensor)}}}}}"


def _write_link_body(geometry: ChainJoint, places: Mapping[str, str]) -> str:
    of = write_expressions(geometry, places)
    if of is None:
        return _write_body(geometry.body)
    h = ", ".join(of[f"moment_{x}"] for x in AXES)
    tensor = ", ".join(f".{xx} = {of[f'inertia_{xx}']}" for xx in TENSOR)
    return f"arm::Body<arm::Real>{{.m = {of['mass']}, .h = {{{h}}}, .I = {{{tensor}}}}}"


def _write_link(geometry: ChainJoint, body: str) -> str:
    theta_0 = geometry.theta_0
    gamma = format_fields({"cos_gamma": geometry.cos_gamma, "sin_gamma": geometry.sin_gamma})
    numbers = {
        "cos_alpha": geometry.cos_alpha,
        "sin_alpha": geometry.sin_alpha,
        "theta_0": theta_0,
        "cos_theta_0": math.cos(theta_0),
        "sin_theta_0": math.sin(theta_0),
    }
    return f"""\
      {{.kind = arm::JointKind::{geometry.kind},
       .parent = {geometry.parent},
       {gamma},
       {format_fields(numbers)},
       .p = {format_vector(geometry.p)},
       .body = {body}}}"""


def _write_places(scene: Scene, places: Mapping[str, str]) -> str:
    """Return the links' places where numbers of the calibration vary."""
    if not any(name.startswith(f"{CALIBRATION}.") for name in places):
        return ""
    rows = ",\n".join(
        f"      {write_place(link, scene.calibration, places)}" for link in scene.chain.links
    )
    return f"""\
  static constexpr arm::LinkPlaces<L> places([[maybe_unused]] const arm::Real* p) {{
    return {{{{
{rows}}}}};
  }}
"""


def _write_brakes(scene: Scene) -> str:
    """Return the joints of the brakes, and the delays after which they close and open."""
    brakes = {j: joint.brake for j, joint in enumerate(scene.joints) if joint.brake}
    delays = (
        f"{{{format_number(b.close_delay)}, {format_number(b.release_delay)}}}"
        for b in brakes.values()
    )
    return f"""\
  static constexpr int braked[brakes + 1] = {{{", ".join(map(str, brakes))}}};
  static constexpr arm::Real brake_delays[brakes + 1][2] = {{{", ".join(delays)}}};
"""


def _write_drive(joint: Joint, places: Mapping[str, str], supply_voltage: float) -> str:
    def write_part(piece: Part) -> str:
        return piece.write_initialiser(joint.name, places)

    def wrap_law(kind: str, values: str) -> tuple[str, str]:
        for extra in joint.extras:
            if extra.friction_wrapper:
                kind = f"arm::{extra.friction_wrapper}<{kind}>"
                values = f"{kind}{{{values}}}"
        return kind, values

    rotor = joint.rotor_friction
    kind, values = "arm::FreeRotor", "{}"
    if joint.brake or rotor:
        law, of_law = wrap_law(*(rotor or make_rotor_friction()).write_law(joint.name, places))
        if joint.brake:
            closed = places[f"joints.{joint.name}.brake.closed"]
            law, of_law = joint.brake.wrap_law(law, of_law, write_part(joint.brake), closed)
        kind, values = f"arm::RotorFriction<{law}>", f"{{{of_law}}}"
    friction = wrap_law(joint.friction.cxx_type, write_part(joint.friction))
    motor = CxxMotor("arm::NoMotor", "arm::NoMotor{}")
    if joint.motor is not None:
        motor = CxxMotor(joint.motor.cxx_type, write_part(joint.motor))
        for decorator in joint.decorators:
            supply = Supply(supply_voltage, places.get("supply.share", ""))
            motor = decorator.wrap_motor(joint.motor, motor, write_part(decorator), supply)
        motor = joint.motor.wrap_motor(motor, joint.name, places)
    gear = joint.gear.cxx_type, write_part(joint.gear)
    for stage in joint.gear_stages:
        gear = stage.wrap_gear(*gear, write_part(stage))
    kinds = [
        motor.type,
        gear[0],
        friction[0],
        kind,
        *(extra.cxx_type for extra in (*joint.extras, *joint.bearing)),
    ]
    extras = ", ".join(map(write_part, (*joint.extras, *joint.bearing)))
    return f"""\
      arm::Drive<{", ".join(kinds)}>{{
          .motor = {motor.value},
          .gear = {gear[1]},
          .friction = {friction[1]},
          .rotor = {values},
          .extras = {{{extras}}}}}"""


def _write_device(joint: Joint) -> str:
    counts_per_rad = format_number(joint.counts_per_turn / (2.0 * math.pi))
    return f"      {{.name = {escape_c_string(joint.name)}, .counts_per_rad = {counts_per_rad}}}"
