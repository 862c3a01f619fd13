// What a node says of the cells below it: sums become smoothness and feature, samples become signs (algorithm, sections 2 to 4).
#ifndef ISOPEEL_NODES_H
#define ISOPEEL_NODES_H

#include "lib/grid.h"
#include "lib/layout.h"
#include "lib/samples.h"
#include "lib/sheets.h"
#include "lib/tables.h"

inline float feature_sample(__global const void *feature, uint type, float missing, ulong i) {
    float v;
    switch (type) {
        case TYPE_U8: v = (float)((__global const uchar *)feature)[i]; break;
        case TYPE_I8: v = (float)((__global const char *)feature)[i]; break;
        case TYPE_U16: v = (float)((__global const ushort *)feature)[i]; break;
        case TYPE_I16: v = (float)((__global const short *)feature)[i]; break;
        default: v = ((__global const float *)feature)[i];
    }
    return v == missing ? NAN : v;
}

// The user's feature at a cell's centre: the mean of its corners that are not missing.
inline float feature_of_cell(Grid grid, SLAB, uint kind, __global const void *feature, uint type, float missing,
                             int3 cell) {
    if (kind == FEATURE_NONE) return 0.0f;
    float sum = 0.0f, count = 0.0f;
    for (uint corner = 0; corner < 8; corner++) {
        const int3 p = cell + (int3)(corner & 1, corner >> 1 & 1, corner >> 2);
        const float v = kind == FEATURE_GRADIENT ? length(gradient_at(grid, SLAB_ARGS, p))
                                                 : feature_sample(feature, type, missing, sample_index(grid, z0, p));
        if (!isnan(v)) { sum += v; count += 1.0f; }
    }
    return count > 0.0f ? sum / count : 0.0f;
}

inline Moments no_moments() {
    Moments m = {{0.0f, 0.0f, 0.0f}, 0.0f, 0.0f, 0};
    return m;
}

inline void add_moments(Moments *into, Moments m) {
    for (uint i = 0; i < 3; i++) into->g[i] += m.g[i];
    into->q += m.q;
    into->f += m.f;
    into->n += m.n;
}

// Eq. 1, of cubes with active cells.
inline float smoothness(Moments m) {
    const float n = (float)m.n;
    const float3 mean = (float3)(exact_quotient(m.g[0], n), exact_quotient(m.g[1], n), exact_quotient(m.g[2], n));
    const float variance = fmax(exact_quotient(m.q, n) - dot(mean, mean), 0.0f);
    return exact_quotient(variance, 1.0f + variance);
}

inline Node make_node(Moments m, uint level, uint cell, uint signs, bool missing, bool safe) {
    Node node;
    node.count = m.n;
    node.s = 0.0f;
    node.f = 0.0f;
    if (m.n > 0) {
        node.s = smoothness(m);
        node.f = exact_quotient(m.f, (float)m.n);
    }
    node.meta = node_code(level, cell) | signs << 16 | (uint)missing << 24 | (uint)safe << 25;
    return node;
}

// The 3x3x3 samples of a cube at half its size, 27 bits x + 3 y + 9 z. Eight of them are its corners.
inline uint corner_signs(uint samples27) {
    uint signs = 0;
    for (uint corner = 0; corner < 8; corner++)
        signs |= (samples27 >> (2 * (corner & 1) + 6 * (corner >> 1 & 1) + 18 * (corner >> 2)) & 1u) << corner;
    return signs;
}

// Do the samples between the corners say nothing that the corners do not (algorithm, section 4)? All edges along an axis,
// and all faces across it, at once: a bit at the low corner of each.
inline bool safe_signs(uint samples27) {
    const uint steps[3] = {1, 3, 9};
    uint unlike = 0;
    for (uint axis = 0; axis < 3; axis++) {
        const uint a = steps[axis], b = steps[(axis + 1) % 3], c = steps[(axis + 2) % 3], s = samples27;
        const uint middle = s >> a, edges = 1u | 1u << (2 * b) | 1u << (2 * c) | 1u << (2 * b + 2 * c);
        unlike |= (middle ^ s) & (middle ^ s >> (2 * a)) & edges;
        const uint centre = s >> (b + c), faces = 1u | 1u << (2 * a);
        unlike |= (centre ^ s) & (centre ^ s >> (2 * b)) & (centre ^ s >> (2 * c)) & (centre ^ s >> (2 * b + 2 * c)) & faces;
    }
    const uint signs = corner_signs(samples27);
    return !unlike && signs != (samples27 >> 13 & 1u ? 0u : 255u) && sheet_count(SHEETS[signs]) == 1 && !JOINED[signs];
}

#endif
