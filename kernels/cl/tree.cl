// tree: the vertex tree, a binary hierarchy over the vertices of the full dual mesh (docs/algorithm.md#7-vertex-tree).
//
// A *point* is a vertex of that mesh: of a cell, of an extra sheet, or on a face of the volume. Points are numbered region by
// region, first those of cells and sheets of all regions (Region::point_base), then those on the volume's faces
// (TreeRegion::border_base). dual_emit writes triangles with these numbers.
//
// One work-group a region; of tree_gather, a block. tree_build.cl makes the nodes.
//
//   kernel         writes
//   tree_borders   numbers of the points on the volume's faces, how many
//   tree_points    positions of points of cells and sheets; dual_emit writes the others
//   tree_gather    how many triangles have a corner in the block; then these triangles
//   tree_collapse  the node that each triangle collapses with
//   tree_corners   the corners of the full mesh at each point
//   tree_lives     the rounds during which each leaf of a region existed while the tree was built

#include "lib/precision.h"
#include "lib/args.h"
#include "lib/device.h"
#include "lib/grid.h"
#include "lib/layout.h"
#include "lib/node.h"
#include "lib/scan.h"
#include "lib/slots.h"
#include "lib/tree_block.h"
#include "lib/tree_leaf.h"
#include "lib/vertices.h"

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

// Number of a point of the surface in the block, or FOREIGN with its number if it belongs to another region.
inline uint block_corner(__global const Region *region, __global const TreeRegion *tree, uint cell_points, uint point) {
    if (point - region->point_base < cell_points) return point - region->point_base;
    if (point - tree->border_base < tree->border_points) return cell_points + point - tree->border_base;
    return point | FOREIGN;
}

#if GROUP == 1
// Whether one of the corners of 16 triangles is a point of the region.
inline bool any_corner_here(__global const uint *corners, __global const Region *region, __global const TreeRegion *tree,
                            uint cell_points) {
    int16 here = 0;
    for (uint i = 0; i < 3; i++) {
        const uint16 points = vload16(i, corners);
        here |= (points - region->point_base < cell_points) | (points - tree->border_base < tree->border_points);
    }
    const int8 eight = here.lo | here.hi;
    const int4 four = eight.lo | eight.hi;
    const int2 two = four.lo | four.hi;
    return (two.x | two.y) != 0;
}
#endif

// A polygon is emitted in the region of the last of its cells, so triangles of a region are in its own mesh and in those of six
// neighbours. `corners`: points of all triangles. `beside`: numbers of those of neighbours. `fill`: 0 counts, 1 writes, 2 writes without
// `beside`. The same holds in blocks of a level above, with clusters for points.
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
#if GROUP == 1
            // Skips most of the triangles of other regions.
            while (begin % 16 == 0 && begin + 16 <= count && n > 0 && !any_corner_here(corners + 3 * (first + begin), region, tree, cell_points))
                begin += 16;
            if (begin == count) break;
#endif
            uint corner[3] = {FOREIGN, FOREIGN, FOREIGN};
            for (uint i = 0; i < 3; i++)
                if (begin + lid < count) corner[i] = block_corner(region, tree, cell_points, corners[3 * (first + begin + lid) + i]);
            const bool is_here = !(corner[0] & corner[1] & corner[2] & FOREIGN);
            const uint to = found + scan_group(scratch, is_here, &total);
            for (uint i = 0; i < 3; i++)
                if (is_here && args.fill) triangles[3 * (tree->triangle_base + to) + i] = corner[i];
            if (is_here && args.fill == 1 && n) beside[tree->beside_base + to - own] = first + begin + lid;
            found += total;
        }
        if (n == 0) own = found;
    }
    if (lid > 0) return;
    tree->triangle_count = found;
    tree->beside_count = found - own;
}

// The lowest node that is above two corners of a triangle, or NONE: if a cut merges it, the triangle degenerates.
inline uint collapsing_node(__global const uint *node_parents, uint a, uint b, uint c) {
    // A node's number is above those of its descendants, and NONE is above all. So the lowest of the three is not above the node at which
    // any two meet, and may be replaced by its parent.
    while (a != b && b != c && c != a) {
        const uint lowest = min(a, min(b, c)), above = node_parents[lowest];
        a = a == lowest ? above : a;
        b = b == lowest ? above : b;
        c = c == lowest ? above : c;
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

// A corner of a region's triangles: of its mesh, then of those beside it. `k`: which one.
inline uint nth_corner(const RegionMesh mesh, __global const TreeRegion *tree, __global const uint *beside, uint k) {
    const uint i = k / 3, own = mesh.triangles[0];
    return 3 * (i < own ? mesh.triangle_base + i : beside[tree->beside_base + i - own]) + k % 3;
}

// `corner_ends`: for each point, the end of its corners in `point_corners`. A region's range begins after as many entries as there are
// corners of the triangles of all regions before it, including the triangles beside those regions.
__kernel __attribute__((reqd_work_group_size(GROUP, 1, 1)))
void tree_corners(const uint points, __global const Region *regions, __global const TreeRegion *tree_regions,
                  __global const RegionMesh *meshes, __global const uint *corners, __global const uint *beside,
                  __global uint *point_corners, __global uint *corner_ends) {
    __local uint scratch[GROUP];
    const uint lid = get_local_id(0), group = (uint)get_group_id(0);
    __global const TreeRegion *tree = tree_regions + group;
    const RegionMesh mesh = meshes[group];
    TreePoints own;
    find_points(&own, regions + group, tree);
    const uint own_points = count_points(own), count = 3 * (mesh.triangles[0] + tree->beside_count);
    for (uint i = lid; i < own_points; i += GROUP) corner_ends[nth_point(own, i)] = 0;
    barrier(CLK_GLOBAL_MEM_FENCE);
    for (uint k = lid; k < count; k += GROUP) {
        const uint point = corners[nth_corner(mesh, tree, beside, k)];
        if (own_leaf_index(&own, 0, 0, points, point) != NONE) add_global(&corner_ends[point], 1);
    }
    barrier(CLK_GLOBAL_MEM_FENCE);
    uint before = 3 * (mesh.triangle_base + tree->beside_base), total;
    for (uint begin = 0; begin < own_points; begin += GROUP) {
        const bool is_there = begin + lid < own_points;
        const uint point = is_there ? nth_point(own, begin + lid) : 0;
        const uint first = before + scan_group(scratch, is_there ? corner_ends[point] : 0, &total);
        if (is_there) corner_ends[point] = first;
        before += total;
    }
    barrier(CLK_GLOBAL_MEM_FENCE);
    // In any order.
    for (uint k = lid; k < count; k += GROUP) {
        const uint corner = nth_corner(mesh, tree, beside, k), point = corners[corner];
        if (own_leaf_index(&own, 0, 0, points, point) != NONE) point_corners[add_global(&corner_ends[point], 1)] = corner;
    }
}

// The end of a life in a region that merging into `parent` ends. What merges in a level above has lived to the end.
inline uchar life_before(__global const TreeRegion *tree, __global const uchar *lives, uint points, uint parent) {
    return parent - tree->node_base < tree->nodes ? lives[life_begin(points + parent)] : ENDLESS_LIFE;
}

__kernel __attribute__((reqd_work_group_size(GROUP, 1, 1)))
void tree_lives(const uint points, __global const Region *regions, __global const TreeRegion *tree_regions,
                __global const uint *point_parents, __global const uint *node_parents, __global const uint *round_ends,
                __global uchar *lives) {
    const uint lid = get_local_id(0), group = (uint)get_group_id(0);
    __global const TreeRegion *tree = tree_regions + group;
    TreePoints own;
    find_points(&own, regions + group, tree);
    for (uint round = 0; round < tree->rounds; round++)
        for (uint i = round_begin(round_ends, group, round) + lid; i < round_end(round_ends, group, round); i += GROUP)
            lives[life_begin(points + tree->node_base + i)] = (uchar)(round + 1);
    barrier(CLK_GLOBAL_MEM_FENCE);
    for (uint i = lid; i < tree->nodes; i += GROUP) {
        const uint parent = node_parents[tree->node_base + i];
        lives[life_end(points + tree->node_base + i)] = life_before(tree, lives, points, parent);
    }
    for (uint i = lid; i < count_points(own); i += GROUP) {
        const uint point = nth_point(own, i);
        lives[life_begin(point)] = 0;
        lives[life_end(point)] = life_before(tree, lives, points, point_parents[point]);
    }
}
