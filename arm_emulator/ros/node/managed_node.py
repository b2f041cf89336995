"""A node with the states of ROS 2's managed nodes, which brings itself up unless asked not to."""

import inspect
import time
import traceback
from collections.abc import Callable
from contextlib import ExitStack
from typing import Any, ClassVar

from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState
from rcl_interfaces.msg import ParameterDescriptor
from rcl_interfaces.srv import SetParameters
from rclpy.executors import ExternalShutdownException
from rclpy.lifecycle import LifecycleNode, LifecycleState, TransitionCallbackReturn
from rclpy.qos import DurabilityPolicy

from arm_emulator.base.refusal import Refusal
from arm_emulator.ros.messages.middleware import HotPath
from arm_emulator.ros.node.barrier import (
    guard_callback,
    guard_coroutine,
    refuse_request,
    set_singly,
)
from arm_emulator.ros.node.sole_publisher import OwnExecutorOnly, SolePublisher
from arm_emulator.workarounds.rclpy_internals import (
    get_state,
    get_transitions,
    release_state_machine,
    replace_transition_callback,
)

CLOCK = "/clock"
# Those that a client may ask for; the others report the end of one.
TRANSITIONS = range(Transition.TRANSITION_CONFIGURE, Transition.TRANSITION_ACTIVE_SHUTDOWN + 1)


class ManagedNode(LifecycleNode):
    """A node that is configured, activated, deactivated, cleaned up, and shut down.

    A subclass declares its parameters in its constructor, and calls `start_lifecycle` at its end.
    Entities that it creates in `create_entities` work while it is active: otherwise messages to
    them are dropped, their timers stand, and their services refuse. Those of the constructor work
    in every state. All callbacks of messages and services are behind the barrier, see
    `guard_callback`.

    Attributes:
        refuse: gets a topic or a service, the reason for which an input of it is refused, and how
            often it came.
        count: gets what is counted without a warning, and how often it came.
        note: gets name and value of what its health is to have.
        has_lost: returns whether of some publishers of a kind of nodes one was killed.
        sole_publishers: of subscriptions whose topic one node publishes on.
        settable: names of the parameters that may be set in every state; the others while it is
            unconfigured.
        configured, active: its state.
        starting: the newest one whose `start_lifecycle` has not succeeded, which no other code has.
        generation: number of transitions so far.
        in_c_so_far, in_python_so_far: messages taken in C, and in Python, since its start.
        hot: its messages in C; None: nothing.
        cleanup: its callbacks are called when the node is cleaned up, the last one first.
    """

    hot: HotPath | None = None
    generation = in_c_so_far = in_python_so_far = 0
    configured = active = False
    starting: "ClassVar[ManagedNode | None]" = None
    _configuring = False

    def __init__(self, name: str) -> None:
        self.sole_publishers: dict[Any, SolePublisher] = {}
        # `Diagnostics` and `DuplicateNodes` put their own in the places of these.
        self.refuse: Callable[..., None] = self._log_refusal
        self.count: Callable[..., None] = lambda counter, times=1: None
        self.note: Callable[[str, object], None] = lambda quantity, value: None
        self.has_lost: Callable[[str, int], bool] = lambda kind, there: False
        super().__init__(name, automatically_declare_parameters_from_overrides=True)
        replace_transition_callback(self, self._handle_change_state)
        for service in self.services:  # of rclpy, made without `create_service`
            service.callback = guard_callback(
                self, service.srv_name, service.callback, refuse_request
            )
        self.settable: set[str] = set()
        self.cleanup = ExitStack()
        self._permanent: list[Any] = []  # entities of the constructor
        self._stopped: list[Any] = []  # timers that go on when it is active
        self._error: Exception | None = None  # of the newest transition
        if not self.has_parameter("autostart"):
            self.declare_parameter("autostart", True)
        text = "whether the node configures and activates itself at its start"
        descriptor = ParameterDescriptor(description=text, dynamic_typing=True, read_only=True)
        self.set_descriptor("autostart", descriptor)

    # Work of a subclass

    def create_entities(self) -> None:
        """Create all that works while the node is active; a Refusal leaves it unconfigured."""

    def begin_work(self) -> None:
        """Begin to work; a Refusal leaves the node inactive."""

    def stop_work(self) -> None:
        """Stand still, so that `begin_work` can go on."""

    # For its owner

    @property
    def state(self) -> str:
        """The state by its name."""
        return get_state(self)

    @property
    def in_c(self) -> HotPath | None:
        """Messages that are taken in C now."""
        return self.hot if self.active else None

    @property
    def figures(self) -> dict[str, object]:
        """Use of the process by messages, for its diagnostics."""
        return {
            "messages taken in C": self.in_c_so_far,
            "messages taken in Python": self.in_python_so_far,
            "processor time [s]": f"{time.process_time():.2f}",
        }

    def start_lifecycle(self) -> None:
        """Configure and activate, unless `autostart` is false.

        Raises:
            Refusal: the node cannot be configured or activated; or the parameter is no truth value.
        """
        autostart = self.get_parameter("autostart").value
        if not isinstance(autostart, bool):
            where, rule = f"node {self.get_name()}", "be true or false"
            raise Refusal(where, "parameter autostart", rule, repr(autostart))
        if autostart:
            ManagedNode.starting = self
            self._run_transitions(self.trigger_configure, self.trigger_activate)
            ManagedNode.starting = None

    def restart_lifecycle(self) -> None:
        """Clean up, and start as at the begin, see `start_lifecycle`."""
        self._run_transitions(self.trigger_deactivate, self.trigger_cleanup)
        self._run_transitions(self.trigger_configure, self.trigger_activate)

    def close(self) -> None:
        """Release all resources at the end of the process.

        Raises:
            Refusal: outputs are incomplete.
        """
        self.active = False
        self.cleanup.close()

    def destroy_node(self) -> None:
        """See `Node`: it has left the network afterwards."""
        super().destroy_node()
        release_state_machine(self)

    # Transitions

    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        """See `LifecycleNode`."""
        return self._try_transition(self._configure_node, self._release_entities)

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """See `LifecycleNode`."""
        return self._try_transition(self._activate_node, self._stop_timers)

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """See `LifecycleNode`."""
        return self._try_transition(self._deactivate_node, self._stop_timers)

    def on_cleanup(self, state: LifecycleState) -> TransitionCallbackReturn:
        """See `LifecycleNode`."""
        return self._try_transition(self._release_entities, self._release_entities)

    def on_shutdown(self, state: LifecycleState) -> TransitionCallbackReturn:
        """See `LifecycleNode`."""
        if self.active:
            self._try_transition(self._deactivate_node, self._stop_timers)
        return self._try_transition(self._release_entities, self._release_entities)

    def on_error(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Release all, so that the node can be configured again."""
        cause = self._error
        result = self._try_transition(self._release_entities, self._release_entities)
        self._error = cause
        return result

    def _try_transition(
        self, do: Callable[[], None], undo: Callable[[], None]
    ) -> TransitionCallbackReturn:
        self.generation += 1
        self._error = None
        try:
            do()
        except Refusal as reason:
            self._error = reason
            undo()
            return TransitionCallbackReturn.FAILURE
        except Exception as error:
            self._error = error
            return TransitionCallbackReturn.ERROR
        return TransitionCallbackReturn.SUCCESS

    def _configure_node(self) -> None:
        self._permanent = self._list_entities()
        self._configuring = True
        try:
            self.create_entities()
        finally:
            self._configuring = False
        self.configured = True
        self._stop_timers()

    def _activate_node(self) -> None:
        self.begin_work()
        self.active = True
        for timer in self._stopped:
            timer.reset()
        self._stopped = []

    def _deactivate_node(self) -> None:
        self.stop_work()
        self._stop_timers()

    def _stop_timers(self) -> None:
        self.active = False
        own = [timer for timer in self.timers if timer not in self._permanent]
        # A timer that an earlier call has stopped goes on, too, after a refused activation.
        running = [timer for timer in own if not timer.is_canceled()]
        self._stopped += [timer for timer in running if timer not in self._stopped]
        for timer in running:
            timer.cancel()

    def _release_entities(self) -> None:
        self.active = self.configured = False
        self.hot, self._stopped = None, []
        try:
            self.cleanup.close()
        finally:
            # Entities of `create_entities`, and later ones.
            for one in (
                entity for entity in self._list_entities() if entity not in self._permanent
            ):
                for many, destroy in (
                    (self.publishers, self.destroy_publisher),
                    (self.subscriptions, self.destroy_subscription),
                    (self.services, self.destroy_service),
                    (self.timers, self.destroy_timer),
                ):
                    if one in [*many]:
                        destroy(one)

    def _list_entities(self) -> list[Any]:
        return [*self.publishers, *self.subscriptions, *self.services, *self.timers]

    def _run_transitions(self, *transitions: Callable[[], TransitionCallbackReturn]) -> None:
        for transition in transitions:
            transition()
            if self._error is not None:
                raise self._error

    def _handle_change_state(
        self, request: ChangeState.Request, response: ChangeState.Response
    ) -> ChangeState.Response:
        try:
            number = self._check_transition(request.transition)
            self._trigger_transition(number)
            self._log_result()
        except Refusal as reason:
            self.get_logger().warning(str(reason))
            return response
        response.success = self._error is None
        return response

    def _trigger_transition(self, number: int) -> None:
        """Go through a transition."""
        triggers = {
            Transition.TRANSITION_CONFIGURE: self.trigger_configure,
            Transition.TRANSITION_CLEANUP: self.trigger_cleanup,
            Transition.TRANSITION_ACTIVATE: self.trigger_activate,
            Transition.TRANSITION_DEACTIVATE: self.trigger_deactivate,
        }
        triggers.get(number, self.trigger_shutdown)()

    def _check_transition(self, requested: Transition) -> int:
        """Return the number of a transition that may begin now.

        Raises:
            Refusal: it cannot; nothing has changed.
        """
        here = get_transitions(self)
        transitions = {label: number for label, number in here.items() if number in TRANSITIONS}
        if requested.label in transitions:
            return transitions[requested.label]
        if not requested.label and requested.id in transitions.values():
            return int(requested.id)
        rule = f"be one that leads from {self.state}"
        actual, valid = requested.label or requested.id, ", ".join(transitions) or "none"
        raise Refusal("change_state", "transition", rule, actual, valid)

    def _log_result(self) -> None:
        """Log what came of a transition that a client has asked for.

        Raises:
            ExternalShutdownException: a signal has shut the context down meanwhile.
        """
        trouble, logger = self._error, self.get_logger()
        if trouble is None:
            logger.info(self.state)
            return
        if isinstance(trouble, ExternalShutdownException) or not self.context.ok():
            raise ExternalShutdownException
        if isinstance(trouble, Refusal):
            logger.error(str(trouble))
        else:
            logger.error("".join(traceback.format_exception(trouble)))

    def _log_refusal(self, where: str, reason: Refusal, times: int = 1) -> None:
        self.get_logger().warning(f"{where}: refused: {reason}")

    # Entities

    def create_subscription(
        self,
        msg_type: Any,
        topic: str,
        callback: Callable[[Any], None],
        *more: Any,
        only_from: str | None = None,
        **named: Any,
    ) -> Any:
        """Create a subscription; in `create_entities` one that works while the node is active.

        Args:
            msg_type: as of `Node`.
            topic: the same.
            callback: the same.
            *more: the same.
            only_from: kind of nodes of which one publishes on the topic, see `SolePublisher`.
            **named: as of `Node`.
        """

        def pass_if_active(message: Any) -> None:
            if self.active:
                callback(message)

        if topic == CLOCK:  # rclpy's own, of `use_sim_time`
            only_from = "emulator"
        guarded = guard_callback(
            self, topic.strip("/"), pass_if_active if self._configuring else callback
        )
        if only_from is None:
            return super().create_subscription(msg_type, topic, guarded, *more, **named)
        named["callback_group"] = OwnExecutorOnly()
        subscription = super().create_subscription(msg_type, topic, guarded, *more, **named)
        keeps = subscription.qos_profile.durability is DurabilityPolicy.TRANSIENT_LOCAL
        self.sole_publishers[subscription] = SolePublisher(self, topic, only_from, keeps)
        return subscription

    def destroy_subscription(self, subscription: Any) -> bool:
        """See `Node`."""
        self.sole_publishers.pop(subscription, None)
        return bool(super().destroy_subscription(subscription))

    def create_service(
        self,
        srv_type: Any,
        srv_name: str,
        callback: Callable[[Any, Any], Any],
        *,
        refuse: Callable[[Any, str], None] | None = None,
        **named: Any,
    ) -> Any:
        """Create a service; in `create_entities` one that refuses while the node is not active.

        Args:
            srv_type: as of `Node`.
            srv_name: the same.
            callback: the same; a coroutine function may wait.
            refuse: writes a reason into a response without `success` and `message`.
            **named: as of `Node`.
        """
        name = srv_name.strip("~/")

        def write_refusal(reason: Refusal, request: Any, response: Any) -> Any:
            if refuse is not None:
                return refuse(response, str(reason))
            return refuse_request(reason, request, response)

        def check_active() -> None:
            if needs_active and not self.active:
                raise Refusal(name, "request", "come while the node is active", self.state)

        needs_active = self._configuring
        wrap = guard_coroutine if inspect.iscoroutinefunction(callback) else guard_callback
        guarded: Callable[..., Any] = wrap(self, name, callback, write_refusal, check_active)
        if srv_type is SetParameters:
            guarded = set_singly(guarded)
        return super().create_service(srv_type, srv_name, guarded, **named)
