// The data's values at a vertex of a coarser leaf: those of the active cell that holds it, or else of the nearest one next to that. So they are a
// function of the position, and the same in every cut that has a vertex there.
#ifndef ISOPEEL_CELL_VALUES_H
#define ISOPEEL_CELL_VALUES_H

#include "lib/device.h"
#include "lib/layout.h"
#include "lib/slots.h"

// Squared distance from a position to a cell. `at`: in the volume, 1/VERTEX_LATTICE cell.
inline int distance2_to_cell(int3 at, int3 cell) {
    const int lattice = (int)VERTEX_LATTICE;
    const int3 low = cell * lattice, way = max(max(low - at, at - low - lattice), 0);
    return way.x * way.x + way.y * way.y + way.z * way.z;
}

// The node with the data's values at `at`; unchanged if no cell around is active.
INLINED Node with_values_at(Grid grid, __global const uint *region_index, __global const Region *regions,
                            __global const Brick *bricks, __global const Node *nodes, Node node, int3 at) {
    const int3 last = (int3)((int)grid.dims[0], (int)grid.dims[1], (int)grid.dims[2]) - 2;
    const int3 centre = clamp(at / (int)VERTEX_LATTICE, (int3)(0), last);
    uint region, slot = find_slot_at(grid, region_index, regions, bricks, 0, centre, &region);
    int nearest = slot == NONE ? INT_MAX : -1;
    for (int i = 0; i < 27 && nearest >= 0; i++) {
        const int3 cell = centre + (int3)(i % 3, i / 3 % 3, i / 9) - 1;
        const int distance = distance2_to_cell(at, cell);
        if (distance >= nearest) continue;
        const uint found = find_slot_at(grid, region_index, regions, bricks, 0, cell, &region);
        if (found == NONE) continue;
        nearest = distance;
        slot = found;
    }
    if (slot == NONE) return node;
    node.s = nodes[slot].s;
    node.f = nodes[slot].f;
    return node;
}

#endif
