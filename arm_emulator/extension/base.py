"""Refusals, declared numbers, files, formulas: what every package needs."""

from arm_emulator.base.array_equality import ArrayEquality
from arm_emulator.base.arrays import Array
from arm_emulator.base.column import Column
from arm_emulator.base.column import Rows as ColumnRows
from arm_emulator.base.escape import (
    escape_c_string,
    escape_html,
    escape_markdown,
    escape_to_line,
    escape_xml,
)
from arm_emulator.base.expression.formula import (
    Combined,
    Constant,
    Expression,
    Formula,
    Margin,
    Operation,
    Signal,
    Window,
    bind_signals,
    expand_stars,
    fold_expression,
    parse_expression,
    parse_formula,
)
from arm_emulator.base.io.atomic_write import name_hidden_file, write_atomically
from arm_emulator.base.io.config_files import check_own, find_beside, find_config_folder, find_scene
from arm_emulator.base.io.table_file import read_table
from arm_emulator.base.io.text_file import open_file, read_bytes, read_text
from arm_emulator.base.io.yaml_file import MAX_BYTES as LARGEST_YAML_FILE
from arm_emulator.base.io.yaml_file import edit_yaml as edited_yaml
from arm_emulator.base.io.yaml_file import read_nodes as yaml_nodes
from arm_emulator.base.io.yaml_file import read_yaml
from arm_emulator.base.non_copyable import NonCopyable
from arm_emulator.base.refusal import Refusal
from arm_emulator.base.registry import Registry
from arm_emulator.base.required_package import require_package
from arm_emulator.base.run_outputs import NOTHING as KEEP_NOTHING
from arm_emulator.base.run_outputs import RunOutputs
from arm_emulator.base.synchronized import Synchronized, synchronized
from arm_emulator.base.urdf.shafts import Shafts, read_shaft_limits
from arm_emulator.base.validation.address import parse_address, refuse_taken_address
from arm_emulator.base.validation.bound import (
    ANY_COMMAND,
    ANY_COMMANDS,
    ANY_STATE,
    EFFORT,
    FORCE,
    MOMENT,
    POINT,
    POSITION,
    TOOL_POSITION,
    VELOCITY,
)
from arm_emulator.base.validation.coerce import coerce_array, coerce_flag, coerce_kind
from arm_emulator.base.validation.count import check_count, check_whole_numbers
from arm_emulator.base.validation.number import LARGEST as LARGEST_NUMBER
from arm_emulator.base.validation.number import REQUIRED, Number, list_numbers, number
from arm_emulator.base.validation.section import Section
from arm_emulator.base.warning import issued as given_warnings
from arm_emulator.base.warning import print_warnings
from arm_emulator.version import VERSION
