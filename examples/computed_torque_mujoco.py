"""The same in MuJoCo: computed torque by mj_inverse."""

from pathlib import Path

import matplotlib.pyplot as plt
import mujoco
import numpy as np

MODEL = str(Path(__file__).with_name("three_axis_torque_mujoco.xml"))
START, RATIO, PERIOD, COUNT = np.array([0.0, 0.5, 0.8]), 0.01, 1e-3, 2 * np.pi / 1024
Kp, Kd, REACH, OMEGA = 400.0, 40.0, 0.3, np.pi  # 1/s2, 1/s, rad, rad/s


def wanted(t):
    s, c = np.sin(OMEGA * t), np.cos(OMEGA * t)
    return START + REACH * (1 - c) / 2, REACH * OMEGA * s / 2, REACH * OMEGA**2 * c / 2


def follow(model, ticks=2000):
    data, inverse = mujoco.MjData(model), mujoco.MjData(model)
    data.qpos[:] = START
    steps, v, q_before = round(PERIOD / model.opt.timestep), 0.0, START
    t, q_true = np.empty(ticks), np.empty((ticks, 3))
    for tick in range(ticks):
        q = (np.floor(data.qpos / RATIO / COUNT) + 0.5) * COUNT * RATIO  # it has no encoder
        v = v + 0.2 * ((q - q_before) / PERIOD - v)
        q_before, (q_d, v_d, a_d) = q, wanted(tick * PERIOD)
        inverse.qpos[:], inverse.qvel[:] = q, v
        inverse.qacc[:] = a_d + Kd * (v_d - v) + Kp * (q_d - q)
        mujoco.mj_inverse(model, inverse)
        data.ctrl[:] = inverse.qfrc_inverse * RATIO
        mujoco.mj_step(model, data, nstep=steps)
        t[tick], q_true[tick] = data.time, data.qpos
    return t, q_true


if __name__ == "__main__":
    t, q = follow(mujoco.MjModel.from_xml_path(MODEL))
    error = 1e3 * (q - wanted(t[:, None])[0])
    print(f"largest error {np.abs(error).max():.2f} mrad")
    plt.plot(t, error, label=("waist", "shoulder", "elbow"))
    plt.xlabel("t [s]"), plt.ylabel("error [mrad]"), plt.legend()
    plt.savefig("computed_torque.png")
