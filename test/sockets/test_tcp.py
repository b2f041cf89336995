"""The machine behind lines of JSON, against `Plant` under the same commands."""

from __future__ import annotations

import contextlib
import json
import socket
import time
from contextlib import AbstractContextManager
from typing import Any

import numpy as np
import pytest
from serving import serving

from arm_emulator import Plant, Refusal, Session, load_scene
from arm_emulator.doors.json_lines import LONGEST, TcpServer
from arm_emulator.machine.session.real_time import open_real_time_session

SCENE = load_scene("three_axis")
PATIENCE = 120.0  # s


def lockstep() -> Session:
    return Session(SCENE, "lockstep", "first_answer")


class Client:
    """Lines to a server and back."""

    def __init__(self, server: TcpServer) -> None:
        self.socket = socket.create_connection(server.address, timeout=PATIENCE)
        self._lines = self.socket.makefile("rwb")
        self.greeting: dict[str, Any] = json.loads(self._lines.readline())

    def __enter__(self) -> Client:
        return self

    def __exit__(self, *_: object) -> None:
        self._lines.close()
        self.socket.close()

    def ask(self, **request: Any) -> dict[str, Any]:
        self._lines.write(json.dumps(request).encode() + b"\n")
        self._lines.flush()
        reply: dict[str, Any] = json.loads(self._lines.readline())
        return reply


def served(session: Session) -> AbstractContextManager[TcpServer]:
    """Serve a session on a port that is free."""
    return serving(TcpServer(session, port=0), session)


def test_clients_in_sequence_get_the_bits_of_the_plant() -> None:
    rng, plant, session = np.random.default_rng(1), Plant(SCENE), lockstep()
    with served(session) as server:
        for turn in range(2):
            with Client(server) as client:
                reply = client.ask()
                assert client.greeting["joints"] == list(SCENE.joint_names)
                assert client.greeting["command"] == ["V", "V", "V"]
                assert client.greeting["outputs"].keys() <= reply.keys()
                for k in range(50):
                    assert reply["tick"] == 50 * turn + k
                    command, powered = rng.uniform(-20.0, 20.0, 3), k % 7 != 3
                    plant.powered = powered
                    plant.exchange(command, reply["tick"])
                    request = {"command": command.tolist(), "tick": reply["tick"], "power": powered}
                    reply = client.ask(**request)
                    assert reply["power"] == powered
                    assert client.ask(**request) == reply, "a command that comes again"
                    for name in ("encoder_counts", "current", "applied"):
                        assert reply[name] == getattr(plant.measured, name).tolist(), name
    assert session.plant.save() == plant.save()


def test_lines_of_every_invalid_kind_are_refused_and_change_no_bit() -> None:
    server, good = TcpServer(lockstep(), port=0), {"command": [1.0, 2.0, 3.0]}
    state, before = server.answer_line(b"{}"), server._session.plant.save()
    wrong = [
        b"", b"{", b"\xff\xfe", b"[" * 10_000, b"[1.0, 2.0, 3.0]", b"null", b'{"colour": 1}',
        b'{"power": false}', b'{"power": true, "tick": 0}',
        *(json.dumps(good | change).encode() for change in (
            {"command": [1.0, 2.0]}, {"command": 1.0}, {"command": None},
            {"command": ["a", "b", "c"]}, {"command": [[1.0], 2.0, 3.0]},
            {"command": [True, 2.0, 3.0]}, {"command": [float("nan"), 0.0, 0.0]},
            {"command": [float("inf"), 0.0, 0.0]}, {"command": [10**400, 0, 0]}, {"tick": 1},
            {"tick": -2}, {"tick": 0.5}, {"tick": True}, {"tick": 2**70}, {"power": 1},
            {"reset": "yes"}, {"command_d": [0.0, 0.0, 0.0]},
        )),
    ]  # fmt: skip
    for line in wrong:
        reply = json.loads(server.answer_line(line))
        assert reply.keys() == {"refused"} and "\n" not in reply["refused"], line
        assert server.answer_line(b"{}") == state and server._session.plant.save() == before, line
    assert server.refused == len(wrong)
    server._session.close()


def test_further_inputs_and_resets() -> None:
    stepper = {"kind": "stepper", "torque_per_current": 0.2, "teeth": 50, "rotor_inertia": 1e-4,
               "bandwidth": 1000.0}  # fmt: skip
    scene = load_scene("three_axis", {"joints.elbow.motor": stepper})
    with served(Session(scene, "lockstep", "first_answer")) as server:
        with Client(server) as client:
            first = client.ask()
            assert client.greeting["inputs"] == ["command_b"]
            reply = client.ask(command=[0.0, 0.0, 1.0], command_b=[0.0, 0.0, 2.0])
            assert reply["applied_b"] == [0.0, 0.0, 2.0]
            refused = client.ask(command_b=[0.0, 0.0, 2.0])
            assert "command must be given with power or further inputs" in refused["refused"]
            assert client.ask(reset=True, power=False) == first, "a reset is the beginning"


def test_a_line_without_end_ends_the_client_and_not_the_server() -> None:
    with served(lockstep()) as server:
        with contextlib.suppress(ConnectionError), Client(server) as client:
            client.socket.sendall(b"x" * (4 * LONGEST))
            assert not client.socket.recv(1)
        with Client(server) as client:
            assert client.ask()["tick"] == 0


def test_in_real_time_ticks_pass_by_themselves() -> None:
    with served(open_real_time_session(SCENE, "first_answer")) as server, Client(server) as client:
        assert client.ask()["tick"] == 0, "it stands until the first command"
        reply = client.ask(command=[3.0, 0.0, 0.0])
        ends = time.monotonic() + PATIENCE
        while reply["tick"] < 20 and time.monotonic() < ends:
            reply = client.ask()
        assert reply["tick"] >= 20 and reply["applied"] == [3.0, 0.0, 0.0]


def test_an_address_that_is_taken_is_refused() -> None:
    with socket.create_server(("127.0.0.1", 0)) as listener:
        port = listener.getsockname()[1]
        with pytest.raises(Refusal, match=f"address 127.0.0.1:{port} must be free"):
            TcpServer(lockstep(), port=port)
