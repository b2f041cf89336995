"""Services of the emulator: pause, step, reset, power, and its machine saved, restored and set."""

from array import array
from collections.abc import Callable
from functools import partial
from typing import Any

from std_srvs.srv import SetBool, Trigger

from arm_emulator.base.refusal import Refusal
from arm_emulator_msgs.msg import MachineEvent
from arm_emulator_msgs.srv import BreakWhen, RestoreState, SaveState, SetState, SetVaried
from emulator_node.breakpoints import Breakpoints
from emulator_node.changes import Changes
from emulator_node.context import Context
from emulator_node.time_control import TimeControl

SAVED_LIMIT = 1000  # states that are kept by name


class Services:
    """Time and power; saving, restoring and setting the machine by hand; breakpoints.

    Each handler returns why the request failed, or "". A Refusal is answered by the node's barrier.
    """

    def __init__(
        self, own: Context, control: TimeControl, changes: Changes, breaks: Breakpoints
    ) -> None:
        self._session, self._gate, self._lock = own.session, own.gate, own.lock
        self._control, self._changes, self._breaks = control, changes, breaks
        self._saved: dict[str, bytes] = {}  # machines by name
        for kind, name, handle in (
            (SetBool, "pause", self._pause_time),
            (Trigger, "step", lambda request, response: control.step_tick()),
            (Trigger, "reset", self._reset_machine),
            (SetBool, "power", self._switch_power),
            (SaveState, "save_state", self._save_state),
            (RestoreState, "restore_state", self._restore_state),
            (SetState, "set_state", self._set_state),
            (SetVaried, "set_varied", self._set_varied),
            (BreakWhen, "break_when", self._set_breakpoint),
        ):
            own.node.create_service(kind, f"~/{name}", partial(self._answer_request, handle))

    def _answer_request(
        self, handle: Callable[[Any, Any], str], request: Any, response: Any
    ) -> Any:
        with self._lock:
            trouble = handle(request, response)
            response.success = not trouble
            response.message = trouble or response.message or f"at tick {self._session.tick}"
        return response

    def _pause_time(self, request: SetBool.Request, response: SetBool.Response) -> str:
        self._control.pause_time(request.data)
        done = "paused" if request.data else "going on"
        response.message = f"{done} at tick {self._session.tick}"
        return ""

    def _reset_machine(self, request: Trigger.Request, response: Trigger.Response) -> str:
        self._control.reset_time()
        response.message = "at tick 0"  # time may pass from here on
        return ""

    def _switch_power(self, request: SetBool.Request, response: SetBool.Response) -> str:
        self._control.switch_power(request.data)
        response.message = (
            "power on" if request.data else "power off: motors at 0 V, windings shorted"
        )
        return ""

    def _save_state(self, request: SaveState.Request, response: SaveState.Response) -> str:
        with self._changes.pause_between_ticks():
            if len(self._saved) >= SAVED_LIMIT and request.name not in {"", *self._saved}:
                rule = f"be one of the {SAVED_LIMIT} that are kept already"
                raise Refusal("save_state", "name", rule, request.name)
            saved = self._session.plant.save()
            if request.name:
                self._saved[request.name] = saved
            response.state = array("B", saved)
            response.message = f"at tick {self._session.tick}"
            return ""

    def _restore_state(self, request: RestoreState.Request, response: RestoreState.Response) -> str:
        def restore_machine() -> None:
            if bool(request.name) == bool(request.state):
                actual = "both" if request.name else "neither"
                raise Refusal("restore_state", "what is restored", "be a name or a state", actual)
            if request.name and request.name not in self._saved:
                valid = ", ".join(self._saved) or "none"
                raise Refusal("restore_state", "name", "be a saved one", request.name, valid)
            self._session.restore(self._saved.get(request.name, bytes(request.state)))

        return self._change_machine(MachineEvent.KIND_RESTORE, restore_machine)

    def _set_state(self, request: SetState.Request, response: SetState.Response) -> str:
        values = {
            "current": request.current,
            "theta_m": request.motor_position,
            "omega_m": request.motor_velocity,
            "q": request.position,
            "v": request.velocity,
        }
        change = partial(self._session.set_state, request.joint_names, values)
        return self._change_machine(MachineEvent.KIND_SET_STATE, change)

    def _set_varied(self, request: SetVaried.Request, response: SetVaried.Response) -> str:
        change = partial(self._session.set_varied, request.name, request.value)
        return self._change_machine(MachineEvent.KIND_SET_VARIED, change)

    def _change_machine(self, kind: int, change: Callable[[], None]) -> str:
        """Change the machine, publish its new state, and continue from there."""
        if behind := self._gate.find_full_recorder():
            return f"recorder {behind} has to catch up first, ask again then"
        self._changes.put_change(kind, change)
        return ""

    def _set_breakpoint(self, request: BreakWhen.Request, response: BreakWhen.Response) -> str:
        with self._changes.pause_between_ticks():
            self._breaks.set_breakpoint(request)
        return ""
