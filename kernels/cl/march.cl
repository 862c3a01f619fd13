// march: the paper's mesher, marching cubes on every leaf (docs/algorithm.md#5-marching-cubes-mesher). One work-group a region.
//
//   kernel            computes
//   march_mark        which fine grid edges carry vertices (leaf.h: owners), and for leaves of level 1 and above the positions of
//                     the vertices on their edges (docs/algorithm.md#51-refinement)
//   march_count       vertices and triangles of each region
//   march_vertices    positions
//   march_triangles   indices

#include "lib/precision.h"
#include "lib/args.h"
#include "lib/cube.h"
#include "lib/grid.h"
#include "lib/layout.h"
#include "lib/leaf.h"
#include "lib/morton.h"
#include "lib/node.h"
#include "lib/samples.h"
#include "lib/scan.h"

// Binary search for a change of sign along an edge of a leaf. `low`: its low end in the volume; `sign`: of that sample; `length`:
// in cells. Returns the number of cells from `low` to the fine grid edge.
inline int refine_edge(Grid grid, SLAB, float iso, int3 low, int3 step, uint sign, int length) {
    int from = 0, to = length;
    while (to - from > 1) {
        const int middle = (from + to) / 2;
        const uint inside = sample_at(grid, SLAB_ARGS, low + step * middle) >= iso;
        if (inside == sign) from = middle;
        else to = middle;
    }
    return from;
}

// `owners`: zero before; `refined`: see refined_offset.
__kernel __attribute__((reqd_work_group_size(GROUP, 1, 1)))
void march_mark(const MarchArgs args, __global const SAMPLE *samples, __global const Region *regions,
                __global const Brick *bricks, __global const Node *nodes, __global const uchar *state,
                __global uint *owners, __global uint2 *refined) {
    const Grid grid = args.grid;
    const uint z0 = args.z0;
    __global const Region *region = regions + args.first_region + get_group_id(0);
    const int3 origin = convert_int3(region_origin(grid, region->region));
    const int3 last = clamp_sample(grid, origin + 32) - origin;
    for (uint i = get_local_id(0); i < region->level_base[6]; i += GROUP) {
        const uint slot = region->slot_base + i;
        const uint meta = nodes[slot].meta, code = meta_code(meta), level = code_level(code), signs = meta_signs(meta);
        if (state[slot] != level) continue;
        const int3 low = convert_int3(unmorton(code_cell(code, level)));
        uint2 offsets = (uint2)(0, 0);
        for (uint edge = 0; edge < 12; edge++) {
            if (!edge_crosses(signs, edge)) continue;
            const uint axis = edge >> 2;
            const int3 step = axis_step(axis);
            int3 at = cube_edge_low(low, level, edge, last);
            if (level > 0) {
                const uint sign = signs >> edge_low_corner(edge) & 1u;
                const int end = component(last - at, axis);
                const int from = refine_edge(grid, SLAB_ARGS, args.iso, origin + at, step, sign, min(1 << level, end));
                at += step * from;
                if (edge < 6) offsets.x |= (uint)from << (5 * edge);
                else offsets.y |= (uint)from << (5 * edge - 30);
            }
            uint owned;
            const uint owner = find_owner(region, bricks, at, axis, &owned);
            atomic_or(&owners[owner], 1u << owned);
        }
        refined[slot] = offsets;
    }
}

// Completes `owners` with the number of vertices before each cell. `cases`: the table, 16 bytes a case, number of triangles first.
__kernel __attribute__((reqd_work_group_size(GROUP, 1, 1)))
void march_count(__global const Region *regions, __global const Node *nodes, __global const uchar *state,
                 __constant uchar *cases, __global uint *owners, __global RegionMesh *meshes) {
    __local uint scratch[GROUP], triangles[6];
    const uint lid = get_local_id(0);
    __global const Region *region = regions + get_group_id(0);
    for (uint i = lid; i < 6; i += GROUP) triangles[i] = 0;
    barrier(CLK_LOCAL_MEM_FENCE);
    uint vertices = 0;
    for (uint first = 0; first < region->level_base[1]; first += GROUP) {
        const uint i = first + lid, slot = region->slot_base + i;
        const uint mask = i < region->level_base[1] ? owners[slot] : 0;
        uint total;
        const uint before = scan_group(scratch, popcount(mask), &total);
        if (i < region->level_base[1]) owners[slot] = mask | (vertices + before) << 12;
        vertices += total;
    }
    for (uint level = 0; level < 6; level++) {
        uint count = 0;
        for (uint i = region->level_base[level] + lid; i < region->level_base[level + 1]; i += GROUP) {
            const uint slot = region->slot_base + i;
            if (state[slot] == level) count += cases[16 * meta_signs(nodes[slot].meta)];
        }
        if (count) atomic_add(&triangles[level], count);
    }
    barrier(CLK_LOCAL_MEM_FENCE);
    __global RegionMesh *mesh = meshes + get_group_id(0);
    for (uint i = lid; i < 6; i += GROUP) mesh->triangles[i] = triangles[i];
    if (lid == 0) mesh->vertices = vertices;
}

__kernel __attribute__((reqd_work_group_size(GROUP, 1, 1)))
void march_vertices(const MarchArgs args, __global const SAMPLE *samples, __global const Region *regions,
                    __global const Node *nodes, __global const uint *owners, __global const RegionMesh *meshes,
                    __global WorkVertex *vertices) {
    const Grid grid = args.grid;
    const uint z0 = args.z0;
    const uint group = args.first_region + (uint)get_group_id(0);
    __global const Region *region = regions + group;
    const int3 origin = convert_int3(region_origin(grid, region->region));
    for (uint i = get_local_id(0); i < region->level_base[1]; i += GROUP) {
        const uint slot = region->slot_base + i, owner = owners[slot];
        if (!(owner & 0xfffu)) continue;
        const int3 cell = convert_int3(unmorton(code_cell(meta_code(nodes[slot].meta), 0)));
        __global WorkVertex *vertex = vertices + meshes[group].vertex_base + (owner >> 12);
        for (uint edge = 0; edge < 12; edge++) {
            if (!(owner >> edge & 1u)) continue;
            const uint axis = edge >> 2;
            const int3 low = cell + edge_offset(edge), step = axis_step(axis);
            const int t = crossing(args.iso, sample_at(grid, SLAB_ARGS, origin + low),
                                   sample_at(grid, SLAB_ARGS, origin + low + step));
            const int3 position = low * 65536 + step * t;
            vertex->position[0] = position.x;
            vertex->position[1] = position.y;
            vertex->position[2] = position.z;
            vertex->key = edge_key(low, axis);
            vertex++;
        }
    }
}

__kernel __attribute__((reqd_work_group_size(GROUP, 1, 1)))
void march_triangles(const Grid grid, __global const Region *regions, __global const Brick *bricks,
                     __global const Node *nodes, __global const uchar *state, __global const uint2 *refined,
                     __constant uchar *cases, __global const uint *owners, __global const RegionMesh *meshes,
                     __global uint *indices) {
    __local uint scratch[GROUP];
    const uint lid = get_local_id(0), group = (uint)get_group_id(0);
    __global const Region *region = regions + group;
    const int3 origin = convert_int3(region_origin(grid, region->region));
    const int3 last = clamp_sample(grid, origin + 32) - origin;
    uint done = 0;
    for (uint first = 0; first < region->level_base[6]; first += GROUP) {
        const uint i = first + lid, slot = region->slot_base + i;
        uint signs = 0, level = 0, code = 0, count = 0;
        if (i < region->level_base[6]) {
            const uint meta = nodes[slot].meta;
            code = meta_code(meta);
            level = code_level(code);
            signs = meta_signs(meta);
            if (state[slot] == level) count = cases[16 * signs];
        }
        uint total;
        const uint before = scan_group(scratch, count, &total);
        if (count) {
            const int3 low = convert_int3(unmorton(code_cell(code, level)));
            const uint2 offsets = level > 0 ? refined[slot] : (uint2)(0, 0);
            uint vertex[12];
            for (uint edge = 0; edge < 12; edge++) {
                if (!edge_crosses(signs, edge)) continue;
                const uint axis = edge >> 2;
                const int3 at = cube_edge_low(low, level, edge, last) + axis_step(axis) * refined_offset(offsets, edge);
                vertex[edge] = find_vertex(region, bricks, owners, at, axis);
            }
            __global uint *out = indices + 3 * (meshes[group].triangle_base + done + before);
            for (uint k = 0; k < 3 * count; k++) out[k] = vertex[cases[16 * signs + 1 + k]];
        }
        done += total;
    }
}
