/* Additions of ethercat.cpp in this folder to a segment. C99. */
#ifndef ETHERCAT_FUZZ_H
#define ETHERCAT_FUZZ_H

#include "ethercat/ethercat.h"

#ifdef __cplusplus
extern "C" {
#endif

int64_t ethercat_fuzz(ethercat_segment* segment, drives* all, uint64_t seed, int64_t frames,
                      char* why);

#ifdef __cplusplus
}
#endif

#endif
