// Where a node's vertex goes: the point that fits the planes of all crossings below best, moved onto the isosurface.
#ifndef ISOPEEL_QUADRIC_H
#define ISOPEEL_QUADRIC_H

#include "lib/grid.h"

#define MEAN_WEIGHT 0.05f          // pull towards the mean of the crossings, each of them
#define MARGIN (1.0f / 32.0f)      // vertices stay this far inside their cube, so that those of two cubes never meet
#define NEWTON_STEPS 2
#define SHEET_STEP 0.875f          // of the way to the isosurface that the vertex of one of several sheets goes

inline float3 unit(float3 g) {
    // Scaled first, so that neither huge nor tiny values leave the range of a float when squared.
    const float largest = fmax(fmax(fabs(g.x), fabs(g.y)), fabs(g.z));
    // fmax passes over a NaN, which differences of infinities are.
    if (!(largest > 0.0f) || !all(isfinite(g))) return (float3)(0.0f);
    g /= largest;
    return g / sqrt(dot(g, g));
}

inline Quadric no_quadric() {
    Quadric q = {{0.0f, 0.0f, 0.0f, 0.0f, 0.0f, 0.0f}, {0.0f, 0.0f, 0.0f}, 0.0f, {0.0f, 0.0f, 0.0f}, 0.0f};
    return q;
}

inline void add_quadric(Quadric *into, Quadric q) {
    for (uint i = 0; i < 6; i++) into->a[i] += q.a[i];
    for (uint i = 0; i < 3; i++) { into->b[i] += q.b[i]; into->m[i] += q.m[i]; }
    into->c += q.c;
    into->k += q.k;
}

inline float3 times_a(Quadric q, float3 x) {
    return (float3)(q.a[0] * x.x + q.a[1] * x.y + q.a[2] * x.z, q.a[1] * x.x + q.a[3] * x.y + q.a[4] * x.z,
                    q.a[2] * x.x + q.a[4] * x.y + q.a[5] * x.z);
}

// The same sums from another origin, `by` away.
inline Quadric shift_quadric(Quadric q, float3 by) {
    const float3 ad = times_a(q, by), b = (float3)(q.b[0], q.b[1], q.b[2]);
    q.c += dot(by, ad) - 2.0f * dot(by, b);
    q.b[0] -= ad.x;
    q.b[1] -= ad.y;
    q.b[2] -= ad.z;
    q.m[0] -= q.k * by.x;
    q.m[1] -= q.k * by.y;
    q.m[2] -= q.k * by.z;
    return q;
}

// Root mean square distance of `x` to the planes.
inline float quadric_error(Quadric q, float3 x) {
    const float3 b = (float3)(q.b[0], q.b[1], q.b[2]);
    return sqrt(fmax((dot(x, times_a(q, x)) - 2.0f * dot(b, x) + q.c) / fmax(q.k, 1.0f), 0.0f));
}

// The best point: minimises the quadric with a pull towards the mean. Symmetric 3x3 system by Cholesky factors.
inline float3 quadric_minimum(Quadric q) {
    const float3 mean = (float3)(q.m[0], q.m[1], q.m[2]) / fmax(q.k, 1.0f);
    const float w = fmax(MEAN_WEIGHT * q.k, 1e-6f);
    const float3 r = (float3)(q.b[0], q.b[1], q.b[2]) - times_a(q, mean);
    const float l00 = sqrt(q.a[0] + w), l10 = q.a[1] / l00, l20 = q.a[2] / l00;
    const float l11 = sqrt(fmax(q.a[3] + w - l10 * l10, 1e-12f)), l21 = (q.a[4] - l20 * l10) / l11;
    const float l22 = sqrt(fmax(q.a[5] + w - l20 * l20 - l21 * l21, 1e-12f));
    const float y0 = r.x / l00, y1 = (r.y - l10 * y0) / l11, y2 = (r.z - l20 * y0 - l21 * y1) / l22;
    const float x2 = y2 / l22, x1 = (y1 - l21 * x2) / l11, x0 = (y0 - l10 * x1 - l20 * x2) / l00;
    return mean + (float3)(x0, x1, x2);
}

// Value (w) and gradient per cell (xyz) of a cell's trilinear interpolant at `t` in [0, 1]^3.
inline float4 trilinear(const float *v, float3 t) {
    const float x00 = mix(v[0], v[1], t.x), x10 = mix(v[2], v[3], t.x), x01 = mix(v[4], v[5], t.x), x11 = mix(v[6], v[7], t.x);
    const float y0 = mix(x00, x10, t.y), y1 = mix(x01, x11, t.y);
    const float d0 = mix(v[1] - v[0], v[3] - v[2], t.y), d1 = mix(v[5] - v[4], v[7] - v[6], t.y);
    return (float4)(mix(d0, d1, t.z), mix(x10 - x00, x11 - x01, t.z), y1 - y0, mix(y0, y1, t.z));
}

// One Newton step towards the isosurface, in cells, at most one cell long.
inline float3 newton_step(float4 field, float iso, float3 spacing) {
    const float3 g = field.xyz / spacing;
    const float length2 = dot(g, g);
    const float3 step = (iso - field.w) / length2 * g / spacing;
    const float longest = fmax(fmax(fabs(step.x), fabs(step.y)), fabs(step.z));
    if (!(longest < INFINITY)) return (float3)(0.0f);
    return longest > 1.0f ? step / longest : step;
}

inline uint octahedral8(float3 n) {
    const float sum = fabs(n.x) + fabs(n.y) + fabs(n.z);
    if (!(sum > 0.0f) || isinf(sum)) return 0;
    float2 p = n.xy / sum;
    if (n.z < 0.0f) p = (1.0f - fabs(p.yx)) * (float2)(p.x >= 0.0f ? 1.0f : -1.0f, p.y >= 0.0f ? 1.0f : -1.0f);
    const int2 q = convert_int2_rte(p * 127.0f);
    return ((uint)q.x & 0xffu) | ((uint)q.y & 0xffu) << 8;
}

// A coordinate in cells from the region's low corner, as Placement holds it.
inline ushort on_lattice(float cells) { return (ushort)(uint)(cells * PLACEMENT_LATTICE + 0.5f); }

// `cells`: position from the region's low corner.
inline Placement quantised(float3 cells, uint normal, float error) {
    Placement p;
    p.position[0] = on_lattice(cells.x);
    p.position[1] = on_lattice(cells.y);
    p.position[2] = on_lattice(cells.z);
    p.normal = (ushort)normal;
    p.error = error;
    return p;
}

// `towards`: any vector along the gradient.
inline Placement make_placement(float3 cells, float3 towards, float error) {
    return quantised(cells, octahedral8(-towards), error);
}

#endif
