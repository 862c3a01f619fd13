// Weighted sums and maxima of distances, by work-item, and of a work-group's.
#ifndef ISOPEEL_DISTANCES_H
#define ISOPEEL_DISTANCES_H

#include "lib/precision.h"
#include "lib/layout.h"

// What a work-item adds up.
typedef struct {
    float sum2, weight, maximum;
} Distances;

inline void add_distance(Distances *sums, float distance, float weight) {
    sums->sum2 += weight * distance * distance;
    sums->weight += weight;
    sums->maximum = fmax(sums->maximum, distance);
}

// Adds up the work-items' sums and maxima; the first one writes the result. To be called by all work-items.
inline void write_sums(__local float *scratch, Distances sums, __global ErrorSum *out) {
    const uint lid = get_local_id(0);
    scratch[3 * lid] = sums.sum2;
    scratch[3 * lid + 1] = sums.weight;
    scratch[3 * lid + 2] = sums.maximum;
    for (uint others = GROUP / 2; others > 0; others /= 2) {
        barrier(CLK_LOCAL_MEM_FENCE);
        if (lid >= others) continue;
        scratch[3 * lid] += scratch[3 * (lid + others)];
        scratch[3 * lid + 1] += scratch[3 * (lid + others) + 1];
        scratch[3 * lid + 2] = fmax(scratch[3 * lid + 2], scratch[3 * (lid + others) + 2]);
    }
    if (lid) return;
    out->sum2 = scratch[0];
    out->weight = scratch[1];
    out->max = scratch[2];
}

#endif
