// Vertices of the sheets of cells that the surface crosses in several: LANES of them at once.
#ifndef ISOPEEL_SHEET_VERTICES_H
#define ISOPEEL_SHEET_VERTICES_H

#include "lib/precision.h"
#include "lib/lanes.h"
#include "lib/octahedral.h"
#include "lib/trilinear.h"
#include "lib/vertex_record.h"

// A column is one sheet.
typedef struct {
    float corner[8 * LANES]; // samples at the cell's corners, minus the isovalue
    uint edges[LANES];       // those of the cell's crossed edges that belong to the sheet, one bit each
    float x[LANES], y[LANES], z[LANES], normal[LANES]; // the vertex from the cell's low corner, and encode_octahedral8 there, as numbers
} SheetVertices;

// The sheet's crossing of one edge, at px, py, pz, which may use `t`.
#define ADD_CROSSING(edge, from, to, px, py, pz)                                                                       \
    {                                                                                                                  \
        const real t = crossing_parameter(from, to);                                                                       \
        const real w = PICK((edges & (1u << (edge))) != 0u, 1.0f, 0.0f);                                               \
        const real x = px, y = py, z = pz;                                                                             \
        sum_x += w * x;                                                                                                \
        sum_y += w * y;                                                                                                \
        sum_z += w * z;                                                                                                \
        count += w;                                                                                                    \
        least_x = fmin(least_x, PICK(w > 0.0f, x, 1.0f));                                                              \
        least_y = fmin(least_y, PICK(w > 0.0f, y, 1.0f));                                                              \
        least_z = fmin(least_z, PICK(w > 0.0f, z, 1.0f));                                                              \
        most_x = fmax(most_x, w * x);                                                                                  \
        most_y = fmax(most_y, w * y);                                                                                  \
        most_z = fmax(most_z, w * z);                                                                                  \
    }

// The vertex of a sheet is the mean of its own crossings, moved towards the isosurface inside their box, which two sheets share
// at most a part of. It goes most of the way alone: where boxes touch, in a corner, two vertices might meet at its end.
inline void place_sheets(SheetVertices *sheets, float3 spacing) {
#pragma OPENCL FP_CONTRACT ON
    const real v0 = LOAD_LANES(sheets->corner), v1 = LOAD_LANES(sheets->corner + LANES);
    const real v2 = LOAD_LANES(sheets->corner + 2 * LANES), v3 = LOAD_LANES(sheets->corner + 3 * LANES);
    const real v4 = LOAD_LANES(sheets->corner + 4 * LANES), v5 = LOAD_LANES(sheets->corner + 5 * LANES);
    const real v6 = LOAD_LANES(sheets->corner + 6 * LANES), v7 = LOAD_LANES(sheets->corner + 7 * LANES);
    CORNER_DIFFERENCES
    const mask_lanes edges = LOAD_MASK(sheets->edges);
    real sum_x = 0.0f, sum_y = 0.0f, sum_z = 0.0f, count = 0.0f;
    real least_x = 1.0f - MARGIN, least_y = least_x, least_z = least_x, most_x = MARGIN, most_y = most_x, most_z = most_x;
    ADD_CROSSING(0, v0, v1, t, 0.0f, 0.0f)
    ADD_CROSSING(1, v2, v3, t, 1.0f, 0.0f)
    ADD_CROSSING(2, v4, v5, t, 0.0f, 1.0f)
    ADD_CROSSING(3, v6, v7, t, 1.0f, 1.0f)
    ADD_CROSSING(4, v0, v2, 0.0f, t, 0.0f)
    ADD_CROSSING(5, v4, v6, 0.0f, t, 1.0f)
    ADD_CROSSING(6, v1, v3, 1.0f, t, 0.0f)
    ADD_CROSSING(7, v5, v7, 1.0f, t, 1.0f)
    ADD_CROSSING(8, v0, v4, 0.0f, 0.0f, t)
    ADD_CROSSING(9, v1, v5, 1.0f, 0.0f, t)
    ADD_CROSSING(10, v2, v6, 0.0f, 1.0f, t)
    ADD_CROSSING(11, v3, v7, 1.0f, 1.0f, t)
    least_x = fmax(least_x, MARGIN);
    least_y = fmax(least_y, MARGIN);
    least_z = fmax(least_z, MARGIN);
    most_x = fmin(most_x, 1.0f - MARGIN);
    most_y = fmin(most_y, 1.0f - MARGIN);
    most_z = fmin(most_z, 1.0f - MARGIN);
    const real per_count = native_recip(count);
    const real mean_x = clamp(sum_x * per_count, MARGIN, 1.0f - MARGIN), mean_y = clamp(sum_y * per_count, MARGIN, 1.0f - MARGIN);
    const real mean_z = clamp(sum_z * per_count, MARGIN, 1.0f - MARGIN);
    const float3 per = native_recip(spacing);
    real x = mean_x, y = mean_y, z = mean_z, now, gx, gy, gz;
    for (uint newton = 0; newton < NEWTON_STEPS; newton++) {
        FIELD_IN_CELL(per)
        const real far = native_divide(-now, gx * gx + gy * gy + gz * gz);
        const real step_x = gx * per.x * far, step_y = gy * per.y * far, step_z = gz * per.z * far;
        const real longest = fmax(fmax(fabs(step_x), fabs(step_y)), fabs(step_z));
        // At most one cell long; none where there is no way.
        const real part = PICK(longest < INFINITY, PICK(longest > 1.0f, native_recip(longest), 1.0f), 0.0f);
        x = PICK(part > 0.0f, fmin(fmax(x + step_x * part, least_x), most_x), x);
        y = PICK(part > 0.0f, fmin(fmax(y + step_y * part, least_y), most_y), y);
        z = PICK(part > 0.0f, fmin(fmax(z + step_z * part, least_z), most_z), z);
    }
    x = mix(mean_x, x, SHEET_STEP);
    y = mix(mean_y, y, SHEET_STEP);
    z = mix(mean_z, z, SHEET_STEP);
    FIELD_IN_CELL(per)
    STORE_LANES(x, sheets->x);
    STORE_LANES(y, sheets->y);
    STORE_LANES(z, sheets->z);
    STORE_LANES(encode_normal_lanes(gx, gy, gz), sheets->normal);
}

#undef ADD_CROSSING
#endif
