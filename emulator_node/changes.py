"""Changes of the machine by hand, between two ticks, published so that a run can be repeated."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager

from arm_emulator.machine.session.session import Session
from arm_emulator.page.page_process import PageProcess
from emulator_node.breakpoints import Breakpoints
from emulator_node.pacer import Pacer
from emulator_node.reports import Reports


class Changes:
    """Changes the machine of a session.

    Attributes:
        pacer: publishes the ticks before a change.
        reports: publishes the change.

    Args:
        page: shows the change on a page.
        breaks: may stop there.
    """

    def __init__(
        self,
        session: Session,
        pacer: Pacer,
        reports: Reports,
        page: PageProcess,
        breaks: Breakpoints,
    ) -> None:
        self._session, self.pacer, self.reports = session, pacer, reports
        self._page, self._breaks = page, breaks

    @contextmanager
    def pause_between_ticks(self) -> Iterator[None]:
        """In this block no time passes, and all ticks up to now are published."""
        with self._session.between_ticks():
            self.pacer.catch_up()
            try:
                yield
            finally:
                self.pacer.note_change()

    def make_change(self, kind: int, change: Callable[[], None]) -> None:
        """Change the machine, and publish the data for repeating the change.

        Args:
            kind: of MachineEvent.
            change: makes the change; if it raises, nothing is published.
        """
        with self.pause_between_ticks():
            change()
            saved = self._session.plant.save()
            self._page.show_machine()
            self.reports.publish_event(kind, saved)
            self._breaks.note_change()

    def put_change(self, kind: int, change: Callable[[], None]) -> None:
        """Change the machine, publish its new state, and continue from there, see `make_change`."""
        with self.pause_between_ticks():
            self.make_change(kind, change)
            self.reports.publish_change()
        if self._session.is_answered:
            self.pacer.go_on()
