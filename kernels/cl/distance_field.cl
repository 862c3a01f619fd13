// distance_field: distances to the nearest sample that is inside, one axis after another: along z the nearest one before and after each
// sample, then along y and x the minimum over each line of (distance from the axes before)² + (distance along the line)², which is the lower
// envelope of parabolas (Meijster, Roerdink and Hesselink, 2000; Felzenszwalb and Huttenlocher, 2012). One work-item a line, with a few
// operations per sample.
//
// In: values, which are inside if they are neither 0 nor NaN; positions of the samples along the axis. Lengths are in `unit`s until the end.

#include "lib/precision.h"
#include "lib/args.h"
#include "lib/layout.h"

// Neighbouring columns of a work-item: on a CPU as many as a line of its cache has samples.
#define COLUMNS LANES

// Columns of the work-item whose first one is `item`, of those of the launch: none behind the last.
inline uint count_columns(const DistanceColumnsArgs args, ulong item) {
    return item < args.columns ? (uint)min((ulong)COLUMNS, args.columns - item) : 0;
}

inline bool is_inside(float value) { return value != 0.0f && !isnan(value); }

// Distance from each sample to the last inside sample at or before it, along columns of a slab. `last`: position of that sample for each
// column; in: at the slab's first plane, out: at plane `keep`, at which the next slab begins.
__kernel __attribute__((reqd_work_group_size(64, 1, 1)))
void distance_field_before(const DistanceColumnsArgs args, __global const float *positions, __global const float *values,
                           __global float *out, __global float *last) {
    const ulong plane = (ulong)args.grid.dims[0] * args.grid.dims[1], item = COLUMNS * get_global_id(0), column = args.first + item;
    const uint width = count_columns(args, item);
    if (width == 0) return;
    float nearest[COLUMNS];
    for (uint k = 0; k < width; k++) nearest[k] = last[column + k];
    for (uint z = 0; z < args.planes; z++) {
        const ulong at = plane * z + column;
        const float here = positions[args.z0 + z];
        if (args.z0 + z == args.keep)
            for (uint k = 0; k < width; k++) last[column + k] = nearest[k];
        for (uint k = 0; k < width; k++) {
            nearest[k] = is_inside(values[at + k]) ? here : nearest[k];
            out[at + k] = here - nearest[k];
        }
    }
}

// The square of the smaller of that distance and the distance to the next inside sample. `next`: as `last` above, from the slab's end.
__kernel __attribute__((reqd_work_group_size(64, 1, 1)))
void distance_field_after(const DistanceColumnsArgs args, __global const float *positions, __global const float *values,
                          __global float *out, __global float *next) {
    const ulong plane = (ulong)args.grid.dims[0] * args.grid.dims[1], item = COLUMNS * get_global_id(0), column = args.first + item;
    const uint width = count_columns(args, item);
    if (width == 0) return;
    float nearest[COLUMNS];
    for (uint k = 0; k < width; k++) nearest[k] = next[column + k];
    for (uint z = args.planes; z-- > 0;) {
        const ulong at = plane * z + column;
        const float here = positions[args.z0 + z];
        if (args.z0 + z == args.keep)
            for (uint k = 0; k < width; k++) next[column + k] = nearest[k];
        for (uint k = 0; k < width; k++) {
            nearest[k] = is_inside(values[at + k]) ? here : nearest[k];
            const float way = fmin(out[at + k], nearest[k] - here) * args.scale;
            out[at + k] = way * way;
        }
    }
}

// A parabola of a line: that of sample `at`, which is the lowest one from sample `from` on.
typedef struct {
    uint at, from;
    float position, height;
} Parabola;

inline float parabola_value(Parabola p, float position, float scale) {
    const float way = (position - p.position) * scale;
    return p.height + way * way;
}

// Two indices in one word.
inline uint pack_parabola(Parabola p) { return p.at | p.from << 16; }

inline Parabola unpack_parabola(uint packed, __global const float *positions, __global const float *squares, uint stride) {
    Parabola p;
    p.at = packed & 0xffffu;
    p.from = packed >> 16;
    p.position = positions[p.at];
    p.height = squares[(ulong)p.at * stride];
    return p;
}

// The first sample after `low.from` at which `high`, which lies further along the line, is below `low`; `length` if none is.
inline uint first_below(Parabola low, Parabola high, __global const float *positions, float scale, uint length, bool is_even) {
    const float way = high.position - low.position;
    const float crossing = 0.5f * (low.position + high.position) + (high.height - low.height) / (2.0f * way * scale * scale);
    uint begin = low.from + 1, end = length;
    if (is_even) return crossing < (float)begin ? begin : crossing < (float)end ? min((uint)crossing + 1, end) : end;
    while (begin < end) {
        const uint middle = begin + (end - begin) / 2;
        if (positions[middle] > crossing) end = middle;
        else begin = middle + 1;
    }
    return begin;
}

// Minimum over each line. The parabolas of a line's envelope are kept at the start of its results: of the first k samples there are k at most,
// and results are written from the end.
__kernel __attribute__((reqd_work_group_size(64, 1, 1)))
void distance_field_envelope(const DistanceLinesArgs args, __global const float *positions, __global const float *all_squares,
                             __global uint *all_out) {
    if (get_global_id(0) >= args.lines) return;
    const ulong line = args.first + get_global_id(0);
    const uint stride = args.axis == 0 ? 1 : args.grid.dims[0], length = args.grid.dims[args.axis];
    const ulong start = args.axis == 0 ? line * length : line / stride * stride * length + line % stride;
    __global const float *squares = all_squares + start;
    __global uint *out = all_out + start;
    uint count = 0;
    Parabola top;
    for (uint i = 0; i < length; i++) {
        Parabola next = {i, 0, positions[i], squares[(ulong)i * stride]};
        if (isinf(next.height)) continue;
        while (count > 0 && parabola_value(top, positions[top.from], args.scale) > parabola_value(next, positions[top.from], args.scale)) {
            if (--count > 0) top = unpack_parabola(out[(ulong)(count - 1) * stride], positions, squares, stride);
        }
        if (count > 0) next.from = first_below(top, next, positions, args.scale, length, args.is_even != 0);
        if (next.from == length) continue;
        out[(ulong)count * stride] = pack_parabola(next);
        top = next;
        count++;
    }
    for (uint i = length; i-- > 0;) {
        const float square = count > 0 ? parabola_value(top, positions[i], args.scale) : INFINITY;
        out[(ulong)i * stride] = as_uint(args.is_last != 0 ? sqrt(square) * args.unit : square);
        if (count > 1 && i == top.from) {
            count--;
            top = unpack_parabola(out[(ulong)(count - 1) * stride], positions, squares, stride);
        }
    }
}
