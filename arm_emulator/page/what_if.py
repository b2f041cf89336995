"""Changes of a run from its page: another future from any moment on."""

from __future__ import annotations

import dataclasses
import math
from functools import partial
from typing import Any

import numpy as np

from arm_emulator.base.refusal import Refusal
from arm_emulator.machine.diverged import Diverged
from arm_emulator.machine.external_wrench import ExternalWrench
from arm_emulator.motion.pose import Pose
from arm_emulator.page.hands import Vector
from arm_emulator.page.push_tab import PushTab
from arm_emulator.page.run_page import RunPage
from arm_emulator.page.subject import Subject
from arm_emulator.runs.offline import OfflineRun
from arm_emulator.runs.timeline import Timeline

NOTHING = "nothing"
LONGEST = 600.0  # s that one press of the button may last


class WhatIf:
    """A tab of a page: move the tool, switch the power, scale gains, set numbers, and go on.

    In the past the run forks; each fork has the past that it had where it began.

    Args:
        page: the page.
        line: timeline of the run that it shows.
    """

    def __init__(self, page: RunPage, line: Timeline[OfflineRun]) -> None:
        self._page, self._lines = page, {"the run": line}
        run, gui = line.run, page.gui
        self._pushes: dict[str, ExternalWrench] = {}  # by link, to be set
        with page.new_tab("Push"):
            scene = run.session.scene
            PushTab(page.exclusive, self._push, page.server, page.arm, scene)
            self._pushed = gui.add_markdown("")
        with page.new_tab("What if"):
            self._which = gui.add_dropdown("Timeline", tuple(self._lines))
            self._which.on_update(lambda _: self._turn_to(self._which.value))
            self._over = gui.add_dropdown("Laid over it", (NOTHING, *self._lines))
            self._over.on_update(lambda _: self._lay_over(self._over.value))
            self._by = gui.add_vector3("Move the tool by [m]", (0.0, 0.0, 0.0), step=0.01)
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

    def _push(self, link: str, force: Vector, moment: Vector) -> None:
        """Let a wrench act from the moment on at which the run goes on."""
        self._pushes[link] = ExternalWrench(force, moment, axes="world")
        words = ", ".join(f"{one:.3g}" for one in force)
        self._pushed.content = f"{link} will be pushed with {words} N: *Go on* in What if"

    def _turn_to(self, name: str) -> None:
        with self._page.exclusive:
            if not self._page.changing:
                line = self._lines[name]
                self._page.turn_to(Subject.of(line, line.newest), line.tick)

    def _lay_over(self, name: str) -> None:
        with self._page.exclusive:
            if self._page.changing:
                return
            line = self._lines.get(name)
            at = self._page.line.tick
            over = None if line is None else Subject.of(line, line.newest)
            self._page.line.go_to(at)  # forks take turns in one machine
            self._page.lay_over(over)

    def _go_on(self) -> None:
        with self._page.exclusive:
            line: Timeline[OfflineRun] = self._page.line
            period, begin = line.run.session.scene.servo_period, line.tick
            name = next(name for name, known in self._lines.items() if known is line)
            seconds = float(self._seconds.value)
            if not period <= seconds <= LONGEST:
                self._answer.content = f"go on for {period:g} to {LONGEST:g} s"
                return
            forked = begin < line.newest
            if forked:
                line = line.fork()
                name = f"fork {len(self._lines)}, from {begin * period:g} s of {name}"
            try:
                done = self._change(line)
                line.advance(round(seconds / period))
                self._answer.content = f"{name}: {done or 'as it was'}"
            except (Refusal, Diverged) as reason:
                self._answer.content = f"```\n{reason}\n```"
                if line.newest == begin:
                    self._page.turn_to(Subject.of(self._page.line, self._page.last), begin)
                    return
            if forked:
                self._lines[name] = line
                self._page.put(self._which, tuple(self._lines), name)
                self._page.put(self._over, (NOTHING, *self._lines), self._over.value)
            self._page.turn_to(Subject.of(line, line.newest), begin)

    def _change(self, line: Timeline[OfflineRun]) -> str:
        """Make the changes that the controls ask for, and return their names.

        Raises:
            Refusal: one of them is refused; those before it are made.
        """
        run, before = line.run, len(line.changes)
        by = np.array(self._by.value, np.float64)
        if by.any():
            line.change(f"tool by {by.round(6).tolist()} m", lambda one: _move(one, by))
            self._by.value = (0.0, 0.0, 0.0)
        if self._power.value != run.session.powered:
            on = bool(self._power.value)
            name = f"power {'on' if on else 'off'}"
            line.change(name, lambda one: setattr(one.session, "powered", on))
        factor = float(self._gains.value)
        if factor != 1.0:
            line.change(f"position gains times {factor:g}", lambda one: _scale(one, factor))
            self._gains.value = 1.0
        for link, wrench in self._pushes.items():
            line.change(f"push {link}", partial(_push, link=link, wrench=wrench))
        self._pushes = {}
        self._pushed.content = ""
        for name, control in self._varied.items():
            value = float(control.value)
            if value != run.session.plant.parameters[name]:
                line.change(f"{name} = {value:g}", partial(_set, name=name, value=value))
        return ", ".join(one.name for one in line.changes[before:])


def _set(run: OfflineRun, name: str, value: float) -> None:
    run.session.set_varied(name, value)


def _push(run: OfflineRun, link: str, wrench: ExternalWrench) -> None:
    run.session.set_external_wrench(link, wrench)


def _move(run: OfflineRun, by: np.ndarray[Any, np.dtype[np.float64]]) -> None:
    """Send the tool to a place beside the one where it is."""
    R_WT, p_WT = run.controller.kinematics.forward(run.session.state.q)
    run.instructor.add(run.session.logical_ns, Pose(p_WT + by, R_WT))


def _scale(run: OfflineRun, factor: float) -> None:
    """Multiply the servo's position gains.

    Raises:
        Refusal: gains that the servo does not take.
    """
    if not (math.isfinite(factor) and factor > 0.0):
        raise Refusal("page", "factor of gains", "be finite and above 0", factor)
    config = run.drives.servo.config
    joints = tuple(
        dataclasses.replace(one, position_gain=factor * one.position_gain) for one in config.joints
    )
    run.drives.retune(dataclasses.replace(config, joints=joints))
