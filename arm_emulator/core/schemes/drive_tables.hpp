// The drives' parts of a step for all joints, side by side in vectors (drive_table.hpp).
#pragma once

#include "numerics/finite.hpp"
#include "schemes/modal_drives.hpp"

namespace arm {

// For each input of a step a row of numbers.
template <int inputs, int row, class Number>
struct TableRows {
  Number at[inputs][row] = {};

  void set(int input, int j, int lane, const Real& number) { set_lane(at[input][j], lane, number); }
  Number number(int input, int j) const { return at[input][j]; }
};
// Rows of numbers with derivatives: of each joint the entries that are not zero, and whose
// derivatives are not. Most joints' tables depend on nothing.
template <int inputs, int row, int directions>
struct TableRows<inputs, row, Dual<directions>> {
  using Number = Dual<directions>;
  struct Entry {
    int input;
    double value;
  };
  struct Slope {
    int input;
    typename Number::Row by;
  };
  Entry entries[row][inputs] = {};
  Slope slopes[row][inputs] = {};
  int entry_count[row] = {}, slope_count[row] = {};

  // In the order of inputs, beginning with the first.
  void set(int input, int j, int, const Number& number) {
    if (input == 0) entry_count[j] = slope_count[j] = 0;
    if (number.value != 0.0) entries[j][entry_count[j]++] = {input, number.value};
    if (has_derivatives(number)) slopes[j][slope_count[j]++] = {input, number.by};
  }
  Number number(int input, int j) const {
    Number result = 0.0;
    for (int e = 0; e < entry_count[j]; ++e)
      if (entries[j][e].input == input) result.value = entries[j][e].value;
    for (int e = 0; e < slope_count[j]; ++e)
      if (slopes[j][e].input == input) result.by = slopes[j][e].by;
    return result;
  }
  // The sum of the products with the inputs before `end`.
  ARM_INLINE Number sum_products(int j, int end, auto&& x) const {
    Number sum = 0.0;
    for (int e = 0; e < entry_count[j] && entries[j][e].input < end; ++e)
      sum += entries[j][e].value * x(entries[j][e].input);
    for (int e = 0; e < slope_count[j] && slopes[j][e].input < end; ++e)
      sum.by += value_of(x(slopes[j][e].input)) * slopes[j][e].by;
    return sum;
  }
};

// The numbers of the tables of all joints.
template <class Modal>
struct StepNumbers {
  using Number = typename Modal::Number;
  using Rows = TableRows<Modal::In::count, Modal::row, Number>;
  static constexpr int states = Modal::K > 0 ? Modal::K : 1;
  static constexpr int rates = Modal::linear ? 1 : Modal::K;

  alignas(64) Rows rhs_1 = {}, rhs_2 = {}, dz[states] = {};
  alignas(64) Rows k_z[rates] = {};
  alignas(64) Number diagonal[Modal::row] = {};
};
// The numbers are those of another table, which outlives this one. A step reads all of them and
// little else, so groups of lanes with the same drives have them once in memory.
template <class Modal>
struct ReferredStepNumbers {
  using Referred = StepNumbers<Modal>;
  explicit ReferredStepNumbers(const Referred& there)
      : rhs_1(there.rhs_1),
        rhs_2(there.rhs_2),
        dz(there.dz),
        k_z(there.k_z),
        diagonal(there.diagonal) {}

  const typename Referred::Rows &rhs_1, &rhs_2, (&dz)[Referred::states], (&k_z)[Referred::rates];
  const typename Referred::Number (&diagonal)[Modal::row];
};

// The tables of all joints, side by side in vectors. `Make` makes a joint's table of its linear
// drive. `refers`: the numbers are those of another table.
template <class S, class X, class Make, bool refers = ModalDrives<S, X>::is_common>
class DriveTables : public ModalDrives<S, X>,
                    public std::conditional_t<refers, ReferredStepNumbers<ModalDrives<S, X>>,
                                              StepNumbers<ModalDrives<S, X>>> {
 public:
  using Modal = ModalDrives<S, X>;
  using Stored = std::conditional_t<refers, ReferredStepNumbers<Modal>, StepNumbers<Modal>>;
  using Modal::is_rate_affected;
  using Modal::N, Modal::K, Modal::M, Modal::R, Modal::row, Modal::linear, Modal::is_input_used;
  using Stored::rhs_1, Stored::rhs_2, Stored::dz, Stored::k_z, Stored::diagonal;
  using typename Modal::In, typename Modal::Inputs, typename Modal::Modes;
  static constexpr bool own = Modal::own;
  static constexpr bool has_past = true;  // the last step had the length of this
  static constexpr std::integral_constant<int, -1> link = {};
  using Number = typename Modal::Number;

  using Numbers = TableRows<In::count, row, Number>;
  // The tables whose numbers these are.
  using Common = std::conditional_t<refers, DriveTables<S, X, Make, false>, Nothing>;

  DriveTables(const arm::Numbers<S, X>& numbers, const Make& maker, Nothing = {})
    requires(!refers)
      : Modal(numbers), make_(maker) {
    fill();
  }
  DriveTables(const arm::Numbers<S, X>& numbers, const Make& maker, const Common& common)
    requires(refers)
      : Modal(numbers), Stored(common), make_(maker) {}
  // The numbers of a lane have changed.
  void update_tables(int lane) {
    if constexpr (own) fill_lane(lane);
  }
  // All numbers have changed.
  void fill() {
    this->update_linear();
    for (int lane = 0; lane < (own ? kWidth<X> : 1); ++lane) fill_lane(lane);
  }
  // Fill one lane. All parts are in their regular modes.
  void fill_lane(int lane) {
    this->n_.for_each_drive_of(lane, [&](const auto& drive, int j) {
      if constexpr (Modal::modal) this->record_modes(j, Modes{});
      write_table(drive, 0, j, lane);
    });
  }

  // Put joint j into these modes.
  void set_modes(int j, const Modes& modes) {
    const unsigned active = modes.active();
    if (active != this->modes_of(j).active()) replace_table(j, active);
    this->record_modes(j, modes);
  }
  // Put all joints into the modes that the state x calls for.
  ARM_APART void set_modes_at(const State<S>& x, const Real (&u)[row]) {
    this->n_.for_each_drive([&]<class Drive>(const Drive& drive, int j) {
      if constexpr (Drive::modes > 0) {
        const auto at = input_of(drive, j, x, u[j]);
        if (is_certainly_regular(drive, j, at)) return;
        this->set_modes(j, resize_modes<Modal::M>(drive.modes_at(at)));
      }
    });
  }
  // Change the modes that do not hold at the end y of a step from x. Returns whether all hold.
  ARM_APART bool correct_modes(const State<S>& x, const State<S>& y, const Real (&u)[row]) {
    if (!is_finite(y.v[0])) return true;  // diverged, whatever its modes
    bool hold = true;
    this->n_.for_each_drive([&]<class Drive>(const Drive& drive, int j) {
      if constexpr (Drive::modes > 0) {
        const auto end = input_of(drive, j, y, u[j]);
        if (is_certainly_regular(drive, j, end)) return;
        const Modes& now = this->modes_of(j);
        const Modes required = resize_modes<Modal::M>(
            drive.required_mode(input_of(drive, j, x, u[j]), end, resize_modes<Drive::modes>(now)));
        if (required == now) return;
        hold = false;
        this->set_modes(j, required);
      }
    });
    return hold;
  }
  // State of joint j after a step of the paper's scheme from `start`, in the modes in use.
  template <class TheDrive, class Input>
  Input compute_end_state(const TheDrive& drive, int j, const Input& start) const {
    const Modes& modes = this->modes_of(j);
    Input end = start;
    const auto add = [&](int k, int input, const auto& x) __attribute__((always_inline)) {
      end.z[k] = fma(dz[k].number(input, j), x, end.z[k]);
    };
    for (int k = 0; k < TheDrive::states; ++k) {
      for (int m = 0; m < TheDrive::states; ++m) add(k, m, start.z[m]);
      add(k, In::q, start.q), add(k, In::v, start.v), add(k, In::u, start.u);
      for (int m = 0; m < TheDrive::modes; ++m) add(k, In::offset + m, modes.at[m].offset);
    }
    if constexpr (!TheDrive::is_linear) {
      const auto nonlinear = drive.nonlinear_part(
          drive.apply_modes(start, resize_modes<TheDrive::modes>(modes)), modes.active());
      for (int k = 0; k < TheDrive::states; ++k) {
        for (int r = 0; r < TheDrive::states; ++r) add(k, In::nonlinear + r, nonlinear.f[r]);
        add(k, In::nonlinear + K, nonlinear.g);
      }
    }
    return end;
  }

  // The parts of a linearly implicit step (linearly_implicit.hpp), from the inputs that are known
  // by then: the link's rows of both stages, and the rates of the states in the first with the link
  // at rest and moving. `at_rest`: no link moves, and products with its motion are left out.
  template <bool at_rest = false>
  ARM_INLINE auto compute_first_rhs(const Inputs& in) const {
    return multiply<In::k1, at_rest>(rhs_1, in, link);
  }
  ARM_INLINE auto compute_rates_at_rest(auto k, const Inputs& in) const {
    return multiply<In::k1>(k_z[k], in, k);
  }
  template <bool at_rest = false>
  ARM_INLINE auto compute_rates(auto k, const Inputs& in) const {
    return multiply<In::change, at_rest>(k_z[k], in, k);
  }
  ARM_INLINE auto compute_second_rhs(const Inputs& in) const {
    return multiply<In::k2>(rhs_2, in, link);
  }
  // The states after the step. All of a joint follow while its inputs are in registers.
  template <int stages, bool at_rest = false>
  ARM_INLINE void add_increments(const Inputs& in, arm::Row<N, X>* z) const {
    for_each<arm::Row<N, X>::groups>([&](auto g) __attribute__((always_inline)) {
      for_each<K, kMaxStates>([&](auto k) __attribute__((always_inline)) {
        constexpr int inputs = stages == 2 ? In::count : In::change;
        z[k].at[g] = in[k].at[g] + multiply_group<inputs, at_rest>(dz[k], in, g, k);
      });
    });
  }

  // Parts of a step of one joint, of numbers with derivatives, from the inputs in[...].at[0].
  Number compute_first_rhs_of(int j, const auto& in) const {
    return multiply_joint<In::k1>(rhs_1, j, in);
  }
  Number compute_rate_of(int k, int j, const auto& in) const {
    return multiply_joint<In::change>(k_z[k], j, in);
  }
  Number compute_second_rhs_of(int j, const auto& in) const {
    return multiply_joint<In::k2>(rhs_2, j, in);
  }
  Number compute_end_state_of(int k, int j, const auto& in) const {
    return in[k].at[0] + multiply_joint<In::count>(dz[k], j, in);
  }
  template <int inputs>
  ARM_INLINE static Number multiply_joint(const Numbers& numbers, int j, const auto& in) {
    return numbers.sum_products(j, inputs, [&](int c) -> const Number& { return in[c].at[0]; });
  }

  // A row's numbers times the inputs, for all joints. `k`: the state of which it is; -1: the link.
  template <int inputs, bool at_rest = false>
  ARM_INLINE static arm::Row<N, X> multiply(const Numbers& numbers, const Inputs& x, auto k) {
    arm::Row<N, X> out;
    for_each<arm::Row<N, X>::groups>([&](auto g) __attribute__((always_inline)) {
      out.at[g] = multiply_group<inputs, at_rest>(numbers, x, g, k);
    });
    return out;
  }
  // A row's numbers times the inputs, for a group of joints.
  template <int inputs, bool at_rest>
  ARM_INLINE static auto multiply_group(const Numbers& numbers, const Inputs& x, int g, auto k) {
    if constexpr (kDifferentiates) {
      return numbers.sum_products(g, inputs, [&](int input) -> const X& { return x[input].at[g]; });
    } else if constexpr (inputs <= kMaxInputs && !std::is_same_v<decltype(k), int>) {
      return sum_of<at_rest, k>(numbers, x, g, std::make_integer_sequence<int, inputs>{});
    } else {
      typename arm::Row<N, X>::Vector out = {};
      for (int input = 0; input < inputs; ++input)
        if (is_term_used(k, input, at_rest))
          out = fma(group_of(numbers.at[input], g), x[input].at[g], out);
      return out;
    }
  }

 private:
  // Whether an input may change the row of state k, or of the link.
  static constexpr bool is_term_used(int k, int input, bool at_rest) {
    if (at_rest && (input == In::v || input == In::k1 || input == In::k2)) return false;
    return is_input_used(input) && (k < 0 || is_rate_affected(k, input));
  }
  // Without a function for each input: there are hundreds, and a compiler optimises each.
  template <bool at_rest, int k, int... input>
  ARM_INLINE static auto sum_of(const Numbers& numbers, const Inputs& x, int g,
                                std::integer_sequence<int, input...>) {
    typename arm::Row<N, X>::Vector out = {};
    ((out = std::bool_constant<is_term_used(k, input, at_rest)>::value
                ? fma(group_of(numbers.at[input], g), x[input].at[g], out)
                : out),
     ...);
    return out;
  }

  // Numbers that are the same for all lanes are taken one by one.
  ARM_INLINE static auto group_of(const Number (&numbers)[row], int g) {
    using Row = arm::Row<N, X>;
    if constexpr (std::is_same_v<Number, typename Row::Vector> || kWidth<X> > 1)
      return numbers[g];
    else
      return Row::load_group(numbers, g);
  }

  // Whether a drive is in its regular modes, and surely stays there at this input.
  template <class TheDrive, class Input>
  bool is_certainly_regular(const TheDrive& drive, int j, const Input& at) const {
    return this->modes_of(j) == Modes{} && drive.is_regular(at);
  }

  template <class TheDrive>
  ARM_APART void write_table(const TheDrive& drive, unsigned active, int j, int lane) {
    copy(make_.template operator()<R>(LinearDrive<K, M>::linearise(drive, active)), j, lane);
  }
  ARM_APART void replace_table(int joint, unsigned active) {
    this->n_.for_each_drive([&](const auto& drive, int j) {
      if (j == joint) write_table(drive, active, j, 0);
    });
  }
  void copy(const DriveTable<K, M, R>& table, int j, int lane) {
    for (int input = 0; input < In::count; ++input) {
      if (kDifferentiates && input > 0 && !is_input_used(input)) continue;
      rhs_1.set(input, j, lane, table.rhs_1[input]);
      rhs_2.set(input, j, lane, table.rhs_2[input]);
      for (int k = 0; k < K; ++k) dz[k].set(input, j, lane, table.dz[k][input]);
      if constexpr (!linear)
        for (int k = 0; k < K; ++k) k_z[k].set(input, j, lane, table.k_z[k][input]);
    }
    set_lane(diagonal[j], lane, table.diagonal);
  }

  Make make_;
};

}  // namespace arm
