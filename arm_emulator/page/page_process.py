"""A running machine with a page: its rows go to a process of its own, so that no tick is late."""

import contextlib
import threading
from collections.abc import Callable
from typing import Self

from arm_emulator.base.packages import find_page_entry
from arm_emulator.base.refusal import Refusal
from arm_emulator.machine.plant.plant import Plant
from arm_emulator.page.controls import Controls
from arm_emulator.runs.row_process import RowProcess, dismiss_all

PATIENCE = 4.0  # s, wall: for the end of the page


def wait_for_ctrl_c() -> None:
    """Let browsers look at a run that has ended, until Ctrl-C."""
    print("page: until Ctrl-C", flush=True)
    with contextlib.suppress(KeyboardInterrupt):
        threading.Event().wait()


class PageProcess:
    """A plant that browsers watch from now on; use it in a `with` block.

    Attributes:
        url: of the page, with its token; empty: no page.

    Args:
        plant: the machine.
        at: [HOST:]PORT of the page, see `PageServer`; None: no page.
        hands: makes the actions on the machine, in the page's process. It is pickled.
        files: descriptors that `hands` needs there.
        waits: whether the machine waits for the page, as a run without a network may; else rows
            that find no room are dropped and counted.

    Raises:
        Refusal: the package of the page or viser is missing, or the port is taken.
    """

    def __init__(
        self,
        plant: Plant,
        at: str | int | None,
        controls: Callable[[], Controls] = Controls,
        files: tuple[int, ...] = (),
        waits: bool = False,
    ) -> None:
        self._process: RowProcess | None = None
        self.url = ""
        if at is None:
            return
        task = {
            "scene": plant.scene,
            "at": at,
            "hands": controls,
            "varied": dict(plant.parameters),
        }
        module = find_page_entry("live").module
        self._process = RowProcess(
            plant, module, task, "page", waits=waits, patience=PATIENCE, files=files
        )
        self.url = str(self._process.ready)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: object, error: object, trace: object) -> None:
        if kind is not None and self._process is not None:
            dismiss_all(self._process.plant)  # a recorder writes its end while the page ends
        self.close()

    def show_machine(self) -> None:
        """Show the machine as it is now, after a change by hand."""
        if self._process is not None:
            self._process.take_row()

    @property
    def trouble(self) -> str:
        """End of the page before the machine, in words; empty if it is served, or never was."""
        return "" if self._process is None else self._process.trouble

    def close(self) -> None:
        """End the page.

        Raises:
            Refusal: it had ended before.
        """
        process, self._process = self._process, None
        if process is not None and isinstance(answer := process.close(), Refusal):
            raise answer
