// A motion with located events, as the smooth parts of its steps. derivative_replay.hpp makes it
// again with derivatives, without the decisions and searches.
#pragma once

#if defined(ARM_RECORDS)  // 4 in 10 lines of a unit that does without
#include <vector>
#endif

namespace arm {

// The end of a part: the step's; an event in it; nothing, since a step with too many events was
// finished without location. `cut` follows the parts of a step that was cut.
enum class PieceEnd { step, event, unlocated, cut };

// A smooth part of a step of N joints with up to K states. Values only, without derivatives.
template <int N, int K>
struct Piece {
  PieceEnd end = PieceEnd::cut;
  int failing = -1;       // the condition that an event changes
  double length = 0.0;    // s
  bool complete = false;  // not a part of a cut step
  bool locked[N] = {};    // the links' modes, and directions
  double direction[N] = {};
  unsigned active[N] = {};                                // the drives' modes
  double z[K > 0 ? K : 1][N] = {}, q[N] = {}, v[N] = {};  // the state at its start
};

// The pieces of one machine, in order.
#if defined(ARM_RECORDS)
template <int N, int K>
using StepSegments = std::vector<Piece<N, K>>;
#else
template <int N, int K>
struct StepSegments;
#endif

}  // namespace arm
