// Keys of the vertex tree's nodes: the tolerance from which on a node is merged (tree_cut.cl).
#ifndef ISOPEEL_TREE_KEY_H
#define ISOPEEL_TREE_KEY_H

// Beside a key: the merge takes away one triangle instead of two. Keys are 0 or more.
#define KEY_SINGLE 0x80000000u

// As a number that is ordered as the keys are.
inline uint key_bits(uint packed) { return packed & ~KEY_SINGLE; }
inline float key_of(uint packed) { return as_float(key_bits(packed)); }

#endif
