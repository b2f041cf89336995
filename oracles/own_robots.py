"""Robot descriptions of many kinds, written as people write them, for tests and the bench."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field

TURN = math.pi


@dataclass(frozen=True)
class RobotPart:
    """A joint and the rod that it moves; the next joint sits at the rod's end."""

    axis: str
    rod: tuple[float, float, float]  # m, from this joint to the next, in the joint's frame
    mass: float = 1.0  # kg
    kind: str = "revolute"
    limits: tuple[float, float] | None = (-0.9 * TURN, 0.9 * TURN)
    effort: float | None = None
    velocity: float | None = None
    rpy: str = "0 0 0"
    radius: float = 0.04  # m, of the rod
    mimic: str = ""


@dataclass
class Robot:
    """A URDF in the making."""

    name: str
    elements: list[str] = field(default_factory=list)

    def add_link(self, name: str, part: RobotPart | None = None) -> None:
        """Add a link, with the inertia of a part."""
        inertial = _write_inertial(part) if part is not None and part.mass > 0.0 else ""
        self.elements.append(f'<link name="{name}">{inertial}</link>')

    def add_joint(self, name: str, kind: str, ends: tuple[str, str], xyz: str, inside: str) -> None:
        """Add a joint; `inside`: its rpy, a bar, and what else it holds."""
        parent, child = ends
        rpy, _, rest = inside.partition("|")
        self.elements.append(
            f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>'
            f'<origin xyz="{xyz}" rpy="{rpy}"/>{rest}</joint>'
        )

    def write_urdf(self) -> str:
        """Return the URDF."""
        return (
            f'<?xml version="1.0"?>\n<robot name="{self.name}">'
            + "\n".join(self.elements)
            + ("</robot>\n")
        )


def write_serial(
    name: str, parts: list[RobotPart], base_rpy: str = "0 0 0", tool: str = "tool0"
) -> str:
    """Return the URDF of a serial arm with joints j1, j2, ... and a massless tool frame."""
    robot = Robot(name)
    robot.add_link("world")
    robot.add_link("base")
    robot.add_joint("mount", "fixed", ("world", "base"), "0 0 0.1", f"{base_rpy}|")
    at, link = (0.0, 0.0, 0.0), "base"
    for k, part in enumerate(parts, start=1):
        robot.add_link(f"l{k}", part)
        robot.add_joint(
            f"j{k}",
            part.kind,
            (link, f"l{k}"),
            _format_words(at),
            f"{part.rpy}|{_write_rest(part)}",
        )
        at, link = part.rod, f"l{k}"
    robot.add_link(tool)
    robot.add_joint("flange", "fixed", (link, tool), _format_words(at), "0 0 0|")
    return robot.write_urdf()


def _write_rest(part: RobotPart) -> str:
    words = f'<axis xyz="{part.axis}"/>'
    limits = {"effort": part.effort, "velocity": part.velocity}
    if part.limits is not None:
        limits |= {"lower": part.limits[0], "upper": part.limits[1]}
    attributes = "".join(
        f' {key}="{value!r}"' for key, value in limits.items() if value is not None
    )
    mimic = f'<mimic joint="{part.mimic}"/>' if part.mimic else ""
    return words + (f"<limit{attributes}/>" if attributes else "") + mimic


def _format_words(p: tuple[float, float, float]) -> str:
    return " ".join(map(repr, p))


def _write_inertial(part: RobotPart) -> str:
    """Return the inertia of a solid cylinder along the rod, upright where the rod has no length."""
    x, y, z = part.rod
    length = math.hypot(x, y, z)
    m, r = part.mass, part.radius
    along, across = 0.5 * m * r * r, m * (3.0 * r * r + length * length) / 12.0
    if length == 0.0:
        u = (0.0, 0.0, 1.0)
    else:
        u = (x / length, y / length, z / length)
    entries = {}
    for a, i in zip("xyz", range(3), strict=True):
        for b, j in zip("xyz", range(3), strict=True):
            if i <= j:
                value = (along - across) * u[i] * u[j] + (across if i == j else 0.0)
                entries[f"i{a}{b}"] = value
    tensor = " ".join(f'{key}="{value!r}"' for key, value in entries.items())
    return (
        f'<inertial><origin xyz="{_format_words((x / 2, y / 2, z / 2))}"/><mass value="{m!r}"/>'
        f"<inertia {tensor}/></inertial>"
    )


def _make_wrist(mass: float = 0.8) -> list[RobotPart]:
    """Return three joints whose axes meet in a point."""
    return [
        RobotPart("1 0 0", (0.0, 0.0, 0.0), mass),
        RobotPart("0 1 0", (0.0, 0.0, 0.0), mass, limits=(-2.0, 2.0)),
        RobotPart("1 0 0", (0.1, 0.0, 0.0), mass),
    ]


def make_pendulum() -> str:
    """Return one joint."""
    return write_serial("pendulum", [RobotPart("0 1 0", (0.5, 0.0, 0.0), 2.0)])


def make_planar() -> str:
    """Return two joints in a vertical plane."""
    return write_serial(
        "planar", [RobotPart("0 1 0", (0.4, 0.0, 0.0), 3.0), RobotPart("0 1 0", (0.3, 0.0, 0.0))]
    )


def make_scara() -> str:
    """Return a SCARA: two turns, a slide, a turn."""
    slide = RobotPart("0 0 1", (0.0, 0.0, -0.2), 1.0, "prismatic", (-0.2, 0.0), 200.0, 1.0)
    return write_serial(
        "scara",
        [
            RobotPart(
                "0 0 1", (0.325, 0.0, 0.0), 8.0, limits=(-2.5, 2.5), effort=120.0, velocity=6.0
            ),
            RobotPart(
                "0 0 1", (0.225, 0.0, 0.0), 5.0, limits=(-2.6, 2.6), effort=60.0, velocity=9.0
            ),
            slide,
            RobotPart("0 0 1", (0.0, 0.0, -0.05), 0.5, velocity=20.0),
        ],
    )


def make_gantry() -> str:
    """Return three slides."""

    def make_axis(direction: str, reach: float, mass: float) -> RobotPart:
        return RobotPart(direction, (0.0, 0.0, 0.0), mass, "prismatic", (0.0, reach), None, 1.0)

    return write_serial(
        "gantry",
        [
            make_axis("1 0 0", 2.0, 60.0),
            make_axis("0 1 0", 1.2, 30.0),
            make_axis("0 0 1", 0.8, 12.0),
        ],
    )


def make_gantry_with_turn() -> str:
    """Return three slides without rates, and a turn without limits."""

    def make_axis(direction: str, reach: float, mass: float) -> RobotPart:
        return RobotPart(direction, (0.0, 0.0, 0.1), mass, "prismatic", (-reach, reach), None, None)

    return write_serial(
        "gantry_with_turn",
        [
            make_axis("1 0 0", 0.6, 20.0),
            make_axis("0 1 0", 0.4, 10.0),
            make_axis("0 0 -1", 0.3, 5.0),
            RobotPart("0 0 1", (0.1, 0.0, 0.0), 1.0, "continuous", None),
        ],
    )


def make_telescopic() -> str:
    """Return two turns and a boom of two slides."""
    return write_serial(
        "telescopic",
        [
            RobotPart("0 0 1", (0.0, 0.0, 0.4), 20.0),
            RobotPart("0 1 0", (0.8, 0.0, 0.0), 15.0, limits=(-1.2, 0.8)),
            RobotPart("1 0 0", (0.3, 0.0, 0.0), 6.0, "prismatic", (0.0, 0.6)),
            RobotPart("1 0 0", (0.2, 0.0, 0.0), 4.0, "prismatic", (0.0, 0.4)),
        ],
    )


def make_five_joints() -> str:
    """Return a hobby arm."""
    return write_serial(
        "five_joints",
        [
            RobotPart("0 0 1", (0.0, 0.0, 0.15), 1.0, effort=6.0, velocity=4.0),
            RobotPart("0 1 0", (0.0, 0.0, 0.2), 0.4, effort=6.0, velocity=4.0),
            RobotPart("0 1 0", (0.2, 0.0, 0.0), 0.3, effort=6.0, velocity=4.0),
            RobotPart("0 1 0", (0.05, 0.0, 0.0), 0.1, effort=2.0, velocity=4.0),
            RobotPart("1 0 0", (0.05, 0.0, 0.0), 0.1, effort=2.0, velocity=4.0),
        ],
    )


def make_spherical_wrist() -> str:
    """Return a heavy arm whose last axes meet."""
    return write_serial(
        "spherical_wrist",
        [
            RobotPart("0 0 1", (0.15, 0.0, 0.4), 60.0, effort=1500.0, velocity=2.2, radius=0.12),
            RobotPart(
                "0 1 0", (0.0, 0.0, 0.7), 40.0, limits=(-1.5, 2.3), effort=1500.0, velocity=2.0
            ),
            RobotPart(
                "0 1 0", (0.7, 0.0, 0.0), 25.0, limits=(-2.9, 1.2), effort=800.0, velocity=2.2
            ),
            *_make_wrist(6.0),
        ],
    )


def make_tilted() -> str:
    """Return the arm with the spherical wrist, hung from a slope."""
    return write_serial(
        "tilted",
        [
            RobotPart("0 0 1", (0.0, 0.0, 0.2), 5.0),
            RobotPart("0 1 0", (0.0, 0.0, 0.4), 4.0),
            RobotPart("0 1 0", (0.35, 0.0, 0.0), 3.0),
            *_make_wrist(),
        ],
        base_rpy="2.6 0.3 0.5",
    )


def make_seven_joints() -> str:
    """Return a redundant arm."""
    return write_serial(
        "seven_joints",
        [
            RobotPart("0 0 1", (0.0, 0.0, 0.3), 4.0),
            RobotPart("0 1 0", (0.0, 0.0, 0.2), 3.0, limits=(-2.0, 2.0)),
            RobotPart("0 0 1", (0.05, 0.0, 0.2), 3.0),
            RobotPart("0 -1 0", (-0.05, 0.0, 0.35), 2.0, limits=(-2.5, -0.1)),
            *_make_wrist(),
        ],
    )


def make_on_a_rail() -> str:
    """Return eight joints, a rail first."""
    return write_serial(
        "on_a_rail",
        [
            RobotPart("0 1 0", (0.0, 0.0, 0.2), 50.0, "prismatic", (-2.0, 2.0), None, 1.5),
            RobotPart("0 0 1", (0.0, 0.0, 0.3), 4.0),
            RobotPart("0 1 0", (0.0, 0.0, 0.2), 3.0, limits=(-2.0, 2.0)),
            RobotPart("0 0 1", (0.05, 0.0, 0.2), 3.0),
            RobotPart("0 -1 0", (-0.05, 0.0, 0.35), 2.0, limits=(-2.5, -0.1)),
            *_make_wrist(),
        ],
    )


def make_nine_joints() -> str:
    """Return a snake of continuous joints without any limits."""
    axes = ["0 0 1", "0 1 0", "1 0 0"] * 3
    return write_serial(
        "nine_joints",
        [RobotPart(axis, (0.05, 0.0, 0.15), 1.0, "continuous", None) for axis in axes],
    )


OWN: dict[str, Callable[[], str]] = {
    make.__name__.removeprefix("make_"): make
    for make in (
        make_pendulum,
        make_planar,
        make_scara,
        make_gantry,
        make_gantry_with_turn,
        make_telescopic,
        make_five_joints,
        make_spherical_wrist,
        make_tilted,
        make_seven_joints,
        make_on_a_rail,
        make_nine_joints,
    )
}
