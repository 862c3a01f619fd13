// Bins of a histogram over keys, the bit patterns of floats of 0 or more. Bin 0 holds keys below `first_key`, the last bin those
// beyond the others.
#ifndef ISOPEEL_FIT_BINS_H
#define ISOPEEL_FIT_BINS_H

#include "lib/constants.h"

inline uint bin_of_key(uint key, uint first_key, uint shift) {
    return key < first_key ? 0 : 1 + min((key - first_key) >> shift, FIT_BINS - 2);
}

#endif
