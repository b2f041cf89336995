"""MPPI on an arm: its commands are means of many rollouts from its state, weighed by their costs.

Williams, Aldrich, Theodorou, Model Predictive Path Integral Control, J. Guidance, Control, and
Dynamics 40 (2), 2017. On a card: ``python examples/mppi.py --device gpu --rollouts 10000``.
"""

import argparse
import importlib
import sys
import time

import numpy as np
from rich.progress import track

from arm_emulator import Refusal
from arm_emulator_fleet import Fleet

HORIZON, HELD, DECISION = 25, 5, 0.02  # decisions of a rollout, and under the same noise; s
TEMPERATURE, SPREAD = 0.01, 0.03  # lambda, of costs; sigma, of commands as shares of the largest
SLOW = 0.05  # cost of 1 rad/s, beside that of 1 rad from the target


class Mppi:
    """Decides for one arm by rollouts from its state; arrays of `xp` stay on the device."""

    def __init__(self, scene, target, rollouts, device=None, xp=np, seed=1):
        self.fleet, self.xp = Fleet(scene, rollouts, device=device), xp
        self.frame, self.random = self.fleet.frame(), np.random.default_rng(seed)
        self.periods = round(DECISION / self.fleet.scene.servo_period)
        noise = self.random.normal(0.0, SPREAD, (HORIZON // HELD, rollouts, len(target)))
        plan = np.zeros((HORIZON, len(target)))
        values = self.fleet.scene.largest_commands, target, noise, plan
        self.most, self.target, self.noise, self.plan = map(self._put, values)

    def _put(self, values):
        return self.xp.from_dlpack(self.fleet.to_device(values))

    def decide(self, arm):
        """Return the command of an arm, a fleet of one, for the coming decision (1, N)."""
        self.fleet.copy_state(0, of=arm)
        # Each decision combines the numbers that were drawn anew, without random ones of the host.
        shifts = self.random.integers(len(self.fleet), size=HORIZON // HELD)
        cost, shares = self._put(np.zeros(len(self.fleet))), []
        for k, mean in enumerate(self.plan):
            noise = self.xp.roll(self.noise[k // HELD], int(shifts[k // HELD]), 0)
            share = self.xp.clip(mean + noise, -1.0, 1.0)
            self.fleet.step(self.most * share, self.periods, out=self.frame)
            q, v = map(self.xp.from_dlpack, (self.frame.q, self.frame.v))
            cost = cost + (self.xp.abs(q - self.target) + SLOW * self.xp.abs(v)).sum(axis=1)
            cost = cost + TEMPERATURE / SPREAD**2 * (mean * share).sum(axis=1)
            shares.append(share)
        weight = self.xp.exp((cost.min() - cost) / TEMPERATURE)
        plan = (weight[:, None] * self.xp.stack(shares)).sum(axis=1) / weight.sum()
        self.plan = self.xp.concatenate([plan[1:], plan[-1:]])
        return self.most * plan[:1]


def main(scene="three_axis", device=None, library="numpy", rollouts=256, seconds=2.0):
    """Bring an arm to a target; return distances after each decision, and the decisions' times."""
    arm, xp = Fleet(scene, 1, device=device), importlib.import_module(library)
    target = arm.scene.start + 0.4
    mppi, frame, off, times = Mppi(scene, target, rollouts, device, xp), arm.frame(), [], []
    for _ in track(range(round(seconds / DECISION)), "decisions"):
        began = time.perf_counter()
        command = mppi.decide(arm)
        arm.step(command, mppi.periods, out=frame)
        off.append(np.abs(np.asarray(frame.q) - target).max())  # waits for the device
        times.append(time.perf_counter() - began)
    return np.array(off), np.array(times)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    for name, kind in (("scene", str), ("device", str), ("library", str), ("rollouts", int)):
        parser.add_argument(f"--{name}", type=kind, default=argparse.SUPPRESS)
    try:
        off, times = main(**vars(parser.parse_args()))
    except (Refusal, ImportError) as error:
        sys.exit(f"mppi: {error}")
    print(f"at the end {off[-1]:.4f} rad off; a decision takes {1e3 * np.median(times):.1f} ms")
