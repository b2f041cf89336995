// Where a part of a drive acts that is neither motor nor gear: on the rotor, whose angle and speed
// it is then asked at, or on the link.
#pragma once

namespace arm {

enum class Place { rotor, link };

// Whether a part has an energy that may become negative.
template <class Part>
concept HasPotential = requires(const Part& part) { part.potential(0.0); };

}  // namespace arm
