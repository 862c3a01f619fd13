// Sums over the active cells below a node (docs/algorithm.md#3-pyramid), and the node made of them.
#ifndef ISOPEEL_MOMENTS_H
#define ISOPEEL_MOMENTS_H

#include "lib/precision.h"
#include "lib/device.h"
#include "lib/layout.h"
#include "lib/node.h"

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

// Smoothness by equation 1 of the paper. `sums`: of Moments, g and q; `n`: at least one.
inline float smoothness(float4 sums, float n) {
    const float3 mean = (float3)(exact_quotient(sums.x, n), exact_quotient(sums.y, n), exact_quotient(sums.z, n));
    const float variance = fmax(exact_quotient(sums.w, n) - dot(mean, mean), 0.0f);
    return exact_quotient(variance, 1.0f + variance);
}

inline Node make_node(Moments m, uint level, uint cell, uint signs, bool missing, bool safe) {
    Node node;
    node.count = m.n;
    node.s = 0.0f;
    node.f = 0.0f;
    if (m.n > 0) {
        node.s = smoothness((float4)(m.g[0], m.g[1], m.g[2], m.q), (float)m.n);
        node.f = exact_quotient(m.f, (float)m.n);
    }
    node.meta = node_code(level, cell) | signs << 16 | (uint)missing << 24 | (uint)safe << 25;
    return node;
}

#endif
