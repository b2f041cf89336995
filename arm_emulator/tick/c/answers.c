#include "answers.h"

#include <string.h>

static int is_repeated(const tick_answers* answers, int64_t tick, const double* command,
                       size_t bytes) {
  return (answers->known > 0 && tick == answers->tick &&
          !memcmp(answers->newest, command, bytes)) ||
         (answers->known > 1 && tick == answers->tick_before &&
          !memcmp(answers->before, command, bytes));
}

int tick_answers_take(tick_answers* answers, int64_t now, int64_t tick, const double* command) {
  const size_t bytes = (size_t)answers->numbers * sizeof(double);
  if (tick > now)
    return !answers->known && tick <= answers->left ? ANSWER_BEFORE_RESET : ANSWER_FUTURE;
  if (is_repeated(answers, tick, command, bytes)) return ANSWER_REPEATED;
  if (tick < answers->tick || (answers->lockstep && answers->known && tick < now))
    return ANSWER_STALE;
  if (answers->known && tick != answers->tick) {
    memcpy(answers->before, answers->newest, bytes);
    answers->tick_before = answers->tick;
    answers->known = 2;
  }
  if (!answers->known) answers->known = 1;
  answers->tick = tick;
  memcpy(answers->newest, command, bytes);
  return ANSWER_NEW;
}
