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

// Minimum and maximum of LANES columns without their missing samples; `gap` is 1 if a sample is missing.
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
// the latency of memory. If there are fewer than nine rows, the last one is used again.
inline void widen_by_rows(Extent *extent, __global const SAMPLE *from, uint rows_y, ulong width, float missing) {
    real rows[9];
    for (uint dy = 0; dy < 9; dy++) rows[dy] = LOAD_SAMPLES(from + min(dy, rows_y - 1) * width);
    for (uint dy = 0; dy < 9; dy++) widen(extent, rows[dy], missing);
}

// The samples under a row of bricks. If `rows_y` or `rows_z` is below 2, there are no cells, and no sample is read.
typedef struct {
    __global const SAMPLE *from; // the first sample
    ulong width, plane;          // samples from a row to the next, and from a plane to the next
    uint columns, rows_y, rows_z;
    float missing;
} RowOfBricks;

INLINED bool has_cells(const RowOfBricks *row) { return row->rows_y > 1 && row->rows_z > 1; }

// `first_region`: the first region of the run.
INLINED RowOfBricks row_of_bricks(const MinmaxArgs args, __global const SAMPLE *samples, uint first_region, uint y, uint z) {
    const Grid grid = args.grid;
    const int3 origin = convert_int3(region_origin(grid, first_region) + (uint3)(0, 8 * y, 8 * z));
    const int3 rest = (int3)((int)grid.dims[0], (int)grid.dims[1], (int)grid.dims[2]) - origin;
    RowOfBricks row;
    row.width = grid.dims[0];
    row.plane = row.width * grid.dims[1];
    row.columns = (uint)min(COLUMNS + 1, rest.x);
    row.rows_y = (uint)clamp(rest.y, 0, 9);
    row.rows_z = (uint)clamp(rest.z, 0, 9);
    row.missing = grid.missing;
    row.from = samples + (has_cells(&row) ? sample_index(grid, args.z0, origin) : 0);
    return row;
}

// Extents by column. The column after the last is stored by layers, so that several work-items share it.
typedef struct {
    __local float *low, *high, *gap;
} Columns;
#define STORED_COLUMNS (COLUMNS + 9)

// The extent of a single column's first `rows_z` layers.
inline void set_column(const RowOfBricks *row, const Columns *out, uint column, __global const SAMPLE *from, uint rows_z) {
    Extent extent = nothing();
    for (uint dz = 0; dz < rows_z; dz++)
        for (uint dy = 0; dy < row->rows_y; dy++) widen(&extent, (real)(float)from[dz * row->plane + dy * row->width], row->missing);
    out->low[column] = FIRST_LANE(extent.low);
    out->high[column] = FIRST_LANE(extent.high);
    out->gap[column] = FIRST_LANE(extent.gap);
}

// Phase: the extent of every column.
INLINED void scan_columns(const RowOfBricks *row, const Columns *out) {
    const uint lid = get_local_id(0), columns = row->columns;
    for (uint block = lid * LANES; block < min(columns, (uint)COLUMNS); block += BRICK_GROUP * LANES) {
        if (columns < LANES) {
            for (uint x = 0; x < columns; x++) set_column(row, out, x, row->from + x, row->rows_z);
            continue;
        }
        // The last columns are taken with some before them that were taken already.
        const uint first = min(block, columns - LANES);
        Extent extent = nothing();
        for (uint dz = 0; dz < row->rows_z; dz++)
            widen_by_rows(&extent, row->from + dz * row->plane + first, row->rows_y, row->width, row->missing);
        STORE_LANES(extent.low, out->low + first);
        STORE_LANES(extent.high, out->high + first);
        STORE_LANES(extent.gap, out->gap + first);
    }
    for (uint dz = lid; columns > COLUMNS && dz < row->rows_z; dz += BRICK_GROUP)
        set_column(row, out, COLUMNS + dz, row->from + dz * row->plane + COLUMNS, 1);
}

// Extent of a brick's columns; empty if the brick has no cells. `x`: of the brick in the row.
INLINED float3 brick_extent(const RowOfBricks *row, const Columns *in, uint x) {
    float3 extent = (float3)(INFINITY, -INFINITY, 0.0f); // low, high, gap
    if (!has_cells(row) || 8 * x + 1 >= row->columns) return extent;
    const uint end = x + 1 < 4 * RUN ? 8 * x + 9 : STORED_COLUMNS;
    for (uint i = 8 * x; i < end; i++) {
        extent.x = fmin(extent.x, in->low[i]);
        extent.y = fmax(extent.y, in->high[i]);
        extent.z = fmax(extent.z, in->gap[i]);
    }
    return extent;
}

__kernel __attribute__((reqd_work_group_size(BRICK_GROUP, 1, 1)))
void minmax(const MinmaxArgs args, __global const SAMPLE *samples, __global float2 *table, __global uint *missing_mask) {
    __local float low[STORED_COLUMNS], high[STORED_COLUMNS], gap[STORED_COLUMNS];
    const Grid grid = args.grid;
    const uint lid = get_local_id(0), in_region = (uint)get_group_id(0) & 15, y = in_region & 3, z = in_region >> 2;
    const uint runs = (grid.regions[0] + RUN - 1) / RUN, run = args.first_run + (uint)(get_group_id(0) >> 4), first_x = run % runs * RUN;
    const uint first_region = run / runs * grid.regions[0] + first_x;
    const RowOfBricks row = row_of_bricks(args, samples, first_region, y, z);
    const Columns columns = {low, high, gap};
    for (uint i = lid; i < STORED_COLUMNS; i += BRICK_GROUP) {
        low[i] = INFINITY;
        high[i] = -INFINITY;
        gap[i] = 0.0f;
    }
    brick_barrier(CLK_LOCAL_MEM_FENCE);
    if (has_cells(&row)) scan_columns(&row, &columns);
    brick_barrier(CLK_LOCAL_MEM_FENCE);
    for (uint x = lid; x < 4 * RUN; x += BRICK_GROUP) {
        if (first_x + x / 4 >= grid.regions[0]) continue;
        const float3 extent = brick_extent(&row, &columns, x);
        const uint region = first_region + x / 4, brick = morton((uint3)(x & 3, y, z));
        table[(ulong)region * 64 + brick] = extent.xy;
        if (extent.z > 0.0f) atomic_or(&missing_mask[2 * region + (brick >> 5)], 1u << (brick & 31));
    }
}
