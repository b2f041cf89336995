// Place of a part that is neither motor nor gear: rotor or link, whose angle and speed are its
// inputs.
#pragma once

#include "numerics/real.hpp"

namespace arm {

enum class Place { rotor, link };

// Whether a part has an energy that may become negative.
template <class Part>
concept HasPotential = requires(const Part& part) { part.potential_energy_at(0.0); };

// Whether a part has a temperature that friction follows.
template <class Part>
concept ChangesFriction = requires(const Part& part, Real rise) { part.compute_factors(rise); };

}  // namespace arm
