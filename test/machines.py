"""Machines for tests: URDFs and scenes made from a few numbers."""

import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import yaml

from arm_emulator.machine.plant.compiler import load_equations
from arm_emulator.machine.plant.core_calls import ARM
from arm_emulator.machine.plant.link_dynamics import LinkDynamics
from arm_emulator.machine.scene.scene import Scene, load_scene
from oracles.random_chain import LINK, list_moving_joints, write_random_chain, write_random_tree

CONFIG = Path(__file__).resolve().parents[1] / "config"

# Of random arms: links of some kg behind a gear of 1 to 50.
MOTOR = {
    "resistance": 1.0,
    "inductance": 1e-3,
    "torque_constant": 0.05,
    "back_emf_constant": 0.05,
    "rotor_inertia": 1e-4,
}

# Of gantries, see gantry_urdf().
ROTOR = 1e-4  # kg m2
DC = {
    "resistance": 1.0,
    "inductance": 1e-3,
    "torque_constant": 0.05,
    "back_emf_constant": 0.05,
    "rotor_inertia": ROTOR,
}
PMSM = {
    "kind": "pmsm",
    "resistance": 0.5,
    "inductance_d": 1e-3,
    "inductance_q": 2e-3,
    "flux": 0.01,
    "pole_pairs": 4,
    "rotor_inertia": ROTOR,
}

# Sensors with noise, a brake and varied numbers, as overrides of three_axis.
SENSED: dict[str, Any] = {
    "varied": ["joints.*.friction.viscous", "seed"],
    "seed": 3,
    "joints.*.current_sensor": {"noise": 0.01},
    "joints.shoulder.tachometer": {"noise": 0.001},
    "joints.waist.brake": {"torque": 50.0, "close_delay": 0.004, "release_delay": 0.006},
    "imus.hand": {"link": "forearm", "gyroscope": {"noise": 1e-3}},
}
GRAVITY = [1.0, -2.0, -9.0]  # m/s2, aslant
LINK_INERTIA = 0.05 + 2.0 * 0.3**2  # kg m2, of one_link_urdf() about its joint


def own_three_axis(folder: Path, more: str) -> Path:
    """Write the three-axis arm with its gains and more lines in its scene; return its file."""
    (folder / "urdf").mkdir(parents=True)
    shutil.copy(CONFIG / "urdf/three_axis.urdf", folder / "urdf")
    for kind in ("servo", "motion"):
        (folder / kind).mkdir()
        shutil.copy(CONFIG / kind / "three_axis.yaml", folder / kind)
    file = folder / "three_axis.yaml"
    file.write_text(f"{(CONFIG / file.name).read_text()}\n{more}\n")
    return file


def make_link_urdf(mass: float = 2.0, com: float = 0.3, inertia: float = 0.05) -> str:
    """A link that turns about y, its centre of mass at distance `com` along x."""
    return f"""<robot name="one_link"><link name="base"/>{
        LINK.format(
            name="joint", kind="continuous", xyz="0 0 0", rpy="0 0 0", parent="base", axis="0 1 0",
            com=f"{com} 0 0", com_rpy="0 0 0", mass=mass, ixx=inertia, iyy=inertia, izz=inertia,
            ixy=0, ixz=0, iyz=0,
        )
    }</robot>"""  # fmt: skip


GANTRY = "x", "y", "z"  # joints of gantry_urdf(), base to tool
MOVED = np.array([6.0, 4.0, 2.0])  # kg, by each of them


def gantry_urdf(mass: float = 2.0) -> str:
    """Three links that slide along x, y and z, and so do not feel each other: 3, 2, 1 `mass`."""
    text, parent = '<robot name="gantry"><link name="base"/>', "base"
    for name, axis in zip(GANTRY, ("1 0 0", "0 1 0", "0 0 1"), strict=True):
        text += LINK.format(
            name=name, kind="prismatic", xyz="0 0 0", rpy="0 0 0", parent=parent, axis=axis,
            com="0 0 0", com_rpy="0 0 0", mass=mass, ixx=0.1, iyy=0.1, izz=0.1, ixy=0, ixz=0, iyz=0,
        )  # fmt: skip
        parent = f"{name}_link"
    return text + "</robot>"


def write_scene(folder: Path, urdf: str, joints: dict[str, Any], **keys: Any) -> Path:
    """Write a scene and its URDF into `folder` and return the scene's path.

    All have the same name, which is part of a library's, so that equal machines share one.
    """
    (folder / "robot.urdf").write_text(urdf)
    data = {
        "name": "machine",
        "urdf": "robot.urdf",
        "tool": "base",
        "supply_voltage": 48.0,
        "joints": joints,
        "integrator": {"scheme": "paper", "dt": 1e-4},
        "servo_period": 1e-3,
        **keys,
    }
    file = folder / "scene.yaml"
    file.write_text(yaml.safe_dump(data))
    return file


def random_chain(folder: Path, seed: int, joints: int, **keys: Any) -> Scene:
    """A random chain whose joints swing freely."""
    urdf = write_random_chain(np.random.default_rng(seed), joints)
    return load_scene(
        write_scene(folder, urdf, {name: {} for name in list_moving_joints(urdf)}, **keys)
    )


def random_tree(folder: Path, seed: int, joints: int, **keys: Any) -> Scene:
    """The same as a tree."""
    urdf = write_random_tree(np.random.default_rng(seed), joints)
    return load_scene(
        write_scene(folder, urdf, {name: {} for name in list_moving_joints(urdf)}, **keys)
    )


def links_of(scene: Scene) -> LinkDynamics:
    """Return what `Plant.links` does without a machine, for a scene without varied numbers."""
    assert not scene.varied and not scene.external_wrench, "the point below is of the state alone"
    library, N = load_equations(scene), len(scene.joints)
    at_rest = ARM.ffi.new("double[]", 100 * N)  # more than a state has
    return LinkDynamics(lambda name, *arguments: getattr(library, name)(at_rest, *arguments), N)


class Oracle:
    """The scene's links in Pinocchio, with the scene's joint order and plain joint angles."""

    def __init__(self, scene: Scene) -> None:
        self.model = pin.buildModelFromXML(scene.urdf)
        self.model.gravity.linear = np.array(scene.gravity or (0.0, 0.0, 0.0))
        self.data = self.model.createData()
        joints = [self.model.joints[self.model.getJointId(name)] for name in scene.joint_names]
        self._places = [joint.idx_v for joint in joints]
        self._joints = joints

    def configuration(self, q: np.ndarray) -> np.ndarray:
        """Pinocchio's q: cosine and sine for continuous joints."""
        out = np.zeros(self.model.nq)
        for joint, angle in zip(self._joints, q, strict=True):
            revolute = joint.nq == 2
            out[joint.idx_q : joint.idx_q + joint.nq] = (
                (np.cos(angle), np.sin(angle)) if revolute else angle
            )
        return out

    def aba(self, q: np.ndarray, v: np.ndarray, tau: np.ndarray) -> np.ndarray:
        at = self.configuration(q)
        return pin.aba(self.model, self.data, at, self._in(v), self._in(tau))[self._places]

    def mass_matrix(self, q: np.ndarray) -> np.ndarray:
        M = pin.crba(self.model, self.data, self.configuration(q))
        M = np.triu(M) + np.triu(M, 1).T
        return M[np.ix_(self._places, self._places)]

    def nle(self, q: np.ndarray, v: np.ndarray) -> np.ndarray:
        at = self.configuration(q)
        return pin.nonLinearEffects(self.model, self.data, at, self._in(v))[self._places]

    def energy(self, q: np.ndarray, v: np.ndarray) -> float:
        """Kinetic and potential energy of the links."""
        at = self.configuration(q)
        kinetic = pin.computeKineticEnergy(self.model, self.data, at, self._in(v))
        return float(kinetic + pin.computePotentialEnergy(self.model, self.data, at))

    def jacobian(self, q: np.ndarray, link: str) -> tuple[np.ndarray, np.ndarray]:
        """J (6, N) at a link's frame along the world's axes, and the frame's rotation (3, 3)."""
        frame, at = self.model.getFrameId(link), self.configuration(q)
        axes = pin.ReferenceFrame.LOCAL_WORLD_ALIGNED
        J = pin.computeFrameJacobian(self.model, self.data, at, frame, axes)
        placement = pin.updateFramePlacement(self.model, self.data, frame)
        return J[:, self._places], placement.rotation

    def place(self, q: np.ndarray, link: str) -> np.ndarray:
        """Origin of a link's frame in the world (3,) [m]."""
        pin.forwardKinematics(self.model, self.data, self.configuration(q))
        frame = self.model.getFrameId(link)
        placement = pin.updateFramePlacement(self.model, self.data, frame)
        return placement.translation.copy()

    def _in(self, values: np.ndarray) -> np.ndarray:
        """Pinocchio's order of joints, which goes by their names."""
        out = np.empty(len(values))
        out[self._places] = values
        return out
