// Where a part of a drive acts that is neither motor nor gear: on the rotor, whose angle and speed
// it is then asked at, or on the link.
#pragma once

namespace arm {

enum class Place { rotor, link };

}  // namespace arm
