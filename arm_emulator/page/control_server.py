"""Actions of a page in another process: requests through a pipe, answered between two ticks."""

from __future__ import annotations

import contextlib
import sys
import threading
from collections.abc import Callable, Iterator
from functools import partial
from multiprocessing import Pipe
from multiprocessing.connection import Connection
from typing import Any

from arm_emulator.base.refusal import Refusal
from arm_emulator.machine.plant.external_wrench import ExternalWrench
from arm_emulator.machine.plant.plant import Plant
from arm_emulator.machine.session.session import Session
from arm_emulator.page.controls import Controls, News, Vector
from arm_emulator.page.page_process import PageProcess

PATIENCE = 10.0  # s, wall: for an answer
PIECE = 1000  # ticks between two looks
LOOK = 0.05  # s, wall, between two looks for requests while time stands still


class ControlServer:
    """The machine's side: answers the requests of a page. Without a page it does nothing.

    Args:
        hands: actions on the machine.
        near: end of the pipe; None: there is no page.
    """

    def __init__(self, controls: MachineControls, near: Connection | None = None) -> None:
        self._controls, self._near, self._closing = controls, near, threading.Event()
        self._served = near is not None

    def poll_requests(self) -> bool:
        """Answer waiting requests between two ticks; while time stands still on request, stay here.

        Returns:
            True, for the conditions of loops.
        """
        self._answer_requests(0.0)
        while self._controls.is_waiting and not self._closing.is_set():
            self._answer_requests(LOOK)
        return True

    def advance_ticks(self, advance: Callable[[int], None], ticks: int) -> None:
        """Let so many ticks pass, and answer requests in between."""
        if not self._served:
            advance(ticks)
            return
        while ticks > 0 and self.poll_requests():
            piece = min(ticks, self._controls.due or PIECE)
            advance(piece)
            ticks -= piece
            self._controls.due = max(0, self._controls.due - piece)
        self._controls.changed()

    def attend_always(self, session: Session) -> None:
        """Answer requests in a thread, while its owner lets the session's time pass."""
        while not self._closing.is_set() and self._near is not None:
            if self._has_request():
                with session.turn, session.between_ticks():
                    self.poll_requests()

    def _has_request(self) -> bool:
        """Return whether a request waits, or the page has ended."""
        try:
            return self._near is not None and self._near.poll(LOOK)
        except OSError:
            return True

    def close(self) -> None:
        """Answer no more requests."""
        self._closing.set()

    def _answer_requests(self, timeout: float) -> None:
        if self._near is None:
            return
        try:
            while self._near.poll(timeout):
                number, action, arguments = self._near.recv()
                self._near.send(
                    (number, self._controls.tick, self._answer_request(action, arguments))
                )
                timeout = 0.0
        except (OSError, EOFError):
            self._near = None
            if not self._closing.is_set():
                self._go_on_alone()

    def _answer_request(self, action: str, arguments: tuple[Any, ...]) -> Any:
        """Return the answer to a request, which a browser may have filled with anything."""
        try:
            if action not in Controls.can(self._controls):
                raise Refusal("page", "action", "be possible here", action)
            return getattr(self._controls, action)(*arguments)
        except Refusal as reason:
            return reason
        except (TypeError, ValueError, LookupError, ArithmeticError) as error:
            return Refusal("page", action, "have values that it can take", repr(error))

    def _go_on_alone(self) -> None:
        """Let time pass again, since the page that may have stopped it has ended."""
        words = "the machine goes on"
        if self._controls.paused:
            self._controls.pause(False)
            words = "the machine, which it had paused, goes on"
        print(f"page: its process has ended; {words}", file=sys.stderr, flush=True)


@contextlib.contextmanager
def serve_controls(
    machine: Plant | Session, at: str | int | None, *, steps: bool = False, waits: bool = False
) -> Iterator[ControlServer]:
    """Serve a page with a machine, and with actions on it, in this block.

    The owner of a plant calls `poll_requests` of the server between two ticks; the owner of a
    session need not.

    Args:
        machine: a plant, or a session.
        at: [HOST:]PORT of the page, see `PageServer`; None: no page.
        steps: whether the owner lets single ticks pass, see `MachineControls`.
        waits: see `PageProcess`.

    Raises:
        Refusal: see `PageProcess`.
    """
    controls = MachineControls(machine, steps)
    if at is None:
        yield ControlServer(controls)
        return
    near, far = Pipe()
    plant = machine.plant if isinstance(machine, Session) else machine
    with contextlib.closing(near):
        with contextlib.closing(far):
            there = partial(_PipedControls, far.fileno(), controls.can())
            page = PageProcess(plant, at, there, (far.fileno(),), waits)
        server = ControlServer(controls, near)
        controls.changed = page.show_machine
        with page:
            print(f"page: {page.url}", flush=True)
            thread = None
            if isinstance(machine, Session):
                thread = threading.Thread(target=server.attend_always, args=[machine], daemon=True)
                thread.start()
            try:
                yield server
            finally:
                server.close()
                if thread is not None:
                    thread.join()


class _PipedControls(Controls):
    """Actions that are requests to a `ControlServer`; see `Controls`.

    Args:
        descriptor: of the pipe in this process, the page's.
        able: names of the actions that the server takes.
    """

    def __init__(self, descriptor: int, able: frozenset[str]) -> None:
        self._pipe, self._able, self._turn = Connection(descriptor), able, threading.Lock()
        self._events: list[tuple[int, str]] = []
        self._paused: bool | None = None
        self._tick, self._number = 0, 0

    def can(self) -> frozenset[str]:
        return self._able

    def news(self) -> News:
        news = News("paused" if self._paused else "", self._paused, None, self._events)
        self._events = []
        return news

    def ask_server(self, action: str, *arguments: Any) -> Any:
        """Return the answer of the server.

        Raises:
            Refusal: it has refused, or does not answer.
        """
        with self._turn:
            self._number += 1
            try:
                self._pipe.send((self._number, action, arguments))
                number = 0
                while number != self._number:  # others came too late for their requests
                    if not self._pipe.poll(PATIENCE):
                        rule = f"answer within {PATIENCE:g} s"
                        raise Refusal("page", "machine", rule, "no answer")
                    number, self._tick, answer = self._pipe.recv()
            except (OSError, EOFError):
                raise Refusal("page", "machine", "go on", "one that has ended") from None
        if isinstance(answer, Refusal):
            raise answer
        return answer

    def do_action(self, action: str, *arguments: Any) -> str:
        answer = str(self.ask_server(action, *arguments))
        if action == "pause":
            self._paused = arguments[0]
        elif action != "step":
            self._events.append((self._tick, answer))
        return answer


class MachineControls(Controls):
    """Changes a plant or a session; its owner calls it between two ticks.

    Attributes:
        paused: whether time has to stand still.
        due: ticks that may pass all the same.
        changed: is called after each change.

    Args:
        machine: a plant, or a session.
        steps: whether its owner lets `due` ticks pass while it is paused.
    """

    def __init__(self, machine: Plant | Session, steps: bool = False) -> None:
        self._machine, self._steps = machine, steps
        self.paused, self.due = False, 0
        self.changed: Callable[[], None] = lambda: None

    def can(self) -> frozenset[str]:
        """Return the actions that this scene and this owner permit."""
        scene = self._machine.scene
        able = set(super().can())
        able -= set() if self._steps else {"step"}
        able -= set() if scene.varied else {"set_varied"}
        return frozenset(able - (set() if scene.external_wrench else {"push"}))

    @property
    def tick(self) -> int:
        """Servo periods that have passed."""
        machine = self._machine
        if isinstance(machine, Session):
            return machine.tick
        return round(machine.t / machine.scene.servo_period)

    @property
    def is_waiting(self) -> bool:
        """Whether no tick may pass now."""
        return self.paused and not self.due

    def pause(self, on: bool) -> str:
        """Let time stand still, or go on."""
        self.paused, self.due = on, 0
        return "paused" if on else "going on"

    def step(self, ticks: int) -> str:
        """Let so many servo periods pass while time stands still."""
        if not self.paused:
            raise Refusal("page", "step", "come while time stands still", "a machine that goes on")
        self.due += ticks
        return f"{ticks} more"

    def power(self, on: bool) -> str:
        """Switch the drives' power."""
        self._machine.powered = on
        self.changed()
        return f"power {'on' if on else 'off'}"

    def set_varied(self, name: str, value: float) -> str:
        """Set a number that the scene lists as varied."""
        machine = self._machine
        put = machine.set_varied if isinstance(machine, Session) else machine.set_parameter
        put(name, value)
        self.changed()
        return f"{name} = {value:g}"

    def push(self, link: str, force: Vector, moment: Vector) -> str:
        """Let a force and a moment act on a link from now on, along the world's axes."""
        self._machine.set_external_wrench(link, ExternalWrench(force, moment, axes="world"))
        self.changed()
        return f"{link} is pushed"
