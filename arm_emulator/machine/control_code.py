"""Control code in C as a step of `arm_emulator.machine.firmware_loop`."""

from __future__ import annotations

import contextlib
import ctypes

from arm_emulator.machine.plant import Plant


class ControlCode:
    """Whoever gives the commands of a run. What is written here holds where no more is to be done.

    Attributes:
        name: for refusals.
        step: address of the function that core/boundary/firmware_loop.h calls in every period.
        with_: address that it gets.
        stop: address of a number that is not 0 after a step that ends the run.
        struct: a `firmware_loop.LoopStruct` where others can see the tick.
    """

    name: str
    step: int | None
    with_: int | None
    stop: int | None = None
    struct: ctypes.Structure | None = None

    @property
    def ended(self) -> Exception | None:
        """Why it cannot go on; None: it can."""
        return None

    def start(self, plant: Plant, period_ns: int) -> None:
        """Take a machine, before the first step.

        Raises:
            Refusal: it does not take this one.
        """

    def stepping(self) -> contextlib.AbstractContextManager[None]:
        """Within, the loop is in its steps."""
        return contextlib.nullcontext()

    def close(self) -> None:
        """End; no step may come after."""
