"""Motion of the motors of an arm with elastic gears for a given motion of its links.

A joint with an elastic gear is differentially flat: its link's motion gives that of its motor. All
quantities at the link; theta is the motor's angle times the ratio, w = theta - q the wind-up.

    T     = tau(q, v, a) + friction(v)           what the gear carries, inverse dynamics
    T     = K w + K3 w^3 + D w'                  so w, and with T' the motor's speed v + w'
    tau_m = T + J theta'' + friction_m(theta')   what the motor gives, J = rotor inertia / ratio^2

T' follows from the link's jerk, by the derivatives of the inverse dynamics; T'' from its snap. The
last is not needed: J theta'' is the servo's, from the motor's speeds of one period and the next.

The damper makes w lag T by D / K, some 0.1 to 1 ms: taken in first order, what is left out is of
the size (D / K)^2 w''.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from arm_emulator.base.arrays import Array
from arm_emulator.motion.model.drive_parameters import DriveParameters, read_column
from arm_emulator.motion.model.link_torques import LinkTorques

# Share of the speed limit over which Coulomb friction grows from 0, without a step at the start.
SMOOTH = 2e-3
_UNKNOWN_LIMIT = 1.0  # rad/s or m/s, where a joint has no limit of speed


@dataclass(frozen=True, eq=False)
class Drive:
    """Motion of an arm's motors at an instant, (N,) each, referred to the links."""

    theta: Array
    """Angles of the motors times their ratios [rad]."""
    omega: Array
    """Speeds likewise [rad/s]."""
    torque: Array
    """Torques that the gears carry [N m]."""
    torque_rate: Array
    """Rates of change of these torques [N m/s]."""


class ElasticArm:
    """Links, gears and rotors of an arm.

    Args:
        links: inverse dynamics.
        drives: in the same order of joints.
        velocity_limit: of the joints (N,) [rad/s]; infinite: not limited.
    """

    def __init__(
        self, links: LinkTorques, drives: Sequence[DriveParameters], velocity_limit: Array
    ) -> None:
        self._links = links
        stiffness = read_column(drives, "stiffness")
        self.softness = 1.0 / stiffness
        """Wind-up per small torque (N,) [rad/(N m)]; 0: rigid."""
        self._cubic = read_column(drives, "cubic_stiffness") * np.isfinite(stiffness)
        self._damping = read_column(drives, "damping") * np.isfinite(stiffness)
        self._of_link = read_column(drives, "viscous"), read_column(drives, "coulomb")
        self._of_rotor = read_column(drives, "rotor_viscous"), read_column(drives, "rotor_coulomb")
        limit = np.where(np.isfinite(velocity_limit), velocity_limit, _UNKNOWN_LIMIT)
        self._smooth = SMOOTH * limit
        self.dry = self._of_link[1] + self._of_rotor[1]
        """Dry friction of links and rotors (N,) [N m]."""

    def compute_drive(
        self,
        q: Array,
        v: Array,
        a: Array,
        jerk: Array,
        factor: Array | float = 1.0,
    ) -> Drive:
        """Return the motors' motion for a motion of the links, (N,) each [rad, s].

        `factor` multiplies the torques that the links need by their description (N,).
        """
        torque, rate = self._links.compute_rates(q, v, a, jerk)
        friction, slope = self._compute_friction(self._of_link, v)
        torque, rate = factor * torque + friction, factor * rate + slope * a
        softness = self._compute_slope(self.compute_wind_up(torque))
        wind_up = self.compute_wind_up(torque - self._damping * rate * softness)
        return Drive(q + wind_up, v + rate * self._compute_slope(wind_up), torque, rate)

    def compute_mean_torques(self, begins: Drive, ends: Drive, period: float) -> Array:
        """Return the mean torques of gears and rotors' friction in a period, (N,) [N m].

        The gears' part is the integral of the cubic through torques and rates at both ends.
        """
        gear = 0.5 * (begins.torque + ends.torque)
        gear += period / 12.0 * (begins.torque_rate - ends.torque_rate)
        omega = 0.5 * (begins.omega + ends.omega)
        return gear + self._compute_friction(self._of_rotor, omega)[0]

    def compute_sliding_share(self, v: Array) -> Array:
        """Return the share of dry friction that acts at speeds v (N,), 0 to 1."""
        return np.asarray(np.abs(v) / np.hypot(v, self._smooth))

    def compute_weight(self, q: Array) -> Array:
        """Return the torques that the gears carry at rest (N,) [N m]."""
        return self._links.compute_torques(q, np.zeros_like(q))

    def compute_wind_up(self, torque: Array) -> Array:
        """Return the wind-up of the gears under torques at rest, (N,) [rad]."""
        linear = torque * self.softness
        cubic = self._cubic * self.softness
        bent = cubic > 0.0
        if not bent.any():
            return linear
        # K w + K3 w^3 = T is 4 s^3 + 3 s = sinh(3 x), with s = sinh(x): its only real root.
        scale = np.sqrt(4.0 / (3.0 * np.where(bent, cubic, 1.0)))
        return np.where(bent, scale * np.sinh(np.arcsinh(3.0 * linear / scale) / 3.0), linear)

    def _compute_slope(self, wind_up: Array) -> Array:
        """Return wind-up per torque at a wind-up (N,) [rad/(N m)]."""
        return self.softness / (1.0 + 3.0 * self._cubic * self.softness * wind_up**2)

    def _compute_friction(self, law: tuple[Array, Array], v: Array) -> tuple[Array, Array]:
        """Return friction at speeds v (N,), and its derivative."""
        viscous, coulomb = law
        root = np.hypot(v, self._smooth)
        return viscous * v + coulomb * v / root, viscous + coulomb * self._smooth**2 / root**3
