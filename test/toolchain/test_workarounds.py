"""Reasons of the workarounds: a test that fails shows that one can go, or needs another look."""

import ctypes
import inspect
import re
import signal
import site
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import cffi
import numpy as np
import pytest
from builtin_interfaces.msg import Time
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState
from rclpy.context import Context
from rclpy.lifecycle import LifecycleNode
from rosgraph_msgs.msg import Clock

import arm_emulator.workarounds
from arm_emulator.ros.process.ros_domain import own_domain
from arm_emulator.toolchain.compile_unit import compile_bytes
from arm_emulator.toolchain.compiler_command import find_compiler
from arm_emulator.toolchain.flags import C_FLAGS
from arm_emulator.toolchain.unit import Unit
from arm_emulator.workarounds import gcc_constant_copies

FOLDER = Path(arm_emulator.workarounds.__file__).parent


@pytest.fixture
def node() -> Iterator[Any]:
    context = Context()
    with own_domain():
        context.init()
        try:
            node: Any = LifecycleNode("one", context=context)
            yield node
            node.destroy_node()
        finally:
            context.try_shutdown()


def test_rclpy_fails_at_bad_transitions_and_times(node: Any) -> None:
    """Our nodes put callbacks of their own in the places of these two."""
    activate = Transition(id=Transition.TRANSITION_ACTIVATE)  # of an unconfigured node
    request = ChangeState.Request(transition=activate)
    with pytest.raises(Exception, match=r"(?i)transition"):
        node._service_change_state.callback(request, ChangeState.Response())
    with pytest.raises(Exception, match=r"(?i)nanoseconds|time|negative"):
        node._time_source.clock_callback(Clock(clock=Time(sec=-1)))


def test_fast_dds_is_that_of_the_workarounds(node: Any) -> None:
    """A newer one may clear what is left, end without a deadlock, or lay out ports otherwise."""
    loaded = set(re.findall(r"libfastrtps[^/\s]*", Path("/proc/self/maps").read_text()))
    if not loaded:
        pytest.skip("another middleware")
    assert all("2.14" in name for name in loaded), loaded


def test_cffi_offers_declarations_as_a_module_alone() -> None:
    """A public method that returns them would take the place of `split_received`."""
    public = {name for name in dir(cffi.FFI) if name.startswith(("emit", "dump", "save", "to_"))}
    assert public == {"emit_c_code", "emit_python_code"}
    assert "filename" in inspect.signature(cffi.FFI.emit_python_code).parameters


def test_viser_has_no_hook_for_requests() -> None:
    viser = pytest.importorskip("viser")
    parameters = set(inspect.signature(viser.ViserServer).parameters)
    assert parameters == {"host", "port", "label", "verbose", "_deprecated_kwargs"}


def test_python_takes_ctrl_c_before_it_runs_a_program() -> None:
    code = "import signal; print(signal.getsignal(signal.SIGINT) is signal.default_int_handler)"
    command = [sys.executable, "-I", "-S", "-c", code]
    # Where it was ignored, as in a job that a script has started with `&`, Python leaves it so.
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        printed = subprocess.run(command, check=True, capture_output=True, text=True).stdout
    finally:
        signal.signal(signal.SIGINT, before)
    assert printed == "True\n"
    ours = (FOLDER / "quiet_start.pth").read_text().splitlines()[-1]
    for folder in map(Path, site.getsitepackages()):
        if (there := folder / "a0_arm_emulator.pth").is_file():
            assert there.read_text().splitlines()[-1] == ours


COPIES = """
static const double given[11] = {0.1, 0.1, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0};
void copy(double *to) { __builtin_memcpy(to, given, sizeof given); }
"""


def compile_copies(folder: Path, *flags: str) -> list[float]:
    """Return the numbers that a copy of the constants has."""
    source, library = folder / "copies.c", folder / f"copies{len(flags)}.so"
    source.write_text(COPIES)
    words = [*find_compiler(), "-x", "c", "-O2", "-march=native", "-shared", "-fPIC", *flags]
    subprocess.run([*words, str(source), "-o", str(library)], check=True)
    numbers = (ctypes.c_double * 11)()
    ctypes.CDLL(str(library)).copy(numbers)
    return list(numbers)


def test_gcc_copies_constants_wrongly_for_wide_stores(tmp_path: Path) -> None:
    given = [0.1] * 2 + [0.0] * 9
    words = [*find_compiler(), "-march=native", "-dM", "-E", "-x", "c", "/dev/null"]
    macros = subprocess.run(words, capture_output=True, text=True, check=True).stdout
    flags = gcc_constant_copies.list_flags(macros)
    assert compile_copies(tmp_path, *flags) == given
    if flags:
        assert compile_copies(tmp_path) != given, "this version needs no flag"


@pytest.mark.parametrize(
    ("version", "wants"),
    [
        ({"GNUC": 12, "GNUC_MINOR": 2, "AVX512F": 1}, True),
        ({"GNUC": 12, "GNUC_MINOR": 1, "AVX512F": 1}, True),
        ({"GNUC": 12, "GNUC_MINOR": 3, "AVX512F": 1}, False),
        ({"GNUC": 11, "GNUC_MINOR": 2, "AVX512F": 1}, False),
        ({"GNUC": 12, "GNUC_MINOR": 2, "AVX2": 1}, False),
        ({"GNUC": 12, "GNUC_MINOR": 2, "AVX512F": 1, "clang": 1}, False),
        ({}, False),
    ],
)
def test_the_flag_against_wide_stores_is_that_of_some_versions(
    version: dict[str, int], wants: bool
) -> None:
    macros = "".join(f"#define __{name}__ {value}\n" for name, value in version.items())
    assert gcc_constant_copies.list_flags(macros) == [gcc_constant_copies.FLAG] * wants


@pytest.mark.parametrize("size", range(4, 18))
def test_a_library_has_the_constants_of_its_source(size: int, tmp_path: Path) -> None:
    """Compiled scenes hold their numbers in constant arrays."""
    rng = np.random.default_rng(size)
    rows = rng.choice([0.0, 0.0, 0.1, 0.1, 2.5], (12, size))
    text = "#include <string.h>\n"
    for place, row in enumerate(rows):
        text += f"static const double row{place}[] = {{{', '.join(map(repr, row.tolist()))}}};\n"
    text += "void copy_rows(double *to) {\n"
    for place in range(len(rows)):
        text += f"  memcpy(to + {place * size}, row{place}, sizeof row{place});\n"
    found = np.full(rows.shape, np.nan)
    flags, more = C_FLAGS, ("copy_rows",)
    unit = Unit("copies", text + "}\n", flags, (), (), "test", "copies", "copies", more=more)
    (tmp_path / "copies.so").write_bytes(compile_bytes(unit, "native"))
    ctypes.CDLL(str(tmp_path / "copies.so")).copy_rows(found.ctypes.data_as(ctypes.c_void_p))
    np.testing.assert_array_equal(found, rows)


def test_each_workaround_names_versions_reason_and_an_existing_test() -> None:
    tests = "".join(file.read_text() for file in Path(__file__).parents[1].glob("*/test_*.py"))
    for file in sorted(FOLDER.iterdir()):
        if not file.is_file() or file.name == "__init__.py":
            continue
        head = file.read_text()[:1200]
        assert "Versions: " in head and "test/" in head, file.name
        for name in head.split("`"):
            if name.startswith("test_"):
                assert f"def {name}(" in tests, f"{file.name}: {name}"
