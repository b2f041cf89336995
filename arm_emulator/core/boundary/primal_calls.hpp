// The machine whose motion is differentiated, without derivatives: it decides
// (schemes/step_segments.hpp). Its code and that of those that follow it are compiled apart, since
// their numbers differ.
#pragma once

#include <cstdint>

struct arm_sensitive_run;
struct arm_leader;

arm_leader* arm_leader_new(const arm_sensitive_run* run);
void arm_leader_delete(arm_leader* leader);
// Take the steps of a row of commands; false if the machine diverged.
bool arm_leader_advance(arm_leader* leader, const double* command, std::int64_t steps);
// The `Piece`s of these steps, `count` of them, and one that begins at their end.
const void* arm_leader_pieces(const arm_leader* leader, std::int64_t* count);
