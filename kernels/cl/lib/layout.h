// Every struct that crosses between host and device. Valid C and OpenCL C; `src/layout.rs` mirrors it and
// `layout_probe.cl` proves that both agree on the real driver.
//
// Vocabulary: a *brick* is 8^3 cells (the level-3 cube), a *region* 32^3 cells (the level-5 cube). Cells of a region are
// numbered in Morton order, 15 bits `zyxzyx...` with x lowest, so the cube of level l that holds cell m is m >> 3l and
// its descendants are neighbours. A *slot* is the place of one node in the compact node array: region by region, inside a
// region level by level (0 first), inside a level in Morton order.
#ifndef ISOPEEL_LAYOUT_H
#define ISOPEEL_LAYOUT_H

#include "lib/constants.h"

#ifndef __OPENCL_VERSION__
typedef unsigned int uint;
typedef unsigned short ushort;
#endif

// Extent of the volume, by value to every kernel.
typedef struct {
    uint dims[3];     // samples along x, y, z
    uint regions[3];  // regions along x, y, z
    float spacing[3]; // world units between samples
    float missing;    // samples equal to this count as NaN; NaN when nothing is missing
} Grid;

// An active region: one with at least one brick that the isovalue touches.
typedef struct {
    uint region;          // linear index in the grid of regions, x fastest
    uint brick_base;      // its first brick in the compact brick array
    uint brick_mask[2];   // its bricks, one bit each in Morton order
    uint missing_mask[2]; // bricks that touch a missing sample
    uint slot_base;       // its first slot
    uint point_base;      // number of its first point (tree.cl)
    uint level_base[8];   // first slot of levels 0..5 relative to slot_base; [6]: of extra sheets; [7]: number of slots
} Region;

// An active brick.
typedef struct {
    uint cells[16];          // active cells, one bit each in Morton order
    ushort cells_before[16]; // active cells in the words before word i, at most 480
    uint level1_mask[2];     // level-1 nodes, one bit each in Morton order
    uint level1_missing[2];  // level-1 cubes that touch a missing sample, one bit each
    uint level2_mask;        // level-2 nodes, low 8 bits
    uint level_base[4];      // first slot of levels 0..2 and, in [3], of extra sheets, relative to the region's slot_base
    uint extra_sheets;       // sum over its cells of the number of sheets - 1
    uint quad_count;         // crossed grid edges that begin at the low corner of one of its cells
    uint region;             // compact index of its region
    uint morton;             // Morton number in its region, 0..63
} Brick;

// A node of the pyramid: an active cell (level 0) or a cube with active cells below. Behind the nodes of a region stand
// its extra sheets: one for every sheet but the first of a cell that the surface crosses more than once.
typedef struct {
    // Triangles of the undecimated surface below, at most 163840; for a cell of several sheets also, from bit 8 on, the index of its
    // first extra sheet among those of its brick; for an extra sheet: see sheets.h.
    uint count;
    float s;    // smoothness feature, eq. 1; of an active cell: that of its level-1 cube
    float f;    // user feature, eq. 2, not yet normalised
    uint meta;  // bits 0..15 code: a one followed by Morton bits; 16..23 corner signs; 24: touches missing samples;
                // 25: safe to merge (docs/algorithm.md#41-guards); 26, 27: extra sheets of a cell, or which of them this is
} Node;

// The vertex of a node, or of one sheet of a cell (docs/algorithm.md#63-vertex-placement).
typedef struct {
    ushort position[3]; // from the region's low corner, 1/2048 cell, strictly inside the node's cube
    ushort normal;      // two signed bytes, octahedral
    float error;        // root mean square distance to the planes of the crossings below, world units; 0 for one of
                        // several sheets of a cell
} VertexRecord;

// Sums over crossings of grid edges below a cube: p position, n unit normal, in world units from some origin.
typedef struct {
    float a[6]; // sum of n n^T: xx xy xz yy yz zz
    float b[3]; // sum of n (n p)
    float c;    // sum of (n p)^2
    float m[3]; // sum of p
    float k;    // how many
} Quadric;

// Sums over the active cells below a cube.
typedef struct {
    float g[3]; // sum of n g
    float q;    // sum of n |g|^2
    float f;    // sum of n f
    uint n;     // sum of n
} Moments;

// What the cut depends on.
typedef struct {
    float alpha;
    float threshold;    // a node is decimated up to this: beta, or with by_error the tolerance in world units
    uint by_error;      // the error over the weight decides, not the importance
    float feature_lo;
    float feature_span; // hi - lo, above 0
    uint max_level;
    uint prefix;         // undecided cubes of this level count as leaves; 0: the final cut
    uint fills;          // so do those that touch a missing sample
    uint points;         // control points of the transfer function
    uint interests;      // regions of interest
    float max_error;     // largest error of a decimated cube, world units; infinite: no guard
    uint preserve;       // decimate only cubes that are safe to merge
    uint cap;            // the volume is padded by a sample on each side: what lies there moves onto its faces
} CutParams;

// A region of interest: what `rows` maps from its centre to the unit ball, or to the cube from -1 to 1.
typedef struct {
    float centre[3]; // in index space
    float rows[9];   // of a matrix, over cells
    float importance;
    uint is_cube;
} Interest;

// Range of a region's part of a mesh.
typedef struct {
    uint vertices;
    uint triangles[6]; // by level
    uint distinct_vertices; // of the dual mesher: those that the region counts, so that each of the surface counts once
    uint vertex_base;  // filled in by the host
    uint triangle_base;
} RegionMesh;

// A vertex while the mesh is made.
typedef struct {
    int position[3]; // from the region's low corner, 1/65536 cell
    uint key;        // fine grid edge: low sample in the region, 6 bits x, y, z, then 2 bits axis
} WorkVertex;

// A vertex as it leaves the device.
typedef struct {
    int position[3];
    uint normal; // two signed 16-bit numbers, octahedral
    uint attributes; // s, then normalised f, 16 bits each
} Vertex;

// What the vertex tree has in a block (tree.cl): in a region, which is a block of level 0, or in a block of a level above.
typedef struct {
    uint border_base;    // number of its first point on the volume's faces
    uint border_points;  // how many
    uint triangle_count; // triangles with a corner in the block
    uint triangle_base;  // the first of them in working memory
    uint cluster_base;   // the first of its clusters in working memory; once the tree is built, the points of the regions before it
    uint node_base;      // its first node
    uint nodes;          // how many
    uint rounds;         // in how many rounds they were made
    uint beside_count;   // triangles of other blocks' meshes that have a corner in the block
    uint beside_base;    // the first of their numbers
    float area;          // a third of the triangles around each of its points
    uint points;         // of all its regions
    uint region;         // compact index of its first region
    uint above;          // number of the block of the next level that it is in, regions first, or NONE
    uint clusters;       // those that remain
    uint idle;           // of these, those that never merge in the block, the last ones
    uint fresh;          // of these, those that the last round has made
    uint is_done;        // 1: no more rounds
} TreeRegion;

// A cluster of points while the vertex tree is built: what the costs of its edges depend on, beside its position. 16 numbers.
typedef struct {
    Quadric quadric; // planes of the triangles around its points, from its own position, weighted by area; k: the area
    uint ring_first; // start of its ring; while the mesh is read, of its list of triangles; between levels, its leaf (tree_leaf.h)
    uint ring_count;
} TreeCluster;

// What nodes need of a cluster's points.
typedef struct {
    float normal[3]; // sum of normals, by area
    float s, f;      // sums of smoothness and user feature, by area
    uint node;       // the cluster's node, or NONE
    uint extent;     // cells that the points lie in (tree_cluster.h)
    uint changes;    // whether something around it merges in this round
} TreeMembers;

// A merge of two clusters of points.
typedef struct {
    uint position[2]; // from its block's low corner, how far it may move, and the block's level (tree_node.h)
    uint normal_s;    // normal as in VertexRecord; from bit 16 smoothness times 65535
    float f;          // user feature, not yet normalised
    uint meta;        // bits 0..2 level of the smallest cube that is as large; 3: on the surface's border; from bit 6 on the
                      // compact index of its block's first region
} TreeNode;

// What the leaves of a cut of the vertex tree add up to in a block.
typedef struct {
    uint leaves[6]; // points, by level
    float error2;   // sum of error^2 (tree_key.h)
    float worst;    // maximum error
} TreeCutRegion;

// What the removed parts have in a region, and the area of those that are left.
typedef struct {
    uint parts;          // those whose first point is in the region
    uint triangles;      // of the full dual mesh
    uint full_triangles; // of marching cubes
    float area_left;     // of the parts whose first point is in the region, world units
} TreePartSum;

// Some cells or triangles of a region, from its `first` on: what one work-group of `error` measures.
typedef struct {
    uint region; // compact index
    uint first;
    uint count;
} ErrorTask;

// Distances of a task: sums of weights and of weighted squares, and the maximum. World units.
typedef struct {
    float sum2;
    float weight;
    float max;
} ErrorSum;

// What the leaves of a region add up to.
typedef struct {
    uint leaves[6];    // by level
    uint undecided[6]; // nodes with leaves below them that may be leaves of a prefix, by level
    uint lost_cubes;   // leaves above level 0 whose corners have one sign
    float error2;      // sum of n error^2, error as in VertexRecord
    float worst;       // maximum error
    uint weight;       // sum of n, triangles of the undecimated surface
} RegionCut;

// The active cell whose vertex is nearest to a position.
typedef struct {
    uint slots[6];    // of the cell and of the cubes above it, by level; NONE if no active cell is near
    uint region;      // compact index
    uint point;       // its point in the vertex tree
    float distance;   // from the position to its vertex, world units
    float s;          // smoothness feature
    float f;          // user feature, not yet normalised
    float blended;    // of both, what the transfer function looks at
    float importance; // raised if its vertex is in a region of interest
} ProbedCell;

// Totals of the marching-cubes mesher, accumulated with atomics.
typedef struct {
    uint unpatched_vertices;
    uint vertices; // different ones: what regions share counts once
} Counters;

#endif
