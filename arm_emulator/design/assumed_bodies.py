"""Bodies of links whose description has shapes only: of one density, marked as assumed.

A mesh is taken for its convex hull, which needs no closed surface and whose density differs little
from arm to arm: of 44 industrial arms with meshes and masses half lie between 980 and 1 520 kg/m3,
the median is 1 200 (`DENSITY`). A link without a shape is a rod to the next joint.
"""

import math
import xml.etree.ElementTree as ET
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from arm_emulator.base.arrays import Array
from arm_emulator.base.refusal import Refusal
from arm_emulator.base.urdf.frames import Frame, make_frame
from arm_emulator.design.mesh_file import find_mesh
from arm_emulator.machine.chain import Body
from arm_emulator.motion.model.mesh_units import read_mesh_unit

DENSITY = 1200.0  # kg/m3
SLENDER = 0.1  # radius by length of a rod
SHORTEST = 0.15  # of the longest rod: a link between joints that meet
LONE = 0.1  # m, of a rod where no link has a length
MAX_MESH = 64 << 20  # bytes
_KEYS = ("ixx", "iyy", "izz", "ixy", "ixz", "iyz")


@dataclass(frozen=True)
class AssumedBody:
    """A link whose body is assumed."""

    link: str
    how: str
    """From what, in words."""


def assume_bodies(
    robot: ET.Element,
    folder: Path,
    links: Mapping[str, Array],
    density: float = DENSITY,
) -> list[AssumedBody]:
    """Give links of a description bodies of a density; a mass that is given stays.

    Args:
        robot: the URDF's root element.
        folder: where its file lies.
        links: that get a body, each with where its rod ends if it has no shape, in its frame [m].
        density: [kg/m3].
    """
    longest = max((float(np.linalg.norm(end)) for end in links.values()), default=0.0)
    out = []
    for link in robot.findall("link"):
        name = link.get("name", "")
        if name not in links:
            continue
        body, how = read_shape_body(link, folder)
        if body is None:
            body, why = _make_rod(links[name], SHORTEST * longest or LONE), how
            how = f"a rod to the next joint{why}"
        scale = density
        for old in link.findall("inertial"):
            mass = old.find("mass")
            stated = float(mass.get("value", "0")) if mass is not None else 0.0
            if stated > 0.0:
                scale, how = stated / body.mass, f"{how}, with the mass given"
            link.remove(old)
        link.insert(0, make_inertial(body.scale_mass(scale)))
        out.append(AssumedBody(name, how))
    return out


def has_shape(link: ET.Element) -> bool:
    """Whether a link has shapes, of which its body could be assumed."""
    return bool(link.findall("collision") or link.findall("visual"))


def read_shape_body(link: ET.Element, folder: Path) -> tuple[Body | None, str]:
    """Return the body of a link's shapes at 1 kg/m3, and from what; without, why not."""
    why = ""
    for kind in ("collision", "visual"):
        body = Body()
        shapes: list[str] = []
        for element in link.findall(kind):
            try:
                part, kind_name = _read_shape(element, folder)
            except Refusal as refusal:
                why = f" ({refusal.quantity} {refusal.got})"
                continue
            body, shapes = body + part, [*shapes, kind_name]
        if body.mass > 0.0:
            return body, f"{kind}: {', '.join(dict.fromkeys(shapes))}"
    return None, why


def _read_shape(element: ET.Element, folder: Path) -> tuple[Body, str]:
    origin, geometry = element.find("origin"), element.find("geometry")
    at = Frame()
    if origin is not None:
        at = make_frame(_read_row(origin, "xyz", "0 0 0"), _read_row(origin, "rpy", "0 0 0"))
    shape = None if geometry is None else next(iter(geometry), None)
    if shape is None:
        raise Refusal("new", "geometry", "be a shape", "without one")
    if shape.tag == "mesh":
        body = _make_hull(_read_points(shape, folder))
    elif shape.tag == "box":
        x, y, z = _read_row(shape, "size")
        body = _make_centred_body(x * y * z, (y * y + z * z, x * x + z * z, x * x + y * y), 12.0)
    elif shape.tag in ("cylinder", "capsule"):
        r, l = _read_row(shape, "radius", count=1)[0], _read_row(shape, "length", count=1)[0]  # noqa: E741
        across = 0.75 * r * r + 0.25 * l * l
        body = _make_centred_body(math.pi * r * r * l, (across, across, 1.5 * r * r), 3.0)
    elif shape.tag == "sphere":
        r = _read_row(shape, "radius", count=1)[0]
        body = _make_centred_body(4.0 / 3.0 * math.pi * r**3, (r * r,) * 3, 2.5)
    else:
        raise Refusal("new", "shape", "be known", shape.tag)
    return body.transform_to(at), "convex hull" if shape.tag == "mesh" else shape.tag


def _read_row(element: ET.Element, key: str, default: str = "", count: int = 3) -> list[float]:
    text = element.get(key, default)
    try:
        values = [float(word) for word in text.split()]
    except ValueError:
        values = []
    if len(values) != count or not all(map(math.isfinite, values)):
        raise Refusal("new", f"{element.tag} {key}", f"be {count} numbers", repr(text))
    return values


def _make_centred_body(volume: float, moments: Iterable[float], by: float) -> Body:
    inertia = np.diag([volume * moment / by for moment in moments])
    return Body(volume, np.zeros(3), inertia)


def _make_rod(end: Array, min_length: float) -> Body:
    """Return a cylinder from the origin to a point, along z where that is nearer than asked."""
    length = float(np.linalg.norm(end))
    if length < min_length:
        length, end = min_length, np.array([0.0, 0.0, min_length])
    r, u = SLENDER * length, end / length
    volume = math.pi * r * r * length
    along, across = 0.5 * r * r, 0.25 * r * r + length * length / 12.0
    inertia = volume * (across * np.eye(3) + (along - across) * np.outer(u, u))
    return Body.from_center(volume, 0.5 * end, inertia)


def _make_hull(points: Array) -> Body:
    """Return the convex hull of points, of 1 kg/m3: the sum of tetrahedra over its faces."""
    from scipy.spatial import ConvexHull, QhullError

    try:
        hull = ConvexHull(points)
    except (QhullError, ValueError):
        raise Refusal("new", "mesh", "span a volume", "flat") from None
    centre = points[hull.vertices].mean(axis=0)
    a, b, c = ((points - centre)[hull.simplices[:, k]] for k in range(3))
    volume = np.abs(np.einsum("ij,ij->i", a, np.cross(b, c))) / 6.0
    total = a + b + c
    # Second moments of a tetrahedron with a corner in the origin.
    second = sum(x[:, :, None] * x[:, None, :] for x in (a, b, c, total))
    S = (volume[:, None, None] * second).sum(axis=0) / 20.0
    h = (volume[:, None] * total).sum(axis=0) / 4.0
    inertia = np.trace(S) * np.eye(3) - S
    return Body(float(volume.sum()), h, inertia).transform_to(Frame(p=centre))


def _read_points(mesh: ET.Element, folder: Path) -> Array:
    """Return the corners of a mesh (K, 3) [m]."""
    import coal

    name, scale = mesh.get("filename", ""), np.array(_read_row(mesh, "scale", "1 1 1"))
    file = find_mesh(name, folder)
    if file is None:
        raise Refusal("new", f"mesh {name}", "be a file", "not found")
    if file.stat().st_size > MAX_MESH:
        raise Refusal("new", f"mesh {name}", f"have at most {MAX_MESH} bytes", "larger")
    try:
        points = coal.MeshLoader().load(str(file), read_mesh_unit(file) * scale).vertices()
    except (RuntimeError, ValueError, TypeError) as error:
        raise Refusal("new", f"mesh {name}", "be readable", f"not read ({error})") from None
    vertices: Array = np.unique(np.asarray(points, dtype=np.float64), axis=0)
    if not len(vertices) or not np.isfinite(vertices).all():
        raise Refusal("new", f"mesh {name}", "have points", "empty")
    return vertices


def make_inertial(body: Body, digits: int = 6) -> ET.Element:
    """Return the element <inertial> of a body given about its link's origin."""
    com = body.moment / body.mass
    offset = float(com @ com) * np.eye(3) - np.outer(com, com)
    tensor = body.inertia - body.mass * offset
    element = ET.Element("inertial")
    ET.SubElement(
        element, "origin", xyz=" ".join(f"{value:.{digits}g}" for value in com), rpy="0 0 0"
    )
    ET.SubElement(element, "mass", value=f"{body.mass:.{digits}g}")
    entries = (*np.diag(tensor), tensor[0, 1], tensor[0, 2], tensor[1, 2])
    keys = zip(_KEYS, entries, strict=True)
    ET.SubElement(element, "inertia", {key: f"{value:.{digits}g}" for key, value in keys})
    return element
