"""Libraries compiled from C and C++, and the folders of the documented headers."""

from arm_emulator.core import BOUNDARY as BOUNDARY_FOLDER
from arm_emulator.core import CORE as CORE_FOLDER
from arm_emulator.servo.c import FOLDER as SERVO_FOLDER
from arm_emulator.tick.c import FOLDERS as TICK_FOLDERS
from arm_emulator.toolchain.c_header import NULL as C_NULL
from arm_emulator.toolchain.c_header import CData, Header, Library
from arm_emulator.toolchain.c_header import make_pointer as c_pointer
from arm_emulator.toolchain.c_header import read_text as c_text
from arm_emulator.toolchain.compile_unit import (
    UnitCompiler,
    compile_bytes,
    compile_file,
    compile_once,
    compile_units,
    load_file,
)
from arm_emulator.toolchain.compile_unit import load_library as compiled_library
from arm_emulator.toolchain.compiler_command import read_command
from arm_emulator.toolchain.cxx import run_compiler
from arm_emulator.toolchain.flags import ARITHMETIC, C_FLAGS
from arm_emulator.toolchain.flags import SHARED as SHARED_FLAGS
from arm_emulator.toolchain.unit import (
    Unit,
    compute_fingerprint,
    list_definitions,
    name_stem,
)
