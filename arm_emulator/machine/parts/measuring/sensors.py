"""The sensors of a scene, in C++ as core/mechanics/sensors.hpp has them."""

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Self

from arm_emulator.base.validation.section import Section
from arm_emulator.machine.parts.measuring.analog_sensor import AnalogSensor
from arm_emulator.machine.parts.measuring.current_sensor import CurrentSensor
from arm_emulator.machine.parts.measuring.encoder import IDEAL_COUNTS_PER_TURN, Encoder, LinkEncoder
from arm_emulator.machine.parts.measuring.imu import Accelerometer, Gyroscope, Imu
from arm_emulator.machine.parts.part import Part
from arm_emulator.machine.parts.registry import list_kinds


def _list_analog() -> tuple[type[AnalogSensor], ...]:
    """Return the kinds of analog sensors, which are those that are registered."""
    last = math.inf  # behind those that have a channel of their own
    return tuple(sorted(list_kinds(AnalogSensor), key=lambda kind: kind.channel or last))


ANALOG = _list_analog()

# Sensors of joints and of links.
SENSORS: tuple[type[Part] | type[Imu], ...] = (Encoder, LinkEncoder, *ANALOG, Imu)

# Kinds of numbers that they have; those of both encoders are alike.
IMU_SENSORS: tuple[type[Part], ...] = (Accelerometer, Gyroscope)
SENSOR_PARTS: tuple[type[Part], ...] = (Encoder, *ANALOG, *IMU_SENSORS)


@dataclass(frozen=True, kw_only=True)
class JointSensors:
    """Sensors of a joint; without an encoder, counts have the finest resolution."""

    encoder: Encoder | None = None
    link_encoder: LinkEncoder | None = None
    analog: tuple[AnalogSensor, ...] = ()

    @classmethod
    def read_section(cls, joint: Section, kind: str) -> Self:
        """Return the sensors that a joint's section describes.

        Args:
            joint: the section.
            kind: revolute or prismatic.

        Raises:
            Refusal: a value breaks its rule, or a sensor of a motor that is not there.
        """
        for key, needed in {
            "encoder": "motor",
            **{kind.section: kind.of for kind in ANALOG},
        }.items():
            if needed and joint.has_key(key) and joint.find_section(needed) is None:
                rule = f"belong to a joint with a {needed.replace('.', ' with a ')}"
                raise joint.make_refusal(key, rule, f"no {needed} section")
        motor, link = joint.get_section("encoder"), joint.get_section("link_encoder")
        sections = ((kind, joint.get_section(kind.section)) for kind in ANALOG)
        turn = 1.0 if kind == "prismatic" else 2.0 * math.pi
        return cls(
            encoder=None if motor is None else Encoder.read_section(motor),
            link_encoder=None if link is None else LinkEncoder.read_section(link, turn),
            analog=tuple(
                kind.read_section(section) for kind, section in sections if section is not None
            ),
        )

    @property
    def parts(self) -> dict[str, Part]:
        """The sensors that are present, by their sections."""
        encoders = {"encoder": self.encoder, "link_encoder": self.link_encoder}
        there: dict[str, Part] = {
            name: encoder for name, encoder in encoders.items() if encoder is not None
        }
        return there | {sensor.section: sensor for sensor in self.analog}

    @classmethod
    def add_counts(cls, counts_per_turn: int) -> Self:
        """Return sensors of which the encoder at the motor is the only one."""
        return cls(encoder=Encoder(counts_per_turn=counts_per_turn))

    @property
    def counting(self) -> Encoder:
        """The encoder at the motor; without one, the finest."""
        return self.encoder or Encoder(counts_per_turn=IDEAL_COUNTS_PER_TURN)

    @property
    def measuring(self) -> dict[str, Part]:
        """The sensors by their sections; the finest encoder where the motor has no encoder."""
        return {Encoder.section: self.counting, **self.parts}

    @property
    def current(self) -> CurrentSensor | None:
        """Sensor of its motor's current, which servos use."""
        return next((sensor for sensor in self.analog if isinstance(sensor, CurrentSensor)), None)

    @property
    def is_ideal(self) -> bool:
        """Whether its only sensor is an exact encoder at the motor."""
        return not self.parts or (
            self.encoder is not None and self.parts.keys() == {"encoder"} and self.encoder.is_ideal
        )


def list_measured_kinds(joints: Iterable[JointSensors]) -> tuple[type[AnalogSensor], ...]:
    """Return the kinds of analog sensors of some joints; a current is always measured."""
    there = {type(sensor) for sensors in joints for sensor in sensors.analog}
    return tuple(kind for kind in ANALOG if kind in there or kind is CurrentSensor)


def write_quantities(kinds: Iterable[type[AnalogSensor]]) -> str:
    """Return the quantities that kinds of sensors read, as structs in C++."""
    return "".join(
        f"""\
struct {kind.__name__} {{
  static constexpr arm::Field field = arm::Field::{kind.field};
  static void of(const auto& now, double* row) {{
    const auto& values = {kind.reads};
    for (int j = 0; j < now.N; ++j) row[j] = values[j];
  }}
}};

"""
        for kind in kinds
    )


def write_suite(
    seed: str,
    joints: Mapping[str, JointSensors],
    imus: Sequence[Imu],
    places: Mapping[str, str],
) -> str:
    """Return the function that makes the sensors of a scene.

    Args:
        seed: of the noise, in C++.
        joints: by name, base to tool.
        imus: inertial measurement units.
        places: where the values of varied numbers stand, by their name.
    """
    kinds = list_measured_kinds(joints.values())
    quantities = "".join(f", {kind.__name__}" for kind in kinds)
    lines = [
        f"arm::SensorSuite<N, {len(imus)}{quantities}> all;",
        f"all.seed = {seed};",
    ]
    for k, kind in enumerate(kinds):
        first, stride = kind.list_streams()
        row = f"std::get<{k}>(all.analog)"
        lines.append(f"{row}.first = {first}, {row}.stride = {stride};")
    rows = {kind.section: f"std::get<{k}>(all.analog).at" for k, kind in enumerate(kinds)}
    members = {"encoder": "all.encoder", "link_encoder": "all.link_encoder", **rows}
    for j, (name, sensors) in enumerate(joints.items()):
        for section, part in sensors.measuring.items():
            lines.append(f"{members[section]}[{j}] = {part.write_initialiser(name, places)};")
    lines += [f"all.imu[{m}] = {imu.write_initialiser(places)};" for m, imu in enumerate(imus)]
    body = "\n".join(f"    {line}" for line in [*lines, "return all;"])
    return f"""\
  static constexpr auto sensors([[maybe_unused]] const double* p) {{
{body}
  }}
"""
