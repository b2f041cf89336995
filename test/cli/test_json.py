"""`--json`: one object on stdout, whatever command, however it ends."""

import json
import re
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from draws import some, with_slow
from made_bags import synthetic
from test_command_line import no_signal, run  # noqa: F401

from arm_emulator.cli.command import command_names, load_command
from arm_emulator.ros.process.ros_domain import own_domain

PATIENCE = 120.0  # s
ARM = "three_axis"
# Words with which a command ends by itself; `{}` is a new folder, see `folder`. Those of a command
# that is not listed are a scene that does not exist.
ENDS: dict[str, list[list[str]]] = {name: [["nowhere"]] for name in command_names()} | {
    "advise": [[ARM, "--motion", "{}/motion.csv", "--error", "1e-5"],
               [ARM, "--motion", "{}/motion.csv", "--error", "1e-13"]],
    "cache": [[]],
    "campaign": [["{}/campaign.yaml", "--dry"], ["{}/campaign.yaml", "--replay", "1"],
                 ["{}/campaign.yaml", "--into", "{}/results", "--workers", "1"]],
    "canopen": [[ARM, "--eds", "{}/eds"]],
    "check-bag": [["{}/bag", "--scene", ARM], ["{}/bag"]],
    "check-scene": [[ARM], [ARM, "--modes"], ["nowhere"]],
    "compile": [[ARM]],
    "completion": [["bash"], ["csh"]],
    "doctor": [[]],
    "ethercat": [[ARM, "--esi", "{}/arm.xml"], [ARM]],
    "explain": [["{}/bag", "--scene", ARM, "--at", "0"], ["{}/bag", "--at", "1e9"],
                ["{}/bag", "{}/bag", "--scene", ARM], ["{}/bag", "{}/none"]],
    "faults": [[ARM]],
    "firmware": [["{}/none.yaml", "{}/none.elf"]],
    "fmu": [[ARM, "--out", "{}/arm.fmu", "--target", "native"], [ARM, "--out", "{}/arm.zip"]],
    "identify": [[ARM, "{}/none.csv"]],
    "foxglove": [[ARM, "{}/layout.json"], [ARM, "{}/no/layout.json"]],
    "fork": [["{}/bag", "{}/new", "--at", "0", "--scene", ARM], ["{}/no", "{}/new", "--at", "0"]],
    "latency": [[ARM, "--rates", "50", "--seconds", "0.3", "--alone"], ["nowhere"]],
    "look": [["{}/none"], ["{}/bag", "--scene", ARM, "--port", "70000"], ["{}/bag", "{}/none"]],
    "modbus": [[ARM, "--registers"], [ARM, "--station", "0"]],
    "move": [["--joints", "waist"]],
    "moveit-config": [[ARM, "--into", "{}/moveit"], ["nowhere"]],
    "new": [["{}/arm.urdf", "--out", "{}/new", "--ros2-control"], ["{}/none.urdf"]],
    "record": [["{}/bag"]],
    "repair": [["{}/bag"], ["{}/none"]],
    "replay": [["{}/bag", "--rate", "1000"], ["{}/bag", "--rate", "0"]],
    "ros2-control": [[ARM, "--into", "{}/ros2_control"], ["nowhere"]],
    "run": [[ARM, "--seconds", "0.1"], [ARM, "--seconds", "-1"]],
    "servo-header": [[ARM], [ARM, "--out", "{}/joints.h"]],
    "status": [["--timeout", "0.1"]],
    "tune": [[ARM], ["nowhere"]],
}  # fmt: skip
COMPILING = ("campaign", "fmu", "new")
# Long ones; what their objects hold is tested with the commands.
SLOW = {
    "advise": ENDS["advise"][:1], "doctor": [[]], "ethercat": ENDS["ethercat"][:1], "tune": [[ARM]],
}  # fmt: skip
NO_SERVERS = {"ethercat": "needs root", "look": "needs a bag", "replay": "ends by itself"}
UNTIL_STOPPED = {
    name: []
    for name in command_names()
    if (one := load_command(name)) and one.until_stopped and name not in NO_SERVERS
} | {"canopen": ["--listen", "0"], "record": ["{}/new_bag"], "up": [ARM]}
CAMPAIGN = """\
scene: three_axis
scenario: {seconds: 0.1, targets: [{at: 0.0, waist: 0.3}]}
vary: {payload.mass: uniform(0, 1)}
set: {payload: 1.0}
requirements: {gear: always abs(gear_torque.*) <= 200}
measures: {torque: max(abs(gear_torque.*))}
count: 4
"""
URDF = """<robot name="arm"><link name="base"/><link name="tip"><inertial><mass value="1"/>
<origin xyz="0.3 0 0"/><inertia ixx="0.01" iyy="0.01" izz="0.01" ixy="0" ixz="0" iyz="0"/>
</inertial></link><joint name="one" type="revolute"><parent link="base"/><child link="tip"/>
<axis xyz="0 1 0"/><limit lower="-1" upper="1" velocity="2" effort="20"/></joint></robot>"""

# Commands that find the state of the machine, which may differ the next time: whether an object has
# something bad, and how the lines begin or name it.
OF_THE_MACHINE: dict[str, tuple[Callable[[Any], bool], str]] = {
    "latency": (lambda facts: not all(rate["held"] for rate in facts["rates"].values()),
                "not held"),
    "doctor": (lambda facts: any(fact["level"] == "problem" for fact in facts["findings"]),
               "(?m)^problem"),
}  # fmt: skip


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    table = "t,waist,shoulder,elbow\n0,1,2,3\n0.03,-4,5,-6\n0.05,0,0,0\n"
    (tmp_path / "motion.csv").write_text(table)
    (tmp_path / "campaign.yaml").write_text(CAMPAIGN)
    (tmp_path / "arm.urdf").write_text(URDF)
    synthetic(tmp_path / "bag", [True] * 8)
    return tmp_path


def check(name: str, words: list[str], code: int, text: str, errors: str) -> None:
    facts = json.loads(text)
    assert (code == 2) == ("refused" in facts), (name, words, errors)
    assert isinstance(facts.pop("warnings"), list)
    if "refused" in facts:
        assert facts["refused"] in errors.splitlines()
        return
    declared = load_command(name)
    assert declared is not None
    documented = set(re.findall(r"`([\w-]+)`", declared.keys))
    assert facts and set(facts) <= documented, (name, words)
    if not set(";(") & set(declared.keys):  # one form only
        assert set(facts) == documented, name


def test_the_lists_name_commands_only() -> None:
    assert {*ENDS, *UNTIL_STOPPED, *NO_SERVERS, *COMPILING} <= {*command_names()}


@pytest.mark.parametrize(
    ("name", "words"),
    [
        pytest.param(name, words, marks=[pytest.mark.slow] if words in SLOW.get(name, ()) else [])
        for name in ENDS
        if name not in COMPILING
        for words in ENDS[name]
    ]
    + some([(name, words) for name in COMPILING for words in ENDS[name]], 1),
    ids=lambda case: case if isinstance(case, str) else " ".join(case),
)
def test_stdout_is_an_object_and_the_exit_code_that_of_text(
    name: str, words: list[str], folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(folder)
    inputs = [word.format(folder) for word in words]
    with own_domain():
        code, text, errors = run(name, "--json", *inputs)
        check(name, words, code, text, errors)
        if "out" not in " ".join(words):  # where it would write a second time
            again, lines, _ = run(name, *inputs)
            assert not lines.startswith("{")
            if name in OF_THE_MACHINE and code < 2:
                is_bad, word = OF_THE_MACHINE[name]
                assert (code, again) == (is_bad(json.loads(text)), bool(re.search(word, lines)))
            else:
                assert again == code


def test_words_that_no_command_takes_are_refused_in_an_object_too() -> None:
    for words in ([], *([name] for name in command_names())):
        code, text, errors = run(*words, "--jsom", "--json")
        assert code == 2 and json.loads(text)["refused"] == errors.strip(), words
    for words, key in (([], "commands"), (["--version"], "version"), (["run", "--help"], "help")):
        code, text, _ = run(*words, "--json")
        assert code == 0 and list(json.loads(text)) == [key, "warnings"]


@pytest.mark.parametrize("name", with_slow(some(list(UNTIL_STOPPED), 2), 1))
def test_ctrl_c_ends_a_server_with_an_object(name: str, tmp_path: Path) -> None:
    words = [word.format(tmp_path) for word in UNTIL_STOPPED[name]]
    command = [sys.executable, "-m", "arm_emulator", name, *words, "--json"]
    with (
        own_domain(),
        subprocess.Popen(
            command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
        ) as process,
    ):
        assert process.stdout is not None and process.stderr is not None
        try:
            end = time.monotonic() + PATIENCE
            if name == "record":  # prints nothing without a network
                while not (tmp_path / "new_bag").exists() and time.monotonic() < end:
                    time.sleep(0.05)
            else:
                while not re.search("ready|baud|scene", process.stderr.readline()):
                    assert process.poll() is None
            process.send_signal(signal.SIGINT)
            text, errors = process.communicate(timeout=PATIENCE)
        finally:
            process.kill()
        check(name, words, process.returncode, text, errors)
        assert process.returncode == 0


def test_json_stands_alone_on_stdout_whoever_prints() -> None:
    program = """
import ctypes
from arm_emulator.cli.output import output
with output.print_at_end(as_json=True):
    print("Python")
    output.print_line("people")
    output.make_console().print("tables")
    ctypes.CDLL(None).puts(b"C")
    ctypes.CDLL(None).fflush(None)
    output.add_facts({"none": float("nan"), "one": 1})
"""
    ended = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, check=True
    )
    assert json.loads(ended.stdout) == {"none": None, "one": 1, "warnings": []}
    assert "Python" in ended.stderr and "C" in ended.stderr and "tables" not in ended.stderr


def test_programs_read_json_where_people_read_lines(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    bag = synthetic(tmp_path / "bag", [True] * 8)
    code, lines, _ = run("check-bag", str(bag), "--scene", "three_axis")
    json_code, text, _ = run("check-bag", str(bag), "--scene", "three_axis", "--json")
    facts = json.loads(text)
    assert json_code == code == 0 and "equal to the last bit" in lines
    assert facts["equal"] and facts["scene"] == "three_axis" and facts["counts"]["states"] > 0

    folder = tmp_path / "cache"
    folder.mkdir(mode=0o700)
    library = folder / f"three_axis-{7:020x}.so"
    library.write_bytes(b"library")
    monkeypatch.setenv("ARM_EMULATOR_CACHE", str(folder))
    assert library.name in run("cache")[1]
    [folder_facts] = json.loads(run("cache", "--json")[1])["folders"]
    assert folder_facts["folder"] == str(folder) and not folder_facts["not_trusted"]
    assert [entry["file"] for entry in folder_facts["libraries"]] == [str(library)]
    assert folder_facts["libraries"][0]["size"] == 7
