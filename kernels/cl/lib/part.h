// What one work-group of dual_count or dual_emit works on: a brick, or a region's levels 4 and 5.
#ifndef ISOPEEL_PART_H
#define ISOPEEL_PART_H

#include "lib/bits.h"
#include "lib/device.h"
#include "lib/grid.h"
#include "lib/layout.h"
#include "lib/morton.h"
#include "lib/slots.h"

typedef struct {
    uint brick;  // NONE: the region's levels 4 and 5
    uint region; // compact
    int3 origin; // of the region, in cells
    int3 low;    // of the brick
    uint finest, levels; // of its leaves
    uint counts; // place of its first level in the counts of triangles: behind the bricks' four levels each, the regions' two
} Part;

inline Part find_part(Grid grid, uint brick_count, __global const Region *regions, __global const Brick *bricks) {
    Part part;
    const uint group = (uint)get_group_id(0);
    const bool top = group >= brick_count;
    part.brick = top ? NONE : group;
    part.region = top ? group - brick_count : bricks[group].region;
    part.origin = convert_int3(region_origin(grid, regions[part.region].region));
    part.finest = top ? 4 : 0;
    part.levels = top ? 2 : 4;
    part.counts = top ? 4 * brick_count + 2 * part.region : 4 * group;
    part.low = part.origin + (top ? (int3)(0) : convert_int3(unmorton(bricks[group].morton << 9)));
    return part;
}

// A part's nodes of a level, of level 6 its extra sheets: `first` relative to the region's slots.
typedef struct {
    uint first, count;
} Slots;

inline Slots part_slots(Part part, __global const Region *region, __global const Brick *bricks, uint level) {
    Slots slots = {0, 0};
    if (part.brick == NONE) {
        if (level != 4 && level != 5) return slots;
        slots.first = region->level_base[level];
        slots.count = region->level_base[level + 1] - slots.first;
        return slots;
    }
    __global const Brick *brick = bricks + part.brick;
    switch (level) {
        case 0: slots.first = brick->level_base[0]; slots.count = count_cells(brick); break;
        case 1: slots.first = brick->level_base[1]; slots.count = count_level1(brick); break;
        case 2: slots.first = brick->level_base[2]; slots.count = popcount(brick->level2_mask); break;
        case 3: slots.first = region->level_base[3] + part.brick - region->brick_base; slots.count = 1; break;
        case 6: slots.first = brick->level_base[3]; slots.count = brick->extra_sheets; break;
        default: break;
    }
    return slots;
}

// Edges of a part's leaves wait here until there is no more space, so that every work-item gets one: level, place among the
// nodes of that level, edge.
#define EDGE_LIST_CAPACITY 3840
#define LIST_ENTRY(level, i, edge) (ushort)((level) << 13 | (i) << 4 | (edge))
inline uint entry_level(uint entry) { return entry >> 13; }
inline uint entry_edge(uint entry) { return entry & 15u; }
inline uint entry_slot(uint entry, Part part, __global const Region *region, __global const Brick *bricks) {
    return region->slot_base + part_slots(part, region, bricks, entry_level(entry)).first + (entry >> 4 & 511u);
}

// Away from the volume's end?
inline bool is_inside(Grid grid, int3 cell) {
    return all(cell > 0) && all(cell + 2 < (int3)((int)grid.dims[0], (int)grid.dims[1], (int)grid.dims[2]));
}

// Are all cells in and around a brick leaves, and no samples missing? Then every crossed edge of a cell inside has a polygon
// of four cells, and the one at whose low corner the edge begins emits it. To be called by all work-items, each of which asks
// some of the bricks around; `wanted` is false without a brick, and where samples are missing.
inline bool is_plain(__global const uchar *fine, bool wanted, __global const uint *near, __local uint *coarse) {
    const uint lid = get_local_id(0);
    if (lid == 0) *coarse = 0;
    barrier(CLK_LOCAL_MEM_FENCE);
    for (uint i = lid; wanted && i < 27; i += BRICK_GROUP) {
        if (near[i] == NONE || fine[near[i]]) continue; // none: no crossed edge there
        atomic_or(coarse, 1u);
        break;
    }
    barrier(CLK_LOCAL_MEM_FENCE);
    return wanted && !*coarse;
}

// Where all cells of a brick and around it are leaves, inside the volume, every crossed edge of theirs has a polygon of two
// triangles, and uses their vertices. Cells on the region boundary also mark ghosts; these are listed in `border`. To be called by all
// work-items; without effect unless `wanted`.
inline void mark_all(Part part, __global const Region *region, __global const Brick *bricks, bool wanted, __global uchar *used,
                     __local uint *triangles, __local ushort *border, __local uint *border_count) {
    const uint lid = get_local_id(0);
    __global const Brick *brick = bricks + (wanted ? part.brick : 0);
    if (lid == 0) {
        triangles[0] = wanted ? 2 * brick->quad_count : 0;
        *border_count = 0;
    }
    barrier(CLK_LOCAL_MEM_FENCE);
    const uint first = region->slot_base + brick->level_base[0], extra = region->slot_base + brick->level_base[3];
    const uint count = count_cells(brick);
    for (uint i = lid; wanted && i < count; i += BRICK_GROUP) used[first + i] = 1;
    for (uint i = lid; wanted && i < brick->extra_sheets; i += BRICK_GROUP) used[extra + i] = 1;
    const int3 in_region = part.low - part.origin;
    for (uint word = lid; wanted && word < 16; word += BRICK_GROUP) {
        // A word holds cells of four coordinates along x and y, and of two along z.
        const uint x = word >> 1 & 1, y = word >> 2 & 1, z = (word & 1) | (word >> 2 & 2);
        const uint outer = (in_region.x == 0 && x == 0 ? FIRST_X : in_region.x == 24 && x == 1 ? LAST_X : 0)
            | (in_region.y == 0 && y == 0 ? FIRST_Y : in_region.y == 24 && y == 1 ? LAST_Y : 0)
            | (in_region.z == 0 && z == 0 ? FIRST_Z : in_region.z == 24 && z == 3 ? LAST_Z : 0);
        const uint cells = brick->cells[word];
        uint at = ADD_LOCAL(border_count, popcount(cells & outer));
        for (uint rest = cells & outer; rest; rest &= rest - 1)
            border[at++] = (ushort)(brick->cells_before[word] + popcount(cells & ((1u << lowest_bit(rest)) - 1)));
    }
    barrier(CLK_LOCAL_MEM_FENCE | CLK_GLOBAL_MEM_FENCE);
}

#endif
