"""Hands of a page on machines of field buses and firmware: fulfilled between two ticks only."""

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
def serve_requests(
    controls: MachineControls, ask: Callable[[_PipedControls], None]
) -> Iterator[ControlServer]:
    near, far = Pipe()
    failed: list[BaseException] = []

    def work() -> None:
        try:
            ask(_PipedControls(os.dup(far.fileno()), controls.can()))
        except BaseException as error:
            failed.append(error)

    worker = threading.Thread(target=work)
    worker.start()
    yield ControlServer(controls, near)
    worker.join()
    assert not failed, failed


def test_requests_are_fulfilled_between_two_ticks() -> None:
    plant, responses = Plant("three_axis"), []
    controls = MachineControls(plant, steps=True)

    def ask(there: _PipedControls) -> None:
        responses.append(there.do_action("pause", True))
        responses.append(there.do_action("step", 7))
        while controls.due:  # until they have passed
            time.sleep(1e-3)
        with pytest.raises(Refusal, match="joint"):
            there.do_action("set_varied", "joints.elbow.motor.resistance", 2.0)
        responses.append(there.do_action("power", False))
        responses.append(there.do_action("pause", False))
        assert [text for _, text in there.news().events] == ["power off"]

    observed = []

    def advance(ticks: int) -> None:
        observed.append((ticks, controls.paused, plant.powered))
        for _ in range(ticks):
            plant.exchange(np.zeros(3))

    with serve_requests(controls, ask) as server:
        while "going on" not in responses:
            server.advance_ticks(advance, 2000)
    assert responses == ["paused", "7 more", "power off", "going on"]
    alone = [ticks for ticks, paused, _ in observed if paused]
    assert alone == [7], "while it is paused the ticks that were asked for pass alone"
    assert not plant.powered


def test_a_server_without_a_page_does_nothing() -> None:
    server, done = ControlServer(MachineControls(Plant("three_axis"))), []
    assert server.poll_requests()
    server.advance_ticks(done.append, 12345)
    assert done == [12345]


def test_a_thread_fulfils_where_a_session_is_advanced_by_others() -> None:
    session = Session("three_axis", "lockstep", "first_answer")
    controls, over = MachineControls(session), threading.Event()

    def ask(there: _PipedControls) -> None:
        there.do_action("power", False)
        there.do_action("pause", True)
        before = session.tick
        assert there.can() == controls.can() and session.tick == before, "it stands"
        there.do_action("pause", False)
        over.set()

    with serve_requests(controls, ask) as server:
        thread = threading.Thread(target=server.attend_always, args=[session])
        thread.start()
        while not over.is_set():
            session.offer(session.tick, session.scene.joint_names, [1.0, 0.0, 0.0])
            session.advance()
        server.close()
        thread.join()
    assert not session.powered


def test_a_scene_has_the_controls_that_it_supports() -> None:
    can = MachineControls(Plant("three_axis")).can()
    assert {"pause", "power"} <= can and not {"push", "set_varied", "step", "aim"} & can


@pytest.mark.parametrize("paused", [False, True])
def test_a_machine_goes_on_when_its_page_has_ended(
    paused: bool, capfd: pytest.CaptureFixture[str]
) -> None:
    """A page that was killed can let no time go on."""
    near, far = Pipe()
    controls = MachineControls(Plant("three_axis"))
    server = ControlServer(controls, near)
    far.send((1, "pause", (paused,)))
    worker = threading.Thread(target=lambda: (far.recv(), far.close()))
    worker.start()
    assert server.poll_requests(), "it would stay here while time stands still"
    worker.join()
    done: list[int] = []
    server.advance_ticks(done.append, 2500)
    assert sum(done) == 2500 and not controls.paused
    assert capfd.readouterr().err.count("its process has ended") == 1
    assert server.poll_requests() and not capfd.readouterr().err


def test_a_server_handles_anything_that_a_browser_sends() -> None:
    plant = Plant("three_axis")
    controls = MachineControls(plant)

    def ask(there: _PipedControls) -> None:
        for request, inputs in (
            ("save", ("x",)), ("tick", ()), ("_machine", ()), ("__init__", (plant,)), ("can", (1,)),
            ("set_varied", ()), ("push", ("tool", "force", None)), ("set_varied", (None, "x")),
        ):  # fmt: skip
            with pytest.raises(Refusal):
                there.ask_server(request, *inputs)
        assert there.do_action("power", False) == "power off"

    with serve_requests(controls, ask) as server:
        while plant.powered:
            server.poll_requests()


def test_an_answer_that_is_late_is_not_taken_for_another(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("arm_emulator.page.control_server.PATIENCE", 0.05)
    near, far = Pipe()
    there = _PipedControls(os.dup(far.fileno()), frozenset())
    with pytest.raises(Refusal, match="answer within"):
        there.ask_server("pause", True)
    first, *_ = near.recv()
    near.send((first, 1, "late"))
    near.send((first + 1, 2, "now"))
    assert there.ask_server("pause", False) == "now"
