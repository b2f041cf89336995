// The machine whose motion is differentiated, without derivatives: it decides
// (schemes/step_segments.hpp). Its code and that of those that follow it are compiled apart, since
// their numbers differ.
#pragma once

#include <cstdint>

struct arm_sensitive_run;
struct arm_primal;

arm_primal* arm_primal_new(const arm_sensitive_run* run);
void arm_primal_delete(arm_primal* primal);
// Take the steps of a row of commands; false if the machine diverged.
bool arm_primal_advance(arm_primal* primal, const double* command, std::int64_t steps);
// The `Piece`s of these steps, `count` of them, and one that begins at their end.
const void* arm_primal_pieces(const arm_primal* primal, std::int64_t* count);
