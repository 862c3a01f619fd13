// dual on a GPU, which works on a brick with BRICK_GROUP work-items: see dual_device.h.
#ifndef ISOPEEL_DUAL_GPU_H
#define ISOPEEL_DUAL_GPU_H

#include "lib/batch.h"
#include "lib/cut.h"
#include "lib/device.h"
#include "lib/layout.h"
#include "lib/leaf_halo.h"
#include "lib/morton.h"
#include "lib/part.h"
#include "lib/polygon.h"
#include "lib/slots.h"
#include "lib/vertices.h"

// Slots that one work-item of dual_scan numbers in a step: several, so that there are few scans.
#define SLOTS_PER_ITEM 8

// Whether plain bricks are emitted from a table of vertices.
#define VERTEX_TABLE 0

// Fills the halo of a brick if `wanted`: each work-item some cubes. To be called by all work-items.
INLINED void find_halo(__local LeafHalo *halo, const Cut *cut, const Part *part, bool wanted) {
    for (uint i = get_local_id(0); wanted && i < HALO_CUBES; i += BRICK_GROUP) {
        // From the low corner of the first of the 27 bricks, in cubes.
        const uint3 at = (uint3)(i % 6, i / 6 % 6, i / 36) + 3, of = at >> 2;
        const uint index = part->near[of.x + 3 * of.y + 9 * of.z], cube = morton(at & 3);
        const uint own = index == NONE ? NONE
            : find_in_brick(cut->regions + cut->bricks[index].region, cut->bricks, index, 1, cube << 3);
        if (own == NONE) halo->cover[i] = HALO_EMPTY;
        else set_halo_cube(halo, i, cut->regions, cut->bricks, cut->state, index, cube, own);
    }
    brick_barrier(CLK_LOCAL_MEM_FENCE);
}

// Plain bricks are emitted like all others, one work-item a polygon. A macro, for a function would have nothing but unused
// parameters.
#define emit_plain_brick(grid, cut, part, mesh, out, used, first_triangle, done, list) 0u

#endif
