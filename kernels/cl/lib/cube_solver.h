// From the sums over the cells below to a cube's vertex, normal and error (docs/algorithm.md#63-vertex-placement): LANES of a
// brick's cubes at once. What lib/cell_solver.h does for cells.
#ifndef ISOPEEL_CUBE_SOLVER_H
#define ISOPEEL_CUBE_SOLVER_H

#include "lib/precision.h"
#include "lib/device.h"
#include "lib/lanes.h"
#include "lib/layout.h"
#include "lib/octahedral.h"
#include "lib/quadric.h"
#include "lib/vertex_record.h"

// Rows of the array: sums over the cells below, as in Moments and Quadric, then the cube from the brick's low corner in cells.
#define CUBE_SLOPE 0   // sum of n g, x y z
#define CUBE_SLOPED 3  // sum of n |g|^2
#define CUBE_FEATURE 4 // sum of n f
#define CUBE_COUNT 5   // sum of n
#define CUBE_QUADRIC 6 // QUADRIC_ROWS rows, from the brick's centre
#define CUBE_SUMS 20   // rows so far
#define CUBE_LOW 20    // x y z
#define CUBE_HIGH 23   // x y z
// What solve_cubes writes in place of the quadric.
#define CUBE_VERTEX 6 // from the brick's low corner, in cells, x y z
#define CUBE_NORMAL 9 // encode_octahedral8 as a number
#define CUBE_ERROR 10 // root mean square distance to the planes of the crossings

// Solves LANES columns from `column` on: the quadric's minimum inside the cube, its error, and the mean gradient of the cells below as
// normal.
inline void solve_cubes(__local float *cubes, uint column, float3 spacing) {
#pragma OPENCL FP_CONTRACT ON
    cubes += column;
    const Quadrics q = load_quadrics(cubes + CUBE_QUADRIC * CUBES, CUBES);
    const real per_k = native_recip(fmax(q.k, 1.0f));
    const float3 per = native_recip(spacing);
    const Real3 mean = scale_real3(q.m, per_k), up = quadrics_minimum(&q, mean, CUBE_PULL);
    const Real3 low = LOAD_REAL3(cubes + CUBE_LOW * CUBES, CUBES), high = LOAD_REAL3(cubes + CUBE_HIGH * CUBES, CUBES);
    // The quadric counts from the brick's centre.
    const Real3 p = make_real3(clamp(4.0f + (mean.x + up.x) * per.x, low.x + MARGIN, high.x - MARGIN),
                               clamp(4.0f + (mean.y + up.y) * per.y, low.y + MARGIN, high.y - MARGIN),
                               clamp(4.0f + (mean.z + up.z) * per.z, low.z + MARGIN, high.z - MARGIN));
    const Real3 world = make_real3((p.x - 4.0f) * spacing.x, (p.y - 4.0f) * spacing.y, (p.z - 4.0f) * spacing.z);
    const real normal = encode_normal_lanes(LOAD_REAL3(cubes + CUBE_SLOPE * CUBES, CUBES));
    STORE_REAL3(p, cubes + CUBE_VERTEX * CUBES, CUBES)
    STORE_LANES(normal, cubes + CUBE_NORMAL * CUBES);
    STORE_LANES(quadrics_error(&q, world, per_k), cubes + CUBE_ERROR * CUBES);
}

#endif
