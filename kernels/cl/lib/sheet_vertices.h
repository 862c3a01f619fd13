// Vertices of the sheets of cells with several sheets (docs/algorithm.md#62-sheets): LANES of them at once.
#ifndef ISOPEEL_SHEET_VERTICES_H
#define ISOPEEL_SHEET_VERTICES_H

#include "lib/precision.h"
#include "lib/device.h"
#include "lib/lanes.h"
#include "lib/octahedral.h"
#include "lib/trilinear.h"
#include "lib/vertex_record.h"

// A column is one sheet.
typedef struct {
    float corner[8 * LANES]; // samples at the cell's corners, minus the isovalue
    uint edges[LANES];       // the cell's crossed edges that belong to the sheet, one bit each
    float x[LANES], y[LANES], z[LANES], normal[LANES]; // vertex from the cell's low corner, encode_octahedral8 there as a number
} SheetVertices;

// Crossings of LANES sheets: sum, number and bounding box.
typedef struct {
    Real3 sum, low, high;
    real count;
} SheetCrossings;

// Adds a crossing at `p` if the sheet has the edge.
INLINED void add_sheet_crossing(SheetCrossings *s, mask_lanes edges, uint edge, Real3 p) {
#pragma OPENCL FP_CONTRACT ON
    const real w = PICK((edges & (1u << edge)) != 0u, 1.0f, 0.0f);
    s->sum.x += w * p.x;
    s->sum.y += w * p.y;
    s->sum.z += w * p.z;
    s->count += w;
    s->low.x = fmin(s->low.x, PICK(w > 0.0f, p.x, 1.0f));
    s->low.y = fmin(s->low.y, PICK(w > 0.0f, p.y, 1.0f));
    s->low.z = fmin(s->low.z, PICK(w > 0.0f, p.z, 1.0f));
    s->high.x = fmax(s->high.x, w * p.x);
    s->high.y = fmax(s->high.y, w * p.y);
    s->high.z = fmax(s->high.z, w * p.z);
}

// All crossings of the sheets, their box inside the margin.
INLINED SheetCrossings sheet_crossings(const Cells *c, mask_lanes edges) {
    SheetCrossings s;
    s.sum = make_real3(0.0f, 0.0f, 0.0f);
    s.count = 0.0f;
    s.low = make_real3(1.0f - MARGIN, 1.0f - MARGIN, 1.0f - MARGIN);
    s.high = make_real3(MARGIN, MARGIN, MARGIN);
    add_sheet_crossing(&s, edges, 0, make_real3(crossing_parameter(c->v0, c->v1), 0.0f, 0.0f));
    add_sheet_crossing(&s, edges, 1, make_real3(crossing_parameter(c->v2, c->v3), 1.0f, 0.0f));
    add_sheet_crossing(&s, edges, 2, make_real3(crossing_parameter(c->v4, c->v5), 0.0f, 1.0f));
    add_sheet_crossing(&s, edges, 3, make_real3(crossing_parameter(c->v6, c->v7), 1.0f, 1.0f));
    add_sheet_crossing(&s, edges, 4, make_real3(0.0f, crossing_parameter(c->v0, c->v2), 0.0f));
    add_sheet_crossing(&s, edges, 5, make_real3(0.0f, crossing_parameter(c->v4, c->v6), 1.0f));
    add_sheet_crossing(&s, edges, 6, make_real3(1.0f, crossing_parameter(c->v1, c->v3), 0.0f));
    add_sheet_crossing(&s, edges, 7, make_real3(1.0f, crossing_parameter(c->v5, c->v7), 1.0f));
    add_sheet_crossing(&s, edges, 8, make_real3(0.0f, 0.0f, crossing_parameter(c->v0, c->v4)));
    add_sheet_crossing(&s, edges, 9, make_real3(1.0f, 0.0f, crossing_parameter(c->v1, c->v5)));
    add_sheet_crossing(&s, edges, 10, make_real3(0.0f, 1.0f, crossing_parameter(c->v2, c->v6)));
    add_sheet_crossing(&s, edges, 11, make_real3(1.0f, 1.0f, crossing_parameter(c->v3, c->v7)));
    s.low = make_real3(fmax(s.low.x, MARGIN), fmax(s.low.y, MARGIN), fmax(s.low.z, MARGIN));
    s.high = make_real3(fmin(s.high.x, 1.0f - MARGIN), fmin(s.high.y, 1.0f - MARGIN), fmin(s.high.z, 1.0f - MARGIN));
    return s;
}

// One Newton step from `p` towards the isosurface, at most one cell long, inside the crossings' box. None if it is not finite.
INLINED Real3 newton_step_in_sheet(const Field *field, Real3 p, float3 per, const SheetCrossings *s) {
#pragma OPENCL FP_CONTRACT ON
    const Real3 g = field->gradient;
    const real step = native_divide(-field->value, dot_real3(g, g));
    const Real3 d = make_real3(g.x * per.x * step, g.y * per.y * step, g.z * per.z * step);
    const real longest = largest_component(d);
    const real part = PICK(longest < INFINITY, PICK(longest > 1.0f, native_recip(longest), 1.0f), 0.0f);
    const Real3 moved = make_real3(fmin(fmax(p.x + d.x * part, s->low.x), s->high.x),
                                   fmin(fmax(p.y + d.y * part, s->low.y), s->high.y),
                                   fmin(fmax(p.z + d.z * part, s->low.z), s->high.z));
    return pick_real3(part > 0.0f, moved, p);
}

// The vertex of a sheet: the mean of its crossings, moved SHEET_STEP of the way that Newton steps towards the isosurface take
// inside the box of its crossings. The boxes of two sheets of a cell may touch in a corner; not going all the way keeps their
// vertices apart there.
inline void solve_sheets(SheetVertices *sheets, float3 spacing) {
#pragma OPENCL FP_CONTRACT ON
    const Cells cells = LOAD_CELLS(sheets->corner, LANES);
    const SheetCrossings s = sheet_crossings(&cells, LOAD_MASK(sheets->edges));
    const real per_count = native_recip(s.count);
    const Real3 mean = make_real3(clamp(s.sum.x * per_count, MARGIN, 1.0f - MARGIN), clamp(s.sum.y * per_count, MARGIN, 1.0f - MARGIN),
                                  clamp(s.sum.z * per_count, MARGIN, 1.0f - MARGIN));
    const float3 per = native_recip(spacing);
    Real3 p = mean;
    for (uint newton = 0; newton < NEWTON_STEPS; newton++) {
        const Field field = field_in_cells(&cells, p, per);
        p = newton_step_in_sheet(&field, p, per, &s);
    }
    p = make_real3(mix(mean.x, p.x, SHEET_STEP), mix(mean.y, p.y, SHEET_STEP), mix(mean.z, p.z, SHEET_STEP));
    const Field field = field_in_cells(&cells, p, per);
    STORE_LANES(p.x, sheets->x);
    STORE_LANES(p.y, sheets->y);
    STORE_LANES(p.z, sheets->z);
    STORE_LANES(encode_normal_lanes(field.gradient), sheets->normal);
}

#endif
