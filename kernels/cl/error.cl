// error: distance of a dual mesh from the surface that it represents, in both directions (docs/algorithm.md#67-measured-error).
// Positions are in world units from the volume's first sample.
//
//   kernel            work-item              computes
//   error_positions   a slot                 position of each slot's vertex
//   error_leaves      a block, a corner      of a cut of the vertex tree: the vertex that replaces each slot's, positions of merged vertices;
//   error_corners                            the vertex of each corner
//   error_link        a corner               for each slot its fan: a chain of the corners of triangles at its vertex
//   error_seeds       a level-2 cube         a vertex in it that has triangles: a seed
//   error_regions     a region               one of its seeds
//   error_spread      a region of the grid   a seed near it, from those of 27 regions at a distance, which is halved by each launch
//   error_far         a brick                a seed for bricks without any in the 27 bricks around them
//   error_crossings   GROUP of a task        distances of crossings of lines through the cells to the mesh
//   error_samples     GROUP of a task        distances of vertices and of points on triangles to the surface
//
// A cut of the vertex tree also has vertices of nodes, numbered after the slots: the number of slots plus the node's number. `stand_ins`
// has the vertex that replaces that of each slot, or NONE if its part was removed; then its crossings are not measured.
//
// A task is a work-group's share of a region: some of its cells, or some of its triangles. The last two kernels write sums and the
// maximum of each task. All work is bounded by the numbers of slots, crossings and triangles.

#include "lib/precision.h"
#include "lib/args.h"
#include "lib/bits.h"
#include "lib/cell_lines.h"
#include "lib/crossing_distance.h"
#include "lib/cube.h"
#include "lib/device.h"
#include "lib/distances.h"
#include "lib/grid.h"
#include "lib/layout.h"
#include "lib/leaf.h"
#include "lib/mesh_distance.h"
#include "lib/morton.h"
#include "lib/node.h"
#include "lib/polygon.h"
#include "lib/sample_distance.h"
#include "lib/samples.h"
#include "lib/scan.h"
#include "lib/sheets.h"
#include "lib/slots.h"
#include "lib/surface_distance.h"
#include "lib/tree_leaf.h"
#include "lib/tree_node.h"
#include "lib/tree_offset.h"
#include "lib/triangle_samples.h"
#include "lib/vertices.h"

// `positions`: in w the diagonal of the vertex' cube, in which there is surface. One group a region.
__kernel __attribute__((reqd_work_group_size(GROUP, 1, 1)))
void error_positions(const ErrorPositionsArgs args, __global const Region *regions, __global const VertexRecord *vertex_records,
                     __global float4 *positions) {
    const Grid grid = args.grid;
    __global const Region *region = regions + args.first_region + get_group_id(0);
    const int3 origin = convert_int3(region_origin(grid, region->region));
    const float3 spacing = (float3)(grid.spacing[0], grid.spacing[1], grid.spacing[2]);
    const float diagonal = length(spacing);
    for (uint i = get_local_id(0); i < region->level_base[7]; i += GROUP) {
        const uint slot = region->slot_base + i;
        uint level = 0;
        if (i < region->level_base[6])
            while (level < 5 && i >= region->level_base[level + 1]) level++;
        const float3 x = convert_float3(lattice_position(grid, args.params, vertex_records[slot], origin)) / VERTEX_LATTICE;
        positions[slot] = (float4)(x * spacing, diagonal * (float)(1u << level));
    }
}

// `stand_ins`: of cells and extra sheets. `offset_sums`: of tree_relax. One group a block.
__kernel __attribute__((reqd_work_group_size(GROUP, 1, 1)))
void error_leaves(const ErrorLeavesArgs args, __global const Region *regions, __global const TreeRegion *tree_regions,
                  __global const TreeNode *tree_nodes, __global const uint2 *offset_sums, __global const int4 *points,
                  __global const uint *leaves, __global uint *stand_ins, __global float4 *positions) {
    const uint group = (uint)get_group_id(0);
    __global const TreeRegion *tree = tree_regions + group;
    TreePoints own;
    find_block_points(&own, regions, args.regions, tree_regions, group);
    for (uint i = get_local_id(0); i < own.count; i += GROUP) {
        const uint point = nth_point(own, i), slot = (uint)points[point].w;
        const uint leaf = leaf_number(leaves[point]);
        stand_ins[slot] = leaf < args.points ? slot : leaf == LEAF_REMOVED ? NONE : args.slots + leaf - args.points;
    }
    const float3 spacing = (float3)(args.grid.spacing[0], args.grid.spacing[1], args.grid.spacing[2]);
    for (uint i = get_local_id(0); i < tree->nodes; i += GROUP) {
        const TreeNode node = tree_nodes[tree->node_base + i];
        const int3 home = tree_node_origin(args.grid, regions, node);
        const int3 at = moved_position(args.grid, args.cap, node, home, offset_sums[tree->node_base + i]);
        const float3 x = convert_float3(at + home * (int)VERTEX_LATTICE) / VERTEX_LATTICE;
        positions[args.slots + tree->node_base + i] = (float4)(x * spacing, length(spacing) * (float)(1u << tree_level(node.meta)));
    }
}

__kernel void error_corners(const ErrorLeavesArgs args, const uint count, __global const int4 *points,
                            __global const uint *corner_leaves, __global uint *corner_slots) {
    const uint i = (uint)get_global_id(0);
    if (i >= count) return;
    const uint leaf = corner_leaves[i];
    if (leaf >= args.points) corner_slots[i] = args.slots + leaf - args.points;
    else corner_slots[i] = (uint)points[leaf].w | (leaf >= args.cell_points ? ON_BORDER : 0);
}

__kernel void error_link(const uint first, const uint count, __global const uint *corner_slots, __global uint *heads,
                         __global uint *next) {
    if (get_global_id(0) >= count) return;
    const uint i = first + (uint)get_global_id(0);
    next[i] = atomic_xchg(&heads[corner_slots[i] & ~ON_BORDER], i);
}

inline uint stand_in(__global const uint *stand_ins, uint has_stand_ins, uint slot) { return has_stand_ins ? stand_ins[slot] : slot; }

// The first of two slots that has triangles and lies nearer to `centre`; `best2`: squared distance of the one before.
inline uint nearer_slot(uint best, uint slot, __global const uint *heads, __global const float4 *positions, float3 centre,
                        float *best2) {
    if (slot == NONE || heads[slot] == NONE) return best;
    const float distance2 = distance2_of(positions[slot].xyz, centre);
    if (!(distance2 < *best2)) return best;
    *best2 = distance2;
    return slot;
}

// The seed of a level-2 cube of a brick in which leaves are of levels 0 to 2.
inline uint seed_of_cube(const ErrorSeedsArgs args, __global const Region *region, __global const Brick *bricks, uint index,
                         uint cube, __global const uchar *state, __global const uint *stand_ins, __global const uint *heads,
                         __global const float4 *positions) {
    __global const Brick *brick = bricks + index;
    const uint own = find_in_brick(region, bricks, index, 2, cube << 6);
    if (own == NONE) return NONE;
    const float3 low = convert_float3(region_origin(args.grid, region->region) + unmorton(brick->morton << 9 | cube << 6));
    const float3 centre = (low + 2.0f) * (float3)(args.grid.spacing[0], args.grid.spacing[1], args.grid.spacing[2]);
    uint best = NONE;
    float best2 = INFINITY;
    if (state[own] == 2) return nearer_slot(best, own, heads, positions, centre, &best2);
    for (uint one = 8 * cube; one < 8 * cube + 8; one++) {
        if (!test_bit64(brick->level1_mask[0], brick->level1_mask[1], one)) continue;
        const uint slot = find_in_brick(region, bricks, index, 1, one << 3);
        if (state[slot] == 1) {
            best = nearer_slot(best, slot, heads, positions, centre, &best2);
            continue;
        }
        const uint first = region->slot_base + brick->level_base[0] + cells_before_level1(brick, one);
        const uint count = popcount(level1_cells(brick, one));
        for (uint i = 0; i < count; i++)
            best = nearer_slot(best, stand_in(stand_ins, args.has_stand_ins, first + i), heads, positions, centre, &best2);
    }
    return best;
}

__kernel void error_seeds(const ErrorSeedsArgs args, __global const Region *regions, __global const Brick *bricks,
                          __global const uchar *state, __global const uint *stand_ins, __global const uint *heads,
                          __global const float4 *positions, __global uint *seeds) {
    const uint index = (uint)(get_global_id(0) / 8), cube = (uint)(get_global_id(0) % 8);
    if (index >= args.brick_count) return;
    __global const Region *region = regions + bricks[index].region;
    const uint level = state[find_in_brick(region, bricks, index, 3, 0)];
    uint seed = NONE;
    if (level == INTERNAL) seed = seed_of_cube(args, region, bricks, index, cube, state, stand_ins, heads, positions);
    else if (cube == 0) {
        const uint leaf = find_slot(region, bricks, level, bricks[index].morton << 9);
        if (heads[leaf] != NONE) seed = leaf;
    }
    seeds[get_global_id(0)] = seed;
}

// The seed nearest to a point among those of a region's bricks.
inline uint seed_in_region(__global const Region *region, __global const uint *seeds, __global const float4 *positions, float3 p) {
    uint best = NONE;
    float best2 = INFINITY;
    const uint first = 8 * region->brick_base, end = first + 8 * count_bricks(region);
    for (uint i = first; i < end; i++) {
        if (seeds[i] == NONE) continue;
        const float distance2 = distance2_of(positions[seeds[i]].xyz, p);
        if (distance2 < best2) {
            best2 = distance2;
            best = seeds[i];
        }
    }
    return best;
}

inline float3 region_centre(Grid grid, uint region) {
    return (convert_float3(region_origin(grid, region)) + 16.0f) * (float3)(grid.spacing[0], grid.spacing[1], grid.spacing[2]);
}

// `region_seeds`: by the region's number in the grid.
__kernel void error_regions(const ErrorSeedsArgs args, __global const Region *regions, __global const uint *seeds,
                            __global const float4 *positions, __global uint *region_seeds) {
    if (get_global_id(0) >= args.region_count) return;
    __global const Region *region = regions + get_global_id(0);
    region_seeds[region->region] = seed_in_region(region, seeds, positions, region_centre(args.grid, region->region));
}

// The nearest to `p` of the seeds of 27 regions, `step` regions apart.
inline uint seed_around(Grid grid, uint region, int step, __global const uint *region_seeds, __global const float4 *positions,
                        float3 p) {
    const int3 at = convert_int3(region_coords(grid, region));
    const int3 regions = (int3)((int)grid.regions[0], (int)grid.regions[1], (int)grid.regions[2]);
    uint best = NONE;
    float best2 = INFINITY;
    for (int k = 0; k < 27; k++) {
        const int3 other = at + ((int3)(k % 3, k / 3 % 3, k / 9) - 1) * step;
        if (any(other < 0) || any(other >= regions)) continue;
        const uint seed = region_seeds[(other.z * regions.y + other.y) * regions.x + other.x];
        if (seed == NONE) continue;
        const float distance2 = distance2_of(positions[seed].xyz, p);
        if (distance2 < best2) {
            best2 = distance2;
            best = seed;
        }
    }
    return best;
}

__kernel void error_spread(const ErrorSpreadArgs args, __global const float4 *positions, __global const uint *from,
                           __global uint *to) {
    const uint region = (uint)get_global_id(0);
    if (region >= args.grid.regions[0] * args.grid.regions[1] * args.grid.regions[2]) return;
    to[region] = seed_around(args.grid, region, (int)args.step, from, positions, region_centre(args.grid, region));
}

inline bool has_seed_near(uint brick, __global const uint *near, __global const uint *seeds) {
    for (uint i = 0; i < 27; i++) {
        const uint index = near[27 * brick + (i + 13) % 27];
        if (index == NONE) continue;
        for (uint cube = 0; cube < 8; cube++)
            if (seeds[8 * index + cube] != NONE) return true;
    }
    return false;
}

__kernel void error_far(const ErrorSeedsArgs args, __global const uint *region_index, __global const Region *regions,
                        __global const Brick *bricks, __global const uint *near, __global const float4 *positions,
                        __global const uint *seeds, __global const uint *region_seeds, __global uint *far) {
    const Grid grid = args.grid;
    const uint index = (uint)get_global_id(0);
    if (index >= args.brick_count) return;
    far[index] = NONE;
    if (has_seed_near(index, near, seeds)) return;
    const uint number = regions[bricks[index].region].region;
    const float3 spacing = (float3)(grid.spacing[0], grid.spacing[1], grid.spacing[2]);
    const float3 low = convert_float3(brick_origin(grid, number, bricks[index].morton));
    const float3 centre = (low + 4.0f) * spacing;
    const uint seed = seed_around(grid, number, 1, region_seeds, positions, centre);
    if (seed == NONE) return;
    // The region of that vertex has nearer ones, perhaps.
    const uint3 at = min(convert_uint3(positions[seed].xyz / spacing) >> 5,
                         (uint3)(grid.regions[0], grid.regions[1], grid.regions[2]) - 1);
    const uint other = region_index[(at.z * grid.regions[1] + at.y) * grid.regions[0] + at.x];
    const uint better = other == NONE ? NONE : seed_in_region(regions + other, seeds, positions, centre);
    far[index] = better == NONE ? seed : better;
}

// Of the sheets of a cell the slot of the one whose vertex is nearest to `p`.
inline uint nearest_sheet(__global const Region *region, __global const Brick *brick, __global const Node *nodes, uint slot,
                          __global const float4 *positions, float3 p) {
    if (!meta_extras(nodes[slot].meta)) return slot;
    uint best = slot;
    for (uint rest = crossed_edges(meta_signs(nodes[slot].meta)); rest; rest &= rest - 1) {
        const uint sheet = sheet_in_brick(region, brick, nodes, slot, lowest_bit(rest));
        if (distance2_of(positions[sheet].xyz, p) < distance2_of(positions[best].xyz, p)) best = sheet;
    }
    return best;
}

// `out`: of each task.
__kernel __attribute__((reqd_work_group_size(GROUP, 1, 1)))
void error_crossings(const ErrorCrossingsArgs args, __global const SAMPLE *samples, __global const ErrorTask *tasks,
                     __global const Region *regions, __global const Brick *bricks, __global const Node *nodes,
                     __global const uchar *state, __global const uint *stand_ins, __global const uint *near,
                     __global const uint *seeds, __global const uint *far, __global const uint *corner_slots,
                     __global const float4 *positions, __global const RegionMesh *meshes, __global const uint *indices,
                     __global const Vertex *vertices, __global const uint *heads, __global const uint *next,
                     __global ErrorSum *out) {
    const Grid grid = args.grid;
    const uint z0 = args.z0, number = args.first_task + (uint)get_group_id(0);
    __local float scratch[3 * GROUP];
    const MeshFans mesh = {regions, meshes, args.region_count, corner_slots, indices, vertices, positions, heads, next};
    const MeshSeeds from = {near, seeds, far};
    const ErrorTask task = tasks[number];
    __global const Region *region = regions + task.region;
    const int3 origin = convert_int3(region_origin(grid, region->region));
    Distances sums = {0.0f, 0.0f, 0.0f};
    Crossings crossings;
    crossings.count = 0;
    Pairs pairs;
    clear_pairs(&pairs);
    for (uint i = get_local_id(0); i < task.count; i += GROUP) {
        const uint slot = region->slot_base + task.first + i, meta = nodes[slot].meta;
        const uint cell = code_cell(meta_code(meta), 0), level = state[slot];
        const int3 at = convert_int3(unmorton(cell));
        const uint brick = region->brick_base + rank64(region->brick_mask[0], region->brick_mask[1], cell >> 9);
        const uint leaf = level > 0 ? find_slot(region, bricks, level, cell) : slot;
        CellOfLines lines = load_cell_of_lines(grid, SLAB_ARGS, args.iso, args.cap, origin + at);
        // Any cell may be the last one before missing samples.
        if (args.has_missing) lines.last = 7u;
        for (uint line = 0; line < 3 * LINES_OF_AXIS; line++) {
            const float4 p = cross_line(&lines, line / LINES_OF_AXIS, line % LINES_OF_AXIS);
            if (!(p.w >= 0.0f)) continue;
            const uint vertex = level > 0 ? leaf
                                          : stand_in(stand_ins, args.has_stand_ins,
                                                     nearest_sheet(region, bricks + brick, nodes, slot, positions, p.xyz));
            if (vertex == NONE) continue;
            collect_point(&crossings, p.xyz, p.w, vertex, level, brick);
            if (crossings.count == LANES) measure_crossings(&crossings, grid, &mesh, &from, bricks, &pairs, &sums);
        }
    }
    if (crossings.count) measure_crossings(&crossings, grid, &mesh, &from, bricks, &pairs, &sums);
    write_sums(scratch, sums, out + number);
}

// The vertices of a region that a task measures, as large a part as its triangles are: the first and the one after the last.
inline uint2 share_of_vertices(__global const RegionMesh *mesh, ErrorTask task) {
    uint triangles = 0;
    for (uint i = 0; i < 6; i++) triangles += mesh->triangles[i];
    const ulong vertices = mesh->vertices;
    return (uint2)((uint)(task.first * vertices / triangles), (uint)((task.first + task.count) * vertices / triangles));
}

__kernel __attribute__((reqd_work_group_size(GROUP, 1, 1)))
void error_samples(const ErrorSamplesArgs args, __global const SAMPLE *samples, __global const ErrorTask *tasks,
                   __global const uint *region_index, __global const Region *regions, __global const Brick *bricks,
                   __global const uint *corner_slots, __global const float4 *positions, __global const RegionMesh *meshes,
                   __global const uint *indices, __global const Vertex *vertices, __global ErrorSum *out) {
    const uint lid = get_local_id(0), number = args.first_task + (uint)get_group_id(0);
    __local float scratch[3 * GROUP];
    __local uint ends[GROUP];
    const MeshFans mesh = {regions, meshes, args.region_count, corner_slots, indices, vertices, positions, corner_slots,
                           corner_slots};
    SampledField field;
    field.grid = args.grid;
    field.region_index = region_index;
    field.bricks = bricks;
    field.samples = samples;
    field.z0 = args.z0;
    field.cap = args.cap;
    field.box = make_field_box(args.grid, args.iso, args.cap, args.first_layer, args.end_layer);
    const ErrorTask task = tasks[number];
    const uint first_triangle = meshes[task.region].triangle_base + task.first;
    TriangleSamples batch;
    clear_samples(&batch);
    Distances sums = {0.0f, 0.0f, 0.0f};
    for (uint chunk = 0; chunk < task.count; chunk += GROUP) {
        // Triangles have different numbers of samples: work-items share the samples, not the triangles.
        uint total, own = 0;
        if (chunk + lid < task.count) own = count_samples(&batch, field.grid, &mesh, 3 * (first_triangle + chunk + lid));
        ends[lid] = scan_group((__local uint *)scratch, own, &total) + own;
        barrier(CLK_LOCAL_MEM_FENCE);
        for (uint i = lid; i < total; i += GROUP) {
            const uint triangle = find_end(ends, i);
            const uint begin = triangle ? ends[triangle - 1] : 0;
            if (!add_sample(&batch, field.grid, &mesh, 3 * (first_triangle + chunk + triangle), i - begin,
                            ends[triangle] - begin, args.first_layer, args.end_layer))
                continue;
            if (batch.count == LANES) measure_samples(&field, &mesh, &batch, &sums);
        }
        barrier(CLK_LOCAL_MEM_FENCE);
    }
    const uint2 share = share_of_vertices(meshes + task.region, task);
    for (uint vertex = share.x + lid; vertex < share.y; vertex += GROUP) {
        const float3 x = vertex_in_cells(field.grid, &mesh, task.region, vertex);
        if (!add_point(&batch, field.grid, x, NONE, 0.0f, args.first_layer, args.end_layer)) continue;
        if (batch.count == LANES) measure_samples(&field, &mesh, &batch, &sums);
    }
    if (batch.count) measure_samples(&field, &mesh, &batch, &sums);
    write_sums(scratch, sums, out + number);
}
