"""Hands of a page on machines of field buses and firmware: fulfilled between two ticks only."""

from __future__ import annotations

import os
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from multiprocessing import Pipe

import numpy as np
import pytest

from arm_emulator import Plant, Refusal, Session
from arm_emulator.page.control_server import ControlServer, MachineControls, _PipedControls


@contextmanager
def asked(hands: MachineControls, ask: Callable[[_PipedControls], None]) -> Iterator[ControlServer]:
    """Yield a server that a thread asks for something."""
    near, far = Pipe()
    failed: list[BaseException] = []

    def work() -> None:
        try:
            ask(_PipedControls(os.dup(far.fileno()), hands.can()))
        except BaseException as error:
            failed.append(error)

    worker = threading.Thread(target=work)
    worker.start()
    yield ControlServer(hands, near)
    worker.join()
    assert not failed, failed


def test_requests_are_fulfilled_between_two_ticks() -> None:
    plant, answers = Plant("three_axis"), []
    hands = MachineControls(plant, steps=True)

    def ask(there: _PipedControls) -> None:
        answers.append(there.do("pause", True))
        answers.append(there.do("step", 7))
        while hands.due:  # until they have passed
            time.sleep(1e-3)
        with pytest.raises(Refusal, match="joint"):
            there.do("set_varied", "joints.elbow.motor.resistance", 2.0)
        answers.append(there.do("power", False))
        answers.append(there.do("pause", False))
        assert [text for _, text in there.news().events] == ["power off"]

    seen = []

    def advance(ticks: int) -> None:
        seen.append((ticks, hands.paused, plant.powered))
        for _ in range(ticks):
            plant.exchange(np.zeros(3))

    with asked(hands, ask) as desk:
        while "going on" not in answers:
            desk.drive(advance, 2000)
    assert answers == ["paused", "7 more", "power off", "going on"]
    alone = [ticks for ticks, paused, _ in seen if paused]
    assert alone == [7], "while it is paused the ticks that were asked for pass alone"
    assert not plant.powered


def test_a_desk_without_a_page_does_nothing() -> None:
    desk, done = ControlServer(MachineControls(Plant("three_axis"))), []
    assert desk.poll()
    desk.drive(done.append, 12345)
    assert done == [12345]


def test_a_thread_fulfils_where_a_session_is_advanced_by_others() -> None:
    session = Session("three_axis", "lockstep", "first_answer")
    hands, over = MachineControls(session), threading.Event()

    def ask(there: _PipedControls) -> None:
        there.do("power", False)
        there.do("pause", True)
        before = session.tick
        assert there.can() == hands.can() and session.tick == before, "it stands"
        there.do("pause", False)
        over.set()

    with asked(hands, ask) as desk:
        thread = threading.Thread(target=desk.attend_always, args=[session])
        thread.start()
        while not over.is_set():
            session.offer(session.tick, session.scene.joint_names, [1.0, 0.0, 0.0])
            session.advance()
        desk.close()
        thread.join()
    assert not session.powered


def test_a_scene_has_the_hands_that_it_can_bear() -> None:
    can = MachineControls(Plant("three_axis")).can()
    assert {"pause", "power"} <= can and not {"push", "set_varied", "step", "aim"} & can


@pytest.mark.parametrize("paused", [False, True])
def test_a_machine_goes_on_when_its_page_has_ended(
    paused: bool, capfd: pytest.CaptureFixture[str]
) -> None:
    """A page that was killed can let no time go on."""
    near, far = Pipe()
    hands = MachineControls(Plant("three_axis"))
    desk = ControlServer(hands, near)
    far.send((1, "pause", (paused,)))
    worker = threading.Thread(target=lambda: (far.recv(), far.close()))
    worker.start()
    assert desk.poll(), "it would stay here while time stands still"
    worker.join()
    done: list[int] = []
    desk.drive(done.append, 2500)
    assert sum(done) == 2500 and not hands.paused
    assert capfd.readouterr().err.count("its process has ended") == 1
    assert desk.poll() and not capfd.readouterr().err


def test_a_desk_answers_anything_that_a_browser_sends() -> None:
    plant = Plant("three_axis")
    hands = MachineControls(plant)

    def ask(there: _PipedControls) -> None:
        for what, given in (
            ("save", ("x",)), ("tick", ()), ("_machine", ()), ("__init__", (plant,)), ("can", (1,)),
            ("set_varied", ()), ("push", ("tool", "force", None)), ("set_varied", (None, "x")),
        ):  # fmt: skip
            with pytest.raises(Refusal):
                there.ask(what, *given)
        assert there.do("power", False) == "power off"

    with asked(hands, ask) as desk:
        while plant.powered:
            desk.poll()


def test_an_answer_that_is_late_is_not_taken_for_another(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("arm_emulator.page.control_server.PATIENCE", 0.05)
    near, far = Pipe()
    there = _PipedControls(os.dup(far.fileno()), frozenset())
    with pytest.raises(Refusal, match="answer within"):
        there.ask("pause", True)
    first, *_ = near.recv()
    near.send((first, 1, "late"))
    near.send((first + 1, 2, "now"))
    assert there.ask("pause", False) == "now"
