"""An emulated industrial arm: a machine, its servo and its motion control.

Programs may rely on the names of `__all__`. They are imported at their first use, so that
``import arm_emulator`` takes no time. All other modules are internal, and may change with any
version.
"""

from __future__ import annotations

# Nothing is imported here: `python -m arm_emulator` runs this while the user's folder is on the
# path.
TYPE_CHECKING = False
if TYPE_CHECKING:
    from typing import Any

    __version__: str
    from arm_emulator import testing as testing
    from arm_emulator.analysis.linearised import LinearMachine as LinearMachine
    from arm_emulator.analysis.linearised import linearise as linearise
    from arm_emulator.analysis.sensitivities import Sensitivities as Sensitivities
    from arm_emulator.analysis.sensitivities import sensitivities as sensitivities
    from arm_emulator.base.refusal import Refusal as Refusal
    from arm_emulator.machine.plant.diverged import Diverged as Diverged
    from arm_emulator.machine.plant.external_wrench import ExternalWrench as ExternalWrench
    from arm_emulator.machine.plant.measured import Measured as Measured
    from arm_emulator.machine.plant.plant import Plant as Plant
    from arm_emulator.machine.plant.plant_state import PlantState as PlantState
    from arm_emulator.machine.scene.scene import Scene as Scene
    from arm_emulator.machine.scene.scene import load_scene as load_scene
    from arm_emulator.machine.session.change import NumberChange as NumberChange
    from arm_emulator.machine.session.change import PowerChange as PowerChange
    from arm_emulator.machine.session.change import WrenchChange as WrenchChange
    from arm_emulator.machine.session.session import Session as Session
    from arm_emulator.motion.model.kinematics import Kinematics as Kinematics
    from arm_emulator.motion.model.pose import Pose as Pose
    from arm_emulator.motion.planner.jacobian_controller import (
        JacobianController as JacobianController,
    )
    from arm_emulator.runs.breakpoint import Breakpoint as Breakpoint
    from arm_emulator.runs.condition import Condition as Condition
    from arm_emulator.runs.gains import load_gains as load_gains
    from arm_emulator.runs.offline import OfflineRun as OfflineRun
    from arm_emulator.runs.recording import Recording as Recording
    from arm_emulator.runs.timeline import Timeline as Timeline
    from arm_emulator.servo.servo import Servo as Servo
    from arm_emulator.servo.servo_config import load_servo_config as load_servo_config

_MODULES = {
    "Breakpoint": "runs.breakpoint",
    "Condition": "runs.condition",
    "Diverged": "machine.plant.diverged",
    "ExternalWrench": "machine.plant.external_wrench",
    "JacobianController": "motion.planner.jacobian_controller",
    "Kinematics": "motion.model.kinematics",
    "LinearMachine": "analysis.linearised",
    "Measured": "machine.plant.measured",
    "NumberChange": "machine.session.change",
    "OfflineRun": "runs.offline",
    "Plant": "machine.plant.plant",
    "PlantState": "machine.plant.plant_state",
    "Pose": "motion.model.pose",
    "PowerChange": "machine.session.change",
    "Recording": "runs.recording",
    "Refusal": "base.refusal",
    "Scene": "machine.scene.scene",
    "Sensitivities": "analysis.sensitivities",
    "Servo": "servo.servo",
    "Timeline": "runs.timeline",
    "Session": "machine.session.session",
    "WrenchChange": "machine.session.change",
    "linearise": "analysis.linearised",
    "load_gains": "runs.gains",
    "load_scene": "machine.scene.scene",
    "load_servo_config": "servo.servo_config",
    "sensitivities": "analysis.sensitivities",
    "testing": "",
}

__all__ = [  # noqa: PLE0604  # found at their first use
    *_MODULES
]


def __getattr__(name: str) -> Any:
    import importlib

    if name == "__version__":
        from arm_emulator.version import VERSION

        return VERSION
    if name not in _MODULES:
        import sys

        rule = f"module {__name__!r} has no attribute {name!r}"
        raise AttributeError(rule, name=name, obj=sys.modules[__name__])
    if not _MODULES[name]:
        return importlib.import_module(f"{__name__}.{name}")
    value = getattr(importlib.import_module(f"{__name__}.{_MODULES[name]}"), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
