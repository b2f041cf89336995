// Place of a part that is neither motor nor gear: rotor or link, whose angle and speed are its
// inputs.
#pragma once

namespace arm {

enum class Place { rotor, link };

// Whether a part has an energy that may become negative.
template <class Part>
concept HasPotential = requires(const Part& part) { part.potential(0.0); };

}  // namespace arm
