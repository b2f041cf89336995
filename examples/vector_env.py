"""64 arms as a vectorised environment of gymnasium: each shall reach a target of its own."""

import numpy as np
from gymnasium import spaces, vector

from arm_emulator_fleet import Fleet


class ReachEnv(vector.VectorEnv):
    """Actions are shares of the supply; observations are what encoders measure, and targets."""

    metadata = {"autoreset_mode": vector.AutoresetMode.NEXT_STEP}

    def __init__(self, scene="three_axis", num_envs=64, seconds=0.2, ticks=1, spread=(0.5, 2.0)):
        self.num_envs, self.seconds, self.ticks, self.spread = num_envs, seconds, ticks, spread
        self.fleet, self.target = Fleet(scene, num_envs), np.zeros((num_envs, 3))
        s = spaces.Box(-1.0, 1.0, (3,)), spaces.Box(-np.inf, np.inf, (6,))
        self.single_action_space, self.single_observation_space = s
        self.action_space, self.observation_space = map(vector.utils.batch_space, s, [num_envs] * 2)

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        return self._begin(np.ones(self.num_envs, bool)), {}

    def step(self, actions):
        ended, supply = self.fallen | self.over, self.fleet.scene.supply_voltage
        self.fleet.step(supply * np.clip(actions, -1.0, 1.0), self.ticks, out=self.frame)
        reward = -np.abs(self.frame.q - self.target).sum(axis=1)  # judged by the truth
        return self._begin(ended), np.where(ended, 0.0, reward), self.fallen, self.over, {}

    def _begin(self, arms):  # with what the scene lists as varied drawn for each
        if many := int(arms.sum()):
            draw, scene = self.np_random.uniform, self.fleet.scene
            start, self.target[arms] = scene.start + draw(-0.5, 0.5, (2, many, 3))
            own = {v.name: v.value * draw(*self.spread, many) for v in scene.varied}
            self.fleet.reset(arms, q=start, varied=own)
            self.frame = self.fleet.step(np.zeros(3), 0, out=vars(self).get("frame"))
        self.fallen, self.over = self.frame.faults >= 0, self.frame.t > self.seconds - 1e-9
        q = (self.frame.measured.encoder_counts + 0.5) * self.fleet.link_angle_per_count
        return np.concatenate([q, self.target], axis=1, dtype=np.float32)
