// The arithmetic of active cells: from corner values to crossings, quadric and vertex. A CPU device works on LANES cells in one
// work-item's vector registers, without a branch, a GPU on one.
#ifndef ISOPEEL_CELLS_H
#define ISOPEEL_CELLS_H

#include "lib/precision.h"
#include "lib/bits.h"
#include "lib/cube.h"
#include "lib/device.h"
#include "lib/lanes.h"
#include "lib/octahedral.h"
#include "lib/quadric.h"
#include "lib/trilinear.h"
#include "lib/vertex_record.h"

// A cell of a brick as construct lists it: number of its level-1 cube in Morton order, then three bits each z, y, x. Neither way
// takes more than a few operations.
inline int3 in_brick(uint listed) { return (int3)((int)(listed & 7u), (int)(listed >> 3 & 7u), (int)(listed >> 6 & 7u)); }
inline uint in_order(uint listed) { return listed >> 9 << 3 | (listed & 1u) | (listed >> 2 & 2u) | (listed >> 4 & 4u); }

#define CELLS 64 // in one run; a column of every array below holds one cell

// Rows of the input: 8 corner values minus isovalue, then the cell's low corner from the quadric's origin, in cells.
#define IN_LOW 8
#define INPUTS 11

// Rows of the output.
#define OUT_SLOPE 0    // unit gradient at the cell's centre, x y z
#define OUT_SLOPED 3   // 0 where that gradient is zero
#define OUT_FEATURE 4  // left to the caller
#define OUT_COUNT 5    // left to the caller
#define OUT_QUADRIC 6  // a (6), b (3), c, m (3), k of Quadric
#define OUT_VERTEX 20  // vertex from the cell's low corner, in cells, x y z
#define OUT_NORMAL 23  // encode_octahedral8 there, as a number
#define OUT_ERROR 24   // its root mean square distance to the planes of the crossings
#define OUT_SIGNS 25   // which corners are inside, one bit each, as a number
#define OUTPUTS 26

#if LANES == 1
#define WEIGHT(lo, hi) 1.0f // only crossed edges are looked at
#else
#define WEIGHT(lo, hi) PICK((lo >= 0.0f) ^ (hi >= 0.0f), 1.0f, 0.0f)
#endif

// Adds the crossing of one edge, weighted 1 or 0. `lo`, `hi`: field at its ends; `px, py, pz`: the crossing from the cell's low
// corner; `gx, gy, gz`: the interpolant's gradient there, per cell. The last six may use `t`.
#define CROSS(lo, hi, px, py, pz, gx, gy, gz)                                                                          \
    {                                                                                                                  \
        const real w = WEIGHT(lo, hi);                                                                                 \
        const real t = PICK(w > 0.0f, clamp(native_divide(lo, lo - hi), 0.0f, 1.0f), 0.0f);                           \
        (void)t; /* a GPU's arguments do not name it */                                                                \
        real nx = (gx) * per_spacing.x, ny = (gy) * per_spacing.y, nz = (gz) * per_spacing.z;                          \
        const real length2 = nx * nx + ny * ny + nz * nz;                                                              \
        const real unit_w = PICK(length2 > 0.0f, w * rsqrt(length2), 0.0f);                                            \
        nx *= unit_w;                                                                                                  \
        ny *= unit_w;                                                                                                  \
        nz *= unit_w;                                                                                                  \
        const real qx = (low_x + (px)) * spacing.x, qy = (low_y + (py)) * spacing.y, qz = (low_z + (pz)) * spacing.z;  \
        const real d = nx * qx + ny * qy + nz * qz;                                                                    \
        axx += nx * nx;                                                                                                \
        axy += nx * ny;                                                                                                \
        axz += nx * nz;                                                                                                \
        ayy += ny * ny;                                                                                                \
        ayz += ny * nz;                                                                                                \
        azz += nz * nz;                                                                                                \
        bx += nx * d;                                                                                                  \
        by += ny * d;                                                                                                  \
        bz += nz * d;                                                                                                  \
        c += d * d;                                                                                                    \
        mx += w * qx;                                                                                                  \
        my += w * qy;                                                                                                  \
        mz += w * qz;                                                                                                  \
        k += w;                                                                                                        \
    }

// One Newton step towards the isosurface, at most a cell long, inside the margin.
#define STEP_TO_SURFACE                                                                                                \
    {                                                                                                                  \
        const real far = native_divide(-now, fmax(gx * gx + gy * gy + gz * gz, 1e-30f));                               \
        x = clamp(x + clamp(gx * per_spacing.x * far, -1.0f, 1.0f), MARGIN, 1.0f - MARGIN);                            \
        y = clamp(y + clamp(gy * per_spacing.y * far, -1.0f, 1.0f), MARGIN, 1.0f - MARGIN);                            \
        z = clamp(z + clamp(gz * per_spacing.z * far, -1.0f, 1.0f), MARGIN, 1.0f - MARGIN);                            \
        FIELD_IN_CELL(per_spacing)                                                                                     \
    }

#define INSIDE(v, bit) PICK(v >= 0.0f, bit, 0.0f)

// Along the axes x, y, z what lies along an edge's own axis and the two across it.
#define TURNED_X(along, b, c) (axis == 0 ? (along) : axis == 1 ? (c) : (b))
#define TURNED_Y(along, b, c) (axis == 0 ? (b) : axis == 1 ? (along) : (c))
#define TURNED_Z(along, b, c) (axis == 0 ? (c) : axis == 1 ? (b) : (along))

// Works on LANES columns from `column` on, whose samples it scales. `per_spacing`: least spacing over spacing; gradients need
// direction alone.
inline void solve_cells(__local float *in, __local float *out, uint column, float3 spacing, float3 per_spacing) {
#pragma OPENCL FP_CONTRACT ON
    in += column;
    out += column;
    real v0 = LOAD_LANES(in), v1 = LOAD_LANES(in + CELLS), v2 = LOAD_LANES(in + 2 * CELLS), v3 = LOAD_LANES(in + 3 * CELLS);
    real v4 = LOAD_LANES(in + 4 * CELLS), v5 = LOAD_LANES(in + 5 * CELLS), v6 = LOAD_LANES(in + 6 * CELLS);
    real v7 = LOAD_LANES(in + 7 * CELLS);
    const real low_x = LOAD_LANES(in + IN_LOW * CELLS), low_y = LOAD_LANES(in + (IN_LOW + 1) * CELLS);
    const real low_z = LOAD_LANES(in + (IN_LOW + 2) * CELLS);
    const real signs_number = INSIDE(v0, 1.0f) + INSIDE(v1, 2.0f) + INSIDE(v2, 4.0f) + INSIDE(v3, 8.0f) + INSIDE(v4, 16.0f)
        + INSIDE(v5, 32.0f) + INSIDE(v6, 64.0f) + INSIDE(v7, 128.0f);
    STORE_LANES(signs_number, out + OUT_SIGNS * CELLS);
    // Scaled to at most 4: neither huge nor tiny values leave the range of a float when squared; infinite ones become 1. By a power
    // of two, which rounds nothing: where the gradient is zero it stays so.
    const real most = fmax(fmax(fmax(fabs(v0), fabs(v1)), fmax(fabs(v2), fabs(v3))),
                           fmax(fmax(fabs(v4), fabs(v5)), fmax(fabs(v6), fabs(v7))));
    const real scale = AS_REAL(0x7f000000 - min(AS_INT(most) & 0x7f800000, 0x7e800000));
#define SCALED(v) PICK((most > 0.0f) & (most < INFINITY), v * scale, PICK(v >= 0.0f, 1.0f, -1.0f))
    v0 = SCALED(v0);
    v1 = SCALED(v1);
    v2 = SCALED(v2);
    v3 = SCALED(v3);
    v4 = SCALED(v4);
    v5 = SCALED(v5);
    v6 = SCALED(v6);
    v7 = SCALED(v7);
#undef SCALED
    CORNER_DIFFERENCES
    real gx = ((x00 + x10) + (x01 + x11)) * per_spacing.x, gy = ((y00 + y10) + (y01 + y11)) * per_spacing.y;
    real gz = ((z00 + z10) + (z01 + z11)) * per_spacing.z;
    const real slope2 = gx * gx + gy * gy + gz * gz;
    const real per_slope = PICK(slope2 > 0.0f, rsqrt(slope2), 0.0f);
    STORE_LANES(gx * per_slope, out + OUT_SLOPE * CELLS);
    STORE_LANES(gy * per_slope, out + (OUT_SLOPE + 1) * CELLS);
    STORE_LANES(gz * per_slope, out + (OUT_SLOPE + 2) * CELLS);
    STORE_LANES(slope2, out + OUT_SLOPED * CELLS);

    real axx = 0.0f, axy = 0.0f, axz = 0.0f, ayy = 0.0f, ayz = 0.0f, azz = 0.0f, bx = 0.0f, by = 0.0f, bz = 0.0f;
    real c = 0.0f, mx = 0.0f, my = 0.0f, mz = 0.0f, k = 0.0f;
#if LANES == 1
    // One crossed edge after another, from samples in local memory: fewer instructions than all twelve, and less text. What is
    // turned is computed before, as an expression in each of the three it takes 4 % more.
    const real scaled[8] = {v0, v1, v2, v3, v4, v5, v6, v7};
    for (uint corner = 0; corner < 8; corner++) in[corner * CELLS] = scaled[corner];
    ROLLED for (uint rest = crossed_edges((uint)signs_number); rest; rest &= rest - 1) {
        const uint edge = lowest_bit(rest), axis = edge >> 2, u = edge & 1, v = edge >> 1 & 1;
        const uint across_b = axis == 2 ? 1u : 2u << axis, across_c = axis == 0 ? 4u : axis;
        const uint low = edge_low_corner(edge), high = low | 1u << axis;
        const real lo = in[low * CELLS], hi = in[high * CELLS], share = clamp(native_divide(lo, lo - hi), 0.0f, 1.0f);
        const real b_lo = in[(low ^ across_b) * CELLS] - lo, b_hi = in[(high ^ across_b) * CELLS] - hi;
        const real c_lo = in[(low ^ across_c) * CELLS] - lo, c_hi = in[(high ^ across_c) * CELLS] - hi;
        const real g = hi - lo, g_b = mix(b_lo, b_hi, share) * (u ? -1.0f : 1.0f), g_c = mix(c_lo, c_hi, share) * (v ? -1.0f : 1.0f);
        CROSS(lo, hi, TURNED_X(share, (real)u, (real)v), TURNED_Y(share, (real)u, (real)v), TURNED_Z(share, (real)u, (real)v),
              TURNED_X(g, g_b, g_c), TURNED_Y(g, g_b, g_c), TURNED_Z(g, g_b, g_c))
    }
#else
    CROSS(v0, v1, t, 0.0f, 0.0f, x00, mix(y00, y10, t), mix(z00, z10, t))
    CROSS(v2, v3, t, 1.0f, 0.0f, x10, mix(y00, y10, t), mix(z01, z11, t))
    CROSS(v4, v5, t, 0.0f, 1.0f, x01, mix(y01, y11, t), mix(z00, z10, t))
    CROSS(v6, v7, t, 1.0f, 1.0f, x11, mix(y01, y11, t), mix(z01, z11, t))
    CROSS(v0, v2, 0.0f, t, 0.0f, mix(x00, x10, t), y00, mix(z00, z01, t))
    CROSS(v1, v3, 1.0f, t, 0.0f, mix(x00, x10, t), y10, mix(z10, z11, t))
    CROSS(v4, v6, 0.0f, t, 1.0f, mix(x01, x11, t), y01, mix(z00, z01, t))
    CROSS(v5, v7, 1.0f, t, 1.0f, mix(x01, x11, t), y11, mix(z10, z11, t))
    CROSS(v0, v4, 0.0f, 0.0f, t, mix(x00, x01, t), mix(y00, y01, t), z00)
    CROSS(v1, v5, 1.0f, 0.0f, t, mix(x00, x01, t), mix(y10, y11, t), z10)
    CROSS(v2, v6, 0.0f, 1.0f, t, mix(x10, x11, t), mix(y00, y01, t), z01)
    CROSS(v3, v7, 1.0f, 1.0f, t, mix(x10, x11, t), mix(y10, y11, t), z11)
#endif
    const real quadric[14] = {axx, axy, axz, ayy, ayz, azz, bx, by, bz, c, mx, my, mz, k};
    for (uint i = 0; i < 14; i++) STORE_LANES(quadric[i], out + (OUT_QUADRIC + i) * CELLS);

    const real per_k = native_recip(fmax(k, 1.0f)), mean_x = mx * per_k, mean_y = my * per_k, mean_z = mz * per_k;
    SOLVE_QUADRIC
    const float3 per = native_recip(spacing);
    real x = clamp((mean_x + up_x) * per.x - low_x, MARGIN, 1.0f - MARGIN);
    real y = clamp((mean_y + up_y) * per.y - low_y, MARGIN, 1.0f - MARGIN);
    real z = clamp((mean_z + up_z) * per.z - low_z, MARGIN, 1.0f - MARGIN);
    const real start_x = x, start_y = y, start_z = z;
    real now;
    FIELD_IN_CELL(per_spacing)
    const real off = fabs(now);
    for (uint newton = 0; newton < NEWTON_STEPS; newton++) STEP_TO_SURFACE
    x = PICK(fabs(now) <= off, x, start_x);
    y = PICK(fabs(now) <= off, y, start_y);
    z = PICK(fabs(now) <= off, z, start_z);
    STORE_LANES(x, out + OUT_VERTEX * CELLS);
    STORE_LANES(y, out + (OUT_VERTEX + 1) * CELLS);
    STORE_LANES(z, out + (OUT_VERTEX + 2) * CELLS);
    STORE_LANES(encode_normal_lanes(gx, gy, gz), out + OUT_NORMAL * CELLS);
    const real ex = (low_x + x) * spacing.x, ey = (low_y + y) * spacing.y, ez = (low_z + z) * spacing.z;
    const real error2 = ex * (axx * ex + axy * ey + axz * ez) + ey * (axy * ex + ayy * ey + ayz * ez)
        + ez * (axz * ex + ayz * ey + azz * ez) - 2.0f * (bx * ex + by * ey + bz * ez) + c;
    STORE_LANES(native_sqrt(fmax(error2 * per_k, 0.0f)), out + OUT_ERROR * CELLS);
}

#undef CROSS
#undef WEIGHT
#undef INSIDE
#undef TURNED_X
#undef TURNED_Y
#undef TURNED_Z
#undef STEP_TO_SURFACE
#endif
