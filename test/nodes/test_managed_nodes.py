"""The nodes' states, asked for by a generic client: every transition, and those out of order."""

import itertools
import math
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
import rclpy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from lifecycle_msgs.msg import State, Transition
from lifecycle_msgs.srv import ChangeState, GetAvailableStates, GetAvailableTransitions, GetState
from network import User, assert_same_bits, network, offline_states
from rcl_interfaces.srv import SetParameters
from rclpy.executors import SingleThreadedExecutor
from rclpy.lifecycle import TransitionCallbackReturn
from rclpy.parameter import Parameter
from test_network import go, pause_at

from arm_emulator.ros.node.duplicate_nodes import DuplicateNodes
from arm_emulator.ros.node.managed_node import ManagedNode
from arm_emulator.ros.node.node_shell import Diagnostics, create_wall_timer
from arm_emulator.ros.process.bringup import Bringup
from arm_emulator.ros.process.ros_domain import is_occupied, own_domain
from arm_emulator.runs.offline import load_offline_run
from arm_emulator_msgs.msg import EmulatorStatus

NODES = ("motion_controller", "servo", "emulator")
LEADS_FROM = {
    "unconfigured": {"configure": "inactive", "shutdown": "finalized"},
    "inactive": {"activate": "active", "cleanup": "unconfigured", "shutdown": "finalized"},
    "active": {"deactivate": "inactive", "shutdown": "finalized"},
    "finalized": {},
}
LABELS = ("configure", "activate", "deactivate", "cleanup", "shutdown")


class Client:
    """Asks a node for its states and changes them, as `ros2 lifecycle` does."""

    def __init__(self, user: User, node: str) -> None:
        self._user, self._node = user, node
        self._clients: dict[str, Any] = {}

    def client(self, kind: Any, service: str) -> Any:
        """Return a client that the server of a service knows: before, it loses its answers."""
        if service not in self._clients:
            name = f"{self._node}/{service}"
            client = self._clients[service] = self._user.node.create_client(kind, name)
            self._user.wait(f"service {name}", client.service_is_ready)
            self._user.meet(self._node)
        return self._clients[service]

    def call(self, kind: Any, service: str, request: Any = None) -> Any:
        future = self.client(kind, service).call_async(request or kind.Request())
        self._user.wait(f"an answer of {self._node}/{service}", future.done)
        return future.result()

    @property
    def state(self) -> str:
        return str(self.call(GetState, "get_state").current_state.label)

    def change(self, label: str = "", number: int = 0) -> bool:
        transition = Transition(id=number, label=label)
        request = ChangeState.Request(transition=transition)
        return bool(self.call(ChangeState, "change_state", request).success)

    def set(self, **values: Any) -> str:
        parameters = [Parameter(name, value=v).to_parameter_msg() for name, v in values.items()]
        request = SetParameters.Request(parameters=parameters)
        (result,) = self.call(SetParameters, "set_parameters", request).results
        return str(result.reason)


def test_a_node_that_is_destroyed_has_left_the_network() -> None:
    """At once, while it is still referred to: none of its ports is open any more."""
    with own_domain() as domain:
        rclpy.init()
        try:
            node = ManagedNode("one")
            assert is_occupied(domain)
            node.destroy_node()
            assert not is_occupied(domain), node
        finally:
            rclpy.shutdown()


@contextmanager
def running(log: Path, **emulator: object) -> Iterator[tuple[User, Bringup, list[Client]]]:
    with network(log, **emulator) as (user, nodes):
        yield user, nodes, [Client(user, name) for name in NODES]


@pytest.mark.slow
def test_a_run_goes_on_after_a_node_was_inactive(tmp_path: Path) -> None:
    """Time stands, commands are dropped, services refuse; after servo and emulator: equal bits."""
    with running(tmp_path) as (user, _, clients):
        go(user)

        def stands(name: str, client: Client) -> None:
            begin = user.tick
            user.wait("the run", lambda: user.tick > begin + 30)
            assert client.change("deactivate") and client.state == "inactive", name
            refusal = user.call(f"{name}/reset")
            assert not refusal.success and "got inactive" in refusal.message, refusal
            user.wait("words", lambda: user.diagnostics[name].message.startswith("inactive"))
            if name == "emulator":
                assert not user.call("emulator/step").success
            assert client.change("activate") and client.state == "active", name
            stop = user.tick
            user.wait("the run to go on", lambda: user.tick > stop + 30)

        for name in ("servo", "emulator"):
            stands(name, clients[NODES.index(name)])
        end = pause_at(user, user.tick)
        run = load_offline_run("three_axis")
        assert_same_bits(user.motor_states(), offline_states(run, end), end)
        assert user.call("emulator/pause", False).success
        stands("motion_controller", clients[0])


def test_every_transition_by_label_and_by_number_and_no_more(tmp_path: Path) -> None:
    """A transition that the state does not have is refused in one line, and the node goes on."""
    numbers = {
        "configure": {"unconfigured": 1},
        "cleanup": {"inactive": 2},
        "activate": {"inactive": 3},
        "deactivate": {"active": 4},
        "shutdown": {"unconfigured": 5, "inactive": 6, "active": 7},
    }
    only = ("emulator",)
    with running(tmp_path, only=only, start="first_answer", autostart=False) as (_user, _, clients):
        emulator = clients[-1]
        states = emulator.call(GetAvailableStates, "get_available_states").available_states
        assert {State.PRIMARY_STATE_UNCONFIGURED, State.PRIMARY_STATE_ACTIVE} <= {
            state.id for state in states
        }
        state, by_number = "unconfigured", itertools.cycle((False, True))
        for label in ("configure", "activate", "deactivate", "cleanup", "configure", "activate",
                    "deactivate", "activate", "shutdown"):  # fmt: skip
            answer = emulator.call(GetAvailableTransitions, "get_available_transitions")
            there = {option.transition.label for option in answer.available_transitions}
            assert there == set(LEADS_FROM[state]), (state, there)
            for wrong in (*(set(LABELS) - there), "destroy", "transition_success", "fly"):
                assert not emulator.change(wrong), (state, wrong)
            for wrong in (0, 8, 30, 97, 255, *(
                number for of in numbers.values() for at, number in of.items() if at != state
            )):  # fmt: skip
                assert not emulator.change(number=wrong), (state, wrong)
            assert emulator.state == state
            done = (
                emulator.change(number=numbers[label][state])
                if next(by_number)
                else emulator.change(label)
            )
            assert done, label
            state = LEADS_FROM[state][label]
            assert emulator.state == state
        printed = (tmp_path / "emulator.log").read_text()
        assert "transition must be one that leads from inactive, got fly; valid: cleanup" in printed
        assert "Traceback" not in printed, printed


def test_a_second_scene_by_parameter_and_a_refused_scene(tmp_path: Path) -> None:
    """A node that cannot be configured stays unconfigured, with the reason in its log."""
    only = ("emulator",)
    with running(tmp_path, only=only, start="first_answer") as (user, _, clients):
        emulator = clients[-1]
        user.wait("tick 0", lambda: user.tick == 0)
        user.wait("the end of its start", lambda: emulator.state == "active")
        assert "unconfigured, got active" in emulator.set(scene="ur5")
        for value in (False, math.nan, "later"):  # it acts at the node's start alone
            assert "read-only" in emulator.set(autostart=value)
        assert emulator.change("deactivate")
        assert "unconfigured, got inactive" in emulator.set(scene="ur5")
        assert emulator.change("cleanup")
        assert not emulator.set(scene="nonesuch")
        assert not emulator.change("configure") and emulator.state == "unconfigured"
        assert "file nonesuch must exist" in (tmp_path / "emulator.log").read_text()
        assert not emulator.set(scene="panda")
        user.forget()
        user.machine, user.joint_names = 0, [f"panda_joint{k}" for k in range(1, 8)]
        assert emulator.change("configure") and emulator.state == "inactive"
        user.spin()
        assert user.tick == -1, "an inactive machine publishes nothing"
        assert emulator.change("activate")
        user.wait("tick 0", lambda: user.tick == 0)
        assert len(user.motor_states()) == 1 and "panda" in user.description


class Duplicate(ManagedNode):
    """An emulator that is to be alone, with a timer, as far as duplicates matter."""

    def __init__(self) -> None:
        super().__init__("duplicate")
        self.fired = 0
        self.health = Diagnostics(self, "nothing")
        self.duplicates = DuplicateNodes(self, self.health, "emulator", "motor_states", "refused")

    def create_entities(self) -> None:
        self.create_publisher(EmulatorStatus, "emulator/status", 1)
        create_wall_timer(self, 0.01, self._fire)

    def begin_work(self) -> None:
        self.duplicates.announce_node()
        self.duplicates.wait_until_first("emulator/status", alone=True)

    def _fire(self) -> None:
        self.fired += 1


def test_a_node_that_was_refused_beside_another_one_works_after_it() -> None:
    """Its timers go on; meanwhile it does not call itself an emulator, which others would count."""
    values = {"kind": "emulator", "topic": "/motor_states", "started [ns]": "1"}
    earlier = [KeyValue(key=key, value=value) for key, value in values.items()]
    health = DiagnosticArray(status=[DiagnosticStatus(name="earlier", values=earlier)])
    with own_domain():
        rclpy.init()
        node = Duplicate()
        executor = SingleThreadedExecutor()
        try:
            node.trigger_configure()
            node.duplicates._take_diagnostics(health)
            assert node.trigger_activate() is TransitionCallbackReturn.FAILURE
            assert node.state == "inactive" and "kind" not in node.health.values
            node.duplicates._duplicates.clear()
            assert node.trigger_activate() is TransitionCallbackReturn.SUCCESS
            assert node.state == "active" and node.health.values["kind"] == "emulator"
            executor.add_node(node)
            fired, end = node.fired, time.monotonic() + 5.0
            while node.fired <= fired and time.monotonic() < end:
                executor.spin_once(timeout_sec=0.1)
            assert node.fired > fired
        finally:
            node.destroy_node()
            rclpy.shutdown()


@pytest.mark.slow
@pytest.mark.parametrize("name", ["servo", "motion_controller"])
def test_a_node_is_configured_again_in_a_run(tmp_path: Path, name: str) -> None:
    """It serves the same arm again; the machine waits for it meanwhile."""
    with running(tmp_path) as (user, _, clients):
        go(user)
        client = clients[NODES.index(name)]
        user.wait("the run", lambda: user.tick > 60)
        for label in ("deactivate", "cleanup", "configure", "activate"):
            assert client.change(label), label
        stop = user.tick
        user.wait("the run to go on", lambda: user.tick > stop + 100)
        assert client.change("shutdown") and client.state == "finalized"
