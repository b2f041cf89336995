"""Kinematics of a robot description, limits of its joints, links that may touch."""

from arm_emulator.motion.collision.link_pairs import DRAWN as DRAWN_CONFIGURATIONS
from arm_emulator.motion.collision.link_pairs import link_pairs
from arm_emulator.motion.model.kinematics import Kinematics
from arm_emulator.motion.model.pinocchio_model import rate_limits

__all__ = [
    "DRAWN_CONFIGURATIONS",
    "Kinematics",
    "link_pairs",
    "rate_limits",
]
