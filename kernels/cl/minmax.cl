// minmax: least and greatest sample of every brick, and which bricks touch a missing one. Once per volume and step.
// One work-group a brick, in the order region, Morton; a work-item takes rows of 9 samples.
#define ROWS 81

__kernel __attribute__((reqd_work_group_size(64, 1, 1)))
void minmax(const Grid grid, SLAB, const uint first_region, __global float2 *table, __global uint *missing_mask) {
    __local float low[64], high[64];
    __local uint missing;
    const uint lid = get_local_id(0), brick = (uint)get_group_id(0) & 63, region = first_region + (uint)(get_group_id(0) >> 6);
    const int3 origin = convert_int3(region_origin(grid, region) + unmorton(brick << 9));
    const int3 end = (int3)((int)grid.dims[0], (int)grid.dims[1], (int)grid.dims[2]);
    if (lid == 0) missing = 0;
    barrier(CLK_LOCAL_MEM_FENCE);

    float lo = INFINITY, hi = -INFINITY;
    uint gap = 0;
    // A brick has cells only where at least two samples fit along every axis.
    if (all(origin + 1 < end)) {
        const int columns = min(9, end.x - origin.x);
        for (uint row = lid; row < ROWS; row += 64) {
            const int3 p = origin + (int3)(0, (int)(row % 9), (int)(row / 9));
            if (p.y >= end.y || p.z >= end.z) continue;
            const ulong base = sample_index(grid, z0, p);
            for (int x = 0; x < columns; x++) {
                const float v = (float)samples[base + x];
                if (isnan(v) || v == grid.missing) gap = 1;
                else { lo = fmin(lo, v); hi = fmax(hi, v); }
            }
        }
    }
    low[lid] = lo;
    high[lid] = hi;
    if (gap) atomic_or(&missing, 1u);
    barrier(CLK_LOCAL_MEM_FENCE);
    for (uint half_size = 32; half_size > 0; half_size >>= 1) {
        if (lid < half_size) {
            low[lid] = fmin(low[lid], low[lid + half_size]);
            high[lid] = fmax(high[lid], high[lid + half_size]);
        }
        barrier(CLK_LOCAL_MEM_FENCE);
    }
    if (lid == 0) {
        table[(ulong)region * 64 + brick] = (float2)(low[0], high[0]);
        if (missing) atomic_or(&missing_mask[2 * region + (brick >> 5)], 1u << (brick & 31));
    }
}
