/* The equations of the machines of a scene: linear forms, dynamics of the links, torques by terms.
 *
 * They are functions of a point: the numbers that `arm_get_point` (arm.h) writes for a machine. No
 * run needs them, so they have a library of their own, which belongs to the scene's of the same
 * core. Arrays and units are as in arm.h. C99.
 *
 * Without a pointer that is required nothing is written.
 */
#ifndef ARM_EQUATIONS_H
#define ARM_EQUATIONS_H

#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

/* The linear part of every drive (drive_table.hpp), for the analysis of small motions. The schemes
 * treat it implicitly. It is the linearisation about a gear that is not wound up, at any state of
 * the machine. Rows of K states; returns K. out, per joint: the number of its states, the carried
 * rotor, D (K), F (K rows of K + 3), G (K + 3), and the rows of motor current and motor angle (K +
 * 3 each); the columns are z, q, v and u. A gear with play has a tooth in contact if `loaded`, else
 * none. With `out` null only K is returned. */
int32_t arm_linear_drives(const double* point, int32_t loaded, double* out);

/* The machine about a state, for what changes little, with what each joint does there held: one
 * that sticks rests, a current at its limit stays, a tooth touches or does not. x has the K states
 * of each drive, z[state * joints + joint], then q and v; those of the machine are taken
 * (`as_it_is`), or those given, and written there, with what follows at once where it then is;
 * commands are put within the bounds of the drives. With `slides` there is no dry friction. With
 * `follows` the memory of gears follows their twist first, as at the start of a step. Out: rows of
 * an entry for each number of x and each command, and the row's own value; the rows are D dz/dt,
 * dv/dt, the motors' currents [A] and their angles [rad]. Behind them D, whether each joint sticks,
 * and how many states its drive has. K is what `arm_linear_drives` returns. */
void arm_linearise(const double* point, double* x, double* command, int32_t as_it_is,
                   int32_t slides, int32_t follows, double* out);

/* The links alone, for `count` rows of joints: M(q) a + nle(q, v) = tau, under the external
 * wrenches that act now. */
void arm_forward_dynamics(const double* point, int64_t count, const double* q, const double* v,
                          const double* tau, double* a);
void arm_inverse_dynamics(const double* point, int64_t count, const double* q, const double* v,
                          const double* a, double* tau);
/* M (joints x joints, symmetric) and nle of the same, for each row of q and v. */
void arm_link_dynamics(const double* point, int64_t count, const double* q, const double* v,
                       double* M, double* nle);

/* The torques on links and rotors, under commands within the bounds of the drives: rows of an entry
 * per joint, as core/mechanics/torque_terms.hpp has them. Returns the number of rows; without `out`
 * that is all. */
int32_t arm_torque_terms(const double* point, const double* command, double* out);

#ifdef __cplusplus
}
#endif

#endif
