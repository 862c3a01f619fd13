// Names of the vertices that a region's mesh has beside those of its own leaves:
//
//   ghost           vertex of a leaf of another region
//   border vertex   mirror image of a leaf beyond a face of the volume (docs/algorithm.md#66-borders-and-caps)
//
// A name is the index of a bit in the region's mask of HALO_WORDS words: 4 * halo cell + sheet. The halo cell, in the layer of
// cells around the region's 32^3, is the leaf's first cell there; for a border vertex it is the cell beyond the face. The index
// of such a vertex in the mesh follows from the number of lower bits that are set.
#ifndef ISOPEEL_GHOSTS_H
#define ISOPEEL_GHOSTS_H

#include "lib/device.h"
#include "lib/grid.h"
#include "lib/layout.h"
#include "lib/morton.h"
#include "lib/node.h"

// Number of a halo cell. `p`: from the region's low corner, -1 to 32, on the halo in at least one coordinate. First the planes
// z = -1 and z = 32 of 34^2 cells, then for each z from 0 to 31 the rows y = -1 and y = 32 of 34 cells and 32 pairs x = -1, 32.
inline uint halo_cell(int3 p) {
    if (p.z < 0) return (uint)((p.y + 1) * 34 + p.x + 1);
    if (p.z > 31) return (uint)(34 * 34 + (p.y + 1) * 34 + p.x + 1);
    const uint layer = 2 * 34 * 34 + 132 * (uint)p.z;
    if (p.y < 0) return layer + (uint)(p.x + 1);
    if (p.y > 31) return layer + 34 + (uint)(p.x + 1);
    return layer + 68 + 2 * (uint)p.y + (p.x > 31);
}

// Name in the region at `origin` of the vertex of a leaf of `region` (`slot` may be an extra sheet); `faces`: for a border vertex
// the faces it lies on, bit 2 axis + side.
INLINED uint ghost_bit(Grid grid, __global const Region *regions, __global const Node *nodes, int3 origin, uint region, uint slot,
                       uint faces) {
    const uint meta = nodes[slot].meta, code = meta_code(meta), level = code_level(code);
    int3 low = convert_int3(region_origin(grid, regions[region].region) + unmorton(code_cell(code, level))) - origin;
    low = max(low, (int3)(-1));
    if (faces) {
        low.x = faces & 1u ? -1 : faces & 2u ? 32 : low.x;
        low.y = faces & 4u ? -1 : faces & 8u ? 32 : low.y;
        low.z = faces & 16u ? -1 : faces & 32u ? 32 : low.z;
    }
    const bool is_extra_sheet = slot - regions[region].slot_base >= regions[region].level_base[6];
    return 4 * halo_cell(low) + (is_extra_sheet ? meta_extras(meta) : 0);
}

#endif
