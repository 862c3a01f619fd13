// Unit normals as two signed numbers: octahedral coding, of one vector and of LANES vectors. Two functions each, because OpenCL C
// has none over several types; those of LANES divide approximately.
#ifndef ISOPEEL_OCTAHEDRAL_H
#define ISOPEEL_OCTAHEDRAL_H

#include "lib/precision.h"
#include "lib/device.h"
#include "lib/lanes.h"

// The point of the square [-1, 1]^2 that encodes the direction of a vector of any length; (0, 0), which is +z, for the zero vector.
inline float2 octahedral_point(float3 n) {
    const float sum = fabs(n.x) + fabs(n.y) + fabs(n.z);
    if (!(sum > 0.0f) || isinf(sum)) return (float2)(0.0f);
    const float2 p = n.xy / sum;
    if (n.z >= 0.0f) return p;
    return (1.0f - fabs(p.yx)) * (float2)(p.x >= 0.0f ? 1.0f : -1.0f, p.y >= 0.0f ? 1.0f : -1.0f);
}

// Two signed bytes, and two signed 16-bit numbers, x in the low half.
inline uint encode_octahedral8(float3 n) {
    const int2 q = convert_int2_rte(octahedral_point(n) * 127.0f);
    return ((uint)q.x & 0xffu) | ((uint)q.y & 0xffu) << 8;
}
inline uint encode_octahedral16(float3 n) {
    const int2 q = convert_int2_rte(octahedral_point(n) * 32767.0f);
    return ((uint)q.x & 0xffffu) | (uint)q.y << 16;
}

// From bytes to 16 bits: 127 becomes 32767 = 258 * 127 + 1.
inline uint widen_octahedral8(uint packed) {
    const int nx = (char)(packed & 0xffu), ny = (char)(packed >> 8 & 0xffu);
    const int x = 258 * nx + (nx > 126) - (nx < -126), y = 258 * ny + (ny > 126) - (ny < -126);
    return ((uint)x & 0xffffu) | (uint)y << 16;
}

// encode_octahedral8 of -g as a number, in lanes.
inline real encode_normal_lanes(Real3 g) {
    const real sum = fabs(g.x) + fabs(g.y) + fabs(g.z);
    const real per_sum = PICK((sum > 0.0f) & (sum < INFINITY), -native_recip(sum), 0.0f);
    real u = g.x * per_sum, v = g.y * per_sum;
    const real fold_u = 1.0f - fabs(v), fold_v = 1.0f - fabs(u);
    const real below = PICK(g.z * per_sum < 0.0f, 1.0f, 0.0f);
    u = PICK(below > 0.0f, PICK(u >= 0.0f, fold_u, -fold_u), u);
    v = PICK(below > 0.0f, PICK(v >= 0.0f, fold_v, -fold_v), v);
    // Two's complement bytes.
    const real low = rint(u * 127.0f), high = rint(v * 127.0f);
    return low + PICK(low < 0.0f, 256.0f, 0.0f) + (high + PICK(high < 0.0f, 256.0f, 0.0f)) * 256.0f;
}

inline float3 decode_octahedral8(uint packed) {
    const float2 p = (float2)((float)(char)(packed & 0xffu), (float)(char)(packed >> 8 & 0xffu)) / 127.0f;
    float3 n = (float3)(p, 1.0f - fabs(p.x) - fabs(p.y));
    if (n.z < 0.0f) n.xy = (1.0f - fabs(p.yx)) * (float2)(p.x >= 0.0f ? 1.0f : -1.0f, p.y >= 0.0f ? 1.0f : -1.0f);
    return n * rsqrt(dot(n, n));
}

// decode_octahedral8 in lanes.
INLINED Real3 decode_normal_lanes(integer packed) {
#pragma OPENCL FP_CONTRACT ON
    real nx = TO_REAL(packed << 24 >> 24) * (1.0f / 127.0f), ny = TO_REAL(packed << 16 >> 24) * (1.0f / 127.0f);
    const real nz = 1.0f - fabs(nx) - fabs(ny), fold = fmax(-nz, 0.0f);
    nx += PICK(nx >= 0.0f, -fold, fold);
    ny += PICK(ny >= 0.0f, -fold, fold);
    const real per_length = rsqrt(nx * nx + ny * ny + nz * nz);
    return make_real3(nx * per_length, ny * per_length, nz * per_length);
}

#endif
