// Distances of the full-resolution surface to the mesh, LANES of its points at a time: crossings of lines through cells.
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
    float weight[LANES];   // area that the point stands for
    float nearest2[LANES]; // squared distance
    uint triangle[LANES];  // first corner of the nearest, or NONE: the vertex
    bool beyond[LANES];    // a triangle that is not in the fan may be nearer
    uint vertex[LANES];    // slot of the leaf's vertex
    uint level[LANES];     // of the leaf
    uint brick[LANES];
    uint count;
} Crossings;

INLINED void collect_point(Crossings *crossings, float3 point, float weight, uint vertex, uint level, uint brick) {
    const uint at = crossings->count++;
    crossings->point[at] = point;
    crossings->weight[at] = weight;
    crossings->vertex[at] = vertex;
    crossings->level[at] = level;
    crossings->brick[at] = brick;
}

// Updates the nearest triangle of each point by a batch of pairs. The order of a chain is not deterministic, so ties go to the triangle with the
// lowest index. One with a border vertex is in the fan twice: with the vertex, and with the one it was moved from.
INLINED void measure_batch(Crossings *crossings, Pairs *pairs) {
    float distances2[LANES], beyond[LANES];
    measure_pairs(pairs, distances2, beyond);
    for (uint i = 0; i < pairs->count; i++) {
        const uint owner = pairs->owner[i], triangle = pairs->triangle[i];
        const float nearest2 = crossings->nearest2[owner];
        if (distances2[i] > nearest2 || (distances2[i] == nearest2 && triangle > crossings->triangle[owner])) continue;
        const bool again = distances2[i] == nearest2 && triangle == crossings->triangle[owner];
        crossings->nearest2[owner] = distances2[i];
        crossings->triangle[owner] = triangle;
        crossings->beyond[owner] = beyond[i] > 0.0f || (again && crossings->beyond[owner]);
    }
    pairs->count = 0;
}

// Begins a point with the distance to the vertex of its leaf; infinite if the fan is empty.
INLINED void measure_vertex(Crossings *crossings, const MeshFans *mesh, uint i) {
    const uint vertex = crossings->vertex[i];
    crossings->nearest2[i] = mesh->heads[vertex] == NONE ? INFINITY : distance2_of(crossings->point[i], mesh->positions[vertex].xyz);
    crossings->triangle[i] = NONE;
    crossings->beyond[i] = false;
}

// Finds the nearest triangle in the fan of each point's leaf; of a large fan the vertex. Returns a mask of the points with large fans.
INLINED uint measure_fans(Crossings *crossings, Grid grid, const MeshFans *mesh, Pairs *pairs) {
    uint large = 0;
    for (uint i = 0; i < crossings->count; i++) {
        const float3 p = crossings->point[i], apex = mesh->positions[crossings->vertex[i]].xyz;
        measure_vertex(crossings, mesh, i);
        uint size = 0;
        for (uint corner = mesh->heads[crossings->vertex[i]]; corner != NONE && size <= FAN_CAPACITY; corner = mesh->next[corner]) {
            size++;
            add_pair(pairs, grid, mesh, p, apex, i, corner);
            if (pairs->count == LANES) measure_batch(crossings, pairs);
        }
        large |= (uint)(size > FAN_CAPACITY) << i;
    }
    if (pairs->count) measure_batch(crossings, pairs);
    for (uint i = 0; i < crossings->count; i++)
        if (large >> i & 1u) measure_vertex(crossings, mesh, i);
    return large;
}

// Adds the distances of the points that were collected: to the fan of the leaf's vertex and to fans next to it. If the distance is large for the
// size of the leaf, or the fan is empty or large, walks from seeds follow.
INLINED void measure_crossings(Crossings *crossings, Grid grid, const MeshFans *mesh, const MeshSeeds *from,
                               __global const Brick *bricks, Pairs *pairs, Distances *sums) {
    const float3 spacing = (float3)(grid.spacing[0], grid.spacing[1], grid.spacing[2]);
    const float unit = SEED_DISTANCE * fmin(fmin(spacing.x, spacing.y), spacing.z);
    const uint large = measure_fans(crossings, grid, mesh, pairs);
    for (uint i = 0; i < crossings->count; i++) {
        const float3 p = crossings->point[i];
        const float near = unit * (float)(1u + (1u << crossings->level[i]));
        float distance2 = crossings->nearest2[i];
        // A point that counts for the maximum alone cannot change it.
        if (crossings->weight[i] == 0.0f && distance2 <= sums->maximum * sums->maximum) continue;
        if (crossings->triangle[i] != NONE) {
            const uint vertex = crossings->vertex[i];
            uint tried = corners_at(mesh, crossings->triangle[i], vertex);
            const uint other = untried_corner(grid, mesh, p, crossings->triangle[i], &tried);
            if (other != NONE
                && (crossings->beyond[i] || distance2_of(p, mesh->positions[other].xyz) < distance2_of(p, mesh->positions[vertex].xyz)))
                distance2 = fmin(distance2, walk_to_mesh(grid, mesh, pairs, p, other));
        }
        if (distance2 > near * near || (large >> i & 1u)) {
            __global const Brick *brick = bricks + crossings->brick[i];
            const uint3 low = brick_origin(grid, mesh->regions[brick->region].region, brick->morton);
            distance2 = walk_from_seeds(grid, mesh, from, pairs, p, crossings->brick[i], convert_float3(low), distance2);
        }
        add_distance(sums, sqrt(distance2), crossings->weight[i]);
    }
    crossings->count = 0;
}

#endif
