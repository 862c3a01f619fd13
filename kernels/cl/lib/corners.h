// Corners of triangles, three in a row each.
#ifndef ISOPEEL_CORNERS_H
#define ISOPEEL_CORNERS_H

// Corners of a triangle after and before one of them.
inline uint next_corner(uint corner) { return corner % 3 == 2 ? corner - 2 : corner + 1; }
inline uint previous_corner(uint corner) { return corner % 3 == 0 ? corner + 2 : corner - 1; }

#endif
