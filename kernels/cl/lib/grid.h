// Coordinates of regions in the volume.
#ifndef ISOPEEL_GRID_H
#define ISOPEEL_GRID_H

#include "lib/layout.h"
#include "lib/morton.h"

inline uint3 region_coords(Grid grid, uint region) {
    const uint rx = grid.regions[0], ry = grid.regions[1];
    return (uint3)(region % rx, region / rx % ry, region / rx / ry);
}
inline uint3 region_origin(Grid grid, uint region) { return region_coords(grid, region) * 32; }
// The low corner of a brick, of which `morton` is the Morton number in its region.
inline uint3 brick_origin(Grid grid, uint region, uint morton) { return region_origin(grid, region) + unmorton(morton << 9); }

#endif
