"""The same in MuJoCo: the arms' states in its rollouts, the encoders by hand."""

import os
from pathlib import Path

import gymnasium as gym
import mujoco
import numpy as np
from gymnasium.vector.utils import batch_space
from mujoco import rollout

MODEL = str(Path(__file__).with_name("three_axis_mujoco.xml"))
START, RATIO, PERIOD, COUNT = np.array([0.0, 0.5, 0.8]), 0.01, 1e-3, 2 * np.pi / 1024
FULL, SUPPLY = mujoco.mjtState.mjSTATE_FULLPHYSICS, 48.0  # V


class ReachEnv(gym.vector.VectorEnv):
    """Actions are shares of the supply; observations are what encoders measure, and targets."""

    metadata = {"autoreset_mode": gym.vector.AutoresetMode.NEXT_STEP}

    def __init__(self, model=None, num_envs=64, last=200):
        self.model = model or mujoco.MjModel.from_xml_path(MODEL)
        self.num_envs, self.last = num_envs, last
        self.pool = rollout.Rollout(nthread=len(os.sched_getaffinity(0)))
        self.data = [mujoco.MjData(self.model) for _ in os.sched_getaffinity(0)]
        self.steps = round(PERIOD / self.model.opt.timestep)
        self.state = np.zeros((num_envs, mujoco.mj_stateSize(self.model, FULL)))
        spaces = gym.spaces.Box(-1.0, 1.0, (3,)), gym.spaces.Box(-np.inf, np.inf, (6,))
        self.single_action_space, self.single_observation_space = spaces
        self.action_space, self.observation_space = (batch_space(s, num_envs) for s in spaces)

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.age = np.zeros(self.num_envs, int)
        self.target, self.ended = np.zeros((self.num_envs, 3)), self.age > 0
        return self._begin(~self.ended), {}

    def step(self, actions):
        voltage = np.clip(actions, -1.0, 1.0) * SUPPLY
        control = np.repeat(voltage[:, np.newaxis], self.steps, axis=1)
        states, _ = self.pool.rollout(self.model, self.data, self.state, control)
        self.state = states[:, -1]
        reward = -np.abs(self.state[:, 4:7] - self.target).sum(axis=1)  # judged by the truth
        observation, reward = self._begin(self.ended), np.where(self.ended, 0.0, reward)
        fallen, over = ~np.isfinite(self.state).all(axis=1), self.age >= self.last
        self.ended = fallen | over
        return observation, reward, fallen, over, {}

    def _begin(self, arms):
        at = START + self.np_random.uniform(-0.5, 0.5, (2, self.num_envs, 3))
        self.state[arms] = 0.0
        self.state[arms, 1:7] = np.concatenate([at[0] / RATIO, at[0]], axis=1)[arms]
        self.target[arms], self.age = at[1, arms], np.where(arms, 0, self.age + 1)
        q = (np.floor(self.state[:, 1:4] / COUNT) + 0.5) * COUNT * RATIO
        return np.concatenate([q, self.target], axis=1).astype(np.float32)
