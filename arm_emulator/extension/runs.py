"""Machine, servo and motion controller in one process, targets, gains, recorders."""

from arm_emulator.demo.demo_plan import NANOSECONDS, DemoPlan
from arm_emulator.motion.executor.goal_status import GoalState as MotionState
from arm_emulator.motion.model.config import MotionConfig, load_motion_config
from arm_emulator.motion.model.pose import Pose
from arm_emulator.runs.breakpoint import Breakpoint
from arm_emulator.runs.gains import Gains, check_fit, check_servo, load_gains
from arm_emulator.runs.goal import find_last_target, find_missed_target
from arm_emulator.runs.offline import OfflineRun
from arm_emulator.runs.recorder import Recorder
from arm_emulator.runs.servo_step import ServoStep
from arm_emulator.runs.table_run import TableRun, compute_tool_error
from arm_emulator.runs.target_table import (
    TargetTable,
    check_targets,
    keep_limits,
    load_target_table,
)
from arm_emulator.servo.servo_arm import ServoArm as ServoDrives
from arm_emulator.servo.servo_config import (
    ServoConfig,
    check_joints,
    check_rates,
    load_servo_config,
)
from arm_emulator.servo.servo_law import Rows as ServoRows
from arm_emulator.servo.servo_numbers import make_servo_numbers
from arm_emulator.servo.watchdog import count_nanoseconds
