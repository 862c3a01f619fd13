// Vectors of LANES numbers, one a cell: on a CPU one work-item computes 16 cells in vector registers, without branches, on a GPU
// one. The types and their loads and stores are lib/device_cpu.h's or lib/device_gpu.h's.
//
// Functions over lanes are INLINED: a call would pass vectors through memory.
#ifndef ISOPEEL_LANES_H
#define ISOPEEL_LANES_H

#include "lib/precision.h"
#include "lib/device.h"

// LANES points or vectors.
typedef struct {
    real x, y, z;
} Real3;

INLINED Real3 make_real3(real x, real y, real z) {
    Real3 v;
    v.x = x;
    v.y = y;
    v.z = z;
    return v;
}

// LANES points from three rows, `stride` numbers apart. A macro because it loads from any address space.
#define LOAD_REAL3(from, stride) \
    make_real3(LOAD_LANES(from), LOAD_LANES((from) + (stride)), LOAD_LANES((from) + 2 * (stride)))
#define STORE_REAL3(value, to, stride)                                                                                 \
    {                                                                                                                  \
        STORE_LANES((value).x, to);                                                                                    \
        STORE_LANES((value).y, (to) + (stride));                                                                       \
        STORE_LANES((value).z, (to) + 2 * (stride));                                                                   \
    }

// Lane by lane: `yes` if the condition holds, else `no`. Both are computed.
INLINED Real3 pick_real3(integer condition, Real3 yes, Real3 no) {
    return make_real3(PICK(condition, yes.x, no.x), PICK(condition, yes.y, no.y), PICK(condition, yes.z, no.z));
}

INLINED Real3 scale_real3(Real3 v, real by) { return make_real3(v.x * by, v.y * by, v.z * by); }
INLINED Real3 minus_real3(Real3 a, Real3 b) { return make_real3(a.x - b.x, a.y - b.y, a.z - b.z); }
INLINED Real3 cross_real3(Real3 a, Real3 b) {
    return make_real3(a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x);
}

// From components along an edge's own axis and the next two (x y z, y z x or z x y) to x, y, z.
INLINED Real3 permute_from_axis(Real3 v, uint axis) {
    return make_real3(axis == 0 ? v.x : axis == 1 ? v.z : v.y, axis == 0 ? v.y : axis == 1 ? v.x : v.z,
                      axis == 0 ? v.z : axis == 1 ? v.y : v.x);
}

INLINED real largest_component(Real3 v) { return fmax(fmax(fabs(v.x), fabs(v.y)), fabs(v.z)); }

INLINED real dot_real3(Real3 a, Real3 b) {
#pragma OPENCL FP_CONTRACT ON
    return a.x * b.x + a.y * b.y + a.z * b.z;
}

#endif
