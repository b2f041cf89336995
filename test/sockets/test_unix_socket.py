"""The machine behind a Unix socket; the lines themselves: test_tcp.py."""

import json
import socket
import stat
from pathlib import Path

import numpy as np
import pytest
from serving import serving

from arm_emulator import Plant, Refusal, Session, load_scene
from arm_emulator.doors.json_lines import UnixSocketServer

SCENE = load_scene("three_axis")
PATIENCE = 120.0  # s


def lockstep() -> Session:
    return Session(SCENE, "lockstep", "first_answer")


def test_clients_get_the_bits_of_the_plant_and_the_file_goes(tmp_path: Path) -> None:
    rng, plant, session, path = np.random.default_rng(1), Plant(SCENE), lockstep(), tmp_path / "s"
    with serving(UnixSocketServer(session, path), session):
        assert stat.S_IMODE(path.stat().st_mode) == 0o600, "for its user alone"
        for _ in range(2):
            with socket.socket(socket.AF_UNIX) as client:
                client.settimeout(PATIENCE)
                client.connect(str(path))
                with client.makefile("rwb") as lines:
                    assert json.loads(lines.readline())["joints"] == list(SCENE.joint_names)
                    for _ in range(20):
                        command = rng.uniform(-20.0, 20.0, 3)
                        plant.exchange(command, session.tick)
                        lines.write(json.dumps({"command": command.tolist()}).encode() + b"\n")
                        lines.flush()
                        reply = json.loads(lines.readline())
                        assert reply["encoder_counts"] == plant.measured.encoder_counts.tolist()
    assert session.plant.save() == plant.save()
    assert not path.exists()


def test_only_a_name_that_is_free_or_a_socket_that_was_left_is_taken(tmp_path: Path) -> None:
    path, session = tmp_path / "s", lockstep()
    with socket.socket(socket.AF_UNIX) as killed:
        killed.bind(str(path))  # and closed, as the system does for a killed process
    with serving(UnixSocketServer(session, path), session):
        with pytest.raises(Refusal, match=r"unix-socket: path must be free, got .*in use"):
            UnixSocketServer(lockstep(), path)
        assert path.exists(), "the first one goes on"
    path.write_text("mine")
    (tmp_path / "link").symlink_to(path)
    wrong: list[str | Path] = [
        path,
        tmp_path / "link",
        tmp_path,
        tmp_path / "no/s",
        tmp_path / ("s" * 200),
        "s\0",
    ]
    for path_to_take in wrong:
        with pytest.raises(Refusal, match="unix-socket: path must be free"):
            UnixSocketServer(lockstep(), path_to_take)
    assert path.read_text() == "mine"
