"""The services and the action of simulation_interfaces, where that package is installed."""

import os
import signal
from functools import partial
from typing import Any

from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.task import Future

from arm_emulator.base.refusal import Refusal
from arm_emulator.machine.session.phase import Phase
from arm_emulator.ros.node.barrier import guard_coroutine
from arm_emulator.ros.node.managed_node import ManagedNode
from arm_emulator.ros.node.node_shell import create_wall_timer
from arm_emulator_msgs.msg import MachineEvent
from emulator_node.changes import Changes
from emulator_node.context import Context
from emulator_node.entities import SimulationEntities
from emulator_node.time_control import TickStepper, TimeControl

try:
    from rclpy.action import ActionServer, CancelResponse
    from simulation_interfaces import action, msg, srv
except ImportError:  # no wheel has it
    srv = None

# By their names in SimulatorFeatures; those that an older package does not know are left out.
FEATURES = (
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
)
ALREADY, FAILED, INCORRECT = 101, 102, 103  # results of SetSimulationState
TIME, STATE, SPAWNED, ALL = 1, 2, 4, 255  # scopes of ResetSimulation
QUIT_AFTER = 0.2  # s, wall: for the answer to leave


def is_installed() -> bool:
    """Return whether simulation_interfaces is installed."""
    return srv is not None


class SimulationServices:
    """Serves them as `~/get_simulator_features`, `~/step_simulation` and so on."""

    def __init__(
        self, node: ManagedNode, own: Context, changes: Changes, control: TimeControl,
        stepper: TickStepper,
    ) -> None:  # fmt: skip
        self._node, self._session, self._gate, self._lock = (
            node, own.session, own.gate, own.lock,
        )  # fmt: skip
        self._changes, self._control, self._stepper = changes, control, stepper
        self._entities = SimulationEntities(own.session)
        self._at_start = own.session.plant.save()
        self._waits_at_start = False  # paused at tick 0, which is not stopped
        for kind, name, answer in (
            (srv.GetSimulationState, "get_simulation_state", self._handle_get_state),
            (srv.SetSimulationState, "set_simulation_state", self._handle_set_state),
            (srv.ResetSimulation, "reset_simulation", self._handle_reset),
            (srv.GetEntities, "get_entities", self._handle_get_entities),
            (srv.GetEntitiesStates, "get_entities_states", self._handle_get_entities),
            (srv.GetEntityState, "get_entity_state", self._handle_get_entity_state),
            (srv.SetEntityState, "set_entity_state", self._handle_set_entity_state),
            (srv.GetEntityInfo, "get_entity_info", self._handle_get_entity_info),
        ):
            node.create_service(kind, f"~/{name}", answer, refuse=_refuse_request)
        node.create_service(
            srv.StepSimulation,
            "~/step_simulation",
            self._handle_step,
            refuse=_refuse_request,
            callback_group=ReentrantCallbackGroup(),  # it waits, and others must not
        )
        node.create_service(
            srv.GetSimulatorFeatures,
            "~/get_simulator_features",
            lambda _, response: _list_features(response),
            refuse=lambda response, _: _list_features(response),
        )
        server = ActionServer(
            node,
            action.SimulateSteps,
            "~/simulate_steps",
            execute_callback=guard_coroutine(
                node, "simulate_steps", self._execute_goal, _report_failure
            ),
            cancel_callback=lambda _: CancelResponse.ACCEPT,
        )
        node.cleanup.callback(server.destroy)

    # Time

    @property
    def _state(self) -> int:
        session, state = self._session, msg.SimulationState
        if session.phase is Phase.PAUSED and session.tick == 0 and not self._waits_at_start:
            return int(state.STATE_STOPPED)
        is_paused = session.phase in (Phase.PAUSED, Phase.STOPPED)
        return int(state.STATE_PAUSED if is_paused else state.STATE_PLAYING)

    def _handle_get_state(self, request: Any, response: Any) -> Any:
        with self._lock:
            response.state.state = self._state
            fault = self._session.fault
            return _report_success(response, "" if fault is None else f"stopped: {fault}")

    def _handle_set_state(self, request: Any, response: Any) -> Any:
        target, state = request.state.state, msg.SimulationState
        with self._lock:
            if target == self._state:
                return _refuse_request(response, "the simulation is in this state", ALREADY)
            if target == state.STATE_QUITTING:
                self._node.get_logger().info("a client lets the simulation quit")
                end = partial(os.kill, os.getpid(), signal.SIGTERM)
                create_wall_timer(self._node, QUIT_AFTER, end)
            elif target == state.STATE_STOPPED:
                self._stepper.end_steps("the simulation was stopped")
                self._waits_at_start = False
                self._control.reset_time(paused=True)
            elif target == state.STATE_PAUSED:
                self._waits_at_start = self._session.tick == 0
                self._control.pause_time(True)
            elif target == state.STATE_PLAYING:
                if self._session.fault is not None:
                    reason = f"stopped, reset first: {self._session.fault}"
                    return _refuse_request(response, reason, FAILED)
                self._stepper.end_steps("the simulation was played")
                self._waits_at_start = False
                self._control.pause_time(False)
            else:
                rule, actual = "be STOPPED, PLAYING, PAUSED or QUITTING", target
                reason = str(Refusal("set_simulation_state", "state", rule, actual))
                return _refuse_request(response, reason, INCORRECT)
            return _report_success(response)

    async def _handle_step(self, request: Any, response: Any) -> Any:
        trouble = await self._begin_steps(int(request.steps))
        if trouble:
            return _refuse_request(response, trouble, msg.Result.RESULT_OPERATION_FAILED)
        return _report_success(response)

    def _begin_steps(self, steps: int, stepped: Any = None) -> Future:
        """Return a future of the reason why there were fewer steps, or ""."""
        ended = Future()
        with self._lock:
            self._waits_at_start = self._waits_at_start or self._session.tick == 0
            self._stepper.begin_steps(steps, ended.set_result, stepped)
        return ended

    async def _execute_goal(self, goal: Any) -> Any:
        steps = int(goal.request.steps)

        def report_step(left: int) -> None:
            if goal.is_cancel_requested:
                self._stepper.end_steps("cancelled")
                return
            feedback = action.SimulateSteps.Feedback()
            feedback.completed_steps, feedback.remaining_steps = steps - left, left
            goal.publish_feedback(feedback)

        result = action.SimulateSteps.Result()
        if self._node.active:
            trouble = await self._begin_steps(steps, report_step)
        else:
            trouble = f"the emulator is {self._node.state}"
        if trouble:
            _refuse_request(result, trouble, msg.Result.RESULT_OPERATION_FAILED)
        else:
            _report_success(result)
        if goal.is_cancel_requested:
            goal.canceled()
        elif trouble:
            goal.abort()
        else:
            goal.succeed()
        return result

    def _handle_reset(self, request: Any, response: Any) -> Any:
        scope = request.scope or ALL
        is_valid = scope == ALL or not scope & ~(TIME | STATE | SPAWNED)
        parts = scope & (TIME | STATE) if is_valid else 0  # nothing is ever spawned
        with self._lock:
            if parts == TIME | STATE:
                stopped = self._session.paused
                self._stepper.end_steps("the simulation was reset")
                self._control.reset_time(paused=stopped)
            elif parts == STATE:
                if behind := self._gate.find_full_recorder():
                    reason = f"recorder {behind} has to catch up first, ask again then"
                    return _refuse_request(response, reason, msg.Result.RESULT_OPERATION_FAILED)
                self._changes.put_change(
                    MachineEvent.KIND_RESTORE, lambda: self._session.restore(self._at_start)
                )
            else:
                rule = "have SCOPE_STATE, and no unknown bit"
                reason = str(Refusal("reset_simulation", "scope", rule, scope))
                return _refuse_request(response, reason, msg.Result.RESULT_FEATURE_UNSUPPORTED)
            return _report_success(response)

    # Entities

    def _handle_get_entities(self, request: Any, response: Any) -> Any:
        if request.filters.bounds.type != msg.Bounds.TYPE_EMPTY:
            reason = str(Refusal("filters", "bounds", "be empty", request.filters.bounds.type))
            return _refuse_request(response, reason, msg.Result.RESULT_FEATURE_UNSUPPORTED)
        with self._lock:
            try:
                response.entities = self._entities.filter_names(request.filters)
            except Refusal as reason:
                return _refuse_request(response, str(reason), msg.Result.RESULT_OPERATION_FAILED)
            if hasattr(response, "states"):
                self._entities.place_links()
                for name in response.entities:
                    state = msg.EntityState()
                    self._entities.fill_state(name, state)
                    response.states.append(state)
        return _report_success(response)

    def _handle_get_entity_state(self, request: Any, response: Any) -> Any:
        if not self._has_entity(request.entity, response):
            return response
        with self._lock:
            self._entities.place_links()
            self._entities.fill_state(request.entity, response.state)
        return _report_success(response)

    def _handle_set_entity_state(self, request: Any, response: Any) -> Any:
        if not self._has_entity(request.entity, response):
            return response
        reason = "links move with their joints: set those with ~/set_state"
        return _refuse_request(response, reason, msg.Result.RESULT_FEATURE_UNSUPPORTED)

    def _handle_get_entity_info(self, request: Any, response: Any) -> Any:
        name, entities = request.entity, self._entities
        if not self._has_entity(name, response):
            return response
        response.info.category.category = entities.get_category(name)
        of, scene = self._session.scene.name, f"arm of {len(self._session.scene.joints)} joints"
        response.info.description = f"link of {of}" if entities.is_link(name) else scene
        response.info.tags = entities.get_tags(name)
        return _report_success(response)

    def _has_entity(self, name: str, response: Any) -> bool:
        names = self._entities.names
        if name not in names:
            reason = str(Refusal("simulation", "entity", "be known", name, ", ".join(names)))
            _refuse_request(response, reason, msg.Result.RESULT_NOT_FOUND)
        return name in names


def _list_features(response: Any) -> Any:
    features = response.features
    numbers = (getattr(msg.SimulatorFeatures, name, None) for name in FEATURES)
    features.features = [number for number in numbers if number is not None]
    features.custom_info = "arm_emulator: one arm; machines are saved, restored and set by ~/"
    return response


def _report_success(response: Any, words: str = "") -> Any:
    response.result.result, response.result.error_message = msg.Result.RESULT_OK, words
    return response


def _refuse_request(response: Any, reason: str, result: int | None = None) -> Any:
    """Write a reason into a response; None: the state does not permit the call."""
    wrong = msg.Result.RESULT_INCORRECT_STATE if result is None else result
    response.result.result, response.result.error_message = wrong, reason
    return response


def _report_failure(reason: Refusal, goal: Any) -> Any:
    result = action.SimulateSteps.Result()
    goal.abort()
    return _refuse_request(result, str(reason), msg.Result.RESULT_OPERATION_FAILED)
