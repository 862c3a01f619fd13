// Phase of construct that relaxes the vertices of cells (docs/algorithm.md#64-vertex-relaxation): one Jacobi step that moves each
// vertex by RELAXATION times the mean offset, along the quads' normals, from the centroids of the quads around it to the
// crossings of their edges. Quads around edges inside the brick alone count, so that no brick waits for its neighbours.
#ifndef ISOPEEL_RELAX_H
#define ISOPEEL_RELAX_H

#include "lib/precision.h"
#include "lib/bits.h"
#include "lib/brick_task.h"
#include "lib/cell_solver.h"
#include "lib/cube.h"
#include "lib/device.h"
#include "lib/lanes.h"
#include "lib/layout.h"
#include "lib/node.h"
#include "lib/sheets.h"
#include "lib/trilinear.h"
#include "lib/vertex_record.h"

#define RELAXATION 0.7f // of the mean offset: neighbours move too, so that the whole of it would be too much
#define OFFSET_LATTICE 65536.0f // offsets are summed as integers, whose sum does not depend on the order
#define OFFSET_LIMIT (1024.0f * OFFSET_LATTICE)

// LANES quads around grid edges inside the brick, one a column.
typedef struct {
    // Row: corner in the order of edge_polygon. Position from the region's low corner, 1/VERTEX_LATTICE cell; index of the cell's
    // sum, NO_SUM for a cell with several sheets.
    int4 corner[4 * LANES];
    int4 edge[LANES]; // low end from the brick's low corner, x y z; axis
    float low[LANES], high[LANES]; // samples at its ends, minus the isovalue
} Quads;

// Corner `k` of the quads, in cells from the brick's low corner `low`.
INLINED Real3 quad_corner(const Quads *quads, uint k, float3 low) {
#pragma OPENCL FP_CONTRACT ON
    integer x, y, z, sum;
    load_vec4s(quads->corner + k * LANES, &x, &y, &z, &sum);
    return make_real3(TO_REAL(x) / VERTEX_LATTICE - low.x, TO_REAL(y) / VERTEX_LATTICE - low.y, TO_REAL(z) / VERTEX_LATTICE - low.z);
}

// Offsets of the quads, 1/OFFSET_LATTICE cell: from the centroid to the crossing, along the normal. `low`: the brick's low corner
// from the region's.
INLINED Real3 quad_offsets(const Quads *quads, float3 low, float3 spacing) {
#pragma OPENCL FP_CONTRACT ON
    const Real3 p0 = quad_corner(quads, 0, low), p1 = quad_corner(quads, 1, low);
    const Real3 p2 = quad_corner(quads, 2, low), p3 = quad_corner(quads, 3, low);
    const real t = crossing_parameter(LOAD_LANES(quads->low), LOAD_LANES(quads->high));
    integer from_x, from_y, from_z, axis;
    load_vec4s(quads->edge, &from_x, &from_y, &from_z, &axis);
    // The normal is the cross product of the diagonals.
    const real ax = (p3.x - p0.x) * spacing.x, ay = (p3.y - p0.y) * spacing.y, az = (p3.z - p0.z) * spacing.z;
    const real bx = (p2.x - p1.x) * spacing.x, by = (p2.y - p1.y) * spacing.y, bz = (p2.z - p1.z) * spacing.z;
    const Real3 n = make_real3(ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx);
    const real length2 = dot_real3(n, n);
    // From the centroid to the crossing.
    Real3 d;
    d.x = (TO_REAL(from_x) + PICK(axis == 0, t, 0.0f) - 0.25f * (p0.x + p1.x + p2.x + p3.x)) * spacing.x;
    d.y = (TO_REAL(from_y) + PICK(axis == 1, t, 0.0f) - 0.25f * (p0.y + p1.y + p2.y + p3.y)) * spacing.y;
    d.z = (TO_REAL(from_z) + PICK(axis == 2, t, 0.0f) - 0.25f * (p0.z + p1.z + p2.z + p3.z)) * spacing.z;
    const real part = PICK(length2 > 0.0f, native_divide(dot_real3(d, n), length2), 0.0f);
    // The limit is far from overflow for the twelve edges of a cell, and only spacings of extreme proportions come near it.
    const float3 scale = OFFSET_LATTICE / spacing;
    return make_real3(clamp(part * n.x * scale.x, -OFFSET_LIMIT, OFFSET_LIMIT), clamp(part * n.y * scale.y, -OFFSET_LIMIT, OFFSET_LIMIT),
                      clamp(part * n.z * scale.z, -OFFSET_LIMIT, OFFSET_LIMIT));
}

// Adds the offsets of the first `count` quads to the sums of their cells. A function of its own, not inlined everywhere, that a
// CPU calls with vectors in memory as they are.
inline void add_offsets(const Quads *quads, uint count, float3 low, float3 spacing, __local int *sums) {
    const Real3 offsets = quad_offsets(quads, low, spacing);
    float x[LANES], y[LANES], z[LANES];
    STORE_LANES(offsets.x, x);
    STORE_LANES(offsets.y, y);
    STORE_LANES(offsets.z, z);
    for (uint i = 0; i < LANES; i++) {
        if (i >= count) break;
        const int4 offset = convert_int4((float4)(x[i], y[i], z[i], 0.0f));
        for (uint k = 0; k < 4; k++) add_offset(sums, (uint)quads->corner[k * LANES + i].w, offset);
    }
}

// Copies the vertices of the cells to local memory; their sums are 0.
INLINED void load_positions(const BrickTask *task, const BrickMemory *memory) {
    const uint lid = get_local_id(0);
    for (uint i = lid; i < task->cell_count; i += BRICK_GROUP) {
        ushort4 position = vload4(0, task->vertex_records[task->cell_slots + i].position); // and the normal
        position.w = test_bit(memory->multi_sheet_mask, i) ? NO_SUM : i;
        store_position(memory->positions, i, position);
        clear_offset_sum(memory->offset_sums, i);
    }
    if (lid == 0) *memory->work_count = 0;
    barrier(CLK_LOCAL_MEM_FENCE);
}

// Lists the crossed edges with four cells of the brick around them, from rows of samples: y + 8 z, one bit a sample.
INLINED void list_inner_quads(const BrickMemory *memory) {
    __local const ushort *rows = memory->inside_rows;
    __local ushort *quads = memory->quad_list;
    for (uint i = get_local_id(0); i < 64; i += BRICK_GROUP) {
        const uint y = i & 7, z = i >> 3, row = 9 * z + y, here = rows[row];
        uint along_x = (here ^ here >> 1) & 0xffu, along_y = (here ^ rows[row + 1]) & 0xfeu;
        uint along_z = (here ^ rows[row + 9]) & 0xfeu;
        if (y == 0) along_x = along_z = 0;
        if (z == 0) along_x = along_y = 0;
        if (!(along_x | along_y | along_z)) continue;
        uint n = add_local(memory->work_count, popcount(along_x | along_y << 8 | along_z << 16));
        for (uint rest = along_x; rest; rest &= rest - 1) quads[n++] = (ushort)(i << 3 | lowest_bit(rest));
        for (uint rest = along_y; rest; rest &= rest - 1) quads[n++] = (ushort)(512 | i << 3 | lowest_bit(rest));
        for (uint rest = along_z; rest; rest &= rest - 1) quads[n++] = (ushort)(1024 | i << 3 | lowest_bit(rest));
    }
    barrier(CLK_LOCAL_MEM_FENCE);
}

// Puts the quad of a list entry into a column. Returns false where the quad does not exist: outside the volume and beside missing
// samples there are no cells.
INLINED bool gather_quad(const BrickTask *task, const BrickMemory *memory, Quads *quads, uint column, uint entry) {
    const uint axis = entry >> 9, x = entry & 7, y = entry >> 3 & 7, z = entry >> 6 & 7;
    // The cells around the edge lie a step back along the other two axes.
    const uint b = axis == 0 ? 8 : axis == 1 ? 64 : 1, c = axis == 0 ? 64 : axis == 1 ? 1 : 8;
    __local const ushort *here = memory->compact_index + (entry & 511);
    const uint cells[4] = {here[0], here[-(int)b], here[-(int)c], here[-(int)(b + c)]};
    // All bits are set if and only if one of them is NO_CELL: indices have nine bits.
    if ((cells[0] | cells[1] | cells[2] | cells[3]) == NO_CELL) return false;
    for (uint k = 0; k < 4; k++) {
        int4 corner = load_position(memory->positions, memory->multi_sheet_mask, cells[k]);
        if (corner.w == NO_SUM) {
            const uint slot = sheet_in_brick(task->region, task->brick, task->nodes, task->cell_slots + cells[k], 4 * axis + k);
            const VertexRecord sheet = task->vertex_records[slot];
            corner = (int4)(sheet.position[0], sheet.position[1], sheet.position[2], NO_SUM);
        }
        quads->corner[k * LANES + column] = corner;
    }
    quads->edge[column] = (int4)((int)x, (int)y, (int)z, (int)axis);
    __local const float *v = memory->tile + 81 * z + 9 * y + x;
    quads->low[column] = v[0];
    quads->high[column] = v[axis == 0 ? 1 : axis == 1 ? 9 : 81];
    return true;
}

// Sums the offsets of the listed quads, LANES at once.
INLINED void sum_offsets(const BrickTask *task, const BrickMemory *memory) {
    Quads quads;
    for (uint i = 0; i < 4 * LANES; i++) quads.corner[i] = (int4)(0);
    for (uint i = 0; i < LANES; i++) {
        quads.edge[i] = (int4)(0);
        quads.low[i] = quads.high[i] = 0.0f;
    }
    const float3 low = convert_float3(task->in_region);
    const uint count = *memory->work_count;
    for (uint begin = get_local_id(0) * LANES; begin < count; begin += BRICK_GROUP * LANES) {
        const uint run = min(count - begin, (uint)LANES);
        uint filled = 0;
        for (uint i = 0; i < LANES; i++) {
            if (i >= run) break;
            // Of one lane the column is known to the compiler, which keeps it in registers.
            if (gather_quad(task, memory, &quads, LANES == 1 ? 0 : filled, memory->quad_list[begin + i])) filled++;
        }
        if (filled) add_offsets(&quads, filled, low, task->spacing, memory->offset_sums);
    }
    barrier(CLK_LOCAL_MEM_FENCE);
}

// Moves the vertices of cells with one sheet, inside the cell less its margin.
INLINED void move_vertices(const BrickTask *task, const BrickMemory *memory) {
    const float3 low = convert_float3(task->in_region);
    for (uint i = get_local_id(0); i < task->cell_count; i += BRICK_GROUP) {
        const int4 here = load_position(memory->positions, memory->multi_sheet_mask, i);
        if (here.w == NO_SUM) continue;
        const uint slot = task->cell_slots + i;
        const float share = RELAXATION / OFFSET_LATTICE / (float)count_crossed(meta_signs(task->nodes[slot].meta));
        const float3 min_position = low + convert_float3(listed_cell(memory->cell_list[i])) + MARGIN;
        const float3 max_position = min_position + (1.0f - 2.0f * MARGIN);
        __global ushort *position = task->vertex_records[slot].position;
        const float3 from = convert_float3(here.xyz) / VERTEX_LATTICE;
        const float3 sum = convert_float3(load_offset_sum(memory->offset_sums, i).xyz);
        const float3 to = clamp(from + sum * share, min_position, max_position);
        position[0] = to_lattice(to.x);
        position[1] = to_lattice(to.y);
        position[2] = to_lattice(to.z);
    }
}

// Phase: relaxed vertices of the cells. Cells with several sheets keep theirs, which keeps the sheets apart.
INLINED void relax_cells(const BrickTask *task, const BrickMemory *memory) {
    load_positions(task, memory);
    list_inner_quads(memory);
    sum_offsets(task, memory);
    move_vertices(task, memory);
}

#endif
