// tree_mesh: meshes of cuts of the vertex tree (docs/algorithm.md#8-cuts-of-the-vertex-tree). One work-group a region: tree_sign and
// tree_emit an active region, tree_index and tree_vertices a region of the mesh, which may consist of several active ones.
//
//   kernel         writes
//   tree_sign      signatures of the regions' meshes
//   tree_emit      the triangles that tree_test found, between leaves
//   tree_index     indices of vertices in the region's mesh
//   tree_vertices  vertices

#include "lib/precision.h"
#include "lib/args.h"
#include "lib/cell_values.h"
#include "lib/device.h"
#include "lib/grid.h"
#include "lib/layout.h"
#include "lib/node.h"
#include "lib/scan.h"
#include "lib/tree_around.h"
#include "lib/tree_edges.h"
#include "lib/tree_leaf.h"
#include "lib/tree_node.h"
#include "lib/tree_offset.h"
#include "lib/vertices.h"

// Mixes the bits of a number: each bit of the result depends on all of them (S. Vigna, splitmix64).
INLINED ulong mix_bits(ulong bits) {
    bits += 0x9e3779b97f4a7c15ul;
    bits = (bits ^ bits >> 30) * 0xbf58476d1ce4e5b9ul;
    bits = (bits ^ bits >> 27) * 0x94d049bb133111ebul;
    return bits ^ bits >> 31;
}

// A signature of a leaf's vertex: of its number, and of the sums by which its position differs from cut to cut.
INLINED ulong sign_leaf(uint leaf, uint points, __global const uint2 *offset_sums) {
    const uint2 sums = leaf < points ? (uint2)(0, 0) : offset_sums[leaf - points];
    return mix_bits(mix_bits(leaf) ^ ((ulong)sums.y << 32 | sums.x));
}

// Adds up signatures of a region's triangles, so that their order does not count. Two words a region. The mesh of a region is the same in two
// cuts of one tree if its signature is, except with a probability of 10^-19. `left`: of tree_test. `cut_meshes`: the number of triangles.
__kernel __attribute__((reqd_work_group_size(WIDE_GROUP, 1, 1)))
void tree_sign(const uint points, __global const TreeRegion *tree_regions, __global const RegionMesh *meshes,
               __global const uint *corners, __global const uint *leaves, __global const uint *left,
               __global const RegionMesh *cut_meshes, __global const uint2 *offset_sums, __global uint2 *signatures) {
    __local uint low, high;
    const uint lid = get_local_id(0), group = (uint)get_group_id(0);
    const uint first = list_base(meshes + group, tree_regions + group), count = count_triangles(cut_meshes + group);
    CutView cut;
    cut.corners = corners;
    cut.leaves = leaves;
    if (lid == 0) low = high = 0;
    barrier(CLK_LOCAL_MEM_FENCE);
    uint own_low = 0, own_high = 0;
    for (uint i = lid; i < count; i += WIDE_GROUP) {
        CutTriangle triangle;
        nth_triangle(&triangle, &cut, left[first + i]);
        const ulong a = sign_leaf(triangle.a, points, offset_sums), b = sign_leaf(triangle.b, points, offset_sums);
        const ulong c = sign_leaf(triangle.c, points, offset_sums);
        const ulong bits = mix_bits(mix_bits(mix_bits(a + triangle.level) + b) + c);
        own_low += (uint)bits;
        own_high += (uint)(bits >> 32);
    }
    add_local(&low, own_low);
    add_local(&high, own_high);
    barrier(CLK_LOCAL_MEM_FENCE);
    if (lid == 0) signatures[group] = (uint2)(low, high);
}

// Writes a region's triangles by level, finest first, inside a level in the order of the full mesh. `left`: of tree_test. `level_starts`: of
// each region and level the place of the first triangle; NONE if the region is not made.
__kernel __attribute__((reqd_work_group_size(WIDE_GROUP, 1, 1)))
void tree_emit(__global const TreeRegion *tree_regions, __global const RegionMesh *meshes, __global const uint *corners,
               __global const uint *leaves, __global const uint *left, __global const RegionMesh *cut_meshes,
               __global const uint *level_starts, __global uint *cut_corners) {
    __local uint scratch[WIDE_GROUP];
    const uint lid = get_local_id(0), group = (uint)get_group_id(0);
    if (level_starts[6 * group] == NONE) return;
    const uint first = list_base(meshes + group, tree_regions + group);
    CutView cut;
    cut.corners = corners;
    cut.leaves = leaves;
    const uint count = count_triangles(cut_meshes + group);
    uint next[6];
    for (uint level = 0; level < 6; level++) next[level] = level_starts[6 * group + level];
    for (uint begin = 0; begin < count; begin += WIDE_GROUP) {
        CutTriangle triangle;
        triangle.level = NONE;
        if (begin + lid < count) nth_triangle(&triangle, &cut, left[first + begin + lid]);
#if WIDE_GROUP == 1
        (void)scratch;
        const uint to = next[triangle.level]++;
        vstore3((uint3)(triangle.a, triangle.b, triangle.c), to, cut_corners);
#else
        // Three levels a scan, 10 bits each.
        for (uint triple = 0; triple < 2; triple++) {
            uint total;
            const uint shift = triangle.level / 3 == triple ? 10 * (triangle.level % 3) : 32;
            const uint before = scan_group(scratch, shift < 32 ? 1u << shift : 0, &total);
            if (shift < 32)
                vstore3((uint3)(triangle.a, triangle.b, triangle.c), next[triangle.level] + (before >> shift & 1023u), cut_corners);
            for (uint i = 0; i < 3; i++) next[3 * triple + i] += total >> (10 * i) & 1023u;
        }
#endif
    }
}

#define LATER_CORNER 0x80000000u // instead of a vertex, the leaf's first corner

// Numbers the vertices of a region's corners in the order of these. `of`: cleared. Returns how many there are.
INLINED uint number_vertices(const LeafNumbers *of, __local uint *scratch, __global const uint *corners, uint count,
                             __global uint *indices, __global uint *vertex_leaves) {
    const uint lid = get_local_id(0);
    uint vertices = 0;
#if WIDE_GROUP == 1
    (void)lid, (void)scratch;
    for (uint i = 0; i < count; i++) {
        __global uint *vertex = number_of_leaf(of, corners[i]);
        if (*vertex == NONE) {
            *vertex = vertices;
            vertex_leaves[vertices++] = corners[i];
        }
        indices[i] = *vertex;
    }
#else
    for (uint i = lid; i < count; i += WIDE_GROUP) min_global(number_of_leaf(of, corners[i]), i);
    barrier(CLK_GLOBAL_MEM_FENCE);
    for (uint begin = 0; begin < count; begin += WIDE_GROUP) {
        const uint i = begin + lid;
        const uint corner = i < count ? *number_of_leaf(of, corners[i]) : NONE;
        const bool is_first = i < count && corner == i;
        uint total;
        const uint vertex = vertices + scan_group(scratch, is_first, &total);
        if (is_first) vertex_leaves[vertex] = corners[i];
        if (i < count) indices[i] = is_first ? vertex : corner | LATER_CORNER;
        vertices += total;
    }
    barrier(CLK_GLOBAL_MEM_FENCE);
    for (uint i = lid; i < count; i += WIDE_GROUP)
        if (indices[i] & LATER_CORNER) indices[i] = indices[indices[i] & ~LATER_CORNER];
#endif
    return vertices;
}

// `corner_regions`: of each region of the mesh, the number of its first active region, and the number in the grid of the region of 32^3 cells
// at its low corner. `own_numbers`: of all leaves; working memory, used for the leaves of the first active region. `table_leaves`,
// `table_numbers`: a hash table a region, from `table_bases` on, up to that of the next region; a power of two each. `vertex_leaves`: leaf of each vertex, from the region's first corner on.
__kernel __attribute__((reqd_work_group_size(WIDE_GROUP, 1, 1)))
void tree_index(const uint points, __global const Region *regions, __global const TreeRegion *tree_regions,
                __global const uint2 *corner_regions, __global const uint *table_bases, __global const uint *cut_corners,
                __global uint *own_numbers, __global uint *table_leaves, __global uint *table_numbers, __global uint *indices, __global uint *vertex_leaves,
                __global RegionMesh *cut_meshes) {
    __local uint scratch[WIDE_GROUP], others;
    const uint lid = get_local_id(0), group = (uint)get_group_id(0), first = 3 * cut_meshes[group].triangle_base;
    const uint own = corner_regions[group].x;
    LeafNumbers of;
    find_points(&of.own, regions + own, tree_regions + own);
    of.node_base = tree_regions[own].node_base;
    of.nodes = tree_regions[own].nodes;
    of.points = points;
    of.own_numbers = own_numbers;
    of.other_leaves = table_leaves + table_bases[group];
    of.other_numbers = table_numbers + table_bases[group];
    const uint count = 3 * count_triangles(cut_meshes + group);
    uint own_others = 0;
    if (lid == 0) others = 0;
    barrier(CLK_LOCAL_MEM_FENCE);
    // Clears only the entries in use: those of the first region's leaves among these corners.
    for (uint i = lid; i < count; i += WIDE_GROUP) {
        const uint leaf = cut_corners[first + i];
        if (is_own_leaf(&of, leaf)) own_numbers[leaf] = NONE;
        else own_others++;
    }
    add_local(&others, own_others);
    barrier(CLK_LOCAL_MEM_FENCE);
    // At least a quarter of the entries stay free.
    of.mask = others ? 0xffffffffu >> clz(others + others / 3) : 0;
    for (uint i = lid; i <= of.mask; i += WIDE_GROUP) of.other_leaves[i] = of.other_numbers[i] = NONE;
    barrier(CLK_GLOBAL_MEM_FENCE);
    const uint vertices = number_vertices(&of, scratch, cut_corners + first, count, indices + first, vertex_leaves + first);
    if (lid == 0) cut_meshes[group].vertices = vertices;
}

#define VERTICES_AHEAD 8 // vertices whose data is prefetched: without, a CPU waits for memory half of the time

__kernel __attribute__((reqd_work_group_size(WIDE_GROUP, 1, 1)))
void tree_vertices(const TreeVerticesArgs args, __global const uint *region_index, __global const Region *regions,
                   __global const Brick *bricks, __global const Node *nodes,
                   __global const VertexRecord *vertex_records, __global const TreeNode *tree_nodes, __global const int4 *points,
                   __global const uint2 *offset_sums, __global const uint2 *corner_regions, __global const RegionMesh *cut_meshes,
                   __global const uint *vertex_leaves, __global Vertex *vertices) {
    const Grid grid = args.grid;
    const uint group = (uint)get_group_id(0);
    const RegionMesh mesh = cut_meshes[group];
    const int3 origin = convert_int3(region_origin(grid, corner_regions[group].y));
    for (uint i = get_local_id(0); i < mesh.vertices; i += WIDE_GROUP) {
        const uint leaf = vertex_leaves[3 * mesh.triangle_base + i];
        // First the point or node, then the cell whose slot the point has.
        const uint far = vertex_leaves[3 * mesh.triangle_base + min(i + 2 * VERTICES_AHEAD, mesh.vertices - 1)];
        const uint near = vertex_leaves[3 * mesh.triangle_base + min(i + VERTICES_AHEAD, mesh.vertices - 1)];
        if (far < args.points) prefetch_line(points + far);
        else {
            prefetch_line(tree_nodes + far - args.points);
            prefetch_line(offset_sums + far - args.points);
        }
        if (near < args.points) {
            const uint slot = (uint)points[near].w;
            prefetch_line(nodes + slot);
            prefetch_line(vertex_records + slot);
        }
        Node node;
        uint normal;
        int3 at;
        if (leaf < args.points) {
            const int4 point = points[leaf];
            node = nodes[(uint)point.w];
            normal = vertex_records[(uint)point.w].normal;
            at = point.xyz - origin * (int)VERTEX_LATTICE;
        } else {
            const TreeNode merged = tree_nodes[leaf - args.points];
            const int3 home = tree_node_origin(grid, regions, merged);
            node.s = (float)(merged.normal_s >> 16) / 65535.0f;
            node.f = merged.f;
            normal = merged.normal_s & 0xffffu;
            const int3 in_volume = moved_position(grid, args.cap, merged, home, offset_sums[leaf - args.points])
                + home * (int)VERTEX_LATTICE;
            at = in_volume - origin * (int)VERTEX_LATTICE;
            node = with_values_at(grid, region_index, regions, bricks, nodes, node, in_volume);
        }
        vertices[mesh.vertex_base + i] = make_vertex(args.params, node, normal, at);
    }
}
