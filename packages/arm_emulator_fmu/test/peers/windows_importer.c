/* A program for Windows that loads a unit of FMI 3.0 and moves it: LIBRARY TOKEN COMMAND Q JOINTS.
 * COMMAND and Q are value references. Prints time and angles after each step, to the last bit. */
#include <stdio.h>
#include <stdlib.h>
#include <windows.h>

#include "fmi3.h"

#define CALL(function, ...) \
  if (function(__VA_ARGS__) != fmi3OK) return fprintf(stderr, #function " failed\n"), 1
#define FIND(name) \
  __typeof__(&name) p_##name = (__typeof__(&name))(void*)GetProcAddress(unit, #name)

enum { MOST = 16, STEPS = 60 };

int main(int count, char** words) {
  if (count != 6) return 2;
  HMODULE unit = LoadLibraryA(words[1]);
  if (!unit) return fprintf(stderr, "%s is not loaded: %lu\n", words[1], GetLastError()), 1;
  FIND(fmi3InstantiateCoSimulation);
  FIND(fmi3EnterInitializationMode);
  FIND(fmi3ExitInitializationMode);
  FIND(fmi3SetFloat64);
  FIND(fmi3GetFloat64);
  FIND(fmi3DoStep);
  FIND(fmi3FreeInstance);
  fmi3Instance one =
      p_fmi3InstantiateCoSimulation("one", words[2], 0, false, false, false, false, 0, 0, 0, 0, 0);
  if (!one) return fprintf(stderr, "no instance\n"), 1;
  const fmi3ValueReference command = (unsigned)atoi(words[3]), q = (unsigned)atoi(words[4]);
  const size_t joints = (size_t)atoi(words[5]);
  CALL(p_fmi3EnterInitializationMode, one, false, 0.0, 0.0, false, 0.0);
  CALL(p_fmi3ExitInitializationMode, one);
  double values[MOST] = {0};
  for (int k = 0; k < STEPS; ++k) {
    for (size_t j = 0; j < joints; ++j) values[j] = (k + (int)j) % 7 - 3.0;
    CALL(p_fmi3SetFloat64, one, &command, 1, values, joints);
    bool flags[3];
    double last = 0.0;
    CALL(p_fmi3DoStep, one, k / 60.0, 1.0 / 60.0, true, flags, flags + 1, flags + 2, &last);
    CALL(p_fmi3GetFloat64, one, &q, 1, values, joints);
    printf("%a", last);
    for (size_t j = 0; j < joints; ++j) printf(" %a", values[j]);
    printf("\n");
  }
  p_fmi3FreeInstance(one);
  return 0;
}
