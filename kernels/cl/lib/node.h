// The fields of Node::meta: code, corner signs, flags.
#ifndef ISOPEEL_NODE_H
#define ISOPEEL_NODE_H

// A node's code holds its level and Morton number: a one bit, then 15 - 3 level Morton bits.
inline uint code_level(uint code) { return (uint)(clz(code) - 16) / 3; }
inline uint node_code(uint level, uint cell) { return 1u << (15 - 3 * level) | cell >> (3 * level); }
// Morton number of the first cell below a node.
inline uint code_cell(uint code, uint level) { return (code ^ 1u << (15 - 3 * level)) << (3 * level); }

inline uint meta_code(uint meta) { return meta & 0xffffu; }
inline uint meta_signs(uint meta) { return meta >> 16 & 0xffu; }
// Whether all corners have one sign: then the surface inside crosses none of the edges between them.
inline bool meta_one_sign(uint meta) { return meta_signs(meta) == 0 || meta_signs(meta) == 255; }
inline uint meta_missing(uint meta) { return meta >> 24 & 1u; }
inline uint meta_safe(uint meta) { return meta >> 25 & 1u; }
inline uint meta_extras(uint meta) { return meta >> 26 & 3u; }

#endif
