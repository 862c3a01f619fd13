// overview: mean or maximum of blocks of samples, of those planes that the launch has. A work-item a block.
// Out: of each block one of its values and the sum of the scaled differences from that one, or their maximum and 0; and how many values it has.

#include "lib/precision.h"
#include "lib/args.h"
#include "lib/layout.h"
#include "lib/samples.h"

__kernel void overview(const OverviewArgs args, __global const SAMPLE *samples, __global float2 *values,
                       __global uint *counts) {
    const Grid grid = args.grid;
    const uint z0 = args.z0;
    const uint i = (uint)get_global_id(0);
    if (i >= args.count) return;
    const uint row = args.first_row + i / args.width;
    const uint3 low = (uint3)(i % args.width * args.factor_x, row % args.height * args.factor_y,
                              row / args.height * args.factor_z);
    const uint3 high = min(low + (uint3)(args.factor_x, args.factor_y, args.factor_z),
                           (uint3)(grid.dims[0], grid.dims[1], args.end_plane));
    float sum = 0.0f, first = 0.0f, largest = -INFINITY;
    uint count = 0;
    for (uint z = max(low.z, args.first_plane); z < high.z; z++) {
        float of_plane = 0.0f;
        for (uint y = low.y; y < high.y; y++) {
            float of_row = 0.0f;
            const ulong at = sample_index(grid, z0, (int3)(0, (int)y, (int)z));
            for (uint x = low.x; x < high.x; x++) {
                const float v = (float)samples[at + x];
                if (v == grid.missing || isnan(v) || isinf(v)) continue;
                first = count == 0 ? v : first;
                // Scaled by a power of two, so that no sum overflows: exact, unless the product is subnormal. Rounding errors are shares of the
                // differences, not of the values.
                of_row += v * args.scale - first * args.scale;
                largest = fmax(largest, v);
                count++;
            }
            of_plane += of_row;
        }
        sum += of_plane;
    }
    values[i] = args.is_maximum ? (float2)(largest, 0.0f) : (float2)(first, sum);
    counts[i] = count;
}
