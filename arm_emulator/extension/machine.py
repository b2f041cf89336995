"""Scenes and machines: parts, inputs, outputs, plant, session, small-motion analysis."""

from arm_emulator.analysis.linear_servo import Loop as ServoLoop
from arm_emulator.analysis.mode_loops import Mode as LoopMode
from arm_emulator.analysis.mode_loops import describe_withheld_modes, list_withheld_modes
from arm_emulator.analysis.residual_vibration import QUANTITIES as VIBRATION_QUANTITIES
from arm_emulator.analysis.residual_vibration import find_reference_end, measure_vibration
from arm_emulator.analysis.servo_loop import draw_poses
from arm_emulator.analysis.stability import SmallMotions, explain_divergence
from arm_emulator.analysis.vibration_modes import find_vibration_modes
from arm_emulator.base.calibration.deviation import Deviation
from arm_emulator.base.calibration.joint_path import JointPath
from arm_emulator.base.calibration.joint_path import find_path as find_joint_path
from arm_emulator.base.urdf.frames import Frame
from arm_emulator.base.urdf.joint_tree import MOVING_KINDS, UrdfJoint, list_element_names
from arm_emulator.base.urdf.joint_tree import find_root as find_root_link
from arm_emulator.base.urdf.joint_tree import read_joints as read_urdf_joints
from arm_emulator.base.urdf.urdf_text import parse_urdf
from arm_emulator.design.assumed_bodies import make_inertial
from arm_emulator.machine.chain import Body, ChainJoint
from arm_emulator.machine.cxx_literals import format_number as cxx_number
from arm_emulator.machine.faults.scene_faults import SceneFault
from arm_emulator.machine.parts.input import VOLTAGE as VOLTAGE_INPUT
from arm_emulator.machine.parts.input import Input
from arm_emulator.machine.parts.output import AXES as OUTPUT_AXES
from arm_emulator.machine.parts.output import COMMAND as COMMAND_OUTPUT
from arm_emulator.machine.parts.output import FURTHER as FURTHER_OUTPUT
from arm_emulator.machine.parts.output import Output
from arm_emulator.machine.parts.part import Part
from arm_emulator.machine.parts.shaft_motion import ShaftMotion
from arm_emulator.machine.plant.build_facts import list_differing_builds
from arm_emulator.machine.plant.call_arguments import (
    LARGEST_STEPS,
    Commands,
    build_refusal,
    make_commands,
    make_options,
    make_truth,
    order_by_joint,
)
from arm_emulator.machine.plant.call_arguments import PIECE as STEPS_BETWEEN_CHECKS
from arm_emulator.machine.plant.compiler import build_machine_unit, compile_ahead, load_machine_with
from arm_emulator.machine.plant.core_calls import ARM as ARM_HEADER
from arm_emulator.machine.plant.core_calls import OK as ARM_OK
from arm_emulator.machine.plant.core_calls import PLACES as STATE_NAMES_IN_C
from arm_emulator.machine.plant.core_calls import REFUSED as ARM_REFUSED
from arm_emulator.machine.plant.core_machine import BorrowedMachine
from arm_emulator.machine.plant.diverged import Diverged
from arm_emulator.machine.plant.external_wrench import AXES as WRENCH_AXES
from arm_emulator.machine.plant.external_wrench import NONE as NO_WRENCH
from arm_emulator.machine.plant.external_wrench import ExternalWrench, move_to_moving_link
from arm_emulator.machine.plant.formula_rows import FORMULA as FORMULA_HEADER
from arm_emulator.machine.plant.formula_rows import FormulaRows, is_at_one_instant
from arm_emulator.machine.plant.inputs import (
    arrange_further_rows,
    check_inputs,
    find_input,
    list_further_inputs,
    list_input_units,
    list_modes,
)
from arm_emulator.machine.plant.measured import Measured, MeasuredPlace, list_rows
from arm_emulator.machine.plant.measured_fields import MeasuredFields
from arm_emulator.machine.plant.outputs import ALWAYS as ALWAYS_OUTPUTS
from arm_emulator.machine.plant.outputs import KNOWN as KNOWN_OUTPUTS
from arm_emulator.machine.plant.outputs import list_outputs, list_readings, list_units
from arm_emulator.machine.plant.plant import Plant
from arm_emulator.machine.plant.plant_state import ROWS as STATE_ROWS
from arm_emulator.machine.plant.plant_state import SET as DECIDING_STATE
from arm_emulator.machine.plant.plant_state import (
    bound_start,
    compute_count_angle,
    compute_largest_position,
)
from arm_emulator.machine.plant.scene_unit import write_scene_unit
from arm_emulator.machine.scene.fault_catalogue import list_variable_numbers
from arm_emulator.machine.scene.integrator import EVENTS as INTEGRATOR_EVENTS
from arm_emulator.machine.scene.integrator import Integrator, format_mismatch
from arm_emulator.machine.scene.joint import Joint
from arm_emulator.machine.scene.known_parts import PARTS
from arm_emulator.machine.scene.overrides import override_keys
from arm_emulator.machine.scene.scene import LARGEST_SEED, Scene, coerce_scene, load_scene
from arm_emulator.machine.schemes.known import KNOWN as KNOWN_SCHEMES
from arm_emulator.machine.schemes.known import SCHEMES
from arm_emulator.machine.session.change import Change, NumberChange, PowerChange, WrenchChange
from arm_emulator.machine.session.command_buffer import DuplicateCommand
from arm_emulator.machine.session.control_code import ControlCode
from arm_emulator.machine.session.record_row import RecordRow, list_columns, select_values
from arm_emulator.machine.session.session import Session
from arm_emulator.machine.session.tool_chain import TOOL as TOOL_SIGNALS_NAME
from arm_emulator.machine.session.tool_chain import ToolChain, list_tool_signals
from arm_emulator.machine.varied import NAMES as VARIED_NAMES
from arm_emulator.machine.varied import Varied, find_varied
from arm_emulator.machine.varied import vary_child as varied_of_child
