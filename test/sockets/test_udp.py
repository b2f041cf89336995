"""The machine behind a UDP socket, against `Plant` under the same commands."""

import shutil
import socket
import subprocess
from contextlib import AbstractContextManager
from pathlib import Path

import numpy as np
import pytest
from serving import serving

from arm_emulator import Plant, Refusal, Session, load_scene
from arm_emulator.doors.udp import (
    GREETING,
    POWER,
    POWERED,
    REFUSED,
    RESET,
    STOPPED,
    Datagrams,
    UdpServer,
)  # fmt: skip
from arm_emulator.machine.session.real_time import open_real_time_session

SCENE = load_scene("three_axis")
EXAMPLE = Path(__file__).resolve().parents[2] / "examples" / "udp_servo.c"
PATIENCE = 120.0  # s
TICKS = 2000  # of the example
PMSM = {"kind": "pmsm", "resistance": 0.5, "inductance_d": 1e-3, "inductance_q": 1e-3, "flux": 0.01,
        "pole_pairs": 4, "rotor_inertia": 1e-4}  # fmt: skip


def served(session: Session) -> AbstractContextManager[UdpServer]:
    """Serve a session on a port that is free."""
    return serving(UdpServer(session, port=0), session)


def lockstep() -> Session:
    return Session(SCENE, "lockstep", "first_answer")


def datagram(kinds: Datagrams, tick: int, command: object = 0.0, control: int = POWER) -> bytes:
    fields = np.zeros((), kinds.command)
    fields["layout"], fields["tick"], fields["control"] = kinds.layout, tick, control
    fields["command"] = command
    return fields.tobytes()


def read(server: UdpServer, reply: bytes) -> np.void:
    assert not reply.startswith(REFUSED), reply
    fields: np.void = np.frombuffer(reply, server.datagrams.measurement)[0]
    return fields


def built(folder: Path) -> Path:
    """Compile the example with the header of its scene."""
    shutil.copy(EXAMPLE, folder)
    (folder / "udp_three_axis.h").write_text(Datagrams(SCENE).write_header())
    command = [
        "cc",
        "-Wall",
        "-Wextra",
        "-Werror",
        "-ffp-contract=off",
        "udp_servo.c",
        "-o",
        "servo",
    ]
    subprocess.run(command, cwd=folder, check=True)
    return folder / "servo"


def test_a_servo_in_c_gives_the_bits_of_the_plant(tmp_path: Path) -> None:
    plant, target = Plant(SCENE), np.array([9000.0, 1000.0, 14000.0])
    counts = before = plant.measured.encoder_counts
    for tick in range(TICKS):
        plant.exchange(0.004 * (target - counts) - 0.04 * (counts - before), tick)
        before, counts = counts, plant.measured.encoder_counts
    session = lockstep()
    with served(session) as server:
        words = [built(tmp_path), str(server.address[1])]
        done = subprocess.run(words, capture_output=True, text=True, check=True, timeout=PATIENCE)
    lines = [f"{name} {n}" for name, n in zip(SCENE.joint_names, counts, strict=True)]
    assert done.stdout.splitlines() == lines
    assert session.plant.save() == plant.save() and session.tick == TICKS


def test_lost_doubled_and_damaged_datagrams_change_no_bit() -> None:
    rng, plant, server = np.random.default_rng(3), Plant(SCENE), UdpServer(lockstep(), port=0)
    refused = 0
    for tick in range(300):
        command = rng.uniform(-20.0, 20.0, 3)
        plant.exchange(command)
        sound = datagram(server.datagrams, tick, command)
        for _ in range(int(rng.integers(0, 3))):
            damaged = bytearray(sound)
            match rng.integers(0, 6):
                case 0:  # too short
                    damaged = damaged[: int(rng.integers(0, len(damaged)))]
                case 1:
                    damaged += bytes(8)
                case 2:  # another layout
                    damaged[int(rng.integers(0, 8))] ^= 1 << int(rng.integers(0, 8))
                case 3:  # of the future, or long past
                    ahead = int(rng.choice([-7, -2, 1, 2**40]))
                    damaged = bytearray(datagram(server.datagrams, tick + ahead - (ahead < 0)))
                case 4:  # not finite, or too large
                    values = np.where(
                        np.arange(3) == rng.integers(3), rng.choice([np.nan, np.inf, 1e10]), command
                    )
                    damaged = bytearray(datagram(server.datagrams, tick, values))
                case 5:  # unknown bits
                    damaged = bytearray(
                        datagram(server.datagrams, tick, command, 1 << int(rng.integers(2, 63)))
                    )
            if damaged[8:16] == np.int64(GREETING).tobytes():
                continue  # it asks, and is answered
            refused += 1
            assert server.answer_datagram(bytes(damaged)).startswith(REFUSED), damaged
        for _ in range(int(rng.integers(1, 4))):  # a reply was lost: the command comes again
            reply = read(server, server.answer_datagram(sound))
            assert reply["tick"] == tick + 1
        np.testing.assert_array_equal(reply["encoder_counts"], plant.measured.encoder_counts)
        np.testing.assert_array_equal(reply["current"], plant.measured.current)
    assert server.refused == refused > 100


def test_power_reset_and_divergence_come_as_bits() -> None:
    server = UdpServer(lockstep(), port=0)
    kinds = server.datagrams
    first = server.answer_datagram(datagram(kinds, GREETING))
    assert read(server, first)["status"] == POWERED
    off = read(server, server.answer_datagram(datagram(kinds, 0, 5.0, control=0)))
    assert off["status"] == 0 and not off["applied"].any() and off["tick"] == 1
    assert (
        read(server, server.answer_datagram(datagram(kinds, 1, 5.0)))["applied"].tolist()
        == [5.0] * 3
    )
    again = read(server, server.answer_datagram(datagram(kinds, 0, 5.0, control=POWER | RESET)))
    assert again.tobytes() == first, "a reset is the beginning"
    session = server._session
    session.set_state(["waist"], {"v": [1e5]})
    for tick in range(50):
        status = read(server, server.answer_datagram(datagram(kinds, tick)))["status"]
        if status & STOPPED:
            break
    assert status == POWERED | STOPPED


def test_in_real_time_each_tick_goes_to_the_client() -> None:
    with (
        served(open_real_time_session(SCENE, "first_answer")) as server,
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as client,
    ):
        client.settimeout(PATIENCE)
        client.connect(server.address)
        client.send(datagram(server.datagrams, GREETING))
        assert read(server, client.recv(4096))["tick"] == 0, "it stands until the first command"
        client.send(datagram(server.datagrams, 0, [3.0, 0.0, 0.0]))
        ticks = [int(read(server, client.recv(4096))["tick"]) for _ in range(100)]
    steps = np.diff(ticks[1:])
    assert (steps >= 0).all() and ticks[-1] > 90
    assert (steps <= 1).mean() > 0.9, "the loop reports each tick"


@pytest.mark.parametrize(
    "changes",
    [
        {},
        {"joints.elbow.link_encoder": {"counts_per_turn": 4096},
         "joints.waist.tachometer": {"noise": 0.1},
         "imus.hand": {"link": "forearm", "gyroscope": {}}},
        {"joints.waist.motor": PMSM},
    ],
    ids=["plain", "sensors", "pmsm"],
)  # fmt: skip
def test_the_header_has_the_bytes_of_the_datagrams(
    changes: dict[str, object], tmp_path: Path
) -> None:
    kinds = Datagrams(load_scene("three_axis", changes))
    (tmp_path / "udp.h").write_text(kinds.write_header())
    sizes = "".join(
        f"_Static_assert(sizeof(arm_udp_{name}) == {kind.itemsize}, \"\");\n"
        + "".join(
            f"_Static_assert(offsetof(arm_udp_{name}, {field}) == {kind.fields[field][1]}, \"\");\n"
            for field in kind.names or () if kind.fields
        )
        for name, kind in (("command", kinds.command), ("measurement", kinds.measurement))
    )  # fmt: skip
    (tmp_path / "sizes.c").write_text(f'#include <stddef.h>\n#include "udp.h"\n{sizes}')
    subprocess.run(["cc", "-Wall", "-Werror", "-fsyntax-only", "sizes.c"], cwd=tmp_path, check=True)


def test_an_address_that_is_taken_is_refused() -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as listener:
        listener.bind(("127.0.0.1", 0))
        port = listener.getsockname()[1]
        with pytest.raises(Refusal, match=f"address 127.0.0.1:{port} must be free"):
            UdpServer(lockstep(), port=port)
