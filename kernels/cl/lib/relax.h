// Vertices of cells, moved so that the polygons between them meet the surface. A vertex on the surface is right for its cell
// alone: a polygon joins four of them across the kinks that the interpolant has at faces of cells, and passes the crossing
// of the edge in its middle on the inner side. Each vertex makes good a part of what its polygons miss. A brick's inner edges
// alone count: a vertex beside another brick moves a little less, and no brick waits for its neighbours.
#ifndef ISOPEEL_RELAX_H
#define ISOPEEL_RELAX_H

#include "lib/precision.h"
#include "lib/bits.h"
#include "lib/cell_solver.h"
#include "lib/cube.h"
#include "lib/device.h"
#include "lib/layout.h"
#include "lib/node.h"
#include "lib/sheets.h"
#include "lib/trilinear.h"
#include "lib/vertex_record.h"

#define NO_PLACE 0xffffu // instead of a place in the list: the cell is not active
#define RELAX 0.7f // part of the mean gap that is made good: neighbours move too, so all of it would be too much
#define GAP_LATTICE 65536.0f // gaps are added up as whole numbers, whose sums do not depend on who adds first
#define GAP_LIMIT (1024.0f * GAP_LATTICE)

// Quads around LANES inner edges, one a column.
typedef struct {
    // Row corner, numbered as in edge_polygon: position from the region's low corner, 1/VERTEX_LATTICE cell; the cell's place
    // among the brick's active cells, NO_SUM for one of several sheets.
    int4 corner[4 * LANES];
    int4 edge[LANES];             // x, y, z from the brick's low corner, axis
    float low[LANES], high[LANES]; // samples at its ends, minus the isovalue
} Quads;

// Adds each quad's gap, from its middle to the crossing along its normal, to its cells' `sums`. `low`: the brick's low corner
// from the region's.
inline void add_gaps(const Quads *quads, uint count, float3 low, float3 spacing, __local int *sums) {
#pragma OPENCL FP_CONTRACT ON
#define LOAD_CORNER(k)                                                                                                 \
    real x##k, y##k, z##k;                                                                                             \
    {                                                                                                                  \
        integer x, y, z, cell;                                                                                         \
        load_vec4s(quads->corner + (k) * LANES, &x, &y, &z, &cell);                                                    \
        x##k = TO_REAL(x) / VERTEX_LATTICE - low.x;                                                                 \
        y##k = TO_REAL(y) / VERTEX_LATTICE - low.y;                                                                 \
        z##k = TO_REAL(z) / VERTEX_LATTICE - low.z;                                                                 \
    }
    LOAD_CORNER(0)
    LOAD_CORNER(1)
    LOAD_CORNER(2)
    LOAD_CORNER(3)
#undef LOAD_CORNER
    const real t = crossing_parameter(LOAD_LANES(quads->low), LOAD_LANES(quads->high));
    integer from_x, from_y, from_z, axis;
    load_vec4s(quads->edge, &from_x, &from_y, &from_z, &axis);
    // The normal is that of both diagonals.
    const real ax = (x3 - x0) * spacing.x, ay = (y3 - y0) * spacing.y, az = (z3 - z0) * spacing.z;
    const real bx = (x2 - x1) * spacing.x, by = (y2 - y1) * spacing.y, bz = (z2 - z1) * spacing.z;
    const real nx = ay * bz - az * by, ny = az * bx - ax * bz, nz = ax * by - ay * bx;
    const real length2 = nx * nx + ny * ny + nz * nz;
    const real dx = (TO_REAL(from_x) + PICK(axis == 0, t, 0.0f) - 0.25f * (x0 + x1 + x2 + x3)) * spacing.x;
    const real dy = (TO_REAL(from_y) + PICK(axis == 1, t, 0.0f) - 0.25f * (y0 + y1 + y2 + y3)) * spacing.y;
    const real dz = (TO_REAL(from_z) + PICK(axis == 2, t, 0.0f) - 0.25f * (z0 + z1 + z2 + z3)) * spacing.z;
    const real part = PICK(length2 > 0.0f, native_divide(dx * nx + dy * ny + dz * nz, length2), 0.0f);
    // Far from overflow for twelve edges a cell; only spacings of odd proportions come near it.
    const float3 per_spacing = GAP_LATTICE / spacing;
    float gap_x[LANES], gap_y[LANES], gap_z[LANES];
    STORE_LANES(clamp(part * nx * per_spacing.x, -GAP_LIMIT, GAP_LIMIT), gap_x);
    STORE_LANES(clamp(part * ny * per_spacing.y, -GAP_LIMIT, GAP_LIMIT), gap_y);
    STORE_LANES(clamp(part * nz * per_spacing.z, -GAP_LIMIT, GAP_LIMIT), gap_z);
    for (uint i = 0; i < LANES; i++) {
        if (i >= count) break;
        const int4 gap = convert_int4((float4)(gap_x[i], gap_y[i], gap_z[i], 0.0f));
        for (uint k = 0; k < 4; k++) add_offset(sums, (uint)quads->corner[k * LANES + i].w, gap);
    }
}

// Moves the vertices of a brick's active cells, `list` in Morton order (in_brick) and `place` by x + 8 y + 64 z, in
// `vertex_records`, where they and those of further sheets lie. `several`: cells of several sheets, whose vertices stay apart from
// each other where they are. Room: POSITIONS_CAPACITY in `at`, OFFSET_SUMS_CAPACITY in `sums`; `quads` 1176. To be called by all work-items.
inline void relax_cells(__local const float *tile, __local const ushort *signs_of_row, __local const ushort *list,
                        __local const ushort *place, __local const uint *several, uint count, __global const Region *region,
                        __global const Brick *brick, __global const Node *nodes, __global VertexRecord *vertex_records,
                        int3 in_region, float3 spacing, __local ushort *at, __local int *sums, __local ushort *quads,
                        __local uint *quad_count) {
    const uint lid = get_local_id(0), first = region->slot_base + brick->level_base[0];
    const float3 low = convert_float3(in_region);
    for (uint i = lid; i < count; i += BRICK_GROUP) {
        ushort4 position = vload4(0, vertex_records[first + i].position); // and the normal
        position.w = test_bit(several, i) ? NO_SUM : i;
        store_position(at, i, position);
        clear_offset_sum(sums, i);
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
    for (uint i = 0; i < 4 * LANES; i++) lanes.corner[i] = (int4)(0);
    for (uint i = 0; i < LANES; i++) {
        lanes.edge[i] = (int4)(0);
        lanes.low[i] = lanes.high[i] = 0.0f;
    }
    const uint total = *quad_count;
    for (uint begin = lid * LANES; begin < total; begin += BRICK_GROUP * LANES) {
        const uint run = min(total - begin, (uint)LANES);
        uint filled = 0;
        for (uint i = 0; i < LANES; i++) {
            if (i >= run) break;
            const uint quad = quads[begin + i], axis = quad >> 9, x = quad & 7, y = quad >> 3 & 7, z = quad >> 6 & 7;
            // The cells around the edge lie a step back along the other two axes.
            const uint b = axis == 0 ? 8 : axis == 1 ? 64 : 1, c = axis == 0 ? 64 : axis == 1 ? 1 : 8;
            __local const ushort *here = place + (quad & 511);
            const uint cells[4] = {here[0], here[-(int)b], here[-(int)c], here[-(int)(b + c)]};
            // Beyond the volume, and where samples are missing, there are no cells, and no quad.
            if ((cells[0] | cells[1] | cells[2] | cells[3]) == NO_PLACE) continue;
            const uint column = LANES == 1 ? 0 : filled;
            for (uint k = 0; k < 4; k++) {
                int4 corner = load_position(at, several, cells[k]);
                if (corner.w == NO_SUM) {
                    const VertexRecord sheet = vertex_records[sheet_in_brick(region, brick, nodes, first + cells[k], 4 * axis + k)];
                    corner = (int4)(sheet.position[0], sheet.position[1], sheet.position[2], NO_SUM);
                }
                lanes.corner[k * LANES + column] = corner;
            }
            lanes.edge[column] = (int4)((int)x, (int)y, (int)z, (int)axis);
            __local const float *v = tile + 81 * z + 9 * y + x;
            lanes.low[column] = v[0];
            lanes.high[column] = v[axis == 0 ? 1 : axis == 1 ? 9 : 81];
            filled++;
        }
        if (filled) add_gaps(&lanes, filled, low, spacing, sums);
    }
    barrier(CLK_LOCAL_MEM_FENCE);

    for (uint i = lid; i < count; i += BRICK_GROUP) {
        const int4 here = load_position(at, several, i);
        if (here.w == NO_SUM) continue;
        const float share = RELAX / GAP_LATTICE / (float)count_crossed(meta_signs(nodes[first + i].meta));
        const float3 lowest = low + convert_float3(listed_cell(list[i])) + MARGIN, highest = lowest + (1.0f - 2.0f * MARGIN);
        __global ushort *position = vertex_records[first + i].position;
        const float3 from = convert_float3(here.xyz) / VERTEX_LATTICE;
        const float3 to = clamp(from + convert_float3(load_offset_sum(sums, i).xyz) * share, lowest, highest);
        position[0] = to_lattice(to.x);
        position[1] = to_lattice(to.y);
        position[2] = to_lattice(to.z);
    }
}

#endif
