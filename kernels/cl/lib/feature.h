// The feature that the user blends into the importance (docs/algorithm.md#2-per-cell-quantities): interpolation and normalisation.
#ifndef ISOPEEL_FEATURE_H
#define ISOPEEL_FEATURE_H

#include "lib/precision.h"
#include "lib/device.h"
#include "lib/layout.h"
#include "lib/samples.h"

inline float normalised_feature(CutParams params, float f) {
    return clamp(exact_quotient(fabs(f) - params.feature_lo, params.feature_span), 0.0f, 1.0f);
}

inline float feature_sample(__global const void *feature, uint type, float missing, ulong i) {
    float v;
    switch (type) {
        case TYPE_U8: v = (float)((__global const uchar *)feature)[i]; break;
        case TYPE_I8: v = (float)((__global const char *)feature)[i]; break;
        case TYPE_U16: v = (float)((__global const ushort *)feature)[i]; break;
        case TYPE_I16: v = (float)((__global const short *)feature)[i]; break;
        default: v = ((__global const float *)feature)[i];
    }
    return v == missing ? NAN : v;
}

// A derived feature at a sample: a case for each line of the list in `src/feature.rs`.
inline float derived_sample(Grid grid, SLAB, uint kind, int3 p) {
    switch (kind) {
        case FEATURE_GRADIENT: return length(gradient_at(grid, SLAB_ARGS, p));
        default: return NAN;
    }
}

// The user's feature at a cell's centre: the mean of its corners that are not missing.
inline float feature_of_cell(Grid grid, SLAB, uint kind, __global const void *feature, uint type, float missing,
                             int3 cell) {
    if (kind == FEATURE_NONE) return 0.0f;
    float sum = 0.0f, count = 0.0f;
    for (uint corner = 0; corner < 8; corner++) {
        const int3 p = cell + (int3)(corner & 1, corner >> 1 & 1, corner >> 2);
        const float v = kind == FEATURE_FIELD ? feature_sample(feature, type, missing, sample_index(grid, z0, p))
                                              : derived_sample(grid, SLAB_ARGS, kind, p);
        if (!isnan(v)) { sum += v; count += 1.0f; }
    }
    return count > 0.0f ? sum / count : 0.0f;
}

#endif
