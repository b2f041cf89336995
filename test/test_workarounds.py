"""Reasons of the workarounds: a test that fails shows that one can go, or needs another look."""

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
import pytest
from builtin_interfaces.msg import Time
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState
from rclpy.context import Context
from rclpy.lifecycle import LifecycleNode
from rosgraph_msgs.msg import Clock

import arm_emulator.workarounds
from arm_emulator.ros.process.ros_domain import own_domain

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


def test_each_workaround_names_versions_reason_and_an_existing_test() -> None:
    tests = "".join(file.read_text() for file in Path(__file__).parent.glob("test_*.py"))
    for file in sorted(FOLDER.iterdir()):
        if not file.is_file() or file.name == "__init__.py":
            continue
        head = file.read_text()[:1200]
        assert "Versions: " in head and "test/test_" in head, file.name
        for name in head.split("`"):
            if name.startswith("test_"):
                assert f"def {name}(" in tests, f"{file.name}: {name}"
