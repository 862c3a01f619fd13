// Points of a mesh whose distances to the surface are measured: its vertices, and points on its triangles. A triangle is divided into n^2 equal ones, and each has the six points of Dunavant's rule, whose weighted sums are
// integrals of polynomials up to the fourth degree (High degree efficient symmetrical Gaussian quadrature rules, 1985). Squared distances
// are such polynomials if the surface is a paraboloid above the triangle. Centroids alone would miss that meshes are furthest off at edges.
// Vertices have no weight: they count for the maximum alone.
#ifndef ISOPEEL_TRIANGLE_SAMPLES_H
#define ISOPEEL_TRIANGLE_SAMPLES_H

#include "lib/precision.h"
#include "lib/device.h"
#include "lib/layout.h"
#include "lib/mesh_distance.h"
#include "lib/surface_distance.h"

// Area of a part of a triangle at most, in square cells, but n is bounded.
#define PART_CELLS 12.0f
#define DIVISIONS_MAX 16u

// Of a triangle of at most this area in square cells, one point of each kind is measured, which a hash chooses: there are many.
#define SMALL_CELLS 3.0f

// Kinds of points, three of each: COORDINATES is the barycentric coordinate of one corner, and those of the other two are equal. The first two
// kinds are the rule. The last, near the middles of the sides, has no weight.
#define KINDS 3u
#define PART_POINTS (3 * KINDS)
__constant float COORDINATES[KINDS] = {0.816847572980459f, 0.108103018168070f, 0.04f};
__constant float WEIGHTS[KINDS] = {0.109951743655322f, 0.223381589678011f, 0.0f};

// The corners of a triangle, in cells.
typedef struct {
    float3 a, b, c;
} TriangleInCells;

INLINED TriangleInCells load_triangle(Grid grid, const MeshFans *mesh, uint first) {
    const float3 spacing = (float3)(grid.spacing[0], grid.spacing[1], grid.spacing[2]);
    TriangleInCells triangle;
    triangle.a = corner_position(grid, mesh, first) / spacing;
    triangle.b = corner_position(grid, mesh, first + 1) / spacing;
    triangle.c = corner_position(grid, mesh, first + 2) / spacing;
    return triangle;
}

// Samples that are measured together.
typedef struct {
    TriangleInCells triangle; // the one at hand
    uint loaded;              // its first corner
    SurfaceSearch search;
    uint first[LANES];   // first corner of the triangle; NONE: the point is a vertex
    float weight[LANES]; // the sample's part of the triangle's area, world units
    uint count;
} TriangleSamples;

INLINED void clear_samples(TriangleSamples *batch) {
    for (uint i = 0; i < 3 * LANES; i++) batch->search.from[i] = 0.0f;
    batch->count = 0;
    batch->loaded = NONE;
}

// Makes a triangle the one at hand.
INLINED TriangleInCells hold_triangle(TriangleSamples *batch, Grid grid, const MeshFans *mesh, uint first) {
    if (batch->loaded != first) batch->triangle = load_triangle(grid, mesh, first);
    batch->loaded = first;
    return batch->triangle;
}

// How many samples a triangle has, by its area in cells.
INLINED uint count_samples(TriangleSamples *batch, Grid grid, const MeshFans *mesh, uint first) {
    const TriangleInCells t = hold_triangle(batch, grid, mesh, first);
    const float area = 0.5f * length(cross(t.b - t.a, t.c - t.a));
    if (area <= SMALL_CELLS) return KINDS;
    const uint n = clamp((uint)ceil(sqrt(area / PART_CELLS)), 1u, DIVISIONS_MAX);
    return n * n * PART_POINTS;
}

// Which of the three points of a kind is measured: a hash of the index, because neighbours have indices that follow each other.
INLINED uint sampled_point(uint first) { return mul_hi(first * 2654435761u, 3u); }

INLINED float3 sample_position(const TriangleSamples *batch, uint i) {
    return (float3)(batch->search.from[i], batch->search.from[LANES + i], batch->search.from[2 * LANES + i]);
}

// Adds a point, in cells, if it is in these layers of regions: the slab that holds a point counts it.
INLINED bool add_point(TriangleSamples *batch, Grid grid, float3 x, uint first, float weight, uint first_layer, uint end_layer) {
    const uint layer = min((uint)x.z / 32, grid.regions[2] - 1);
    if (layer < first_layer || layer >= end_layer) return false;
    const uint at = batch->count++;
    batch->search.from[at] = x.x;
    batch->search.from[LANES + at] = x.y;
    batch->search.from[2 * LANES + at] = x.z;
    batch->first[at] = first;
    batch->weight[at] = weight;
    return true;
}

// Adds sample `i` of `count` of a triangle.
INLINED bool add_sample(TriangleSamples *batch, Grid grid, const MeshFans *mesh, uint first, uint i, uint count, uint first_layer,
                        uint end_layer) {
    const float3 spacing = (float3)(grid.spacing[0], grid.spacing[1], grid.spacing[2]);
    const TriangleInCells t = hold_triangle(batch, grid, mesh, first);
    const bool is_small = count == KINDS;
    // Row r from corner a on has 2 r + 1 parts, by turns with a corner towards a and away from it.
    const float n = is_small ? 1.0f : sqrt((float)(count / PART_POINTS));
    const uint part = is_small ? 0 : i / PART_POINTS, point = is_small ? 3 * i + sampled_point(first) : i % PART_POINTS;
    const uint row = (uint)sqrt((float)part), column = part - row * row;
    const bool away = column & 1;
    const float coordinate = COORDINATES[point / 3], rest = 0.5f - 0.5f * coordinate;
    const float second = point % 3 == 1 ? coordinate : rest, third = point % 3 == 2 ? coordinate : rest;
    const float down = ((float)row + (away ? third : second + third)) / n;
    const float across = ((float)(column / 2) + (away ? second + third : third)) / n;
    const float3 x = t.a + down * (t.b - t.a) + across * (t.c - t.b);
    const float area = 0.5f * length(cross((t.b - t.a) * spacing, (t.c - t.a) * spacing)) / (n * n);
    return add_point(batch, grid, x, first, area * WEIGHTS[point / 3] * (is_small ? 3.0f : 1.0f), first_layer, end_layer);
}

// Index of the first of GROUP ends that is above `i`.
INLINED uint find_end(__local const uint *ends, uint i) {
    uint low = 0, high = GROUP - 1;
    while (low < high) {
        const uint middle = (low + high) / 2;
        if (ends[middle] > i) high = middle;
        else low = middle + 1;
    }
    return low;
}

#endif
