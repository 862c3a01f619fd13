// Morton numbers: the bits of x, y and z interleaved, x lowest.
#ifndef ISOPEEL_MORTON_H
#define ISOPEEL_MORTON_H

// Five bits to every third bit, and back.
inline uint spread_bits(uint v) {
    v = (v | v << 8) & 0x100fu;
    v = (v | v << 4) & 0x10c3u;
    return (v | v << 2) & 0x1249u;
}
inline uint gather_bits(uint v) {
    v &= 0x1249u;
    v = (v | v >> 2) & 0x10c3u;
    v = (v | v >> 4) & 0x100fu;
    return (v | v >> 8) & 0x1fu;
}
inline uint morton(uint3 p) { return spread_bits(p.x) | spread_bits(p.y) << 1 | spread_bits(p.z) << 2; }
inline uint3 unmorton(uint m) { return (uint3)(gather_bits(m), gather_bits(m >> 1), gather_bits(m >> 2)); }

// Masks of 32 numbers in Morton order, 4 x 4 x 2 along x, y and z: the first and the last along each axis.
#define FIRST_X 0x00550055u
#define FIRST_Y 0x00003333u
#define FIRST_Z 0x0f0f0f0fu
#define LAST_X 0xaa00aa00u
#define LAST_Y 0xcccc0000u
#define LAST_Z 0xf0f0f0f0u

#endif
