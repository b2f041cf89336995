"""The same in MuJoCo: 200 models, and their rollouts on all cores."""

import copy
import os
from pathlib import Path

import mujoco
import numpy as np
from mujoco import rollout

MODEL = str(Path(__file__).with_name("three_axis_mujoco.xml"))
START, RATIO, PERIOD = np.array([0.0, 0.5, 0.8]), 0.01, 1e-3
PULSE = np.zeros((1000, 3))  # V, a row per control period
PULSE[:500, 1:] = [6.0, 4.0]


def sweep(model, friction, mass):
    models = [copy.copy(model) for _ in mass]
    for mujoco_model, viscous, load in zip(models, friction, mass):
        mujoco_model.dof_damping[mujoco_model.joint("elbow").dofadr] = viscous
        mujoco_model.body_mass[mujoco_model.body("payload").id] = load
        mujoco.mj_setConst(mujoco_model, mujoco.MjData(mujoco_model))
    data = mujoco.MjData(model)
    data.qpos[:] = np.concatenate([START / RATIO, START])
    state = np.empty(mujoco.mj_stateSize(model, mujoco.mjtState.mjSTATE_FULLPHYSICS))
    mujoco.mj_getState(model, data, state, mujoco.mjtState.mjSTATE_FULLPHYSICS)
    steps = round(PERIOD / model.opt.timestep)
    threads = [mujoco.MjData(model) for _ in os.sched_getaffinity(0)]
    states, q = np.tile(state, (len(mass), 1)), np.empty((len(PULSE), len(mass), 3))
    for row in range(0, len(PULSE), 50):  # it keeps the states of all steps
        zoh = np.repeat(PULSE[row : row + 50], steps, axis=0)
        control = np.tile(zoh, (len(mass), 1, 1))
        after, _ = rollout.rollout(models, threads, states, control)
        states = after[:, -1]
        q[row : row + 50] = after[:, steps - 1 :: steps, 4:7].swapaxes(0, 1)
    return q


def drawn(arms):
    rng = np.random.default_rng(1)
    return rng.uniform(0.3, 3.0, arms), rng.uniform(0.0, 3.0, arms)


if __name__ == "__main__":
    friction, mass = drawn(200)
    moved = sweep(mujoco.MjModel.from_xml_path(MODEL), friction, mass)[-1, :, 2] - START[2]
    for name, values in (("friction", friction), ("mass", mass)):
        print(f"correlation with {name}: {np.corrcoef(values, moved)[0, 1]:.3f}")
    print(f"moved {moved.min():.3f} to {moved.max():.3f} rad")
