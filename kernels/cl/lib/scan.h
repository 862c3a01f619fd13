// Exclusive prefix sum over a work-group; `total` receives the sum. `scratch` holds one uint a work-item.
#ifndef ISOPEEL_SCAN_H
#define ISOPEEL_SCAN_H

inline uint scan_group(__local uint *scratch, uint value, uint *total) {
#if GROUP == 1
    (void)scratch;
    *total = value;
    return 0;
#else
    const uint lid = get_local_id(0), size = get_local_size(0);
    scratch[lid] = value;
    barrier(CLK_LOCAL_MEM_FENCE);
    for (uint step = 1; step < size; step <<= 1) {
        const uint add = lid >= step ? scratch[lid - step] : 0;
        barrier(CLK_LOCAL_MEM_FENCE);
        scratch[lid] += add;
        barrier(CLK_LOCAL_MEM_FENCE);
    }
    const uint inclusive = scratch[lid];
    *total = scratch[size - 1];
    barrier(CLK_LOCAL_MEM_FENCE);
    return inclusive - value;
#endif
}

// Before a loop that a work-item of many goes through once or twice: unrolled, it would only push the rest of a large kernel out
// of a GPU's cache of instructions.
#if BRICK_GROUP == 1
#define ROLLED
#else
#define ROLLED _Pragma("unroll 1")
#endif

// Adds to a number that the work-items of a brick share, and answers what it was before.
#if BRICK_GROUP == 1
#define ADD_LOCAL(to, value) ((*(to) += (value)) - (value))
#else
#define ADD_LOCAL(to, value) atomic_add(to, value)
#endif

#endif
