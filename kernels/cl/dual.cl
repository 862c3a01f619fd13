// dual: the mesher that is watertight by construction (docs/algorithm.md#6-dual-contouring-mesher). One vertex a leaf and sheet,
// one polygon for every minimal edge of the cut whose ends differ in sign, joining the leaves around it.
//
//   kernel      work-group    reads                    writes
//   dual_begin  a region      cut                      which bricks are *fine*; clears what dual_count marks
//   dual_count  a part        cut, nodes               triangles by level; edges that leaves emit a polygon around; slots, ghosts
//                                                      and border vertices whose vertices are used
//   dual_scan   a region      the above                compact index of each vertex; first triangle of each part and level
//   dual_emit   a part        the above, vertices      vertices and indices
//
// A *part* is a brick, for leaves of levels 0 to 3, or a region, for leaves of levels 4 and 5. Groups 0 to `brick_count` - 1 work
// on bricks, those behind them on regions.
//
// Which edges a leaf emits a polygon around depends on the kind of its part:
//
//   part        condition                            leaf                          edges                        polygon
//   all quads   plain, and away from the             cell                          crossed, at its low corner   plain_polygon
//               volume's faces
//   plain       no samples missing in the volume;    cell away from the faces      crossed, at its low corner   plain_polygon
//               all active cells here and in the     cell at a face                crossed, as edge_polygon     edge_polygon
//               26 bricks around are leaves                                        decides
//   mixed       any other brick                      levels 0 and 1                crossed, unless neighbours   edge_polygon
//                                                                                  emit (edges_of_neighbours)
//                                                    levels 2 and 3                crossed, as edge_polygon     edge_polygon
//                                                                                  decides
//   region      levels 4 and 5                       any                           crossed, as edge_polygon     edge_polygon
//                                                                                  decides
//   covered     a leaf of level 4 or 5 covers it     none
//
// dual_count counts most polygons without finding their corners. Of the edges above, it counts
//
//   part        at once                                               by find_polygon (edges go into a list first)
//   all quads   2 triangles each, all from Brick::quad_count          those on the region's boundary, for their ghosts alone
//   plain       2 each, of cells inside and not at the low faces of   all others
//               the region
//   mixed       levels 0 and 1, edges inside the region, no samples   all others
//               missing: 1 or 2 each (count_inner_polygon)
//   region      none                                                  all
//
// `parts` and `made_regions`: which parts and regions the groups of a launch work on. If a part of a surface is made again, those of
// other regions have no groups.
//
// plain_polygon: four cells, known without a search. edge_polygon: the leaves around are looked up (see lib/polygon.h).

#include "lib/args.h"
#include "lib/batch.h"
#include "lib/count_polygons.h"
#include "lib/cut.h"
#include "lib/device.h"
#include "lib/dual_device.h"
#include "lib/emit_polygons.h"
#include "lib/layout.h"
#include "lib/leaf_halo.h"
#include "lib/part.h"
#include "lib/polygon.h"
#include "lib/scan.h"
#include "lib/slots.h"
#include "lib/vertices.h"

// `fine`: of each brick, whether all its active cells are leaves.
__kernel __attribute__((reqd_work_group_size(GROUP, 1, 1)))
void dual_begin(__global const Region *regions, __global const Brick *bricks, __global const uchar *state,
                __global uchar *fine, __global uchar *used, __global uchar *used_elsewhere,
                __global uint *ghosts, __global uint *borders) {
    const uint lid = get_local_id(0), group = (uint)get_group_id(0);
    __global const Region *region = regions + group;
    const uint slots = region->slot_base, count = region->level_base[7];
    for (uint i = lid; i < count; i += GROUP) used[slots + i] = used_elsewhere[slots + i] = 0;
    for (uint i = lid; i < HALO_WORDS; i += GROUP) ghosts[group * HALO_WORDS + i] = borders[group * HALO_WORDS + i] = 0;
    const uint brick_count = count_bricks(region);
    for (uint b = lid; b < brick_count; b += GROUP) {
        __global const Brick *brick = bricks + region->brick_base + b;
        const uint first = slots + brick->level_base[1], level1_count = count_level1(brick);
        bool all_internal = true;
        for (uint i = 0; i < level1_count; i++) all_internal = all_internal && state[first + i] == INTERNAL;
        fine[region->brick_base + b] = all_internal;
    }
}

// Buffers: see Cut and Counts. `brick_triangles`: triangles of each part and level.
__kernel __attribute__((reqd_work_group_size(BRICK_GROUP, 1, 1)))
void dual_count(const DualCountArgs args, __global const uint *parts, __global const uint *region_index, __global const Region *regions,
                __global const Brick *bricks, __global const Node *nodes, __global const uchar *state, __global const uint *near,
                __global const uchar *fine, __global uchar *used, __global uchar *used_elsewhere, __global uint *emitted_edges,
                __global uint *brick_triangles, __global uint *ghosts, __global uint *borders) {
    const Grid grid = args.grid;
    const bool has_missing = args.has_missing;
    __local uint triangles[6], found_coarse, border_count, listed;
    __local ushort list[EDGE_LIST_CAPACITY], border[512];
    __local LeafHalo halo;
    const uint lid = get_local_id(0);
    Part part;
    find_part(&part, grid, args.brick_count, parts, regions, bricks, near);
    const Cut cut = {region_index, regions, bricks, nodes, state};
    const Counts counts = {used, used_elsewhere, emitted_edges, ghosts, borders, triangles};
    ROLLED for (uint i = lid; i < 6; i += BRICK_GROUP) triangles[i] = 0;
    classify_part(&part, grid, regions, bricks, state, fine, has_missing, &found_coarse);
    find_halo(&halo, &cut, &part, part.brick != NONE && !part.all_quads && !part.covered);
    count_all_quads(&cut, &part, &counts, border, &border_count);

    LeafWalk walk;
    begin_walk(&walk, part, regions + part.region, bricks);
    ROLLED while (walk.level < walk.end_level) {
        if (lid == 0) listed = 0;
        brick_barrier(CLK_LOCAL_MEM_FENCE);
        count_leaves(grid, &cut, &part, &halo, &counts, &walk, has_missing, border, border_count, list, &listed);
        brick_barrier(CLK_LOCAL_MEM_FENCE | CLK_GLOBAL_MEM_FENCE);
        ROLLED for (uint i = lid; i < listed; i += BRICK_GROUP) count_listed(grid, &cut, &part, &halo, &counts, list[i]);
        brick_barrier(CLK_LOCAL_MEM_FENCE);
    }
    ROLLED for (uint i = lid; i < part.levels; i += BRICK_GROUP) brick_triangles[part.counts + i] = triangles[part.finest + i];
}

// Adds up a region's triangles by level, and writes the first triangle of every part and level, counted from the region's first.
inline void scan_triangles(__global const Region *region, uint group, uint brick_count, __global const uint *brick_triangles,
                           __global uint *first_triangles, __global RegionMesh *meshes, __local uint *triangles) {
    const uint lid = get_local_id(0), first = region->brick_base, end = first + count_bricks(region);
    const uint top = 4 * brick_count + 2 * group - 4; // of the region's levels 4 and 5, less level 4
    for (uint level = lid; level < 6; level += GROUP) {
        uint sum = 0;
        if (level > 3) sum = brick_triangles[top + level];
        else for (uint b = first; b < end; b++) sum += brick_triangles[4 * b + level];
        triangles[level] = sum;
        meshes[group].triangles[level] = sum;
    }
    barrier(CLK_LOCAL_MEM_FENCE);
    for (uint level = lid; level < 6; level += GROUP) {
        uint before = 0;
        for (uint finer = 0; finer < level; finer++) before += triangles[finer];
        if (level > 3) first_triangles[top + level] = before;
        else for (uint b = first; b < end; b++) {
            first_triangles[4 * b + level] = before;
            before += brick_triangles[4 * b + level];
        }
    }
}

// `ghost_base`: index of the vertex of the first ghost of every word.
__kernel __attribute__((reqd_work_group_size(GROUP, 1, 1)))
void dual_scan(const uint brick_count, __global const uint *made_regions, __global const Region *regions, __global const uchar *used,
               __global const uchar *used_elsewhere, __global const uint *ghosts, __global const uint *borders,
               __global const uint *brick_triangles, __global uint *first_triangles, __global uint *compact_index,
               __global uint *ghost_base, __global RegionMesh *meshes) {
    __local uint scratch[GROUP], triangles[6], distinct_vertices;
    const uint lid = get_local_id(0), group = made_regions[get_group_id(0)];
    __global const Region *region = regions + group;
    if (lid == 0) distinct_vertices = 0;
    scan_triangles(region, group, brick_count, brick_triangles, first_triangles, meshes, triangles);

    const uint slots = region->level_base[7];
    uint vertices = 0, total, distinct = 0;
    for (uint begin = 0; begin < slots; begin += SLOTS_PER_ITEM * GROUP) {
        const uint first = begin + SLOTS_PER_ITEM * lid;
        uint own = 0; // one bit a slot
        for (uint i = 0; i < SLOTS_PER_ITEM; i++) {
            if (first + i >= slots) break;
            const uint slot = region->slot_base + first + i, here = used[slot];
            own |= here << i;
            distinct += here | used_elsewhere[slot];
        }
        const uint before = vertices + scan_group(scratch, popcount(own), &total);
        for (uint i = 0; i < SLOTS_PER_ITEM; i++) {
            if (first + i >= slots) break;
            compact_index[region->slot_base + first + i] = before + popcount(own & ((1u << i) - 1));
        }
        vertices += total;
    }
    for (uint word = lid; word < HALO_WORDS; word += GROUP) distinct += popcount(borders[group * HALO_WORDS + word]);
    if (distinct) atomic_add(&distinct_vertices, distinct);
    for (uint first = 0; first < HALO_WORDS; first += GROUP) {
        const bool inside = first + lid < HALO_WORDS;
        const uint word = group * HALO_WORDS + first + lid;
        const uint before = scan_group(scratch, inside ? popcount(ghosts[word]) : 0, &total);
        if (inside) ghost_base[word] = vertices + before;
        vertices += total;
    }
    barrier(CLK_LOCAL_MEM_FENCE);
    if (lid == 0) {
        meshes[group].vertices = vertices;
        meshes[group].distinct_vertices = distinct_vertices;
    }
}

// `corner_slots`: if wanted, the slot behind every index, for the stage `error`. For the stage `tree`, indices are numbers of points,
// and no vertices are written.
__kernel __attribute__((reqd_work_group_size(BRICK_GROUP, 1, 1)))
void dual_emit(const DualEmitArgs args, __global const uint *parts, __global const uint *region_index, __global const Region *regions,
               __global const Brick *bricks, __global const Node *nodes, __global const uchar *state, __global const uint *near,
               __global const uchar *fine, __global const VertexRecord *vertex_records, __global const uchar *used,
               __global const uint *emitted_edges, __global const uint *brick_triangles, __global const uint *first_triangles,
               __global const uint *compact_index, __global const uint *ghosts, __global const uint *ghost_base,
               __global const RegionMesh *meshes, __global Vertex *vertices, __global uint *indices, __global uint *corner_slots,
               __global const uint *borders, __global const uint *border_base, __global const TreeRegion *tree_regions,
               __global int4 *points) {
    const Grid grid = args.grid;
    __local uint first_triangle[6], scratch[BRICK_GROUP], found_coarse;
    __local ushort list[EDGE_LIST_CAPACITY];
    __local LeafHalo halo;
    Part part;
    find_part(&part, grid, args.brick_count, parts, regions, bricks, near);
    const Cut cut = {region_index, regions, bricks, nodes, state};
    const float3 scale = (float3)(grid.spacing[0], grid.spacing[1], grid.spacing[2]) / VERTEX_LATTICE;
    const TriangleOutput out = {scale, indices, args.corners == CORNERS_SLOTS, corner_slots};
    const MeshVertices mesh = {args.params, nodes, vertex_records, compact_index, ghosts, ghost_base,
                               vertices + meshes[part.region].vertex_base,
                               {args.corners == CORNERS_POINTS, borders, border_base, tree_regions, points}};
    // Of each level, less the triangles of the levels before, which `done` counts too.
    for (uint i = get_local_id(0); i < part.levels; i += BRICK_GROUP) {
        uint before = 0;
        for (uint finer = 0; finer < i; finer++) before += brick_triangles[part.counts + finer];
        first_triangle[part.finest + i] = meshes[part.region].triangle_base + first_triangles[part.counts + i] - before;
    }
    classify_part(&part, grid, regions, bricks, state, fine, args.has_missing, &found_coarse);
    find_halo(&halo, &cut, &part, part.brick != NONE && !part.all_quads && !part.covered);
    const bool from_table = VERTEX_TABLE && part.plain;
    if (!from_table) write_own_vertices(grid, &cut, &part, &mesh, used);

    Batch batch;
    batch.count = 0;
    for (uint i = 0; i < 4 * LANES; i++) batch.position_normal[i] = (int4)(0);
    uint done = 0, listed = 0;
    LeafWalk walk;
    begin_walk(&walk, part, regions + part.region, bricks);
    if (from_table) {
        listed = emit_plain_brick(grid, &cut, &part, &mesh, &out, used, first_triangle[0], &done, list);
        walk.level = walk.end_level;
    }
    while (listed || walk.level < walk.end_level) {
        listed = list_emitted_edges(grid, &cut, &part, &walk, emitted_edges, brick_triangles, listed, list, scratch);
        brick_barrier(CLK_LOCAL_MEM_FENCE);
        emit_listed(&batch, grid, &cut, &halo, &part, &mesh, &out, first_triangle, &done, list, listed, scratch);
        brick_barrier(CLK_LOCAL_MEM_FENCE);
        listed = 0;
    }
    if (batch.count) emit_batch(&batch, &out);
}
