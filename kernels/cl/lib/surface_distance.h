// Distance of points to the isosurface of the volume's trilinear interpolant, LANES points at a time: Newton steps along the gradient, then
// towards the foot of the perpendicular, along the surface and back to it. The result is the distance to a point near the surface: never much
// less than the distance to the surface. Points `x` are in cells, `p` in world units.
#ifndef ISOPEEL_SURFACE_DISTANCE_H
#define ISOPEEL_SURFACE_DISTANCE_H

#include "lib/precision.h"
#include "lib/device.h"
#include "lib/lanes.h"
#include "lib/layout.h"
#include "lib/samples.h"
#include "lib/trilinear.h"

// Newton steps at most, towards the surface and after each move along it, and how many such moves.
#define SURFACE_STEPS 6
#define FOOT_STEPS 3
#define SURFACE_MOVES 2

// Thresholds of the residual |V - iso| / |gradient|, in smallest spacings: converged; accepted; diverged, no more steps. ARRIVED is also the
// minimum of a move along the surface.
#define ARRIVED 0.01f
#define STRAIGHT 0.125f
#define ASTRAY 2.0f

// Box in which the surface is searched: cells of the volume, without padding, whose samples the slab has.
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
    float at[3 * LANES];       // position after the steps so far, cells
    float distance[LANES];     // world units, or NaN
    float residual[LANES];     // the part of it that is by slope, from the last step on
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

// The search for LANES points, in registers.
typedef struct {
    Real3 from, x;           // cells
    real distance, residual; // of the nearest so far
    Field field;             // at x
} Feet;

INLINED Real3 clamp_to_box(const FieldBox *box, Real3 x) {
    const float3 low = convert_float3(box->first), high = convert_float3(box->last) + 1.0f;
    return make_real3(clamp(x.x, (real)low.x, (real)high.x), clamp(x.y, (real)low.y, (real)high.y), clamp(x.z, (real)low.z, (real)high.z));
}

// Displacement of the points by the steps so far, world units.
INLINED Real3 way_of(const FieldBox *box, const Feet *feet) {
    return make_real3((feet->x.x - feet->from.x) * box->spacing.x, (feet->x.y - feet->from.y) * box->spacing.y,
                      (feet->x.z - feet->from.z) * box->spacing.z);
}

// Makes the points of a mask active, and no others. Returns whether there are any.
INLINED bool activate(SurfaceSearch *search, integer mask, uint count) {
    STORE_LANES(PICK(mask, 1.0f, 0.0f), search->active);
    bool any_active = false;
    for (uint i = 0; i < count; i++) any_active = any_active || search->active[i] > 0.0f;
    return any_active;
}

// Newton steps of the active points, until they have converged. `moves`: number of moves along the surface before.
INLINED void step_to_surface(Grid grid, SLAB, const FieldBox *box, SurfaceSearch *search, Feet *feet, float *rows, uint count, uint moves) {
    const float3 inverse = 1.0f / box->spacing;
    const uint steps = moves ? FOOT_STEPS : SURFACE_STEPS;
    const integer searching = LOAD_LANES(search->active) > 0.0f;
    for (uint step = 0; step <= steps; step++) {
        load_active_cells(grid, SLAB_ARGS, box, search, count, rows);
        const Cells cells = LOAD_CELLS(rows, LANES);
        feet->field = field_in_cells(&cells, LOAD_REAL3(rows + 8 * LANES, LANES), inverse);
        const Field field = feet->field;
        const real slope2 = dot_real3(field.gradient, field.gradient), residual = fabs(field.value) / sqrt(slope2);
        const Real3 way = way_of(box, feet);
        const real distance = sqrt(dot_real3(way, way)) + residual;
        const integer better = (residual <= box->straight) & (distance < feet->distance);
        feet->distance = moves ? PICK(better, distance, feet->distance) : distance;
        feet->residual = moves ? PICK(better, residual, feet->residual) : residual;
        const integer unconverged = searching & (residual > box->straight * (ARRIVED / STRAIGHT))
            & (residual < box->straight * (ASTRAY / STRAIGHT));
        if (!activate(search, unconverged, count) || step == steps) break;
        // At most one cell.
        const real scale = -field.value / slope2;
        const Real3 step_in_cells = make_real3(field.gradient.x * inverse.x * scale, field.gradient.y * inverse.y * scale,
                                               field.gradient.z * inverse.z * scale);
        const real shorter = 1.0f / fmax(largest_component(step_in_cells), (real)1.0f);
        const Real3 to = make_real3(feet->x.x + step_in_cells.x * shorter, feet->x.y + step_in_cells.y * shorter,
                                    feet->x.z + step_in_cells.z * shorter);
        feet->x = pick_real3(unconverged, clamp_to_box(box, to), feet->x);
        STORE_REAL3(feet->x, search->at, LANES);
    }
}

// Moves points that are on the surface along it, to the foot of the perpendicular from their start point, as if the surface were a plane. The
// moved points become the active points; points that are already at the foot do not move. Returns false if no point moves.
INLINED bool move_along_surface(const FieldBox *box, SurfaceSearch *search, Feet *feet, uint count) {
    const Field field = feet->field;
    const Real3 way = way_of(box, feet);
    const real along_normal = dot_real3(way, field.gradient) / dot_real3(field.gradient, field.gradient);
    const Real3 aside = make_real3(way.x - along_normal * field.gradient.x, way.y - along_normal * field.gradient.y,
                                   way.z - along_normal * field.gradient.z);
    const real shortest = box->straight * (ARRIVED / STRAIGHT);
    const integer moves = (feet->residual <= box->straight) & (dot_real3(aside, aside) > shortest * shortest);
    const Real3 to = make_real3(feet->x.x - aside.x / box->spacing.x, feet->x.y - aside.y / box->spacing.y,
                                feet->x.z - aside.z / box->spacing.z);
    feet->x = pick_real3(moves, clamp_to_box(box, to), feet->x);
    STORE_REAL3(feet->x, search->at, LANES);
    return activate(search, moves, count);
}

// Whether the search for a point arrived at the surface.
INLINED bool arrived(const FieldBox *box, const SurfaceSearch *search, uint i) {
    return search->residual[i] <= fmax(box->straight, 0.125f * search->distance[i]);
}

// Begins a search for `count` points from their positions.
INLINED void begin_search(SurfaceSearch *search, uint count) {
    for (uint i = 0; i < LANES; i++) search->active[i] = i < count ? 1.0f : 0.0f;
    for (uint i = 0; i < 3 * LANES; i++) search->at[i] = search->from[i];
}

// Searches from `at` for the first `count` points. Fills in `distance` and `residual` of those that are active; the others are undefined.
INLINED void search_surface(Grid grid, SLAB, const FieldBox *box, SurfaceSearch *search, uint count) {
    float rows[11 * LANES];
    for (uint i = 0; i < 11 * LANES; i++) rows[i] = 0.0f;
    Feet feet;
    feet.from = LOAD_REAL3(search->from, LANES);
    feet.x = LOAD_REAL3(search->at, LANES);
    feet.distance = INFINITY;
    feet.residual = INFINITY;
    for (uint moves = 0; moves <= SURFACE_MOVES; moves++) {
        if (moves && !move_along_surface(box, search, &feet, count)) break;
        step_to_surface(grid, SLAB_ARGS, box, search, &feet, rows, count, moves);
    }
    STORE_LANES(feet.distance, search->distance);
    STORE_LANES(feet.residual, search->residual);
}

#endif
