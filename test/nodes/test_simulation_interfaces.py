"""simulation_interfaces by a generic client: each call, and features exactly as claimed."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from network import User, assert_same_bits, network, offline_states, user
from rclpy.action import ActionClient
from test_managed_nodes import Client

from arm_emulator.machine.scene.scene import load_scene
from arm_emulator.motion.model.link_motions import LinkMotions
from arm_emulator.ros.process.bringup import Bringup
from arm_emulator.runs.offline import load_offline_run

pytest.importorskip("simulation_interfaces", reason="simulation_interfaces is not installed")
from simulation_interfaces.action import SimulateSteps
from simulation_interfaces.msg import (
    Bounds,
    EntityCategory,
    EntityFilters,
    Result,
    SimulationState,
    SimulatorFeatures,
    TagsFilter,
)
from simulation_interfaces.srv import (
    GetEntities,
    GetEntitiesStates,
    GetEntityInfo,
    GetEntityState,
    GetSimulationState,
    GetSimulatorFeatures,
    ResetSimulation,
    SetEntityState,
    SetSimulationState,
    StepSimulation,
)

CLAIMED = {
    "ENTITY_TAGS",
    "ENTITY_CATEGORIES",
    "ENTITY_STATE_GETTING",
    "ENTITY_INFO_GETTING",
    "SIMULATION_RESET",
    "SIMULATION_RESET_STATE",
    "SIMULATION_STATE_GETTING",
    "SIMULATION_STATE_SETTING",
    "SIMULATION_STATE_PAUSE",
    "STEP_SIMULATION_SINGLE",
    "STEP_SIMULATION_MULTIPLE",
    "STEP_SIMULATION_ACTION",
}
STOPPED, PLAYING, PAUSED = (
    SimulationState.STATE_STOPPED,
    SimulationState.STATE_PLAYING,
    SimulationState.STATE_PAUSED,
)


class Simulation(Client):
    """A client that knows simulation_interfaces alone."""

    def __init__(self, user: User) -> None:
        super().__init__(user, "emulator")
        self.user = user
        self._goals: ActionClient | None = None

    @property
    def goals(self) -> ActionClient:
        """The client of the action, which its server knows."""
        if self._goals is None:
            self._goals = ActionClient(self.user.node, SimulateSteps, "emulator/simulate_steps")
            self.user.wait("the action", self._goals.server_is_ready)
            self.user.meet("emulator")
        return self._goals

    @property
    def state_now(self) -> int:
        answer = self.call(GetSimulationState, "get_simulation_state")
        assert answer.result.result == Result.RESULT_OK
        return int(answer.state.state)

    def to(self, state: int) -> int:
        request = SetSimulationState.Request(state=SimulationState(state=state))
        return int(self.call(SetSimulationState, "set_simulation_state", request).result.result)

    def step(self, steps: int) -> Any:
        request = StepSimulation.Request(steps=steps)
        return self.call(StepSimulation, "step_simulation", request).result

    def begin_steps(self, steps: int) -> Any:
        client = self.client(StepSimulation, "step_simulation")
        return client.call_async(StepSimulation.Request(steps=steps))

    def reset(self, scope: int) -> int:
        request = ResetSimulation.Request(scope=scope)
        return int(self.call(ResetSimulation, "reset_simulation", request).result.result)

    def goal(self, steps: int, cancel_at: int = -1) -> tuple[Any, list[tuple[int, int]]]:
        heard: list[tuple[int, int]] = []

        def hear(message: Any) -> None:
            feedback = message.feedback
            heard.append((feedback.completed_steps, feedback.remaining_steps))

        acceptance = self.goals.send_goal_async(SimulateSteps.Goal(steps=steps), hear)
        self.user.wait("the goal's acceptance", acceptance.done)
        goal = acceptance.result()
        if cancel_at >= 0:
            self.user.wait("some steps", lambda: heard and heard[-1][0] >= cancel_at)
            goal.cancel_goal_async()
        result = goal.get_result_async()
        self.user.wait("the goal's end", result.done)
        if cancel_at < 0 and result.result().result.result.result == Result.RESULT_OK:
            self.user.wait("the last feedback", lambda: len(heard) == steps)
        return result.result().result.result, heard


@pytest.fixture(scope="module")
def simulation(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Simulation]:
    with network(tmp_path_factory.mktemp("log")) as (user_of_network, _):
        yield Simulation(user_of_network)


def test_features_are_those_claimed(simulation: Simulation) -> None:
    answer = simulation.call(GetSimulatorFeatures, "get_simulator_features")
    assert set(answer.features.features) == {getattr(SimulatorFeatures, name) for name in CLAIMED}
    assert not answer.features.spawn_formats


def test_states_steps_and_resets_to_equal_bits(simulation: Simulation) -> None:
    user, ok = simulation.user, Result.RESULT_OK
    user.await_start()
    assert simulation.state_now == STOPPED
    assert simulation.to(STOPPED) == SetSimulationState.Response.ALREADY_IN_TARGET_STATE
    assert simulation.to(PAUSED) == ok and simulation.state_now == PAUSED, "without a step"
    assert simulation.step(1).result == ok
    user.wait("tick 1", lambda: user.tick == 1)
    assert simulation.step(60).result == ok
    user.wait("tick 61", lambda: user.tick == 61)
    result, heard = simulation.goal(20)
    assert result.result == ok and heard == [(k, 20 - k) for k in range(1, 21)]
    user.wait("tick 81", lambda: user.tick == 81)
    result, heard = simulation.goal(10**6, cancel_at=5)
    assert result.error_message == "cancelled" and 5 <= len(heard) < 10**5
    assert simulation.state_now == PAUSED
    for wrong in (simulation.step(0), simulation.goal(0)[0]):
        assert (
            wrong.result == Result.RESULT_OPERATION_FAILED and "at least 1" in wrong.error_message
        )

    assert simulation.to(PLAYING) == ok and simulation.state_now == PLAYING
    wrong = simulation.step(1)
    assert wrong.result == Result.RESULT_OPERATION_FAILED and "not paused" in wrong.error_message
    assert simulation.to(77) == SetSimulationState.Response.INCORRECT_TRANSITION
    begin = user.tick
    user.wait("the run", lambda: user.tick > begin + 50)
    assert simulation.to(PAUSED) == ok
    user.wait("the pause", lambda: user.status.answered and user.status.tick == user.tick)
    end = user.tick
    run = load_offline_run("three_axis")
    assert_same_bits(user.motor_states(), offline_states(run, end), end)

    assert simulation.reset(ResetSimulation.Request.SCOPE_STATE) == ok
    start = np.array(load_scene("three_axis").start)
    user.wait("the start", lambda: np.array_equal(user.truth.position, start))
    assert user.tick == end, "time goes on"
    time, state, spawned, unknown = 1, 2, 4, 8
    for scope in (time, spawned, time | spawned, unknown | state, unknown | time | state, 254):
        assert simulation.reset(scope) == Result.RESULT_FEATURE_UNSUPPORTED
    assert simulation.reset(state | spawned) == ok and user.tick == end
    begun, big = simulation.begin_steps(2**63), user.tick + 20
    user.wait("many steps", lambda: user.tick > big)
    for result_of_steps in (simulation.goal(5)[0], simulation.step(1)):
        assert result_of_steps.error_message == "other steps are not done yet"
    assert simulation.reset(time | state | spawned) == ok
    user.wait("their end", begun.done)
    assert begun.result().result.error_message == "the simulation was reset"
    assert simulation.reset(ResetSimulation.Request.SCOPE_DEFAULT) == ok
    user.wait("tick 0", lambda: user.tick == 0)
    assert simulation.state_now == STOPPED


def test_entities_are_the_arm_and_its_links(simulation: Simulation) -> None:
    scene = load_scene("three_axis")
    links = LinkMotions(scene.urdf, scene.joint_names)

    def names(**filters: Any) -> Any:
        request = GetEntities.Request(filters=EntityFilters(**filters))
        return simulation.call(GetEntities, "get_entities", request)

    everything = [scene.name, *links.names]
    assert list(names().entities) == everything
    assert list(names(filter="^three_").entities) == [scene.name]
    robots = [EntityCategory(category=EntityCategory.CATEGORY_ROBOT)]
    assert list(names(categories=robots).entities) == [scene.name]
    tags = TagsFilter(tags=["link", "other"], filter_mode=TagsFilter.FILTER_MODE_ANY)
    assert list(names(tags=tags).entities) == list(links.names)
    tags.filter_mode = TagsFilter.FILTER_MODE_ALL
    assert not names(tags=tags).entities
    assert names(filter="(").result.result == Result.RESULT_OPERATION_FAILED
    bounds = Bounds(type=Bounds.TYPE_SPHERE)
    assert names(bounds=bounds).result.result == Result.RESULT_FEATURE_UNSUPPORTED

    user = simulation.user
    user.wait("the truth", lambda: user.truth)
    answer = simulation.call(GetEntitiesStates, "get_entities_states")
    links.place_links(np.array(user.truth.position), np.array(user.truth.velocity))
    assert list(answer.entities) == everything
    for name, state in zip(answer.entities, answer.states, strict=True):
        single = simulation.call(
            GetEntityState, "get_entity_state", GetEntityState.Request(entity=name)
        )
        assert single.state.pose == state.pose and single.result.result == Result.RESULT_OK
        if name in links.names:
            p = state.pose.position
            assert np.abs(links.get_pose(name)[0] - (p.x, p.y, p.z)).max() < 1e-12
        info = simulation.call(GetEntityInfo, "get_entity_info", GetEntityInfo.Request(entity=name))
        assert info.info.description and info.info.tags
        wrong = simulation.call(
            SetEntityState, "set_entity_state", SetEntityState.Request(entity=name, set_pose=True)
        )
        assert wrong.result.result == Result.RESULT_FEATURE_UNSUPPORTED
    for kind, service in (
        (GetEntityState, "get_entity_state"),
        (SetEntityState, "set_entity_state"),
        (GetEntityInfo, "get_entity_info"),
    ):
        answer = simulation.call(kind, service, kind.Request(entity="nobody"))
        assert answer.result.result == Result.RESULT_NOT_FOUND


def test_an_inactive_emulator_refuses_and_still_names_its_features(simulation: Simulation) -> None:
    assert simulation.change("deactivate")
    assert simulation.to(PLAYING) == Result.RESULT_INCORRECT_STATE
    assert simulation.step(1).result == Result.RESULT_INCORRECT_STATE
    assert simulation.goal(1)[0].result == Result.RESULT_OPERATION_FAILED
    answer = simulation.call(GetSimulatorFeatures, "get_simulator_features")
    assert len(answer.features.features) == len(CLAIMED)
    assert simulation.change("activate") and simulation.state_now == STOPPED


def test_a_client_lets_it_quit(tmp_path: Path) -> None:
    with user() as client, Bringup("three_axis", log=tmp_path, only=("emulator",)) as nodes:
        simulation = Simulation(client)
        client.wait("its start", lambda: simulation.state == "active")
        assert simulation.to(SimulationState.STATE_QUITTING) == Result.RESULT_OK
        client.wait("its end", nodes.find_ended)
        assert nodes.find_ended() == ("emulator", 0)
