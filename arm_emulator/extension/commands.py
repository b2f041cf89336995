"""Commands of the command line: their registration, options, output, recorder and page."""

from arm_emulator.cli.command import command
from arm_emulator.cli.commands.servo_header import servo_data_unit
from arm_emulator.cli.new_bag import check_new_bag
from arm_emulator.cli.options import (
    Clock,
    Keep,
    PageAt,
    RunNumber,
    SceneName,
    Seconds,
    TargetFile,
    When,
)
from arm_emulator.cli.output import output, plain
from arm_emulator.cli.run_report import ctrl_c_ends_at_once, ticks_of
from arm_emulator.cli.run_report import report as report_run
from arm_emulator.cli.served import served_session
from arm_emulator.page.control_server import serve_controls
from arm_emulator.page.page_process import PageProcess, wait_for_ctrl_c
