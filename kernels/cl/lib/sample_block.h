// Blocks of 11^3 samples, x fastest: a brick's 9^3 and a halo of one.
#ifndef ISOPEEL_SAMPLE_BLOCK_H
#define ISOPEEL_SAMPLE_BLOCK_H

#include "lib/precision.h"
#include "lib/device.h"
#include "lib/layout.h"
#include "lib/samples.h"

#define BLOCK_ROW 11
#define BLOCK_PLANE (11 * 11)
#define BLOCK_FIRST (BLOCK_PLANE + BLOCK_ROW + 1) // the brick's first sample
#define BLOCK_END (9 * BLOCK_PLANE + 9 * BLOCK_ROW + 10) // behind its last one

// Source of a row of a block: samples `first` to `last` of a row, counted from the brick's first sample; none outside the volume.
typedef struct {
    ulong index; // of the sample above the brick's first along x
    int first, last;
} BlockRow;

// Row `row` of a block around the brick at `origin`, y fastest.
INLINED BlockRow find_block_row(Grid grid, uint z0, int3 origin, uint row) {
    const int y = origin.y + (int)(row % 11) - 1, z = origin.z + (int)(row / 11) - 1;
    BlockRow from = {0, 0, -1};
    if (y < 0 || z < 0 || y >= (int)grid.dims[1] || z >= (int)grid.dims[2]) return from;
    from.index = sample_index(grid, z0, (int3)(origin.x, y, z));
    from.first = origin.x > 0 ? -1 : 0;
    from.last = min((int)grid.dims[0] - 1 - origin.x, 9);
    return from;
}

// Copies a row of samples of any type into a block: NaN if a sample is missing or outside the volume.
#define COPY_BLOCK_ROW(from, samples, missing, to)                                                                     \
    if ((from).first == -1 && (from).last == 9) {                                                                      \
        const float8 v = convert_float8(vload8(0, (samples) + (from).index - 1));                                      \
        const float4 end = convert_float4(vload4(0, (samples) + (from).index + 6)); /* one of them again */             \
        vstore8(select(v, (float8)(NAN), v == (missing)), 0, to);                                                      \
        vstore4(select(end, (float4)(NAN), end == (missing)), 0, (to) + 7);                                            \
    } else for (int x = -1; x < 10; x++) {                                                                             \
        float v = NAN;                                                                                                 \
        if (x >= (from).first && x <= (from).last) v = (float)(samples)[(from).index + (ulong)(long)x];                \
        (to)[x + 1] = v == (missing) ? NAN : v;                                                                        \
    }

// As COPY_BLOCK_ROW, of samples whose type is known at run time.
#define COPY_TYPED_BLOCK_ROW(from, samples, type, missing, to)                                                         \
    switch (type) {                                                                                                    \
        case TYPE_U8: COPY_BLOCK_ROW(from, (__global const uchar *)(samples), missing, to) break;                      \
        case TYPE_I8: COPY_BLOCK_ROW(from, (__global const char *)(samples), missing, to) break;                       \
        case TYPE_U16: COPY_BLOCK_ROW(from, (__global const ushort *)(samples), missing, to) break;                    \
        case TYPE_I16: COPY_BLOCK_ROW(from, (__global const short *)(samples), missing, to) break;                     \
        default: COPY_BLOCK_ROW(from, (__global const float *)(samples), missing, to)                                  \
    }

#endif
