"""Arms as a vectorised environment of gymnasium, on a card too: each shall reach its target."""

import numpy as np
from gymnasium import spaces, vector

from arm_emulator_fleet import Fleet


class ReachEnv(vector.VectorEnv):
    """Its arrays are of `xp`: numpy, or on a card torch or cupy."""

    metadata = {"autoreset_mode": vector.AutoresetMode.NEXT_STEP}

    def __init__(self, scene="three_axis", num_envs=64, seconds=0.2, ticks=1, spread=(0.5, 2.0),
                 device=None, xp=np):  # fmt: skip
        self.num_envs, self.ticks, self.spread, self.xp = num_envs, ticks, spread, xp
        self.fleet = Fleet(scene, num_envs, device=device)
        self.frame, scene, N = self.fleet.frame(), self.fleet.scene, len(self.fleet.scene.joints)
        angle, seconds = self.fleet.link_angle_per_count, np.subtract(seconds, 1e-9)
        numbers = seconds, scene.largest_commands, scene.start, angle
        self.seconds, self.most, self.center, self.angle = map(self._put, numbers)
        s = spaces.Box(-1.0, 1.0, (N,)), spaces.Box(-np.inf, np.inf, (2 * N,))
        self.single_action_space, self.single_observation_space = s
        self.action_space, self.observation_space = map(vector.utils.batch_space, s, [num_envs] * 2)

    def _put(self, values):
        return self.xp.from_dlpack(self.fleet.to_device(values))

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)  # each episode's draws lie a drawn stride beyond those before it
        shape = 2, self.num_envs, 2 * len(self.most) + len(self.fleet.scene.varied)
        self.draws, self.stride = map(self._put, self.np_random.uniform(size=shape))
        return self._begin(self.draws[:, 0] >= 0.0), {}

    def step(self, actions):  # shares of the largest commands
        command, ended = self.most * self.xp.clip(actions, -1.0, 1.0), self.fallen | self.over
        self.fleet.step(command, self.ticks, out=self.frame)
        error = self.xp.abs(self.xp.from_dlpack(self.frame.q) - self.target).sum(axis=1)
        observed = self._begin(ended) if ended.any() else self._observe()
        return observed, self.xp.where(ended, 0.0, -error), self.fallen, self.over, {}

    def _begin(self, arms):  # with what the scene lists as varied drawn for each
        self.draws = self.xp.where(arms[:, None], (self.draws + self.stride) % 1.0, self.draws)
        N, (low, high), varied = len(self.most), self.spread, self.fleet.scene.varied
        start, self.target = (self.center + self.draws[:, k : k + N] - 0.5 for k in (0, N))
        share = low + (high - low) * self.draws[:, 2 * N :]
        own = {v.name: v.value * share[:, k] for k, v in enumerate(varied)}
        self.fleet.reset(arms, q=start, varied=own)
        self.fleet.step(0.0 * start, 0, out=self.frame)
        return self._observe()

    def _observe(self):  # encoders' angles, and targets
        faults, t = map(self.xp.from_dlpack, (self.frame.faults, self.frame.t))
        self.fallen, self.over = faults >= 0, t > self.seconds
        q = (self.xp.from_dlpack(self.frame.measured.encoder_counts) + 0.5) * self.angle
        return self.xp.asarray(self.xp.concatenate([q, self.target], axis=1), dtype=self.xp.float32)
