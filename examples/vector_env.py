"""A vectorised environment in the manner of gymnasium: arms shall reach targets of their own."""

import numpy as np

from arm_emulator import Fleet, load_scene


class ReachEnv:
    """64 arms; actions are shares of the supply, observations what encoders measure and targets."""

    def __init__(self, num_envs=64, last=200):
        self.scene = load_scene("three_axis")
        self.fleet, self.num_envs, self.last = Fleet(self.scene, num_envs), num_envs, last
        self.unit = np.array([2.0 * np.pi / j.counts_per_turn for j in self.scene.joints])

    def reset(self, *, seed=None, options=None):
        self.rng = np.random.default_rng(seed)
        self.target, self.age = np.zeros((self.num_envs, 3)), np.zeros(self.num_envs, int)
        self._begin(np.ones(self.num_envs, bool))
        return self._observe(), {}

    def step(self, actions):
        self.fleet.exchange(np.clip(actions, -1.0, 1.0) * self.scene.supply_voltage)
        self.age += 1
        reward = -np.abs(self.fleet.state.q - self.target).sum(axis=1)  # judged by the truth
        fallen, over = self.fleet.faults >= 0, self.age >= self.last
        self._begin(fallen | over)
        return self._observe(), reward, fallen, over, {}

    def _begin(self, arms):
        self.fleet.reset(arms, q=self.scene.start + self.rng.uniform(-0.2, 0.2, (self.num_envs, 3)))
        goals = self.scene.start + self.rng.uniform(-0.5, 0.5, (self.num_envs, 3))
        self.target[arms], self.age[arms] = goals[arms], 0

    def _observe(self):
        q = self.fleet.measured.encoder_counts * self.unit * self.scene.gear_ratios
        return np.concatenate([q, self.target], axis=1).astype(np.float32)
