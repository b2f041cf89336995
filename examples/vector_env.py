"""64 arms as a vectorised environment of gymnasium: each shall reach a target of its own."""

import gymnasium as gym
import numpy as np
from gymnasium.vector.utils import batch_space

from arm_emulator import Fleet


class ReachEnv(gym.vector.VectorEnv):
    """Actions are shares of the supply; observations are what encoders measure, and targets."""

    metadata = {"autoreset_mode": gym.vector.AutoresetMode.NEXT_STEP}

    def __init__(self, scene="three_axis", num_envs=64, last=200):
        self.num_envs, self.last, self.fleet = num_envs, last, Fleet(scene, num_envs)
        spaces = gym.spaces.Box(-1.0, 1.0, (3,)), gym.spaces.Box(-np.inf, np.inf, (6,))
        self.single_action_space, self.single_observation_space = spaces
        self.action_space, self.observation_space = (batch_space(s, num_envs) for s in spaces)

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.age = np.zeros(self.num_envs, int)
        self.target, self.ended = np.zeros((self.num_envs, 3)), self.age > 0
        return self._begin(~self.ended), {}

    def step(self, actions):
        self.fleet.exchange(np.clip(actions, -1.0, 1.0) * self.fleet.scene.supply_voltage)
        reward = -np.abs(self.fleet.state.q - self.target).sum(axis=1)  # judged by the truth
        seen, reward = self._begin(self.ended), np.where(self.ended, 0.0, reward)
        fallen, over = self.fleet.faults >= 0, self.age >= self.last
        self.ended = fallen | over
        return seen, reward, fallen, over, {}

    def _begin(self, arms):
        at = self.fleet.scene.start + self.np_random.uniform(-0.5, 0.5, (2, self.num_envs, 3))
        self.fleet.reset(arms, q=at[0])
        self.target[arms], self.age = at[1, arms], np.where(arms, 0, self.age + 1)
        q = (self.fleet.measured.encoder_counts + 0.5) * self.fleet.link_angle_per_count
        return np.concatenate([q, self.target], axis=1).astype(np.float32)
