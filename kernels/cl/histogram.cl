// histogram: range and 256 bins of a field or of a derived feature, those of `derive` from its values. Work-items stride over the samples of rows of one slab.
// histogram_range: minimum and maximum, one pair a work-group. histogram_bins: adds to 256 counters.

#include "lib/precision.h"
#include "lib/args.h"
#include "lib/device.h"
#include "lib/feature.h"
#include "lib/layout.h"
#include "lib/samples.h"

// Value of number `i` of a launch that begins with row `first_row` of plane `first_plane`.
inline float histogram_value(Grid grid, SLAB, uint kind, uint first_plane, uint first_row, ulong i) {
    if (kind == FEATURE_STORED) return ((__global const float *)samples)[i];
    if (kind == FEATURE_NONE) {
        const float v = (float)samples[i + ((ulong)(first_plane - z0) * grid.dims[1] + first_row) * grid.dims[0]];
        return v == grid.missing ? NAN : v;
    }
    const uint row = first_row + (uint)(i / grid.dims[0]);
    const int3 p = (int3)((int)(i % grid.dims[0]), (int)(row % grid.dims[1]), (int)(first_plane + row / grid.dims[1]));
    return isnan(sample_at(grid, SLAB_ARGS, p)) ? NAN : derived_sample(grid, SLAB_ARGS, kind, p);
}

__kernel __attribute__((reqd_work_group_size(64, 1, 1)))
void histogram_range(const HistogramRangeArgs args, __global const SAMPLE *samples,
                     __global float2 *ranges) {
    const Grid grid = args.grid;
    const uint z0 = args.z0, kind = args.kind, first_plane = args.first_plane, first_row = args.first_row, count = args.count;
    __local float low[64], high[64];
    const uint lid = get_local_id(0);
    float lo = INFINITY, hi = -INFINITY;
    for (uint i = (uint)get_global_id(0); i < count; i += (uint)get_global_size(0)) {
        const float v = histogram_value(grid, SLAB_ARGS, kind, first_plane, first_row, i);
        if (!isnan(v) && !isinf(v)) { lo = fmin(lo, v); hi = fmax(hi, v); }
    }
    low[lid] = lo;
    high[lid] = hi;
    barrier(CLK_LOCAL_MEM_FENCE);
    if (lid == 0) {
        for (uint i = 1; i < 64; i++) { lo = fmin(lo, low[i]); hi = fmax(hi, high[i]); }
        ranges[get_group_id(0)] = (float2)(lo, hi);
    }
}

__kernel __attribute__((reqd_work_group_size(64, 1, 1)))
void histogram_bins(const HistogramBinsArgs args, __global const SAMPLE *samples, __global uint *bins) {
    const Grid grid = args.grid;
    const uint z0 = args.z0, kind = args.kind, first_plane = args.first_plane, first_row = args.first_row, count = args.count;
    const float lo = args.lo, hi = args.hi;
    __local uint local_bins[256];
    for (uint i = get_local_id(0); i < 256; i += 64) local_bins[i] = 0;
    barrier(CLK_LOCAL_MEM_FENCE);
    for (uint i = (uint)get_global_id(0); i < count; i += (uint)get_global_size(0)) {
        const float v = histogram_value(grid, SLAB_ARGS, kind, first_plane, first_row, i);
        if (isnan(v) || isinf(v)) continue;
        // Halved, so that the span of a field over the whole range of floats does not overflow.
        const float span = 0.5f * hi - 0.5f * lo;
        // Rounded exactly: integers lie on the boundaries of bins.
        const uint bin = span > 0.0f ? min(255u, (uint)(exact_quotient(0.5f * v - 0.5f * lo, span) * 256.0f)) : 0u;
        atomic_inc(&local_bins[bin]);
    }
    barrier(CLK_LOCAL_MEM_FENCE);
    for (uint i = get_local_id(0); i < 256; i += 64)
        if (local_bins[i]) atomic_add(&bins[i], local_bins[i]);
}
