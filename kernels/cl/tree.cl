// tree: the vertex tree, a binary hierarchy over the vertices of the full dual mesh (docs/algorithm.md#7-vertex-tree).
//
// A *point* is a vertex of that mesh: of a cell, of an extra sheet, or on a face of the volume. Points are numbered region by
// region, first those of cells and sheets of all regions (Region::point_base), then those on the volume's faces
// (TreeRegion::border_base). dual_emit writes triangles with these numbers.
//
//   kernel        work-group   writes
//   tree_borders  a region     numbers of the points on the volume's faces, how many
//   tree_points   a region     positions of points of cells and sheets; dual_emit writes the others
//   tree_gather   a region     how many triangles have a corner in the region; then these triangles
//   tree_build    a region     the nodes, the parents of nodes and points
//   tree_collapse a region     the node that each triangle collapses with
//
// In tree_build a region is a *block*: points merge with points of the same block alone, so that blocks do not wait for each other.

#include "lib/precision.h"
#include "lib/args.h"
#include "lib/device.h"
#include "lib/grid.h"
#include "lib/layout.h"
#include "lib/node.h"
#include "lib/octahedral.h"
#include "lib/scan.h"
#include "lib/slots.h"
#include "lib/tree_block.h"
#include "lib/tree_cluster.h"
#include "lib/tree_fans.h"
#include "lib/tree_leaf.h"
#include "lib/tree_rounds.h"
#include "lib/vertices.h"

#define MIN_PROGRESS 64 // the last round is the one that merges less than one in so many clusters

// Slot of a point of a cell or sheet of a region.
inline uint slot_of_point(__global const Region *region, uint point) {
    const uint cells = region->level_base[1];
    return region->slot_base + (point < cells ? point : region->level_base[6] + point - cells);
}

// `border_base`: of each word of `borders` the points before it in its region.
__kernel __attribute__((reqd_work_group_size(GROUP, 1, 1)))
void tree_borders(__global const uint *borders, __global uint *border_base, __global uint *border_counts) {
    __local uint scratch[GROUP];
    const uint lid = get_local_id(0), words = (uint)get_group_id(0) * HALO_WORDS;
    uint before = 0, total;
    for (uint first = 0; first < HALO_WORDS; first += GROUP) {
        const bool inside = first + lid < HALO_WORDS;
        const uint rank = before + scan_group(scratch, inside ? popcount(borders[words + first + lid]) : 0, &total);
        if (inside) border_base[words + first + lid] = rank;
        before += total;
    }
    if (lid == 0) border_counts[get_group_id(0)] = before;
}

__kernel __attribute__((reqd_work_group_size(GROUP, 1, 1)))
void tree_points(const TreePointsArgs args, __global const Region *regions, __global const VertexRecord *vertex_records,
                 __global int4 *points) {
    __global const Region *region = regions + get_group_id(0);
    const int3 origin = convert_int3(region_origin(args.grid, region->region));
    const uint count = count_cell_points(region);
    for (uint i = get_local_id(0); i < count; i += GROUP) {
        const uint slot = slot_of_point(region, i);
        points[region->point_base + i] = (int4)(lattice_position(args.grid, args.params, vertex_records[slot], origin), (int)slot);
    }
}

// Number in the block of a point of the surface, or that it is of another region.
inline uint block_corner(__global const Region *region, __global const TreeRegion *tree, uint cell_points, uint point) {
    if (point - region->point_base < cell_points) return point - region->point_base;
    if (point - tree->border_base < tree->border_points) return cell_points + point - tree->border_base;
    return point | FOREIGN;
}

// A polygon is emitted in the region of the last of its cells, so triangles of a region are in its own mesh and in those of six
// neighbours. `corners`: points of all triangles. `beside`: numbers of those of neighbours. `fill`: 0 counts, 1 writes.
__kernel __attribute__((reqd_work_group_size(GROUP, 1, 1)))
void tree_gather(const TreeGatherArgs args, __global const uint *region_index, __global const Region *regions,
                 __global const RegionMesh *meshes, __global const uint *corners, __global TreeRegion *tree_regions,
                 __global uint *triangles, __global uint *beside) {
    __local uint scratch[GROUP];
    const uint lid = get_local_id(0), group = args.first_region + (uint)get_group_id(0);
    __global const Region *region = regions + group;
    __global TreeRegion *tree = tree_regions + group;
    const uint3 coords = region_coords(args.grid, region->region);
    const uint cell_points = count_cell_points(region);
    uint found = 0, own = 0, total;
    for (uint n = 0; n < 7; n++) {
        const uint3 at = coords + (uint3)(n & 1, n >> 1 & 1, n >> 2);
        if (at.x >= args.grid.regions[0] || at.y >= args.grid.regions[1] || at.z >= args.grid.regions[2]) continue;
        const uint other = region_index[(at.z * args.grid.regions[1] + at.y) * args.grid.regions[0] + at.x];
        if (other == NONE) continue;
        const uint first = meshes[other].triangle_base, count = meshes[other].triangles[0];
        for (uint begin = 0; begin < count; begin += GROUP) {
            uint corner[3] = {FOREIGN, FOREIGN, FOREIGN};
            for (uint i = 0; i < 3; i++)
                if (begin + lid < count) corner[i] = block_corner(region, tree, cell_points, corners[3 * (first + begin + lid) + i]);
            const bool is_here = !(corner[0] & corner[1] & corner[2] & FOREIGN);
            const uint to = found + scan_group(scratch, is_here, &total);
            for (uint i = 0; i < 3; i++)
                if (is_here && args.fill) triangles[3 * (tree->triangle_base + to) + i] = corner[i];
            if (is_here && args.fill && n) beside[tree->beside_base + to - own] = first + begin + lid;
            found += total;
        }
        if (n == 0) own = found;
    }
    if (lid > 0) return;
    tree->triangle_count = found;
    tree->beside_count = found - own;
}

inline void add_plane(__global Quadric *q, float3 normal, float weight) {
    q->a[0] += weight * normal.x * normal.x;
    q->a[1] += weight * normal.x * normal.y;
    q->a[2] += weight * normal.x * normal.z;
    q->a[3] += weight * normal.y * normal.y;
    q->a[4] += weight * normal.y * normal.z;
    q->a[5] += weight * normal.z * normal.z;
}

// Adds the plane through the edge from a point on the border to `other`, at right angles to the triangle with this normal.
inline void add_border_plane(const TreeBlock *block, uint at, uint other, float3 normal) {
    const float3 edge = end_position(block, other).xyz - cluster_position(block, at);
    const float3 across = cross(edge, normal);
    const float length2 = dot(across, across);
    if (length2 > 0.0f)
        add_plane(&block->clusters[at].quadric, across, BORDER_WEIGHT * exact_quotient(dot(edge, edge), length2));
}

inline bool is_on_border(const TreeBuildArgs args, uint cell_points, uint at) {
    return at & FOREIGN ? (at & ~FOREIGN) >= args.cell_points : at >= cell_points;
}

// Flags of a point whose triangles lie like this. `beside`, `end`: its first and its last neighbour.
inline uint point_flags(const TreeBuildArgs args, uint kind, uint at, uint cell_points, uint beside, uint end, int3 position, int3 last) {
    if (at < cell_points) return kind == FAN_CLOSED ? 0 : CLUSTER_LOCKED;
    if (kind != FAN_OPEN || !is_on_border(args, cell_points, beside) || !is_on_border(args, cell_points, end)) return CLUSTER_LOCKED;
    const int3 on_face = (position == (int3)(0)) | (position == last * (int)VERTEX_LATTICE);
    return CLUSTER_BORDER | (on_face.x ? 1u : 0) | (on_face.y ? 2u : 0) | (on_face.z ? 4u : 0);
}

// What the triangles around a point say: its ring, its quadric, and whether it is on a border or may not merge. `last`: of the
// volume's samples.
INLINED void classify_point(const TreeBuildArgs args, const TreeBlock *block, const TreeFans *fans, uint at, uint cell_points,
                            int3 position, int3 last) {
    __global TreeCluster *cluster = block->clusters + at;
    __global TreeMembers *members = block->members + at;
    __global const uint *corners = fans->corners + cluster->ring_first;
    const uint count = cluster->ring_count, ring = cluster->ring_first + at;
    const float3 own = cluster_position(block, at);
    float3 begin_normal = (float3)(0.0f), end_normal = (float3)(0.0f);
    uint begin, end = NONE;
    const uint kind = make_ring(fans, corners, count, block->rings + ring, &begin, &end);
    for (uint i = 0; i < count; i++) {
        const uint before = fans->triangles[previous_corner(corners[i])];
        const float3 normal = cross(end_position(block, fans->triangles[next_corner(corners[i])]).xyz - own,
                                    end_position(block, before).xyz - own);
        const float length = sqrt(dot(normal, normal));
        if (length > 0.0f) add_plane(&cluster->quadric, normal, exact_quotient(1.0f, 6.0f * length));
        cluster->quadric.k += length / 6.0f;
        if (i == begin) begin_normal = normal;
        if (before == end) end_normal = normal;
    }
    const float area = cluster->quadric.k;
    members->s *= area;
    members->f *= area;
    for (uint i = 0; i < 3; i++) members->normal[i] *= area;
    const uint beside = kind == FAN_OPEN ? block->rings[ring] : NONE;
    const uint flags = point_flags(args, kind, at, cell_points, beside, end, position, last);
    if (flags & CLUSTER_BORDER) {
        add_border_plane(block, at, beside, begin_normal);
        add_border_plane(block, at, end, end_normal);
    }
    // Others still read the position, which the flags will be beside.
    block->best[at] = flags;
    cluster->ring_first = ring;
    cluster->ring_count = flags & CLUSTER_LOCKED ? 0 : count + (flags & CLUSTER_BORDER ? 1 : 0);
}

// A point as a cluster, but for what its triangles say.
INLINED void begin_cluster(const TreeBlock *block, __global const Node *nodes, __global const VertexRecord *vertex_records, uint at,
                           int4 point) {
    __global TreeMembers *members = block->members + at;
    const Node node = nodes[(uint)point.w];
    const float3 position = convert_float3(point.xyz - block->origin * (int)VERTEX_LATTICE) * block->scale;
    const float3 normal = decode_octahedral8(vertex_records[(uint)point.w].normal);
    block->clusters[at].quadric = no_quadric();
    block->positions[at] = (float4)(position, 0.0f);
    members->normal[0] = normal.x;
    members->normal[1] = normal.y;
    members->normal[2] = normal.z;
    members->s = node.s;
    members->f = node.f;
    members->node = NONE;
    // Of an extra sheet, the code is that of its cell.
    members->extent = extent_of_cell(unmorton(code_cell(meta_code(node.meta), 0)));
    block->alive[at] = at;
    block->partners[at] = at;
}

// Working memory: of the launch's regions. `rings`: two a region, `edges` beside them; the second one holds the corners around each
// point at first. `lists`: three numbers a cluster. `tree_nodes`: from TreeRegion::node_base on; `round_ends`: how many of them there
// are after each round.
__kernel __attribute__((reqd_work_group_size(GROUP, 1, 1)))
void tree_build(const TreeBuildArgs args, __global const Region *regions, __global const Node *nodes,
                __global const VertexRecord *vertex_records, __global const int4 *points, __global TreeRegion *tree_regions,
                __global const uint *triangles, __global uint *rings, __global float4 *edges, __global TreeCluster *clusters,
                __global TreeMembers *members, __global float4 *positions, __global uint *lists, __global TreeNode *tree_nodes,
                __global uint *node_errors, __global uchar *node_levels, __global uint *node_parents, __global uint *point_parents, __global uint *round_ends) {
    __local uint scratch[GROUP];
    const uint lid = get_local_id(0), group = args.first_region + (uint)get_group_id(0);
    const Grid grid = args.grid;
    __global const Region *region = regions + group;
    __global TreeRegion *tree = tree_regions + group;
    TreePoints own;
    find_points(&own, region, tree);
    const uint cell_points = own.count, count = count_points(own);
    const uint entries = 3 * tree->triangle_count + count, entry_base = 2 * (3 * tree->triangle_base + tree->cluster_base);
    const int3 last = (int3)((int)grid.dims[0], (int)grid.dims[1], (int)grid.dims[2]) - 1;
    TreeBlock block;
    block.clusters = clusters + tree->cluster_base;
    block.members = members + tree->cluster_base;
    block.positions = positions + tree->cluster_base;
    block.rings = rings + entry_base;
    block.next_rings = block.rings + entries;
    block.edges = edges + entry_base;
    block.next_edges = block.edges + entries;
    block.alive = lists + 3 * tree->cluster_base;
    block.best = block.alive + count;
    block.partners = block.best + count;
    block.points = points;
    block.origin = convert_int3(region_origin(grid, region->region));
    block.scale = (float3)(grid.spacing[0], grid.spacing[1], grid.spacing[2]) / VERTEX_LATTICE;
    block.alive_count = count;
    TreeFans fans;
    fans.triangles = triangles + 3 * tree->triangle_base;
    fans.triangle_count = tree->triangle_count;
    fans.corners = block.next_rings;
    for (uint i = lid; i < count; i += GROUP) {
        const uint point = nth_point(own, i);
        begin_cluster(&block, nodes, vertex_records, i, points[point]);
        point_parents[point] = NONE;
    }
    make_fans(&block, &fans, scratch);
    for (uint i = lid; i < count; i += GROUP)
        classify_point(args, &block, &fans, i, cell_points, points[nth_point(own, i)].xyz, last);
    barrier(CLK_GLOBAL_MEM_FENCE);
    for (uint i = lid; i < count; i += GROUP) block.positions[i].w = as_float(block.best[i]);
    barrier(CLK_GLOBAL_MEM_FENCE);
    float area = 0.0f;
    if (lid == 0)
        for (uint i = 0; i < count; i++) area += block.clusters[i].quadric.k;

    TreeOutput out;
    out.nodes = tree_nodes;
    out.node_errors = node_errors;
    out.node_levels = node_levels;
    out.node_parents = node_parents;
    out.point_parents = point_parents + region->point_base;
    out.border_parents = point_parents + tree->border_base;
    out.cell_points = cell_points;
    out.region = group;
    out.node_base = tree->node_base;
    const int3 margin = (int3)(args.params.cap ? 1 : 0);
    out.low = max((int3)(0), (margin - block.origin) * (int)VERTEX_LATTICE);
    out.high = min((int3)(32), last - margin - block.origin) * (int)VERTEX_LATTICE;
    out.per_length = exact_quotient(1.0f, fmin(fmin(grid.spacing[0], grid.spacing[1]), grid.spacing[2]));
    uint node_count = 0, rounds = 0;
    while (rounds < TREE_ROUNDS) {
        find_pairs(&block);
        const uint merged = commit_pairs(&block, &out, node_count, scratch), before = block.alive_count;
        node_count += merged;
        if (lid == 0) round_ends[TREE_ROUNDS * group + rounds] = node_count;
        rounds++;
        compact_block(&block, scratch);
        if (merged * MIN_PROGRESS < before || merged == 0) break;
    }
    if (lid > 0) return;
    tree->nodes = node_count;
    tree->rounds = rounds;
    tree->area = area;
}

// The lowest node above two corners of a triangle, or NONE: a cut that merges it has no such triangle.
inline uint collapsing_node(__global const uint *node_parents, uint a, uint b, uint c) {
    // A node's number is above those of the nodes below it, NONE above all: the lowest of three is not above where any two meet.
    while (a != b && b != c && c != a) {
        if (a < b && a < c) a = node_parents[a];
        else if (b < c) b = node_parents[b];
        else c = node_parents[c];
    }
    return a == b ? a : c;
}

__kernel __attribute__((reqd_work_group_size(GROUP, 1, 1)))
void tree_collapse(__global const RegionMesh *meshes, __global const uint *corners, __global const uint *point_parents,
               __global const uint *node_parents, __global uint *collapsed_by) {
    const RegionMesh mesh = meshes[get_group_id(0)];
    for (uint i = get_local_id(0); i < mesh.triangles[0]; i += GROUP) {
        const uint triangle = mesh.triangle_base + i;
        __global const uint *at = corners + 3 * triangle;
        collapsed_by[triangle] =
            collapsing_node(node_parents, point_parents[at[0]], point_parents[at[1]], point_parents[at[2]]);
    }
}
