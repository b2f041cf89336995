"""The tool's position in the world, in C, for many joint positions in one call."""

from collections.abc import Mapping

import numpy as np

from arm_emulator.base.arrays import Array
from arm_emulator.machine.plant.formula_rows import TOOL_POSITION, formula_library
from arm_emulator.machine.scene.scene import Scene
from arm_emulator.machine.varied_places import displace_joint
from arm_emulator.toolchain.c_header import make_pointer

TOOL = ("tool.x", "tool.y", "tool.z")  # position in the world [m]


def list_tool_signals(scene: Scene) -> tuple[str, ...]:
    """Return the names of the tool's coordinates.

    None where no joint carries the tool, or where bearings give way, which joints do not show.
    """
    return TOOL if scene.tool in scene.chain.carried and not scene.chain.deflections else ()


class ToolChain:
    """The joints between base and tool, see core/boundary/tool_position.h.

    Attributes:
        struct: ``tool_chain``.

    Args:
        scene: whose tool a joint carries.
        values: of varied numbers, by their name; others are the scene's.

    Raises:
        Refusal: bearings give way.
    """

    def __init__(self, scene: Scene, values: Mapping[str, float] | None = None) -> None:
        scene.refuse_bearings("the position of the tool by those of the joints")
        chain = scene.chain
        last, frame = chain.place_of(scene.tool)
        path = chain.find_path(last)[::-1]
        self._shares = np.ascontiguousarray(chain.coupling.C[path])
        self._joints = TOOL_POSITION.make_rows("tool_joint", len(path))
        first, stride = self._shares.__array_interface__["data"][0], self._shares.strides[0]
        for place, (row, number) in enumerate(zip(self._joints, path, strict=True)):
            link = displace_joint(chain.links[number], scene.calibration, values or {})
            row["share"] = first + place * stride
            row["q_0"] = chain.coupling.offset[number]
            for name in ("theta_0", "cos_alpha", "sin_alpha", "cos_gamma", "sin_gamma", "p"):
                row[name] = getattr(link, name)
            row["slides"] = link.kind == "prismatic"
        self.struct = TOOL_POSITION.make_struct(
            "tool_chain",
            joints=len(path),
            joint=self._joints,
            drives=self._shares.shape[1],
            p=frame.p.tolist(),
            R=chain.R_BW.T.ravel().tolist(),
        )

    def compute_positions(self, q: Array) -> Array:
        """Return p_WT (3, K) [m] for joint positions (N, K) [rad or m]."""
        q = np.ascontiguousarray(q, np.float64)
        p_WT = np.empty((3, q.shape[1]))
        if p_WT.size:
            places = make_pointer(q), q.shape[1], q.shape[1], make_pointer(p_WT)
            formula_library().tool_positions(self.struct, *places)
        return p_WT
