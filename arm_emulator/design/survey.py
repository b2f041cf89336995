"""A look at an arm over its poses: what the links ask of each joint, and where to start."""

from dataclasses import dataclass

import numpy as np

from arm_emulator.analysis.holding import LinkLoads
from arm_emulator.analysis.servo_loop import FREE_SLIDE, FREE_TURN
from arm_emulator.base.arrays import Array
from arm_emulator.machine.scene.scene import Scene
from arm_emulator.motion.collision.collisions import Collisions
from arm_emulator.motion.model.kinematics import POSE_ROWS, Kinematics

POSES = 400
MIDDLE = 0.7  # of a joint's range: where a start is looked for
FARTHEST_START = 1.6  # rad or m from 0, or from the limit next to 0
DEMO_PART = 0.05  # of the arm's reach: how far a demo moves the tool


@dataclass(frozen=True, eq=False)
class Survey:
    """Results of the survey. N joints, in the scene's order."""

    inertia: Array
    """Least and most that a joint feels over the poses, (N, 2) [kg m2 or kg].

    Least with all other joints free, most with all others held.
    """
    coupling: Array
    """Most of |M| over the poses, (N, N): what a joint feels of the others' acceleration."""
    gravity_torque: Array
    """Most that the links' weight asks for over the poses, (N,) [N m or N]."""
    start: Array
    """A bent pose away from limits and singular poses, (N,) [rad or m]."""
    displacement: Array
    """Displacement of the tool from the start, within reach, (3,) [m]."""


def inspect_arm(scene: Scene, kinematics: Kinematics, shapes: Collisions | None = None) -> Survey:
    """Look at an arm in many poses within its limits, drawn always the same.

    Args:
        scene: the links.
        kinematics: of the arm.
        shapes: of the arm, of which no two touch at the start if there is such a start; None:
            not known.
    """
    low, high = _choose_ranges(scene, kinematics)
    rng = np.random.default_rng(0)
    N = len(low)
    poses = low + (high - low) * rng.random((POSES, N))
    loads = LinkLoads(scene)
    smallest, coupling = np.full(N, np.inf), np.zeros((N, N))
    weight = np.zeros(N)
    for q in poses:
        M = loads.compute_mass_matrix(q)
        smallest = np.minimum(smallest, 1.0 / np.diag(np.linalg.inv(M)))
        coupling = np.maximum(coupling, np.abs(M))
        weight = np.maximum(weight, np.abs(loads.compute_weight(q)))
    start = _choose_start(kinematics, low, high, rng, shapes)
    inertia = np.stack([smallest, np.diag(coupling)], axis=1)
    displacement = _choose_displacement(kinematics, start, low, high)
    return Survey(inertia, coupling, weight, start, displacement)


def _choose_ranges(scene: Scene, kinematics: Kinematics) -> tuple[Array, Array]:
    """Return lower and upper ends of the poses to look at, (N,) each."""
    free = np.array(
        [FREE_SLIDE if joint.kind == "prismatic" else FREE_TURN for joint in scene.chain.joints]
    )
    low, high = kinematics.lower, kinematics.upper
    # Of a wide or open range the part next to 0 is looked at.
    bottom = np.where(high < -free, high - 2.0 * free, np.maximum(low, -free))
    top = np.where(low > free, low + 2.0 * free, np.minimum(high, free))
    return np.minimum(np.maximum(bottom, low), high), np.maximum(np.minimum(top, high), low)


def _choose_start(
    kinematics: Kinematics,
    low: Array,
    high: Array,
    rng: np.random.Generator,
    shapes: Collisions | None,
) -> Array:
    """Return the pose in the middle of the ranges whose smallest singular value is largest.

    Of those in which no parts touch; of all where parts touch in each.
    """
    middle, half = 0.5 * (low + high), 0.5 * MIDDLE * (high - low)
    nearest = np.clip(0.0, low, high)
    bottom = np.clip(middle - half, nearest - FARTHEST_START, nearest + FARTHEST_START)
    top = np.clip(middle + half, nearest - FARTHEST_START, nearest + FARTHEST_START)
    poses = bottom + (top - bottom) * rng.random((POSES, len(low)))
    poses = np.round(poses, 3)
    dexterity = np.array([kinematics.singular_values(q)[-1] for q in poses])
    best = poses[np.argsort(-dexterity, kind="stable")]
    free = (q for q in best if shapes is None or not shapes.find_first_contact(q))
    return np.asarray(next(free, best[0]), dtype=np.float64)


def _choose_displacement(kinematics: Kinematics, start: Array, low: Array, high: Array) -> Array:
    """Return a short way of the tool that the arm can go.

    An arm of six joints and more can go any short way; of one with fewer a joint motion decides.
    """
    distance = DEMO_PART * kinematics.reach
    J = kinematics.jacobian(start)
    U, s, Vt = np.linalg.svd(J[:3])
    if len(start) >= POSE_ROWS:
        displacement = distance * U[:, 0]
    else:
        step = Vt[0] * min(distance / max(float(s[0]), 1e-9), 0.2)
        q = np.clip(start + step, low, high)
        displacement = kinematics.forward(q)[1] - kinematics.forward(start)[1]
    return np.asarray(np.round(displacement, 4) + 0.0, dtype=np.float64)
