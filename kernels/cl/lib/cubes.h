// The arithmetic of cubes of cells: from the sums over the cells below to the vertex, as cells.h does for cells.
#ifndef ISOPEEL_CUBES_H
#define ISOPEEL_CUBES_H

#include "lib/precision.h"
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
#define CUBE_QUADRIC 6 // a (6), b (3), c, m (3), k, from the brick's centre
#define CUBE_SUMS 20   // rows so far
#define CUBE_LOW 20    // x y z, then the high corner, x y z
// What solve_cubes writes in the quadric's place.
#define CUBE_VERTEX 6 // from the brick's low corner, in cells, x y z
#define CUBE_NORMAL 9 // encode_octahedral8 as a number
#define CUBE_ERROR 10 // root mean square distance to the planes of the crossings

// Field and gradient, per cell, of the brick's samples at x, y, z.
#define FIELD_IN_BRICK                                                                                                 \
    {                                                                                                                  \
        float at[3 * LANES], corner[8 * LANES];                                                                        \
        STORE_LANES(x, at);                                                                                            \
        STORE_LANES(y, at + LANES);                                                                                    \
        STORE_LANES(z, at + 2 * LANES);                                                                                \
        for (uint i = 0; i < LANES; i++) {                                                                             \
            const int3 from = clamp(convert_int3((float3)(at[i], at[LANES + i], at[2 * LANES + i])), (int3)(0), last - 1); \
            __local const float *v = tile + (from.z * 9 + from.y) * 9 + from.x;                                        \
            GATHER_CORNERS(v, corner + i, LANES)                                                                       \
            at[i] = (float)from.x;                                                                                     \
            at[LANES + i] = (float)from.y;                                                                             \
            at[2 * LANES + i] = (float)from.z;                                                                         \
        }                                                                                                              \
        const real tx = x - LOAD_LANES(at), ty = y - LOAD_LANES(at + LANES), tz = z - LOAD_LANES(at + 2 * LANES);      \
        const real v0 = LOAD_LANES(corner), v1 = LOAD_LANES(corner + LANES), v2 = LOAD_LANES(corner + 2 * LANES);      \
        const real v3 = LOAD_LANES(corner + 3 * LANES), v4 = LOAD_LANES(corner + 4 * LANES);                           \
        const real v5 = LOAD_LANES(corner + 5 * LANES), v6 = LOAD_LANES(corner + 6 * LANES);                           \
        const real v7 = LOAD_LANES(corner + 7 * LANES);                                                                \
        const real x00 = mix(v0, v1, tx), x10 = mix(v2, v3, tx), x01 = mix(v4, v5, tx), x11 = mix(v6, v7, tx);         \
        const real y0 = mix(x00, x10, ty), y1 = mix(x01, x11, ty);                                                     \
        now = mix(y0, y1, tz);                                                                                         \
        gx = mix(mix(v1 - v0, v3 - v2, ty), mix(v5 - v4, v7 - v6, ty), tz) * per.x;                                    \
        gy = mix(x10 - x00, x11 - x01, tz) * per.y;                                                                    \
        gz = (y1 - y0) * per.z;                                                                                        \
    }

// Works on LANES columns from `column` on. `tile`: the brick's samples minus the isovalue; `last`: their last place.
inline void solve_cubes(__local const float *tile, __local float *cubes, uint column, int3 last, float3 spacing) {
#pragma OPENCL FP_CONTRACT ON
    cubes += column;
    __local const float *q = cubes + CUBE_QUADRIC * CUBES;
    const real axx = LOAD_LANES(q), axy = LOAD_LANES(q + CUBES), axz = LOAD_LANES(q + 2 * CUBES);
    const real ayy = LOAD_LANES(q + 3 * CUBES), ayz = LOAD_LANES(q + 4 * CUBES), azz = LOAD_LANES(q + 5 * CUBES);
    const real bx = LOAD_LANES(q + 6 * CUBES), by = LOAD_LANES(q + 7 * CUBES), bz = LOAD_LANES(q + 8 * CUBES);
    const real c = LOAD_LANES(q + 9 * CUBES), k = LOAD_LANES(q + 13 * CUBES), per_k = native_recip(fmax(k, 1.0f));
    const float3 per = native_recip(spacing);
    const real mean_x = LOAD_LANES(q + 10 * CUBES) * per_k, mean_y = LOAD_LANES(q + 11 * CUBES) * per_k;
    const real mean_z = LOAD_LANES(q + 12 * CUBES) * per_k;

    SOLVE_QUADRIC

    __local const float *box = cubes + CUBE_LOW * CUBES;
    const real low_x = LOAD_LANES(box) + MARGIN, low_y = LOAD_LANES(box + CUBES) + MARGIN;
    const real low_z = LOAD_LANES(box + 2 * CUBES) + MARGIN;
    const real high_x = LOAD_LANES(box + 3 * CUBES) - MARGIN, high_y = LOAD_LANES(box + 4 * CUBES) - MARGIN;
    const real high_z = LOAD_LANES(box + 5 * CUBES) - MARGIN;
    real x = clamp(4.0f + (mean_x + up_x) * per.x, low_x, high_x);
    real y = clamp(4.0f + (mean_y + up_y) * per.y, low_y, high_y);
    real z = clamp(4.0f + (mean_z + up_z) * per.z, low_z, high_z);
    const real start_x = x, start_y = y, start_z = z;
    real now, gx, gy, gz;
    FIELD_IN_BRICK
    const real off = fabs(now);
    for (uint newton = 0; newton < NEWTON_STEPS; newton++) {
        // Towards the isosurface, at most a cell.
        const real far = native_divide(-now, gx * gx + gy * gy + gz * gz);
        const real dx = far * gx * per.x, dy = far * gy * per.y, dz = far * gz * per.z;
        const real longest = fmax(fmax(fabs(dx), fabs(dy)), fabs(dz));
        const real part = PICK(longest < INFINITY, native_recip(fmax(longest, 1.0f)), 0.0f);
        x = PICK(part > 0.0f, clamp(x + dx * part, low_x, high_x), x);
        y = PICK(part > 0.0f, clamp(y + dy * part, low_y, high_y), y);
        z = PICK(part > 0.0f, clamp(z + dz * part, low_z, high_z), z);
        FIELD_IN_BRICK
    }
    x = PICK(fabs(now) <= off, x, start_x);
    y = PICK(fabs(now) <= off, y, start_y);
    z = PICK(fabs(now) <= off, z, start_z);
    const real ex = (x - 4.0f) * spacing.x, ey = (y - 4.0f) * spacing.y, ez = (z - 4.0f) * spacing.z;
    const real error2 = ex * (axx * ex + axy * ey + axz * ez) + ey * (axy * ex + ayy * ey + ayz * ez)
        + ez * (axz * ex + ayz * ey + azz * ez) - 2.0f * (bx * ex + by * ey + bz * ez) + c;
    // The mean gradient of the cells below says which way the cube faces.
    const real normal = encode_normal_lanes(LOAD_LANES(cubes + CUBE_SLOPE * CUBES), LOAD_LANES(cubes + (CUBE_SLOPE + 1) * CUBES),
                                    LOAD_LANES(cubes + (CUBE_SLOPE + 2) * CUBES));
    STORE_LANES(x, cubes + CUBE_VERTEX * CUBES);
    STORE_LANES(y, cubes + (CUBE_VERTEX + 1) * CUBES);
    STORE_LANES(z, cubes + (CUBE_VERTEX + 2) * CUBES);
    STORE_LANES(normal, cubes + CUBE_NORMAL * CUBES);
    STORE_LANES(native_sqrt(fmax(error2 * per_k, 0.0f)), cubes + CUBE_ERROR * CUBES);
}

#undef FIELD_IN_BRICK
#endif
