// Vertices of cells, moved so that the polygons between them meet the surface. A vertex on the surface is right for its cell
// alone: a polygon joins four of them across the kinks that the interpolant has at faces of cells, and passes the crossing
// of the edge in its middle on the inner side. Each vertex makes good a part of what its polygons miss. A brick's inner edges
// alone count: a vertex beside another brick moves a little less, and no brick waits for its neighbours.
#ifndef ISOPEEL_RELAX_H
#define ISOPEEL_RELAX_H

#define NO_PLACE 0xffffu // instead of a place in the list: the cell is not active
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
        // Far from overflow for twelve edges a cell; only spacings of odd proportions come near it.
        const int3 gap = convert_int3_sat_rte(clamp((float3)(gap_x[i], gap_y[i], gap_z[i]), -1024.0f, 1024.0f) * GAP_LATTICE);
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

// Moves the vertices of a brick's active cells, `list` in Morton order and `place_of` by x + 8 y + 64 z, in `placements`, where
// they and those of further sheets lie. `several`: cells of several sheets, whose vertices stay apart from each other where they are. `sums`: room for three
// numbers a cell. To be called by all work-items.
inline void relax_cells(__local const float *tile, __local const ushort *list, __local const ushort *place_of,
                        __local const uint *several, uint count,
                        __global const Region *region, __global const Brick *brick, __global const Node *nodes,
                        __global Placement *placements, int3 in_region, float3 spacing, __local int *sums) {
    const uint lid = get_local_id(0), first = region->slot_base + brick->base[0];
    for (uint i = lid; i < 3 * count; i += BRICK_GROUP) sums[i] = 0;
    barrier(CLK_LOCAL_MEM_FENCE);

    Quads quads;
    quads.count = 0;
    for (uint i = 0; i < 4 * LANES; i++) quads.x[i] = quads.y[i] = quads.z[i] = 0.0f;
    for (uint i = 0; i < LANES; i++) quads.low[i] = quads.high[i] = 0.0f;
    for (uint i = lid; i < count; i += BRICK_GROUP) {
        const int3 at = convert_int3(unmorton(list[i]));
        __local const float *v = tile + (at.z * 9 + at.y) * 9 + at.x;
        const bool inside = v[0] >= 0.0f;
        for (uint axis = 0; axis < 3; axis++) {
            const float end = v[axis == 0 ? 1 : axis == 1 ? 9 : 81];
            // The cells around the edge lie a step back along the other two axes.
            const int along_b = axis == 0 ? at.y : axis == 1 ? at.z : at.x, along_c = axis == 0 ? at.z : axis == 1 ? at.x : at.y;
            if (inside == (end >= 0.0f) || along_b == 0 || along_c == 0) continue;
            const int b = axis == 0 ? 8 : axis == 1 ? 64 : 1, c = axis == 0 ? 64 : axis == 1 ? 1 : 8;
            __local const ushort *here = place_of + at.x + 8 * at.y + 64 * at.z;
            const uint cells[4] = {here[0], here[-b], here[-c], here[-b - c]};
            // Else samples are missing.
            if (cells[1] == NO_PLACE || cells[2] == NO_PLACE || cells[3] == NO_PLACE) continue;
            const uint column = NEXT_COLUMN(&quads);
            for (uint k = 0; k < 4; k++) {
                const bool stays = several[cells[k] >> 5] >> (cells[k] & 31) & 1u;
                const uint slot = stays ? sheet_in_brick(region, brick, nodes, first + cells[k], 4 * axis + k) : first + cells[k];
                const Placement place = placements[slot];
                quads.cell[k * LANES + column] = stays ? NONE : cells[k];
                quads.x[k * LANES + column] = (float)place.position[0] / PLACEMENT_LATTICE;
                quads.y[k * LANES + column] = (float)place.position[1] / PLACEMENT_LATTICE;
                quads.z[k * LANES + column] = (float)place.position[2] / PLACEMENT_LATTICE;
            }
            quads.from_x[column] = (float)(in_region.x + at.x);
            quads.from_y[column] = (float)(in_region.y + at.y);
            quads.from_z[column] = (float)(in_region.z + at.z);
            quads.along_x[column] = axis == 0 ? 1.0f : 0.0f;
            quads.along_y[column] = axis == 1 ? 1.0f : 0.0f;
            quads.along_z[column] = axis == 2 ? 1.0f : 0.0f;
            quads.low[column] = v[0];
            quads.high[column] = end;
            if (quads.count == LANES) add_gaps(&quads, spacing, sums);
        }
    }
    if (quads.count) add_gaps(&quads, spacing, sums);
    barrier(CLK_LOCAL_MEM_FENCE | CLK_GLOBAL_MEM_FENCE);

    for (uint i = lid; i < count; i += BRICK_GROUP) {
        if (several[i >> 5] >> (i & 31) & 1u) continue;
        const uint crossed = popcount(crossed_edges(meta_signs(nodes[first + i].meta)));
        __global Placement *place = placements + first + i;
        const float3 from = (float3)(place->position[0], place->position[1], place->position[2]) / PLACEMENT_LATTICE;
        const float3 sum = (float3)((float)sums[3 * i], (float)sums[3 * i + 1], (float)sums[3 * i + 2]) / GAP_LATTICE;
        const float3 lowest = convert_float3(in_region + convert_int3(unmorton(list[i]))) + MARGIN;
        const float3 to = rint(clamp(from + RELAX / (float)crossed * sum, lowest, lowest + (1.0f - 2.0f * MARGIN)) * PLACEMENT_LATTICE);
        place->position[0] = (ushort)to.x;
        place->position[1] = (ushort)to.y;
        place->position[2] = (ushort)to.z;
    }
}

#undef ADD_LOCAL
#endif
