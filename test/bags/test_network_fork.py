"""`fork` of a network's bag: machine and servo made again from joint targets, to the last bit."""

import json
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from draws import with_slow
from geometry_msgs.msg import PoseStamped
from in_process import in_process
from machines import own_three_axis

from arm_emulator.bags.comparison import compare_bag
from arm_emulator.bags.recorded_machine import RecordedMachine
from arm_emulator.bags.recorded_topics import RecordedTopics
from arm_emulator.bags.timeline_bag import ORDERS, TARGETS
from arm_emulator.base.refusal import Refusal
from arm_emulator.cli.commands.fork import fork_run
from arm_emulator.machine.scene.scene import load_scene
from arm_emulator.ros.recording.bag import Bag
from arm_emulator_msgs.srv import SetState, SetVaried

VISCOUS = "joints.elbow.friction.viscous"
LAST = 420  # ticks of 1 ms


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return own_three_axis(tmp_path_factory.mktemp("scene") / "own", f"varied: [{VISCOUS}]")


@pytest.fixture(scope="module")
def moved(scene: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A bag of two runs, of which the last one has moves, and changes by hand on the way."""
    with in_process(file=scene) as nodes:
        nodes.begin_record()
        nodes.run_to(20)
        nodes.call("emulator/reset")
        nodes.run_to(30)
        controller = nodes.nodes["motion_controller"]._controller
        _, p = controller.kinematics.forward(load_scene(scene).start)
        target = PoseStamped()
        target.pose.position.x, target.pose.position.y, target.pose.position.z = map(float, p)
        target.pose.position.y += 0.05
        target.pose.orientation.w = 1.0
        nodes.send("tool_target", target)
        nodes.run_to(200)
        assert nodes.call("emulator/set_varied", SetVaried.Request(name=VISCOUS, value=0.4)).success
        nodes.run_to(230)
        assert nodes.call("emulator/power", False).success
        nodes.run_to(260)
        assert nodes.call("emulator/power", True).success
        nodes.run_to(320)
        faster = SetState.Request(joint_names=["elbow"], velocity=[0.2])
        assert nodes.call("emulator/set_state", faster).success
        nodes.run_to(LAST)
        return nodes.write(tmp_path_factory.mktemp("bags") / "moved")


def record_states(bag: Path, scene: Path) -> list[bytes]:
    """The machine at each tick."""
    machine = RecordedMachine.open_run(bag, load_scene(scene))
    states = [machine.session.plant.save()]
    while machine.tick < machine.last:
        machine.advance(1)
        states.append(machine.session.state.q.tobytes() + machine.session.state.current.tobytes())
    return states


@pytest.mark.parametrize("at", with_slow([245, 0, 137, 215, 300, 380], 1))
def test_a_fork_without_a_change_is_the_recorded_run(
    at: int, scene: Path, moved: Path, tmp_path: Path
) -> None:
    """From the fork on nothing but the changes by hand before it is known."""
    bag = tmp_path / "fork"
    last = next(end for end in (200, 230, 260, 320, LAST) if end > at)
    assert fork_run(moved, bag, at=at * 1e-3, seconds=(last - at) * 1e-3, scene=str(scene)) == 0
    expected = record_states(moved, scene)
    assert record_states(bag, scene)[1:] == expected[1 : last + 1]
    assert np.ptp([np.frombuffer(state)[1] for state in expected[1:]]) > 0.005, (
        "an arm that moves [rad]"
    )
    assert compare_bag(bag, str(scene)).difference is None


@pytest.mark.slow
def test_forks_of_forks_name_the_bag_with_the_targets(
    scene: Path, moved: Path, tmp_path: Path
) -> None:
    first, second, third = (tmp_path / name for name in ("first", "second", "third"))
    assert fork_run(moved, first, at=0.21, gains=1.5, seconds=0.1, scene=str(scene)) == 0
    assert (
        fork_run(first, second, at=0.29, set_=[f"{VISCOUS}=0.1"], seconds=0.1, scene=str(scene))
        == 0
    )
    assert fork_run(second, third, at=0.39, seconds=0.0, scene=str(scene)) == 0
    assert record_states(third, scene) == record_states(second, scene)
    assert record_states(second, scene)[1:291] == record_states(first, scene)[1:291]
    assert record_states(first, scene)[1:211] == record_states(moved, scene)[1:211]
    assert record_states(first, scene)[310] != record_states(moved, scene)[310], "the gains act"
    about = Bag(third).about
    assert about[TARGETS] == str(moved)
    kinds = [order["kind"] for order in json.loads(about[ORDERS])]
    assert kinds == ["leave_changes", "gains", "leave_changes", "set_varied"]
    assert compare_bag(third, str(scene)).difference is None


@pytest.mark.parametrize(("words", "rule"), [
    ({"displacement": (0.0, 0.01, 0.0)}, "go to the servo"), ({"gains": 0.0}, "above 0"),
    ({"at": 0.5}, "--at must be within 0 and 0.42 s"),
])  # fmt: skip
def test_impossible_requests_are_refused_and_write_nothing(
    words: dict[str, Any], rule: str, scene: Path, moved: Path, tmp_path: Path
) -> None:
    with pytest.raises(Refusal, match=rule):
        fork_run(moved, tmp_path / "new", scene=str(scene), **{"at": 0.1, **words})
    assert not (tmp_path / "new").exists()


def test_a_bag_that_cannot_be_repeated_is_refused(
    scene: Path, moved: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    soft = tmp_path / "own" / scene.name
    shutil.copytree(scene.parent, soft.parent)
    gains = soft.parent / "servo" / scene.name
    gains.write_text(gains.read_text().replace("position_gain: 30.0", "position_gain: 29.0"))
    with pytest.raises(Refusal, match="lead to the recorded commands"):
        fork_run(moved, tmp_path / "new", at=0.01, scene=str(soft))
    monkeypatch.setattr(RecordedTopics, "is_real_time", True)
    with pytest.raises(Refusal, match="be of lock-step"):
        fork_run(moved, tmp_path / "new", at=0.01, scene=str(scene))
    assert not (tmp_path / "new").exists()
