// relax: vertices of cells, moved so that the polygons between them meet the surface. A vertex on the surface is right for
// its cell alone: a polygon joins four of them across the kinks that the interpolant has at faces of cells, and passes the
// crossing of the edge in its middle on the inner side. Each vertex makes good a part of what its polygons miss. Runs once an
// isovalue; one work-group a brick, whose inner edges alone count: a vertex beside another brick moves a little less, and
// no brick waits for its neighbours.

#define RELAX 0.7f // part of the mean gap that is made good: neighbours move too, so all of it would be too much
#define GAP_LATTICE 65536.0f // gaps are added up as whole numbers, whose sums do not depend on who adds first

#if BRICK_GROUP == 1
#define ADD_LOCAL(to, value) (*(to) += (value))
#else
#define ADD_LOCAL(to, value) atomic_add(to, value)
#endif

// Quads around inner edges wait here until there are LANES of them. Row corner (0 to 3 as in edge_polygon), column quad.
typedef struct {
    float x[4 * LANES], y[4 * LANES], z[4 * LANES]; // the cells' vertices from the region's low corner, in cells
    float from_x[LANES], from_y[LANES], from_z[LANES], along_x[LANES], along_y[LANES], along_z[LANES]; // the edge
    float low[LANES], high[LANES]; // samples at its ends, minus the isovalue
    uint cell[4 * LANES];          // among the brick's active cells; NONE: one of several sheets
    uint count;
} Quads;

// Adds each quad's gap, from its middle to the crossing along its normal, to its cells' `sums`.
inline void add_gaps(Quads *quads, float3 spacing, __local int *sums) {
#pragma OPENCL FP_CONTRACT ON
#define CORNER(row, i) LOAD_LANES(quads->row + (i) * LANES)
    // As `crossing`: the middle where both samples are infinite.
    const real low = LOAD_LANES(quads->low), share = low / (low - LOAD_LANES(quads->high));
    const real t = PICK(share == share, clamp(share, 0.0f, 1.0f), 0.5f);
    const real x0 = CORNER(x, 0), x1 = CORNER(x, 1), x2 = CORNER(x, 2), x3 = CORNER(x, 3);
    const real y0 = CORNER(y, 0), y1 = CORNER(y, 1), y2 = CORNER(y, 2), y3 = CORNER(y, 3);
    const real z0 = CORNER(z, 0), z1 = CORNER(z, 1), z2 = CORNER(z, 2), z3 = CORNER(z, 3);
#undef CORNER
    // The normal is that of both diagonals.
    const real ax = (x3 - x0) * spacing.x, ay = (y3 - y0) * spacing.y, az = (z3 - z0) * spacing.z;
    const real bx = (x2 - x1) * spacing.x, by = (y2 - y1) * spacing.y, bz = (z2 - z1) * spacing.z;
    const real nx = ay * bz - az * by, ny = az * bx - ax * bz, nz = ax * by - ay * bx;
    const real length2 = nx * nx + ny * ny + nz * nz;
    const real dx = (LOAD_LANES(quads->from_x) + LOAD_LANES(quads->along_x) * t - 0.25f * (x0 + x1 + x2 + x3)) * spacing.x;
    const real dy = (LOAD_LANES(quads->from_y) + LOAD_LANES(quads->along_y) * t - 0.25f * (y0 + y1 + y2 + y3)) * spacing.y;
    const real dz = (LOAD_LANES(quads->from_z) + LOAD_LANES(quads->along_z) * t - 0.25f * (z0 + z1 + z2 + z3)) * spacing.z;
    const real part = PICK(length2 > 0.0f, (dx * nx + dy * ny + dz * nz) / length2, 0.0f);
    float gap_x[LANES], gap_y[LANES], gap_z[LANES];
    STORE_LANES(part * nx / spacing.x, gap_x);
    STORE_LANES(part * ny / spacing.y, gap_y);
    STORE_LANES(part * nz / spacing.z, gap_z);
    for (uint i = 0; i < LANES; i++) {
        if (i >= quads->count) break;
        // Within a few cells, unless samples are not finite.
        const int3 gap = convert_int3_sat_rte(clamp((float3)(gap_x[i], gap_y[i], gap_z[i]), -4.0f, 4.0f) * GAP_LATTICE);
        for (uint k = 0; k < 4; k++) {
            const uint cell = quads->cell[k * LANES + i];
            if (cell == NONE) continue;
            ADD_LOCAL(&sums[3 * cell], gap.x);
            ADD_LOCAL(&sums[3 * cell + 1], gap.y);
            ADD_LOCAL(&sums[3 * cell + 2], gap.z);
        }
    }
    quads->count = 0;
}

__kernel __attribute__((reqd_work_group_size(BRICK_GROUP, 1, 1)))
void relax(const Grid grid, SLAB, const float iso, const uint first_brick, __global const Region *regions,
           __global const Brick *bricks, __global const Node *nodes, __global Placement *placements) {
    __local int sums[3 * 512]; // of each active cell in Morton order, 1/GAP_LATTICE cell
    const uint lid = get_local_id(0), index = first_brick + (uint)get_group_id(0);
    __global const Brick *brick = bricks + index;
    __global const Region *region = regions + brick->region;
    const int3 in_region = convert_int3(unmorton(brick->morton << 9));
    const int3 origin = convert_int3(region_origin(grid, region->region)) + in_region;
    const float3 spacing = (float3)(grid.spacing[0], grid.spacing[1], grid.spacing[2]);
    const uint first = region->slot_base + brick->base[0], count = brick->prefix[15] + popcount(brick->cells[15]);
    const uint3 strides = (uint3)(1, grid.dims[0], grid.dims[0] * grid.dims[1]);
    for (uint i = lid; i < 3 * count; i += BRICK_GROUP) sums[i] = 0;
    barrier(CLK_LOCAL_MEM_FENCE);

    Quads quads;
    quads.count = 0;
    for (uint i = 0; i < 4 * LANES; i++) quads.x[i] = quads.y[i] = quads.z[i] = 0.0f;
    for (uint i = 0; i < LANES; i++) quads.low[i] = quads.high[i] = 0.0f;
    for (uint i = lid; i < count; i += BRICK_GROUP) {
        const uint meta = nodes[first + i].meta;
        const int3 at = convert_int3(unmorton(code_cell(meta_code(meta), 0) & 511));
        for (uint rest = crossed_edges(meta_signs(meta)) & EDGES_OWN; rest; rest &= rest - 1) {
            const uint axis = lowest_bit(rest) >> 2;
            const int3 b = axis_step((axis + 1) % 3), c = axis_step((axis + 2) % 3);
            if (any(at - b - c < 0)) continue;
            uint cells[4], known = 1;
            for (uint k = 0; k < 4; k++) {
                const uint cell = morton(convert_uint3(at - b * (int)(k & 1) - c * (int)(k >> 1))), word = cell >> 5;
                known &= brick->cells[word] >> (cell & 31); // else samples are missing
                cells[k] = brick->prefix[word] + popcount(brick->cells[word] & ((1u << (cell & 31)) - 1));
            }
            if (!(known & 1u)) continue;
            const uint column = NEXT_COLUMN(&quads);
            for (uint k = 0; k < 4; k++) {
                uint slot = first + cells[k];
                const bool several = brick->extras && meta_extras(nodes[slot].meta);
                if (several) slot = sheet_in_brick(region, brick, nodes, slot, 4 * axis + k);
                const Placement place = placements[slot];
                quads.cell[k * LANES + column] = several ? NONE : cells[k];
                quads.x[k * LANES + column] = (float)place.position[0] / PLACEMENT_LATTICE;
                quads.y[k * LANES + column] = (float)place.position[1] / PLACEMENT_LATTICE;
                quads.z[k * LANES + column] = (float)place.position[2] / PLACEMENT_LATTICE;
            }
            const int3 along = axis_step(axis), from = in_region + at;
            quads.from_x[column] = (float)from.x;
            quads.from_y[column] = (float)from.y;
            quads.from_z[column] = (float)from.z;
            quads.along_x[column] = (float)along.x;
            quads.along_y[column] = (float)along.y;
            quads.along_z[column] = (float)along.z;
            const ulong sample = sample_index(grid, z0, origin + at);
            quads.low[column] = (float)samples[sample] - iso;
            quads.high[column] = (float)samples[sample + (axis == 0 ? strides.x : axis == 1 ? strides.y : strides.z)] - iso;
            if (quads.count == LANES) add_gaps(&quads, spacing, sums);
        }
    }
    if (quads.count) add_gaps(&quads, spacing, sums);
    barrier(CLK_LOCAL_MEM_FENCE | CLK_GLOBAL_MEM_FENCE);

    for (uint i = lid; i < count; i += BRICK_GROUP) {
        const uint meta = nodes[first + i].meta;
        // Of several sheets each stays where it is, apart from the others.
        if (meta_extras(meta)) continue;
        const int3 at = in_region + convert_int3(unmorton(code_cell(meta_code(meta), 0) & 511));
        __global Placement *place = placements + first + i;
        const float3 from = (float3)(place->position[0], place->position[1], place->position[2]) / PLACEMENT_LATTICE;
        const float3 sum = (float3)((float)sums[3 * i], (float)sums[3 * i + 1], (float)sums[3 * i + 2]) / GAP_LATTICE;
        const float3 lowest = convert_float3(at) + MARGIN;
        const float3 step = RELAX / (float)popcount(crossed_edges(meta_signs(meta))) * sum;
        const float3 to = rint(clamp(from + step, lowest, lowest + (1.0f - 2.0f * MARGIN)) * PLACEMENT_LATTICE);
        place->position[0] = (ushort)to.x;
        place->position[1] = (ushort)to.y;
        place->position[2] = (ushort)to.z;
    }
}
