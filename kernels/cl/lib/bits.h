// Bit masks: ranks, single bits, one bit a byte or lane.
#ifndef ISOPEEL_BITS_H
#define ISOPEEL_BITS_H

#include "lib/device.h"

// Number of set bits below bit `b` of a 64-bit mask.
inline uint rank64(uint low, uint high, uint b) {
    return b < 32 ? popcount(low & ((1u << b) - 1)) : popcount(low) + popcount(high & ((1u << (b - 32)) - 1));
}
inline bool test_bit64(uint low, uint high, uint b) { return (b < 32 ? low >> b : high >> (b - 32)) & 1u; }

// One bit for every byte of a word: whether it is not zero.
inline uint nonzero_bytes(uint w) {
    return (uint)((w & 0xffu) != 0) | (uint)((w & 0xff00u) != 0) << 1 | (uint)((w & 0xff0000u) != 0) << 2
        | (uint)((w & 0xff000000u) != 0) << 3;
}

// One bit for each true lane of a comparison.
inline uint mask8(int8 lanes) {
    return (uint)((as_ulong(convert_char8(lanes)) & 0x8040201008040201ul) * 0x0101010101010101ul >> 56);
}

inline uint lowest_bit(uint mask) { return popcount((mask & -mask) - 1); }
inline uint lowest_cell_bit(cell_bits mask) { return (uint)popcount((mask & -mask) - 1); }

inline uint test_bit(__local const uint *words, uint i) { return words[i >> 5] >> (i & 31) & 1u; }

#endif
