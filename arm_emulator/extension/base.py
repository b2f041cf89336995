"""Refusals, declared numbers, files, formulas: what every package needs."""

from arm_emulator.base.address import host_and_port, not_free
from arm_emulator.base.array_equality import ArrayEquality
from arm_emulator.base.arrays import Array
from arm_emulator.base.column import Column
from arm_emulator.base.column import Rows as ColumnRows
from arm_emulator.base.config_files import check_own, config_folder, find_beside, find_scene
from arm_emulator.base.escape import c_string, html_text, markdown_text, one_line, xml_text
from arm_emulator.base.expression.formula import (
    Combined,
    Constant,
    Expression,
    Formula,
    Margin,
    Operation,
    Signal,
    Window,
    bound_to,
    fold,
    meant_by,
    parse_expression,
    parse_formula,
)
from arm_emulator.base.io.atomic_write import atomic_write, hidden_beside
from arm_emulator.base.io.table_file import read_table
from arm_emulator.base.io.text_file import open_file, read_bytes, read_text
from arm_emulator.base.io.yaml_file import MOST_BYTES as LARGEST_YAML_FILE
from arm_emulator.base.io.yaml_file import edited as edited_yaml
from arm_emulator.base.io.yaml_file import nodes_of as yaml_nodes
from arm_emulator.base.io.yaml_file import read_yaml
from arm_emulator.base.non_copyable import NonCopyable
from arm_emulator.base.refusal import Refusal
from arm_emulator.base.registry import Registry
from arm_emulator.base.required_package import require_package
from arm_emulator.base.run_outputs import NOTHING as KEEP_NOTHING
from arm_emulator.base.run_outputs import RunOutputs
from arm_emulator.base.synchronized import Synchronized, synchronized
from arm_emulator.base.urdf.shafts import Shafts, shaft_limits
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
from arm_emulator.base.validation.coerce import array_of, coerce_flag, coerce_kind
from arm_emulator.base.validation.count import check_count, whole_numbers
from arm_emulator.base.validation.number import LARGEST as LARGEST_NUMBER
from arm_emulator.base.validation.number import REQUIRED, Number, number, numbers_of
from arm_emulator.base.validation.section import Section
from arm_emulator.base.warning import given as given_warnings
from arm_emulator.base.warning import warn
from arm_emulator.version import VERSION

__all__ = [
    "ANY_COMMAND",
    "ANY_COMMANDS",
    "ANY_STATE",
    "EFFORT",
    "FORCE",
    "KEEP_NOTHING",
    "LARGEST_NUMBER",
    "LARGEST_YAML_FILE",
    "MOMENT",
    "POINT",
    "POSITION",
    "REQUIRED",
    "TOOL_POSITION",
    "VELOCITY",
    "VERSION",
    "Array",
    "ArrayEquality",
    "Column",
    "ColumnRows",
    "Combined",
    "Constant",
    "Expression",
    "Formula",
    "Margin",
    "NonCopyable",
    "Number",
    "Operation",
    "Refusal",
    "Registry",
    "RunOutputs",
    "Section",
    "Shafts",
    "Signal",
    "Synchronized",
    "Window",
    "array_of",
    "atomic_write",
    "bound_to",
    "c_string",
    "check_count",
    "check_own",
    "coerce_flag",
    "coerce_kind",
    "config_folder",
    "edited_yaml",
    "find_beside",
    "find_scene",
    "fold",
    "given_warnings",
    "hidden_beside",
    "host_and_port",
    "html_text",
    "markdown_text",
    "meant_by",
    "not_free",
    "number",
    "numbers_of",
    "one_line",
    "open_file",
    "parse_expression",
    "parse_formula",
    "read_bytes",
    "read_table",
    "read_text",
    "read_yaml",
    "require_package",
    "shaft_limits",
    "synchronized",
    "warn",
    "whole_numbers",
    "xml_text",
    "yaml_nodes",
]
