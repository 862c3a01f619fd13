// Vertices of cells, moved so that the polygons between them meet the surface. A vertex on the surface is right for its cell
// alone: a polygon joins four of them across the kinks that the interpolant has at faces of cells, and passes the crossing
// of the edge in its middle on the inner side. Each vertex makes good a part of what its polygons miss. A brick's inner edges
// alone count: a vertex beside another brick moves a little less, and no brick waits for its neighbours.
#ifndef ISOPEEL_RELAX_H
#define ISOPEEL_RELAX_H

#define NO_PLACE 0xffffu // instead of a place in the list: the cell is not active
#define RELAX 0.7f // part of the mean gap that is made good: neighbours move too, so all of it would be too much
#define GAP_LATTICE 65536.0f // gaps are added up as whole numbers, whose sums do not depend on who adds first
#define GAP_LIMIT (1024.0f * GAP_LATTICE)

// Quads around LANES inner edges, one a column. Row corner (0 to 3 as in edge_polygon).
typedef struct {
    float x[4 * LANES], y[4 * LANES], z[4 * LANES]; // the cells' vertices from the brick's low corner, in cells
    float from_x[LANES], from_y[LANES], from_z[LANES], along_x[LANES], along_y[LANES], along_z[LANES]; // the edge
    float low[LANES], high[LANES]; // samples at its ends, minus the isovalue
    uint cell[4 * LANES];          // among the brick's active cells; NONE: one of several sheets
} Quads;

// Adds each quad's gap, from its middle to the crossing along its normal, to its cells' `sums`.
inline void add_gaps(const Quads *quads, uint count, float3 spacing, __local int *sums) {
#pragma OPENCL FP_CONTRACT ON
#define CORNER(row, i) LOAD_LANES(quads->row + (i) * LANES)
    const real t = crossing_share(LOAD_LANES(quads->low), LOAD_LANES(quads->high));
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
    const real part = PICK(length2 > 0.0f, native_divide(dx * nx + dy * ny + dz * nz, length2), 0.0f);
    // Far from overflow for twelve edges a cell; only spacings of odd proportions come near it.
    const float3 per_spacing = GAP_LATTICE / spacing;
    float gap_x[LANES], gap_y[LANES], gap_z[LANES];
    STORE_LANES(clamp(part * nx * per_spacing.x, -GAP_LIMIT, GAP_LIMIT), gap_x);
    STORE_LANES(clamp(part * ny * per_spacing.y, -GAP_LIMIT, GAP_LIMIT), gap_y);
    STORE_LANES(clamp(part * nz * per_spacing.z, -GAP_LIMIT, GAP_LIMIT), gap_z);
    for (uint i = 0; i < LANES; i++) {
        if (i >= count) break;
        const int x = (int)gap_x[i], y = (int)gap_y[i], z = (int)gap_z[i];
        for (uint k = 0; k < 4; k++) {
            const uint cell = quads->cell[k * LANES + i];
            if (cell == NONE) continue;
            ADD_LOCAL(&sums[cell], x);
            ADD_LOCAL(&sums[512 + cell], y);
            ADD_LOCAL(&sums[1024 + cell], z);
        }
    }
}

// Moves the vertices of a brick's active cells, `list` in Morton order and `place` by x + 8 y + 64 z, in `placements`, where
// they and those of further sheets lie. `several`: cells of several sheets, whose vertices stay apart from each other where
// they are. Room: `at` (as Placement's position) and `sums` three numbers for each of 512 cells; `quads` 1176. To be called by
// all work-items.
inline void relax_cells(__local const float *tile, __local const ushort *signs_of_row, __local const ushort *list,
                        __local const ushort *place, __local const uint *several, uint count, __global const Region *region,
                        __global const Brick *brick, __global const Node *nodes, __global Placement *placements,
                        int3 in_region, float3 spacing, __local ushort *at, __local int *sums, __local ushort *quads,
                        __local uint *quad_count) {
    const uint lid = get_local_id(0), first = region->slot_base + brick->base[0];
    const float3 low = convert_float3(in_region);
    for (uint i = lid; i < count; i += BRICK_GROUP) {
        const Placement placement = placements[first + i];
        at[i] = placement.position[0];
        at[512 + i] = placement.position[1];
        at[1024 + i] = placement.position[2];
        sums[i] = sums[512 + i] = sums[1024 + i] = 0;
    }
    if (lid == 0) *quad_count = 0;
    barrier(CLK_LOCAL_MEM_FENCE);
    // Edges from the samples of a row, y + 8 z, at which the surface crosses and that have four cells of the brick around them.
    for (uint i = lid; i < 64; i += BRICK_GROUP) {
        const uint y = i & 7, z = i >> 3, row = 9 * z + y, here = signs_of_row[row];
        uint along_x = (here ^ here >> 1) & 0xffu, along_y = (here ^ signs_of_row[row + 1]) & 0xfeu;
        uint along_z = (here ^ signs_of_row[row + 9]) & 0xfeu;
        if (y == 0) along_x = along_z = 0;
        if (z == 0) along_x = along_y = 0;
        if (!(along_x | along_y | along_z)) continue;
        uint n = ADD_LOCAL(quad_count, popcount(along_x | along_y << 8 | along_z << 16));
        for (uint rest = along_x; rest; rest &= rest - 1) quads[n++] = (ushort)(i << 3 | lowest_bit(rest));
        for (uint rest = along_y; rest; rest &= rest - 1) quads[n++] = (ushort)(512 | i << 3 | lowest_bit(rest));
        for (uint rest = along_z; rest; rest &= rest - 1) quads[n++] = (ushort)(1024 | i << 3 | lowest_bit(rest));
    }
    barrier(CLK_LOCAL_MEM_FENCE);

    Quads lanes;
    for (uint i = 0; i < 4 * LANES; i++) lanes.x[i] = lanes.y[i] = lanes.z[i] = 0.0f;
    for (uint i = 0; i < LANES; i++) lanes.low[i] = lanes.high[i] = 0.0f;
    const uint total = *quad_count;
    for (uint begin = lid * LANES; begin < total; begin += BRICK_GROUP * LANES) {
        const uint run = min(total - begin, (uint)LANES);
        for (uint i = 0; i < LANES; i++) {
            if (i >= run) break;
            const uint quad = quads[begin + i], axis = quad >> 9, x = quad & 7, y = quad >> 3 & 7, z = quad >> 6 & 7;
            // The cells around the edge lie a step back along the other two axes.
            const uint b = axis == 0 ? 8 : axis == 1 ? 64 : 1, c = axis == 0 ? 64 : axis == 1 ? 1 : 8;
            __local const ushort *here = place + (quad & 511);
            const uint cells[4] = {here[0], here[-(int)b], here[-(int)c], here[-(int)(b + c)]};
            // Beyond the volume, and where samples are missing, there are no cells, and no quad.
            const bool whole = cells[0] != NO_PLACE && cells[1] != NO_PLACE && cells[2] != NO_PLACE && cells[3] != NO_PLACE;
            for (uint k = 0; k < 4; k++) {
                const uint cell = cells[k], to = k * LANES + i;
                const bool stays = !whole || several[cell >> 5] >> (cell & 31) & 1u;
                lanes.cell[to] = stays ? NONE : cell;
                uint3 p = (uint3)(0);
                if (!stays) p = (uint3)(at[cell], at[512 + cell], at[1024 + cell]);
                else if (whole) {
                    const Placement sheet = placements[sheet_in_brick(region, brick, nodes, first + cell, 4 * axis + k)];
                    p = (uint3)(sheet.position[0], sheet.position[1], sheet.position[2]);
                }
                lanes.x[to] = (float)p.x / PLACEMENT_LATTICE - low.x;
                lanes.y[to] = (float)p.y / PLACEMENT_LATTICE - low.y;
                lanes.z[to] = (float)p.z / PLACEMENT_LATTICE - low.z;
            }
            lanes.from_x[i] = (float)x;
            lanes.from_y[i] = (float)y;
            lanes.from_z[i] = (float)z;
            lanes.along_x[i] = axis == 0 ? 1.0f : 0.0f;
            lanes.along_y[i] = axis == 1 ? 1.0f : 0.0f;
            lanes.along_z[i] = axis == 2 ? 1.0f : 0.0f;
            __local const float *v = tile + 81 * z + 9 * y + x;
            lanes.low[i] = v[0];
            lanes.high[i] = v[axis == 0 ? 1 : axis == 1 ? 9 : 81];
        }
        add_gaps(&lanes, run, spacing, sums);
    }
    barrier(CLK_LOCAL_MEM_FENCE);

    for (uint i = lid; i < count; i += BRICK_GROUP) {
        if (several[i >> 5] >> (i & 31) & 1u) continue;
        const float share = RELAX / GAP_LATTICE / (float)popcount(crossed_edges(meta_signs(nodes[first + i].meta)));
        const float3 lowest = low + convert_float3(unmorton(list[i])) + MARGIN, highest = lowest + (1.0f - 2.0f * MARGIN);
        __global ushort *position = placements[first + i].position;
        const float3 from = (float3)((float)at[i], (float)at[512 + i], (float)at[1024 + i]) / PLACEMENT_LATTICE;
        const float3 way = (float3)((float)sums[i], (float)sums[512 + i], (float)sums[1024 + i]) * share;
        const float3 to = clamp(from + way, lowest, highest);
        position[0] = on_lattice(to.x);
        position[1] = on_lattice(to.y);
        position[2] = on_lattice(to.z);
    }
}

#endif
