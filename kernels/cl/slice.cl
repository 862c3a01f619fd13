// slice: samples of a plane of the volume along two axes, as they are. A work-item a sample.
// In: the slab that holds rows `first_row` on. Out: samples, row after row, from that row on.

#include "lib/precision.h"
#include "lib/args.h"
#include "lib/layout.h"
#include "lib/samples.h"

__kernel void slice(const SliceArgs args, __global const SAMPLE *samples, __global SAMPLE *out) {
    const uint i = (uint)get_global_id(0);
    if (i >= args.count) return;
    const int along = (int)(i % args.width), across = (int)(args.first_row + i / args.width), index = (int)args.index;
    const int3 at = args.axis == 0 ? (int3)(index, along, across) : args.axis == 1 ? (int3)(along, index, across)
                                                                                   : (int3)(along, across, index);
    out[(ulong)args.first_row * args.width + i] = samples[sample_index(args.grid, args.z0, at)];
}
