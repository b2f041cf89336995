"""Bounds of quantities of joints and of the tool that come from outside.

A joint at 1e308 rad is a mistake of its sender, and computations with it overflow. Every number is
therefore compared with a bound once, at its input. The bounds are far beyond every machine, and
all results computed within them are finite.
"""

import math

import numpy as np
import numpy.typing as npt

from arm_emulator.base.validation.number import Number

# Commands to a joint and measurements of it; m instead of rad for a prismatic joint.
POSITION = Number.bound_size("position", "rad", 1e6)
VELOCITY = Number.bound_size("velocity", "rad/s", 1e6)
ACCELERATION = Number.bound_size("acceleration", "rad/s2", 1e9)
EFFORT = Number.bound_size("effort", "N m", 1e9)
COMMAND = Number.bound_size("command", "V, N m or A", 1e9)
CURRENT = Number.bound_size("current", "A", 1e9)
BRAKE_CLOSED = Number.bound_size("brake_closed", "", 1.0)
# Commands within one process, of any size: drives limit them.
ANY_COMMAND = Number.bound_size("command", "V, N m or A", math.inf)
ANY_STATE = Number.bound_size("x", "", math.inf)
ANY_COMMANDS = ANY_COMMAND.rename("commands")
# An external force on a link, and its point of application.
FORCE = Number.bound_size("force", "N", 1e6)
MOMENT = Number.bound_size("moment", "N m", 1e6)
POINT = Number.bound_size("point", "m", 1e3)
# Target of the tool, in the world.
TOOL_POSITION = Number.bound_size("position", "m", 1e6)

# Beyond this, half a count is lost in rounding.
LARGEST_COUNT = 2.0**52


def bound_encoder_counts(count_angle: npt.ArrayLike) -> Number:
    """Return the bound of encoder counts: that of the joint's position.

    Args:
        count_angle: link angle of one count, per joint (N,) [rad or m].
    """
    with np.errstate(over="ignore", divide="ignore"):
        counts = np.floor(POSITION.most / np.abs(np.asarray(count_angle, dtype=np.float64)))
    # One less: the position is taken as the middle of the count.
    return Number.bound_size("encoder_counts", "", np.minimum(LARGEST_COUNT, counts) - 1.0)
