// Samples of the resident volume and their gradient. SAMPLE is their type on the device, given when the program is built. A volume
// is a list of slabs; a kernel reads the one whose first plane is `z0`.
#ifndef ISOPEEL_SAMPLES_H
#define ISOPEEL_SAMPLES_H

#include "lib/precision.h"
#include "lib/cube.h"
#include "lib/device.h"
#include "lib/layout.h"

// The slab that a function reads, as parameters and as arguments. Macros, not a struct: a function that is not inlined would read
// a struct from memory, see lib/brick_task.h.
#define SLAB __global const SAMPLE *samples, const uint z0
#define SLAB_ARGS samples, z0

// 64-bit: a slab may hold more than 2^32 samples.
inline ulong sample_index(Grid grid, uint z0, int3 p) {
    return ((ulong)(uint)(p.z - (int)z0) * grid.dims[1] + (uint)p.y) * grid.dims[0] + (uint)p.x;
}
inline float sample_at(Grid grid, SLAB, int3 p) {
    const float v = (float)samples[sample_index(grid, z0, p)];
    return v == grid.missing ? NAN : v;
}
inline int3 clamp_sample(Grid grid, int3 p) {
    return min(p, (int3)((int)grid.dims[0] - 1, (int)grid.dims[1] - 1, (int)grid.dims[2] - 1));
}

// Loads the samples of a brick into a CPU's caches, for the work-group that comes next: on a CPU a group's first phase waits for
// memory, half of what `classify` takes.
INLINED void prefetch_samples(Grid grid, SLAB, int3 origin) {
    const int3 last = clamp_sample(grid, origin + 8);
    for (int z = origin.z; z <= last.z; z++)
        for (int y = origin.y; y <= last.y; y++) {
            __global const SAMPLE *row = samples + sample_index(grid, z0, (int3)(origin.x, y, z));
            prefetch_line(row);
            prefetch_line(row + last.x - origin.x);
        }
}

// One component of the gradient at a sample, in units per world unit: central differences, one-sided at the volume's
// border or beside a missing sample, zero if neither neighbour is known.
inline float gradient_component(Grid grid, SLAB, int3 p, float here, uint axis) {
    const int3 step = axis_step(axis);
    const int at = axis == 0 ? p.x : axis == 1 ? p.y : p.z;
    const float spacing = axis == 0 ? grid.spacing[0] : axis == 1 ? grid.spacing[1] : grid.spacing[2];
    const int last = (int)(axis == 0 ? grid.dims[0] : axis == 1 ? grid.dims[1] : grid.dims[2]) - 1;
    const float below = at > 0 ? sample_at(grid, SLAB_ARGS, p - step) : NAN;
    const float above = at < last ? sample_at(grid, SLAB_ARGS, p + step) : NAN;
    float d;
    if (!isnan(below) && !isnan(above)) d = (above - below) / (2.0f * spacing);
    else if (!isnan(above)) d = (above - here) / spacing;
    else if (!isnan(below)) d = (here - below) / spacing;
    else d = 0.0f;
    return isnan(d) ? 0.0f : d;
}
inline float3 gradient_at(Grid grid, SLAB, int3 p) {
    const float here = sample_at(grid, SLAB_ARGS, p);
    return (float3)(gradient_component(grid, SLAB_ARGS, p, here, 0), gradient_component(grid, SLAB_ARGS, p, here, 1),
                    gradient_component(grid, SLAB_ARGS, p, here, 2));
}

#endif
