"""Wrenches that come as messages: they act from a tick on, and `check-bag` repeats them."""

import math
import random
import shutil
from pathlib import Path

import pytest
from by_hand import CLOCKS, events_of, go_on, session_of
from draws import with_slow
from geometry_msgs.msg import Vector3, WrenchStamped
from in_process import InProcess, in_process
from machines import CONFIG

from arm_emulator.cli.commands.check_bag import check_bag
from arm_emulator_msgs.msg import MachineEvent

TOPICS = {"external_wrench": "link", "external_wrench_in_world": "world"}
LINKS = ("upper_arm", "forearm", "tool")
VARIED = "payload: 1.0\nvaried: [payload.mass]\n"  # as in test_manners, which compiles it


@pytest.fixture(scope="module")
def pushed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("pushed")
    shutil.copytree(CONFIG / "urdf", folder / "urdf")
    text = (CONFIG / "three_axis.yaml").read_text()
    (folder / "three_axis.yaml").write_text(f"{text}\nexternal_wrench: true\n{VARIED}")
    return folder / "three_axis.yaml"


def message(link: str, *numbers: float) -> WrenchStamped:
    printed = WrenchStamped()
    printed.header.frame_id = link
    printed.wrench.force, printed.wrench.torque = (
        Vector3(x=x, y=y, z=z) for x, y, z in (numbers[:3], numbers[3:])
    )
    return printed


def sound(draw: random.Random) -> tuple[str, WrenchStamped]:
    return draw.choice(list(TOPICS)), message(
        draw.choice(LINKS), *(draw.gauss(0.0, 20.0) for _ in range(6))
    )


def changes(nodes: InProcess) -> int:
    return int(nodes.nodes["emulator"]._reports.changes)


@pytest.mark.parametrize("clock", with_slow(CLOCKS, 1))
def test_a_run_under_wrenches_is_repeated_to_the_last_bit(
    clock: str, pushed: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    draw, printed = random.Random(1), 0
    with in_process(clock, file=pushed) as nodes:
        nodes.begin_record()
        assert nodes.call("emulator/reset").success

        def between() -> None:
            nonlocal printed
            if draw.random() < 0.02:
                nodes.nodes[
                    "emulator"
                ]._status.publish_status()  # by which `check-bag` knows the clock
                nodes.send(*sound(draw))
                printed += 1

        go_on(nodes, 300, between)
        while printed < 6:  # a busy machine looks less often between its ticks
            go_on(nodes, 20, between)
        assert nodes.refused("emulator") == 0, f"of {printed} stated"
        nodes.write(tmp_path / "bag")
    code, words = check_bag(tmp_path / "bag", scene=str(pushed)), capfd.readouterr().out
    assert code == 0 and "equal to the last bit" in words, words
    kinds = [event.kind for event in events_of(tmp_path / "bag")]
    assert kinds.count(MachineEvent.KIND_EXTERNAL_WRENCH) == printed, "each is reported"


def test_a_wrench_acts_at_its_link_until_the_next_wrench(pushed: Path) -> None:
    draw = random.Random(2)
    with in_process(file=pushed) as nodes:
        go_on(nodes, 5)
        for _ in range(20):
            topic, printed = sound(draw)
            nodes.send(topic, printed)
            joint = next(
                j
                for j in session_of(nodes).scene.chain.joints
                if printed.header.frame_id in j.links
            )
            acts = session_of(nodes).plant.external_wrenches[joint.link]
            assert acts.axes == TOPICS[topic], printed
            inputs = printed.wrench.force
            size = math.hypot(
                printed.wrench.force.x, printed.wrench.force.y, printed.wrench.force.z
            )
            assert math.hypot(*acts.force) == pytest.approx(size, rel=1e-12), printed
            if acts.axes == "world":
                assert acts.force == (inputs.x, inputs.y, inputs.z), printed
            reported = changes(nodes)
            nodes.send(topic, printed)
            assert changes(nodes) == reported, "what acts already is no change"
            go_on(nodes, 2)
        assert nodes.call("emulator/reset").success
        for wrench in session_of(nodes).plant.external_wrenches.values():
            assert not any((*wrench.force, *wrench.moment)), "after a reset"


def test_bad_messages_are_refused_counted_and_change_nothing(pushed: Path) -> None:
    draw = random.Random(3)
    with in_process(file=pushed) as nodes:
        go_on(nodes, 5)
        nodes.send(*sound(draw))
        saved = session_of(nodes).plant.save()
        for count in range(1, 40):
            topic, printed = sound(draw)
            if draw.random() < 0.5:
                printed.header.frame_id = draw.choice(
                    ["", "base", "world", "elbow", "TOOL", "no", "é"]
                )
            else:
                vector = draw.choice([printed.wrench.force, printed.wrench.torque])
                bad = draw.choice([math.nan, math.inf, -math.inf, 1e300, -1e9])
                setattr(vector, draw.choice("xyz"), bad)
            nodes.send(topic, printed)
            assert nodes.refused("emulator") == count, printed
            assert session_of(nodes).plant.save() == saved, printed
    with in_process() as nodes:  # a scene without
        nodes.send(*sound(draw))
        assert nodes.refused("emulator") == 1, "a scene without external_wrench"
        assert (
            "external_wrench must be true" in nodes.nodes["emulator"]._diagnostics._newest_refusal
        )
