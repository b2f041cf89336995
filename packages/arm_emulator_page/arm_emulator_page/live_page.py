"""The page of a running machine: the arm now and before, its signals, and actions on it."""

import math
import threading
import time
from collections.abc import Mapping, Sequence
from functools import partial
from typing import Any

import numpy as np

from arm_emulator.extension.base import Column, ColumnRows, Refusal, escape_markdown
from arm_emulator.extension.machine import Scene, select_values
from arm_emulator.extension.page import Controls
from arm_emulator_page.arm_scene import ArmScene
from arm_emulator_page.machine_tab import TargetTab, add_machine_tab
from arm_emulator_page.number_table import EventList, format_machine
from arm_emulator_page.page_server import PageServer
from arm_emulator_page.push_tab import PushTab
from arm_emulator_page.signal_plot import SignalPlot, read_choice

PLOTTED = 0.25  # s, wall, between two plots and two tables
SPANS = {"1 s": 1.0, "10 s": 10.0, "60 s": 60.0, "the whole run": math.inf}
SAMPLES = 1500  # of a plot
STEPS = {"+1": 1, "+10": 10, "+100": 100}
RATES = {"as fast as possible": 0.0, "1": 1.0, "0.25": 0.25, "0.1": 0.1, "0.01": 0.01}


class LivePage:
    """Serves a running machine to browsers until it is closed.

    Its owner gives it rows by `take_rows`, and lets it draw by `draw_rows`, some times a second.
    All browsers see the same moment.

    Attributes:
        url: address with the token.
        server: of viser.
        arm: that is shown.
        hands: actions on the machine.
        exclusive: lock of all that changes the page.
        varied: numbers that can be set, as they were at first.
        answer: line for the answers of the machine.

    Args:
        scene: the machine.
        columns: of its rows.
        kind: of a row.
        controls: actions on it.
        at: [HOST:]PORT, see `PageServer`.
        varied: numbers of the machine that can be set, as they are now.

    Raises:
        Refusal: see `PageServer`.
    """

    def __init__(
        self,
        scene: Scene,
        columns: Sequence[Column],
        kind: np.dtype[np.void],
        controls: Controls,
        at: str | int = 0,
        varied: Mapping[str, float] | None = None,
    ) -> None:
        self.varied = dict(varied or {})
        self._scene, self.hands = scene, controls
        self._served = served = PageServer(at)
        self.url, self.server = served.url, served.server
        gui = self.server.gui
        self.exclusive = threading.RLock()
        self._history = LiveHistory(kind)
        self._events: list[tuple[int, str]] = []
        self._at: int | None = None  # tick in the past that is shown
        self._changing = False
        self._plotted_rows = -1  # rows that had come
        self._plotted_at, self._mark, self._factor = 0.0, (time.monotonic(), 0.0), 0.0
        self._state, self._dropped, self._over = "", 0, ""
        self.arm = ArmScene(served.server, scene)
        served.look_from(self.arm.size)
        can = controls.can()
        gui.add_markdown(f"**{escape_markdown(scene.name)}**")
        self._moment = gui.add_markdown("no tick yet")
        self._slider = gui.add_slider("Tick", 0, 1, 1, 0)
        self._slider.on_update(
            lambda _: None if self._changing else self.go_to_tick(self._slider.value)
        )
        self._live_button = gui.add_button("Live", disabled=True)
        self._live_button.on_click(lambda _: self.go_to_tick(None))
        self._add_time_controls(gui, can)
        self.answer = gui.add_markdown("")
        tabs = gui.add_tab_group()
        with tabs.add_tab("Now"):
            self._numbers = gui.add_markdown("")
        with tabs.add_tab("Plot"):
            self._span = gui.add_dropdown("Span", tuple(SPANS), initial_value="10 s")
            self._span.on_update(lambda _: self._plot_history())
            self._plots = SignalPlot(gui, columns, self._plot_history)
        if "aim" in can:
            with tabs.add_tab("Target"):
                self._target = TargetTab(self, served.server, self.arm)
        if "push" in can:
            with tabs.add_tab("Push"):
                push = partial(self.request_action, "push")
                PushTab(self.exclusive, push, served.server, self.arm, scene)
        with tabs.add_tab("Machine"):
            add_machine_tab(self, gui, scene)
        with tabs.add_tab("Events"):
            if "break_when" in can:
                self._condition = gui.add_text("Stop when", "")
                gui.add_button("Set the breakpoint").on_click(lambda _: self._set_breakpoint())
            self._list = EventList(gui, self.go_to_tick)
        if self.arm.missing:
            gui.add_markdown(f"The arm's shapes are not shown. {escape_markdown(self.arm.missing)}")

    @property
    def browsers(self) -> int:
        """Number of browsers that are connected."""
        return len(self._served.server.get_clients())

    def close(self) -> None:
        """End the page."""
        self._served.stop()

    # Rows and pictures

    def take_rows(self, rows: ColumnRows, dropped: int) -> None:
        """Take rows of the machine, and the number of those that were dropped so far."""
        with self.exclusive:
            self._dropped = dropped
            if len(rows):
                self._history.add_rows(rows)

    def show_end(self, words: str) -> None:
        """Show that the machine has ended."""
        with self.exclusive:
            self._over, self._plotted_rows = words, -1

    def draw_rows(self) -> None:
        """Show what has come since the last call."""
        with self.exclusive:
            self._look_at_news()
            if not self.browsers or not len(self._history.newest):
                return
            now = time.monotonic()
            fresh = self._plotted_rows != self._history.count
            if fresh and self._at is None:
                self.arm.show_arm(self._history.newest["q"][0])
            if (fresh or self._plotted_rows < 0) and now - self._plotted_at >= PLOTTED:
                self._plotted_rows, self._plotted_at = self._history.count, now
                self._show_moment()

    def _look_at_news(self) -> None:
        news = self.hands.news()
        if news.state:
            self._state, self._plotted_rows = news.state, -1
        if news.paused is not None and "pause" in self.hands.can():
            self._pause_button.label = "Play" if news.paused else "Pause"
        if news.events:
            self._events += news.events
            del self._events[:-1000]
            self._list.show_events(self._events)

    def _show_moment(self) -> None:
        """Show the moment that is looked at."""
        newest = self._history.newest
        last = int(newest["tick"][0])
        row = newest if self._at is None else self._history.find_row(self._at)
        tick, scene = int(row["tick"][0]), self._scene
        self._changing = True
        try:
            if self._slider.max != max(1, last):
                self._slider.max = max(1, last)
            self._slider.value = min(tick, max(1, last))
        finally:
            self._changing = False
        self._live_button.disabled = self._at is None
        words = [f"tick {tick}, {tick * scene.servo_period:.4f} s"]
        if self._at is None:
            words += filter(
                None, (self._over or self._state, self._format_speed(float(newest["t"][0])))
            )
        else:
            words.append("**in the past**")
        if self._dropped:
            words.append(f"{self._dropped} ticks not shown: the page is too slow for them")
        if self._at is not None:
            self.arm.show_arm(row["q"][0])
        self._numbers.content = format_machine(
            scene.joint_names,
            q=row["q"][0],
            v=row["v"][0],
            gear=row["gear_torque"][0],
            current=row["current"][0],
            command=select_values(row, "measured.applied", scene)[0],
            counts=select_values(row, "measured.encoder_counts", scene)[0],
        )
        if self._at is None:
            self._plot_history()
        self._moment.content = ", ".join(words)  # last: all of this moment is shown

    def _format_speed(self, t: float) -> str:
        """Return how fast logical time passes, in words."""
        now = time.monotonic()
        since, before = self._mark
        if now - since >= 0.5:
            self._factor = max(0.0, t - before) / (now - since)
            self._mark = now, t
        return f"{self._factor:.3g} times real time" if self._factor else ""

    def _plot_history(self) -> None:
        with self.exclusive:
            self._plots.show_rows(
                self._history.select_rows(SPANS[read_choice(self._span, SPANS)], SAMPLES)
            )

    @property
    def plotted(self) -> tuple[Any, ...]:
        """Times [s] and the columns that are plotted over them."""
        return self._plots.data

    # Changes by hand

    def go_to_tick(self, tick: int | None) -> None:
        """Show a tick of the past; None: the newest one, now and from now on."""
        with self.exclusive:
            newest = self._history.newest
            if not len(newest):
                return
            self._at = None if tick is None or tick >= newest["tick"][0] else int(tick)
            self._show_moment()

    def request_action(self, what: str, *given: Any) -> str:
        """Do an action by its name, and show its answer; return "" if it was refused."""
        try:
            answer: str = self.hands.do_action(what, *given)
        except Refusal as reason:
            self._show_refusal(str(reason))
            return ""
        self.answer.content = escape_markdown(answer)
        return answer

    def _show_refusal(self, reason: str) -> None:
        with self.exclusive:
            newest = self._history.newest
            self._events.append(
                (int(newest["tick"][0]) if len(newest) else 0, f"refused: {reason}")
            )
            self._list.show_events(self._events)
            self.answer.content = escape_markdown(reason)

    def _add_time_controls(self, gui: Any, can: frozenset[str]) -> None:
        if "pause" in can:
            self._pause_button = gui.add_button("Pause")
            self._pause_button.on_click(lambda _: self._switch_pause())
            gui.add_command("Play or pause", hotkey="space").on_trigger(
                lambda _: self._switch_pause()
            )
        if "step" in can:
            steps = gui.add_button_group("Step", tuple(STEPS))
            steps.on_click(lambda event: self.request_action("step", STEPS[event.target.value]))
            for label, key, ticks in (("One tick on", "arrowright", 1), ("Ten on", "arrowup", 10)):
                command = gui.add_command(label, hotkey=key)
                command.on_trigger(lambda _, ticks=ticks: self.request_action("step", ticks))
        if "rate" in can:
            labels = (label for label, factor in RATES.items() if factor == self.hands.factor)
            now = next(labels, None)
            rate = gui.add_dropdown("Times real time", tuple(RATES), initial_value=now)
            rate.on_update(lambda _: self.request_action("rate", RATES[read_choice(rate, RATES)]))

    def _switch_pause(self) -> None:
        pauses = self._pause_button.label == "Pause"
        if self.request_action("pause", pauses):
            self._pause_button.label = "Play" if pauses else "Pause"
            if not pauses:
                self.go_to_tick(None)

    def _set_breakpoint(self) -> None:
        self.request_action("break_when", self._condition.value)


NEWEST = 8000  # rows that are kept one by one
MAX_ROWS = 4000  # rows of the whole run


class LiveHistory:
    """Rows of a run so far.

    When a machine begins anew at an earlier tick, its rows replace those before.

    Attributes:
        count: of rows that have come.

    Args:
        kind: of a row.
    """

    def __init__(self, kind: np.dtype[np.void]) -> None:
        self._newest = np.zeros(0, kind)
        self._thinned = np.zeros(0, kind)
        self._every = 1  # of the rows of the whole run
        self.count = 0

    def add_rows(self, rows: ColumnRows) -> None:
        """Add rows (K,) in the order of their ticks."""
        back = np.flatnonzero(np.diff(rows["tick"]) < 0)
        if len(back):
            rows = rows[back[-1] + 1 :]
            self._forget_rows()
        elif len(rows) and len(self._newest) and rows["tick"][0] < self._newest["tick"][-1]:
            self._forget_rows()
        picked = rows[-self.count % self._every :: self._every]
        self.count += len(rows)
        self._thinned = np.concatenate([self._thinned, picked])
        while len(self._thinned) > MAX_ROWS:
            self._thinned, self._every = self._thinned[::2].copy(), 2 * self._every
        self._newest = np.concatenate([self._newest, rows])[-NEWEST:].copy()

    def _forget_rows(self) -> None:
        self._newest, self._thinned = self._newest[:0], self._thinned[:0]
        self._every, self.count = 1, 0

    @property
    def newest(self) -> ColumnRows:
        """The newest row (1,), or none (0,)."""
        return self._newest[-1:]

    def find_row(self, tick: int) -> ColumnRows:
        """Return the row (1,) that is nearest to a tick, or none (0,)."""
        first = self._newest["tick"][:1]
        rows = self._newest if len(first) and tick >= first[0] else self._thinned
        if not len(rows):
            return rows
        place = int(np.argmin(np.abs(rows["tick"] - tick)))
        return rows[place : place + 1]

    def select_rows(self, seconds: float, max_rows: int) -> ColumnRows:
        """Return at most so many rows of the last seconds; infinity: of the whole run."""
        if not len(self._newest):
            return self._newest
        begin = self._newest["t"][-1] - seconds
        rows = self._newest
        if begin < rows["t"][0]:
            rows = np.concatenate([self._thinned[self._thinned["t"] < rows["t"][0]], rows])
        rows = rows[np.searchsorted(rows["t"], begin) :]
        every = max(1, -(-len(rows) // max_rows))
        return rows[(len(rows) - 1) % every :: every]
