"""Changes of a run by hand as data, so that another process can make them again."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from arm_emulator.base.refusal import Refusal
from arm_emulator.machine.plant.external_wrench import ExternalWrench
from arm_emulator.machine.session.change import Change, NumberChange, PowerChange, WrenchChange
from arm_emulator.motion.model.pose import Pose
from arm_emulator.runs.offline import OfflineRun
from arm_emulator.runs.timeline import Timeline

Vector = tuple[float, float, float]
NO_VECTOR = (0.0, 0.0, 0.0)


@dataclass(frozen=True)
class Order:
    """A change of an `OfflineRun`, which is called with it.

    Attributes:
        kind: its name in files.
    """

    kind: ClassVar[str]

    @property
    def name(self) -> str:
        """The change in words."""
        raise NotImplementedError

    @property
    def change(self) -> Change | None:
        """The change of the machine; None: it is for servo or motion controller."""
        return None

    def __call__(self, run: OfflineRun) -> None:
        """Make the change between two ticks.

        Raises:
            Refusal: the run does not take it; nothing has changed.
        """
        if self.change is None:
            raise NotImplementedError
        self.change.make(run.session)

    def give(self, line: Timeline[OfflineRun]) -> None:
        """Make the change in a timeline, see `Timeline.change`."""
        line.change(self.name, self)


@dataclass(frozen=True)
class MoveTool(Order):
    """Sends the tool to a place beside the one where it is, `by` [m] in the world."""

    kind: ClassVar[str] = "move"
    by: Vector

    @property
    def name(self) -> str:
        """The change in words."""
        return f"tool by {', '.join(f'{distance:g}' for distance in self.by)} m"

    def __call__(self, run: OfflineRun) -> None:
        """Give the target to the motion controller."""
        run.instructor.add(run.session.logical_ns, self.target(run))

    def target(self, run: OfflineRun) -> Pose:
        """Return the pose, through the quaternion as in a message, for the same rounding."""
        R_WT, p_WT = run.controller.kinematics.forward(run.session.state.q)
        turned = Pose(p_WT, R_WT).quaternion()
        return Pose.from_quaternion(p_WT + np.array(self.by), turned, "a move of the tool")


@dataclass(frozen=True)
class SwitchPower(Order):
    """Switches the drives' power."""

    kind: ClassVar[str] = "power"
    on: bool

    @property
    def name(self) -> str:
        """The change in words."""
        return f"power {'on' if self.on else 'off'}"

    @property
    def change(self) -> PowerChange:
        """The switch."""
        return PowerChange(self.on)


@dataclass(frozen=True)
class ScaleGains(Order):
    """Multiplies the servo's position gains by a factor."""

    kind: ClassVar[str] = "gains"
    factor: float

    @property
    def name(self) -> str:
        """The change in words."""
        return f"position gains times {self.factor:g}"

    def __call__(self, run: OfflineRun) -> None:
        """Set the gains."""
        if not (math.isfinite(self.factor) and self.factor > 0.0):
            raise Refusal("order", "factor of gains", "be finite and above 0", self.factor)
        config = run.drives.servo.config
        joints = tuple(
            dataclasses.replace(joint, position_gain=self.factor * joint.position_gain)
            for joint in config.joints
        )
        run.drives.set_config(dataclasses.replace(config, joints=joints))


@dataclass(frozen=True)
class SetVaried(Order):
    """Sets a number that the scene lists as varied, or the magnitude of a fault."""

    kind: ClassVar[str] = "set_varied"
    number: str
    value: float

    @property
    def name(self) -> str:
        """The change in words."""
        return f"{self.number} = {self.value:g}"

    @property
    def change(self) -> NumberChange:
        """The number."""
        return NumberChange(self.number, self.value)


@dataclass(frozen=True)
class Push(Order):
    """Lets a force [N] and a moment [N m] act on a link from now on, along the world's axes."""

    kind: ClassVar[str] = "external_wrench"
    link: str
    force: Vector = NO_VECTOR
    moment: Vector = NO_VECTOR

    @property
    def name(self) -> str:
        """The change in words."""
        return f"{self.link} is pushed with {', '.join(f'{force:.3g}' for force in self.force)} N"

    @property
    def change(self) -> WrenchChange:
        """The wrench."""
        return WrenchChange(self.link, ExternalWrench(self.force, self.moment, axes="world"))


ORDERS: tuple[type[Order], ...] = (MoveTool, SwitchPower, ScaleGains, SetVaried, Push)
"""All kinds but those of the modules that read them beside these."""


def convert_to_data(order: Order) -> dict[str, Any]:
    """Return an order as it stands in a file."""
    return {"kind": order.kind, **dataclasses.asdict(order)}


def read_order(where: str, data: Any, further: Sequence[type[Order]] = ()) -> Order:
    """Return the order that stands in a file.

    Args:
        where: the file, for refusals.
        data: of the order.
        further: kinds that the file may have beside `ORDERS`.

    Raises:
        Refusal: it is not an order.
    """
    kinds = {order.kind: order for order in (*ORDERS, *further)}
    kind = kinds.get(data.get("kind", "")) if isinstance(data, Mapping) else None
    if kind is None:
        raise Refusal(where, "order", "be of a known kind", data, ", ".join(kinds))
    values = {name: value for name, value in data.items() if name != "kind"}
    fields = {field.name: str(field.type) for field in dataclasses.fields(kind)}
    if values.keys() != fields.keys():
        raise Refusal(where, f"order {kind.kind}", f"have {', '.join(fields)}", ", ".join(values))
    taken = {name: _check_value(where, name, fields[name], value) for name, value in values.items()}
    return kind(**taken)


def _check_value(where: str, name: str, kind: str, value: Any) -> Any:
    """Return a field's value if it is of its kind."""
    if kind == "Vector" and isinstance(value, Sequence) and len(value) == 3:
        if all(_is_number(element) for element in value):
            return tuple(map(float, value))
    elif kind == "float" and _is_number(value):
        return float(value)
    elif kind == "bool" and isinstance(value, bool):
        return value
    elif kind == "str" and isinstance(value, str):
        return value
    raise Refusal(where, f"order, {name}", f"be a {kind}", value)


def _is_number(value: Any) -> bool:
    number = isinstance(value, int | float) and not isinstance(value, bool)
    return number and math.isfinite(value)
