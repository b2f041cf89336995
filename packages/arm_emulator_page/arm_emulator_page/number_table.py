"""Numbers of joints as tables of Markdown, and events as a list."""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from arm_emulator.extension.base import escape_markdown

# Headings with units, for joints that turn; those of slides are in the line above the table.
SLIDES = "slides: q in m, v in m/s, gear in N; command: as the motor takes it"
DECIMALS = 4


def format_numbers(names: Sequence[str], columns: dict[str, Any]) -> str:
    """Return columns (N,) by their headings as a table, a line per joint."""
    lines = ["| | " + " | ".join(columns) + " |", "|---" * (len(columns) + 1) + "|"]
    for j, name in enumerate(names):
        cells = (_format_cell(np.asarray(value)[j]) for value in columns.values())
        lines.append(f"| {escape_markdown(name)} | " + " | ".join(cells) + " |")
    return "\n".join(lines)


def format_machine(
    names: Sequence[str], q: Any, v: Any, gear: Any, current: Any, command: Any, counts: Any
) -> str:
    """Return the state and the measurement of all joints (N,) as a table with its units."""
    columns = {
        "q [rad]": q,
        "v [rad/s]": v,
        "gear [N m]": gear,
        "current [A]": current,
        "command": command,
        "counts": counts,
    }
    return f"{SLIDES}\n\n" + format_numbers(names, columns)


def _format_cell(value: Any) -> str:
    if isinstance(value, np.integer):
        return str(int(value))
    if np.isnan(value):
        return "-"
    # Equal decimals let the eye compare the lines; what is too large or small for them is rare.
    fits = value == 0.0 or 0.5 * 10.0**-DECIMALS <= abs(value) < 1e5
    return f"{float(value) + 0.0:.{DECIMALS}f}" if fits else f"{float(value):.1e}"


MAX_BUTTONS = 40  # buttons: the newest events
Event = tuple[int, str]  # tick and text


class EventList:
    """Buttons in the tab or folder in whose context this is made.

    Args:
        gui: of the server.
        go: is called with the tick of an event that is clicked.
    """

    def __init__(self, gui: Any, go: Callable[[int], None]) -> None:
        self._gui, self._go = gui, go
        self._more = gui.add_markdown("No event yet.")
        self._folder = gui.add_folder("Events, the newest first")
        self._buttons: list[tuple[Event, Any]] = []
        self._order = 0.0

    def show_events(self, events: Sequence[Event]) -> None:
        """Show other events: those that are listed already stay, and newer ones come above them."""
        listed = [event for event, _ in self._buttons]
        newest = list(events[-MAX_BUTTONS:])
        removed = range(len(listed) + 1)  # of those that are listed, the oldest
        self._drop_events(next(k for k in removed if listed[k:] == newest[: len(listed) - k]))
        for event in newest[len(self._buttons) :]:
            self._add_event(event)
        left = len(events) - len(newest)
        text = f"{left} older events are not listed." if left else ""
        self._more.content = text or ("" if events else "No event yet.")

    def _drop_events(self, count: int) -> None:
        for _, button in self._buttons[:count]:
            button.remove()
        del self._buttons[:count]

    def _add_event(self, event: Event) -> None:
        tick, text = event
        self._order -= 1.0
        with self._folder:
            button = self._gui.add_button(f"{tick}: {text}", order=self._order, color="gray")
        button.on_click(lambda _: self._go(tick))
        self._buttons.append((event, button))
