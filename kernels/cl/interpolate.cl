// interpolate: a field at points, trilinear between its samples. A work-item a point.
// In: the samples of a slab, points in cells. Out: the values of the points whose cells are in the slab's layers of regions; NaN beside
// missing samples.

#include "lib/precision.h"
#include "lib/args.h"
#include "lib/grid.h"
#include "lib/layout.h"
#include "lib/samples.h"

__kernel void interpolate(const InterpolateArgs args, __global const SAMPLE *samples, __global const float4 *points,
                          __global float *values) {
    const uint i = args.first + (uint)get_global_id(0);
    if (i >= args.end) return;
    const Grid grid = args.grid;
    const int3 last = (int3)((int)grid.dims[0], (int)grid.dims[1], (int)grid.dims[2]) - 1;
    const float3 at = clamp(points[i].xyz, (float3)(0.0f), convert_float3(last));
    const int3 low = min(convert_int3(at), last - 1);
    const uint layer = min((uint)low.z / 32u, grid.regions[2] - 1);
    if (layer < args.first_layer || layer >= args.end_layer) return;
    const float3 t = at - convert_float3(low);
    float value = 0.0f;
    for (int corner = 0; corner < 8; corner++) {
        const int3 bit = (int3)(corner & 1, corner >> 1 & 1, corner >> 2);
        const float weight =
            (bit.x ? t.x : 1.0f - t.x) * (bit.y ? t.y : 1.0f - t.y) * (bit.z ? t.z : 1.0f - t.z);
        // A missing sample of weight 0 has no effect.
        if (weight > 0.0f) value += weight * sample_at(grid, samples, args.z0, low + bit);
    }
    values[i] = value;
}
