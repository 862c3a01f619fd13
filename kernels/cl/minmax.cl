// minmax: least and greatest sample of every brick, and which bricks touch a missing one. Once per volume and step. One
// work-group a row of four bricks along x, in the order region, y, z; its work-items take columns of samples across x, so
// that those that run together read one row.
#define COLUMNS 33 // of a row of bricks, the last one shared with the next
#define BLOCKS (32 / LANES)

// Least and greatest of LANES columns, samples that are missing passed over.
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

__kernel __attribute__((reqd_work_group_size(BRICK_GROUP, 1, 1)))
void minmax(const Grid grid, SLAB, const uint first_region, __global float2 *table, __global uint *missing_mask) {
    // Of every column twice, from even layers and from odd ones.
    __local float low[2 * COLUMNS], high[2 * COLUMNS], gap[2 * COLUMNS];
    const uint lid = get_local_id(0), row_of_bricks = (uint)get_group_id(0) & 15;
    const uint region = first_region + (uint)(get_group_id(0) >> 4), y = row_of_bricks & 3, z = row_of_bricks >> 2;
    const int3 origin = convert_int3(region_origin(grid, region) + (uint3)(0, 8 * y, 8 * z));
    const int3 end = (int3)((int)grid.dims[0], (int)grid.dims[1], (int)grid.dims[2]);
    for (uint i = lid; i < 2 * COLUMNS; i += BRICK_GROUP) {
        low[i] = INFINITY;
        high[i] = -INFINITY;
        gap[i] = 0.0f;
    }
    barrier(CLK_LOCAL_MEM_FENCE);

    const int columns = min(COLUMNS, end.x - origin.x), rows_y = min(9, end.y - origin.y), rows_z = min(9, end.z - origin.z);
    for (uint i = lid; i < 2 * BLOCKS; i += BRICK_GROUP) {
        const uint odd = i / BLOCKS, first = i % BLOCKS * LANES;
        Extent extent = nothing(), last = nothing();
        const bool whole = (int)(first + LANES) <= columns, with_last = first + LANES == 32 && columns == COLUMNS;
        for (int dz = (int)odd; dz < rows_z; dz += 2) {
            __global const SAMPLE *from = samples + sample_index(grid, z0, origin + (int3)(0, 0, dz));
            if (whole && rows_y == 9) {
                // All of them before the first is looked at: memory is far.
                real rows[9];
                for (uint dy = 0; dy < 9; dy++) rows[dy] = LOAD_SAMPLES(from + (ulong)dy * grid.dims[0] + first);
                for (uint dy = 0; dy < 9; dy++) widen(&extent, rows[dy], grid.missing);
                if (with_last)
                    for (uint dy = 0; dy < 9; dy++) widen(&last, (real)(float)from[(ulong)dy * grid.dims[0] + 32], grid.missing);
                continue;
            }
            for (int dy = 0; dy < rows_y; dy++, from += grid.dims[0]) {
                if (whole) widen(&extent, LOAD_SAMPLES(from + first), grid.missing);
                else for (int x = (int)first; x < columns; x++) {
                    Extent one = nothing();
                    widen(&one, (real)(float)from[x], grid.missing);
                    const uint at = odd * COLUMNS + (uint)x;
                    low[at] = fmin(low[at], FIRST_LANE(one.low));
                    high[at] = fmax(high[at], FIRST_LANE(one.high));
                    gap[at] = fmax(gap[at], FIRST_LANE(one.gap));
                }
                if (with_last) widen(&last, (real)(float)from[32], grid.missing);
            }
        }
        if (whole) {
            STORE_LANES(extent.low, low + odd * COLUMNS + first);
            STORE_LANES(extent.high, high + odd * COLUMNS + first);
            STORE_LANES(extent.gap, gap + odd * COLUMNS + first);
        }
        if (first + LANES == 32) {
            low[odd * COLUMNS + 32] = FIRST_LANE(last.low);
            high[odd * COLUMNS + 32] = FIRST_LANE(last.high);
            gap[odd * COLUMNS + 32] = FIRST_LANE(last.gap);
        }
    }
    barrier(CLK_LOCAL_MEM_FENCE);

    for (uint x = lid; x < 4; x += BRICK_GROUP) {
        float least = INFINITY, greatest = -INFINITY, gaps = 0.0f;
        // A brick has cells only where at least two samples fit along every axis.
        if ((int)(8 * x + 1) < columns && rows_y > 1 && rows_z > 1) {
            for (uint i = 0; i < 18; i++) {
                const uint at = i % 2 * COLUMNS + 8 * x + i / 2;
                least = fmin(least, low[at]);
                greatest = fmax(greatest, high[at]);
                gaps = fmax(gaps, gap[at]);
            }
        }
        const uint brick = morton((uint3)(x, y, z));
        table[(ulong)region * 64 + brick] = (float2)(least, greatest);
        if (gaps > 0.0f) atomic_or(&missing_mask[2 * region + (brick >> 5)], 1u << (brick & 31));
    }
}
