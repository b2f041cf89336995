"""Computed torque on the three-axis arm: M(q) a + nle of the model, through ideal torque motors."""

import sys

import numpy as np

from arm_emulator import Plant, Recording, load_scene

TORQUE = {"kind": "torque", "rotor_inertia": 1e-6}
scene = load_scene("three_axis", {"joints.*.motor": TORQUE, "joints.*.gear": {"ratio": 0.01}})
plant, ratio, start = Plant(scene), scene.gear_ratios, scene.start
viscous = np.array([joint.friction.viscous for joint in scene.joints])
carried = 1e-6 / ratio**2  # kg m2, of the rotors at the links
Kp, Kd, omega = 400.0, 40.0, np.pi  # 1/s2, 1/s, rad/s
angle, reach = 2.0 * np.pi / np.array([joint.counts_per_turn for joint in scene.joints]), 0.3
q_before, v = start, np.zeros(3)
with Recording(plant, names=("q",)) as run:
    for tick in range(2000):
        t = tick * scene.servo_period
        q = (plant.measured.encoder_counts + 0.5) * angle * ratio
        v = v + 0.2 * ((q - q_before) / scene.servo_period - v)  # an encoder measures no speed
        q_before = q
        q_d = start + reach * (1.0 - np.cos(omega * t)) / 2.0
        v_d, a_d = (
            reach * omega / 2.0 * np.sin(omega * t),
            reach * omega**2 / 2 * np.cos(omega * t),
        )
        a = a_d + Kd * (v_d - v) + Kp * (q_d - q)
        tau = plant.links.inverse_dynamics(q, v, a) + carried * a + viscous * v
        plant.exchange(tau * ratio, tick)
        run.take()
wanted = start + reach * (1.0 - np.cos(omega * run.t[:, None])) / 2.0
print(f"largest error {1e3 * np.abs(run['q'] - wanted).max():.2f} mrad")
if len(sys.argv) > 1:  # a file for the picture
    import matplotlib.pyplot as plt

    plt.plot(run.t, 1e3 * (run["q"] - wanted), label=scene.joint_names)
    plt.xlabel("t [s]"), plt.ylabel("error [mrad]"), plt.legend(), plt.savefig(sys.argv[1])
