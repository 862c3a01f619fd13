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
#include "lib/trilinear.h"
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

// The field at LANES points of a brick. `tile`: its samples minus the isovalue; `last`: the last of them; `scale`: of the
// gradient, per cell.
INLINED Field field_in_brick(__local const float *tile, int3 last, Real3 p, float3 scale) {
#pragma OPENCL FP_CONTRACT ON
    float low[3 * LANES], corner[8 * LANES];
    STORE_REAL3(p, low, LANES)
    for (uint i = 0; i < LANES; i++) {
        const int3 from = clamp(convert_int3((float3)(low[i], low[LANES + i], low[2 * LANES + i])), (int3)(0), last - 1);
        __local const float *v = tile + (from.z * 9 + from.y) * 9 + from.x;
        GATHER_CORNERS(v, corner + i, LANES)
        low[i] = (float)from.x;
        low[LANES + i] = (float)from.y;
        low[2 * LANES + i] = (float)from.z;
    }
    const real tx = p.x - LOAD_LANES(low), ty = p.y - LOAD_LANES(low + LANES), tz = p.z - LOAD_LANES(low + 2 * LANES);
    const real v0 = LOAD_LANES(corner), v1 = LOAD_LANES(corner + LANES), v2 = LOAD_LANES(corner + 2 * LANES);
    const real v3 = LOAD_LANES(corner + 3 * LANES), v4 = LOAD_LANES(corner + 4 * LANES), v5 = LOAD_LANES(corner + 5 * LANES);
    const real v6 = LOAD_LANES(corner + 6 * LANES), v7 = LOAD_LANES(corner + 7 * LANES);
    const real x00 = mix(v0, v1, tx), x10 = mix(v2, v3, tx), x01 = mix(v4, v5, tx), x11 = mix(v6, v7, tx);
    const real y0 = mix(x00, x10, ty), y1 = mix(x01, x11, ty);
    Field field;
    field.value = mix(y0, y1, tz);
    field.gradient.x = mix(mix(v1 - v0, v3 - v2, ty), mix(v5 - v4, v7 - v6, ty), tz) * scale.x;
    field.gradient.y = mix(x10 - x00, x11 - x01, tz) * scale.y;
    field.gradient.z = (y1 - y0) * scale.z;
    return field;
}

// Axis-aligned boxes, one a lane.
typedef struct {
    Real3 low, high;
} Boxes;

INLINED Real3 clamp_to_boxes(Real3 p, const Boxes *boxes) {
    return make_real3(clamp(p.x, boxes->low.x, boxes->high.x), clamp(p.y, boxes->low.y, boxes->high.y),
                      clamp(p.z, boxes->low.z, boxes->high.z));
}

// One Newton step from `p` towards the isosurface, at most one cell long, inside the boxes. None where it is not finite.
INLINED Real3 newton_step_in_boxes(const Field *field, Real3 p, float3 per, const Boxes *boxes) {
#pragma OPENCL FP_CONTRACT ON
    const Real3 g = field->gradient;
    const real step = native_divide(-field->value, dot_real3(g, g));
    const Real3 d = make_real3(step * g.x * per.x, step * g.y * per.y, step * g.z * per.z);
    const real longest = largest_component(d);
    const real part = PICK(longest < INFINITY, native_recip(fmax(longest, 1.0f)), 0.0f);
    const Real3 moved = make_real3(p.x + d.x * part, p.y + d.y * part, p.z + d.z * part);
    return pick_real3(part > 0.0f, clamp_to_boxes(moved, boxes), p);
}

// Solves LANES columns from `column` on. `tile`: the brick's samples minus the isovalue; `last`: the last of them.
inline void solve_cubes(__local const float *tile, __local float *cubes, uint column, int3 last, float3 spacing) {
#pragma OPENCL FP_CONTRACT ON
    cubes += column;
    const Quadrics q = load_quadrics(cubes + CUBE_QUADRIC * CUBES, CUBES);
    const real per_k = native_recip(fmax(q.k, 1.0f));
    const float3 per = native_recip(spacing);
    const Real3 mean = scale_real3(q.m, per_k), up = quadrics_minimum(&q, mean);

    Boxes boxes;
    boxes.low = LOAD_REAL3(cubes + CUBE_LOW * CUBES, CUBES);
    boxes.high = LOAD_REAL3(cubes + CUBE_HIGH * CUBES, CUBES);
    boxes.low = make_real3(boxes.low.x + MARGIN, boxes.low.y + MARGIN, boxes.low.z + MARGIN);
    boxes.high = make_real3(boxes.high.x - MARGIN, boxes.high.y - MARGIN, boxes.high.z - MARGIN);
    // The quadric counts from the brick's centre.
    Real3 p = make_real3(4.0f + (mean.x + up.x) * per.x, 4.0f + (mean.y + up.y) * per.y, 4.0f + (mean.z + up.z) * per.z);
    p = clamp_to_boxes(p, &boxes);
    const Real3 start = p;
    Field field = field_in_brick(tile, last, p, per);
    const real off = fabs(field.value);
    for (uint newton = 0; newton < NEWTON_STEPS; newton++) {
        p = newton_step_in_boxes(&field, p, per, &boxes);
        field = field_in_brick(tile, last, p, per);
    }
    p = pick_real3(fabs(field.value) <= off, p, start);
    const Real3 world = make_real3((p.x - 4.0f) * spacing.x, (p.y - 4.0f) * spacing.y, (p.z - 4.0f) * spacing.z);
    // The mean gradient of the cells below is the cube's normal.
    const real normal = encode_normal_lanes(LOAD_REAL3(cubes + CUBE_SLOPE * CUBES, CUBES));
    STORE_REAL3(p, cubes + CUBE_VERTEX * CUBES, CUBES)
    STORE_LANES(normal, cubes + CUBE_NORMAL * CUBES);
    STORE_LANES(quadrics_error(&q, world, per_k), cubes + CUBE_ERROR * CUBES);
}

#endif
