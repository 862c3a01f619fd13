// Phase of construct that relaxes the vertices of cells (docs/algorithm.md#64-vertex-relaxation): one Jacobi step that moves each
// vertex by RELAXATION times the weighted mean of the offsets, along the quads' normals, from the centroids of the quads around it to
// the crossings of their edges. Quads around edges on the brick's side count as offsets of 0, so that no brick waits for its neighbours.
#ifndef ISOPEEL_RELAX_H
#define ISOPEEL_RELAX_H

#include "lib/precision.h"
#include "lib/bits.h"
#include "lib/brick_task.h"
#include "lib/cell_solver.h"
#include "lib/construct_device.h"
#include "lib/cube.h"
#include "lib/device.h"
#include "lib/lanes.h"
#include "lib/layout.h"
#include "lib/node.h"
#include "lib/sheets.h"
#include "lib/trilinear.h"
#include "lib/vertex_record.h"

#define RELAXATION 0.5f // of the mean offset: neighbours move too, so that the whole of it would be too much
#define OFFSET_WEIGHT 0.1f // an offset weighs as much as this and its length in cells: a crest is one large offset among small ones
#define OFFSET_LATTICE 2048.0f // sums are of integers, which do not depend on the order; of twelve edges they fit 16 bits

INLINED float sum3(float4 v) { return v.x + v.y + v.z; }

// From the centroid of a quad to the crossing of its edge, along the quad's normal, in world units. `p`: its corners in the order of
// edge_polygon, `crossing`: likewise in 1/VERTEX_LATTICE cell from one origin; `unit`: of these.
INLINED float4 quad_offset(float4 p0, float4 p1, float4 p2, float4 p3, float4 crossing, float4 unit) {
#pragma OPENCL FP_CONTRACT ON
    // The normal is the cross product of the diagonals.
    const float4 a = (p3 - p0) * unit, b = (p2 - p1) * unit, n = a.yzxw * b.zxyw - a.zxyw * b.yzxw;
    const float4 d = (crossing - 0.25f * ((p0 + p1) + (p2 + p3))) * unit;
    const float length2 = sum3(n * n), along = sum3(d * n);
    return n * (length2 > 0.0f ? native_divide(along, length2) : 0.0f);
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
    brick_barrier(CLK_LOCAL_MEM_FENCE);
}

// The vertex of a sheet of a cell of several, as load_position has it.
inline int4 sheet_position(const BrickTask *task, uint cell, uint edge) {
    const uint slot = sheet_in_brick(task->region, task->brick, task->nodes, task->cell_slots + cell, edge);
    const VertexRecord sheet = task->vertex_records[slot];
    return (int4)(sheet.position[0], sheet.position[1], sheet.position[2], NO_SUM);
}

// Parameter of the crossing between two samples minus the isovalue; 1/2 if both are infinite.
INLINED float sample_crossing(float from, float to) {
    const float t = native_divide(from, from - to);
    return t == t ? clamp(t, 0.0f, 1.0f) : 0.5f;
}

// An offset in cells, of one at most, by its weight, and in w its length: the part of the weight that differs between offsets.
INLINED int4 weighted_offset(float4 offset) {
    const float length = sqrt(sum3(offset * offset)), limited = fmin(length, 1.0f);
    const float weight = (OFFSET_WEIGHT + limited) * (length > 1.0f ? native_divide(1.0f, length) : 1.0f);
    return convert_int4_rte(OFFSET_LATTICE * (float4)(weight * offset.xyz, limited));
}

// Adds the offset of the quad of a list entry to the sums of its cells, if the quad exists: outside the volume and beside missing
// samples there are no cells.
INLINED void add_quad_offset(const BrickTask *task, const BrickMemory *memory, uint entry, float4 low, float4 unit, float4 scale) {
    const uint axis = entry >> 9, x = entry & 7, y = entry >> 3 & 7, z = entry >> 6 & 7;
    // The cells around the edge lie a step back along the other two axes.
    const uint b = axis == 0 ? 8 : axis == 1 ? 64 : 1, c = axis == 0 ? 64 : axis == 1 ? 1 : 8;
    __local const ushort *here = memory->compact_index + (entry & 511);
    const uint c0 = here[0], c1 = here[-(int)b], c2 = here[-(int)c], c3 = here[-(int)(b + c)];
    // All bits are set if and only if one of them is NO_CELL: indices have nine bits.
    if ((c0 | c1 | c2 | c3) == NO_CELL) return;
    int4 p0 = load_position(memory->positions, memory->multi_sheet_mask, c0);
    int4 p1 = load_position(memory->positions, memory->multi_sheet_mask, c1);
    int4 p2 = load_position(memory->positions, memory->multi_sheet_mask, c2);
    int4 p3 = load_position(memory->positions, memory->multi_sheet_mask, c3);
    if ((p0.w | p1.w | p2.w | p3.w) & NO_SUM) {
        if (p0.w == NO_SUM) p0 = sheet_position(task, c0, 4 * axis);
        if (p1.w == NO_SUM) p1 = sheet_position(task, c1, 4 * axis + 1);
        if (p2.w == NO_SUM) p2 = sheet_position(task, c2, 4 * axis + 2);
        if (p3.w == NO_SUM) p3 = sheet_position(task, c3, 4 * axis + 3);
    }
    __local const float *v = memory->tile + 81 * z + 9 * y + x;
    const float t = VERTEX_LATTICE * sample_crossing(v[0], v[axis == 0 ? 1 : axis == 1 ? 9 : 81]);
    const float4 crossing = low + VERTEX_LATTICE * convert_float4((int4)((int)x, (int)y, (int)z, 0))
        + (float4)(axis == 0 ? t : 0.0f, axis == 1 ? t : 0.0f, axis == 2 ? t : 0.0f, 0.0f);
    const float4 offset = quad_offset(convert_float4(p0), convert_float4(p1), convert_float4(p2), convert_float4(p3), crossing, unit);
    const int4 weighted = weighted_offset(offset * scale);
    add_offset(memory->offset_sums, (uint)p0.w, weighted);
    add_offset(memory->offset_sums, (uint)p1.w, weighted);
    add_offset(memory->offset_sums, (uint)p2.w, weighted);
    add_offset(memory->offset_sums, (uint)p3.w, weighted);
}

// Sums the offsets of the listed quads.
INLINED void sum_offsets(const BrickTask *task, const BrickMemory *memory) {
    const float4 low = (float4)(convert_float3(task->in_region) * VERTEX_LATTICE, 0.0f);
    const float4 unit = (float4)(task->spacing / VERTEX_LATTICE, 0.0f), scale = (float4)(1.0f / task->spacing, 0.0f);
    const uint count = *memory->work_count;
    for (uint i = get_local_id(0); i < count; i += BRICK_GROUP)
        add_quad_offset(task, memory, memory->quad_list[i], low, unit, scale);
    brick_barrier(CLK_LOCAL_MEM_FENCE);
}

// Moves the vertices of cells with one sheet, inside the cell less its margin.
INLINED void move_vertices(const BrickTask *task, const BrickMemory *memory) {
    const int lattice = (int)VERTEX_LATTICE;
    const float4 margin = (float4)(MARGIN * VERTEX_LATTICE);
    for (uint i = get_local_id(0); i < task->cell_count; i += BRICK_GROUP) {
        const int4 here = load_position(memory->positions, memory->multi_sheet_mask, i);
        if (here.w == NO_SUM) continue;
        const uint slot = task->cell_slots + i;
        const float4 sum = convert_float4(load_offset_sum(memory->offset_sums, i));
        const float weights = OFFSET_WEIGHT * OFFSET_LATTICE * (float)count_crossed(meta_signs(task->nodes[slot].meta)) + sum.w;
        const float4 offset = (float4)(sum.xyz, 0.0f) * (RELAXATION * VERTEX_LATTICE / weights);
        const float4 low = convert_float4(here & -lattice); // of the cell, whose vertex lies inside
        const float4 to = clamp(convert_float4(here) + offset, low + margin, low + VERTEX_LATTICE - margin);
        const int4 on_lattice = convert_int4(to + 0.5f);
        __global ushort *position = task->vertex_records[slot].position;
        position[0] = (ushort)on_lattice.x;
        position[1] = (ushort)on_lattice.y;
        position[2] = (ushort)on_lattice.z;
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
