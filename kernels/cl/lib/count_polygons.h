// dual_count's way from leaves to counts: which edges a leaf emits a polygon around, and which vertices that polygon needs.
#ifndef ISOPEEL_COUNT_POLYGONS_H
#define ISOPEEL_COUNT_POLYGONS_H

#include "lib/bits.h"
#include "lib/cube.h"
#include "lib/cut.h"
#include "lib/device.h"
#include "lib/ghosts.h"
#include "lib/grid.h"
#include "lib/layout.h"
#include "lib/leaf_halo.h"
#include "lib/morton.h"
#include "lib/node.h"
#include "lib/part.h"
#include "lib/polygon.h"
#include "lib/sheets.h"
#include "lib/slots.h"

// What dual_count writes.
typedef struct {
    __global uchar *used;           // of each slot: its region's mesh has its vertex
    __global uchar *used_elsewhere; // of each slot: another region's mesh has it, as a ghost
    __global uint *emitted_edges;   // of each leaf outside plain bricks, one bit an edge
    __global uint *ghosts;          // of each region, names of its ghosts and border vertices (ghosts.h)
    __global uint *borders;         // of each region, those border vertices whose leaf is its own
    __local uint *triangles;        // of the part, by level
} Counts;

// Cells of a part whose polygons are all quads: counts these, marks all cells as used, and lists in `border` those on the region's
// boundary, which also mark ghosts. To be called by all work-items; counts nothing in other parts.
INLINED void count_all_quads(const Cut *cut, const Part *part, const Counts *counts, __local ushort *border,
                             __local uint *border_count) {
    const uint lid = get_local_id(0);
    const bool wanted = part->all_quads;
    __global const Region *region = cut->regions + part->region;
    __global const Brick *brick = cut->bricks + (wanted ? part->brick : 0);
    if (lid == 0) {
        counts->triangles[0] = wanted ? 2 * brick->quad_count : 0;
        *border_count = 0;
    }
    brick_barrier(CLK_LOCAL_MEM_FENCE);
    const uint first = region->slot_base + brick->level_base[0], extra = region->slot_base + brick->level_base[3];
    const uint count = count_cells(brick);
    for (uint i = lid; wanted && i < count; i += BRICK_GROUP) counts->used[first + i] = 1;
    for (uint i = lid; wanted && i < brick->extra_sheets; i += BRICK_GROUP) counts->used[extra + i] = 1;
    const int3 in_region = part->low - part->origin;
    for (uint word = lid; wanted && word < 16; word += BRICK_GROUP) {
        // A word holds cells of four coordinates along x and y, and of two along z.
        const uint x = word >> 1 & 1, y = word >> 2 & 1, z = (word & 1) | (word >> 2 & 2);
        const uint outer = (in_region.x == 0 && x == 0 ? FIRST_X : in_region.x == 24 && x == 1 ? LAST_X : 0)
            | (in_region.y == 0 && y == 0 ? FIRST_Y : in_region.y == 24 && y == 1 ? LAST_Y : 0)
            | (in_region.z == 0 && z == 0 ? FIRST_Z : in_region.z == 24 && z == 3 ? LAST_Z : 0);
        const uint cells = brick->cells[word];
        uint at = add_local(border_count, popcount(cells & outer));
        for (uint rest = cells & outer; rest; rest &= rest - 1)
            border[at++] = (ushort)(brick->cells_before[word] + popcount(cells & ((1u << lowest_bit(rest)) - 1)));
    }
    brick_barrier(CLK_LOCAL_MEM_FENCE | CLK_GLOBAL_MEM_FENCE);
}

// Edges of a cell at the end of its region that belong to polygons of the next region.
inline uint edges_of_next_regions(Grid grid, int3 low, int3 in_region) {
    return (in_region.x == 31 && low.x + 2 < (int)grid.dims[0] ? EDGES_HIGH_X : 0)
        | (in_region.y == 31 && low.y + 2 < (int)grid.dims[1] ? EDGES_HIGH_Y : 0)
        | (in_region.z == 31 && low.z + 2 < (int)grid.dims[2] ? EDGES_HIGH_Z : 0);
}

// Marks the vertices of a cell that is a leaf, if no samples are missing: every crossed edge has a polygon then, so the cell
// knows which of its sheets are used without those leaves that emit the polygons.
INLINED void mark_sheets(Grid grid, const Cut *cut, const Part *part, const Counts *counts, uint slot, uint crossed,
                         int3 in_region) {
    const bool is_last = any(part->low - part->origin == 24);
    const uint next = is_last ? edges_of_next_regions(grid, part->origin + in_region, in_region) : 0;
    if (part->all_quads && !next) return; // count_all_quads has marked them
    const uint extras = meta_extras(cut->nodes[slot].meta);
    const uint extra = first_extra(cut->regions + part->region, cut->bricks + part->brick, cut->nodes[slot]);
    const uint sheets = extras ? cut->nodes[extra].count : 0;
    ROLLED for (uint sheet = 0; sheet <= extras; sheet++) {
        const uint at = sheet == 0 ? slot : extra + sheet - 1, edges = crossed & edges_of_sheet(sheets, sheet);
        if (edges & ~next) counts->used[at] = 1;
        else if (part->all_quads) counts->used[at] = 0; // count_all_quads has marked it
        if (edges & next) counts->used_elsewhere[at] = 1;
    }
}

// Triangles of the polygon that a leaf of level 0 or 1 emits around an edge inside its region, if no samples are missing.
// Marks other leaves around it as used, except cells, which mark_sheets marks. `in_region`, `in_brick`: the leaf's low corner.
inline uint count_inner_polygon(__local const LeafHalo *halo, uint level, int3 in_region, int3 in_brick, uint edge,
                                __global uchar *used) {
    const int3 offset = edge_offset(edge) << (int)level;
    const EdgeCubes cubes = edge_cubes(in_brick + offset, edge >> 2), whole = edge_cubes(in_region + offset, edge >> 2);
    uint triangles = 2;
    for (uint k = 0; k < 4; k++) {
        if (k == (edge & 3)) continue;
        const uint i = cube_at(cubes, k), found = cover_level(halo->cover[i]);
        if (found == 0) continue;
        used[halo->slot[i]] = 1;
        // A coarser leaf covers two of the positions, unless the edge lies on an edge of it.
        if (found > level && (whole.b | whole.c) & (int)((1u << found) - 1)) triangles = 1;
    }
    return triangles;
}

// Edges of a leaf by how their polygons are counted: see dual.cl.
typedef struct {
    uint listed;    // their polygons are found one by one
    uint inner;     // their polygons are counted already
    uint triangles; // of the latter
} EdgeMasks;

// A leaf of level 0 or 1 in a brick that is not plain, or at a face of the volume.
INLINED EdgeMasks count_fine_leaf(Grid grid, const Part *part, __local const LeafHalo *halo, const Counts *counts, uint slot,
                                  uint level, uint crossed, int3 in_region, bool has_missing) {
    const int3 in_brick = part->origin + in_region - part->low;
    EdgeMasks edges = {crossed & ~edges_of_neighbours(halo, level, convert_uint3(in_brick)), 0, 0};
    if (has_missing) return edges;
    const uint outer = boundary_edges(grid, part->origin, in_region, level);
    edges.inner = edges.listed & ~outer;
    edges.listed &= outer;
    if (edges.inner && level > 0) counts->used[slot] = 1;
    ROLLED for (uint rest = edges.inner; rest; rest &= rest - 1)
        edges.triangles += count_inner_polygon(halo, level, in_region, in_brick, lowest_bit(rest), counts->used);
    return edges;
}

// Any leaf. `crossed`: its crossed edges; `in_region`: its low corner.
INLINED EdgeMasks count_leaf(Grid grid, const Part *part, __local const LeafHalo *halo, const Counts *counts, uint slot, uint level,
                             uint crossed, int3 in_region, bool has_missing) {
    EdgeMasks edges = {0, 0, 0};
    if (part->all_quads) edges.listed = crossed & EDGES_OWN & boundary_edges(grid, part->origin, in_region, 0);
    else if (part->plain && is_inside(grid, part->origin + in_region)) {
        if (all(in_region > 0)) edges.triangles = 2 * popcount(crossed & EDGES_OWN);
        else edges.listed = crossed & EDGES_OWN;
    } else if (part->brick == NONE || level > 1) edges.listed = crossed;
    else edges = count_fine_leaf(grid, part, halo, counts, slot, level, crossed, in_region, has_missing);
    return edges;
}

// Counts leaves from the walk's place on, until the list is full: what is known of them at once; edges whose polygons are to be
// found one by one go into the list, in any order.
INLINED void count_leaves(Grid grid, const Cut *cut, const Part *part, __local const LeafHalo *halo, const Counts *counts,
                          LeafWalk *walk, bool has_missing, __local const ushort *border, uint border_count,
                          __local ushort *list, __local uint *listed) {
    __global const Region *region = cut->regions + part->region;
    const uint lid = get_local_id(0);
    for (uint capacity = EDGE_LIST_CAPACITY; walk->level < walk->end_level && capacity >= 12 * BRICK_GROUP;) {
        const uint count = part->all_quads ? border_count : walk->slots.count, level = walk->level;
        if (walk->begin >= count) {
            next_level(walk, *part, region, cut->bricks);
            continue;
        }
        const uint at = walk->begin + lid, i = part->all_quads ? border[min(at, count - 1)] : at;
        const uint own = region->slot_base + walk->slots.first + i;
        const bool is_leaf = at < count && (part->plain || cut->state[own] == level);
        walk->begin += BRICK_GROUP;
        capacity -= 12 * BRICK_GROUP;
        if (!is_leaf) continue;
        const uint meta = cut->nodes[own].meta, crossed = crossed_edges(meta_signs(meta));
        const int3 in_region = convert_int3(unmorton(code_cell(meta_code(meta), level)));
        if (level == 0 && !has_missing) mark_sheets(grid, cut, part, counts, own, crossed, in_region);
        const EdgeMasks edges = count_leaf(grid, part, halo, counts, own, level, crossed, in_region, has_missing);
        if (edges.triangles) add_local(&counts->triangles[level], edges.triangles);
        if (!part->plain) counts->emitted_edges[own] = edges.inner;
        if (!edges.listed) continue;
        uint next = add_local(listed, popcount(edges.listed));
        ROLLED for (uint rest = edges.listed; rest; rest &= rest - 1) list[next++] = edge_entry(level, i, lowest_bit(rest));
    }
}

// Marks the vertex of one corner: an own one, a ghost, or a border vertex (see polygon.h).
INLINED void mark_corner(Grid grid, const Cut *cut, const Part *part, const Counts *counts, uint slot, uint region, uint faces) {
    if (region == part->region && !faces) {
        counts->used[slot] = 1;
        return;
    }
    const uint bit = ghost_bit(grid, cut->regions, cut->nodes, part->origin, region, slot, faces);
    atomic_or(&counts->ghosts[part->region * HALO_WORDS + (bit >> 5)], 1u << (bit & 31));
    if (!faces) counts->used_elsewhere[slot] = 1;
    else {
        // The leaf's region alone counts it among the surface's vertices.
        const int3 origin = convert_int3(region_origin(grid, cut->regions[region].region));
        const uint own_bit = ghost_bit(grid, cut->regions, cut->nodes, origin, region, slot, faces);
        atomic_or(&counts->borders[region * HALO_WORDS + (own_bit >> 5)], 1u << (own_bit & 31));
    }
}

// Counts the polygon around a listed edge, if there is one.
INLINED void count_listed(Grid grid, const Cut *cut, const Part *part, __local const LeafHalo *halo, const Counts *counts,
                          uint entry) {
    const uint level = entry_level(entry), edge = entry_edge(entry);
    const uint slot = entry_slot(entry, *part, cut->regions + part->region, cut->bricks);
    const int3 low = part->origin + convert_int3(unmorton(code_cell(meta_code(cut->nodes[slot].meta), level)));
    const Polygon polygon = find_polygon(grid, cut, halo, part, slot, level, low, edge);
    if (!polygon.count) return;
    if (!part->all_quads) add_local(&counts->triangles[level], polygon.count - 2);
    if (!part->plain) atomic_or(&counts->emitted_edges[slot], 1u << edge);
    for (uint k = 0; k < 4; k++) {
        if (k >= polygon.count) break;
        mark_corner(grid, cut, part, counts, polygon.slot[k], polygon.region[k], polygon.faces[k]);
    }
}

#endif
