"""Trees of links: the core against Pinocchio, and what rests on it for several branches."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from draws import some
from machines import GRAVITY, Oracle, random_tree

from arm_emulator.machine.plant import Plant

STATES = 200
# Both sides lose about cond(M) units of the last place, and cond(M) < 1e5 here.
TOLERANCE = 1e-10

# Seed and joints: chosen so that all fork, five on the base as well as farther out. 14 and 30 lie
# beyond limits of unrolling.
TREES = [(1, 5), (2, 12), (3, 3), (4, 7), (5, 14), (6, 9), (7, 26)]


def relative(got: np.ndarray, expected: np.ndarray) -> float:
    return float(np.linalg.norm(got - expected) / np.linalg.norm(expected))


@pytest.mark.parametrize(("seed", "joints"), some(TREES, 1))
def test_random_trees_equal_pinocchio(tmp_path: Path, seed: int, joints: int) -> None:
    """M, nle, accelerations and energy; revolute and prismatic joints about any axis."""
    scene = random_tree(tmp_path, seed, joints, gravity=GRAVITY)
    assert scene.chain.forks, "the draw is a chain"
    plant, oracle, rng = Plant(scene), Oracle(scene), np.random.default_rng(seed)
    q, v, tau = rng.normal(size=(3, STATES, joints)) * np.array([2.0, 3.0, 30.0])[:, None, None]
    M, nle = plant.links.mass_matrix(q), plant.links.nle(q, v)
    a = plant.links.accelerations(q, v, tau)
    for k in range(STATES):
        assert relative(M[k], oracle.mass_matrix(q[k])) < TOLERANCE, "mass matrix"
        assert relative(nle[k], oracle.nle(q[k], v[k])) < TOLERANCE, "nonlinear effects"
        assert relative(a[k], oracle.aba(q[k], v[k], tau[k])) < TOLERANCE, "accelerations"
    apart = np.array(
        [[i not in scene.chain.way_to(j) and j not in scene.chain.way_to(i)
          for j in range(joints)] for i in range(joints)]
    )  # fmt: skip
    assert (M[:, apart] == 0.0).all(), "joints of different branches do not feel each other"
    plant.reset(q[0], v[0])
    # The same few hundred operations in another order.
    assert plant.energy == pytest.approx(oracle.energy(q[0], v[0]), rel=1e-12), "energy [J]"
