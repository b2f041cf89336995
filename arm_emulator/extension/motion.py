"""Kinematics of a robot description, limits of its joints, links that may touch."""

from arm_emulator.motion.collision.link_pairs import SAMPLES as DRAWN_CONFIGURATIONS
from arm_emulator.motion.collision.link_pairs import find_link_pairs
from arm_emulator.motion.model.kinematics import Kinematics
from arm_emulator.motion.model.pinocchio_model import read_rate_limits
