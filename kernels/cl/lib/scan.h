// Exclusive prefix sum over a work-group. Returns the sum of the values of work-items before this one; `total` receives the sum of
// all. `scratch`: one uint a work-item. Called by all work-items.
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

#endif
