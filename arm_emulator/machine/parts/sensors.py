"""The sensors of a scene, in C++ as core/mechanics/sensors.hpp has them."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from arm_emulator.base.section import Section
from arm_emulator.machine import cxx_literals
from arm_emulator.machine.parts.current_sensor import CurrentSensor
from arm_emulator.machine.parts.encoder import IDEAL_COUNTS_PER_TURN, Encoder, LinkEncoder
from arm_emulator.machine.parts.imu import Accelerometer, Gyroscope, Imu
from arm_emulator.machine.parts.part import Part
from arm_emulator.machine.parts.torque_sensor import TorqueSensor

# All kinds of numbers that sensors have.
SENSORS: tuple[type[Part], ...] = (
    Encoder,
    CurrentSensor,
    TorqueSensor,
    Accelerometer,
    Gyroscope,
)


@dataclass(frozen=True, kw_only=True)
class JointSensors:
    """What a joint has; None: nothing, and of the motor's encoder the finest there is."""

    encoder: Encoder | None = None
    link_encoder: LinkEncoder | None = None
    current: CurrentSensor | None = None
    torque: TorqueSensor | None = None

    @classmethod
    def read(cls, joint: Section, kind: str) -> JointSensors:
        """Return the sensors that a joint's section describes.

        Args:
            joint: the section.
            kind: revolute or prismatic.

        Raises:
            Refusal: a value breaks its rule, or a sensor of a motor that is not there.
        """
        if not joint.has("motor"):
            for key in ("encoder", "current_sensor", "torque_sensor"):
                if joint.has(key):
                    rule = "belong to a joint with a motor"
                    raise joint.refusal(key, rule, "no motor section")
        motor, link = joint.section("encoder"), joint.section("link_encoder")
        current, torque = joint.section("current_sensor"), joint.section("torque_sensor")
        turn = 1.0 if kind == "prismatic" else 2.0 * math.pi
        return cls(
            encoder=None if motor is None else Encoder.read(motor),
            link_encoder=None if link is None else LinkEncoder.read(link, turn),
            current=None if current is None else CurrentSensor.read(current),
            torque=None if torque is None else TorqueSensor.read(torque),
        )

    @property
    def parts(self) -> dict[str, Part]:
        """Those that are there, by their names in C++."""
        found = {name: getattr(self, name) for name in self.__dataclass_fields__}
        return {name: one for name, one in found.items() if one is not None}

    @property
    def plain(self) -> bool:
        """Whether nothing but the motor's counts as they are is told beside the truth."""
        return not self.parts or (
            self.encoder is not None and self.parts.keys() == {"encoder"} and self.encoder.plain
        )


def suite(
    seed: int,
    joints: Mapping[str, JointSensors],
    imus: Sequence[Imu],
    places: Mapping[str, str],
) -> str:
    """Return the function that makes the sensors of a scene.

    Args:
        seed: of the noise.
        joints: by name, base to tool.
        imus: inertial measurement units.
        places: where the values of varied numbers stand, by their name.
    """
    lines = [
        f"arm::SensorSuite<N, {len(imus)}> all;",
        f"all.seed = {places.get('seed') or cxx_literals.number(seed)};",
    ]
    for j, (name, sensors) in enumerate(joints.items()):
        finest = Encoder(counts_per_turn=IDEAL_COUNTS_PER_TURN)
        for member, part in {"encoder": finest, **sensors.parts}.items():
            lines.append(f"all.{member}[{j}] = {part.initialiser(name, places)};")
    lines += [f"all.imu[{m}] = {imu.initialiser(places)};" for m, imu in enumerate(imus)]
    body = "\n".join(f"    {line}" for line in [*lines, "return all;"])
    return f"""\
  static constexpr auto sensors([[maybe_unused]] const double* p) {{
{body}
  }}
"""
