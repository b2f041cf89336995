"""Computed torque on the three-axis arm: M(q) a + nle of the model, through ideal torque motors."""

import matplotlib.pyplot as plt
import numpy as np

from arm_emulator import Plant, Recording, load_scene

MOTOR = {"kind": "torque", "rotor_inertia": 1e-6}  # with the gear 0.01 kg m2 at the link
MACHINE = {"joints.*.motor": MOTOR, "joints.*.gear": {"ratio": 0.01}}
CARRIED, VISCOUS = 0.01, 0.5  # kg m2, N m s/rad
Kp, Kd, REACH, OMEGA = 400.0, 40.0, 0.3, np.pi  # 1/s2, 1/s, rad, rad/s


def wanted(t, start):
    s, c = np.sin(OMEGA * t), np.cos(OMEGA * t)
    return start + REACH * (1 - c) / 2, REACH * OMEGA * s / 2, REACH * OMEGA**2 * c / 2


def follow(scene, ticks=2000):
    plant, v, q_before = Plant(scene), np.zeros(3), scene.start
    run = Recording(plant, names=("q",))
    for tick in range(ticks):
        q = (plant.measured.encoder_counts + 0.5) * plant.link_angle_per_count
        v = v + 0.2 * ((q - q_before) / scene.servo_period - v)  # an encoder measures no speed
        q_before, (q_d, v_d, a_d) = q, wanted(tick * scene.servo_period, scene.start)
        a = a_d + Kd * (v_d - v) + Kp * (q_d - q)
        tau = plant.links.inverse_dynamics(q, v, a) + CARRIED * a + VISCOUS * v
        plant.exchange(tau * scene.gear_ratios)
        run.take()
    return run.t, run["q"]


if __name__ == "__main__":
    t, q = follow(scene := load_scene("three_axis", MACHINE))
    error = 1e3 * (q - wanted(t[:, None], scene.start)[0])
    print(f"largest error {np.abs(error).max():.2f} mrad")
    plt.plot(t, error, label=scene.joint_names)
    plt.xlabel("t [s]"), plt.ylabel("error [mrad]"), plt.legend()
    plt.savefig("computed_torque.png")
