"""Null pointers into the functions of our C headers: refused, or nothing happens."""

import re
import subprocess
import sys
from pathlib import Path

import null_pointers
from arm_emulator.core import BOUNDARY
from arm_emulator.machine.plant.compiler import load_machine
from arm_emulator.machine.plant.core_calls import ARM
from arm_emulator.machine.scene.scene import load_scene

# Of these some pointers may be null, as their headers state.
MAY = {
    "arm_join_schedule": "machine",  # 0: not permitted
    "arm_set_truth": "",
}


def test_every_function_takes_null_pointers() -> None:
    program = str(Path(null_pointers.__file__))
    done = subprocess.run([sys.executable, program], capture_output=True, text=True, check=False)
    lines = done.stdout.splitlines()
    assert done.returncode == 0, f"crash in {lines[-1] if lines else done.stderr}"
    called = {line.split()[0] for line in lines}
    named = set(re.findall(r"\b(arm_\w+)\(", (BOUNDARY / "arm.h").read_text()))
    assert set(ARM.functions) == named <= called, "every function of arm.h"
    core = load_machine(load_scene("three_axis"))
    results = {name: ARM.ffi.typeof(getattr(core, name)).result.cname for name in ARM.functions}
    for line in lines:
        name, *nulls, result = line.replace(",", "").split()
        if results.get(name) == "int" and nulls != ["-"] and name not in MAY:
            assert result == "1", f"ARM_REFUSED of {line}"
