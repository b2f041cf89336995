/* Real time for a machine behind arm.h: a thread that wakes at absolute deadlines, one per servo
 * period, and exchanges the newest command for a measurement. C99. */
#ifndef ARM_REAL_TIME_H
#define ARM_REAL_TIME_H

#include "tick.h"

#ifdef __cplusplus
extern "C" {
#endif

typedef struct arm_real_time arm_real_time;

/* The machine, which must outlive the loop. */
typedef struct arm_real_time_options {
  uint32_t size;
  int32_t reserved;
  const tick_machine* at;
  int (*join_schedule)(arm_machine*); /* of its library */
  int64_t period;                     /* ns, may be another one than the machine's */
  int32_t core;                       /* processor core of the thread; -1: any */
  int32_t imus;                       /* inertial measurement units, arm_description.imus */
  int32_t readings;                   /* rows of them, arm_description.readings */
  int32_t inputs;                     /* rows of further inputs, arm_description.inputs */
  int32_t readers; /* threads that take snapshots, each all of them; 0: one, at most 2 */
} arm_real_time_options;

/* Result of a period: the machine at the tick that ends it. Every pointer may be null, in `truth`
 * as in arm_get_truth; the sizes of both structs must be set. */
typedef struct arm_snapshot {
  uint32_t size;
  uint32_t reserved;
  int64_t tick;
  int64_t answered; /* tick that the command of the period answered; -1: none yet */
  int64_t lateness; /* ns, of the wake-up that computed it */
  int64_t spent;    /* ns, on the exchange */
  arm_truth truth;
  arm_joint_measurement* joint; /* an entry per joint */
  arm_joint_sensors* sensors;   /* an entry per joint */
  arm_imu_measurement* imu;     /* an entry per unit */
  double* current_d;            /* an entry per joint */
  double* readings;             /* a row of entries per joint for each */
  double* further;              /* what the motors got of further inputs, alike */
} arm_snapshot;

/* Since `arm_real_time_clear_figures`; times in ns. */
typedef struct arm_real_time_figures {
  int64_t tick;
  int64_t lost_periods; /* deadlines missed by whole periods, which logical time has lost */
  int64_t old_commands; /* periods under a command that answers a tick more than two periods old */
  int64_t worst_lateness, median_lateness, p99_lateness;
  int64_t unread; /* snapshots that were not taken in time */
  int64_t fifo;   /* 1: the threads run under SCHED_FIFO */
  int64_t locked; /* 1: memory is locked */
} arm_real_time_figures;

/* Return a loop that does not run yet, or null if the options make no sense. */
arm_real_time* arm_real_time_new(const arm_real_time_options* options);
void arm_real_time_delete(arm_real_time* loop);
/* Run from `tick`, the machine's, until stopped or diverged, or where tick_machine.stop ends loops,
 * as it was at the start. While it runs, no other thread may use the machine. */
void arm_real_time_start(arm_real_time* loop, int64_t tick);
/* Stop within a period. The machine may be changed until the loop starts or continues. */
void arm_real_time_stop(arm_real_time* loop);
/* Continue as if it had not stopped: missed deadlines count as lateness and lost periods. */
void arm_real_time_go_on(arm_real_time* loop);
/* The newest command wins. It may be given and replaced at any time, by one thread. */
void arm_real_time_command(arm_real_time* loop, const arm_command* command);
/* Copy the oldest snapshot that a reader, from 0 on, has not taken yet; 0 if it has taken all, or
 * if a size is not that of its struct. */
int arm_real_time_take(arm_real_time* loop, int32_t reader, arm_snapshot* out);
/* Leave a reader the newest snapshot alone of those that it has not taken yet; returns the sum of
 * what the others spent [ns]. */
int64_t arm_real_time_skip(arm_real_time* loop, int32_t reader);
/* A descriptor that is readable when there is a snapshot: for one reader, who empties it. */
int arm_real_time_descriptor(const arm_real_time* loop);
void arm_real_time_get_figures(const arm_real_time* loop, arm_real_time_figures* out);
void arm_real_time_clear_figures(arm_real_time* loop);

#ifdef __cplusplus
}
#endif

#endif
