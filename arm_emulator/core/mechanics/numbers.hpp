// The numbers of a machine: constants of its scene, and varied numbers of each machine, which may
// be set between two steps.
//
// Numbers here are constants unless a varied number affects them; a trial at compile time finds the
// links' base parameters that it affects.
#pragma once

#include "mechanics/links/base_parameters.hpp"
#include "mechanics/links/external_wrench.hpp"

namespace arm {

// Whether gravity and the voltage of the supply are data of each machine.
template <class S>
inline constexpr bool kFieldVaries = requires(const Real* p) { S::field(p); };
template <class S>
inline constexpr bool kSupplyVaries = requires(const Real* p) { S::supply(p); };

struct Nothing {};

// The links' places at some values of the varied numbers, where they vary.
template <class S>
constexpr auto find_places([[maybe_unused]] const Real* p) {
  if constexpr (kPlacesVary<S>)
    return S::places(p);
  else
    return Nothing();
}

// All numbers that follow from the varied ones.
template <class S>
struct DerivedNumbers {
  decltype(S::drives(nullptr)) drives;
  [[no_unique_address]] decltype(find_places<S>(nullptr)) places;
  BaseParameters<S> base;
  Real carried[S::N] = {};  // inertia of the rotors that turn with their links, at the links
  Real Dc[S::N] = {}, Ds[S::N] = {};
  Vec3<Real> gravity = S::gravity;
  Real supply = S::supply_voltage;

  constexpr explicit DerivedNumbers(const Real* p)
      : drives(S::drives(p)), places(find_places<S>(p)), base(base_parameters_of(p)) {
    [&]<int... j>(std::integer_sequence<int, j...>) {
      (set(j, std::get<j>(drives)), ...);
    }(std::make_integer_sequence<int, S::N>{});
    if constexpr (kFieldVaries<S>) gravity = S::field(p);
    if constexpr (kSupplyVaries<S>) supply = S::supply(p);
  }

 private:
  constexpr BaseParameters<S> base_parameters_of(const Real* p) const {
    if constexpr (kPlacesVary<S>)
      return BaseParameters<S>(S::links(p).at, places.at);
    else
      return BaseParameters<S>(S::links(p).at);
  }
  constexpr void set(int j, const auto& drive) {
    carried[j] = drive.carried();
    Dc[j] = drive.sliding_torque(drive.make_rest_state(0.0, 0.0), 0, Real{1.0});
    Ds[j] = drive.holding_torque(drive.make_rest_state(0.0, 0.0), 0, Real{1.0});
  }
};

// The numbers at some values of the varied ones, one of them changed; -1: none. All brakes are
// open.
template <class S>
constexpr DerivedNumbers<S> derive_numbers_with(int changed) {
  SomeValues<S> values;
  for (int k = S::parameters; k < kOwnNumbers<S>; ++k) values.p[k] = 0.0;
  if (changed >= 0) values.p[changed] *= 1.5;
  return DerivedNumbers<S>(values.p);
}

// A mask of the numbers of the links that depend on varied ones.
template <class S>
struct VariedBodies {
  Body<bool> at[S::L] = {};

  constexpr VariedBodies() {
    const DerivedNumbers<S> nominal = derive_numbers_with<S>(-1);
    for (int k = 0; k < S::parameters; ++k) {
      const DerivedNumbers<S> perturbed = derive_numbers_with<S>(k);
      for (int j = 0; j < S::L; ++j)
        for_each_number_of([](bool& varied, const Real& a, const Real& b) { varied |= a != b; },
                           at[j], nominal.base.body[j], perturbed.base.body[j]);
    }
  }
};

// The constants of a scene, and which of its links' base parameters a varied number reaches.
template <class S>
struct Constants {
  static constexpr DerivedNumbers<S> derived = derive_numbers_with<S>(-1);
  static constexpr VariedBodies<S> varied = {};

  // A link of which `own` has what may vary.
  template <class X, class Index>
  ARM_INLINE static constexpr Body<X> body(Index i, const Body<X>& own) {
    Body<X> body = own;
    for_each_number_of(
        [](X& number, const bool& varies, const Real& constant) __attribute__((always_inline)) {
          if (!varies) number = X{} + constant;
        },
        body, varied.at[i], derived.base.body[i]);
    return body;
  }
};

// A drive as lanes know it: its link's dry friction, if that is a torque or two, stands in rows of
// `Numbers`.
template <class Drive>
constexpr Drive without_link_friction(Drive drive) {
  if constexpr (!decltype(drive.friction)::varies)
    drive.friction = drive.friction.without_torques();
  return drive;
}
// Whether machines in lanes need drives of their own: whether a varied number changes a drive
// as lanes know it. A number of a drive is linear in each varied one, so two values show it.
template <class S>
constexpr bool drives_vary() {
  const auto same = [](const auto& left, const auto& right) {
    return without_link_friction(left) == without_link_friction(right);
  };
  const DerivedNumbers<S> before = derive_numbers_with<S>(-1);
  for (int k = 0; k < S::parameters; ++k) {
    const DerivedNumbers<S> after = derive_numbers_with<S>(k);
    const bool all = [&]<int... j>(std::integer_sequence<int, j...>) {
      return (true && ... && same(std::get<j>(before.drives), std::get<j>(after.drives)));
    }(std::make_integer_sequence<int, S::N>{});
    if (!all) return true;
  }
  return false;
}

// Whether a varied number changes the drive of a joint, as above.
template <class S>
struct ChangedDrives {
  bool at[S::parameters + 1][S::N] = {};

  ChangedDrives() {
    const DerivedNumbers<S> before = derive_numbers_with<S>(-1);
    for (int k = 0; k < S::parameters; ++k) {
      const DerivedNumbers<S> after = derive_numbers_with<S>(k);
      [&]<int... j>(std::integer_sequence<int, j...>) {
        ((at[k][j] = !(std::get<j>(before.drives) == std::get<j>(after.drives))), ...);
      }(std::make_integer_sequence<int, S::N>{});
    }
  }
};

template <class S, class X = Real>
class Numbers;

// Numbers of one machine.
template <class S>
class Numbers<S, Real> {
 public:
  static constexpr int N = S::N;
  static constexpr bool varied = kOwnNumbers<S> > 0, drives_vary = varied;
  using Number = Real;

  // `values`: of the varied numbers; the brakes are open.
  constexpr explicit Numbers(const Real* values) : p_(values), derived_(p_.p) {}

  Real value(int k) const { return p_.p[k]; }
  bool are_brakes_open() const {
    bool open = true;
    for (int k = S::parameters; k < kOwnNumbers<S>; ++k) open = open && p_.p[k] == 0.0;
    return open;
  }
  // Set a varied number; the caller has checked its bounds.
  void set(int k, Real value) {
    p_.p[k] = value;
    derived_ = DerivedNumbers<S>(p_.p);
  }
  // All of them, without the brakes.
  void set_all(const Real* values) {
    for (int k = 0; k < S::parameters; ++k) p_.p[k] = values[k];
    derived_ = DerivedNumbers<S>(p_.p);
  }

  ARM_INLINE constexpr const auto& drives() const { return derived().drives; }
  // body(drive, j) for the drive of every joint.
  template <class TheBody>
  ARM_INLINE constexpr void for_each_drive(TheBody&& body) const {
    [&]<int... j>(std::integer_sequence<int, j...>) __attribute__((always_inline)) {
      (body(std::get<j>(derived().drives), j), ...);
    }(std::make_integer_sequence<int, N>{});
  }
  // body(drive, j) for the drives of one lane, of which there is one.
  template <class TheBody>
  ARM_INLINE constexpr void for_each_drive_of(int, TheBody&& body) const {
    for_each_drive(body);
  }

  // A link in base parameters.
  template <class Index>
  ARM_INLINE constexpr Body<Real> body(Index i) const {
    if constexpr (varied)
      return Constants<S>::body(i, derived_.base.body[i]);
    else
      return Constants<S>::derived.base.body[i];
  }
  constexpr const Body<Real>& fixed() const { return derived().base.fixed; }
  template <class Index>
  ARM_INLINE constexpr const auto& place(Index i) const {
    if constexpr (kPlacesVary<S>)
      return derived_.places.at[i];
    else
      return kLinks<S>.at[i];
  }

  ARM_INLINE constexpr const ExternalWrench<Real>& external_wrench(int i) const {
    return outside_.on[i];
  }
  void set_external_wrench(int i, const ExternalWrench<Real>& wrench) { outside_.on[i] = wrench; }

  // In the base's frame [m/s2].
  ARM_INLINE constexpr const Vec3<Real>& gravity() const {
    if constexpr (kFieldVaries<S>)
      return derived_.gravity;
    else
      return S::gravity;
  }
  ARM_INLINE constexpr Real supply() const {
    if constexpr (kSupplyVaries<S>)
      return derived_.supply;
    else
      return S::supply_voltage;
  }

  ARM_INLINE constexpr Real carried(int j) const { return derived().carried[j]; }
  ARM_INLINE constexpr Real Dc(int j) const { return derived().Dc[j]; }
  ARM_INLINE constexpr Real Ds(int j) const { return derived().Ds[j]; }

 private:
  ARM_INLINE constexpr const DerivedNumbers<S>& derived() const {
    if constexpr (varied)
      return derived_;
    else
      return Constants<S>::derived;
  }

  struct Values {
    Real p[kOwnNumbers<S> + 1] = {};
    constexpr explicit Values(const Real* varied) {
      for (int k = 0; k < S::parameters; ++k) p[k] = varied[k];
    }
  };

  Values p_;
  DerivedNumbers<S> derived_;
  ExternalWrenches<S, Real> outside_;
};

// Numbers of machines in lanes, one in each. A number that is not varied is the same for
// all, as with the brakes open: a machine with a closed one takes its steps by its machine
// (lane_stepper.hpp).
template <class S, class X>
class Numbers {
 public:
  static constexpr int N = S::N, width = kWidth<X>;
  static constexpr bool varied = S::parameters > 0;
  static constexpr bool drives_vary = arm::drives_vary<S>();
  using Number = std::conditional_t<varied, X, Real>;

  // All lanes as `first`.
  explicit Numbers(const Numbers<S>& first) {
    for (int lane = 0; lane < width; ++lane) set(lane, first);
  }

  // `machine` must stay where it is.
  void set(int lane, const Numbers<S>& machine) {
    machines_[lane] = &machine;
    open_[lane] = machine.are_brakes_open() ? -1 : 0;
    if constexpr (varied) {
      for (int j = 0; j < S::L; ++j) {
        const Body<Real> from = machine.body(j);
        for_each_number_of([lane](X& to, const Real& number) { set_lane(to, lane, number); },
                           bodies_[j], from);
      }
      if constexpr (kPlacesVary<S>)
        for (int j = 0; j < S::L; ++j)
          for_each_number_of_place(
              [lane](X& to, const Real& number) { set_lane(to, lane, number); }, places_.at[j],
              machine.place(j));
      for (int j = 0; j < N; ++j) {
        set_lane(rotor_[j], lane, machine.carried(j));
        set_lane(coulomb_[j], lane, machine.Dc(j)), set_lane(breakaway_[j], lane, machine.Ds(j));
      }
      if constexpr (kFieldVaries<S>) {
        const Vec3<Real>& g = machine.gravity();
        set_lane(field_.x, lane, g.x), set_lane(field_.y, lane, g.y), set_lane(field_.z, lane, g.z);
      }
      if constexpr (kSupplyVaries<S>) set_lane(supply_, lane, machine.supply());
    }
  }

  // body(drive, j) for the drive of every joint, which all lanes have in common.
  template <class TheBody>
  ARM_INLINE constexpr void for_each_drive(TheBody&& body) const
    requires(!drives_vary)
  {
    [&]<int... j>(std::integer_sequence<int, j...>) __attribute__((always_inline)) {
      (body(std::get<j>(Constants<S>::derived.drives), j), ...);
    }(std::make_integer_sequence<int, N>{});
  }
  // body(drive, j) for the drives of one lane.
  template <class TheBody>
  ARM_INLINE constexpr void for_each_drive_of([[maybe_unused]] int lane, TheBody&& body) const {
    if constexpr (drives_vary)
      machines_[lane]->for_each_drive(body);
    else
      for_each_drive(body);
  }
  // Where no brake is closed.
  const Mask<X>& are_brakes_open() const { return open_; }

  template <class Index>
  ARM_INLINE constexpr Body<Number> body(Index i) const {
    if constexpr (varied)
      return Constants<S>::body(i, bodies_[i]);
    else
      return Constants<S>::derived.base.body[i];
  }

  template <class Index>
  ARM_INLINE constexpr const auto& place(Index i) const {
    if constexpr (kPlacesVary<S>)
      return places_.at[i];
    else
      return kLinks<S>.at[i];
  }

  // Take what acts on the links of a machine.
  void set_external_wrenches(int lane, const Numbers<S>& machine) {
    for (int i = 0; i < S::L; ++i) {
      ExternalWrench<Real> wrench = machine.external_wrench(i);
      Real numbers[sizeof wrench / sizeof(Real)];
      Real *to = numbers, *from = numbers;
      wrench.for_each_number([&](Real number) { *to++ = number; });
      outside_.on[i].for_each_number([&](X& number) { set_lane(number, lane, *from++); });
    }
  }
  ARM_INLINE constexpr const ExternalWrench<X>& external_wrench(int i) const {
    return outside_.on[i];
  }

  ARM_INLINE constexpr decltype(auto) gravity() const {
    if constexpr (kFieldVaries<S>)
      return (field_);
    else
      return (S::gravity);
  }
  ARM_INLINE constexpr auto supply() const {
    if constexpr (kSupplyVaries<S>)
      return supply_;
    else
      return S::supply_voltage;
  }
  Real supply_of(int lane) const { return machines_[lane]->supply(); }

  ARM_INLINE constexpr Number carried(int j) const {
    return number(rotor_, j, &DerivedNumbers<S>::carried);
  }
  ARM_INLINE constexpr Number Dc(int j) const {
    return number(coulomb_, j, &DerivedNumbers<S>::Dc);
  }
  ARM_INLINE constexpr Number Ds(int j) const {
    return number(breakaway_, j, &DerivedNumbers<S>::Ds);
  }

 private:
  using Row = Number[varied ? N : 1];

  ARM_INLINE static constexpr Number number(const Row& own, int j,
                                            Real (DerivedNumbers<S>::*row)[N]) {
    if constexpr (varied)
      return own[j];
    else
      return (Constants<S>::derived.*row)[j];
  }

  const Numbers<S>* machines_[width] = {};
  Mask<X> open_ = {};
  Body<Number> bodies_[varied ? S::L : 1] = {};
  [[no_unique_address]] std::conditional_t<kPlacesVary<S>, LinkPlaces<S::L, X>, Nothing> places_ =
      {};
  Row rotor_ = {}, coulomb_ = {}, breakaway_ = {};
  [[no_unique_address]] std::conditional_t<kFieldVaries<S>, Vec3<X>, Nothing> field_ = {};
  [[no_unique_address]] std::conditional_t<kSupplyVaries<S>, X, Nothing> supply_ = {};
  ExternalWrenches<S, X> outside_;
};

}  // namespace arm
