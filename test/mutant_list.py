"""Plausible mistakes for `mutants.py`, each with the tests that must notice it."""

from typing import NamedTuple


class Mutant(NamedTuple):
    """One mistake in one file.

    Attributes:
        file: path of the source.
        old: text that stands there once.
        new: text that replaces it.
        tests: arguments of pytest, relative to test/, with blanks between them.
    """

    file: str
    old: str
    new: str
    tests: str


PARTS, MACHINE, MOTION = (
    "arm_emulator/machine/parts",
    "arm_emulator/machine",
    "arm_emulator/motion",
)
CORE_PARTS, MECHANICS, SCHEMES = (
    "arm_emulator/core/parts",
    "arm_emulator/core/mechanics",
    "arm_emulator/core/schemes",
)

MUTANTS = (
    # Declared numbers of parts.
    Mutant(
        f"{PARTS}/motors/dc_motor.py",
        '"L", "H", at_least=0.0, default=0.0,',
        '"L", "H", at_least=0.0, default=1.0,',
        "parts/test_declared_numbers.py motors/test_motors.py",
    ),
    Mutant(
        f"{PARTS}/motors/dc_motor.py",
        '"L", "H", at_least=0.0, default=0.0,',
        '"L", "H", at_least=-5.0, default=0.0,',
        "parts/test_declared_numbers.py",
    ),
    Mutant(
        f"{PARTS}/drive_stages/winding.py",
        "default=0.0039",
        "default=0.0045",
        "parts/test_declared_numbers.py motors/test_winding.py",
    ),
    Mutant(
        f"{PARTS}/drive_stages/winding.py",
        "default=20.0",
        "default=25.0",
        "parts/test_declared_numbers.py motors/test_winding.py",
    ),
    Mutant(
        f"{PARTS}/gears/gear.py",
        "at_most=1e3",
        "at_most=1e1",
        "parts/test_declared_numbers.py parts/test_parts.py",
    ),
    Mutant(
        f"{PARTS}/gears/elastic_gear.py",
        '"N m s/rad"',
        '"N m/rad"',
        "parts/test_declared_numbers.py machine/test_scene.py",
    ),
    Mutant(
        f"{PARTS}/measuring/encoder.py",
        '"bits", at_least=1, at_most=48',
        '"bits", at_least=1, at_most=64',
        "sensors/test_encoders.py",
    ),
    Mutant(
        f"{PARTS}/measuring/encoder.py",
        "ends=(0.0, 0.5)",
        "ends=(0.0, 1.0)",
        "parts/test_declared_numbers.py",
    ),
    Mutant(
        f"{PARTS}/frictions/brake.py",
        '"release_delay",\n        "s",\n        ends=(0.0, 10.0)',
        '"release_delay",\n        "s",\n        ends=(0.0, 1.0)',
        "parts/test_declared_numbers.py",
    ),
    Mutant(
        f"{PARTS}/joint_effects/end_stops.py",
        '"K", "N m/rad", above=0.0',
        '"K", "N m/rad", at_least=0.0',
        "parts/test_declared_numbers.py parts/test_parts.py",
    ),
    Mutant(
        f"{PARTS}/measuring/analog_sensor.py",
        '"gain_error", "1", ends=(-1.0, 1.0)',
        '"gain_error", "1", ends=(-0.1, 0.1)',
        "parts/test_declared_numbers.py sensors/test_sensors.py",
    ),
    Mutant(
        f"{PARTS}/gears/backlash_gear.py",
        '"play", "rad", at_least=0.0',
        '"play", "rad", at_least=-1.0',
        "parts/test_declared_numbers.py",
    ),
    Mutant(
        f"{PARTS}/frictions/friction.py",
        'follows="coulomb",',
        "at_least=0.0,",
        "parts/test_declared_numbers.py parts/test_parts.py",
    ),
    # Scenes, faults, states and rows of a machine.
    Mutant(
        f"{MACHINE}/scene/scene.py",
        "ends=(1e-6, 1.0)",
        "ends=(1e-6, 10.0)",
        "machine/test_scene.py",
    ),
    Mutant(
        f"{MACHINE}/scene/payload.py",
        "xx, yy, zz, xy, xz, yz = entries",
        "xx, yy, zz, xy, yz, xz = entries",
        "mechanics/test_dynamics.py machine/test_scene.py",
    ),
    Mutant(
        "arm_emulator/base/calibration/denavit_hartenberg.py",
        "there.inverse @ link @ compute_screw(2,",
        "there.inverse @ compute_screw(2,",
        "machine/test_calibration.py",
    ),
    Mutant(
        "arm_emulator/core/mechanics/scene.hpp",
        "sy * sp * cr - cy * sr",
        "sy * sp * cr + cy * sr",
        "mechanics/test_varied_places.py",
    ),
    Mutant(
        "arm_emulator/base/urdf/joint_tree.py",
        "for axis in (2, 1, 0)",
        "for axis in (0, 1, 2)",
        "mechanics/test_dynamics.py",
    ),
    Mutant(
        f"{MACHINE}/faults/motors.py",
        '"{x} * (1.0 - {m}) * (1.0 - {m})"',
        '"{x} * (1.0 - {m})"',
        "parts/test_declared_faults.py",
    ),
    Mutant(
        f"{MACHINE}/faults/drive_trains.py",
        '"gear.stiffness", "gear.damping", "gear.cubic_stiffness"',
        '"gear.stiffness", "gear.damping"',
        "parts/test_declared_faults.py",
    ),
    Mutant(
        f"{MACHINE}/plant/plant_state.py",
        '"motor velocity", "rad/s", VELOCITY.most / ratio',
        '"motor velocity", "rad/s", VELOCITY.most * ratio',
        "machine/test_bound.py::test_motors_are_set_within_the_bounds_of_their_links",
    ),
    Mutant(
        f"{MACHINE}/plant/plant_state.py",
        '"q": "m", "v": "m/s"',
        '"q": "m", "v": "rad/s"',
        "bags/test_recorder.py project/test_public_names.py",
    ),
    Mutant(
        f"{MACHINE}/session/record_row.py",
        'rows["t"], rows["tick"] = self.truth.time, self.measurement.tick',
        'rows["t"], rows["tick"] = self.truth.time, self.measurement.answered',
        "bags/test_recorder.py::test_a_row_has_the_time_and_the_tick_of_its_measurement",
    ),
    Mutant(
        f"{MACHINE}/session/pace.py",
        "(tick + 1 - self._first)",
        "(tick - self._first)",
        "ros/test_pace.py",
    ),
    Mutant(
        f"{MACHINE}/plant/external_wrench.py",
        "point = _read_vectors(where, POINT, wrench.point, arms, frame.R) + frame.p",
        "point = _read_vectors(where, POINT, wrench.point, arms, frame.R)",
        "mechanics/test_external_wrench.py",
    ),
    Mutant(
        f"{MACHINE}/varied.py",
        "factor = R[i, k] * R[j, m] + (R[i, m] * R[j, k] if k != m else 0.0)",
        "factor = R[i, k] * R[j, m]",
        "mechanics/test_varied.py mechanics/test_varied_axes.py",
    ),
    Mutant(
        f"{MACHINE}/session/command_buffer.py",
        "        self.pointer.known = 0\n",
        "",
        "machine/test_session.py",
    ),
    # The compiled core.
    Mutant(
        f"{CORE_PARTS}/motors/dc_motor.hpp",
        "if (L == 0.0) i[0] = (V - Kb * wm) / R_circuit();",
        "if (L == 0.0) i[0] = (V + Kb * wm) / R_circuit();",
        "schemes/test_limits.py",
    ),
    Mutant(
        f"{CORE_PARTS}/motors/dc_motor.hpp",
        "return 0.5 * L * i[0] * i[0];",
        "return L * i[0] * i[0];",
        "schemes/test_located.py",
    ),
    Mutant(
        f"{MECHANICS}/drive.hpp",
        "rotor.law.holding_torque(make_link_torques<Rotor>(x, gear.Ng * T, rotor_direction(way)))",
        "rotor.law.holding_torque(make_link_torques<Rotor>(x, T, rotor_direction(way)))",
        "frictions/test_load_friction.py frictions/test_rotor_friction.py",
    ),
    Mutant(
        f"{MECHANICS}/drive.hpp",
        "motor.Mm / (gear.Ng * gear.Ng)",
        "motor.Mm / magnitude(gear.Ng)",
        "schemes/test_schemes.py::test_euler_s_methods_go_by_the_speed_at_the_step_s_begin_or_end",
    ),
    Mutant(
        f"{CORE_PARTS}/frictions/load_friction.hpp",
        "return dry + mu * magnitude(on.of_gear);",
        "return dry + mu * on.of_gear;",
        "frictions/test_load_friction.py",
    ),
    Mutant(
        f"{CORE_PARTS}/frictions/load_friction.hpp",
        "select(on.power_direction > 0.0, q * on.of_gear",
        "select(on.power_direction < 0.0, q * on.of_gear",
        "frictions/test_directed_load_friction.py",
    ),
    Mutant(
        f"{CORE_PARTS}/frictions/rotor_friction.hpp",
        "return same < onward ? same : onward;",
        "return onward;",
        "frictions/test_directed_load_friction.py",
    ),
    Mutant(
        f"{MECHANICS}/coulomb.hpp",
        "return select(sign < 0.0, torques_.Ds[1][j], torques_.Ds[0][j]);",
        "return torques_.Ds[0][j];",
        "frictions/test_directed_load_friction.py",
    ),
    Mutant(
        f"{CORE_PARTS}/measuring/encoder.hpp",
        "(c > disc ? to : to + 1) * per_turn",
        "to * per_turn",
        "sensors/test_encoders.py",
    ),
    Mutant(
        f"{CORE_PARTS}/measuring/encoder.hpp",
        "return turn * per_turn > counts ? turn - 1 : turn;",
        "return turn;",
        "sensors/test_encoders.py",
    ),
    Mutant(
        f"{CORE_PARTS}/measuring/analog_sensor.hpp",
        "__builtin_floor(y / resolution + 0.5)",
        "__builtin_floor(y / resolution)",
        "sensors/test_sensors.py",
    ),
    Mutant(
        f"{MECHANICS}/sensors.hpp",
        "extend(encoder[j].delay), extend(link_encoder[j].delay);",
        "extend(encoder[j].delay);",
        "sensors/test_sensors.py",
    ),
    Mutant(
        f"{MECHANICS}/sensors.hpp",
        "repeats_reading(imu.gyroscope[k].held, of_channel(3 + k), tick)",
        "repeats_reading(imu.gyroscope[k].held, of_channel(k), tick)",
        "sensors/test_sensors.py",
    ),
    Mutant(
        f"{MECHANICS}/sensors.hpp",
        "    if (resets) drifted_ = {};\n",
        "",
        "sensors/test_sensors.py",
    ),
    Mutant(
        f"{MECHANICS}/imu.hpp",
        "Vec3<double>{2.0 * m.omega.y * v[i], -2.0 * m.omega.x * v[i], a[i]}",
        "Vec3<double>{m.omega.y * v[i], -m.omega.x * v[i], a[i]}",
        "sensors/test_imu.py",
    ),
    Mutant(
        f"{CORE_PARTS}/gears/backlash.hpp",
        "return 0.5 * play;",
        "return play;",
        "gears/test_backlash.py",
    ),
    Mutant(
        f"{CORE_PARTS}/gears/hysteresis.hpp",
        "anchors[i] = w - deflection(i, w, anchors);",
        "anchors[i] = w;",
        "gears/test_hysteresis.py",
    ),
    Mutant(
        f"{CORE_PARTS}/joint_effects/gear_temperature.hpp",
        "return power / C;",
        "return power / (2.0 * C);",
        "gears/test_gear_temperature.py",
    ),
    Mutant(
        f"{CORE_PARTS}/bearing.hpp",
        "return 0.5 * K * q * q;",
        "return K * q * q;",
        "parts/test_bearing.py",
    ),
    Mutant(
        "arm_emulator/core/mechanics/scene.hpp",
        "while (joint >= 0 && drive_of<S>(joint) > drive) --joint;",
        "while (joint >= 0 && drive_of<S>(joint) >= drive) --joint;",
        "parts/test_bearing.py",
    ),
    Mutant(
        "arm_emulator/machine/scene/bearings.py",
        "if kind.slides == slides and along > ACROSS:",
        "if kind.slides == slides and along > 1.0:",
        "parts/test_bearing.py",
    ),
    Mutant(
        f"{MECHANICS}/drive.hpp",
        "f[Motor::rise] -= flow;",
        "f[Motor::rise] += flow;",
        "gears/test_gear_temperature.py",
    ),
    Mutant(
        f"{CORE_PARTS}/frictions/brake.hpp",
        "return Law::sliding_torque(w, on) + closed * brake.torque;",
        "return Law::sliding_torque(w, on);",
        "parts/test_brake.py",
    ),
    Mutant(
        "arm_emulator/core/machine/machine.hpp",
        "value_of(S::brake_delays[k][change] / dt) + 0.5)",
        "value_of(S::brake_delays[k][change] / dt))",
        "parts/test_brake.py",
    ),
    Mutant(
        f"{CORE_PARTS}/drive_stages/winding.hpp",
        "f[rise] += resistance(z) * Motor::copper_loss(z);",
        "f[rise] += resistance(z) * Motor::dissipated_power(z);",
        "motors/test_winding.py motors/test_motor_faults.py",
    ),
    Mutant(
        f"{CORE_PARTS}/drive_stages/winding.hpp",
        "winding.beta * (winding.ambient - winding.reference + z[rise])",
        "winding.beta * z[rise]",
        "motors/test_winding.py",
    ),
    Mutant(
        f"{CORE_PARTS}/drive_stages/current_loop.hpp",
        "active ? control.I / control.P * (V - z[1] - E() * wm) : control.I * (u - z[0]);",
        "control.I * (u - z[0]);",
        "motors/test_current_loop.py",
    ),
    Mutant(
        f"{CORE_PARTS}/joint_effects/counterbalance.hpp",
        "return F0 * h / (h + compressing() * (l - l0));",
        "return F0 * h / (h + (l - l0));",
        "parts/test_independent_slides.py",
    ),
    Mutant(
        f"{CORE_PARTS}/motors/pmsm.hpp",
        "(psi + (Ld - Lq) * z[0])",
        "(psi + (Lq - Ld) * z[0])",
        "motors/test_pmsm.py",
    ),
    Mutant(
        f"{SCHEMES}/stored_modes.hpp",
        "if (is_current_ && (is_certain_under(u) || are_modes_unchanged(x, u))) return true;",
        "if (is_current_) return true;",
        "schemes/test_kept_modes.py",
    ),
    Mutant(
        f"{SCHEMES}/stored_modes.hpp",
        "sure &= u[j] == u_[j];",
        "sure &= true;",
        "schemes/test_kept_modes.py",
    ),
    Mutant(
        f"{SCHEMES}/one_thread.hpp",
        "    memo_.invalidate();\n    stepper_.restore(memory);",
        "    stepper_.restore(memory);",
        "schemes/test_kept_modes.py mechanics/test_external_wrench.py",
    ),
    Mutant(
        f"{SCHEMES}/stored_modes.hpp",
        "return !(drive.margin(at, now) < 0.0);",
        "return true;",
        "schemes/test_kept_modes.py",
    ),
    Mutant(
        f"{SCHEMES}/linearly_implicit.hpp",
        "k1.torque[j] -= k1.torque[j] - links.nle[j];",
        "",
        "schemes/test_kept_modes.py",
    ),
    Mutant(
        f"{SCHEMES}/event_location.hpp",
        "      left -= t;\n",
        "      left = h_ - t;\n",
        "schemes/test_located.py",
    ),
    Mutant(
        f"{MECHANICS}/links/links.hpp",
        "  for (int j = 0; j < S::N; ++j) torque[j] += n.carried(j) * a[j];\n",
        "",
        "schemes/test_located.py::test_a_rotor_reverses_with_its_link_on_parabolas",
    ),
    Mutant(
        f"{SCHEMES}/paper.hpp",
        "x.q[j] = fma(h_, x.v[j], x.q[j]);\n      x.v[j] = fma(h_, a[j], x.v[j]);",
        "x.v[j] = fma(h_, a[j], x.v[j]);\n      x.q[j] = fma(h_, x.v[j], x.q[j]);",
        "schemes/test_schemes.py::test_euler_s_methods_go_by_the_speed_at_the_step_s_begin_or_end",
    ),
    Mutant(
        f"{MECHANICS}/coulomb.hpp",
        "return Ds(j, lock_torque_[j]) * (1.0 + kRounding) - magnitude(lock_torque_[j]);",
        "return Dc(j, lock_torque_[j]) * (1.0 + kRounding) - magnitude(lock_torque_[j]);",
        "frictions/test_breakaway.py schemes/test_located.py",
    ),
    Mutant(
        f"{MECHANICS}/links/link_tree.hpp",
        "cross(omega, body.I * omega, body.I * alpha)",
        "body.I * alpha",
        "mechanics/test_dynamics.py",
    ),
    # The servo.
    Mutant(
        "arm_emulator/servo/c/servo.c",
        "(off < 0 ? -off : off) <= HALF * joint->count_angle",
        "(off < 0 ? -off : off) <= joint->count_angle",
        "servo/test_servo.py servo/test_servo_loop.py",
    ),
    Mutant(
        "arm_emulator/servo/c/servo.c",
        "joint->reset_rate * (i_ref - feedforward - state->integral)",
        "joint->reset_rate * (i_ref - state->integral)",
        "servo/test_servo.py",
    ),
    Mutant(
        "arm_emulator/servo/c/servo_clock.h",
        "(silence > dog->hold_after)",
        "(silence >= dog->hold_after)",
        "servo/test_watchdog.py",
    ),
    Mutant(
        "arm_emulator/servo/c/servo_clock.h",
        "holds & (arm->holding == 0)",
        "holds",
        "servo/test_watchdog.py",
    ),
    Mutant(
        "arm_emulator/servo/servo_numbers.py",
        "joint.velocity_gain * ratio**2 / torque_constant",
        "joint.velocity_gain * abs(ratio) / torque_constant",
        "servo/test_servo.py servo/test_servo_loop.py",
    ),
    Mutant(
        "arm_emulator/servo/servo_config.py",
        'if scalars["cut_after"] <= scalars["hold_after"]:',
        'if scalars["cut_after"] < scalars["hold_after"]:',
        "ros/test_servo_parameters.py servo/test_watchdog.py",
    ),
    # Motion control.
    Mutant(
        f"{MOTION}/planner/jacobian_controller.py",
        "(0.5 * e) ** 2 * (1.0 - (s / e) ** 2)",
        "(0.5 * e) ** 2",
        "motion/test_jacobian_controller.py",
    ),
    Mutant(
        f"{MOTION}/model/kinematics.py",
        "            if self.model.parents[joint] > 0:\n                length",
        "            if joint > 0:\n                length",
        "motion/test_kinematics.py",
    ),
    Mutant(
        f"{MOTION}/model/config.py",
        '        1e-3,\n        "largest distance of a tool that has',
        '        1e-2,\n        "largest distance of a tool that has',
        "nodes/test_run_time_parameters.py motion/test_motion_orders.py "
        "motion/test_candidate_paths.py",
    ),
    Mutant(
        f"{MOTION}/executor/jog_goal.py",
        "twist = np.concatenate([R_WL @ twist[:3], R_WL @ twist[3:]])",
        "twist = np.concatenate([R_WL @ twist[:3], twist[3:]])",
        "motion/test_jog.py::test_a_twist_is_along_any_link",
    ),
    Mutant(
        f"{MOTION}/trajectory/tolerances.py",
        "                if value:\n",
        "                if value > 0.0:\n",
        "ros/test_follow_joint_trajectory.py",
    ),
    Mutant(
        f"{MOTION}/trajectory/time_scaling.py",
        "3.0 * original.a * rate * change",
        "original.a * rate * change",
        "motion/test_stopping_on_the_way.py",
    ),
    Mutant(
        f"{MOTION}/cpp/chain.hpp",
        "(2.0 * v[i]) * cross(w, z)",
        "v[i] * cross(w, z)",
        "mechanics/test_arm_tree.py",
    ),
    # Ticks, runs and nodes.
    Mutant(
        "arm_emulator/tick/c/tick.c",
        "if (result == ARM_OK) ++at->tick;",
        "++at->tick;",
        "../packages/test/test_tick.py",
    ),
    Mutant(
        "arm_emulator/tick/c/answers.c",
        "!memcmp(answers->before, command, bytes)",
        "!memcmp(answers->newest, command, bytes)",
        "machine/test_session.py",
    ),
    Mutant(
        "arm_emulator/tick/c/condition.c",
        "  self->held = holds;\n",
        "  self->held |= holds;\n",
        "machine/test_breakpoint.py",
    ),
    Mutant(
        "arm_emulator/tick/c/record_ring.c",
        "return writer->ring->written - taken < writer->capacity;",
        "return writer->ring->written - taken <= writer->capacity;",
        "bags/test_recorder.py",
    ),
    Mutant(
        "packages/arm_emulator_fleet/arm_emulator_fleet/core/fleet_kernels.hpp",
        "if (!mask || mask[k]) fleet->move_to_machine(k), act(fleet->machine[k], k);",
        "fleet->move_to_machine(k), act(fleet->machine[k], k);",
        "../packages/arm_emulator_fleet/test/test_fleet_on_device.py::test_every_call_gives_the_bits_of_lanes",
    ),
    Mutant(
        "packages/arm_emulator_fleet/arm_emulator_fleet/core/fleet_kernels.hpp",
        "arm->machine.set_parameter(static_cast<int>(call.place), call.values[k]);",
        "arm->machine.set_parameter(0, call.values[k]);",
        "../packages/arm_emulator_fleet/test/test_fleet_on_device.py::test_every_call_gives_the_bits_of_lanes",
    ),
    Mutant(
        "packages/arm_emulator_fleet/arm_emulator_fleet/device_core.py",
        "wrench_array.pointer + each * np.arange(len(pushes))",
        "wrench_array.pointer + 0 * np.arange(len(pushes))",
        "../packages/arm_emulator_fleet/test/test_fleet_on_device.py::test_every_call_gives_the_bits_of_lanes",
    ),
    Mutant(
        "packages/arm_emulator_fleet/arm_emulator_fleet/core/servo_group.hpp",
        "fleet.since[row + 1] <= tick",
        "fleet.since[row + 1] < tick",
        "../packages/arm_emulator_fleet/test/test_fleet_follow.py::test_rows_that_state_their_periods_hold_from_these_on",
    ),
    Mutant(
        "packages/arm_emulator_fleet/arm_emulator_fleet/core/advance_to_event.hpp",
        "    state.store();\n",
        "",
        "../packages/arm_emulator_fleet/test/test_event_queue.py",
    ),
    Mutant(
        "packages/arm_emulator_fleet/arm_emulator_fleet/core/fleet.hpp",
        "bool stays_in_lane = has_signals_in_lanes && is_in_lane(k);",
        "bool stays_in_lane = has_signals_in_lanes;",
        "../packages/arm_emulator_fleet/test/test_fleet_step.py::test_an_arm_that_has_diverged_measures_what_a_plant_does",
    ),
    Mutant(
        "arm_emulator/runs/target_table.py",
        "np.diff(t) <= 0.0",
        "np.diff(t) < 0.0",
        "servo/test_target_table.py motion/test_goal.py",
    ),
    Mutant(
        "arm_emulator/runs/servo_step.c",
        "    step->closed[j] = joint->brake;\n",
        "",
        "parts/test_brake.py::test_servos_in_c_and_python_handle_brakes_alike",
    ),
    Mutant(
        "emulator_node/c/answered_ticks.c",
        "  if (tick % ticks->report_ticks) return;\n",
        "  if ((tick + 1) % ticks->report_ticks) return;\n",
        "ros/test_hot_path.py nodes/test_network.py",
    ),
    Mutant(
        "emulator_node/c/motor_commands.c",
        " || (own->machine && own->machine != own->emulator)",
        "",
        "nodes/test_duplicate_nodes.py::test_c_reads_commands_for_this_emulator_alone",
    ),
    Mutant(
        "servo_node/c/answered_states.c",
        " && has_same_target(own))",
        ")",
        "ros/test_hot_path.py nodes/test_sole_publisher.py nodes/test_lockstep.py",
    ),
    Mutant(
        "servo_node/node.py",
        "silence < self._config.cut_after",
        "silence < self._config.hold_after",
        "ros/test_diagnostics.py",
    ),
    Mutant(
        "motion_controller_node/order_topics.py",
        "distinct_times = times if len(set(times)) > 1 else None",
        "distinct_times = times if times else None",
        "ros/test_motion_node.py",
    ),
    # Input.
    Mutant(
        "arm_emulator/base/validation/number.py",
        "return LARGEST if self.at_most is None else float(np.min(self.at_most))",
        "return LARGEST if self.at_most is None else float(np.max(self.at_most))",
        "files/test_number.py machine/test_bound.py",
    ),
    Mutant(
        "arm_emulator/base/validation/bound.py",
        'FORCE = Number.bound_size("force", "N", 1e6)',
        'FORCE = Number.bound_size("force", "N", 1e9)',
        "machine/test_bound.py mechanics/test_external_wrench.py",
    ),
    Mutant(
        "arm_emulator/base/validation/bound.py",
        "np.minimum(LARGEST_COUNT, counts) - 1.0",
        "np.minimum(LARGEST_COUNT, counts)",
        "machine/test_bound.py",
    ),
    Mutant(
        "arm_emulator/base/validation/joint_order.py",
        "array[[self._index[name] for name in names]] = unordered",
        "array = unordered[[self._index[name] for name in names]]",
        "machine/test_session.py machine/test_manners.py nodes/test_lockstep.py",
    ),
    Mutant(
        "arm_emulator/base/expression/formula.py",
        'strict = sign in ("<", ">")',
        'strict = sign == "<"',
        "machine/test_condition.py",
    ),
    Mutant(
        "arm_emulator/base/validation/section.py",
        "            below.refuse_unread_keys()\n",
        "            pass\n",
        "machine/test_scene.py",
    ),
)
