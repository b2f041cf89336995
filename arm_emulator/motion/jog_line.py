"""Line along which a jogged tool goes while its twist keeps its direction.

Joint speeds that grow together lead a tool aside while they grow, and a twist alone has no place to
come back to. The line begins where the tool rests, or where it goes along the twist. It shifts with
the tool along the twist: how far the tool has come is the lever's business.
"""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from arm_emulator.motion.instruction import FloatArray
from arm_emulator.motion.kinematics import POSE_ROWS, POSITION_ROWS, Kinematics
from arm_emulator.motion.pose import Pose

GAIN = 15.0  # 1/s, of the distance from the line
MOST = 0.3  # of the twist, that leads back at most
_SAME = 0.9998  # cosine: 1 degree
_ALONG = 0.02  # of the twist, that may lead aside where a line begins


class JogLine:
    """The line of one arm's jog.

    Args:
        kinematics: of the arm.
    """

    def __init__(self, kinematics: Kinematics) -> None:
        self._kinematics = kinematics
        self._command: FloatArray = np.zeros(POSE_ROWS)
        self._place: Pose | None = None

    def leave(self) -> None:
        """Forget the line."""
        self._place = None

    def back(
        self, q: FloatArray, v: FloatArray, command: FloatArray, twist: FloatArray
    ) -> FloatArray:
        """Return the twist that leads the tool back to its line (6,) [m/s, rad/s].

        Args:
            q: joint angles (N,).
            v: joint speeds (N,).
            command: twist as commanded (6,), which keeps its direction in the frame of the command.
            twist: the same along the world's axes (6,).
        """
        kinematics, rows = self._kinematics, self._kinematics.rows
        scale, back = kinematics.scale, np.zeros(POSE_ROWS)
        wanted = scale * twist[:rows]
        size = float(np.linalg.norm(wanted))
        if size == 0.0 or not self._goes_on(command):
            self.leave()
        self._command = command
        if size == 0.0:
            return back
        if self._place is None:
            tool = scale * (kinematics.jacobian(q) @ v)
            if np.linalg.norm(_aside(tool, wanted)) <= _ALONG * size:
                R_WT, p_WT = kinematics.forward(q)
                self._place = Pose(p_WT, R_WT)
            return back
        off = scale * kinematics.tool_error(q, self._place)
        passed = -float(off @ wanted) / size**2
        self._place = Pose(
            self._place.p_WT + passed * twist[:POSITION_ROWS],
            pin.exp3(passed * twist[POSITION_ROWS:]) @ self._place.R_WT,
        )
        aside = GAIN * _aside(off, wanted)
        much = float(np.linalg.norm(aside)) / (MOST * size)
        back[:rows] = aside / scale / max(1.0, much)
        return back

    def _goes_on(self, command: FloatArray) -> bool:
        norms = float(np.linalg.norm(command) * np.linalg.norm(self._command))
        return float(command @ self._command) >= _SAME * norms > 0.0


def _aside(one: FloatArray, along: FloatArray) -> FloatArray:
    """Return the part of a vector across another."""
    across: FloatArray = one - along * float(one @ along) / float(along @ along)
    return across
