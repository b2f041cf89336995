"""Control code in C as a controller of `arm_emulator.machine.session.firmware_loop`."""

import contextlib
from typing import Any

from arm_emulator.base.refusal import Refusal
from arm_emulator.machine.plant.plant import Plant
from arm_emulator.toolchain.c_header import NULL, CData


class ControlCode:
    """Source of the commands of a run. These are the defaults.

    Attributes:
        name: for refusals.
        step: the function that tick/c/firmware_controller.h calls in every period.
        with_: pointer that it gets.
        stop: where a number lies that is not 0 after a step that ends the run; NULL: nowhere.
        struct: a ``firmware_controller`` where others can see the tick.
    """

    name: str
    step: CData
    with_: CData
    stop: CData = NULL
    struct: CData | None = None

    @property
    def ended(self) -> Exception | None:
        """Reason for which it cannot continue; None: it can."""
        return None

    def start_on(self, plant: Plant, period_ns: int) -> None:
        """Take a machine, before the first step.

        Raises:
            Refusal: it does not take this one.
        """

    def save(self) -> Any:
        """Return all that decides how the code goes on, for `restore`; it has a length [B].

        Raises:
            Refusal: it cannot be known.
        """
        rule = "be one that can be saved"
        raise Refusal(self.name, "control code", rule, type(self).__name__)

    def restore(self, saved: Any) -> None:
        """Go on from what `save` of this code has returned."""

    def mark_steps(self) -> contextlib.AbstractContextManager[None]:
        """Context in which the loop runs its steps."""
        return contextlib.nullcontext()

    def close(self) -> None:
        """End; no step may follow."""
