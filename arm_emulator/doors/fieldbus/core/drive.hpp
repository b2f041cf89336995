// One CiA 402 drive: its dictionary, its state machine, and what its motor gets in a servo period.
//
// A bus reads and writes between two periods. In `begin_period` the drive takes the controlword and
// its targets, in `end_period` what was measured. Its inner loops are those of
// arm_emulator/servo/c/servo.h.
//
// Inside, positions are counts of the encoder since the machine began, those of the dictionary are
// less by `shift_`, which homing sets.
#pragma once

#include "cia402.hpp"
#include "drives.h"
#include "homing.hpp"
#include "interpolation.hpp"
#include "profile.hpp"
#include "touch_probe.hpp"
#include "units.hpp"
#include "values.hpp"

namespace fieldbus {

class Drive {
 public:
  // `joint` must outlive the drive, and the drive its place.
  Drive(const drives_joint& joint, const drives_machine& machine, int number)
      : joint_(joint),
        units_(joint.servo),
        dt_(1e-9 * static_cast<double>(machine.period)),
        supply_(machine.supply_voltage),
        number_(number),
        values_(static_cast<Bus>(machine.bus)) {
    values_.set_text(0x1008, machine.device_name);
    values_.set_text(0x1009, "1.0");
    values_.set_text(0x100A, "1.0");
    set_standard();
  }
  Drive(const Drive&) = delete;
  Drive& operator=(const Drive&) = delete;

  const Values& values() const { return values_; }
  const StateMachine& machine() const { return machine_; }
  // Periods in the interpolation time 0x60C2, one at least.
  int periods_per_target() const {
    static constexpr double kTen[] = {1.0, 0.1, 0.01, 1e-3, 1e-4, 1e-5, 1e-6};
    const double time =
        static_cast<double>(values_.get<0x60C2, 1>()) * kTen[-values_.get<0x60C2, 2>()];
    const double periods = std::floor(time / dt_ + 0.5);
    return periods < 1.0 ? 1 : periods > 1e9 ? 1000000000 : static_cast<int>(periods);
  }

  // ------------------------------------------------------------------------------- dictionary

  // Read or write an entry: 0, or the abort code of an SDO server; a refused access changes
  // nothing.
  std::uint32_t read(std::uint16_t index, std::uint8_t sub, std::span<std::byte> out,
                     std::size_t& size) const {
    return values_.read(index, sub, out, size);
  }
  std::uint32_t write(std::uint16_t index, std::uint8_t sub, std::span<const std::byte> in) {
    int slot = -1;
    std::int64_t value = 0;
    const std::uint32_t abort = values_.check(index, sub, in, slot, value);
    return abort ? abort : take(slot, value);
  }
  // Set an entry that belongs to the bus, whatever its access; false: there is none.
  bool set(std::uint16_t index, std::uint8_t sub, std::int64_t value) {
    const int slot = values_.find(index, sub);
    if (slot >= 0) values_.set_at(slot, value);
    return slot >= 0;
  }

  // Process data. What is mapped is in values().mapping(...), values().process_data(...).
  void read_mapped(const Mapped& one, std::byte* out) const {
    if (one.slot < 0)
      std::memset(out, 0, static_cast<std::size_t>(one.bits) / 8);
    else
      std::memcpy(out, values_.place(one.slot), static_cast<std::size_t>(one.bits) / 8);
  }
  // A value out of its range is not taken; its abort code is returned.
  std::uint32_t write_mapped(const Mapped& one, const std::byte* in) {
    if (one.slot < 0) return abort_code::none;
    const std::int64_t value = Values::number(Values::entry(one.slot), in);
    const std::uint32_t abort = values_.check_value(one.slot, value);
    return abort ? abort : take(one.slot, value);
  }
  void lock_mapping(bool locked) { values_.mapping_locked = locked; }

  // ---------------------------------------------------------------------------------- its life

  // Begin anew where the motor is now.
  void begin(const arm_joint_measurement& measured, const arm_joint_sensors& sensors,
             bool powered) {
    servo_joint_reset(&state_);
    shift_ = 0;
    diverged_ = false;
    look(measured, sensors, powered);
    restart();
  }
  // Values as they were made, Switch on disabled.
  void restart() {
    const bool locked = values_.mapping_locked;
    values_.restore();
    values_.mapping_locked = locked;
    set_standard();
    machine_.begin();
    mode_ = Mode::none;
    shift_ = 0;
    closing_ = false;
    aimed_ = lost_ = false;
    homing_.begin();
    probe_[0] = probe_[1] = TouchProbe{};
    hold();
    tell();
  }
  // The master is gone.
  void lost(std::uint16_t error) {
    const std::int64_t reaction = values_.get<0x6007>();
    if (!reaction) return;
    const State before = machine_.state();
    machine_.lose_master(reaction, error, options(), powered_);
    note_failure(before);
    values_.set<0x6040>(0);
    lost_ = true;
    tell();
  }
  // The machine has diverged, and stays where it was.
  void diverged() {
    diverged_ = true;
    fail(error_code::software, false);
  }

  // ------------------------------------------------------------------------- the servo period

  // What the motor gets in the servo period that begins now.
  arm_joint_command begin_period() {
    if (!lost_)
      machine_.take(static_cast<std::uint16_t>(values_.get<0x6040>()), options(), powered_, !brake_,
                    cause());
    closing_ = closing_ && !brake_ && powered_;
    if (machine_.controls()) closing_ = false;
    choose_mode();
    if (!machine_.controls() && !closing_) return let_go();
    if (!controlled_) hold();
    controlled_ = true;
    const double volts = move();
    if (!machine_.controls() && !closing_) return let_go();  // a stop has come to its end
    const bool close = closing_ || closed_by_output();
    const std::uint32_t enable = ARM_ENABLED | (close ? std::uint32_t{ARM_CLOSE_BRAKE} : 0U);
    return {joint_.mode, enable, volts};
  }
  // What was measured when it ended.
  void end_period(const arm_joint_measurement& measured, const arm_joint_sensors& sensors,
                  bool powered) {
    look(measured, sensors, powered);
    watch();
    tell();
  }

 private:
  enum class Loop { position, speed, torque };

  // ----------------------------------------------------------------------------- the standard

  void set_standard() {
    Values& of = values_;
    const double fastest = units_.speed(joint_.servo.omega_limit);
    const auto whole = [](double value) {
      const std::int64_t number = to_integer(value, 32);
      return number < 1 ? std::int64_t{1} : number;
    };
    of.set<0x1018, 4>(number_ + 1);
    of.set<0x6065>(whole(2.0 * fastest / joint_.servo.position_gain));
    of.set<0x606D>(to_integer(0.01 * fastest, 16, false));
    of.set<0x606F>(to_integer(0.01 * fastest, 16, false));
    of.set<0x6075>(static_cast<std::int64_t>(units_.rated_current));
    of.set<0x6076>(static_cast<std::int64_t>(units_.rated_torque));
    of.set<0x607D, 1>(joint_.lower);
    of.set<0x607D, 2>(joint_.upper);
    of.set<0x607F>(whole(std::floor(fastest)));
    of.set<0x6080>(to_integer(std::ceil(60.0 * joint_.servo.omega_limit / kTurn), 32, false));
    of.set<0x6081>(whole(0.25 * fastest));
    of.set<0x6083>(whole(2.0 * fastest));
    of.set<0x6084>(whole(2.0 * fastest));
    of.set<0x6085>(whole(8.0 * fastest));
    of.set<0x608F, 1>(joint_.counts_per_turn);
    of.set<0x6092, 1>(joint_.counts_per_turn);
    of.set<0x6099, 1>(whole(0.1 * fastest));
    of.set<0x6099, 2>(whole(0.02 * fastest));
    of.set<0x609A>(whole(fastest));
    of.set<0x60C5>(4294967295);
    of.set<0x60C6>(4294967295);
    int value = static_cast<int>(1e3 * dt_ + 0.5), exponent = -3;
    if (value < 1 || value > 255 || std::fabs(1e-3 * value - dt_) > 1e-9) {
      value = 1;  // as near as it gets: less than a period is a period
      exponent = -6;
    }
    of.set<0x60C2, 1>(value);
    of.set<0x60C2, 2>(exponent);
    of.set<0x6502>(joint_.modes);
    int methods = 0;
    for (const int one : Homing::method)
      if (Homing::known(one, joint_.index != 0, joint_.stops != 0))
        of.set_at(kSlot<0x60E3, 0> + ++methods, one);
    of.set<0x60E3, 0>(methods);
  }

  // ------------------------------------------------------------------------------ what is set

  // Take a value that is in the range of its entry.
  std::uint32_t take(int slot, std::int64_t value) {
    constexpr std::int64_t load = 0x64616F6C;  // the text, as CiA 301 says
    const std::uint16_t index = Values::entry(slot).index;
    switch (index) {
      case 0x1003:
        if (value != 0) return abort_code::out_of_range;
        values_.forget_errors();
        return abort_code::none;
      case 0x1010:
        return abort_code::cannot_store;  // there is nowhere to store them
      case 0x1011:
        return value == load ? abort_code::none : abort_code::cannot_store;
      case 0x6060:
        if (value && !(values_.get<0x6502>() >> (value - 1) & 1)) return abort_code::out_of_range;
        break;
      case 0x6098:
        if (!Homing::known(value, joint_.index != 0, joint_.stops != 0))
          return abort_code::out_of_range;
        break;
      case 0x607A:
        fresh_ = aimed_ = true;
        break;
      case 0x6040:
        lost_ = false;
        break;
      default:
        break;
    }
    values_.set_at(slot, value);
    return abort_code::none;
  }

  StopOptions options() const {
    const auto option = [](std::int64_t value) { return static_cast<std::int16_t>(value); };
    return {option(values_.get<0x605A>()), option(values_.get<0x605B>()),
            option(values_.get<0x605C>()), option(values_.get<0x605D>()),
            option(values_.get<0x605E>())};
  }
  double number(std::int64_t value) const { return static_cast<double>(value); }
  double speed_limit() const {  // counts/s
    const double motor = units_.speed(most_omega()), profile = number(values_.get<0x607F>());
    return motor < profile ? motor : profile;
  }
  double most_omega() const {
    const double rpm = number(values_.get<0x6080>()) * kTurn / 60.0;
    return rpm < joint_.servo.omega_limit ? rpm : joint_.servo.omega_limit;
  }
  template <std::uint16_t index>
  double acceleration() const {
    const double most = number(values_.get<0x60C5>()), one = number(values_.get<index>());
    return one < most ? one : most;
  }
  template <std::uint16_t index>
  double deceleration() const {
    const double most = number(values_.get<0x60C6>()), one = number(values_.get<index>());
    return one < most ? one : most;
  }
  bool bounded() const { return values_.get<0x607D, 1>() < values_.get<0x607D, 2>(); }
  // A position of the dictionary within the software limits, as one inside.
  double inside(std::int64_t position) {
    const std::int64_t low = values_.get<0x607D, 1>(), high = values_.get<0x607D, 2>();
    std::int64_t within = position;
    if (bounded()) within = position < low ? low : position > high ? high : position;
    outside_ = within != position;
    return number(within + shift_);
  }
  bool brakes() const { return joint_.brake != 0; }
  bool closed_by_output() const {
    return brakes() && values_.get<0x60FE, 1>() & values_.get<0x60FE, 2>() & 1;
  }
  // Whether what leads to a fault is there.
  bool cause() const { return diverged_ || hot_; }

  // --------------------------------------------------------------------------------- a period

  void choose_mode() {
    const Mode asked = static_cast<Mode>(values_.get<0x6060>());
    word_before_ = word_;
    word_ = static_cast<std::uint16_t>(values_.get<0x6040>());
    if (asked == mode_) return;
    if (mode_ == Mode::homing) homing_.interrupt();
    mode_ = asked;
    reached_time_ = still_time_ = 0.0;
    if (mode_ == Mode::homing) homing_.begin();
    if (!controlled_) return;
    switch (mode_) {
      case Mode::profile_position:
      case Mode::cyclic_position:
        control_position();
        begin_position();
        break;
      case Mode::profile_velocity:
      case Mode::cyclic_velocity:
      case Mode::homing:
        control_speed();
        break;
      case Mode::profile_torque:
      case Mode::cyclic_torque:
        torque_ = actual_torque();
        loop_ = Loop::torque;
        break;
      case Mode::none:
        break;
    }
  }

  // No voltage; the brake closes.
  arm_joint_command let_go() {
    hold();
    controlled_ = false;
    servo_release(&arm_);
    limited_ = 0;
    return {joint_.mode, 0, 0.0};
  }
  // Demands at the motor as it is, without speed.
  void follow_motor() {
    position_ = number(counts_);
    speed_ = torque_ = 0.0;
    loop_ = Loop::position;
    target_ = position_;
    fresh_ = aimed_;
    acknowledged_ = buffered_ = outside_ = halted_ = stands_ = false;
    reached_time_ = still_time_ = stood_ = 0.0;
    line_.begin(position_);
    profile_.stand(position_);
  }
  void hold() {
    follow_motor();
    if (mode_ == Mode::homing) homing_.interrupt();
  }
  // Change to a loop, the motion going on.
  void control_position() {
    if (loop_ != Loop::position) position_ = number(counts_);
    if (loop_ == Loop::torque) speed_ = actual_speed();
    loop_ = Loop::position;
  }
  void control_speed() {
    if (loop_ == Loop::torque) speed_ = actual_speed();
    loop_ = Loop::speed;
  }
  void begin_position() {
    line_.begin(position_);
    target_ = position_;
    fresh_ = aimed_;
    acknowledged_ = buffered_ = outside_ = false;
    if (speed_ == 0.0) {
      profile_.stand(position_);
    } else {  // to where it can stop
      const double d = deceleration<0x6084>();
      plan(position_ + speed_ * std::fabs(speed_) / (2.0 * d));
    }
  }

  double actual_speed() const { return units_.speed(state_.omega); }
  double actual_torque() const { return state_.current / units_.current; }

  // Work out the demands of this period, and what voltage they take.
  double move() {
    cut_ = false;
    const bool operates = machine_.state() == State::operation_enabled;
    const bool halts = operates && (word_ & control::halt) && mode_ != Mode::none;
    Stop stop = machine_.stop();
    if (stop == Stop::none && halts) stop = static_cast<Stop>(values_.get<0x605D>());
    if (stop != Stop::none) {
      slow_down(stop, halts);
    } else {
      if (halted_) go_on();
      halted_ = false;
      if (operates)
        run();
      else
        stand();
    }
    return drive();
  }

  void slow_down(Stop stop, bool halt) {
    if (!halted_ && machine_.state() == State::fault_reaction) {  // it may be far from its demand
      speed_ = actual_speed();
      loop_ = Loop::speed;
    }
    halted_ = true;
    by_halt_ = halt && machine_.stop() == Stop::none;
    const bool fades = by_halt_ && mode_ == Mode::profile_torque;
    if (fades) {  // halt in profile torque: the torque goes
      torque_ = ramp(torque_, 0.0, slope(), slope(), dt_);
      return;
    }
    if (stop == Stop::torque_limit && !stands_) {
      control_speed();
      speed_ = 0.0;
    } else {
      if (loop_ == Loop::torque) control_speed();
      const double d = stop == Stop::quick_ramp ? deceleration<0x6085>() : deceleration<0x6084>();
      const double before = speed_;
      speed_ = ramp(speed_, 0.0, d, d, dt_);
      if (loop_ == Loop::position) position_ += 0.5 * (before + speed_) * dt_;
    }
    settle();
  }
  // Look whether a stop has come to its end.
  void settle() {
    if (speed_ != 0.0) {
      stands_ = false;
      stood_ = 0.0;
      return;
    }
    stood_ += dt_;
    const bool slow = std::fabs(actual_speed()) <= number(values_.get<0x606F>());
    stands_ = slow || stood_ > kLongestStop;
    if (!stands_) return;
    if (loop_ == Loop::speed) {
      position_ = number(counts_);
      loop_ = Loop::position;
    }
    if (machine_.stop() == Stop::none) return;
    const State before = machine_.state();
    machine_.stands(options());
    const bool left = machine_.state() != before;
    // The motor is held until its brake has closed.
    closing_ = left && !machine_.controls() && brakes();
  }
  // A stop has ended: what a halt has interrupted goes on.
  void go_on() {
    stands_ = false;
    stood_ = 0.0;
    switch (mode_) {
      case Mode::profile_position: {
        const double target = target_;
        control_position();
        const bool known = acknowledged_;
        begin_position();
        acknowledged_ = known;
        if (by_halt_) plan(target_ = target);
        break;
      }
      case Mode::cyclic_position:
        control_position();
        begin_position();
        break;
      case Mode::profile_velocity:
      case Mode::cyclic_velocity:
        loop_ = Loop::speed;
        break;
      case Mode::profile_torque:
      case Mode::cyclic_torque:
        if (loop_ != Loop::torque) torque_ = actual_torque();
        loop_ = Loop::torque;
        break;
      case Mode::homing:
      case Mode::none:
        break;
    }
  }
  void stand() {
    if (loop_ != Loop::position) position_ = number(counts_);
    loop_ = Loop::position;
    speed_ = 0.0;
  }

  void run() {
    switch (mode_) {
      case Mode::profile_position:
        loop_ = Loop::position;
        take_set_point();
        profile_.advance(dt_, position_, speed_);
        if (profile_.done() && buffered_) {
          buffered_ = false;
          plan(target_);
        }
        break;
      case Mode::profile_velocity:
        loop_ = Loop::speed;
        speed_ = ramp(speed_, within_speed(values_.get<0x60FF>(), speed_limit()),
                      acceleration<0x6083>(), deceleration<0x6084>(), dt_);
        break;
      case Mode::profile_torque:
        loop_ = Loop::torque;
        torque_ = ramp(torque_, number(values_.get<0x6071>()), slope(), slope(), dt_);
        break;
      case Mode::homing:
        home();
        break;
      case Mode::cyclic_position: {
        loop_ = Loop::position;
        if (fresh_) line_.aim(inside(cyclic_target()), periods_per_target());
        fresh_ = false;
        line_.advance(dt_, 1e-4 * number(values_.get<0x2002>()));
        position_ = line_.position();
        speed_ = line_.speed();
        break;
      }
      case Mode::cyclic_velocity:
        loop_ = Loop::speed;
        speed_ =
            within_speed(values_.get<0x60FF>() + values_.get<0x60B1>(), units_.speed(most_omega()));
        break;
      case Mode::cyclic_torque:
        loop_ = Loop::torque;
        torque_ = number(values_.get<0x6071>() + values_.get<0x60B2>());
        break;
      case Mode::none:
        stand();
        break;
    }
  }

  double slope() const { return number(values_.get<0x6087>()); }
  double within_speed(std::int64_t asked, double most) {
    const double speed = number(asked);
    const double within = speed > most ? most : speed < -most ? -most : speed;
    cut_ = cut_ || within != speed;
    return within;
  }
  // The newest target of cyclic positions, in the dictionary's coordinates.
  std::int64_t cyclic_target() const {
    return near(counts_ - shift_, values_.get<0x607A>()) + values_.get<0x60B0>();
  }

  void plan(double target) {
    const double asked = number(values_.get<0x6081>()), most = speed_limit();
    profile_.plan(position_, speed_, target,
                  {asked < most ? asked : most, acceleration<0x6083>(), deceleration<0x6084>()});
    reached_time_ = 0.0;
  }
  void take_set_point() {
    using namespace control;
    if (!(word_ & new_set_point)) {
      acknowledged_ = buffered_;
      return;
    }
    if (word_before_ & new_set_point || acknowledged_) return;
    const std::int64_t word = values_.get<0x607A>();
    const std::int64_t from = static_cast<std::int64_t>(std::floor(target_ + 0.5)) - shift_;
    target_ = inside(word_ & relative ? from + word : near(counts_ - shift_, word));
    acknowledged_ = true;
    if (word_ & change_at_once || profile_.done()) {
      buffered_ = false;
      plan(target_);
    } else {
      buffered_ = true;
    }
  }

  void home() {
    if (!(word_ & control::start_homing)) {
      homing_.interrupt();
    } else if (!(word_before_ & control::start_homing) && !homing_.moves()) {
      homing_.start(static_cast<int>(values_.get<0x6098>()), counts_, pulses_);
    }
    const bool search = homing_.phase() == Homing::Phase::to_stop;
    const double most = speed_limit();
    double speed = number(search ? values_.get<0x6099, 1>() : values_.get<0x6099, 2>());
    speed = homing_.direction() * (speed < most ? speed : most);
    const double a = number(values_.get<0x609A>());
    if (homing_.moves() || speed_ != 0.0) {
      control_speed();
      speed_ = ramp(speed_, speed, a, a, dt_);
    } else {
      stand();
    }
    const bool pressing = limited_ & SERVO_LIMITS_CURRENT &&
                          std::fabs(actual_speed()) <= 0.1 * number(values_.get<0x6099, 1>());
    homing_.look(counts_, pulses_, index_, pressing, speed_, joint_.counts_per_turn, dt_);
    std::int64_t found = 0;
    if (homing_.take(found)) {
      shift_ = found - values_.get<0x607C>();
      stand();
    }
  }

  // The inner loops: what voltage the demands take.
  double drive() {
    servo_wish wish;
    servo_wish_within(&servo_, &wish);
    const double most = number(values_.get<0x6072>());
    const double forward = number(values_.get<0x60E0>()), back = number(values_.get<0x60E1>());
    double up = units_.current * (forward < most ? forward : most);
    double down = units_.current * (back < most ? back : most);
    if (mode_ == Mode::homing && homing_.moves() && Homing::by_stop(values_.get<0x6098>())) {
      const double pressing = units_.current * number(values_.get<0x2003>());
      up = pressing < up ? pressing : up;
      down = pressing < down ? pressing : down;
    }
    if (up < wish.most_current) wish.most_current = up;
    if (-down > wish.least_current) wish.least_current = -down;
    wish.most_omega = most_omega();
    wish.least_omega = -wish.most_omega;
    switch (loop_) {
      case Loop::position: {
        const bool cyclic = mode_ == Mode::cyclic_position &&
                            machine_.state() == State::operation_enabled && !halted_;
        const double share = 1e-3 * number(values_.get<0x2001>());
        const double offset = cyclic ? number(values_.get<0x60B1>()) : 0.0;
        wish.wants = SERVO_POSITION;
        wish.q_target = units_.q(position_);
        wish.v_target = units_.v(share * speed_ + offset);
        break;
      }
      case Loop::speed:
        wish.wants = SERVO_SPEED;
        wish.omega = units_.omega(speed_);
        bound_speed(wish);
        break;
      case Loop::torque:
        wish.wants = SERVO_CURRENT;
        wish.current = units_.current * torque_;
        bound_speed(wish);
        break;
    }
    const bool cyclic = mode_ == Mode::cyclic_position || mode_ == Mode::cyclic_velocity;
    if (cyclic && machine_.state() == State::operation_enabled)
      wish.tau = units_.tau(number(values_.get<0x60B2>()));
    const double volts = servo_drive(&arm_, 0, &wish);
    limited_ = wish.limited;
    return volts;
  }
  // No faster than the motor can stop before a software limit.
  void bound_speed(servo_wish& wish) const {
    if (!bounded() || mode_ == Mode::homing) return;
    const double d = deceleration<0x6084>(), at = number(counts_ - shift_);
    const auto most = [&](double way) {
      return way > 0.0 ? units_.omega(std::sqrt(2.0 * d * way)) : 0.0;
    };
    const double up = most(number(values_.get<0x607D, 2>()) - at);
    const double down = -most(at - number(values_.get<0x607D, 1>()));
    if (up < wish.most_omega) wish.most_omega = up;
    if (down > wish.least_omega) wish.least_omega = down;
  }

  // ------------------------------------------------------------------------- what was measured

  void look(const arm_joint_measurement& measured, const arm_joint_sensors& sensors, bool powered) {
    const std::int64_t before = counts_;
    servo_observe(&arm_, &measured.encoder, &measured.current, &measured.voltage);
    counts_ = servo_.wrap ? state_.counts : measured.encoder;
    turned_ = counts_ - before;
    volts_ = measured.voltage;
    index_ = sensors.index;
    pulses_ = sensors.index_pulses;
    brake_ = measured.brake != 0;
    hot_ = (measured.faults & ARM_FAULT_THERMAL) != 0;
    diverged_ = diverged_ || (measured.faults & ARM_FAULT_DIVERGED) != 0;
    powered_ = powered;
  }

  void fail(std::uint16_t error, bool can_stop) {
    const State before = machine_.state();
    machine_.fail(error, options(), can_stop && powered_);
    if (!can_stop) closing_ = false;
    note_failure(before);
  }
  // Keep the error that has led to a fault from another state.
  void note_failure(State before) {
    const auto failed = [](State one) {
      return one == State::fault || one == State::fault_reaction;
    };
    if (failed(before) || !failed(machine_.state())) return;
    halted_ = stands_ = false;
    stood_ = 0.0;
    values_.add_error(machine_.error());
  }

  void watch() {
    const State state = machine_.state();
    const bool on = state == State::operation_enabled || state == State::quick_stop;
    if (diverged_) fail(error_code::software, false);
    if (hot_ && (on || state == State::fault_reaction)) fail(error_code::too_hot, false);
    if (!powered_ && (on || state == State::fault_reaction)) fail(error_code::undervoltage, false);
    const std::int64_t window = values_.get<0x6065>();
    const bool follows = on && loop_ == Loop::position &&
                         (mode_ == Mode::profile_position || mode_ == Mode::cyclic_position);
    const double error = position_ - number(counts_);
    off_ = follows && window != 4294967295 && std::fabs(error) > number(window);
    off_time_ = off_ ? off_time_ + dt_ : 0.0;
    if (off_time_ > 1e-3 * number(values_.get<0x6066>()) + 0.5 * dt_)
      fail(error_code::following_error, true);
    const bool at_target = std::fabs(target_ - number(counts_)) <= number(values_.get<0x6067>());
    const bool at_speed =
        std::fabs(number(values_.get<0x60FF>()) - actual_speed()) <= number(values_.get<0x606D>());
    const bool there = mode_ == Mode::profile_velocity ? at_speed : at_target && profile_.done();
    reached_time_ = there ? reached_time_ + dt_ : 0.0;
    const bool still = std::fabs(actual_speed()) <= number(values_.get<0x606F>());
    still_time_ = still ? still_time_ + dt_ : 0.0;
    for (int k = 0; k < 2; ++k) {
      const auto function = static_cast<unsigned>(values_.get<0x60B8>() >> (8 * k)) & 0xffU;
      if (!probe_[k].look(function, pulses_)) continue;
      const std::int64_t at = word_of(index_ - shift_);
      if (k)
        values_.set<0x60BC>(at);
      else
        values_.set<0x60BA>(at);
    }
  }

  bool lasts(double time, std::int64_t ms) const { return time + 0.5 * dt_ >= 1e-3 * number(ms); }

  std::uint16_t status() const {
    using namespace fieldbus::status;
    std::uint16_t word = machine_.status() | remote;
    if (powered_) word |= voltage_enabled;
    if (off_) word |= warning;
    const bool operates = machine_.state() == State::operation_enabled;
    if (operates && (cut_ || outside_ || limited_)) word |= internal_limit;
    const bool goes = operates && machine_.stop() == Stop::none;
    if (operates && halted_ && stands_) word |= target_reached;
    switch (mode_) {
      case Mode::profile_position:
        if (operates && !halted_ && !buffered_ && lasts(reached_time_, values_.get<0x6068>()))
          word |= target_reached;
        if (acknowledged_) word |= bit12;
        if (off_) word |= bit13;
        break;
      case Mode::profile_velocity:
        if (operates && !halted_ && lasts(reached_time_, values_.get<0x606E>()))
          word |= target_reached;
        if (lasts(still_time_, values_.get<0x6070>())) word |= bit12;
        break;
      case Mode::profile_torque:
        if (operates && torque_ == (halted_ ? 0.0 : number(values_.get<0x6071>())))
          word |= target_reached;
        break;
      case Mode::homing:
        if (homing_.phase() == Homing::Phase::attained) word |= bit12;
        if (homing_.phase() == Homing::Phase::failed) word |= bit13;
        if (!homing_.moves() && speed_ == 0.0) word |= target_reached;
        break;
      case Mode::cyclic_position:
        if (off_) word |= bit13;
        [[fallthrough]];
      case Mode::cyclic_velocity:
      case Mode::cyclic_torque:
        if (goes && !halted_) word |= bit12;
        break;
      case Mode::none:
        break;
    }
    return word;
  }

  std::uint8_t error_register() const {
    const std::uint16_t error = machine_.error();
    if (!error) return 0;
    switch (error >> 12) {
      case 3:
        return 0x05;
      case 4:
        return 0x09;
      case 8:
        return error == error_code::following_error ? 0x21 : 0x11;
      default:
        return 0x01;
    }
  }

  // Tell the master.
  void tell() {
    Values& of = values_;
    const double error = position_ - number(counts_);
    of.set<0x1001>(error_register());
    of.set<0x2004>(brake_);
    of.set<0x2005>(to_integer(1e3 * state_.current, 32));
    of.set<0x2006>(to_integer(1e3 * volts_, 32));
    of.set<0x603F>(machine_.error());
    of.set<0x6041>(status());
    of.set<0x6061>(static_cast<std::int64_t>(mode_));
    const auto demand = static_cast<std::int64_t>(std::floor(position_ + 0.5));
    const bool in_position = loop_ == Loop::position;
    const std::int64_t demanded = in_position ? demand : counts_;
    of.set<0x6062>(word_of(demanded - shift_));
    of.set<0x6063>(word_of(counts_));
    of.set<0x6064>(word_of(counts_ - shift_));
    of.set<0x6069>(to_integer(number(turned_) / dt_, 32));
    of.set<0x606B>(to_integer(loop_ == Loop::torque ? actual_speed() : speed_, 32));
    of.set<0x606C>(to_integer(actual_speed(), 32));
    of.set<0x6074>(to_integer(loop_ == Loop::torque ? torque_ : actual_torque(), 16));
    of.set<0x6077>(to_integer(actual_torque(), 16));
    of.set<0x6078>(to_integer(1e6 * state_.current / units_.rated_current, 16));
    of.set<0x6079>(powered_ ? to_integer(1e3 * supply_, 32, false) : 0);
    of.set<0x60B9>(probe_[0].status() | probe_[1].status() << 8);
    of.set<0x60F4>(in_position ? to_integer(error, 32) : 0);
    of.set<0x60FC>(word_of(demanded));
    of.set<0x60FD>(brake_ ? 1 << 16 : 0);
  }

  static constexpr double kLongestStop = 0.5;  // s that a motor may creep at the end of a stop

  const drives_joint& joint_;
  const Units units_;
  const double dt_, supply_;
  const int number_;

  Values values_;
  StateMachine machine_;
  Mode mode_ = Mode::none;
  std::uint16_t word_ = 0, word_before_ = 0;

  servo_joint servo_ = joint_.servo;
  servo_state state_ = {};
  servo arm_ = {1, 0, &servo_, &state_, {}, 0, 0, 0, 0, 0, 0, 0};

  // Demands.
  Loop loop_ = Loop::position;
  double position_ = 0.0, speed_ = 0.0, torque_ = 0.0;
  Interpolation line_;
  Trapezoid profile_;
  Homing homing_;
  TouchProbe probe_[2];
  double target_ = 0.0;  // of profile positions
  bool aimed_ = false;   // a target position was written
  bool fresh_ = false, acknowledged_ = false, buffered_ = false;
  bool by_halt_ = false;  // the newest stop was a halt
  bool controlled_ = false, closing_ = false, halted_ = false, stands_ = false, lost_ = false;
  bool cut_ = false, outside_ = false;  // a target speed, position was beyond a limit
  int limited_ = 0;                     // bits of enum servo_limits

  // What was measured.
  std::int64_t counts_ = 0, turned_ = 0, shift_ = 0, index_ = 0, pulses_ = 0;
  double volts_ = 0.0;
  bool powered_ = true, brake_ = false, hot_ = false, diverged_ = false, off_ = false;
  double off_time_ = 0.0, reached_time_ = 0.0, still_time_ = 0.0, stood_ = 0.0;
};

}  // namespace fieldbus
