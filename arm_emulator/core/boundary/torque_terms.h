/* The torques on the links and rotors of a machine behind arm.h, term by term. C99. */
#ifndef TORQUE_TERMS_H
#define TORQUE_TERMS_H

#include "arm.h"

#ifdef __cplusplus
extern "C" {
#endif

/* Write the torques now, under commands within the bounds of the drives: rows of an entry per
 * joint, as core/mechanics/torque_terms.hpp has them. Returns the number of rows; with a null
 * pointer that is all. */
int32_t arm_torque_terms(const arm_machine* machine, const double* command, double* out);

#ifdef __cplusplus
}
#endif

#endif
