"""Parameters of a node: declared from a dataclass, checked in our words, changed together or not.

Those that are read once, when the node is configured, may be set while it is unconfigured.
"""

import dataclasses
from collections.abc import Callable, Mapping
from typing import Any

from rcl_interfaces.msg import (
    FloatingPointRange,
    IntegerRange,
    ParameterDescriptor,
    SetParametersResult,
)
from rclpy.parameter import Parameter as RosParameter

from arm_emulator.base.refusal import Refusal
from arm_emulator.base.validation.number import Number
from arm_emulator.base.validation.parameters import (
    ROS_PARAMETERS,
    Parameters,
    check_parameter,
    list_parameters,
    suggest_nearest_name,
)
from arm_emulator.ros.node.managed_node import ManagedNode

SETTABLE = "set in every state of the node"


def declare_parameters(node: ManagedNode, kind: type[Parameters]) -> Parameters:
    """Declare every field of the frozen dataclass `kind` on the node and return the values.

    Raises:
        Refusal: a value of the wrong type or out of its range.
    """
    where, fields = f"node {node.get_name()}", list_parameters(kind).values()
    values = {}
    for field in fields:
        if not node.has_parameter(field.name):
            # A loose descriptor first: the check below refuses in our words, and takes 1 for 1.0.
            loose = ParameterDescriptor(dynamic_typing=True)
            node.declare_parameter(field.name, field.default, loose)
        value = check_parameter(node.get_parameter(field.name).value, field, where)
        values[field.name] = value
        choices = field.metadata["choices"]
        descriptor = ParameterDescriptor(
            description=field.metadata["description"],
            additional_constraints=f"one of {', '.join(choices)}" if choices else "",
            dynamic_typing=True,
        )
        if field.metadata["settable"]:
            node.settable.add(field.name)
        describe_parameter(node, field.name, descriptor, field.metadata.get("number"))
    return kind(**values)


def refuse_unknown_parameters(
    node: ManagedNode, config: object, beside: tuple[str, ...] = ()
) -> None:
    """Refuse parameters that were given to the node and are neither in `config` nor ROS's own.

    The node must have been created with ``automatically_declare_parameters_from_overrides``.
    `beside` are the names of sections that the node reads itself.

    Raises:
        Refusal: a parameter is unknown, for example misspelt.
    """
    names = [*list_parameters(type(config)), *beside]
    for name in node.get_parameters_by_prefix(""):
        if name.split(".")[0] not in (*names, *ROS_PARAMETERS):
            where = f"node {node.get_name()}"
            actual = f"an unknown one{suggest_nearest_name(name, names)}"
            raise Refusal(where, f"parameter {name}", "be a known one", actual, ", ".join(names))


def accept_changes(
    node: ManagedNode, prepare: Callable[[Mapping[str, Any]], Any], take: Callable[[Any], None]
) -> None:
    """Let parameters be set: all of a request together, or none.

    Args:
        node: whose parameters are declared; those that are not in its `settable` are refused,
            unless it is unconfigured.
        prepare: returns the new working objects, given the changes; a Refusal is the answer.
        take: gets those objects if nothing is refused.
    """

    def list_changes(parameters: list[RosParameter]) -> dict[str, Any]:
        own = (
            parameter
            for parameter in parameters
            if parameter.name.split(".")[0] not in ROS_PARAMETERS
        )
        return {parameter.name: parameter.value for parameter in own}

    def check_changes(parameters: list[RosParameter]) -> SetParametersResult:
        try:
            for name in list_changes(parameters):
                if node.configured and name not in node.settable:
                    where, rule = f"node {node.get_name()}", "be set while the node is unconfigured"
                    raise Refusal(where, f"parameter {name}", rule, node.state)
            prepare(list_changes(parameters))
        except Refusal as reason:
            return SetParametersResult(successful=False, reason=str(reason))
        return SetParametersResult(successful=True)

    def handle_change(parameters: list[RosParameter]) -> None:
        if changed := list_changes(parameters):
            take(prepare(changed))

    node.add_on_set_parameters_callback(check_changes)
    node.add_post_set_parameters_callback(handle_change)


def replace_parameters(
    node: ManagedNode, config: Parameters, changes: Mapping[str, Any]
) -> Parameters:
    """Return the parameters of a node with some changed.

    Raises:
        Refusal: a value of the wrong type or out of its range.
    """
    fields, where = list_parameters(type(config)), f"node {node.get_name()}"
    checked = {name: check_parameter(value, fields[name], where) for name, value in changes.items()}
    return dataclasses.replace(config, **checked)  # type: ignore[type-var]


def describe_parameter(
    node: ManagedNode, name: str, descriptor: ParameterDescriptor, number: Number | None
) -> None:
    """Set a parameter's descriptor, with its range; None: it is not a number.

    Its constraints name those that may be set in every state, so `settable` is complete before.
    """
    if name in node.settable:
        descriptor.additional_constraints = SETTABLE
    if number is not None:
        first, last = number.ends
        if number.whole:
            steps = IntegerRange(from_value=round(first), to_value=round(last), step=1)
            descriptor.integer_range = [steps]
        else:
            any_ = FloatingPointRange(from_value=float(first), to_value=float(last))
            descriptor.floating_point_range = [any_]
    node.set_descriptor(name, descriptor)
