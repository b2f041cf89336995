"""Inertias of physical bodies: mass, centre and tensor by ten unconstrained numbers.

The pseudo-inertia matrix of a body is positive definite, and so U U' with an upper triangle U; its
logarithms and lengths may be any numbers (C. Rucker and P. M. Wensing, IEEE Robotics and Automation
Letters 7, 2022: log-Cholesky parameters). Pinocchio has the map and its derivative.
"""

import numpy as np
import pinocchio as pin

from arm_emulator.extension.base import Array
from arm_emulator.extension.machine import Body

NUMBERS = 10
THIN = 1e-6  # of a body's second moments: assumed for a thin or massless one


def list_dynamic(body: Body) -> Array:
    """Return the ten numbers in which torques are linear: m, m c, and xx xy yy xz yz zz."""
    I = body.inertia  # noqa: E741
    tensor = I[0, 0], I[0, 1], I[1, 1], I[0, 2], I[1, 2], I[2, 2]
    return np.array([body.mass, *body.moment, *tensor])


def make_body(numbers: Array) -> Body:
    """Return the body of ten numbers as `list_dynamic` gives them."""
    xx, xy, yy, xz, yz, zz = numbers[4:]
    inertia = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    return Body(float(numbers[0]), np.array(numbers[1:4]), inertia)


def is_body(body: Body) -> bool:
    """Whether such a body is possible, even a thin one. Models reduced by hand contain others."""
    P = _make_pseudo_inertia(body)
    size = 1.0 / np.sqrt(np.maximum(np.diag(P), 1e-300))
    return bool(np.linalg.eigvalsh(P * size[:, None] * size[None, :]).min() > -0.5 * THIN)


def make_ball(body: Body) -> Body:
    """Return a ball in place of an impossible body."""
    return Body(max(body.mass, 1e-6), np.zeros(3), max(np.trace(body.inertia), 1e-9) * np.eye(3))


def _make_pseudo_inertia(body: Body) -> Array:
    second = 0.5 * np.trace(body.inertia) * np.eye(3) - body.inertia
    return np.block([[second, body.moment[:, None]], [body.moment[None, :], body.mass]])


def map_logarithm(body: Body) -> Array:
    """Return the ten numbers whose exponential map is that body, or one less thin."""
    P = _make_pseudo_inertia(body)
    second = P[:3, :3]
    size = max(float(np.trace(second)), 1e-12)
    P += np.diag([THIN * size] * 3 + [THIN * max(body.mass, 1e-12)])
    # Upper triangle: the lower one of the reversed matrix.
    U = np.linalg.cholesky(P[::-1, ::-1])[::-1, ::-1]
    alpha, U = np.log(U[3, 3]), U / U[3, 3]
    d = np.log(np.diag(U)[:3])
    return np.array([alpha, *d, U[0, 1], U[1, 2], U[0, 2], *U[:3, 3]])


def estimate_widths(body: Body, trust: float) -> Array:
    """Return the deviations of the ten numbers, for figures with the relative accuracy `trust`."""
    length = np.sqrt(max(0.5 * np.trace(body.inertia), 1e-12) / max(body.mass, 1e-12))
    return trust * np.array([0.5, 1.0, 1.0, 1.0, *(6 * [length])])


def map_exponential(numbers: Array) -> Array:
    """Return the numbers of `list_dynamic` (10,)."""
    parameters: Array = pin.LogCholeskyParameters(numbers).toDynamicParameters()
    return parameters


def differentiate_exponential(numbers: Array) -> Array:
    """Return the derivative of `map_exponential` (10, 10)."""
    jacobian: Array = pin.LogCholeskyParameters(numbers).calculateJacobian()
    return jacobian
