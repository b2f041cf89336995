"""A controller manager of ros2_control, unchanged, with its own controllers moves our arms.

The tests need ros2_control, built or installed, on AMENT_PREFIX_PATH.
"""

import hashlib
import os
import subprocess
import sysconfig
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
import rclpy
import yaml
from action_msgs.msg import GoalStatus
from draws import FULL
from rclpy.action import ActionClient
from rclpy.duration import Duration
from rosgraph_msgs.msg import Clock
from std_msgs.msg import Float64MultiArray, String
from std_srvs.srv import SetBool

from arm_emulator.base.cpu_load import load_processors
from arm_emulator.base.io.config_files import find_scene
from arm_emulator.machine.scene.scene import load_scene
from arm_emulator.ros.messages.time_stamp import convert_to_nanoseconds
from arm_emulator.ros.node.network_client import NetworkClient
from arm_emulator.ros.node.node_shell import DESCRIPTION_QOS
from arm_emulator.ros.process.ros_domain import own_domain
from arm_emulator_export.commands.ros2_control import write_ros2_control_files
from arm_emulator_export.control_files import PLUGIN

PACKAGE = Path(__file__).resolve().parents[2] / "packages/arm_emulator_hardware"
PREFIXES = [Path(entry) for entry in os.environ.get("AMENT_PREFIX_PATH", "").split(":") if entry]
REQUIRED_PACKAGES = (
    "controller_manager",
    "joint_trajectory_controller",
    "forward_command_controller",
)
MOCK = "mock_components/GenericSystem"
TARGETS = {
    "three_axis": {"waist": 0.4, "shoulder": 0.8, "elbow": 1.0},
    "ur5": {
        "shoulder_pan_joint": 0.5, "shoulder_lift_joint": -1.2, "elbow_joint": 1.0,
        "wrist_1_joint": -1.0, "wrist_2_joint": -1.2, "wrist_3_joint": 0.3,
    },
}  # fmt: skip
SECONDS = 2.0
RUNS, BUSY = (100, 8) if FULL else (2, 0)  # that are compared, busy processes beside them
CYCLES = 10_000
CHECKS = "-g -O1 -fsanitize=address,undefined -fno-sanitize-recover=undefined"
# The middleware keeps memory until its process ends, and frees it by another size.
QUIET = {"ASAN_OPTIONS": "detect_leaks=0:new_delete_type_mismatch=0:verify_asan_link_order=0"}

absent = [
    package
    for package in REQUIRED_PACKAGES
    if not any((at / "share" / package).is_dir() for at in PREFIXES)
]
pytestmark = pytest.mark.skipif(bool(absent), reason=f"not there: {', '.join(absent)}")


def install(at: Path, flags: str = "") -> Path:
    """Build our package; return where it is installed."""
    for words in (
        ("-S", str(PACKAGE), "-B", str(at / "build"), f"-DCMAKE_INSTALL_PREFIX={at / 'install'}",
         f"-DCMAKE_CXX_FLAGS={flags}",
         "-DCMAKE_EXE_LINKER_FLAGS=-Wl,--unresolved-symbols=ignore-in-shared-libs"),
        ("--build", str(at / "build")),
        ("--install", str(at / "build")),
    ):  # fmt: skip
        free = {name: value for name, value in os.environ.items() if name != "LD_PRELOAD"}
        done = subprocess.run(
            ("cmake", *words), capture_output=True, text=True, env=free, check=False
        )
        assert done.returncode == 0, done.stdout + done.stderr
        assert "warning:" not in done.stderr
    return at / "install"


@pytest.fixture(scope="module")
def prefix(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Our package, installed."""
    return install(tmp_path_factory.mktemp("hardware"))


@pytest.fixture(scope="module")
def sound(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Our package with sanitizers in it."""
    return install(tmp_path_factory.mktemp("sound"), CHECKS)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("scenes")


@pytest.fixture(autouse=True)
def domain() -> Iterator[int]:
    """No other controller manager, and no other clock."""
    with own_domain() as domain_id:
        yield domain_id


def of_program(prefix: Path, program: str, *words: object, **more: str) -> dict[str, Any]:
    """Return how a program of ours is started."""
    paths = f"{prefix}:{os.environ['AMENT_PREFIX_PATH']}"
    of_wheels = ":".join(map(str, Path(sysconfig.get_paths()["purelib"]).glob("*.libs")))
    libraries = f"{prefix / 'lib'}:{os.environ.get('LD_LIBRARY_PATH', '')}:{of_wheels}"
    # Libraries of messages in wheels need Python's without naming it.
    python = Path(sysconfig.get_config_var("LIBDIR"), sysconfig.get_config_var("INSTSONAME"))
    preload = str(python) if of_wheels and python.is_file() else ""
    others = {"AMENT_PREFIX_PATH": paths, "LD_LIBRARY_PATH": libraries, "LD_PRELOAD": preload}
    return {
        "args": [prefix / "lib/arm_emulator_hardware" / program, *map(str, words)],
        "env": {**os.environ, **others, **more},
        "text": True,
    }


def run(
    prefix: Path, program: str, *words: object, seconds: float = 120.0, **more: str
) -> subprocess.CompletedProcess[str]:
    how = of_program(prefix, program, *words, **more)
    return subprocess.run(**how, capture_output=True, timeout=seconds, check=False)


def move(
    prefix: Path, description: Path, controllers: Path, target: Mapping[str, float],
    rows: Path | None = None,
) -> subprocess.CompletedProcess[str]:  # fmt: skip
    words = [f"{joint}={value}" for joint, value in target.items()]
    return run(prefix, "trajectory", description, controllers, SECONDS, rows or "-", *words)


@pytest.mark.parametrize("name", TARGETS)
def test_a_trajectory_is_followed_with_equal_bits(prefix: Path, folder: Path, name: str) -> None:
    write_ros2_control_files(name, into=folder)
    files = folder / f"{name}.urdf", folder / f"{name}_controllers.yaml"
    with load_processors(BUSY):
        runs = [move(prefix, *files, TARGETS[name]) for _ in range(RUNS)]
    assert runs[0].returncode == 0, runs[0].stderr
    digest, *lines = runs[0].stdout.splitlines()
    assert digest.startswith("digest ") and {finished.stdout for finished in runs} == {
        runs[0].stdout
    }
    scene = load_scene(name)
    for line, joint in zip(lines, scene.joints, strict=True):
        word, *numbers = line.split()
        true, measured, start = map(float, numbers)
        assert word == joint.name and start == pytest.approx(joint.start, abs=1e-9)
        # A gear that carries the arm's weight is wound up by some tenths of a mrad.
        assert np.allclose([true, measured], TARGETS[name][word], atol=1.5e-3), line


def test_mock_components_have_no_error_and_we_have_that_of_the_drives(
    prefix: Path, folder: Path, tmp_path: Path
) -> None:
    """The line of the plugin is all that differs."""
    name = "three_axis"
    write_ros2_control_files(name, into=folder)
    text = (folder / f"{name}.urdf").read_text()
    (tmp_path / "mock.urdf").write_text(text.replace(PLUGIN, MOCK))
    table: dict[str, npt.NDArray[np.float64]] = {}
    for component, description in (
        ("ours", folder / f"{name}.urdf"),
        ("mock", tmp_path / "mock.urdf"),
    ):
        rows = tmp_path / component
        done = move(prefix, description, folder / f"{name}_controllers.yaml", TARGETS[name], rows)
        assert done.returncode == 0, done.stderr
        joints = len(TARGETS[name])
        table[component] = np.array(
            [[float(word) for word in line.split()] for line in rows.read_text().splitlines()]
        ).reshape(-1, joints, 4)
    position, velocity, effort, true = (table["ours"][..., k] for k in range(4))
    reference = table["mock"][..., 0]
    assert not table["mock"][..., 2].any(), "a mock needs no torque"
    # A mock is at its command a cycle later, and so is our arm at the soonest.
    late = np.abs(true - reference).max(axis=0)
    assert np.all(late > 1e-5) and np.all(late < 5e-3)
    # Held by its motors against gravity, at rest at the end.
    assert np.abs(effort[-1]).max() > 1.0 and np.abs(velocity[-1]).max() < 1e-2
    wind_up = np.abs(position - true)[-1]
    assert 1e-5 < wind_up.max() < 5e-3


# They bear the motions between the troubles; the largest currents heat them by 20 and 1 K/ms.
CONSTANT = {"resistance_coefficient": 0.0}
WINDINGS = {
    "three_axis": {"heat_capacity": 0.02, "thermal_resistance": 2.0, "limit": 500.0, **CONSTANT},
    "ur5": {"heat_capacity": 0.05, "thermal_resistance": 10.0, "limit": 350.0, **CONSTANT},
}
HOT = {"three_axis": 100.0, "ur5": 150.0}  # N m, of 20 and 11.9 A
STIFFNESS, FAULT = "joints.elbow.gear.stiffness", "faults.elbow.encoder_stuck"


def troubled(name: str, into: Path) -> Path:
    """Write what a manager needs for a machine whose windings get hot; `three_axis` can diverge.

    Returns parameters with controllers for each loop of the drives and each trouble.
    """
    file = find_scene(name)
    scene = yaml.safe_load(file.read_text()) | {"servo": name, "motion": name}
    for joint in scene["joints"].values():
        joint["motor"] = {**joint["motor"], "winding": WINDINGS[name]}
    numbers = {}
    if name == "three_axis":
        scene["urdf"] = str(file.parent / scene["urdf"])
        scene["integrator"]["scheme"] = "paper"  # explicit: 1 ms is too long for a stiff gear
        scene |= {"varied": [STIFFNESS], "faults": [FAULT.removeprefix("faults.")]}
        numbers = {"stiffness": STIFFNESS, "fault": FAULT}
    (into / f"{name}.yaml").write_text(yaml.safe_dump(scene))
    write_ros2_control_files(str(into / f"{name}.yaml"), into=into)
    parameters = yaml.safe_load((into / f"{name}_controllers.yaml").read_text())
    manager = parameters["controller_manager"]["ros__parameters"]
    forwarded = {loop: (list(TARGETS[name]), loop) for loop in ("position", "velocity", "effort")}
    forwarded["power"] = [f"{name}_power"], "power"
    forwarded |= {joint: ([f"{name}_varied"], number) for joint, number in numbers.items()}
    for controller, (joints, interface) in forwarded.items():
        manager[controller] = {"type": "forward_command_controller/ForwardCommandController"}
        parameters[controller] = {
            "ros__parameters": {"joints": joints, "interface_name": interface}
        }
    written = into / f"{name}_turns.yaml"
    written.write_text(yaml.safe_dump(parameters))
    return written


@pytest.mark.parametrize(
    ("name", "cycles"), [("three_axis", CYCLES), ("ur5", CYCLES // 4)], ids=["three_axis", "ur5"]
)
def test_controllers_alternate_while_the_machine_is_in_trouble(
    tmp_path: Path, name: str, cycles: int, sound: Path
) -> None:
    controllers = troubled(name, tmp_path)
    words = tmp_path / f"{name}.urdf", controllers, name, cycles, 1, HOT[name], *TARGETS[name]
    runs = [run(sound, "switches", *words, seconds=550.0, **QUIET) for _ in range(2)]
    assert runs[0].returncode == 0, runs[0].stdout + runs[0].stderr
    assert "ERROR: AddressSanitizer" not in runs[0].stderr
    assert "runtime error" not in runs[0].stderr
    assert runs[1].stdout == runs[0].stdout
    counts = dict(line.split() for line in runs[0].stdout.splitlines())
    assert int(counts["switches"]) > 0.5 * cycles / 40 and counts["not_finite"] == "0"
    assert int(counts["cuts"]) == cycles // 970 and int(counts["hot"]) == cycles // 1130
    if name == "three_axis":
        assert int(counts["diverged"]) == cycles // 1510
    assert int(counts["wrong"]) > 0.3 * cycles / 210, "infinities, which are refused"
    assert 0.01 < float(counts["fastest"]) < 10.0


START = '<param name="initial_value">0.5<'
NUMBER = '<param name="initial_value">10000.0<'
WRONG = [
    ('name="scene"', 'name="scenes"', "param must be known, got scenes; valid: scene"),
    ('<param name="scene"', '<param name="clock">wall</param><param name="scene"',
     "param must be known, got clock; valid: scene"),
    ('<command_interface name="velocity"', '<command_interface name="speed"',
     "command_interface must be known, got speed; valid: position, velocity, effort"),
    ('<state_interface name="current"', '<state_interface name="amps"',
     "state_interface must be known, got amps"),
    ('<state_interface name="powered"', '<state_interface name="on"',
     "three_axis_power: state_interface must be known, got on; valid: powered"),
    ('<command_interface name="power"', '<command_interface name="Power"',
     "must be `power` or a number that the scene varies, got Power; valid: joints.elbow.gear"),
    ("faults.elbow.encoder_stuck", "faults.elbow.encoder_gone", "got faults.elbow.encoder_gone"),
    (NUMBER, '<param name="initial_value"><', f"{STIFFNESS} must have an initial_value"),
    (NUMBER, '<param name="initial_value">-5<', f"{STIFFNESS} must be within 1e-15 to 1e+15"),
    (NUMBER, '<param name="initial_value">much<', "Invalid initial value : 'much'"),
    (START, '<param name="initial_value">1e300<', "must be 3 numbers within -1e+09 to 1e+09"),
    (START, '<param name="initial_value">half<', "Invalid initial value : 'half'"),
    ("three_axis</param>", "nothing</param>", "scene must be FOLDER/NAME after"),
    ("/three_axis</param>", "/</param>", "scene must be FOLDER/NAME after"),
    ('name="elbow"', 'name="bend"',
     "joint must be one of the arm, got bend; valid: waist, shoulder, elbow"),
    ('type="system"', 'type="system" is_async="true"', "is_async must be false"),
    ('type="system"', 'type="system" rw_rate="300"', "update_rate must give whole ns, got 300 Hz"),
    ('<command_interface name="position"', '<command_interface name="position" data_type="bool"',
     "data_type of position must be double, got bool"),
    (PLUGIN, f"{PLUGIN}s", f"class {PLUGIN}s with base class type"),
]  # fmt: skip


def test_wrong_descriptions_are_a_line(prefix: Path, tmp_path: Path) -> None:
    troubled("three_axis", tmp_path)
    text = (tmp_path / "three_axis.urdf").read_text()
    for old, new, why in WRONG:
        assert old in text
        (tmp_path / "wrong.urdf").write_text(text.replace(old, new))
        files = tmp_path / "wrong.urdf", tmp_path / "three_axis_controllers.yaml"
        with own_domain():
            done = move(prefix, *files, TARGETS["three_axis"])
        assert done.returncode > 0, f"{new}: {done.stderr}"
        assert len([line for line in done.stderr.splitlines() if why in line]) == 1, done.stderr


def test_lockstep_node_ends_in_a_line_after_a_wrong_description(
    prefix: Path, tmp_path: Path
) -> None:
    write_ros2_control_files("three_axis", into=tmp_path)
    description = tmp_path / "three_axis.urdf"
    description.write_text(description.read_text().replace("three_axis</param>", "none</param>"))
    with client_node() as node:
        node_manager = Managed(node, prefix, description, tmp_path / "three_axis_controllers.yaml")
        node_manager.wait("its end", lambda: node_manager.process.poll() is not None)
    assert node_manager.process.returncode == 2
    assert node_manager.log.read_text().count("scene must be FOLDER/NAME after") == 1


@pytest.mark.parametrize(
    ("wrong", "why"),
    [("real_time_factor:=-1.0", "real_time_factor must be 0, or at least 1e-06, got -1"),
     ("start:=later", "start must be known, got later; valid: running, paused")],
)  # fmt: skip
def test_lockstep_node_refuses_a_parameter_in_a_line(
    prefix: Path, folder: Path, wrong: str, why: str
) -> None:
    write_ros2_control_files("three_axis", into=folder)
    words = "--params-file", folder / "three_axis_controllers.yaml", "-p", wrong
    done = run(prefix, "lockstep_node", "--ros-args", *words)
    assert done.returncode == 2 and done.stderr.count(why) == 1, done.stderr


@contextmanager
def client_node() -> Iterator[NetworkClient]:
    """A client in the domain."""
    context = rclpy.Context()
    context.init()
    node = NetworkClient("client", "", context)
    try:
        yield node
    finally:
        node.destroy_node()
        context.shutdown()


def test_times_of_another_process_are_refused_in_a_line(prefix: Path, folder: Path) -> None:
    """A cycle between whose steps the clock jumps is not a cycle: it must not pass silently."""
    write_ros2_control_files("three_axis", into=folder)
    files = folder / "three_axis.urdf", folder / "three_axis_controllers.yaml"
    over = threading.Event()
    with client_node() as node:
        publisher = node.create_publisher(Clock, "/clock", 10)

        def publish() -> None:
            message = Clock()
            while not over.wait(0.001):
                message.clock.sec += 1
                publisher.publish(message)

        thread = threading.Thread(target=publish)
        thread.start()
        try:
            done = move(prefix, *files, TARGETS["three_axis"])
        finally:
            over.set()
            thread.join()
    assert done.returncode == 5 and "digest" not in done.stdout, done.stdout
    assert done.stderr.count("/clock must be published by this process alone") == 1, done.stderr


class Managed:
    """A client of a `lockstep_node` in a process of its own, whose time stands at the start.

    Args:
        node: the client.
        prefix: where our package is installed.
        description: of the robot.
        parameters: of the manager and its controllers.
    """

    def __init__(
        self, node: NetworkClient, prefix: Path, description: Path, parameters: Path
    ) -> None:
        self.node, self.name, self.log = node, description.stem, parameters.with_suffix(".log")
        self._services: dict[str, Any] = {}
        self._clients: list[ActionClient] = []
        self._describe = node.create_publisher(String, "/robot_description", DESCRIPTION_QOS)
        self._describe.publish(String(data=description.read_text()))
        words = (
            "--ros-args", "--params-file", parameters, "-p", "start:=paused",
            "-p", "real_time_factor:=0.5", "--log-level", "warn",
        )  # fmt: skip
        with self.log.open("w") as log:
            self.process = subprocess.Popen(
                **of_program(prefix, "lockstep_node", *words), stderr=log
            )

    def wait(self, condition_text: str, condition: Callable[[], bool]) -> None:
        assert self.node.spin_until(condition, 120.0), f"{condition_text}; {self.log.read_text()}"

    def call(self, kind: Any, service: str, **request: Any) -> Any:
        if service not in self._services:
            self._services[service] = self.node.create_client(kind, service)
        client = self._services[service]
        self.wait(service, client.service_is_ready)
        answer = client.call_async(kind.Request(**request))
        self.wait(service, answer.done)
        return answer.result()

    def let_pass(self, seconds: float) -> None:
        """Wait for the manager's time."""
        times: list[int] = []

        def hear(message: Clock) -> None:
            times.append(convert_to_nanoseconds(message.clock))

        clock = self.node.create_subscription(Clock, "/clock", hear, 10)
        self.wait("time", lambda: bool(times) and times[-1] >= times[0] + 1e9 * seconds)
        self.node.destroy_subscription(clock)

    def load(self, *controllers: str) -> None:
        from controller_manager_msgs.srv import ConfigureController, LoadController

        for name in controllers:
            for kind, verb in (LoadController, "load"), (ConfigureController, "configure"):
                assert self.call(kind, f"/controller_manager/{verb}_controller", name=name).ok

    def switch(self, start: Sequence[str], stop: Sequence[str] = ()) -> None:
        from controller_manager_msgs.srv import SwitchController

        request = {"activate_controllers": [*start], "deactivate_controllers": [*stop]}
        service = "/controller_manager/switch_controller"
        assert self.call(SwitchController, service, strictness=2, **request).ok

    def pause(self, paused: bool) -> None:
        assert self.call(SetBool, "/controller_manager/pause", data=paused).success

    @property
    def state(self) -> str:
        """Lifecycle state of the arm."""
        from controller_manager_msgs.srv import ListHardwareComponents

        service = "/controller_manager/list_hardware_components"
        return str(self.call(ListHardwareComponents, service).component[0].state.label)

    def activate(self) -> None:
        from controller_manager_msgs.srv import SetHardwareComponentState
        from lifecycle_msgs.msg import State

        service, state = "/controller_manager/set_hardware_component_state", State(label="active")
        request = {"name": self.name, "target_state": state}
        assert self.call(SetHardwareComponentState, service, **request).ok

    def send(self, controller: str, *values: float, until: Callable[[], bool]) -> None:
        """Send values to a forward_command_controller until they show.

        A reader that has just been found may miss the first ones.
        """
        publisher = self.node.create_publisher(Float64MultiArray, f"/{controller}/commands", 10)
        self.wait(controller, lambda: publisher.get_subscription_count() > 0)
        for _ in range(20):
            publisher.publish(Float64MultiArray(data=values))
            if self.node.spin_until(until, 6.0):
                break
        assert until(), f"{controller}; {self.log.read_text()}"
        # One that was sent once too often is taken before this is answered, not later.
        assert publisher.wait_for_all_acked(Duration(seconds=60)) and self.state and self.state
        self.node.destroy_publisher(publisher)

    def follow(self, seconds: float, target: Mapping[str, float], **allowed: float) -> Any:
        """Send a goal; return its handle."""
        from control_msgs.action import FollowJointTrajectory
        from control_msgs.msg import JointTolerance
        from trajectory_msgs.msg import JointTrajectoryPoint

        topic = "/joint_trajectory_controller/follow_joint_trajectory"
        client = ActionClient(self.node, FollowJointTrajectory, topic)
        self.wait(topic, client.server_is_ready)
        goal = FollowJointTrajectory.Goal()
        goal.trajectory.joint_names = list(target)
        end = JointTrajectoryPoint(positions=[*target.values()], velocities=[0.0] * len(target))
        end.time_from_start = Duration(seconds=seconds).to_msg()
        goal.trajectory.points = [end]
        goal.path_tolerance = [JointTolerance(name=k, position=v) for k, v in allowed.items()]
        sent = client.send_goal_async(goal)
        self.wait("the goal", sent.done)
        assert sent.result().accepted, self.log.read_text()
        self._clients.append(client)
        return sent.result()

    def result(self, goal: Any) -> Any:
        result = goal.get_result_async()
        self.wait("the goal's end", result.done)
        return result.result()

    def close(self) -> None:
        for client in self._clients:
            client.destroy()
        self.process.terminate()
        assert self.process.wait(60.0) == 0


@contextmanager
def managed(prefix: Path, description: Path, parameters: Path) -> Iterator[Managed]:
    """Start a manager in the domain, and end it."""
    with client_node() as node:
        managed_node = Managed(node, prefix, description, parameters)
        try:
            yield managed_node
        finally:
            managed_node.close()


JTC = "joint_trajectory_controller"


def goal_run(prefix: Path, folder: Path) -> dict[int, str]:
    """Send a goal by its action to a manager that stands, let time go on; return states by time.

    The action answers before its controller has the goal, which the manager's one thread hides.
    """
    from control_msgs.msg import JointTrajectoryControllerState

    states: dict[int, str] = {}

    def keep(state: Any) -> None:
        bits = np.concatenate([state.feedback.positions, state.output.positions]).tobytes()
        states[convert_to_nanoseconds(state.header.stamp)] = hashlib.sha256(bits).hexdigest()

    files = folder / "three_axis.urdf", folder / "three_axis_controllers.yaml"
    with managed(prefix, *files) as manager:
        manager.load(JTC)
        manager.switch([JTC])
        topic = f"/{JTC}/controller_state"
        manager.node.create_subscription(JointTrajectoryControllerState, topic, keep, 1000)
        manager.wait("a state", lambda: bool(states))
        goal = manager.follow(0.3, TARGETS["three_axis"])
        manager.pause(False)
        assert manager.result(goal).result.error_code == 0
    return states


def test_a_goal_sent_while_time_stands_gives_equal_bits(prefix: Path, folder: Path) -> None:
    write_ros2_control_files("three_axis", into=folder)
    with load_processors(BUSY):
        first, *others = [goal_run(prefix, folder) for _ in range(RUNS)]
    for later in others:
        # States are sent best effort. Of the time that stands, any may be the last one.
        both = first.keys() & later.keys() - {min(first)}
        moving = [at for at in both if at < 300_000_000]
        assert len(moving) > 50
        assert all(first[at] == later[at] for at in both)


def test_troubles_are_states_of_the_component_and_results_of_goals(
    prefix: Path, tmp_path: Path
) -> None:
    """A cut, hot windings, a fault and a divergence, each in the middle of a motion."""
    name, loops = "three_axis", ("power", "fault", "stiffness")
    parameters = troubled(name, tmp_path)
    away, back = ({joint: by * q for joint, q in TARGETS[name].items()} for by in (1.0, 0.5))
    with managed(prefix, tmp_path / f"{name}.urdf", parameters) as manager:
        manager.load(JTC, "effort", *loops)
        manager.switch([JTC, *loops])
        assert manager.state == "active"
        manager.pause(False)

        def again() -> None:
            """Begin again at rest, with cool windings; a component stops its controllers."""
            manager.let_pass(1.0)
            manager.activate()
            manager.switch([JTC, *loops])
            assert manager.result(manager.follow(1.0, back)).result.error_code == 0

        goal = manager.follow(20.0, away)
        manager.send("power", 0.0, until=lambda: manager.state == "inactive")
        assert manager.result(goal).status == GoalStatus.STATUS_ABORTED
        again()

        manager.switch(["effort"], [JTC])
        efforts = [HOT[name]] * 3
        manager.send("effort", *efforts, until=lambda: manager.state == "inactive")
        again()

        goal = manager.follow(20.0, away, elbow=0.05)
        ended = goal.get_result_async()
        manager.send("fault", 1.0, until=ended.done)  # the servo drives the elbow away
        assert ended.result().result.error_code == -4, "its path tolerance"
        assert manager.state == "active", "no drive has noticed"

        goal = manager.follow(20.0, away)
        manager.send("stiffness", 1e9, until=lambda: manager.state == "unconfigured")
        assert manager.result(goal).status == GoalStatus.STATUS_ABORTED
        again()  # as at the start, without the fault
    lines = manager.log.read_text()
    assert lines.count("got a cut") == lines.count("got a divergence") == 1, lines
    # A machine that diverges may trip by its currents first.
    assert lines.count("got one too hot") in (1, 2), lines
