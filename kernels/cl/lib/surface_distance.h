// Distance of points to the isosurface of the volume's trilinear interpolant, LANES points at a time: Newton steps along the
// gradient where the field is curved. What is found is the way to a point on the surface: never much less than the distance.
#ifndef ISOPEEL_SURFACE_DISTANCE_H
#define ISOPEEL_SURFACE_DISTANCE_H

#include "lib/precision.h"
#include "lib/device.h"
#include "lib/lanes.h"
#include "lib/layout.h"
#include "lib/samples.h"
#include "lib/trilinear.h"

// Newton steps at most, and distances by slope, in smallest spacings: up to which the field counts as straight, and from which the
// gradient does not lead to the surface.
#define SURFACE_STEPS 6
#define STRAIGHT 0.125f
#define ASTRAY 2.0f

// Where the surface is looked for: cells of the volume, without padding, whose samples the slab has.
typedef struct {
    int3 first, last; // cells
    float iso;
    float3 spacing;
    float straight; // STRAIGHT in world units
} FieldBox;

inline FieldBox make_field_box(Grid grid, float iso, uint cap, uint first_layer, uint end_layer) {
    FieldBox box;
    const int3 last = (int3)((int)grid.dims[0], (int)grid.dims[1], (int)grid.dims[2]) - 2;
    box.first = (int3)((int)cap);
    box.last = last - (int)cap;
    box.first.z = max(box.first.z, 32 * (int)first_layer);
    box.last.z = min(box.last.z, 32 * (int)end_layer - 1);
    box.iso = iso;
    box.spacing = (float3)(grid.spacing[0], grid.spacing[1], grid.spacing[2]);
    box.straight = STRAIGHT * fmin(fmin(box.spacing.x, box.spacing.y), box.spacing.z);
    return box;
}

// Whether the slab has the samples around `x`, in cells.
inline bool is_in_box(const FieldBox *box, float3 x) {
    return x.z >= (float)box->first.z && x.z <= (float)(box->last.z + 1);
}

// Value less the isovalue (w) and gradient in world units (xyz) at `x`, in cells.
inline float4 field_at(Grid grid, SLAB, const FieldBox *box, float3 x) {
    const int3 low = clamp(convert_int3(x), box->first, box->last);
    float v[8];
    for (uint corner = 0; corner < 8; corner++)
        v[corner] = sample_at(grid, SLAB_ARGS, low + (int3)(corner & 1, corner >> 1 & 1, corner >> 2)) - box->iso;
    const float4 field = trilinear(v, x - convert_float3(low));
    return (float4)(field.xyz / box->spacing, field.w);
}

// LANES points and what is found for them.
typedef struct {
    float from[3 * LANES];     // cells
    float at[3 * LANES];       // where the steps have come, cells
    float distance[LANES];     // world units, or NaN
    float residual[LANES];     // the part of it that is by slope, from the last step on
    float value[LANES];        // less the isovalue, where the steps have come
    float active[LANES];       // 1: more steps are wanted
} SurfaceSearch;

// Loads the samples at the corners of a cell, less the isovalue, into a column of eight rows. `low`: its low corner.
INLINED void load_cell(Grid grid, SLAB, float iso, int3 low, float *column) {
    __global const SAMPLE *first = samples + sample_index(grid, z0, low);
    const ulong row = grid.dims[0], plane = row * grid.dims[1];
    for (uint corner = 0; corner < 8; corner++) {
        const float v = (float)first[(corner & 1) + (corner >> 1 & 1) * row + (corner >> 2) * plane];
        column[corner * LANES] = v == grid.missing ? NAN : v - iso;
    }
}

// Loads the cells around the points that still move: corner values into rows, the points' place in their cell behind them.
INLINED void load_active_cells(Grid grid, SLAB, const FieldBox *box, const SurfaceSearch *search, uint count, float *rows) {
    for (uint i = 0; i < LANES; i++) {
        if (i >= count || !(search->active[i] > 0.0f)) continue;
        const float3 x = (float3)(search->at[i], search->at[LANES + i], search->at[2 * LANES + i]);
        const int3 low = clamp(convert_int3(x), box->first, box->last);
        load_cell(grid, SLAB_ARGS, box->iso, low, rows + i);
        const float3 t = x - convert_float3(low);
        rows[8 * LANES + i] = t.x;
        rows[9 * LANES + i] = t.y;
        rows[10 * LANES + i] = t.z;
    }
}

// Fills in the distances of the first `count` points.
INLINED void search_surface(Grid grid, SLAB, const FieldBox *box, SurfaceSearch *search, uint count) {
    float rows[11 * LANES];
    for (uint i = 0; i < 11 * LANES; i++) rows[i] = 0.0f;
    for (uint i = 0; i < LANES; i++) search->active[i] = i < count ? 1.0f : 0.0f;
    for (uint i = 0; i < 3 * LANES; i++) search->at[i] = search->from[i];
    const float3 inverse = 1.0f / box->spacing, low = convert_float3(box->first), high = convert_float3(box->last) + 1.0f;
    const Real3 from = LOAD_REAL3(search->from, LANES);
    Real3 x = from;
    for (uint step = 0; step <= SURFACE_STEPS; step++) {
        load_active_cells(grid, SLAB_ARGS, box, search, count, rows);
        const Cells cells = LOAD_CELLS(rows, LANES);
        const Field field = field_in_cells(&cells, LOAD_REAL3(rows + 8 * LANES, LANES), inverse);
        const real slope2 = dot_real3(field.gradient, field.gradient), residual = fabs(field.value) / sqrt(slope2);
        const Real3 way = make_real3((x.x - from.x) * box->spacing.x, (x.y - from.y) * box->spacing.y,
                                     (x.z - from.z) * box->spacing.z);
        STORE_LANES(sqrt(dot_real3(way, way)) + residual, search->distance);
        STORE_LANES(residual, search->residual);
        STORE_LANES(field.value, search->value);
        const integer moves = (residual > box->straight) & (residual < box->straight * (ASTRAY / STRAIGHT));
        STORE_LANES(PICK(moves, 1.0f, 0.0f), search->active);
        bool any_moves = false;
        for (uint i = 0; i < count; i++) any_moves = any_moves || search->active[i] > 0.0f;
        if (!any_moves || step == SURFACE_STEPS) break;
        // At most one cell.
        const real scale = -field.value / slope2;
        const Real3 far = make_real3(field.gradient.x * inverse.x * scale, field.gradient.y * inverse.y * scale,
                                     field.gradient.z * inverse.z * scale);
        const real shorter = 1.0f / fmax(largest_component(far), (real)1.0f);
        const Real3 to = make_real3(clamp(x.x + far.x * shorter, (real)low.x, (real)high.x),
                                    clamp(x.y + far.y * shorter, (real)low.y, (real)high.y),
                                    clamp(x.z + far.z * shorter, (real)low.z, (real)high.z));
        x = pick_real3(moves, to, x);
        STORE_REAL3(x, search->at, LANES);
    }
}

#endif
