// A *part* is the unit of work of one work-group of dual_count or dual_emit: a brick with its leaves of levels 0 to 3, or a region
// with its leaves of levels 4 and 5.
#ifndef ISOPEEL_PART_H
#define ISOPEEL_PART_H

#include "lib/bits.h"
#include "lib/device.h"
#include "lib/grid.h"
#include "lib/layout.h"
#include "lib/morton.h"
#include "lib/slots.h"

typedef struct {
    uint brick;          // compact index; NONE: the region's levels 4 and 5
    __global const uint *near; // the 27 bricks around it, NONE if there is none: x + 3 y + 9 z, itself at 13
    uint region;         // compact index
    int3 origin;         // of the region, in cells of the volume
    int3 low;            // of the brick, likewise
    uint finest, levels; // of its leaves
    uint counts;         // index of its finest level in the counts of triangles: four of each brick, then two of each region
    bool plain;          // see dual.cl
    bool all_quads;      // see dual.cl
    bool covered;        // a brick with no leaf of its own: one of level 4 or 5 covers it
} Part;

// The part of this work-group. Whether it is plain is not known yet. Written through a pointer, as the walk below: Oclgrind
// does not know an intrinsic that clang 14 leaves behind when it inlines a function that returns a struct.
inline void find_part(Part *part, Grid grid, uint brick_count, __global const uint *parts, __global const Region *regions,
                      __global const Brick *bricks, __global const uint *near) {
    const uint group = parts[get_group_id(0)];
    const bool is_top = group >= brick_count;
    part->brick = is_top ? NONE : group;
    part->near = near + 27 * (is_top ? 0 : group);
    part->region = is_top ? group - brick_count : bricks[group].region;
    part->origin = convert_int3(region_origin(grid, regions[part->region].region));
    part->finest = is_top ? 4 : 0;
    part->levels = is_top ? 2 : 4;
    part->counts = is_top ? 4 * brick_count + 2 * part->region : 4 * group;
    part->low = part->origin + (is_top ? (int3)(0) : convert_int3(unmorton(bricks[group].morton << 9)));
    part->plain = part->all_quads = part->covered = false;
}

// Slots of a part's nodes of one level: `first` relative to the region's slots. EXTRA_SHEETS stands for its extra sheets.
#define EXTRA_SHEETS 6u
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
        case EXTRA_SHEETS: slots.first = brick->level_base[3]; slots.count = brick->extra_sheets; break;
        default: break;
    }
    return slots;
}

// A walk over the leaves of a part, level by level, BRICK_GROUP at a time.
typedef struct {
    uint level, end_level;
    uint begin; // first leaf of this step among the nodes of the level, or in the list that stands for these
    Slots slots;
} LeafWalk;

inline void begin_walk(LeafWalk *walk, Part part, __global const Region *region, __global const Brick *bricks) {
    walk->level = part.finest;
    walk->end_level = part.finest + (part.covered ? 0 : part.plain ? 1 : part.levels);
    walk->begin = 0;
    walk->slots = part_slots(part, region, bricks, part.finest);
}
INLINED void next_level(LeafWalk *walk, Part part, __global const Region *region, __global const Brick *bricks) {
    walk->begin = 0;
    walk->slots = part_slots(part, region, bricks, ++walk->level);
}

// Edges of a part's leaves are collected in a list in local memory before their polygons are found, so that every work-item gets
// one. An entry: level, index among the part's nodes of that level, edge.
#define EDGE_LIST_CAPACITY 3840
inline ushort edge_entry(uint level, uint i, uint edge) { return (ushort)(level << 13 | i << 4 | edge); }
inline uint entry_level(uint entry) { return entry >> 13; }
inline uint entry_edge(uint entry) { return entry & 15u; }
inline uint entry_slot(uint entry, Part part, __global const Region *region, __global const Brick *bricks) {
    return region->slot_base + part_slots(part, region, bricks, entry_level(entry)).first + (entry >> 4 & 511u);
}

// Whether a cell lies away from the volume's faces, so that all cells around it exist.
inline bool is_inside(Grid grid, int3 cell) {
    return all(cell > 0) && all(cell + 2 < (int3)((int)grid.dims[0], (int)grid.dims[1], (int)grid.dims[2]));
}

// Sets `plain` and `all_quads` (see dual.cl), and `covered`. `fine`: of each brick, whether all its active cells are leaves; `has_missing`:
// samples are missing somewhere in the volume. To be called by all work-items; each reads some of the 27 bricks.
INLINED void classify_part(Part *part, Grid grid, __global const Region *regions, __global const Brick *bricks,
                           __global const uchar *state, __global const uchar *fine, bool has_missing, __local uint *found_coarse) {
    const bool may_be_plain = part->brick != NONE && !has_missing;
    const uint lid = get_local_id(0);
    if (lid == 0) *found_coarse = 0;
    brick_barrier(CLK_LOCAL_MEM_FENCE);
    for (uint i = lid; may_be_plain && i < 27; i += BRICK_GROUP) {
        if (part->near[i] == NONE || fine[part->near[i]]) continue; // NONE: no active cells there
        atomic_or(found_coarse, 1u);
        break;
    }
    brick_barrier(CLK_LOCAL_MEM_FENCE);
    part->plain = may_be_plain && !*found_coarse;
    part->all_quads = part->plain && is_inside(grid, part->low) && is_inside(grid, part->low + 7);
    if (part->brick != NONE) {
        __global const Region *region = regions + part->region;
        const uint level = state[region->slot_base + part_slots(*part, region, bricks, 3).first];
        part->covered = level != INTERNAL && level > 3;
    }
}

#endif
