// generate: volumes made of formulas, for benches: any size without reading or sending a byte. One work-item a sample.
// STORE rounds and clamps to SAMPLE; values are of the order of [-2, 2] and are stored as value * factor + offset.

#include "lib/args.h"
#include "lib/layout.h"

// Numbers of Shape::numbers; 4 are spheres.
#define SHAPE_SIN 0
#define SHAPE_WAVES 1
#define SHAPE_MARSCHNER_LOBB 2
#define SHAPE_GYROID 3

// Below every surface.
#define OUTSIDE (-3.0f)

inline uint scramble(uint h) {
    h ^= h >> 15;
    h *= 2246822519u;
    h ^= h >> 13;
    h *= 3266489917u;
    return h ^ h >> 16;
}

// White noise of variance 1 that depends on the sample's index alone.
inline float normal_noise(ulong index) {
    const uint seed = scramble((uint)index * 2654435761u ^ scramble((uint)(index >> 32) + 0x9e3779b9u));
    const float u = ((float)(seed >> 8) + 0.5f) / 16777216.0f;
    const float v = (float)(scramble(seed + 0x68bc21ebu) >> 8) / 16777216.0f;
    return sqrt(-2.0f * log(u)) * cos(6.2831853f * v);
}

// Eight plane waves of fixed, once randomly drawn direction, wavelength a half to a sixth of the period.
inline float sin_waves(float3 p) {
    return (0.936777f * sin(dot(p, (float3)(0.027649f, 6.714596f, -6.161514f)) + 1.885044f)
            + 0.639213f * sin(dot(p, (float3)(0.511931f, 11.40765f, -4.189566f)) + 1.903044f)
            + 0.896331f * sin(dot(p, (float3)(1.489567f, -13.148075f, -0.413346f)) + 6.251742f)
            + 0.521971f * sin(dot(p, (float3)(-5.357081f, -3.633534f, -5.189462f)) + 3.846749f)
            + 0.757059f * sin(dot(p, (float3)(1.104f, -1.316557f, -17.725577f)) + 3.951541f)
            + 0.684768f * sin(dot(p, (float3)(-12.204533f, -3.810613f, -7.804777f)) + 1.25981f)
            + 0.754895f * sin(dot(p, (float3)(-0.29592f, 8.047206f, -5.310274f)) + 5.528486f)
            + 0.753886f * sin(dot(p, (float3)(-4.972824f, 0.309073f, 5.515822f)) + 3.398383f))
        / 3.0f;
}

// Eight other waves, of round numbers.
inline float round_waves(float3 p) {
    const float x = p.x * 6.2831853f, y = p.y * 6.2831853f, z = p.z * 6.2831853f;
    return (0.8f * sin(1.3f * x + 0.4f * y + 0.9f * z + 1.0f) + 0.7f * sin(-1.7f * x + 1.1f * y + 0.3f * z + 2.0f)
            + sin(0.6f * x - 2.1f * y + 1.2f * z) + 0.6f * sin(2.2f * x + 0.7f * y - 1.4f * z + 3.0f)
            + 0.9f * sin(0.2f * x + 1.5f * y + 2.4f * z + 0.5f) + 0.5f * sin(1.9f * x - 0.8f * y - 0.9f * z + 4.0f)
            + 0.7f * sin(-0.5f * x - 1.2f * y + 1.8f * z + 5.0f) + 0.6f * sin(1.1f * x + 2.3f * y + 0.4f * z + 0.7f))
        / 3.0f;
}

// S. Marschner, R. Lobb, "An evaluation of reconstruction filters for volume rendering", 1994; p in [-1, 1].
inline float marschner_lobb(float3 p) {
    const float rho = cospi(12.0f * cospi(0.5f * sqrt(p.x * p.x + p.y * p.y)));
    return ((1.0f - sinpi(0.5f * p.z)) + 0.25f * (1.0f + rho)) / 2.5f;
}

inline float gyroid(float3 p) {
    return sin(p.x) * cos(p.y) + sin(p.y) * cos(p.z) + sin(p.z) * cos(p.x);
}

// Balls of radius 40 samples, `count` along every axis; the value falls by 1 every 20 samples.
inline float balls(Grid grid, int3 p, uint count) {
    const float3 pitch = (float3)((float)grid.dims[0], (float)grid.dims[1], (float)grid.dims[2]) / (float)count;
    const float3 at = convert_float3(p) + 0.5f;
    const float3 centre = (min(floor(at / pitch), (float3)((float)count - 1.0f)) + 0.5f) * pitch;
    return clamp((40.0f - length(at - centre)) / 20.0f, -2.0f, 2.0f);
}

__kernel __attribute__((reqd_work_group_size(64, 1, 1)))
void generate(const GenerateArgs args, __global SAMPLE *samples) {
    const Grid grid = args.grid;
    const uint z0 = args.z0, first = args.first, planes = args.planes, shape = args.shape;
    const float period = args.period;
    const uint count = args.count, closed = args.closed;
    const float factor = args.factor, offset = args.offset;
    const ulong item = get_global_id(0), plane = (ulong)grid.dims[0] * grid.dims[1];
    if (item >= plane * planes) return;
    const uint in_plane = (uint)(item % plane);
    const int3 p = (int3)((int)(in_plane % grid.dims[0]), (int)(in_plane / grid.dims[0]), (int)(first + (uint)(item / plane)));
    const int3 last = (int3)((int)grid.dims[0], (int)grid.dims[1], (int)grid.dims[2]) - 1;
    const float3 at = convert_float3(p);
    float value;
    if (closed && (any(p == 0) || any(p == last))) value = OUTSIDE;
    else if (shape == SHAPE_SIN) {
        const float noise = 0.01f * 256.0f / period * normal_noise(plane * (uint)p.z + in_plane);
        value = sin_waves((at + 0.5f) / period) + noise;
    } else if (shape == SHAPE_WAVES) {
        // Uniform noise of the same variance.
        const uint h = scramble((uint)(plane * (uint)p.z + in_plane) * 2654435761u);
        value = round_waves(at / period) + 0.017f * 256.0f / period * ((float)(h & 0xffffffu) / 8388608.0f - 1.0f);
    } else if (shape == SHAPE_MARSCHNER_LOBB) value = marschner_lobb(2.0f * at / (period - 1.0f) - 1.0f);
    else if (shape == SHAPE_GYROID) {
        const float3 angle = at * (6.2831853f / (period - 1.0f));
        value = gyroid(4.0f * angle) + 0.5f * gyroid(9.0f * angle);
    } else value = balls(grid, p, count);
    samples[(ulong)(first - z0) * plane + item] = STORE(value * factor + offset);
}
