"""The current loops of a synchronous motor's drive."""

from arm_emulator.machine.parts.drive_stages.current_loop import CurrentLoop
from arm_emulator.machine.parts.input import CURRENT, Input
from arm_emulator.machine.parts.registry import register_part


@register_part
class FieldOrientedLoop(CurrentLoop):
    """A PI controller for each axis of the rotor: commands are the currents of both.

    Its proportional gain is that of the current across the flux; along it, it goes with the
    inductance.
    """

    inputs = (
        CURRENT,
        Input("command_d", "current along each rotor's flux", "A", applied="applied_d"),
    )
    header = "drive_stages/field_oriented_loop.hpp"
    loop = "FieldOrientedLoop"
    around_kind = "pmsm"
