"""Services of the emulator: pause, step, reset, power, and its machine saved, restored and set."""

from __future__ import annotations

from array import array
from collections.abc import Callable
from functools import partial

from std_srvs.srv import SetBool, Trigger

from arm_emulator.base.refusal import Refusal
from arm_emulator_msgs.msg import MachineEvent
from arm_emulator_msgs.srv import BreakWhen, RestoreState, SaveState, SetState, SetVaried
from emulator_node.breakpoints import Breakpoints
from emulator_node.changes import Changes
from emulator_node.context import Context
from emulator_node.time_control import TimeControl

MOST_SAVED = 1000  # states that are kept by name


class Services:
    """Time and power; saving, restoring and setting the machine by hand; breakpoints."""

    def __init__(
        self, own: Context, control: TimeControl, changes: Changes, breaks: Breakpoints
    ) -> None:
        self._session, self._gate, self._lock = own.session, own.gate, own.lock
        self._control, self._changes, self._breaks = control, changes, breaks
        self._saved: dict[str, bytes] = {}  # machines by name
        node = own.node
        node.create_service(SetBool, "~/pause", self._on_pause)
        node.create_service(Trigger, "~/step", self._on_step)
        node.create_service(Trigger, "~/reset", self._on_reset)
        node.create_service(SetBool, "~/power", self._on_power)
        node.create_service(SaveState, "~/save_state", self._on_save_state)
        node.create_service(RestoreState, "~/restore_state", self._on_restore_state)
        node.create_service(SetState, "~/set_state", self._on_set_state)
        node.create_service(SetVaried, "~/set_varied", self._on_set_varied)
        node.create_service(BreakWhen, "~/break_when", self._on_break_when)

    def _on_pause(self, request: SetBool.Request, response: SetBool.Response) -> SetBool.Response:
        with self._lock:
            self._control.pause(request.data)
            response.success = True
            done = "paused" if request.data else "going on"
            response.message = f"{done} at tick {self._session.tick}"
            return response

    def _on_step(self, request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        with self._lock:
            trouble = self._control.step()
            response.success = not trouble
            response.message = trouble or f"at tick {self._session.tick}"
            return response

    def _on_reset(self, request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        with self._lock:
            self._control.reset()
            response.success, response.message = True, "at tick 0"
            return response

    def _on_power(self, request: SetBool.Request, response: SetBool.Response) -> SetBool.Response:
        with self._lock:
            self._control.power(request.data)
        response.success = True
        response.message = (
            "power on" if request.data else "power off: motors at 0 V, windings shorted"
        )
        return response

    def _on_save_state(
        self, request: SaveState.Request, response: SaveState.Response
    ) -> SaveState.Response:
        with self._lock, self._changes.between_ticks():
            if len(self._saved) >= MOST_SAVED and request.name not in {"", *self._saved}:
                rule = f"be one of the {MOST_SAVED} that are kept already"
                response.message = str(Refusal("save_state", "name", rule, request.name))
                return response
            saved = self._session.plant.save()
            if request.name:
                self._saved[request.name] = saved
            response.success, response.state = True, array("B", saved)
            response.message = f"at tick {self._session.tick}"
            return response

    def _on_restore_state(
        self, request: RestoreState.Request, response: RestoreState.Response
    ) -> RestoreState.Response:
        def restore() -> None:
            if bool(request.name) == bool(request.state):
                got = "both" if request.name else "neither"
                raise Refusal("restore_state", "what is restored", "be a name or a state", got)
            if request.name and request.name not in self._saved:
                known = ", ".join(self._saved) or "none"
                raise Refusal("restore_state", "name", "be a saved one", request.name, known)
            self._session.restore(self._saved.get(request.name, bytes(request.state)))

        self._put(MachineEvent.KIND_RESTORE, restore, response)
        return response

    def _on_set_state(
        self, request: SetState.Request, response: SetState.Response
    ) -> SetState.Response:
        given = {
            "current": request.current,
            "theta_m": request.motor_position,
            "omega_m": request.motor_velocity,
            "q": request.position,
            "v": request.velocity,
        }
        change = partial(self._session.set_state, request.joint_names, given)
        self._put(MachineEvent.KIND_SET_STATE, change, response)
        return response

    def _on_set_varied(
        self, request: SetVaried.Request, response: SetVaried.Response
    ) -> SetVaried.Response:
        change = partial(self._session.set_varied, request.name, request.value)
        self._put(MachineEvent.KIND_SET_VARIED, change, response)
        return response

    def _put(
        self,
        kind: int,
        change: Callable[[], None],
        response: RestoreState.Response | SetState.Response | SetVaried.Response,
    ) -> None:
        """Change the machine, publish its new state, and continue from there."""
        with self._lock:
            behind = self._gate.without_room()
            if behind:
                response.message = f"recorder {behind} has to catch up first, ask again then"
                return
            try:
                self._changes.put(kind, change)
            except Refusal as reason:
                response.message = str(reason)
                return
            response.success, response.message = True, f"at tick {self._session.tick}"

    def _on_break_when(
        self, request: BreakWhen.Request, response: BreakWhen.Response
    ) -> BreakWhen.Response:
        with self._lock, self._changes.between_ticks():
            try:
                self._breaks.set(request)
            except Refusal as reason:
                response.message = str(reason)
                return response
            response.success, response.message = True, f"at tick {self._session.tick}"
            return response
