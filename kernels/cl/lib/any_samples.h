// Samples of a type that is known only when a kernel runs: one program serves all types.
#ifndef ISOPEEL_ANY_SAMPLES_H
#define ISOPEEL_ANY_SAMPLES_H

#include "lib/precision.h"
#include "lib/constants.h"
#include "lib/device.h"

// LANES samples from `at` on. Behind the last sample, the last one is repeated.
#define LOAD_TYPE(type)                                                                                                \
    {                                                                                                                  \
        __global const type *all = (__global const type *)samples;                                                     \
        if (at + LANES <= end) return LOAD_SAMPLES(all + at);                                                          \
        for (uint i = 0; i < LANES; i++) last[i] = (float)all[min(at + i, end - 1)];                                   \
        return LOAD_LANES(last);                                                                                       \
    }
INLINED real load_any(__global const void *samples, uint type, ulong at, ulong end) {
    float last[LANES];
    switch (type) {
        case TYPE_U8: LOAD_TYPE(uchar)
        case TYPE_I8: LOAD_TYPE(char)
        case TYPE_U16: LOAD_TYPE(ushort)
        case TYPE_I16: LOAD_TYPE(short)
        default: LOAD_TYPE(float)
    }
}

// Stores LANES values, which the type has, from `at` on; none behind the last sample.
#define STORE_TYPE(type)                                                                                               \
    {                                                                                                                  \
        __global type *all = (__global type *)samples;                                                                 \
        for (uint i = 0; i < LANES && at + i < end; i++) all[at + i] = (type)values[i];                                \
        return;                                                                                                        \
    }
INLINED void store_any(real value, __global void *samples, uint type, ulong at, ulong end) {
    float values[LANES];
    STORE_LANES(value, values);
    switch (type) {
        case TYPE_U8: STORE_TYPE(uchar)
        case TYPE_I8: STORE_TYPE(char)
        case TYPE_U16: STORE_TYPE(ushort)
        case TYPE_I16: STORE_TYPE(short)
        default: STORE_TYPE(float)
    }
}

#endif
