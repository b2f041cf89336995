// The machine: motors, gears and links of one scene, integrated over time.
//
// One class: its members share the state that a step changes, hence the length.
#pragma once

#include <cstdint>
#include <type_traits>

#include "machine/brakes.hpp"
#include "machine/checkpoint.hpp"
#include "machine/command_schedule.hpp"
#include "mechanics/energy.hpp"
#include "mechanics/energy_flow.hpp"
#include "mechanics/links/external_work.hpp"
#include "numerics/finite.hpp"
#include "schemes/event_location.hpp"

namespace arm {

template <class S>
class Machine {
 public:
  static constexpr int N = S::N;

  static constexpr bool locates = kLocatesEvents<S>;
  using Method = MethodOf<S, Real>;
  using Stepper = std::conditional_t<locates, EventLocation<S>, Method>;

  using Threads = typename S::template Threads<Stepper>;

  // `core`: of the second thread, if there is one; -1: any.
  // `parameters`: values of the varied numbers.
  Machine(Real dt, int core, const Real* parameters)
      : h_(dt), numbers_(parameters), threads_(dt, core, numbers_) {
    for (int k = 0; k < S::brakes; ++k)
      for (int change = 0; change < 2; ++change)
        delay_[k][change] =
            static_cast<std::int64_t>(value_of(S::brake_delays[k][change] / dt) + 0.5);
  }

  // One step of a state that a lane has, without its neighbours.
  ARM_APART void step_state(State<S>& x, const Real (&u)[Stepper::row],
                            typename Threads::Memory& past) {
    update_tables();
    threads_.restore(past);
    threads_.step(x, u);
    past = threads_.memory();
  }
  // Such a step of which the end y is known, see EventLocation::step_to; `past` is that of y.
  ARM_APART void step_state_to(const State<S>& y, const auto& friction, State<S>& x,
                               const Real (&u)[Stepper::row], typename Threads::Memory& past) {
    update_tables();
    threads_.restore(past);
    threads_.stepper().step_to(y, friction, x, u);
    past = threads_.memory();
  }

  // Schedule all threads as the calling one; false if the system does not permit it.
  bool join_schedule() { return threads_.join_schedule(); }
  // In a forked child: have the threads that the parent has.
  void begin_thread() { threads_.begin_thread(); }

  using Checkpoint = arm::Checkpoint<S, typename Threads::Memory, Stepper::row>;
  using FullState = arm::FullState<S, Checkpoint>;

  Checkpoint make_checkpoint() const {
    Checkpoint checkpoint = {x_, threads_.memory(), balance_, work_, {}, power_, steps_taken_};
    for (int j = 0; j < Stepper::row; ++j) checkpoint.u[j] = applied_[j];
    return checkpoint;
  }
  FullState make_full_state() const { return {make_checkpoint(), checked_, fault_, brakes_}; }
  ARM_ONCE void restore(const FullState& make_full_state) {
    restore_checkpoint(make_full_state.now);
    checked_ = make_full_state.checked;
    fault_ = static_cast<int>(make_full_state.fault);
    brakes_ = make_full_state.brakes;
  }

  // Set a varied number, between two steps. The motion goes on from where it is.
  ARM_ONCE void set_parameter(int k, Real value) {
    change_numbers([&] { numbers_.set(k, value); });
  }
  // Set all varied numbers; the brakes are as they are.
  ARM_ONCE void set_parameters(const Real* values) {
    change_numbers([&] { numbers_.set_all(values); });
  }
  // Set the external wrench on link i, between two steps.
  ARM_ONCE void set_external_wrench(int i, const ExternalWrench<Real>& wrench) {
    count_external_work();
    apply_change([&] { numbers_.set_external_wrench(i, wrench); });
  }

  // Want brake k closed, or open. It follows after its delay, in whole steps.
  void request_brake(int k, bool closed) {
    if (brakes_.is_requested(k) == closed) return;
    brakes_.request(k, closed, is_brake_closed(k), steps_taken_, delay_[k][closed ? 0 : 1]);
    apply_due_brakes();
  }
  bool is_brake_requested(int k) const { return brakes_.is_requested(k); }
  bool is_brake_closed(int k) const { return numbers_.value(S::parameters + k) != 0.0; }
  // Close or open all brakes without delay.
  void set_brakes(bool closed) {
    brakes_.set_all(closed);
    for (int k = 0; k < S::brakes; ++k) set_brake(k, closed);
  }
  // Change the brakes that are due.
  void apply_due_brakes() {
    if (fault_ < 0)
      brakes_.apply_due(steps_taken_, [this](int k, bool closed) { set_brake(k, closed); });
  }
  // Steps until the next brake changes.
  std::int64_t count_steps_to_brakes() const {
    return fault_ < 0 ? brakes_.next_change() - steps_taken_ : Brakes<S>::never;
  }

  Real parameter(int k) const { return numbers_.value(k); }
  const Numbers<S>& numbers() const { return numbers_; }
  // A count that changes whenever the numbers do.
  std::int64_t numbers_version() const { return version_; }

  // Set the state, without a past. Time continues, or starts at 0.
  ARM_ONCE void set_state(const State<S>& at, bool resets_time) {
    x_ = at;
    threads_.reset(x_);
    balance_.reset(numbers_, x_);
    work_.reset(x_);
    fault_ = -1;
    for (Real& u : applied_) u = 0.0;
    power_ = EnergyBalance<S>::largest_power(numbers_, x_, applied_);
    if (resets_time) steps_taken_ = 0;
    checked_ = make_checkpoint();
  }

  // Set the links to (q, v) and the motors to match, at time 0, without current or gear torque.
  void reset(const Real* q, const Real* v) { set_state(make_rest_state(numbers_, q, v), true); }

  // Where the parts of steps are noted.
  void record_segments_in(auto* pieces)
    requires(locates)
  {
    threads_.stepper().record_segments_in(pieces);
  }

  // Take `steps` steps with the commands held, clamped as the drives do. Returns -1, or the joint
  // that went out of bounds: then the state is the last one within, until reset.
  int advance(const Real* command, std::int64_t steps) {
    Real q[N];
    return follow_commands(command, 1, steps, q);
  }

  // Follow `rows` rows of commands. The links' positions after each row go to `q`.
  int follow_commands(const Real* command, std::int64_t rows, std::int64_t steps, Real* q) {
    CommandSchedule schedule({command}, {q}, N, steps);
    if (steps == 0 && fault_ < 0)
      for (std::int64_t row = 0; row < rows; ++row) schedule.finish_row(x_);
    return follow_schedule(schedule, rows * steps);
  }

  // Take the next `count` steps of a schedule.
  using CommandSchedule = arm::CommandSchedule<S, Real, Stepper::row>;
  int follow_schedule(CommandSchedule& schedule, std::int64_t count) {
    if (fault_ >= 0) return fault_;
    update_tables();
    threads_.begin_burst(count, x_);
    while (count > 0) {
      const int due = steps_to_check(steps_taken_);
      int chunk = count < due ? static_cast<int>(count) : due;
      [[maybe_unused]] const std::int64_t to_brakes = count_steps_to_brakes();
      if constexpr (S::brakes > 0)
        if (to_brakes < chunk) chunk = static_cast<int>(to_brakes);
      if (run_steps(schedule, chunk) >= 0) return fault_ = step_to_fault(schedule, chunk);
      count -= chunk;
      if (chunk == due) {
        count_external_work();
        if (balance_.is_due_after(kCheckEvery)) fault_ = balance_.find_violation(numbers_, x_, h_);
        if (fault_ >= 0) {
          restore_checkpoint(checked_);
          return fault_;
        }
        checked_ = make_checkpoint();
      }
      if constexpr (S::brakes > 0) {
        if (to_brakes > chunk) continue;
        threads_.end_burst();
        apply_due_brakes();
        update_tables();
        threads_.begin_burst(count, x_);
      }
    }
    threads_.end_burst();
    return -1;
  }

  // Advance, and add the energy that the joints get and dissipate [J] to `flow`.
  int advance_metered(const Real* command, std::int64_t steps, EnergyFlow<S>& flow) {
    EnergyMeter<S> meter(numbers_);
    Real u[Stepper::row] = {};
    for (int j = 0; j < N; ++j) u[j] = command[j];
    clamp_commands(u);
    if constexpr (locates) threads_.set_meter(&meter);
    int joint = fault_;
    for (; joint < 0 && steps > 0; --steps) {
      State<S> before = x_;
      joint = advance(command, 1);
      if constexpr (!locates)
        if (joint < 0) {
          const Modes<S> modes = Modes<S>::find_at(numbers_, before, u);
          meter.add_part(before, x_, u, modes, h_);
        }
    }
    if constexpr (locates) threads_.set_meter(static_cast<EnergyMeter<S>*>(nullptr));
    flow.add(meter.total, 1.0);
    return joint;
  }

  // Set the motors' further inputs, rows as in arm_command, and return the applied values.
  void set_further_inputs(const Real* rows) {
    numbers_.for_each_drive([&](const auto& drive, int j) {
      auto at = input_of(drive, j, x_, 0.0);
      for (int r = 0; r < S::inputs; ++r)
        if (const int k = S::input[r].of[j]; k >= 0)
          drive.set_further_input(k, at, rows[r * N + j], numbers_.supply());
      store_states(drive, j, 0, at, x_);
    });
    if constexpr (locates) threads_.stepper().invalidate();
    power_ = EnergyBalance<S>::largest_power(numbers_, x_, applied_);
  }
  void applied_inputs(Real* rows) const {
    numbers_.for_each_drive([&](const auto& drive, int j) {
      for (int r = 0; r < S::inputs; ++r) {
        const int k = S::input[r].of[j];
        rows[r * N + j] = k < 0 ? 0.0 : drive.applied_inputs(k, input_of(drive, j, x_, 0.0));
      }
    });
  }
  void currents_d(Real* current) const {
    numbers_.for_each_drive([&](const auto& drive, int j) {
      current[j] = drive.current_d(input_of(drive, j, x_, 0.0));
    });
  }

  // The temperatures of the windings [degC], NaN where none is known, and which are too hot.
  static constexpr bool has_winding_temperature =
      any_drive<S>([](const auto& drive) { return drive.has_winding_temperature; });
  void winding_temperatures(Real* temperature) const {
    numbers_.for_each_drive([&](const auto& drive, int j) {
      temperature[j] = drive.winding_temperature(input_of(drive, j, x_, 0.0));
    });
  }
  // The temperatures of the gears [degC], NaN where none is known.
  void gear_temperatures(Real* temperature) const {
    numbers_.for_each_drive([&](const auto& drive, int j) {
      temperature[j] = drive.gear_temperature(input_of(drive, j, x_, 0.0));
    });
  }
  void find_overheated(bool* hot) const {
    numbers_.for_each_drive([&](const auto& drive, int j) {
      hot[j] = drive.is_overheated(input_of(drive, j, x_, 0.0));
    });
  }

  // Put commands within the bounds of their motors.
  void clamp_commands(Real* u) const { bound_commands(numbers_, x_, u); }

  // Power supplied to and dissipated by each joint now, under these commands [W].
  EnergyFlow<S> measure_powers(const Real* command) const {
    Real u[N];
    for (int j = 0; j < N; ++j) u[j] = command[j];
    clamp_commands(u);
    State<S> at = x_;
    const Modes<S> modes = Modes<S>::find_at(numbers_, at, u);
    return compute_powers(numbers_, at, u, modes);
  }

  // Whether the state of joint j is finite, and one step turns it by so little that the result has
  // a meaning.
  template <class Drive, class X>
  static Mask<X> is_within_bounds(const Drive& drive, int j, const State<S, X>& s, Real h) {
    const auto at = input_of(drive, j, s, X{});
    const X angles[] = {h * at.v, h * drive.gear.Ng * drive.motor_speed(at)};
    Mask<X> sound = is_finite(at.q);
    sound &= is_finite(at.v);
    for (int k = 0; k < drive.states; ++k) sound &= is_finite(at.z[k]);
    for (const X& turn : angles) sound &= (turn <= kLargestTurn) & (turn >= -kLargestTurn);
    return sound;
  }
  // Checks are due after so many steps since the reset.
  static constexpr int kCheckEvery = 16;
  static bool is_check(std::int64_t steps) { return steps % kCheckEvery == 0; }
  static int steps_to_check(std::int64_t steps) {
    return kCheckEvery - static_cast<int>(steps % kCheckEvery);
  }

  std::int64_t steps() const { return steps_taken_; }
  double time() const { return static_cast<double>(steps_taken_) * value_of(h_); }
  int faulty_joint() const { return fault_; }
  const State<S>& state() const { return x_; }

  // Current [A], angle [rad] and speed [rad/s] of each motor.
  void get_motor_signals(Real* current, Real* angle, Real* speed) const {
    numbers_.for_each_drive([&](const auto& drive, int j) {
      const auto at = input_of(drive, j, x_, 0.0);
      current[j] = drive.current(at);
      angle[j] = drive.motor_angle(at);
      speed[j] = drive.motor_speed(at);
    });
  }

  // Accelerations of the joints under what acts on them now [rad/s2].
  void compute_accelerations(Real (&a)[N]) const {
    typename Links<S>::Dynamics links;
    Links<S>::compute_dynamics_apart(numbers_, x_.q, x_.v, links);
    Coulomb<S, Real> coulomb(numbers_);
    const Real none[N] = {};
    Modes<S>(numbers_, x_, none, links).compute_accelerations(x_, none, links, a, coulomb);
  }

  // Torque that each gear puts on its link [N m]; of a rigid gear, the motor's torque less that of
  // its rotor's acceleration. A function of its own: true state and sensors get the same bits.
  ARM_APART void gear_torques(Real* T) const {
    Real a[N] = {};
    if constexpr (any_drive<S>([](const auto& drive) { return drive.carries_rotor; }))
      compute_accelerations(a);
    numbers_.for_each_drive([&](const auto& drive, int j) {
      T[j] = drive.gear_torque(input_of(drive, j, x_, 0.0), a[j]);
    });
  }

  // Kinetic, potential, elastic and magnetic energy of links, gears and motors [J].
  Real energy() const { return compute_energy<S>(numbers_, x_).total(); }

 private:
  // Update the scheme's tables. A machine in a lane needs none.
  void update_tables() {
    if (stale_) threads_.update_tables();
    stale_ = false;
  }

  void set_brake(int k, bool closed) {
    if (is_brake_closed(k) != closed) set_parameter(S::parameters + k, closed ? 1.0 : 0.0);
  }

  // The work of the external wrenches adds to the largest possible energy.
  void count_external_work() {
    if constexpr (S::external_wrench)
      balance_.set_energy_limit(balance_.energy_limit() + work_.add_since(numbers_, x_));
  }

  void change_numbers(auto&& set) {
    apply_change([&] {
      const auto before = numbers_.drives();
      set();
      ++version_;
      // Equal numbers may have other derivatives.
      stale_ = stale_ || kDifferentiates || numbers_.drives() != before;
    });
    balance_.reset(numbers_, x_);
    power_ = EnergyBalance<S>::largest_power(numbers_, x_, applied_);
    checked_ = make_checkpoint();
  }
  // Change the numbers. Torques that the scheme keeps from the last step are recomputed with the
  // new numbers, since the jump is not a motion.
  void apply_change(auto&& set) {
    typename Threads::Memory past = threads_.memory();
    if constexpr (S::Scheme::extrapolates) {
      auto& scheme = scheme_of(past);
      Real before[N], after[N];
      compute_link_torques<S>(numbers_, x_.q, x_.v, scheme.a, before);
      set();
      compute_link_torques<S>(numbers_, x_.q, x_.v, scheme.a, after);
      for (int j = 0; j < N; ++j) scheme.torque[j] += after[j] - before[j];
    } else {
      set();
    }
    threads_.restore(past);
  }
  static auto& scheme_of(typename Threads::Memory& past) {
    if constexpr (requires { past.stepper; })
      return past.stepper;
    else
      return past;
  }

  static constexpr Real kLargestTurn = 3.14159265358979;  // rad (or m) in one step

  // Take `count` steps. Returns -1, or the joint that went out of bounds: then the state is
  // unchanged. Neither inlined nor cloned: every step runs the same instructions and gives the same
  // bits.
  ARM_APART int run_steps(CommandSchedule& schedule, int count) {
    const typename Threads::Memory past = threads_.memory();
    CommandSchedule there = schedule;
    State<S> y = x_;  // local, so that the compiler may keep it in registers
    alignas(64) Real u[Stepper::row];
    for (int j = 0; j < Stepper::row; ++j) u[j] = applied_[j];
    Real most = balance_.energy_limit();
    Real power = is_check(steps_taken_) ? EnergyBalance<S>::largest_power(numbers_, y, u) : power_;
    there.advance_steps(numbers_, threads_, h_, count, y, u, power, most);
    const int joint = find_joint_out_of_bounds(y);
    if (joint >= 0) {
      threads_.end_burst();
      threads_.restore(past);
      return joint;
    }
    schedule = there;
    x_ = y;
    for (int j = 0; j < Stepper::row; ++j) applied_[j] = u[j];
    power_ = power;
    balance_.set_energy_limit(most);
    steps_taken_ += count;
    return -1;
  }

  ARM_ONCE void restore_checkpoint(const Checkpoint& to) {
    threads_.end_burst();
    threads_.restore(to.memory);
    x_ = to.x;
    balance_ = to.balance;
    work_ = to.work;
    for (int j = 0; j < Stepper::row; ++j) applied_[j] = to.u[j];
    power_ = to.power;
    steps_taken_ = to.steps_taken;
  }

  // Repeat a chunk one step at a time, up to the last state within bounds.
  ARM_ONCE int step_to_fault(CommandSchedule& schedule, int chunk) {
    for (int s = 0; s < chunk; ++s) {
      threads_.begin_burst(1, x_);
      const int joint = run_steps(schedule, 1);
      if (joint >= 0) return joint;
      threads_.end_burst();
    }
    __builtin_unreachable();  // the same steps as before end at the same fault
  }

  // The first joint whose state is not finite, or that turns so far in one step that the result
  // means nothing; -1 without such a joint.
  int find_joint_out_of_bounds(const State<S>& s) const {
    int result = -1;
    for_each_drive<S>([&](const auto& drive, int j) {
      if (result < 0 && !is_within_bounds(drive, j, s, h_)) result = j;
    });
    return result;
  }

  Real h_;
  Numbers<S> numbers_;
  Threads threads_;
  State<S> x_ = {};
  EnergyBalance<S> balance_;
  ExternalWork<S> work_;
  Brakes<S> brakes_;
  std::int64_t delay_[S::brakes + 1][2] = {};  // of brakes, in steps: to close, to open
  Real applied_[Stepper::row] = {};
  Real power_ = 0.0;
  std::int64_t steps_taken_ = 0;
  std::int64_t version_ = 0;
  bool stale_ = false;  // the scheme's tables are older than the drives
  int fault_ = -1;      // the joint that went out of bounds
  Checkpoint checked_ = {};
};

}  // namespace arm
