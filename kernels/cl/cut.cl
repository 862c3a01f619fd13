// cut: decides which nodes are leaves of the cut (docs/algorithm.md#4-importance-and-cut), and compares and mixes cuts.
//
// cut: one work-group a region, from level 5 down. In: parameters, control points of the transfer function, regions of interest,
//   nodes, vertex records. Out: state[slot], the level of the leaf that covers the node (its own level: it is a leaf) or INTERNAL
//   if the leaves are below it; sums over the leaves of the region.
// cut_compare: one work-group a region. In: two cuts. Out: for each region, one bit per neighbour that a node with different states
//   touches.
// cut_mix: one work-group a region. In: two cuts, and for each region which of the two it takes. Out: the mixed cut.

#include "lib/precision.h"
#include "lib/args.h"
#include "lib/bits.h"
#include "lib/device.h"
#include "lib/importance.h"
#include "lib/layout.h"
#include "lib/morton.h"
#include "lib/node.h"
#include "lib/slots.h"

// What a work-item's leaves add up to.
typedef struct {
    float error2; // sum of n error^2
    float worst;  // maximum error
    uint weight;  // sum of n
} LeafSums;

INLINED void add_leaf(LeafSums *sums, uint triangles, float error) {
    sums->error2 += (float)triangles * error * error;
    sums->worst = fmax(sums->worst, error);
    sums->weight += triangles;
}

// Leaves of levels 5 to 1, in this order. `whole`: nodes of all levels exist.
INLINED void cut_cubes(const CutCriterion *criterion, bool whole, __global const Region *region, __global const Brick *bricks,
                       __global const Node *nodes, __global const VertexRecord *vertex_records, __global uchar *state,
                       __local uint *leaves, __local uint *undecided, __local uint *lost, LeafSums *sums) {
    const uint slots = region->slot_base;
    for (uint level = 5; level > 0; level--) {
        barrier(CLK_LOCAL_MEM_FENCE | CLK_GLOBAL_MEM_FENCE);
        uint count = 0, empty = 0, open = 0;
        for (uint i = region->level_base[level] + get_local_id(0); i < region->level_base[level + 1]; i += GROUP) {
            if (!whole) {
                state[slots + i] = INTERNAL;
                continue;
            }
            const Node node = nodes[slots + i];
            uint result = level == 5 ? INTERNAL : state[find_slot(region, bricks, level + 1, code_cell(meta_code(node.meta), level))];
            const bool missing = meta_missing(node.meta);
            if (result == INTERNAL && node.count > 0 && (criterion->params.fills || !missing)) {
                const float error = counted_error(criterion, node, level, vertex_records[slots + i].error);
                if (level == criterion->params.prefix
                    || (!missing && may_decimate(criterion->params, node, level, error)
                        && decimation_key(criterion, node, level, error) <= criterion->params.threshold)) {
                    result = level;
                    count++;
                    empty += meta_one_sign(node.meta);
                    add_leaf(sums, node.count, error);
                } else open++;
            }
            state[slots + i] = (uchar)result;
        }
        if (count) atomic_add(&leaves[level], count);
        if (open) atomic_add(&undecided[level], open);
        if (empty) atomic_add(lost, empty);
    }
    barrier(CLK_LOCAL_MEM_FENCE | CLK_GLOBAL_MEM_FENCE);
}

// Active cells are leaves if their level-1 cube is INTERNAL. Cells and cubes have the same order. Returns how many.
INLINED uint cut_cells(__global const Region *region, __global const Brick *bricks, __global const Node *nodes,
                       __global const VertexRecord *vertex_records, __global uchar *state, LeafSums *sums) {
    const uint slots = region->slot_base, brick_count = count_bricks(region);
    uint cells = 0;
    for (uint b = get_local_id(0); b < brick_count; b += GROUP) {
        __global const Brick *brick = bricks + region->brick_base + b;
        uint cube = slots + brick->level_base[1], slot = slots + brick->level_base[0];
        for (uint side = 0; side < 2; side++) {
            for (uint rest = brick->level1_mask[side]; rest; rest &= rest - 1) {
                const uint above = state[cube++], end = slot + popcount(level1_cells(brick, side << 5 | lowest_bit(rest)));
                if (above != INTERNAL) {
                    for (; slot < end; slot++) state[slot] = (uchar)above;
                    continue;
                }
                cells += end - slot;
                for (; slot < end; slot++) {
                    state[slot] = 0;
                    add_leaf(sums, nodes[slot].count & 0xffu, vertex_records[slot].error);
                }
            }
        }
    }
    return cells;
}

// All active cells are leaves: there are no nodes above them. Returns how many.
INLINED uint cut_all_cells(__global const Region *region, __global const Node *nodes, __global const VertexRecord *vertex_records,
                           __global uchar *state, LeafSums *sums) {
    uint cells = 0;
    for (uint i = region->level_base[0] + get_local_id(0); i < region->level_base[1]; i += GROUP) {
        const uint slot = region->slot_base + i;
        state[slot] = 0;
        add_leaf(sums, nodes[slot].count & 0xffu, vertex_records[slot].error);
        cells++;
    }
    return cells;
}

__kernel __attribute__((reqd_work_group_size(GROUP, 1, 1)))
void cut(const CutArgs args, __constant float2 *points, __constant Interest *interests, __global const Region *regions,
         __global const Brick *bricks, __global const Node *nodes, __global const VertexRecord *vertex_records,
         __global uchar *state, __global RegionCut *region_cuts) {
    __local uint leaves[6], undecided[6], lost, weights[GROUP];
    __local float errors2[GROUP], worsts[GROUP];
    const uint lid = get_local_id(0);
    __global const Region *region = regions + get_group_id(0);
    for (uint i = lid; i < 6; i += GROUP) leaves[i] = undecided[i] = 0;
    if (lid == 0) lost = 0;
    LeafSums sums = {0.0f, 0.0f, 0};
    CutCriterion criterion;
    find_criterion(&criterion, args.grid, args.params, points, interests, region->region);
    cut_cubes(&criterion, args.whole_pyramid, region, bricks, nodes, vertex_records, state, leaves, undecided, &lost, &sums);
    const uint cells = args.whole_pyramid ? cut_cells(region, bricks, nodes, vertex_records, state, &sums)
                                          : cut_all_cells(region, nodes, vertex_records, state, &sums);
    if (cells) atomic_add(&leaves[0], cells);
    errors2[lid] = sums.error2;
    worsts[lid] = sums.worst;
    weights[lid] = sums.weight;
    // An extra sheet has the state of its cell.
    barrier(CLK_LOCAL_MEM_FENCE | CLK_GLOBAL_MEM_FENCE);
    for (uint i = region->level_base[6] + lid; i < region->level_base[7]; i += GROUP) {
        const uint slot = region->slot_base + i;
        state[slot] = state[find_slot(region, bricks, 0, code_cell(meta_code(nodes[slot].meta), 0))];
    }
    if (lid > 0) return;
    RegionCut out;
    for (uint level = 0; level < 6; level++) {
        out.leaves[level] = leaves[level];
        out.undecided[level] = undecided[level];
    }
    out.lost_cubes = lost;
    for (uint i = 1; i < GROUP; i++) {
        sums.error2 += errors2[i];
        sums.worst = fmax(sums.worst, worsts[i]);
        sums.weight += weights[i];
    }
    out.error2 = sums.error2;
    out.worst = sums.worst;
    out.weight = sums.weight;
    region_cuts[get_group_id(0)] = out;
}

// Along one axis, which neighbours of the region a cube touches: bit 0 the one before, bit 1 none (always set), bit 2 the one behind.
inline uint touched(uint low, uint size) { return 2u | (low == 0 ? 1u : 0u) | (low + size == 32 ? 4u : 0u); }

// The neighbours of the region that a cube touches, one bit each, x + 3 y + 9 z; bit 13 is the region itself, always set.
inline uint touched_neighbours(uint3 low, uint size) {
    const uint x = touched(low.x, size), y = touched(low.y, size), z = touched(low.z, size);
    const uint row = (y & 1u ? x : 0) | (y & 2u ? x << 3 : 0) | (y & 4u ? x << 6 : 0);
    return (z & 1u ? row : 0) | (z & 2u ? row << 9 : 0) | (z & 4u ? row << 18 : 0);
}

__kernel __attribute__((reqd_work_group_size(GROUP, 1, 1)))
void cut_compare(__global const Region *regions, __global const Node *nodes, __global const uchar *before,
                 __global const uchar *after, __global uint *differences) {
    __local uint difference;
    __global const Region *region = regions + get_group_id(0);
    if (get_local_id(0) == 0) difference = 0;
    barrier(CLK_LOCAL_MEM_FENCE);
    uint found = 0;
    for (uint i = get_local_id(0); i < region->level_base[6]; i += GROUP) {
        const uint slot = region->slot_base + i;
        if (before[slot] == after[slot]) continue;
        const uint code = meta_code(nodes[slot].meta), level = code_level(code);
        found |= touched_neighbours(unmorton(code_cell(code, level)), 1u << level);
    }
    if (found) atomic_or(&difference, found);
    barrier(CLK_LOCAL_MEM_FENCE);
    if (get_local_id(0) == 0) differences[get_group_id(0)] = difference;
}

__kernel __attribute__((reqd_work_group_size(GROUP, 1, 1)))
void cut_mix(__global const Region *regions, __global const uchar *takes_after, __global const uchar *before,
             __global const uchar *after, __global uchar *state) {
    __global const Region *region = regions + get_group_id(0);
    const bool is_after = takes_after[get_group_id(0)];
    for (uint i = get_local_id(0); i < region->level_base[7]; i += GROUP) {
        const uint slot = region->slot_base + i;
        state[slot] = is_after ? after[slot] : before[slot];
    }
}
