"""Events and states of motions in words."""

from arm_emulator_msgs.msg import MachineEvent, MotionStatus


def _name_constants(message: type, begin: str) -> dict[int, str]:
    """Return the constants of a message that begin so, in words, by their numbers."""
    constants = (name for name in dir(message) if name.startswith(begin))
    return {
        getattr(message, name): name.removeprefix(begin).lower().replace("_", " ")
        for name in constants
    }


_CHANGES = _name_constants(MachineEvent, "KIND_")
STATES = _name_constants(MotionStatus, "STATE_")
_MOTIONS = _name_constants(MotionStatus, "KIND_")


def describe_change(kind: int, powered: bool) -> str:
    """Return a change by hand, by its kind in `MachineEvent`."""
    if kind == MachineEvent.KIND_POWER:
        return f"power {'on' if powered else 'off'}"
    return _CHANGES.get(kind, str(kind))


def describe_motion(status: MotionStatus) -> str:
    """Return the state of a target, trajectory or path."""
    goal = f"{_MOTIONS.get(status.kind, status.kind)} {status.number}"
    reason = f": {status.reason}" if status.reason else ""
    return f"{goal} {STATES.get(status.state, status.state)}{reason}"
