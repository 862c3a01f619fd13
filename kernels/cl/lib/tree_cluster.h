// Clusters of the vertex tree while it is built: their quadrics, and the position and cost of a merge of two clusters
// (docs/algorithm.md#7-vertex-tree).
#ifndef ISOPEEL_TREE_CLUSTER_H
#define ISOPEEL_TREE_CLUSTER_H

#include "lib/precision.h"
#include "lib/device.h"
#include "lib/lanes.h"
#include "lib/layout.h"
#include "lib/quadric.h"

#define BORDER_WEIGHT 1.0f      // of the planes at right angles to the border, by squared length of its edges
#define MERGE_PULL 0.003f       // weight of the pull towards the mean of a merged cluster's points, in parts of its area
#define MERGE_LENGTH_COST 1e-6f // cost of an edge's squared length: of merges that cost nothing else, short ones come first

// A cluster's flags beside CLUSTER_BORDER
#define CLUSTER_LOW_FACES 7u // faces of the volume that it lies on, which it may not leave, one bit each: at the low ends of the axes
#define CLUSTER_LOCKED 16    // beside missing samples, or two fans meet at it: never merges
#define CLUSTER_HIGH_FACES (CLUSTER_LOW_FACES << CLUSTER_HIGH) // faces at the high ends
#define CLUSTER_HIGH 5
#define CLUSTER_FACES (CLUSTER_LOW_FACES | CLUSTER_HIGH_FACES)

// As dot_real3, without contraction: costs are the same from both sides of an edge, and on every device.
INLINED real plain_dot(Real3 a, Real3 b) { return a.x * b.x + a.y * b.y + a.z * b.z; }

// A x.
INLINED Real3 times_quadrics(const Quadrics *q, Real3 x) {
    return make_real3(q->axx * x.x + q->axy * x.y + q->axz * x.z, q->axy * x.x + q->ayy * x.y + q->ayz * x.z,
                      q->axz * x.x + q->ayz * x.y + q->azz * x.z);
}

// The same sums from origins moved by `by`.
INLINED void shift_quadrics(Quadrics *q, Real3 by) {
    const Real3 ad = times_quadrics(q, by);
    q->c += plain_dot(by, ad) - 2.0f * plain_dot(by, q->b);
    q->b = make_real3(q->b.x - ad.x, q->b.y - ad.y, q->b.z - ad.z);
    q->m = make_real3(q->m.x - q->k * by.x, q->m.y - q->k * by.y, q->m.z - q->k * by.z);
}

// Solves (A + w 1) x = r for the quadrics' A, by L D L^T factors.
INLINED Real3 solve_pulled(const Quadrics *q, real w, Real3 r) {
    const real one = 1.0f;
    const real d0 = EXACT_QUOTIENT(one, q->axx + w), l10 = q->axy * d0, l20 = q->axz * d0;
    const real d1 = EXACT_QUOTIENT(one, fmax(q->ayy + w - l10 * q->axy, w)), a21 = q->ayz - l20 * q->axy, l21 = a21 * d1;
    const real d2 = EXACT_QUOTIENT(one, fmax(q->azz + w - l20 * q->axz - l21 * a21, w));
    const real y1 = r.y - l10 * r.x, y2 = r.z - l20 * r.x - l21 * y1;
    const real z = y2 * d2, y = y1 * d1 - l21 * z;
    return make_real3(r.x * d0 - l10 * y - l20 * z, y, z);
}

// LANES pairs of clusters.
typedef struct {
    // The first before the second, so that results have the same bits from both sides.
    uint first[LANES + MORE_COLUMNS], second[LANES + MORE_COLUMNS];
    uint entry[LANES + MORE_COLUMNS]; // what the caller keeps with a pair
    uint other[LANES + MORE_COLUMNS]; // of an edge, the end whose ring does not have that entry
    uint count;
} PairBatch;

// Returns the pair's column.
inline uint collect_pair(PairBatch *batch, uint a, uint b, uint entry) {
    const uint column = NEXT_COLUMN(batch);
    batch->first[column] = min(a, b);
    batch->second[column] = max(a, b);
    batch->entry[column] = entry;
    return column;
}

// LANES pairs as one cluster each.
typedef struct {
    Quadrics quadrics; // from the first one's position
    Real3 from;        // the first one's position
    Real3 to;          // from there to the merged position
    real cost;         // INFINITY if the two may not merge
    real children;     // squared errors of the two, summed
} Merges;

INLINED Quadrics load_cluster_quadrics(__global const TreeCluster *clusters, const uint *at) {
    real rows[16];
    load_rows16((__global const float *)clusters, at, rows);
    Quadrics q;
    q.axx = rows[0];
    q.axy = rows[1];
    q.axz = rows[2];
    q.ayy = rows[3];
    q.ayz = rows[4];
    q.azz = rows[5];
    q.b = make_real3(rows[6], rows[7], rows[8]);
    q.c = rows[9];
    q.m = make_real3(rows[10], rows[11], rows[12]);
    q.k = rows[13];
    return q;
}

// Positions of LANES clusters, and their flags, which are in w.
INLINED Real3 load_positions_flags(__global const float4 *positions, const uint *at, integer *flags) {
    int4 rows[LANES];
    for (uint i = 0; i < LANES; i++) rows[i] = as_int4(positions[at[i]]);
    integer x, y, z;
    load_vec4s(rows, &x, &y, &z, flags);
    return make_real3(AS_REAL(x), AS_REAL(y), AS_REAL(z));
}

// Columns without a pair compute that of the first one.
INLINED Merges merge_pairs(PairBatch *batch, __global const TreeCluster *clusters, __global const float4 *positions) {
    for (uint i = batch->count; i < LANES; i++) {
        batch->first[i] = batch->first[0];
        batch->second[i] = batch->second[0];
    }
    Merges merges;
    integer first_flags, second_flags;
    merges.from = load_positions_flags(positions, batch->first, &first_flags);
    const Real3 other = load_positions_flags(positions, batch->second, &second_flags);
    const Quadrics a = load_cluster_quadrics(clusters, batch->first);
    Quadrics q = load_cluster_quadrics(clusters, batch->second);
    const real second_c = q.c;
    const Real3 between = make_real3(other.x - merges.from.x, other.y - merges.from.y, other.z - merges.from.z);
    shift_quadrics(&q, make_real3(-between.x, -between.y, -between.z));
    q.axx += a.axx;
    q.axy += a.axy;
    q.axz += a.axz;
    q.ayy += a.ayy;
    q.ayz += a.ayz;
    q.azz += a.azz;
    q.b = make_real3(q.b.x + a.b.x, q.b.y + a.b.y, q.b.z + a.b.z);
    q.m = make_real3(q.m.x + a.m.x, q.m.y + a.m.y, q.m.z + a.m.z);
    q.c += a.c;
    q.k += a.k;
    const real one = 1.0f, zero = 0.0f;
    const integer first_faces = first_flags & (int)CLUSTER_FACES, second_faces = second_flags & (int)CLUSTER_FACES;
    const integer faces = first_faces | second_faces, fixed = faces | faces >> CLUSTER_HIGH; // along which axes, in the low bits
    const Real3 mean = scale_real3(q.m, EXACT_QUOTIENT(one, fmax(q.k, 1e-30f)));
    const Real3 pulled = times_quadrics(&q, mean);
    const Real3 rest = make_real3(q.b.x - pulled.x, q.b.y - pulled.y, q.b.z - pulled.z);
    const Real3 solved = solve_pulled(&q, fmax(MERGE_PULL * q.k, 1e-30f), rest);
    const Real3 best = make_real3(PICK((fixed & 1) != 0, zero, mean.x + solved.x), PICK((fixed & 2) != 0, zero, mean.y + solved.y),
                                  PICK((fixed & 4) != 0, zero, mean.z + solved.z));
    const Real3 end = pick_real3(faces == first_faces, make_real3(zero, zero, zero), between);
    merges.to = pick_real3(first_faces == second_faces, best, end);
    const real error = fmax(plain_dot(merges.to, times_quadrics(&q, merges.to))
                                - 2.0f * (q.b.x * merges.to.x + q.b.y * merges.to.y + q.b.z * merges.to.z) + q.c, 0.0f);
    const real cost = error - a.c - second_c + MERGE_LENGTH_COST * plain_dot(between, between) * q.k;
    const integer may_merge = (((first_flags | second_flags) & CLUSTER_LOCKED) == 0) & ((faces == first_faces) | (faces == second_faces));
    merges.cost = PICK(may_merge, fmax(cost, 0.0f), INFINITY);
    merges.children = a.c + second_c;
    merges.quadrics = q;
    return merges;
}

// Order of edges of equal cost: without it, whole planes would merge one pair after another.
inline uint edge_hash(uint a, uint b) {
    uint h = a * 0x9e3779b1u ^ b * 0x85ebca6bu;
    h = (h ^ h >> 15) * 0x2c1b3c6du;
    return h ^ h >> 12;
}

// Cells that a cluster's points lie in: low and high x, y, z, 5 bits each.
inline uint extent_of_cell(uint3 cell) {
    const uint packed = cell.x | cell.y << 5 | cell.z << 10;
    return packed | packed << 15;
}
inline uint join_extents(uint a, uint b) {
    uint joined = 0;
    for (uint i = 0; i < 30; i += 5) {
        const uint p = a >> i & 31u, q = b >> i & 31u;
        joined |= (i < 15 ? min(p, q) : max(p, q)) << i;
    }
    return joined;
}
// Level of the smallest cube that is as large.
inline uint extent_level(uint extent) {
    uint longest = 0;
    for (uint i = 0; i < 15; i += 5) longest = max(longest, (extent >> (i + 15) & 31u) - (extent >> i & 31u));
    return longest == 0 ? 0 : 32 - (uint)clz(longest);
}

#endif
