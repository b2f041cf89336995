"""End stops: impacts of one link in closed form, of a driven arm by their energy."""

import dataclasses
import math
import xml.etree.ElementTree as ET
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from draws import some
from machines import LINK_INERTIA, MOTOR, make_link_urdf, write_scene

from arm_emulator import Plant, Refusal, Scene, load_scene

PERIOD = 1e-3  # s
STOPS = {"lower": -0.4, "upper": 0.5, "stiffness": 5e3, "damping": 5.0}


def free_link(folder: Path, events: str) -> Path:
    """A link without a motor between its stops, all numbers of which may be set."""
    return write_scene(
        folder, make_link_urdf(), {"joint": {"end_stops": STOPS}}, varied=["joints.*"],
        energy_flow=True, servo_period=PERIOD,
        integrator={"scheme": "rosenbrock", "dt": PERIOD / 5, "events": events},
    )  # fmt: skip


class Impact:
    """A link of one inertia that hits a stop at v0: the motion until it leaves it for good."""

    def __init__(self, K: float, D: float, v0: float) -> None:
        w, self.d = math.sqrt(K / LINK_INERTIA), D / (2.0 * LINK_INERTIA)
        self.W, self.v0 = math.sqrt(w**2 - self.d**2), v0
        # Until the torque vanishes, with the link still inside.
        lag = math.atan2(2.0 * self.d * self.W, self.W**2 - self.d**2)
        self.ends = (math.pi - lag) / self.W
        self.leaves = -v0 * math.exp(-self.d * self.ends)

    def depth(self, t: float) -> float:
        if t > self.ends:
            return self.depth(self.ends) + self.leaves * (t - self.ends)
        return self.v0 / self.W * math.exp(-self.d * t) * math.sin(self.W * t)


def sample_stops(rng: np.random.Generator) -> tuple[dict[str, float], float, float]:
    K = float(10 ** rng.uniform(2.5, 4.5))
    largest = 2.0 * math.sqrt(K * LINK_INERTIA)
    D = float(rng.choice([0.0, rng.uniform(0.02, 0.8) * largest]))
    stops = {"lower": float(rng.uniform(-1.0, -0.2)), "upper": float(rng.uniform(0.2, 1.0)),
             "stiffness": K, "damping": D}  # fmt: skip
    return stops, float(rng.choice([-1.0, 1.0])), float(rng.uniform(0.5, 5.0))


@pytest.mark.parametrize(("events", "order"), some([("located", 2.0), ("step", 1.0)], 1))
def test_a_link_rebounds_as_in_closed_form(tmp_path: Path, events: str, order: float) -> None:
    """Way and speed during and after the hit, and what the damper has taken."""
    rng = np.random.default_rng(1)
    file = free_link(tmp_path, events)
    for _ in range(6):
        stops, side, v0 = sample_stops(rng)
        hit = Impact(stops["stiffness"], stops["damping"], v0)
        end = stops["upper" if side > 0 else "lower"]
        before = float(rng.uniform(0.5, 1.5)) * hit.ends  # from the start to the hit
        rows = 20
        t = np.arange(1, rows + 1) * (before + 1.6 * hit.ends) / rows
        truth = end + side * np.array(
            [hit.depth(at - before) if at > before else v0 * (at - before) for at in t]
        )
        errors, left = [], []
        for steps in (10, 20, 40, 80):
            dt = float(round(t[0] / steps, 12))
            plant = Plant(with_step(load_scene(file), dt))
            for key, value in stops.items():
                plant.set_parameter(f"joints.joint.end_stops.{key}", value)
            plant.reset([end - side * v0 * before], [side * v0])
            q, lost = [], 0.0
            for _ in range(rows):
                flow = plant.advance_metered([0.0], steps)
                lost += float(flow.dissipated[0] - flow.supplied[0])
                q.append(plant.state.q[0])
            errors.append(float(np.abs(np.array(q) - truth).max()) / (v0 * hit.ends))
            kinetic = 0.5 * LINK_INERTIA * v0**2
            left.append(abs(plant.energy + lost - kinetic) / kinetic)
        last = side * plant.state.v[0]
        scale = 1.0 if events == "step" else 0.05
        assert last == pytest.approx(hit.leaves, rel=0.1 * scale, abs=0.02 * scale * v0), stops
        # By chance, of where in a step the hit falls, a step may be better than its order.
        mean = math.log2(errors[0] / errors[-1]) / 3.0
        assert mean > order - (0.25 if events == "located" else 0.6), (errors, stops)
        assert errors[-1] < (2e-3 if events == "located" else 3e-2), (errors, stops)
        assert left[-1] < (2e-3 if events == "located" else 5e-2), (left, stops)


def with_step(scene: Scene, dt: float) -> Scene:
    return dataclasses.replace(
        scene, servo_period=dt, integrator=dataclasses.replace(scene.integrator, dt=dt)
    )


def stopped_arm(folder: Path, **stops: Any) -> Path:
    joint = {
        "motor": MOTOR | {"current_limit": 20.0},
        "gear": {"ratio": 0.02, "stiffness": 4e3, "damping": 4.0},
        "end_stops": STOPS | stops,
    }
    return write_scene(
        folder, make_link_urdf(), {"joint": joint}, gravity=[0.0, 0.0, -9.81], energy_flow=True,
        servo_period=PERIOD, integrator={"scheme": "rosenbrock", "dt": PERIOD / 5},
    )  # fmt: skip


@pytest.mark.slow
def test_a_hit_at_full_speed_is_accounted_for(tmp_path: Path) -> None:
    """At full voltage from one stop into the other, at each of several steps."""
    file = stopped_arm(tmp_path)
    left, fastest, deepest = [], 0.0, 0.0
    for steps in (5, 10, 20):
        scene = load_scene(file, {"integrator.dt": PERIOD / steps})
        plant, flow, inputs = Plant(scene), 0.0, 0.0
        before = plant.energy
        for k in range(600):
            metered = plant.advance_metered([48.0 if k // 150 % 2 == 0 else -48.0], steps)
            flow += float((metered.supplied - metered.dissipated).sum())
            inputs += float(np.abs(metered.supplied).sum())
            fastest = max(fastest, abs(plant.state.v[0]))
            deepest = max(deepest, plant.state.q[0] - STOPS["upper"])
        left.append(abs(plant.energy - before - flow) / inputs)
    assert fastest > 3.0 and deepest > 0.01, f"{fastest} rad/s, {deepest} rad deep"
    assert left[-1] < 2e-3 and left[-1] < left[0], left
    # At rest in the stop, pressed in by the motor: K u is what the gear gives, less the weight.
    plant.advance([48.0], 5000 * 20)
    x = plant.state
    u = x.q[0] - STOPS["upper"]
    weight = 2.0 * 0.3 * 9.81 * math.cos(x.q[0])  # turns it up, see one_link_urdf
    assert abs(x.v[0]) < 1e-6 and u > 0.0, "at rest in the stop"
    assert STOPS["stiffness"] * u == pytest.approx(x.gear_torque[0] + weight, rel=1e-6), "torques"


@pytest.mark.parametrize("beyond", [0.0, 0.02])
def test_stops_stand_at_the_limits_of_the_urdf_on_request(beyond: float) -> None:
    K = {"stiffness": 1e4}
    stops = {"joints.*.end_stops": {"at": "limits", **K} | ({"beyond": beyond} if beyond else {})}
    for joint in load_scene("ur5", stops).joints:
        (stop,) = joint.extras
        name = joint.name
        robot = ET.fromstring(load_scene("ur5").urdf)
        limit = next(j for j in robot.findall("joint") if j.get("name") == name).find("limit")
        assert limit is not None
        assert (stop.lower, stop.upper) == (  # type: ignore[attr-defined]
            float(limit.get("lower", "")) - beyond, float(limit.get("upper", "")) + beyond
        ), name  # fmt: skip
    with pytest.raises(Refusal, match=r"elbow\.end_stops\.at must be absent: the URDF has no"):
        load_scene("three_axis", {"joints.elbow.end_stops": {"at": "limits", **K}})
    for bad in ("ends", None, 3, True, ["limits"]):
        with pytest.raises(Refusal, match=r"end_stops\.at must be one of the known"):
            load_scene("ur5", {"joints.elbow_joint.end_stops": K | {"at": bad}})
    for key in ("lower", "upper"):
        with pytest.raises(Refusal, match=rf"end_stops\.{key} must be absent together with"):
            load_scene("ur5", {"joints.elbow_joint.end_stops": K | {"at": "limits", key: 0.1}})
    with pytest.raises(Refusal, match=r"end_stops\.beyond must be a number from 0 to"):
        load_scene("ur5", {"joints.elbow_joint.end_stops": K | {"at": "limits", "beyond": -0.1}})
    with pytest.raises(Refusal, match=r"end_stops\.beyond"):
        load_scene("ur5", {"joints.elbow_joint.end_stops": STOPS | {"beyond": 0.1}})
    with pytest.raises(Refusal, match=r"upper must be > 0\.5 rad, the lower one"):
        load_scene("three_axis", {"joints.elbow.end_stops": STOPS | {"lower": 0.5}})
