"""A machine changed by hand, drawn: for tests of bags, brakes and of what changes at run time."""

import random
import shutil
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import yaml
from in_process import InProcess
from network import JOINTS, PATIENCE
from rclpy.serialization import deserialize_message

from arm_emulator import load_scene
from arm_emulator.machine.varied import Varied
from arm_emulator.ros.recording.bag import Bag
from arm_emulator_msgs.msg import MachineEvent
from arm_emulator_msgs.srv import RestoreState, SaveState, SetState, SetVaried

CLOCKS = ("lockstep", "realtime")
QUANTITIES = ("position", "velocity", "motor_position", "motor_velocity", "current")
RATIO = {joint.name: joint.gear.ratio for joint in load_scene("three_axis").joints}
Call = Callable[[str, Any], Any]  # of a service


@pytest.fixture(scope="module")
def varied(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The three-axis arm with sensors, and with numbers that can be set while it runs."""
    folder, config = (
        tmp_path_factory.mktemp("varied"),
        Path(__file__).resolve().parents[1] / "config",
    )
    shutil.copytree(config / "urdf", folder / "urdf")
    scene = yaml.safe_load((config / "three_axis.yaml").read_text())
    joints = scene["joints"]
    joints["waist"]["encoder"] |= {"index": "latch", "missed": 0.01, "noise": 1e-3}
    joints["shoulder"]["link_encoder"] = {"kind": "absolute", "counts_per_turn": 4096, "bits": 12}
    joints["shoulder"]["torque_sensor"] = {"noise": 0.1, "delay": 2}
    joints["elbow"]["current_sensor"] = {"noise": 0.05, "offset": 0.0, "delay": 1}
    numbers = ["joints.*.motor.resistance", "joints.*.gear.stiffness"]
    sensors = {"missed": "waist.encoder", "offset": "elbow.current_sensor"}
    scene["varied"] = numbers + [f"joints.{place}.{key}" for key, place in sensors.items()]
    faults = "waist.encoder_misses_edges", "elbow.gear_breaks", "elbow.current_sensor_gain"
    scene["faults"] = list(faults)
    scene["imus"] = {"hand": {"link": "forearm", "gyroscope": {"noise": 1e-3}}}
    (folder / "three_axis.yaml").write_text(yaml.safe_dump(scene))
    return folder / "three_axis.yaml"


def sound_set_state(draw: random.Random) -> SetState.Request:
    """Some joints somewhere near, with their motors."""
    names = draw.sample(JOINTS, draw.randrange(1, 4))
    position = [draw.uniform(-1.0, 1.0) for _ in names]
    velocity = [draw.uniform(-0.5, 0.5) for _ in names]
    ratio = [RATIO[name] for name in names]
    values = {
        "position": position,
        "velocity": velocity,
        "motor_position": [
            q / n + draw.gauss(0, 1e-3) for q, n in zip(position, ratio, strict=True)
        ],
        "motor_velocity": [v / n for v, n in zip(velocity, ratio, strict=True)],
        "current": [draw.uniform(-0.5, 0.5) for _ in names],
    }
    quantities = draw.choice(
        [QUANTITIES, ("position", "motor_position"), ("current",), ("velocity",)]
    )
    return SetState.Request(joint_names=names, **{name: values[name] for name in quantities})


class ByHand:
    """Changes a machine by random sound calls, and keeps what it has saved."""

    def __init__(self, draw: random.Random, call: Call, varied: tuple[Varied, ...] = ()) -> None:
        self._varied = varied
        self.kinds: set[str] = set()  # what was done
        self.bursts = [0]  # how many things one right after the other
        self._draw, self._call = draw, call
        self._saved: list[bytes] = []
        self._names: list[str] = []

    def change(self, reset: bool = True) -> None:
        """Do one thing, at random."""
        draw = self._draw
        kinds = {"set_state": 4, "save_state": 3, "restore_state": 4, "power": 2}
        kinds |= {"reset": int(reset), "set_varied": 3 * bool(self._varied)}
        kind = draw.choices(list(kinds), list(kinds.values()))[0]
        request: Any = None
        if kind == "set_state":
            request = sound_set_state(draw)
        elif kind == "save_state":
            request = SaveState.Request(name=draw.choice(["", "one", "another"]))
        elif kind == "set_varied":
            number = draw.choice(self._varied)
            value = max(number.value, 0.1) * draw.uniform(0.8, 1.25)
            request = SetVaried.Request(name=number.name, value=value)
        elif kind == "power":
            request = draw.random() < 0.7
        elif kind == "restore_state":
            if not self._saved:
                return
            by_name = self._names and draw.random() < 0.5
            request = (
                RestoreState.Request(name=draw.choice(self._names)) if by_name
                else RestoreState.Request(state=draw.choice(self._saved))
            )  # fmt: skip
        answer = self._call(f"emulator/{kind}", request)
        assert answer.success, f"{kind}: {answer.message}"
        self.kinds.add(kind)
        self.bursts[-1] += 1
        if kind == "save_state":
            self._saved.append(bytes(answer.state))
            self._names += [request.name] if request.name else []

    def changes(self, reset: bool = True) -> None:
        """Do some things, one right after the other."""
        self.bursts.append(0)
        while self._draw.random() < 0.7:
            self.change(reset)

    def has_done_much(self) -> bool:
        """Whether there were many changes, of several kinds, and several of them at once."""
        return sum(self.bursts) > 15 and max(self.bursts) > 1 and len(self.kinds) >= 3


def go_on(in_process: InProcess, ticks: int, between: Callable[[], None] = lambda: None) -> None:
    """Deliver until the machine has gone through so many ticks more, or has begun anew."""
    deadline, ticks_done, newest = time.monotonic() + PATIENCE, 0, session_of(in_process).tick
    while ticks_done < ticks:
        assert time.monotonic() < deadline, f"nobody states anything any more at tick {newest}"
        between()
        if not in_process.deliver():
            time.sleep(1e-4)  # in real time the next tick is to come
        now = session_of(in_process).tick
        ticks_done, newest = ticks_done + (max(0, now - newest) if now >= newest else now), now


def session_of(in_process: InProcess) -> Any:
    return in_process.nodes["emulator"]._session


def events_of(bag: Path) -> list[MachineEvent]:
    printed = Bag(bag).read_messages(["/emulator/events"])
    return [deserialize_message(message.data, MachineEvent) for message in printed]
