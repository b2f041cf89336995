"""Parameters of the motion controller."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from words.parameters import load_parameters, parameter


@dataclass(frozen=True)
class MotionConfig:
    """Parameters of the motion controller."""

    tool: str = parameter("tool", "link of the robot description that is the tool")
    period: float = parameter(
        0.05, "logical time between joint targets", unit="s", minimum=1e-4, maximum=10.0
    )
    method: str = parameter(
        "auto",
        "control law: paper, eq. (6); qp, within all limits; auto: paper below 6 joints, else qp",
        choices=("auto", "paper", "qp"),
    )
    weight: float = parameter(0.5, "w of eq. (6)", minimum=1e-6, maximum=1.0, settable=True)
    task: str = parameter(
        "auto",
        "what the target rules; auto: position below 6 joints, else pose",
        choices=("auto", "position", "pose"),
    )
    step_limit: float = parameter(
        0.2,
        "largest joint step per instruction",
        unit="rad",
        minimum=1e-6,
        maximum=100.0,
        settable=True,
    )
    singular_below: float = parameter(
        0.02,
        "singular values of the Jacobian below this are damped",
        minimum=1e-9,
        maximum=1.0,
        settable=True,
    )
    velocity_limit: float = parameter(
        3.0,
        "qp: largest joint speed, beside the robot description's",
        unit="rad/s",
        minimum=1e-6,
        maximum=1e3,
        settable=True,
    )
    acceleration_limit: float = parameter(
        10.0,
        "qp: largest joint acceleration, beside the robot description's",
        unit="rad/s2",
        minimum=1e-6,
        maximum=1e5,
        settable=True,
    )


def load_motion_config(path: Path) -> MotionConfig:
    """Read a ROS parameter file of the node `motion_controller`.

    Raises:
        Refusal: a value that is not taken.
    """
    return load_parameters(path, "motion_controller", MotionConfig)
