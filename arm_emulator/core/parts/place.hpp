// Place of a part that is neither motor nor gear: the rotor, whose angle and speed are then its
// inputs, or the link.
#pragma once

namespace arm {

enum class Place { rotor, link };

// Whether a part has an energy that may become negative.
template <class Part>
concept HasPotential = requires(const Part& part) { part.potential(0.0); };

}  // namespace arm
