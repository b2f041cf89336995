"""Commands of the command line: their registration, options, output, recorder and page."""

from arm_emulator.cli.command import command
from arm_emulator.cli.commands.servo_header import make_servo_data_unit
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
from arm_emulator.cli.output import convert_to_plain, output
from arm_emulator.cli.run_report import count_ticks, end_at_ctrl_c, report_run
from arm_emulator.cli.served import serve_session
from arm_emulator.page.control_server import serve_controls
from arm_emulator.page.page_process import PageProcess, wait_for_ctrl_c
