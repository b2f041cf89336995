"""A policy that brings a UR5 to its targets by its drives' currents, whatever friction it has.

Augmented random search: Mania, Guy, Recht, Simple random search of static linear policies is
competitive for reinforcement learning, NeurIPS 2018. Each arm tries a policy of its own, on a card
by ``python examples/train_reach.py --device gpu --library torch --arms 65536``.
"""

import argparse
import importlib
import sys

import matplotlib.pyplot as plt
import numpy as np
from rich.progress import Progress
from vector_env import ReachEnv  # type: ignore[import-not-found]

from arm_emulator import Refusal, load_scene

VARIED = ["joints.*.friction.viscous", "joints.*.friction.coulomb", "payload.mass"]
MACHINE = {"payload": 1.0, "varied": VARIED}
SECONDS, TICKS, SPEED = 0.5, 10, 0.1  # of an episode; servo periods of an action; s, of speeds
RATE, TRIED = 0.3, 0.1  # of the steps; deviation of the weights that arms try


class Search:
    """Weights of features for each action, and how they improve; arrays of `xp` stay in place."""

    def __init__(self, scene, arms=256, device=None, xp=np, seed=1):
        how = {"seconds": SECONDS, "ticks": TICKS, "spread": (0.5, 1.5), "device": device, "xp": xp}
        self.env, self.xp, self.random = (
            ReachEnv(scene, arms, **how),
            xp,
            np.random.default_rng(seed),
        )
        self.N, scene = len(self.env.most), self.env.fleet.scene
        self.action_time, self.episode = TICKS * scene.servo_period, 0
        self.steps = round(SECONDS / self.action_time)
        self.weights = self.put(np.zeros((4 * self.N, self.N)))

    def put(self, values):
        return self.xp.from_dlpack(self.env.fleet.to_device(values))

    def play(self, weights, seed):
        """Return the mean reward of an episode of each arm, by weights of its own or for all."""
        xp, N, total, (observed, _) = self.xp, self.N, 0.0, self.env.reset(seed=seed)
        before = observed
        for _ in range(self.steps):
            now, last = (
                xp.asarray(observation, dtype=xp.float64) for observation in (observed, before)
            )
            q, error, moved = now[:, :N], now[:, N:] - now[:, :N], now[:, :N] - last[:, :N]
            speed = SPEED / self.action_time * moved  # encoders measure none
            features = xp.concatenate([error, speed, xp.sin(q), xp.cos(q)], axis=1)
            before = observed
            observed, reward, _, _, _ = self.env.step((features[:, None] @ weights)[:, 0])
            total = total + reward
        return total / self.steps

    def improve(self):
        """Try weights on both sides of the present ones, and return the mean reward."""
        shape = self.env.num_envs, *self.weights.shape
        tried = self.put(self.random.normal(0.0, TRIED, shape))
        self.episode += 1  # both sides meet the same arms and targets
        more, less = (self.play(self.weights + s * tried, self.episode) for s in (1.0, -1.0))
        mean = 0.5 * (more + less).mean()
        deviation = (0.5 * ((more - mean) ** 2 + (less - mean) ** 2).mean()) ** 0.5
        slope = ((more - less)[:, None, None] * tried).mean(axis=0) / (TRIED * deviation)
        self.weights = self.weights + RATE * slope
        return float(mean)


def main(scene="ur5", device=None, library="numpy", arms=256, rounds=100, picture="reach.png"):
    """Search, draw the learning curve, and return it with the search."""
    search = Search(load_scene(scene, MACHINE), arms, device, importlib.import_module(library))
    curve = []
    with Progress() as progress:
        task = progress.add_task("learning", total=rounds)
        for _ in range(rounds):
            curve.append(search.improve())
            progress.update(task, advance=1, description=f"{-curve[-1]:.3f} rad off")
    plt.plot(curve)
    plt.xlabel("round"), plt.ylabel("mean reward [rad]")
    plt.savefig(picture)
    return search, curve


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    for name, kind in (("scene", str), ("device", str), ("library", str), ("arms", int),
                       ("rounds", int), ("picture", str)):  # fmt: skip
        parser.add_argument(f"--{name}", type=kind, default=argparse.SUPPRESS)
    try:
        search, _ = main(**vars(parser.parse_args()))
    except (Refusal, ImportError) as error:
        sys.exit(f"train_reach: {error}")
    without, learnt = (search.play(w, 0).mean() for w in (0.0 * search.weights, search.weights))
    print(f"off target in the mean, without a policy {-without:.3f} rad, with it {-learnt:.3f} rad")
