// Distance of a point to a dual mesh, by the fans of its vertices. Positions are in world units from the volume's first sample.
//
// The triangles around the vertex of a slot, its fan, are a chain of corners: heads[slot], then next[corner], to NONE; a corner is
// its position among all indices. Every distance is that to some triangle or vertex of the mesh: never less than the true one.
#ifndef ISOPEEL_MESH_DISTANCE_H
#define ISOPEEL_MESH_DISTANCE_H

#include "lib/precision.h"
#include "lib/device.h"
#include "lib/grid.h"
#include "lib/lanes.h"
#include "lib/layout.h"
#include "lib/polygon.h"

// Fans of more triangles are not searched. That of a cell has at most 24; a larger one is that of a coarse leaf beside fine ones, and its
// triangles are in the fans of those, too. So the cost of a crossing is bounded, whatever the cut.
#define FAN_CAPACITY 1024

// If a crossing is further than SEED_DISTANCE (1 + edge of its leaf in cells) smallest spacings, seeds are tried.
#define SEED_DISTANCE 0.125f

// Fans that are tried on the way to the nearest triangle.
#define WALK_STEPS 16

// Positions of the corners of triangles: vertices of slots, and border vertices, which exist only in the mesh.
typedef struct {
    __global const Region *regions;
    __global const RegionMesh *meshes;
    uint region_count;
    __global const uint *corner_slots;
    __global const uint *indices;
    __global const Vertex *vertices;
    __global const float4 *positions; // of the vertex of each slot; w: diagonal of its cube
    __global const uint *heads;
    __global const uint *next;
} MeshFans;

// Position of a vertex of a region's mesh, in cells.
inline float3 vertex_in_cells(Grid grid, const MeshFans *mesh, uint region, uint vertex) {
    const Vertex v = mesh->vertices[mesh->meshes[region].vertex_base + vertex];
    const float3 cells = (float3)((float)v.position[0], (float)v.position[1], (float)v.position[2]) / 65536.0f;
    return cells + convert_float3(region_origin(grid, mesh->regions[region].region));
}

INLINED float3 corner_position(Grid grid, const MeshFans *mesh, uint corner) {
    const uint slot = mesh->corner_slots[corner];
    if (!(slot & ON_BORDER)) return mesh->positions[slot].xyz;
    // The triangle is in the last region whose triangles begin at it or before, found by bisection.
    uint region = 0, end = mesh->region_count;
    while (end - region > 1) {
        const uint middle = region + (end - region) / 2;
        if (mesh->meshes[middle].triangle_base <= corner / 3) region = middle;
        else end = middle;
    }
    return vertex_in_cells(grid, mesh, region, mesh->indices[corner]) * (float3)(grid.spacing[0], grid.spacing[1], grid.spacing[2]);
}

inline float distance2_of(float3 a, float3 b) {
    const float3 d = a - b;
    return dot(d, d);
}

// Squared distance of `p` to a box from its low corner on.
inline float distance2_to_box(float3 p, float3 low, float3 size) { return distance2_of(p, clamp(p, low, low + size)); }

// Low corner of the k-th of the 27 bricks around a brick, world units. `low`: of the brick, in cells.
inline float3 near_brick_origin(float3 low, uint k, float3 spacing) {
    return (low + 8.0f * ((float3)((float)(k % 3), (float)(k / 3 % 3), (float)(k / 9)) - 1.0f)) * spacing;
}

// Triangles, each with a point whose distance to it is wanted: rows of coordinates of the point and of the three corners.
typedef struct {
    float rows[12 * LANES];
    uint owner[LANES];    // of the point
    uint triangle[LANES]; // first corner
    uint count;
} Pairs;

INLINED void clear_pairs(Pairs *pairs) {
    for (uint i = 0; i < 12 * LANES; i++) pairs->rows[i] = 0.0f;
    pairs->count = 0;
}

INLINED void set_point(float *rows, uint row, uint column, float3 p) {
    rows[row * LANES + column] = p.x;
    rows[(row + 1) * LANES + column] = p.y;
    rows[(row + 2) * LANES + column] = p.z;
}

// Adds the triangle of a corner of the fan of the vertex at `apex`, unless no point of it is nearer to `p` than the apex.
INLINED void add_pair(Pairs *pairs, Grid grid, const MeshFans *mesh, float3 p, float3 apex, uint owner, uint corner) {
    const uint which = corner % 3, triangle = corner - which;
    const bool on_border = mesh->corner_slots[corner] & ON_BORDER;
    const float3 a = on_border ? corner_position(grid, mesh, corner) : apex;
    const float3 b = corner_position(grid, mesh, triangle + (which + 1) % 3);
    const float3 c = corner_position(grid, mesh, triangle + (which + 2) % 3);
    const float3 to = p - apex;
    if (!on_border && dot(b - apex, to) <= 0.0f && dot(c - apex, to) <= 0.0f) return;
    const uint column = pairs->count++;
    set_point(pairs->rows, 0, column, p);
    set_point(pairs->rows, 3, column, a);
    set_point(pairs->rows, 6, column, b);
    set_point(pairs->rows, 9, column, c);
    pairs->owner[column] = owner;
    pairs->triangle[column] = triangle;
}

// Squared distance from a point to an edge. `along`: the edge; `to`: from its start to the point.
INLINED real side_distance2(Real3 along, Real3 to) {
    const real t = clamp(dot_real3(to, along) / fmax(dot_real3(along, along), (real)FLT_MIN), (real)0.0f, (real)1.0f);
    const Real3 d = make_real3(to.x - t * along.x, to.y - t * along.y, to.z - t * along.z);
    return dot_real3(d, d);
}

// Squared distances of the pairs: to the triangle's plane if the foot of the perpendicular lies inside, else to its nearest side. `beyond`: 1 if
// that side is the one opposite to the fan's vertex: then a triangle outside of the fan may be nearer.
INLINED void measure_pairs(const Pairs *pairs, float *distances2, float *beyond) {
    const Real3 p = LOAD_REAL3(pairs->rows, LANES), a = LOAD_REAL3(pairs->rows + 3 * LANES, LANES);
    const Real3 b = LOAD_REAL3(pairs->rows + 6 * LANES, LANES), c = LOAD_REAL3(pairs->rows + 9 * LANES, LANES);
    const Real3 ab = minus_real3(b, a), bc = minus_real3(c, b), ca = minus_real3(a, c);
    const Real3 ap = minus_real3(p, a), bp = minus_real3(p, b), cp = minus_real3(p, c);
    // n points away from the side on which the corners are counter-clockwise.
    const Real3 n = cross_real3(ab, ca);
    const real length2 = dot_real3(n, n), height = dot_real3(n, ap);
    const real left = dot_real3(cross_real3(ab, n), ap), middle = dot_real3(cross_real3(bc, n), bp);
    const real inmost = fmin(fmin(left, middle), dot_real3(cross_real3(ca, n), cp));
    const integer inside = (length2 > 0.0f) & (inmost >= 0.0f);
    const real beside = fmin(side_distance2(ab, ap), side_distance2(ca, cp)), away = side_distance2(bc, bp);
    STORE_LANES(PICK(inside, height * height / length2, fmin(beside, away)), distances2);
    STORE_LANES(PICK(inside | (beside <= away), 0.0f, 1.0f), beyond);
}

// The nearest of some triangles, by its first corner; NONE: the distance is that to a vertex, or infinite.
typedef struct {
    float distance2;
    uint triangle;
} Nearest;

// Ties go to the triangle with the lowest index, because the order of a chain is not deterministic.
INLINED Nearest nearest_pair(Nearest nearest, Pairs *pairs) {
    float distances2[LANES], beyond[LANES];
    measure_pairs(pairs, distances2, beyond);
    for (uint i = 0; i < pairs->count; i++) {
        const uint triangle = pairs->triangle[i];
        if (distances2[i] < nearest.distance2 || (distances2[i] == nearest.distance2 && triangle < nearest.triangle)) {
            nearest.distance2 = distances2[i];
            nearest.triangle = triangle;
        }
    }
    pairs->count = 0;
    return nearest;
}

// Among the vertex and the triangles of a fan that is not empty; of a large one its vertex.
INLINED Nearest nearest_in_fan(Grid grid, const MeshFans *mesh, Pairs *pairs, float3 p, uint slot) {
    const float3 apex = mesh->positions[slot].xyz;
    const Nearest by_apex = {distance2_of(p, apex), NONE};
    Nearest nearest = by_apex;
    uint size = 0;
    for (uint corner = mesh->heads[slot]; corner != NONE; corner = mesh->next[corner]) {
        if (size++ == FAN_CAPACITY) {
            pairs->count = 0;
            return by_apex;
        }
        add_pair(pairs, grid, mesh, p, apex, 0, corner);
        if (pairs->count == LANES) nearest = nearest_pair(nearest, pairs);
    }
    return pairs->count ? nearest_pair(nearest, pairs) : nearest;
}

// The corners of a triangle that are at the vertex of a slot, one bit each; a border vertex counts as the vertex that it was moved from.
INLINED uint corners_at(const MeshFans *mesh, uint triangle, uint slot) {
    uint corners = 0;
    for (uint i = 0; i < 3; i++) corners |= (uint)((mesh->corner_slots[triangle + i] & ~ON_BORDER) == slot) << i;
    return corners;
}

// The slot of the triangle's corner that is nearest to `p` among those whose bits are not set in `tried`; sets its bit. NONE: all are set.
INLINED uint untried_corner(Grid grid, const MeshFans *mesh, float3 p, uint triangle, uint *tried) {
    uint nearest = NONE;
    float nearest2 = INFINITY;
    for (uint i = 0; i < 3; i++) {
        if (*tried >> i & 1u) continue;
        const float distance2 = distance2_of(p, corner_position(grid, mesh, triangle + i));
        if (distance2 < nearest2) {
            nearest2 = distance2;
            nearest = i;
        }
    }
    if (nearest == NONE) return NONE;
    *tried |= 1u << nearest;
    return mesh->corner_slots[triangle + nearest] & ~ON_BORDER;
}

// Squared distance of `p` to the mesh near the vertex of a slot: from fan to fan, those of the corners of the nearest triangle so far.
INLINED float walk_to_mesh(Grid grid, const MeshFans *mesh, Pairs *pairs, float3 p, uint slot) {
    Nearest nearest = {INFINITY, NONE};
    uint tried = 0;
    for (uint step = 0; step < WALK_STEPS && slot != NONE; step++) {
        const Nearest found = nearest_in_fan(grid, mesh, pairs, p, slot);
        if (found.distance2 < nearest.distance2) {
            nearest = found;
            if (found.triangle == NONE) break;
            tried = corners_at(mesh, found.triangle, slot);
        }
        slot = untried_corner(grid, mesh, p, nearest.triangle, &tried);
    }
    return nearest.distance2;
}

// Start points of searches. Every brick has a seed for each of its level-2 cubes: the slot of a vertex that has triangles, or NONE.
typedef struct {
    __global const uint *near;  // the 27 bricks around each brick
    __global const uint *seeds; // 8 a brick
    __global const uint *far;   // of each brick, the slot to use if the bricks around have no seed
} MeshSeeds;

// The seed of a brick that is nearest to `p`, or NONE if it has none.
INLINED uint nearest_seed(const MeshSeeds *from, __global const float4 *positions, float3 p, uint brick) {
    uint nearest = NONE;
    float nearest2 = INFINITY;
    for (uint octant = 0; octant < 8; octant++) {
        const uint slot = from->seeds[8 * brick + octant];
        if (slot == NONE) continue;
        const float distance2 = distance2_of(p, positions[slot].xyz);
        if (distance2 < nearest2) {
            nearest2 = distance2;
            nearest = slot;
        }
    }
    return nearest;
}

// Squared distance of `p` to the mesh by walks from seeds, at most `nearest2`: from the nearest seed of each of the 27 bricks around that is closer
// than the result so far; if none of them has a seed, from `far`. `low`: of the brick, in cells.
INLINED float walk_from_seeds(Grid grid, const MeshFans *mesh, const MeshSeeds *from, Pairs *pairs, float3 p, uint brick, float3 low,
                              float nearest2) {
    const float3 spacing = (float3)(grid.spacing[0], grid.spacing[1], grid.spacing[2]);
    bool has_seeds = false;
    for (uint i = 0; i < 27; i++) {
        const uint k = (i + 13) % 27, index = from->near[27 * brick + k];
        if (index == NONE) continue;
        if (distance2_to_box(p, near_brick_origin(low, k, spacing), 8.0f * spacing) >= nearest2) continue;
        const uint seed = nearest_seed(from, mesh->positions, p, index);
        if (seed == NONE) continue;
        has_seeds = true;
        nearest2 = fmin(nearest2, walk_to_mesh(grid, mesh, pairs, p, seed));
    }
    const uint far = from->far[brick];
    return has_seeds || far == NONE ? nearest2 : fmin(nearest2, walk_to_mesh(grid, mesh, pairs, p, far));
}

#endif
