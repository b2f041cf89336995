"""A page in the browser: rows of a run, its timeline, controls of the machine."""

from arm_emulator.analysis.torque_terms import TermsNow, TorqueTerms
from arm_emulator.machine.session.record_ring import SharedRing
from arm_emulator.motion.model.mesh_units import list_package_folders, scale_to_metres
from arm_emulator.page.controls import Controls, Vector
from arm_emulator.page.page_address import PageAddress, get_token
from arm_emulator.runs.condition import Condition
from arm_emulator.runs.order import (
    NO_VECTOR,
    MoveTool,
    Order,
    Push,
    ScaleGains,
    SetVaried,
    SwitchPower,
)
from arm_emulator.runs.row_end import RowEnd
from arm_emulator.runs.timeline import Timeline
from arm_emulator.workarounds.websocket_requests import answer_requests
