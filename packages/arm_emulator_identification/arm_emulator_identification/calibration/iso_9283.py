"""Pose accuracy and repeatability of manipulating robots, ISO 9283:1998, clauses 6 and 7.2.

In a cube of the workspace five poses lie on a diagonal plane: its centre, and four on the
diagonals, a tenth of their length before their ends. The arm visits them in turn, 30 times.
"""

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from arm_emulator.extension.base import Array

EDGES = (1.0, 0.63, 0.4, 0.25, 0.16, 0.1)  # m; those below 0.25 for arms smaller than the norm's
INWARD = 0.8  # of half a diagonal, so that 10 % of it are left at each end
# Corners of the plane, which contains the y axis: P2 to P5.
_CORNERS = ((1.0, 1.0, 1.0), (1.0, -1.0, 1.0), (-1.0, -1.0, -1.0), (-1.0, 1.0, -1.0))
DIRECTED = (0, 1, 3)  # P1, P2 and P4 are approached from several directions


def place_poses(centre: Array, edge: float) -> Array:
    """Return the positions P1 to P5 (5, 3) [m] in a cube.

    Args:
        centre: of the cube (3,) [m].
        edge: of the cube [m].
    """
    corners = np.array(((0.0, 0.0, 0.0), *_CORNERS))
    return np.asarray(centre + 0.5 * INWARD * edge * corners)


@dataclass(frozen=True)
class PoseCharacteristics:
    """Characteristics of one pose by ISO 9283; orientations where they are controlled."""

    AP: float  # pose accuracy: from the command to the barycentre of the attained positions [m]
    RP: float  # pose repeatability: mean plus 3 standard deviations of distances from it [m]
    AP_abc: tuple[float, float, float]  # the same of the orientation, about x, y, z [rad]
    RP_abc: tuple[float, float, float]  # 3 standard deviations of it [rad]


def judge_pose(
    command: tuple[Array, Array], positions: Array, orientations: Array
) -> PoseCharacteristics:
    """Return the characteristics of a pose.

    Args:
        command: orientation (3, 3) and position (3,) [m] commanded.
        positions: attained, a row per cycle (K, 3) [m].
        orientations: attained (K, 3, 3).
    """
    R, p = command
    barycentre = positions.mean(axis=0)
    distances = np.linalg.norm(positions - barycentre, axis=1)
    rotations = Rotation.from_matrix(orientations @ R.T).as_rotvec()
    deviation = _compute_deviation(distances)
    return PoseCharacteristics(
        AP=float(np.linalg.norm(barycentre - p)),
        RP=float(distances.mean() + 3.0 * deviation),
        AP_abc=_convert_to_triple(rotations.mean(axis=0)),
        RP_abc=_convert_to_triple([3.0 * _compute_deviation(column) for column in rotations.T]),
    )


def compute_direction_deviation(positions: list[Array]) -> float:
    """Return vAP [m]: the largest distance of barycentres of a pose that differ by the approach.

    Args:
        positions: attained from each direction (K, 3) [m].
    """
    centres = [cluster.mean(axis=0) for cluster in positions]
    return max(float(np.linalg.norm(a - b)) for a in centres for b in centres)


def _compute_deviation(values: Array) -> float:
    return float(np.std(values, ddof=1)) if len(values) > 1 else 0.0


def _convert_to_triple(values: object) -> tuple[float, float, float]:
    x, y, z = map(float, np.asarray(values))
    return x, y, z
