"""The whole machine as a linear system about rest in a pose."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from arm_emulator.analysis.stability import SmallMotions
from arm_emulator.machine.chain import Array
from arm_emulator.machine.plant import Plant
from arm_emulator.machine.plant_state import start_bounds


@dataclass(frozen=True)
class LinearMachine:
    """dx/dt = A x + B u about rest; x are the states of the drives, then q and v of the links.

    Coulomb friction and current limits are left out. Constant torques on the links hold them.

    Attributes:
        A: (n, n).
        B: (n, N), per unit of each joint's command.
        theta_m: motor angles by x, (N, n).
        current: motor currents by x, (N, n).
        q, v: places of the links' positions and speeds in x.
    """

    A: Array
    B: Array
    theta_m: Array
    current: Array
    q: slice
    v: slice


def linearise(plant: Plant, q: ArrayLike | None = None) -> LinearMachine:
    """Return what a plant is for small motions about rest.

    Args:
        plant: the machine; its state stays as it is.
        q: the pose (N,) [rad or m]; where its links are if None.

    Raises:
        Refusal: no such pose.
    """
    N = len(plant.scene.joints)
    at = plant.state.q if q is None else start_bounds(plant.scene)[0].row("linearise", q, N)
    motions = SmallMotions(plant, np.array(at))
    first = motions.links
    return LinearMachine(
        motions.J,
        motions.B,
        motions.theta_m,
        motions.current,
        slice(first, first + N),
        slice(first + N, first + 2 * N),
    )
