"""By how much a joint of one machine stands otherwise than its description has it."""

from dataclasses import dataclass, fields
from functools import partial
from typing import Self

from arm_emulator.base.urdf.frames import Frame, compute_rpy, make_frame
from arm_emulator.base.validation.number import number

# Machines differ from their descriptions by millimetres and by fractions of a degree.
_length = partial(number, "m", default=0.0, ends=(-1.0, 1.0))
_angle = partial(number, "rad", default=0.0, ends=(-1.0, 1.0))


@dataclass(frozen=True, kw_only=True)
class Deviation:
    """Deviations of one joint; x to yaw displace its frame, as seen from that of the description.

    The numbers of Denavit and Hartenberg are those of Universal Robots: the link behind the joint
    goes on by Rz(theta) Tz(d) Tx(a) Rx(alpha) to the next axis (denavit_hartenberg.py).
    """

    x: float = _length(text="displacement of the joint's frame along its own axes")
    y: float = _length(text="the same along y")
    z: float = _length(text="the same along z")
    roll: float = _angle(text="turn of the joint's frame, as `rpy` of a URDF")
    pitch: float = _angle(text="the same about y")
    yaw: float = _angle(text="the same about z")
    delta_theta: float = _angle(text="added to theta: a turn about the joint's axis")
    delta_d: float = _length(text="added to d: a shift along the joint's axis")
    delta_a: float = _length(text="added to a, the distance to the next axis")
    delta_alpha: float = _angle(text="added to alpha, the twist between both axes")
    encoder_zero: float = number(
        "rad or m",
        default=0.0,
        ends=(-10.0, 10.0),
        text="what the joint's encoders report, seen at the link, where the joint is at 0",
    )

    @classmethod
    def from_frame(cls, frame: Frame) -> Self:
        """Return the deviation that displaces a joint's frame to `frame`, seen from it."""
        x, y, z = map(float, frame.p)
        roll, pitch, yaw = map(float, compute_rpy(frame.R))
        return cls(x=x, y=y, z=z, roll=roll, pitch=pitch, yaw=yaw)

    @property
    def displaced(self) -> Frame:
        """Frame to which x to yaw displace that of the joint."""
        return make_frame((self.x, self.y, self.z), (self.roll, self.pitch, self.yaw))

    @property
    def has_dh_numbers(self) -> bool:
        """Whether it has numbers of Denavit and Hartenberg."""
        return any((self.delta_theta, self.delta_d, self.delta_a, self.delta_alpha))

    @property
    def nonzero(self) -> dict[str, float]:
        """Its numbers that are not 0, by name."""
        names = (field.name for field in fields(self))
        return {name: value for name in names if (value := getattr(self, name))}
