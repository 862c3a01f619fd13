// Distances of the full-resolution surface to the mesh, LANES of its points at a time: crossings, and vertices of merged cells.
#ifndef ISOPEEL_CROSSING_DISTANCE_H
#define ISOPEEL_CROSSING_DISTANCE_H

#include "lib/precision.h"
#include "lib/device.h"
#include "lib/distances.h"
#include "lib/grid.h"
#include "lib/lanes.h"
#include "lib/layout.h"
#include "lib/mesh_distance.h"
#include "lib/morton.h"

// Points that are measured together.
typedef struct {
    float3 point[LANES];
    float nearest2[LANES]; // squared distance
    uint vertex[LANES]; // slot of the leaf's vertex
    uint level[LANES];  // of the leaf
    bool walks[LANES];  // from the fan of a cluster on, whose triangles need not be the nearest
    uint brick[LANES];
    uint count;
} Crossings;

INLINED void collect_point(Crossings *crossings, float3 point, uint vertex, uint level, bool walks, uint brick) {
    const uint at = crossings->count++;
    crossings->point[at] = point;
    crossings->vertex[at] = vertex;
    crossings->level[at] = level;
    crossings->walks[at] = walks;
    crossings->brick[at] = brick;
}

// The distances of a batch of pairs go to their points.
INLINED void measure_batch(Crossings *crossings, Pairs *pairs) {
    float distances2[LANES];
    measure_pairs(pairs, distances2);
    for (uint i = 0; i < pairs->count; i++) {
        const uint owner = pairs->owner[i];
        crossings->nearest2[owner] = fmin(crossings->nearest2[owner], distances2[i]);
    }
    pairs->count = 0;
}

// Finds the nearest triangle in the fan of each point's leaf; of a large one the vertex.
INLINED void measure_fans(Crossings *crossings, Grid grid, const MeshFans *mesh, Pairs *pairs) {
    uint large = 0;
    for (uint i = 0; i < crossings->count; i++) {
        const float3 p = crossings->point[i], apex = mesh->positions[crossings->vertex[i]].xyz;
        uint corner = mesh->heads[crossings->vertex[i]], size = 0;
        crossings->nearest2[i] = corner == NONE ? INFINITY : distance2_of(p, apex);
        for (; corner != NONE && size <= FAN_CAPACITY; corner = mesh->next[corner]) {
            size++;
            add_pair(pairs, grid, mesh, p, apex, i, corner);
            if (pairs->count == LANES) measure_batch(crossings, pairs);
        }
        large |= (uint)(size > FAN_CAPACITY) << i;
    }
    if (pairs->count) measure_batch(crossings, pairs);
    for (uint i = 0; i < crossings->count; i++)
        if (large >> i & 1u)
            crossings->nearest2[i] = distance2_of(crossings->point[i], mesh->positions[crossings->vertex[i]].xyz);
}

// Adds the distances of the points that were collected: by the fan of the leaf's vertex; where that is far, for the size of the
// leaf, or has no triangles, also by the fans from a seed on.
INLINED void measure_crossings(Crossings *crossings, Grid grid, const MeshFans *mesh, const MeshSeeds *from,
                               __global const Brick *bricks, Pairs *pairs, Distances *sums) {
    const float3 spacing = (float3)(grid.spacing[0], grid.spacing[1], grid.spacing[2]);
    const float unit = SEARCH_FROM * fmin(fmin(spacing.x, spacing.y), spacing.z);
    measure_fans(crossings, grid, mesh, pairs);
    for (uint i = 0; i < crossings->count; i++) {
        const float near = unit * (float)(1u + (1u << crossings->level[i]));
        float distance2 = crossings->nearest2[i];
        if (crossings->walks[i]) distance2 = fmin(distance2, walk_to_mesh(grid, mesh, pairs, crossings->point[i], crossings->vertex[i]));
        if (distance2 > near * near) {
            __global const Brick *brick = bricks + crossings->brick[i];
            const uint3 low = brick_origin(grid, mesh->regions[brick->region].region, brick->morton);
            const uint seed = nearest_seed(from, mesh->positions, crossings->point[i], crossings->brick[i], convert_float3(low),
                                           spacing);
            if (seed != NONE) distance2 = fmin(distance2, walk_to_mesh(grid, mesh, pairs, crossings->point[i], seed));
        }
        add_distance(sums, sqrt(distance2), 1.0f);
    }
    crossings->count = 0;
}

#endif
