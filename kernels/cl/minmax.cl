// minmax: minimum and maximum sample of every brick, and which bricks touch a missing sample. Once per volume and time step.
// In: samples. Out: minimum and maximum a brick; missing_mask, 64 bits a region.
//
// One work-group reads a row of bricks along x through RUN regions; groups in the order run, y, z. A work-item takes columns of
// samples, so that neighbouring work-items read neighbouring samples. Rows overlap by one column: long rows read few twice.

#include "lib/precision.h"
#include "lib/args.h"
#include "lib/device.h"
#include "lib/grid.h"
#include "lib/layout.h"
#include "lib/morton.h"
#include "lib/samples.h"

#define COLUMNS (32 * RUN)

// Minimum and maximum of LANES columns without their missing samples; `gap` is 1 where one is missing.
typedef struct {
    real low, high, gap;
} Extent;

inline Extent nothing() {
    Extent extent;
    extent.low = INFINITY;
    extent.high = -INFINITY;
    extent.gap = 0.0f;
    return extent;
}

inline void widen(Extent *extent, real v, float missing) {
    const real known = PICK(v == missing, NAN, v);
    extent->low = fmin(extent->low, known);
    extent->high = fmax(extent->high, known);
    extent->gap = PICK(known == known, extent->gap, 1.0f);
}

// Widens the extent by LANES columns of a layer's rows, from `from` on. All rows are loaded before the first is used, which hides
// the latency of memory. Where there are fewer than nine rows the last one is used again.
inline void widen_by_rows(Extent *extent, __global const SAMPLE *from, uint rows_y, ulong width, float missing) {
    real rows[9];
    for (uint dy = 0; dy < 9; dy++) rows[dy] = LOAD_SAMPLES(from + min(dy, rows_y - 1) * width);
    for (uint dy = 0; dy < 9; dy++) widen(extent, rows[dy], missing);
}

// The extent of a single column.
inline void set_column(__local float *low, __local float *high, __local float *gap, uint column, __global const SAMPLE *from,
                       uint rows_y, uint rows_z, ulong width, ulong plane, float missing) {
    Extent extent = nothing();
    for (uint dz = 0; dz < rows_z; dz++)
        for (uint dy = 0; dy < rows_y; dy++) widen(&extent, (real)(float)from[dz * plane + dy * width], missing);
    low[column] = FIRST_LANE(extent.low);
    high[column] = FIRST_LANE(extent.high);
    gap[column] = FIRST_LANE(extent.gap);
}

__kernel __attribute__((reqd_work_group_size(BRICK_GROUP, 1, 1)))
void minmax(const MinmaxArgs args, __global const SAMPLE *samples, __global float2 *table, __global uint *missing_mask) {
    const Grid grid = args.grid;
    const uint z0 = args.z0, first_layer = args.first_layer;
    // By column. The column after the last is stored by layers, so that several work-items share it.
    __local float low[COLUMNS + 9], high[COLUMNS + 9], gap[COLUMNS + 9];
    const uint lid = get_local_id(0), row_of_bricks = (uint)get_group_id(0) & 15, y = row_of_bricks & 3, z = row_of_bricks >> 2;
    const uint runs = (grid.regions[0] + RUN - 1) / RUN, run = (uint)(get_group_id(0) >> 4), first_x = run % runs * RUN;
    const uint first_region = (first_layer * grid.regions[1] + run / runs) * grid.regions[0] + first_x;
    const int3 origin = convert_int3(region_origin(grid, first_region) + (uint3)(0, 8 * y, 8 * z));
    const int3 rest = (int3)((int)grid.dims[0], (int)grid.dims[1], (int)grid.dims[2]) - origin;
    const uint columns = (uint)min(COLUMNS + 1, rest.x), rows_y = (uint)clamp(rest.y, 0, 9), rows_z = (uint)clamp(rest.z, 0, 9);
    for (uint i = lid; i < COLUMNS + 9; i += BRICK_GROUP) {
        low[i] = INFINITY;
        high[i] = -INFINITY;
        gap[i] = 0.0f;
    }
    barrier(CLK_LOCAL_MEM_FENCE);

    // A brick has cells only where at least two samples fit along every axis.
    const bool any_cells = rows_y > 1 && rows_z > 1;
    const ulong width = grid.dims[0], plane = width * grid.dims[1];
    __global const SAMPLE *from = samples + (any_cells ? sample_index(grid, z0, origin) : 0);
    for (uint block = lid * LANES; any_cells && block < min(columns, (uint)COLUMNS); block += BRICK_GROUP * LANES) {
        if (columns < LANES) {
            for (uint x = 0; x < columns; x++)
                set_column(low, high, gap, x, from + x, rows_y, rows_z, width, plane, grid.missing);
            continue;
        }
        // The last columns are taken with some before them that were taken already.
        const uint first = min(block, columns - LANES);
        Extent extent = nothing();
        for (uint dz = 0; dz < rows_z; dz++) widen_by_rows(&extent, from + dz * plane + first, rows_y, width, grid.missing);
        STORE_LANES(extent.low, low + first);
        STORE_LANES(extent.high, high + first);
        STORE_LANES(extent.gap, gap + first);
    }
    for (uint dz = lid; any_cells && columns > COLUMNS && dz < rows_z; dz += BRICK_GROUP)
        set_column(low, high, gap, COLUMNS + dz, from + dz * plane + COLUMNS, rows_y, 1, width, plane, grid.missing);
    barrier(CLK_LOCAL_MEM_FENCE);

    for (uint x = lid; x < 4 * RUN; x += BRICK_GROUP) {
        if (first_x + x / 4 >= grid.regions[0]) continue;
        float minimum = INFINITY, maximum = -INFINITY, gaps = 0.0f;
        if (any_cells && 8 * x + 1 < columns) {
            const uint end = x + 1 < 4 * RUN ? 8 * x + 9 : COLUMNS + 9;
            for (uint i = 8 * x; i < end; i++) {
                minimum = fmin(minimum, low[i]);
                maximum = fmax(maximum, high[i]);
                gaps = fmax(gaps, gap[i]);
            }
        }
        const uint region = first_region + x / 4, brick = morton((uint3)(x & 3, y, z));
        table[(ulong)region * 64 + brick] = (float2)(minimum, maximum);
        if (gaps > 0.0f) atomic_or(&missing_mask[2 * region + (brick >> 5)], 1u << (brick & 31));
    }
}
