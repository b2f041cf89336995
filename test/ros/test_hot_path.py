"""Messages taken in C: the same are published as by Python, for any message."""

import random
import subprocess
from collections import Counter
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from ament_index_python.packages import get_package_prefix
from draws import some, with_slow
from in_process import InProcess, in_process
from network import JOINTS

from arm_emulator.ros.c import FOLDER, WORKAROUNDS
from arm_emulator_msgs.srv import SetState

TOPICS = (
    "motor_states", "motor_commands", "joint_states", "joint_targets", "servo_states",
    "emulator/joint_states", "clock",
)  # fmt: skip
TICKS = 150
HEADERS = ("wait", "subscription", "publisher", "guard_condition", "types")  # of rcl
# Modules that repeat or report something after some wall time.
TIMED = (
    "emulator_node.reports", "emulator_node.pacer", "emulator_node.answered_ticks",
    "emulator_node.recorder_gate", "servo_node.node",
)  # fmt: skip


class Trouble:
    """Draws what a user does between two messages; the same for the same seed.

    Attributes:
        now: wall time, which goes on by 10 ms from message to message [s].
    """

    def __init__(self, seed: int) -> None:
        self._draw, self.now = random.Random(seed), 0.0
        self.held: dict[str, bytes] = {}

    def between(self, nodes: InProcess) -> None:
        draw, self._one = self._draw, nodes
        self.now += 0.01
        for topic in ("motor_states", "motor_commands", "joint_targets"):
            if topic in nodes.stated() and draw.random() < 0.02:
                self.held[topic] = nodes.stated()[topic]
        if draw.random() < 0.05 and self.held:
            self._send(draw.choice(sorted(self.held)))
        if draw.random() < 0.02:
            self._change()

    def _send(self, topic: str) -> None:
        draw = self._draw
        data = bytearray(draw.choice([self.held[topic], self._one.stated()[topic]]))
        for _ in range(draw.randrange(3)):
            data[draw.randrange(len(data))] ^= 1 << draw.randrange(8)
        self._one.send_bytes(topic, bytes(data) + bytes(draw.choice([0, 0, 3, 40])))

    def _change(self) -> None:
        draw, nodes = self._draw, self._one
        kind = draw.randrange(4)
        if kind == 0:
            assert nodes.call("emulator/power", draw.random() < 0.5).success
        elif kind == 1:
            request = SetState.Request(joint_names=[draw.choice(JOINTS)], velocity=[0.1])
            assert nodes.call("emulator/set_state", request).success
        elif kind == 2:
            assert nodes.call("emulator/pause", True).success
            nodes.call("emulator/step")
            assert nodes.call("emulator/pause", False).success
        else:
            nodes.timers()


def run(
    seed: int, hot: tuple[str, ...], patch: pytest.MonkeyPatch
) -> tuple[list[Any], Counter[int]]:
    """Return all that is published in a run, and what C did with the messages that it got."""
    trouble = Trouble(seed)
    for module in TIMED:
        patch.setattr(f"{module}.time", SimpleNamespace(monotonic=lambda: trouble.now))
    with in_process() as nodes:
        done: Counter[int] = Counter()
        counts = [nodes.take_in_c(node) for node in hot]
        nodes.begin_record()
        assert nodes.call("emulator/reset").success
        for _ in range(12 * TICKS):
            trouble.between(nodes)
            if not nodes.deliver():
                nodes.timers()  # states without an answer are repeated
        for count in counts:
            done += count
        return nodes.published(TOPICS), done


@pytest.mark.parametrize("seed", with_slow(some(range(40), 2), 1))
def test_c_and_python_publish_the_same(seed: int, monkeypatch: pytest.MonkeyPatch) -> None:
    slow, _ = run(seed, (), monkeypatch)
    fast, done = run(seed, ("emulator", "servo"), monkeypatch)
    assert done[0] >= 30, "C takes those of an undisturbed run; some troubles stop it early"
    assert done[1] >= 10, "and Python the others"
    for at, (first, second) in enumerate(zip(slow, fast, strict=False)):
        assert first == second, f"message {at} of {len(slow)}, on {first[0]} and {second[0]}"
    assert len(slow) == len(fast)


def test_rcl_is_called_as_its_headers_declare(tmp_path: Path) -> None:
    """Sizes, places and constants; names of ours are hidden from the headers."""
    called = ("rcl_take_serialized_message", "rcl_publish_serialized_message",
              "rcl_subscription_set_on_new_message_callback", "rcl_trigger_guard_condition",
              "rcutils_reset_error")  # fmt: skip
    constants = ("RCL_RET_OK", "RCL_RET_SUBSCRIPTION_TAKE_FAILED")
    lines = [f"#define {name} our_{name}" for name in called]
    lines += [
        '#include "rcl_calls.h"',
        f"enum {{ {', '.join(f'OUR_{constant} = {constant}' for constant in constants)} }};",
    ]
    lines += [f"#undef {name}" for name in called]
    lines += [f"#include <rcl/{header}.h>" for header in HEADERS]
    lines += [
        f'_Static_assert(OUR_{constant} == {constant}, "{constant}");' for constant in constants
    ]
    lines += [
        '_Static_assert(sizeof(rcl_bytes) == sizeof(rcl_serialized_message_t), "bytes");',
        '_Static_assert(sizeof(rcl_message_info) == sizeof(rmw_message_info_t), "info");',
        '_Static_assert(sizeof(((rcl_gid*)0)->data) == RMW_GID_STORAGE_SIZE, "identity");',
        '_Static_assert(sizeof(rcl_allocator) == sizeof(rcl_allocator_t), "allocator");',
    ]
    for ours, theirs, fields in (
        ("rcl_bytes", "rcl_serialized_message_t",
         ("buffer", "buffer_length", "buffer_capacity", "allocator")),
        ("rcl_allocator", "rcl_allocator_t",
         ("allocate", "deallocate", "reallocate", "zero_allocate", "state")),
        ("rcl_gid", "rmw_gid_t", ("implementation_identifier", "data")),
        ("rcl_message_info", "rmw_message_info_t",
         ("source_timestamp", "received_timestamp", "publication_sequence_number",
          "reception_sequence_number", "publisher_gid", "from_intra_process")),
    ):  # fmt: skip
        lines += [
            f'_Static_assert(offsetof({ours}, {field}) == offsetof({theirs}, {field}), "{field}");'
            for field in fields
        ]
    # The same arguments, by their number and size.
    lines += [
        "int32_t (*a)(const rcl_subscription_t*, rcl_serialized_message_t*, rmw_message_info_t*, "
        "rmw_subscription_allocation_t*) = rcl_take_serialized_message;",
        "int32_t (*b)(const rcl_publisher_t*, const rcl_serialized_message_t*, "
        "rmw_publisher_allocation_t*) = rcl_publish_serialized_message;",
        "int32_t (*c)(const rcl_subscription_t*, void (*)(const void*, size_t), const void*) = "
        "rcl_subscription_set_on_new_message_callback;",
        "int32_t (*d)(rcl_guard_condition_t*) = rcl_trigger_guard_condition;",
    ]
    source = tmp_path / "check.c"
    source.write_text("\n".join(lines) + "\n")
    headers = Path(get_package_prefix("rcl")) / "include"
    folders = [FOLDER, WORKAROUNDS, *(file for file in headers.iterdir() if file.is_dir())]
    command = ["cc", "-std=c11", "-Werror", "-fsyntax-only", str(source)]
    subprocess.run([*command, *(f"-I{folder}" for folder in folders)], check=True)
