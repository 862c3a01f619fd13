// From the corner values of active cells to their crossings' quadric, vertex, normal and error
// (docs/algorithm.md#63-vertex-placement): LANES cells at once, without branches on a CPU.
#ifndef ISOPEEL_CELL_SOLVER_H
#define ISOPEEL_CELL_SOLVER_H

#include "lib/precision.h"
#include "lib/bits.h"
#include "lib/cube.h"
#include "lib/device.h"
#include "lib/lanes.h"
#include "lib/octahedral.h"
#include "lib/quadric.h"
#include "lib/trilinear.h"
#include "lib/vertex_record.h"

// A cell of a brick as construct lists it: the Morton number of its level-1 cube, then z, y and x in three bits each. Both its
// coordinates and its Morton number take few operations.
inline int3 listed_cell(uint entry) { return (int3)((int)(entry & 7u), (int)(entry >> 3 & 7u), (int)(entry >> 6 & 7u)); }
inline uint listed_morton(uint entry) { return entry >> 9 << 3 | (entry & 1u) | (entry >> 2 & 2u) | (entry >> 4 & 4u); }

#define CELLS 64 // columns of the arrays below: cells solved between two barriers

// Rows of the input: corner values minus isovalue, then the cell's low corner from the quadric's origin, in cells.
#define IN_LOW 8
#define INPUTS 11

// Rows of the output.
#define OUT_SLOPE 0    // unit gradient at the cell's centre, x y z
#define OUT_SLOPED 3   // 0 if that gradient is zero
#define OUT_FEATURE 4  // left to the caller
#define OUT_COUNT 5    // left to the caller
#define OUT_SUMS 6     // rows so far, which cubes sum up
#define OUT_RECORD 6   // the bytes of its VertexRecord, four by four
#define OUT_SIGNS 9    // which corners are inside, one bit each, as a number
#define OUTPUTS 10

// What the crossings of LANES cells need beside the corner values.
typedef struct {
    Real3 low;          // low corners from the quadric's origin, in cells
    float3 spacing;
    float3 per_spacing; // smallest spacing / spacing: gradients need direction alone
} CellFrame;

// Adds a crossing at `p` from the cell's low corner, in cells. `gradient`: per cell.
INLINED void add_cell_crossing(Quadrics *q, const CellFrame *frame, real weight, Real3 p, Real3 gradient) {
#pragma OPENCL FP_CONTRACT ON
    const Real3 world = make_real3((frame->low.x + p.x) * frame->spacing.x, (frame->low.y + p.y) * frame->spacing.y,
                                   (frame->low.z + p.z) * frame->spacing.z);
    const Real3 scaled = make_real3(gradient.x * frame->per_spacing.x, gradient.y * frame->per_spacing.y,
                                    gradient.z * frame->per_spacing.z);
    add_crossing(q, weight, world, scaled);
}

#if LANES == 1
// The crossings of one cell: one crossed edge after another, from the corner values in `in`, which are fewer instructions than
// all twelve.
INLINED Quadrics cell_crossings(const Cells *cells, const CellFrame *frame, uint signs, __local float *in) {
    const real corners[8] = {cells->v0, cells->v1, cells->v2, cells->v3, cells->v4, cells->v5, cells->v6, cells->v7};
    for (uint corner = 0; corner < 8; corner++) in[corner * CELLS] = corners[corner];
    Quadrics q = no_quadrics();
    ROLLED for (uint rest = crossed_edges(signs); rest; rest &= rest - 1) {
        const uint edge = lowest_bit(rest), axis = edge >> 2, u = edge & 1, v = edge >> 1 & 1;
        const uint corner_b = axis == 2 ? 1u : 2u << axis, corner_c = axis == 0 ? 4u : axis;
        const uint low = edge_low_corner(edge), high = low | 1u << axis;
        const real lo = in[low * CELLS], hi = in[high * CELLS], t = clamp(native_divide(lo, lo - hi), 0.0f, 1.0f);
        const real b_lo = in[(low ^ corner_b) * CELLS] - lo, b_hi = in[(high ^ corner_b) * CELLS] - hi;
        const real c_lo = in[(low ^ corner_c) * CELLS] - lo, c_hi = in[(high ^ corner_c) * CELLS] - hi;
        // Along the edge's own axis and the next two.
        const Real3 p = make_real3(t, (real)u, (real)v);
        const Real3 g = make_real3(hi - lo, mix(b_lo, b_hi, t) * (u ? -1.0f : 1.0f), mix(c_lo, c_hi, t) * (v ? -1.0f : 1.0f));
        add_cell_crossing(&q, frame, 1.0f, permute_from_axis(p, axis), permute_from_axis(g, axis));
    }
    return q;
}
#else
// Weight and parameter of the crossing between two corners: weight 0 if there is none.
INLINED real edge_weight(real lo, real hi) { return PICK((lo >= 0.0f) ^ (hi >= 0.0f), 1.0f, 0.0f); }
INLINED real edge_parameter(real weight, real lo, real hi) {
    return PICK(weight > 0.0f, clamp(native_divide(lo, lo - hi), 0.0f, 1.0f), 0.0f);
}

// The crossing of an edge along x between corner values `lo` and `hi`, at `y` and `z`. `slope`: their difference; the others:
// differences along y and z at the edge's low and high end.
INLINED void add_edge_x(Quadrics *q, const CellFrame *frame, real lo, real hi, float y, float z, real slope, real y_lo, real y_hi,
                       real z_lo, real z_hi) {
    const real w = edge_weight(lo, hi), t = edge_parameter(w, lo, hi);
    add_cell_crossing(q, frame, w, make_real3(t, y, z), make_real3(slope, mix(y_lo, y_hi, t), mix(z_lo, z_hi, t)));
}
INLINED void add_edge_y(Quadrics *q, const CellFrame *frame, real lo, real hi, float x, float z, real slope, real x_lo, real x_hi,
                       real z_lo, real z_hi) {
    const real w = edge_weight(lo, hi), t = edge_parameter(w, lo, hi);
    add_cell_crossing(q, frame, w, make_real3(x, t, z), make_real3(mix(x_lo, x_hi, t), slope, mix(z_lo, z_hi, t)));
}
INLINED void add_edge_z(Quadrics *q, const CellFrame *frame, real lo, real hi, float x, float y, real slope, real x_lo, real x_hi,
                       real y_lo, real y_hi) {
    const real w = edge_weight(lo, hi), t = edge_parameter(w, lo, hi);
    add_cell_crossing(q, frame, w, make_real3(x, y, t), make_real3(mix(x_lo, x_hi, t), mix(y_lo, y_hi, t), slope));
}

// The crossings of LANES cells: all twelve edges, with weight 0 if an edge is not crossed.
INLINED Quadrics cell_crossings(const Cells *c, const CellFrame *frame) {
    Quadrics q = no_quadrics();
    add_edge_x(&q, frame, c->v0, c->v1, 0.0f, 0.0f, c->x00, c->y00, c->y10, c->z00, c->z10);
    add_edge_x(&q, frame, c->v2, c->v3, 1.0f, 0.0f, c->x10, c->y00, c->y10, c->z01, c->z11);
    add_edge_x(&q, frame, c->v4, c->v5, 0.0f, 1.0f, c->x01, c->y01, c->y11, c->z00, c->z10);
    add_edge_x(&q, frame, c->v6, c->v7, 1.0f, 1.0f, c->x11, c->y01, c->y11, c->z01, c->z11);
    add_edge_y(&q, frame, c->v0, c->v2, 0.0f, 0.0f, c->y00, c->x00, c->x10, c->z00, c->z01);
    add_edge_y(&q, frame, c->v1, c->v3, 1.0f, 0.0f, c->y10, c->x00, c->x10, c->z10, c->z11);
    add_edge_y(&q, frame, c->v4, c->v6, 0.0f, 1.0f, c->y01, c->x01, c->x11, c->z00, c->z01);
    add_edge_y(&q, frame, c->v5, c->v7, 1.0f, 1.0f, c->y11, c->x01, c->x11, c->z10, c->z11);
    add_edge_z(&q, frame, c->v0, c->v4, 0.0f, 0.0f, c->z00, c->x00, c->x01, c->y00, c->y01);
    add_edge_z(&q, frame, c->v1, c->v5, 1.0f, 0.0f, c->z10, c->x00, c->x01, c->y10, c->y11);
    add_edge_z(&q, frame, c->v2, c->v6, 0.0f, 1.0f, c->z01, c->x10, c->x11, c->y00, c->y01);
    add_edge_z(&q, frame, c->v3, c->v7, 1.0f, 1.0f, c->z11, c->x10, c->x11, c->y10, c->y11);
    return q;
}
#endif

// `bit` if a corner value is inside, else 0.
INLINED real sign_bit(real v, float bit) { return PICK(v >= 0.0f, bit, 0.0f); }

// The signs of the corners as a number, corner 0 lowest.
INLINED real corner_sign_bits(const Cells *c) {
    return sign_bit(c->v0, 1.0f) + sign_bit(c->v1, 2.0f) + sign_bit(c->v2, 4.0f) + sign_bit(c->v3, 8.0f) + sign_bit(c->v4, 16.0f)
        + sign_bit(c->v5, 32.0f) + sign_bit(c->v6, 64.0f) + sign_bit(c->v7, 128.0f);
}

// A corner value scaled; if the largest is infinite or zero, its sign.
INLINED real scale_corner(real v, real largest, real scale) {
    return PICK((largest > 0.0f) & (largest < INFINITY), v * scale, PICK(v >= 0.0f, 1.0f, -1.0f));
}

// Corner values scaled to at most 4, so that neither huge nor tiny ones leave the range of a float when squared; infinite ones
// become 1. By a power of two, which rounds nothing: a zero gradient stays zero.
INLINED Cells scale_cells(const Cells *c) {
    const real largest = fmax(fmax(fmax(fabs(c->v0), fabs(c->v1)), fmax(fabs(c->v2), fabs(c->v3))),
                              fmax(fmax(fabs(c->v4), fabs(c->v5)), fmax(fabs(c->v6), fabs(c->v7))));
    const real scale = AS_REAL(0x7f000000 - min(AS_INT(largest) & 0x7f800000, 0x7e800000));
    return make_cells(scale_corner(c->v0, largest, scale), scale_corner(c->v1, largest, scale),
                      scale_corner(c->v2, largest, scale), scale_corner(c->v3, largest, scale),
                      scale_corner(c->v4, largest, scale), scale_corner(c->v5, largest, scale),
                      scale_corner(c->v6, largest, scale), scale_corner(c->v7, largest, scale));
}

// Moves `p` by one Newton step towards the isosurface, at most a cell along each axis, inside the margin.
INLINED void newton_step_in_cells(const Cells *c, float3 per_spacing, Real3 *p, Field *field) {
#pragma OPENCL FP_CONTRACT ON
    const Real3 g = field->gradient;
    const real step = native_divide(-field->value, fmax(dot_real3(g, g), 1e-30f));
    p->x = clamp(p->x + clamp(g.x * per_spacing.x * step, -1.0f, 1.0f), MARGIN, 1.0f - MARGIN);
    p->y = clamp(p->y + clamp(g.y * per_spacing.y * step, -1.0f, 1.0f), MARGIN, 1.0f - MARGIN);
    p->z = clamp(p->z + clamp(g.z * per_spacing.z * step, -1.0f, 1.0f), MARGIN, 1.0f - MARGIN);
    *field = field_in_cells(c, *p, per_spacing);
}

// Vertices of LANES cells from their low corners, in cells: the quadric's minimum, then Newton steps if these come closer to the
// isosurface. `field`: receives the field at the last step. `per_k`: 1 / number of crossings.
INLINED Real3 cell_vertices(const Cells *c, const CellFrame *frame, const Quadrics *q, real per_k, Field *field) {
#pragma OPENCL FP_CONTRACT ON
    const Real3 mean = scale_real3(q->m, per_k), up = quadrics_minimum(q, mean, CELL_PULL), low = frame->low;
    const float3 per = native_recip(frame->spacing);
    Real3 p;
    p.x = clamp((mean.x + up.x) * per.x - low.x, MARGIN, 1.0f - MARGIN);
    p.y = clamp((mean.y + up.y) * per.y - low.y, MARGIN, 1.0f - MARGIN);
    p.z = clamp((mean.z + up.z) * per.z - low.z, MARGIN, 1.0f - MARGIN);
    const Real3 start = p;
    *field = field_in_cells(c, p, frame->per_spacing);
    const real off = fabs(field->value);
    for (uint newton = 0; newton < NEWTON_STEPS; newton++) newton_step_in_cells(c, frame->per_spacing, &p, field);
    return pick_real3(fabs(field->value) <= off, p, start);
}

// VertexRecord::position of LANES coordinates, in cells from the region's low corner: to_lattice.
INLINED integer to_lattice_lanes(real cells) { return TO_INTEGER(cells * VERTEX_LATTICE + 0.5f); }

// Stores the vertex records of LANES cells. `p`: vertices, in cells from the region's low corner; `normal`: as a number.
INLINED void store_records(__local float *out, Real3 p, real normal, real error) {
    STORE_LANES(AS_REAL(to_lattice_lanes(p.x) | to_lattice_lanes(p.y) << 16), out);
    STORE_LANES(AS_REAL(to_lattice_lanes(p.z) | TO_INTEGER(normal) << 16), out + CELLS);
    STORE_LANES(error, out + 2 * CELLS);
}

// Solves LANES columns from `column` on; scales the corner values in `in`. `centre`: the quadric's origin from the region's low corner,
// in cells.
inline void solve_cells(__local float *in, __local float *out, uint column, float3 centre, float3 spacing, float3 per_spacing) {
#pragma OPENCL FP_CONTRACT ON
    in += column;
    out += column;
    Cells cells = LOAD_CELLS(in, CELLS);
    CellFrame frame;
    frame.low = LOAD_REAL3(in + IN_LOW * CELLS, CELLS);
    frame.spacing = spacing;
    frame.per_spacing = per_spacing;
    const real signs = corner_sign_bits(&cells);
    STORE_LANES(signs, out + OUT_SIGNS * CELLS);
    cells = scale_cells(&cells);

    const Real3 slope = make_real3(((cells.x00 + cells.x10) + (cells.x01 + cells.x11)) * per_spacing.x,
                                   ((cells.y00 + cells.y10) + (cells.y01 + cells.y11)) * per_spacing.y,
                                   ((cells.z00 + cells.z10) + (cells.z01 + cells.z11)) * per_spacing.z);
    const real slope2 = dot_real3(slope, slope);
    STORE_REAL3(scale_real3(slope, PICK(slope2 > 0.0f, rsqrt(slope2), 0.0f)), out + OUT_SLOPE * CELLS, CELLS)
    STORE_LANES(slope2, out + OUT_SLOPED * CELLS);

#if LANES == 1
    const Quadrics q = cell_crossings(&cells, &frame, (uint)signs, in);
#else
    const Quadrics q = cell_crossings(&cells, &frame);
#endif

    const real per_k = native_recip(fmax(q.k, 1.0f));
    Field field;
    const Real3 p = cell_vertices(&cells, &frame, &q, per_k, &field);
    const Real3 world = make_real3((frame.low.x + p.x) * spacing.x, (frame.low.y + p.y) * spacing.y, (frame.low.z + p.z) * spacing.z);
    // Low corners first: whole numbers, whose sum is exact.
    const Real3 in_region = make_real3((frame.low.x + centre.x) + p.x, (frame.low.y + centre.y) + p.y, (frame.low.z + centre.z) + p.z);
    store_records(out + OUT_RECORD * CELLS, in_region, encode_normal_lanes(field.gradient), quadrics_error(&q, world, per_k));
}

#endif
