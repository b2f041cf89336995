"""The page of a recorded run: play it, go to any moment, and look at every number there."""

import threading
from collections.abc import Callable
from typing import Any

import numpy as np

from arm_emulator.extension.base import Refusal, escape_markdown
from arm_emulator.extension.machine import Session
from arm_emulator.extension.page import Condition, TermsNow, Timeline
from arm_emulator_page.arm_scene import ArmScene
from arm_emulator_page.number_table import EventList, format_machine, format_numbers
from arm_emulator_page.page_server import PageServer
from arm_emulator_page.run_view import RunView
from arm_emulator_page.signal_plot import FIRST, HEIGHT, SCALES, make_line_styles, read_choice

FRAME = 1.0 / 30.0  # s, wall time between two pictures while it plays
RATES = ("0.01", "0.1", "0.25", "1", "4")
THIS, SECOND, DIFFERENCE = "this run", "the other run", "difference"


class RunPage:
    """Serves a run to browsers until it is closed.

    All browsers see the same moment. What they do goes through one lock, so that no two of them
    move the run at the same time.

    Attributes:
        url: address with the token, without which nothing is served.
        server: of viser, for what is added to the picture.
        gui: of the server, for further controls.
        arm: that is shown.
        exclusive: lock of all that moves the run or changes the page.
        changing: whether the page itself changes its controls.

    Args:
        run_view: the run.
        explain: returns the torques at the moment at which the run is, and what is active there.
        at: [HOST:]PORT, see `PageServer`.
        over: a run that is laid over it.

    Raises:
        Refusal: viser is missing, the port is taken, or the runs are of different joints.
    """

    def __init__(
        self,
        run_view: RunView,
        explain: Callable[[], tuple[TermsNow, list[str]]],
        at: str | int = 0,
        over: RunView | None = None,
    ) -> None:
        if over is not None:
            _check_alike(run_view, over)
        self._view, self._explain = run_view, explain
        self._over: RunView | None = None
        self._arm_over: ArmScene | None = None
        self.exclusive = threading.RLock()
        self._playing, self._closing = False, threading.Event()
        self.changing = False
        scene = self._session.scene
        self._served = PageServer(at)
        self.server: Any = self._served.server
        server = self.server
        self.url = self._served.url
        self.arm = ArmScene(server, scene)
        self._served.look_from(self.arm.size)
        self.arm.show_path(run_view.history.read_values("q"))
        self.gui: Any = server.gui
        self._build_controls(server, scene.name)
        if self.arm.missing:
            missing = escape_markdown(self.arm.missing)
            server.gui.add_markdown(f"The arm's shapes are not shown. {missing}")
        self.show_second_run(over)
        self._thread = threading.Thread(target=self._play_ticks, name="page", daemon=True)
        self._thread.start()

    @property
    def line(self) -> Timeline[Any]:
        """The timeline that is shown."""
        return self._view.line

    @property
    def last(self) -> int:
        """The last tick that can be visited."""
        return self._view.last

    @property
    def _session(self) -> Session:
        session: Session = self.line.run.session
        return session

    @property
    def plotted(self) -> tuple[Any, ...]:
        """Times [s] and the columns that are plotted over them."""
        data: tuple[Any, ...] = self._chart.data
        return data

    def add_tab(self, name: str) -> Any:
        """Return a new tab as a context for its controls."""
        return self._tabs.add_tab(name)

    def turn_to(self, run_view: RunView, tick: int) -> None:
        """Show another run, from a tick on."""
        with self.exclusive:
            self._view = run_view
            run_view.line.go_to(tick)
            self.arm.show_path(run_view.history.read_values("q"))
            self._list.show_events(run_view.events)
            self.changing = True
            try:
                self._slider.max = max(1, run_view.last)
            finally:
                self.changing = False
            self._choose_plots()
            self._plot_series()
            self._show_moment()

    def show_second_run(self, view: RunView | None) -> None:
        """Show a second run over this one, at the same ticks, or none any more.

        Raises:
            Refusal: it is of other joints or another servo period.
        """
        with self.exclusive:
            if view is not None:
                _check_alike(self._view, view)
            if self._arm_over is not None:
                self._arm_over.remove_arm()
                self._arm_over = None
            self._over = view
            if view is not None:
                scene = view.line.run.session.scene
                self._arm_over = ArmScene(self.server, scene, "/over", over=True)
                self._arm_over.show_path(view.history.read_values("q"))
            self._choose_plots()
            self._plot_series()
            self._show_moment()

    def _choose_plots(self) -> None:
        """Offer the quantities that all shown runs have."""
        here, now = self._view.history, self._group.value
        groups = tuple(here.groups)
        if self._over is not None:
            there = self._over.history
            groups = tuple(
                group for group in groups if here.list_paths(group) == there.list_paths(group)
            )
        self.put_options(self._group, groups, now if now in groups else None)
        plots = (THIS,) if self._over is None else (THIS, SECOND, DIFFERENCE)
        self.put_options(self._of, plots, self._of.value if self._of.value in plots else None)

    def put_options(self, control: Any, options: tuple[str, ...], value: str | None) -> None:
        """Give a dropdown other options, and a value, without any action."""
        self.changing = True
        try:
            control.options = options
            control.value = options[0] if value is None else value
        finally:
            self.changing = False

    def close(self) -> None:
        """End the page."""
        self._closing.set()
        self._thread.join()
        self._served.stop()

    # Controls

    def _build_controls(self, server: Any, name: str) -> None:
        gui, period = server.gui, self._session.scene.servo_period
        gui.add_markdown(f"**{escape_markdown(name)}**, {self.last * period:g} s")
        self._moment = gui.add_markdown("")
        self._slider = gui.add_slider("Tick", 0, max(1, self.last), 1, 0)
        self._slider.on_update(
            lambda _: None if self.changing else self._go_to_tick(self._slider.value)
        )
        self._play_button = gui.add_button("Play")
        self._play_button.on_click(lambda _: self._switch_playing())
        self._rate = gui.add_dropdown("Speed", RATES, initial_value="1")
        steps = gui.add_button_group("Step", ("to start", "-1", "+1", "to end"))
        steps.on_click(lambda event: self._step_ticks(event.target.value))
        for label, key, step in (
            ("Play or pause", "space", None),
            ("One tick back", "arrowleft", "-1"),
            ("One tick on", "arrowright", "+1"),
            ("To the start", "home", "to start"),
            ("To the end", "end", "to end"),
        ):
            command = gui.add_command(label, hotkey=key)
            command.on_trigger(
                lambda _, step=step: self._step_ticks(step) if step else self._switch_playing()
            )
        self._tabs = tabs = gui.add_tab_group()
        with tabs.add_tab("Now"):
            self._numbers = gui.add_markdown("")
        with tabs.add_tab("Plot"):
            groups = tuple(self._view.history.groups)
            self._group = gui.add_dropdown("Signal", groups, initial_value=FIRST)
            self._group.on_update(lambda _: None if self.changing else self._plot_series())
            self._of = gui.add_dropdown("Of", (THIS,))
            self._of.on_update(lambda _: None if self.changing else self._plot_series())
            self._chart = gui.add_uplot(*self._make_series(FIRST), scales=SCALES, height=HEIGHT)
        with tabs.add_tab("Events"):
            self._condition = gui.add_text("Condition", "")
            find = gui.add_button("Find the next")
            find.on_click(lambda _: self._find_condition())
            self._found = gui.add_markdown("")
            self._list = EventList(gui, self._go_to_tick)
            self._list.show_events(self._view.events)
        with tabs.add_tab("Torques"):
            ask = gui.add_button("Explain this moment")
            ask.on_click(lambda _: self._show_terms())
            self._terms = gui.add_markdown("")

    def _switch_playing(self) -> None:
        with self.exclusive:
            if not self._playing and self.line.tick >= self.last:
                self.line.go_to(0)
            self._playing = not self._playing
            self._play_button.label = "Pause" if self._playing else "Play"

    def _step_ticks(self, step: str) -> None:
        with self.exclusive:
            now = self.line.tick
            to = {"to start": 0, "-1": now - 1, "+1": now + 1, "to end": self.last}[step]
            self._go_to_tick(to)

    def _go_to_tick(self, tick: int) -> None:
        with self.exclusive:
            self.line.go_to(max(0, min(int(tick), self.last)))
            self._show_moment()

    def _find_condition(self) -> None:
        with self.exclusive:
            scene = self._session.scene
            try:
                condition = Condition(self._condition.value, scene, "page")
            except Refusal as reason:
                self._found.content = escape_markdown(str(reason))
                return
            before = self.line.tick
            tick = self.line.find(lambda run: condition.holds(run.session), self.last)
            if tick is None:
                self.line.go_to(before)
                self._found.content = "does not hold from here to the end"
                return
            self._show_moment()
            self._found.content = f"holds at tick {tick}, {tick * scene.servo_period:g} s"

    def _show_terms(self) -> None:
        with self.exclusive:
            terms, active = self._explain()
            names = self._session.scene.joint_names
            tables = [
                f"On each {side} [N m or N]\n\n" + format_numbers(names, rows)
                for side, rows in (("link", terms.link), ("rotor", terms.rotor))
            ]
            self._terms.content = "\n\n".join(
                [*tables, *(f"- {escape_markdown(text)}" for text in active)]
            )

    # Pictures

    def _play_ticks(self) -> None:
        """Move on while it plays."""
        at = 0.0
        while not self._closing.wait(FRAME):
            with self.exclusive:
                if not self._playing:
                    at = float(self.line.tick)
                    continue
                at = max(at, float(self.line.tick))
                at += (
                    FRAME * float(read_choice(self._rate, RATES)) / self._session.scene.servo_period
                )
                tick = min(int(at), self.last)
                if tick != self.line.tick:
                    self.line.go_to(tick)
                    self._show_moment()
                if tick >= self.last:
                    self._switch_playing()

    def _show_moment(self) -> None:
        """Show the moment at which the run is."""
        tick, apart = self.line.tick, ""
        if self._over is not None and self._arm_over is not None:
            line_over = self._over.line
            line_over.go_to(min(tick, self._over.last))
            self._arm_over.show_arm(line_over.run.session.state.q)
            self.line.go_to(tick)  # forks take turns in one machine
        session = self._session
        state, names = session.state, session.scene.joint_names
        self.arm.show_arm(state.q)
        if self._arm_over is not None:
            away = 1e3 * float(np.linalg.norm(self.arm.p_WT - self._arm_over.p_WT))
            apart = f", tools {away:.4g} mm apart"
        self.changing = True
        try:
            self._slider.value = tick
        finally:
            self.changing = False
        power = "" if session.powered else ", **no power**"
        measured = session.measured
        self._numbers.content = format_machine(
            names,
            q=state.q,
            v=state.v,
            gear=state.gear_torque,
            current=state.current,
            command=measured.applied,
            counts=measured.encoder_counts,
        )
        self._moment.content = (  # last: all of this moment is shown
            f"tick {tick}, {tick * session.scene.servo_period:.4f} s{apart}{power}"
        )

    def _make_series(self, group: str) -> tuple[tuple[Any, ...], tuple[Any, ...]]:
        history = self._view.history
        ticks, values = history.ticks, history.read_values(group)
        if self._over is not None and self._of.value == SECOND:
            ticks, values = self._over.history.ticks, self._over.history.read_values(group)
        elif self._over is not None and self._of.value == DIFFERENCE:
            ticks, values = history.subtract_history(self._over.history, group)
        t = ticks * self._session.scene.servo_period
        return (t, *values.T), make_line_styles(history.groups[group])

    def _plot_series(self) -> None:
        with self.exclusive:
            self._chart.data, self._chart.series = self._make_series(
                read_choice(self._group, self._view.history.groups)
            )


def _check_alike(first_view: RunView, second_view: RunView) -> None:
    first, second = (each.line.run.session.scene for each in (first_view, second_view))
    if first.joint_names != second.joint_names:
        names = list(second.joint_names)
        raise Refusal("page", "joints of the other run", f"be {list(first.joint_names)}", names)
    if first.servo_period != second.servo_period:
        rule = f"be {first.servo_period:g} [s]"
        raise Refusal("page", "servo period of the other run", rule, second.servo_period)
