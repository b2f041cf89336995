"""Motor commands in the form that Python has taken, described to C (c/motor_commands.h)."""

from __future__ import annotations

import numpy as np

from arm_emulator.base.bound import COMMAND
from arm_emulator.build.c_header import CData
from arm_emulator.machine.scene import Scene
from arm_emulator.ros.doubles import started
from arm_emulator.ros.fixed_layout import FixedLayout, Taking
from arm_emulator.ros.middleware import pattern_of
from emulator_node.c import MOTOR_COMMANDS


class KnownCommands:
    """The form of the newest commands.

    Args:
        scene: the machine.
        taking: takes them in Python.
        struct: ``motor_commands *`` that describes them to C.
        number: of their topic in the log of C.
    """

    def __init__(self, scene: Scene, taking: Taking, struct: CData, number: int) -> None:
        N = len(scene.joints)
        self._joint_names, self._taking, self._struct = scene.joint_names, taking, struct
        self._layout: FixedLayout | None = None  # that C knows
        self._keep: list[object] = []
        self._place = np.zeros(N, np.int64)
        self._most = np.full(N, float(COMMAND.most))
        self._came = np.zeros(N)
        MOTOR_COMMANDS.fill(
            struct,
            joints=N,
            place=self._place,
            most=self._most,
            came=self._came,
            emulator=started(),
            number=number,
        )

    def known(self) -> bool:
        """Describe the newest form; return whether C can take commands."""
        layout, struct = self._taking.layout, self._struct
        if layout is not self._layout:
            self._layout, self._keep = layout, []
            assert layout is not None
            names, known = layout.message.joint_names, self._joint_names
            fits = sorted(names) == sorted(known) and not len(layout.message.inputs)
            fits = fits and len(layout.message.command) == len(known)
            struct.pattern = pattern_of(layout, self._keep)[0]
            struct.pattern.size *= fits
            if fits:
                self._place[:] = [known.index(name) for name in names]
                places = layout.places
                struct.tick_at, struct.machine_at = places["tick"], places["machine"]
                struct.command_at = places["command"]
        return bool(struct.pattern.size)
