// Corners and edges of a cube. Corner = dx + 2 dy + 4 dz. Edge = 4 axis + u + 2 v with u and v along the next two axes, cyclically.
#ifndef ISOPEEL_CUBE_H
#define ISOPEEL_CUBE_H

inline int component(int3 v, uint axis) { return axis == 0 ? v.x : axis == 1 ? v.y : v.z; }
inline int3 axis_step(uint axis) { return (int3)(axis == 0, axis == 1, axis == 2); }
// Offset of an edge of a unit cube from the cube's low corner: edge = 4 axis + u + 2 v.
inline int3 edge_offset(uint edge) {
    const uint axis = edge >> 2;
    return axis_step((axis + 1) % 3) * (int)(edge & 1) + axis_step((axis + 2) % 3) * (int)(edge >> 1 & 1);
}

// Low corner of an edge, and whether the signs of its corners differ.
inline uint edge_low_corner(uint edge) { return (uint)(0x321051406420ul >> 4 * edge) & 7u; }
inline bool edge_crosses(uint signs, uint edge) {
    const uint low = edge_low_corner(edge), high = low + (1u << (edge >> 2));
    return (signs >> low ^ signs >> high) & 1u;
}

#define EDGES_OWN (1u << 0 | 1u << 4 | 1u << 8) // edges that begin at the cube's low corner

// The crossed edges of a cube, one bit each: edges whose corners differ in sign.
inline uint crossed_edges(uint signs) {
    const uint x = signs ^ signs >> 1, y = signs ^ signs >> 2, z = signs ^ signs >> 4;
    return (x & 1u) | (x >> 1 & 2u) | (x >> 2 & 4u) | (x >> 3 & 8u) | (y & 1u) << 4 | (y & 16u) << 1 | (y & 2u) << 5
        | (y & 32u) << 2 | (z & 15u) << 8;
}
// Their number.
inline uint count_crossed(uint signs) {
    return popcount(((signs ^ signs >> 1) & 0x55u) | ((signs ^ signs >> 2) & 0x33u) << 8 | ((signs ^ signs >> 4) & 0xfu) << 16);
}

#endif
