"""Inertias that no body has, or hardly any: refused, warned of, or replaced from shapes."""

import math
import shutil
import xml.etree.ElementTree as ET
from pathlib import Path

import numpy as np
import pytest
from draws import some, with_slow
from test_new_drives import untuned

from arm_emulator import Refusal, load_scene
from arm_emulator.base import warning
from arm_emulator.cli.commands.check_scene import check_scene
from arm_emulator.design.new_scene import NewScene, write_new

__all__ = ["untuned"]  # a fixture
pytestmark = pytest.mark.usefixtures("untuned", "without_loops")

SIZE = np.array([0.08, 0.1, 0.3])  # m, of all boxes
KEYS = ("ixx", "iyy", "izz", "ixy", "ixz", "iyz")
BOX = '<box size="{:g} {:g} {:g}"/>'.format(*SIZE)


@pytest.fixture
def without_loops(monkeypatch: pytest.MonkeyPatch) -> None:
    """Loops are not analysed, for which the machine is compiled: the tests are of links."""
    place = "arm_emulator.cli.commands.check_scene."
    monkeypatch.setattr(place + "warn_of_loops", lambda *_: None)
    monkeypatch.setattr(place + "list_withheld_modes", lambda *_: [])


def moments(mass: float, size: np.ndarray = SIZE) -> np.ndarray:
    """Return the principal moments of a box, filled evenly, in closed form."""
    square = size**2
    return mass * (square.sum() - square) / 12.0


def arm(
    bodies: list[tuple[float, np.ndarray]], shape: str = BOX, at: str = "0.0123 -0.0071 0.15"
) -> str:
    """Return an arm of boxes with masses [kg] and tensors (3, 3) [kg m2]."""
    text = ['<robot name="boxes"><link name="base"/>']
    before = "base"
    for k, (mass, tensor) in enumerate(bodies, start=1):
        entries = (*np.diag(tensor), tensor[0, 1], tensor[0, 2], tensor[1, 2])
        inertia = " ".join(f'{key}="{value!r}"' for key, value in zip(KEYS, entries, strict=True))
        text.append(
            f'<link name="l{k}"><inertial><origin xyz="{at}"/><mass value="{mass!r}"/>'
            f'<inertia {inertia}/></inertial><collision><origin xyz="0 0 0.15"/><geometry>{shape}'
            f'</geometry></collision></link><joint name="j{k}" type="revolute">'
            f'<parent link="{before}"/><child link="l{k}"/><origin xyz="0 0 0.3"/>'
            '<axis xyz="0 1 0"/><limit lower="-2" upper="2" effort="50" velocity="2"/></joint>'
        )
        before = f"l{k}"
    return "".join(text).replace("np.float64(", "").replace(')"', '"') + "</robot>"


def good(mass: float = 2.4) -> tuple[float, np.ndarray]:
    return mass, np.diag(moments(mass))


def turned(diagonal: np.ndarray, seed: int) -> np.ndarray:
    """Return a tensor of these principal moments along axes that are drawn."""
    Q, _ = np.linalg.qr(np.random.default_rng(seed).normal(size=(3, 3)))
    tensor: np.ndarray = Q @ np.diag(diagonal) @ Q.T
    return 0.5 * (tensor + tensor.T)


def scene_of(folder: Path, text: str, **options: bool) -> NewScene:
    folder.mkdir(exist_ok=True)
    file = folder / "boxes.urdf"
    file.write_text(text)
    shutil.rmtree(folder / "new", ignore_errors=True)
    return write_new(file, folder / "new", **options)  # type: ignore[arg-type]


IMPOSSIBLE = {
    "triangle": (2.0, np.diag([0.0043, 0.0110, 0.0519]), "above the sum of the others"),
    "turned triangle": (2.0, turned(np.array([0.01, 0.02, 0.035]), 3), "above the sum"),
    "identity": (0.6, np.eye(3), "longer than the arm"),
    "micro": (1e-5, np.diag([1e-5] * 3), "longer than the arm"),
    "air": (1e-3, np.diag(moments(1e-3)), "0.417 kg/m3"),
}
DOUBTFUL = {
    "light": (0.5, np.diag(moments(0.5)), "208 kg/m3, not 300 to 3000"),
    "heavy": (10.0, np.diag(moments(10.0)), "4.17e+03 kg/m3"),
    "wide": (2.4, 9.0 * np.diag(moments(2.4)), "radius of gyration"),
    "small": (2.4, 1e-6 * np.eye(3), "radius of gyration"),
    "point": (2.4, np.zeros((3, 3)), "radius of gyration"),
}


@pytest.mark.parametrize("kind", IMPOSSIBLE)
def test_impossible_inertias_are_refused_and_replaced(kind: str, tmp_path: Path) -> None:
    mass, tensor, words = IMPOSSIBLE[kind]
    text = arm([good(), (mass, tensor), good()])
    with pytest.raises(Refusal, match=r"inertia of link l2 must be a body's") as refusal:
        scene_of(tmp_path, text)
    assert words in str(refusal.value) and "--replace-inertias" in str(refusal.value)
    assert not (tmp_path / "new").exists()
    written = scene_of(tmp_path, text, replace_inertias=True)
    assert [assumed.link for assumed in written.assumed] == ["l2"]
    body = load_scene(written.file).chain.joints[1].body
    saved = mass if 300.0 <= mass / SIZE.prod() <= 3000.0 else 1200.0 * SIZE.prod()
    assert body.mass == pytest.approx(saved, rel=1e-5), "a mass in doubt goes, too"
    c = body.moment / body.mass
    about = body.inertia - body.mass * (float(c @ c) * np.eye(3) - np.outer(c, c))
    np.testing.assert_allclose(np.sort(np.linalg.eigvalsh(about)), np.sort(moments(saved)), 1e-4)


def test_a_negative_moment_is_replaced_as_a_missing_moment_is(tmp_path: Path) -> None:
    written = scene_of(tmp_path, arm([good(), (2.0, turned(np.array([-0.005, 0.02, 0.018]), 4))]))
    assert [body.link for body in written.assumed] == ["l2"]


@pytest.mark.parametrize("kind", with_slow(DOUBTFUL, 2))
def test_doubtful_inertias_are_warned_of(
    kind: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    inputs: list[str] = []
    monkeypatch.setattr(warning, "issued", inputs)
    mass, tensor, words = DOUBTFUL[kind]
    text = arm([good(), good(), (mass, tensor)])
    written = scene_of(tmp_path, text)
    assert sum("link l3: " in line and words in line for line in inputs) == 1, inputs
    inputs.clear()
    check_scene(str(written.file))
    assert sum("link l3: " in line and words in line for line in inputs) == 1, inputs
    inputs.clear()
    check_scene(str(scene_of(tmp_path, text, trust_inertias=True).file))
    check_scene(str(scene_of(tmp_path, text, replace_inertias=True).file))
    assert not any("link l" in line for line in inputs), inputs


def test_bodies_of_many_kinds_pass(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Mixtures of points within the box have its bounds; a plate has equality in the triangle."""
    inputs: list[str] = []
    monkeypatch.setattr(warning, "issued", inputs)
    rng = np.random.default_rng(5)
    for _ in some(range(10), 3):
        bodies = []
        for _ in range(4):
            p = (rng.random((60, 3)) - 0.5) * SIZE
            p[:, rng.integers(3)] *= rng.choice([0.0, 1.0])  # flat
            p -= p.mean(axis=0)
            tensor = (2.4 / 60) * sum(float(x @ x) * np.eye(3) - np.outer(x, x) for x in p)
            bodies.append((2.4, np.array([[float(f"{v:.3g}") for v in row] for row in tensor])))
        scene_of(tmp_path, arm(bodies))
    assert not any("link l" in line for line in inputs), inputs


def test_a_link_is_judged_with_all_that_is_fixed_to_it(tmp_path: Path) -> None:
    """A camera with a figure for its inertia does not make its link impossible."""
    robot = ET.fromstring(arm([good(), good()]))
    camera = ET.fromstring(arm([(0.01, np.diag([1e-5, 1e-5, 1e-4]))])).findall("link")[1]
    camera.set("name", "camera")
    robot.append(camera)
    joint = ET.SubElement(robot, "joint", name="camera", type="fixed")
    ET.SubElement(joint, "parent", link="l2")
    ET.SubElement(joint, "child", link="camera")
    assert scene_of(tmp_path, ET.tostring(robot, encoding="unicode")).file.exists()


def test_a_scene_with_an_impossible_link_is_refused_unless_it_trusts_it(tmp_path: Path) -> None:
    mass, tensor, _ = IMPOSSIBLE["triangle"]
    written = scene_of(tmp_path, arm([good(), (mass, tensor)]), trust_inertias=True)
    assert load_scene(written.file).trusted_inertias == ("l2",)
    check_scene(str(written.file))
    text = written.file.read_text()
    written.file.write_text(
        text.replace("trusted_inertias:", "assumed: []\n#").replace("  - l2", "")
    )
    with pytest.raises(Refusal, match=r"boxes.yaml: inertia of link l2 must be a body's"):
        check_scene(str(written.file))
    with pytest.raises(Refusal, match="without --replace-inertias"):
        scene_of(tmp_path, arm([good()]), trust_inertias=True, replace_inertias=True)


@pytest.mark.parametrize(
    "name", ["three_axis", "ur5", "panda", "manutec_r3", "kuka_kr300", "so_arm100"]
)
def test_shipped_scenes_say_which_inertias_are_not_of_bodies(
    name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    inputs: list[str] = []
    monkeypatch.setattr(warning, "issued", inputs)
    check_scene(name)
    assert not any("link " in line and "kg" in line for line in inputs), inputs
    assert math.isfinite(load_scene(name).servo_period)
