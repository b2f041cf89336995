"""Internals of rclpy that a node with messages in C, or with a barrier, needs.

Versions: rclpy 7.1 (Jazzy). Reasons: rclpy has no wait set of chosen entities, and calls no
callback for bytes that were taken elsewhere. It fails at a request for a transition that a state
does not have, and at a clock message with a malformed time.
Test: test/toolchain/test_workarounds.py, `test_rclpy_fails_at_bad_transitions_and_times`.
"""

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.lifecycle import LifecycleNode
from rclpy.node import Node


def make_wait_set(counts: Sequence[int], context: Any) -> Any:
    """Return a wait set of rcl.

    Args:
        counts: subscriptions, guard conditions, timers, clients, services, events.
        context: handle of their context.
    """
    return rclpy_implementation.WaitSet(*counts, context)


def make_guard_condition(context: Any) -> Any:
    """Return a guard condition of rcl, for the handle of a context."""
    return rclpy_implementation.GuardCondition(context)


def call_subscription_back(subscription: Any, taken: tuple[Any, Any]) -> None:
    """Call back with a taken message, and with its facts where the callback wants them."""
    if subscription._callback_type is subscription.CallbackType.MessageOnly:  # noqa: SLF001
        subscription.callback(taken[0])
    else:
        subscription.callback(*taken)


def replace_clock_callback(node: Node, take: Callable[[Callable[[Any], None], Any], None]) -> None:
    """Let `take` get rclpy's own callback for messages on `clock`, and each message."""
    source: Any = node._time_source  # noqa: SLF001
    source.clock_callback = partial(take, source.clock_callback)
    if source._clock_sub is not None:  # noqa: SLF001  # made before, with the method as it was
        source._clock_sub.callback = source.clock_callback  # noqa: SLF001


def replace_transition_callback(node: LifecycleNode, callback: Callable[[Any, Any], Any]) -> None:
    """Let a callback answer the service `change_state` of a managed node."""
    node._service_change_state.callback = callback  # noqa: SLF001


def get_state(node: LifecycleNode) -> str:
    """Return the name of the state of a managed node."""
    return str(node._state_machine.current_state[1])  # noqa: SLF001


def get_transitions(node: LifecycleNode) -> dict[str, int]:
    """Return the numbers of the transitions of a managed node's state, by their labels."""
    transitions = node._state_machine.available_transitions  # noqa: SLF001
    return {str(label): int(number) for number, label, *_ in transitions}


def release_state_machine(node: LifecycleNode) -> None:
    """Release the state machine of a node that was destroyed; else it keeps the node."""
    node._state_machine.destroy_when_not_in_use()  # noqa: SLF001
