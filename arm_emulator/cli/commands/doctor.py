"""Check this machine for the emulator's needs, and for remains of earlier runs."""

from __future__ import annotations

import importlib.util
import json
import os
import platform
import shutil
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from arm_emulator.base.refusal import Refusal
from arm_emulator.base.required_package import name_package
from arm_emulator.cli.command import command
from arm_emulator.cli.output import output
from arm_emulator.ros.process.ros_domain import LARGEST
from arm_emulator.toolchain.compiler_command import find_compiler
from arm_emulator.toolchain.library_cache import list_writable_caches, read_largest_size
from arm_emulator.version import VERSION
from arm_emulator.workarounds.fastdds_shared_memory import find_left_over

if TYPE_CHECKING:  # this machine may have no ROS 2
    from rclpy.node import Node

MIN_DISK = 1.0  # GB: libraries, a recording
DISCOVERY = 1.0  # s, wall: for the middleware to find the nodes of the domain
MAX_FAULTS = 3  # of a network, that are named
FAST_DDS = ("default middleware", "rmw_fastrtps_cpp", "rmw_fastrtps_dynamic_cpp")
NODES = ("emulator_node.node", "servo_node.node", "motion_controller_node.node")
# Modules without which nothing works: nodes and `run`.
NEEDED = (
    "cffi", "coal", "cyclopts", "daqp", "numpy", "pinocchio", "rich", "ruckig", "scipy", "yaml",
)  # fmt: skip
# Modules that some commands need.
EXTRAS = {
    "SALib": "sensitivities of campaigns",
    "can": "`canopen`",
    "cma": "`campaign` with the search cma-es",
    "distributed": "`campaign --dask`",
    "elftools": "`firmware`",
    "lz4": "bags that are compressed so",
    "matplotlib": "pictures of `bode`, `tune`, `identify`, `campaign`",
    "mcap": "`--record` and bags",
    "optuna": "`campaign` with the search bayes",
    "pyarrow": "campaigns, and records as .parquet",
    "rerun": "`--rerun`, `demo`",
    "rosbags": "bags",
    "trimesh": "the page of `look`, `--page`",
    "unicorn": "`firmware`",
    "viser": "the page of `look`, `--page`",
    "websockets": "the page of `look`, `--page`",
    "xacro": "`new` from .xacro",
    "zstandard": "bags that are compressed so",
}


class SystemFinding(NamedTuple):
    """A line of the report.

    Attributes:
        name: item checked.
        level: ok, note (only some commands need it) or problem.
        text: finding.
        remedy: remedy, empty if none is needed.
    """

    name: str
    level: str
    text: str
    remedy: str = ""


@command(keys="`findings`")
def check_machine() -> int:
    """Check compiler, packages, ROS, processes, shared memory and disk: a line each, with a remedy.

    The exit code is 1 if there is a problem. A missing package of some commands is a note.
    """
    listed = []
    for finding in run_checks():  # printed one by one: the imports take seconds
        listed.append(finding)
        remedy = f"; {finding.remedy}" if finding.remedy else ""
        output.print_line(f"{finding.level:<8} {finding.name:<15} {finding.text}{remedy}")
    output.add_facts({"findings": [finding._asdict() for finding in listed]})
    return int(any(finding.level == "problem" for finding in listed))


def run_checks() -> Iterator[SystemFinding]:
    """Yield the findings, from compiler to packages."""
    of_python = f"Python {platform.python_version()}, {platform.system()} {platform.machine()}"
    yield SystemFinding("version", "ok", f"arm_emulator {VERSION}, {of_python}")
    for look in (
        _check_compiler,
        _check_cache,
        _check_disk,
        _check_ros,
        _check_domain,
        _check_processes,
        _check_shared_memory,
        _check_priority,
    ):
        yield look()
    yield from check_imports()
    if importlib.util.find_spec("rclpy") is not None:
        yield _check_network()


def check_imports() -> Iterator[SystemFinding]:
    """Yield what can be imported; a process of its own tries, as a broken package may end it."""
    modules = (*NEEDED, *EXTRAS)
    there = [module for module in modules if importlib.util.find_spec(module) is not None]
    command = [sys.executable, "-P", "-m", "arm_emulator.base.import_trial", *there]
    env = os.environ | {"PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
    done = subprocess.run(command, capture_output=True, text=True, check=False, env=env)
    broken: dict[str, str] = {}
    if done.returncode:
        text = f"their imports end with exit code {done.returncode}"
        yield SystemFinding("packages", "problem", text, "import them one by one")
    else:
        broken = json.loads(done.stdout)
    for module in modules:
        package, needed_by = name_package(module), EXTRAS.get(module, "nodes and `run`")
        if module in broken:
            text = f"module {module}, needed by {needed_by}, cannot be imported: {broken[module]}"
        elif module not in there:
            text = f"module {module} is not installed, needed by {needed_by}"
        else:
            yield SystemFinding(module, "ok", f"{package} can be imported")
            continue
        level = "problem" if module in NEEDED else "note"
        yield SystemFinding(module, level, text, f"pip install {package}")


def _try_check(name: str, look: Callable[[], str]) -> SystemFinding:
    try:
        return SystemFinding(name, "ok", look())
    except Refusal as reason:
        return SystemFinding(name, "problem", str(reason))


def _check_compiler() -> SystemFinding:
    def check_version() -> str:
        words = find_compiler()
        program = "#include <concepts>\n#include <numbers>\n"
        command = [*words, "-std=c++20", "-fsyntax-only", "-x", "c++", "-"]
        done = subprocess.run(command, input=program, capture_output=True, text=True, check=False)
        if done.returncode:
            actual = (done.stderr.strip().splitlines() or ["no reason given"])[0]
            valid = "g++ from 11 or clang from 14 on (Debian, Ubuntu: apt install g++)"
            raise Refusal(" ".join(words), "C++20", "compile", actual, valid)
        version = subprocess.run(
            [*words, "--version"], capture_output=True, text=True, check=False
        ).stdout.splitlines()
        return f"{' '.join(words)}: {version[0] if version else 'compiles C++20'}"

    return _try_check("compiler", check_version)


def _check_cache() -> SystemFinding:
    return _try_check(
        "cache", lambda: f"{next(list_writable_caches())}, at most {read_largest_size() / 1e6:g} MB"
    )


def _check_disk() -> SystemFinding:
    places = {Path.cwd(), Path(os.environ.get("TMPDIR", "/tmp"))}
    free = {place: shutil.disk_usage(place).free / 1e9 for place in sorted(places)}
    text = ", ".join(f"{size:.1f} GB free in {place}" for place, size in free.items())
    if min(free.values()) < MIN_DISK:
        return SystemFinding("disk", "problem", text, f"make room for {MIN_DISK:g} GB")
    return SystemFinding("disk", "ok", text)


def _check_ros() -> SystemFinding:
    missing = [
        name for name in ("rclpy", "arm_emulator_msgs") if importlib.util.find_spec(name) is None
    ]
    if missing:
        text = f"no Python module {' and '.join(missing)}, needed by nodes and bags"
        remedy = "`make setup` in a checkout, or source a workspace: `. install/setup.bash`"
        return SystemFinding("ROS 2", "note", text, remedy)
    middleware = os.environ.get("RMW_IMPLEMENTATION", "default middleware")
    text = f"{os.environ.get('ROS_DISTRO', 'from wheels')}, {middleware}"
    if middleware not in FAST_DDS:
        remedy = "unset RMW_IMPLEMENTATION if nodes do not start, or if lock-step is slow"
        return SystemFinding("ROS 2", "note", f"{text}, with which nothing was tried", remedy)
    return SystemFinding("ROS 2", "ok", text)


def _check_domain() -> SystemFinding:
    named = os.environ.get("ROS_DOMAIN_ID", "0")
    reach = os.environ.get("ROS_AUTOMATIC_DISCOVERY_RANGE", "SUBNET")
    if not (named.isdecimal() and int(named) <= LARGEST):
        remedy = f"export ROS_DOMAIN_ID=0 to {LARGEST}"
        return SystemFinding("ROS domain", "problem", f"ROS_DOMAIN_ID is {named!r}", remedy)
    if reach == "SUBNET":
        text = f"{named}, open to the whole subnet: who has the same domain there joins in"
        remedy = "export ROS_AUTOMATIC_DISCOVERY_RANGE=LOCALHOST to stay on this machine"
        return SystemFinding("ROS domain", "note", text, remedy)
    return SystemFinding("ROS domain", "ok", f"{named}, {reach}")


def _check_network() -> SystemFinding:
    """Look at the nodes of the domain, of any program."""
    try:
        from arm_emulator.ros.node.network_client import join_network

        with join_network("doctor", "") as node:
            count, more = 0, True
            while more:  # on a busy machine the nodes are found one after the other
                node.spin_until(lambda: False, DISCOVERY)
                neighbours = len(set(node.get_node_names_and_namespaces())) - 1
                count, more = neighbours, neighbours > count
            faults = sorted(
                set(list_network_faults(node)), key=lambda fault: (not fault.grave, fault.text)
            )
    except Exception as error:  # a middleware that is not there, a domain that is not valid
        reason = (str(error).splitlines() or [type(error).__name__])[0]
        return SystemFinding(
            "network", "problem", f"cannot be joined: {reason}", "see the lines above"
        )
    nodes = f"{count} other node{'' if count == 1 else 's'} in the domain"
    if not faults:
        return SystemFinding("network", "ok", nodes)
    texts = [fault.text for fault in faults[:MAX_FAULTS]]
    if len(faults) > len(texts):
        texts.append(f"{len(faults) - len(texts)} more")
    level = "problem" if faults[0].grave else "note"
    return SystemFinding("network", level, f"{nodes}; {'; '.join(texts)}", faults[0].remedy)


def _check_processes() -> SystemFinding:
    """Look for nodes of this user whose launcher is gone."""
    alive, orphans = 0, list[int]()
    for entry in Path("/proc").iterdir():
        if not entry.name.isdecimal():
            continue
        try:
            words = (entry / "cmdline").read_bytes().split(b"\0")
            parent = int((entry / "stat").read_text().rpartition(")")[2].split()[1])
            mine = entry.stat().st_uid == os.geteuid()
        except (OSError, ValueError, IndexError):  # it has just ended
            continue
        if mine and any(node.encode() in words for node in NODES):
            alive += 1
            orphans += [int(entry.name)] if parent == 1 else []
    if orphans:
        numbers = " ".join(map(str, sorted(orphans)))
        text = f"nodes run whose launcher has ended: {numbers}"
        return SystemFinding("processes", "problem", text, f"kill {numbers}")
    return SystemFinding("processes", "ok", f"{alive} nodes run, none left behind")


def _check_shared_memory() -> SystemFinding:
    count = sum(1 for _ in find_left_over())
    if count:
        text = f"{count} remains of killed processes in /dev/shm"
        return SystemFinding("shared memory", "note", text, "the next network removes them")
    return SystemFinding("shared memory", "ok", "nothing left behind")


def _check_priority() -> SystemFinding:
    before = os.sched_getscheduler(0)
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(1))
        os.sched_setscheduler(0, before, os.sched_param(0))
    except OSError as error:
        text = f"no real-time priority ({error.strerror}): `--clock realtime` may be late"
        return SystemFinding("priority", "note", text, "`ulimit -r` must be > 0")
    return SystemFinding("priority", "ok", "real-time priority may be had; `latency` measures it")


CLOCK = "rosgraph_msgs/msg/Clock"


class NetworkFault(NamedTuple):
    """A fault, in words.

    Attributes:
        grave: whether no node may go on so.
        text: the fault.
        remedy: remedy.
    """

    grave: bool
    text: str
    remedy: str


def list_network_faults(node: Node) -> Iterator[NetworkFault]:
    """Yield the faults among all that a node has discovered."""
    from rclpy.qos import QoSCompatibility, qos_check_compatible

    for topic, kinds in node.get_topic_names_and_types():
        offers = node.get_publishers_info_by_topic(topic)
        if CLOCK in kinds and len(offers) > 1:
            names = ", ".join(sorted(map(_name_endpoint, offers)))
            remedy = "end all but one, or give each network a ROS_DOMAIN_ID or namespace"
            yield NetworkFault(True, f"{topic} has {len(offers)} publishers: {names}", remedy)
        for request in node.get_subscriptions_info_by_topic(topic):
            for offer in offers:
                level, reason = qos_check_compatible(offer.qos_profile, request.qos_profile)
                if level == QoSCompatibility.ERROR:
                    why = str(reason).removeprefix("ERROR: ").strip(" ;")
                    here, there = _name_endpoint(request), _name_endpoint(offer)
                    text = f"{topic}: {here} hears nothing of {there}: {why}"
                    yield NetworkFault(False, text, "change the QoS of one of them")


def _name_endpoint(endpoint: Any) -> str:
    return f"{endpoint.node_namespace.rstrip('/')}/{endpoint.node_name}"
