"""Changes of a run from its page: another future from any moment on."""

from collections.abc import Callable
from pathlib import Path

from arm_emulator.extension.base import Refusal, escape_markdown
from arm_emulator.extension.machine import Diverged
from arm_emulator.extension.page import (
    NO_VECTOR,
    MoveTool,
    Order,
    Push,
    ScaleGains,
    SetVaried,
    SwitchPower,
    Timeline,
    Vector,
)
from arm_emulator.extension.runs import OfflineRun
from arm_emulator_page.push_tab import PushTab
from arm_emulator_page.run_page import RunPage
from arm_emulator_page.run_view import RunView

Keep = Callable[[Timeline[OfflineRun], Path, Path | None], None]
NOTHING = "nothing"
LONGEST = 600.0  # s that one press of the button may last


class WhatIf:
    """A tab of a page: move the tool, switch the power, scale gains, set numbers, and go on.

    In the past the run forks; each fork has the past that it had where it began.

    Args:
        page: the page.
        line: timeline of the run that it shows.
        keep: writes a timeline as a bag into a folder, with the bag of its parent; None: bags
            cannot be written here.
    """

    def __init__(self, page: RunPage, line: Timeline[OfflineRun], keep: Keep | None = None) -> None:
        self._page, self._lines, self._keep = page, {"the run": line}, keep
        run, gui = line.run, page.gui
        self._pushes: dict[str, Push] = {}  # by link, to be set
        with page.add_tab("Push"):
            scene = run.session.scene
            PushTab(page.exclusive, self._push_link, page.server, page.arm, scene)
            self._pushed = gui.add_markdown("")
        with page.add_tab("What if"):
            self._which = gui.add_dropdown("Timeline", tuple(self._lines))
            self._which.on_update(lambda _: self._turn_to(self._which.value))
            self._over = gui.add_dropdown("Laid over it", (NOTHING, *self._lines))
            self._over.on_update(lambda _: self._show_fork(self._over.value))
            self._by = gui.add_vector3("Move the tool by [m]", NO_VECTOR, step=0.01)
            self._power = gui.add_checkbox("Power", run.session.powered)
            self._gains = gui.add_number("Position gains times", 1.0, min=0.0, step=0.1)
            self._varied = {
                name: gui.add_number(name, value, step=0.01 * abs(value) or 0.01)
                for name, value in run.session.plant.parameters.items()
            }
            self._seconds = gui.add_number("Go on for [s]", 2.0, min=0.001, max=LONGEST, step=0.5)
            self._button = gui.add_button("Go on from this moment")
            self._button.on_click(lambda _: self._go_on())
            self._answer = gui.add_markdown("")
            if keep is not None:
                self._folder = gui.add_text("New folder for bags", "futures")
                gui.add_button("Keep all as bags").on_click(lambda _: self._keep_all())

    def _push_link(self, link: str, force: Vector, moment: Vector) -> None:
        """Let a wrench act from the moment on at which the run goes on."""
        self._pushes[link] = order = Push(link, force, moment)
        self._pushed.content = f"When it goes on (tab *What if*): {escape_markdown(order.name)}"

    def _keep_all(self) -> None:
        """Write every timeline as a bag that names its parent's."""
        folder = self.folder
        with self._page.exclusive:
            try:
                if folder.exists():
                    raise Refusal("page", f"folder {folder}", "be new", "one that exists")
                bags: dict[int, Path] = {}  # by timeline; a parent comes before its forks
                for name, line in self._lines.items():
                    bag = folder / name.partition(",")[0].replace(" ", "_")
                    assert self._keep is not None
                    self._keep(line, bag, bags.get(id(line.parent)))
                    bags[id(line)] = bag
                answer = escape_markdown(f"{len(bags)} bags in {folder.resolve()}")
            except (Refusal, OSError) as reason:
                answer = escape_markdown(str(reason))
            self._page.line.go_to(self._page.line.tick)  # forks take turns in one machine
            self._answer.content = answer  # last: all that it reports is done

    def _turn_to(self, name: str) -> None:
        with self._page.exclusive:
            if not self._page.changing:
                line = self._lines[name]
                self._page.turn_to(RunView.create_from_line(line, line.newest), line.tick)

    def _show_fork(self, name: str) -> None:
        with self._page.exclusive:
            if self._page.changing:
                return
            line = self._lines.get(name)
            at = self._page.line.tick
            over = None if line is None else RunView.create_from_line(line, line.newest)
            self._page.line.go_to(at)  # forks take turns in one machine
            self._page.show_second_run(over)

    def _go_on(self) -> None:
        with self._page.exclusive:
            line: Timeline[OfflineRun] = self._page.line
            period, begin = line.run.session.scene.servo_period, line.tick
            name = next(name for name, future in self._lines.items() if future is line)
            seconds = self.seconds
            if not period <= seconds <= LONGEST:
                self._answer.content = f"go on for {period:g} to {LONGEST:g} s"
                return
            forked = begin < line.newest
            if forked:
                line = line.fork()
                name = f"fork {len(self._lines)}, from {begin * period:g} s of {name}"
            try:
                done = self._change_run(line)
                line.advance(round(seconds / period))
                answer = escape_markdown(f"{name}: {done or 'as it was'}")
            except (Refusal, Diverged) as reason:
                answer = escape_markdown(str(reason))
            if line.newest == begin:  # refused at once: no other future
                line = self._page.line
            elif forked:
                self._lines[name] = line
                self._page.put_options(self._which, tuple(self._lines), name)
                self._page.put_options(self._over, (NOTHING, *self._lines), self._over.value)
            self._page.turn_to(RunView.create_from_line(line, line.newest), begin)
            self._answer.content = answer

    def _change_run(self, line: Timeline[OfflineRun]) -> str:
        """Make the changes that the controls ask for, and return their names.

        Raises:
            Refusal: one of them is refused; those before it are made.
        """
        orders = self.orders
        for order in orders:
            order.give(line)
        self._by.value, self._gains.value = NO_VECTOR, 1.0
        self._pushes, self._pushed.content = {}, ""
        return ", ".join(order.name for order in orders)

    @property
    def seconds(self) -> float:
        """Time that the run goes on for [s]."""
        return float(self._seconds.value)

    @property
    def folder(self) -> Path:
        """Folder that bags are written into."""
        return Path(self._folder.value)

    @property
    def orders(self) -> list[Order]:
        """Changes that the controls ask for at the moment that is shown."""
        run: OfflineRun = self._page.line.run
        orders: list[Order] = []
        x, y, z = (float(number) for number in self._by.value)
        if (x, y, z) != NO_VECTOR:
            orders.append(MoveTool((x, y, z)))
        if self._power.value != run.session.powered:
            orders.append(SwitchPower(bool(self._power.value)))
        if (factor := float(self._gains.value)) != 1.0:
            orders.append(ScaleGains(factor))
        orders += self._pushes.values()
        for name, control in self._varied.items():
            value = float(control.value)
            if value != run.session.plant.parameters[name]:
                orders.append(SetVaried(name, value))
        return orders
