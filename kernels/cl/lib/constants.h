// Constants that host and device share, from kernels/src/constants.rs. Generated: `make generated`.
#ifndef ISOPEEL_CONSTANTS_H
#define ISOPEEL_CONSTANTS_H

// Index of a region, brick or node that does not exist.
#define NONE 4294967295u
// What `dual_emit` writes for corners: indices of vertices.
#define CORNERS_INDICES 0u
// Also their slots.
#define CORNERS_SLOTS 1u
// Numbers of the vertex tree's points instead.
#define CORNERS_POINTS 2u
// Cut state of a node whose descendants hold the leaves.
#define INTERNAL 255u
// Feature that the importance blends with smoothness: none.
#define FEATURE_NONE 0u
// Feature: a field on the same grid.
#define FEATURE_FIELD 1u
// Feature: the magnitude of the field's own gradient.
#define FEATURE_GRADIENT 2u
// Feature: computed by `derive` before; the nodes have it, and what a histogram is made of are its values.
#define FEATURE_STORED 3u
// Feature of `derive`: mean curvature of the isosurface.
#define FEATURE_MEAN_CURVATURE 4u
// Feature of `derive`: Gaussian curvature of the isosurface.
#define FEATURE_GAUSSIAN_CURVATURE 5u
// Feature of `derive`: variance of the samples around.
#define FEATURE_LOCAL_VARIANCE 6u
// Feature of `derive`, of three fields: magnitude of the vector.
#define FEATURE_VECTOR_MAGNITUDE 7u
// Feature of `derive`, of three fields: divergence.
#define FEATURE_DIVERGENCE 8u
// Feature of `derive`, of three fields: magnitude of the vorticity.
#define FEATURE_VORTICITY 9u
// Feature of `derive`, of three fields: Q-criterion.
#define FEATURE_Q_CRITERION 10u
// Feature of `derive`, of three fields: lambda-2.
#define FEATURE_LAMBDA_2 11u
// Feature of `derive`, of three fields: helicity.
#define FEATURE_HELICITY 12u
// Maximum fields of an expression.
#define EXPRESSION_FIELDS 8u
// Maximum operations of an expression.
#define EXPRESSION_OPERATIONS 64u
// Launches of `evaluate` and `mask` begin at multiples of this number of samples.
#define LAUNCH_BLOCK 1024u
// Operation of `evaluate`: a number.
#define OPERATION_NUMBER 0u
// Operation of `evaluate`: the sample of a field.
#define OPERATION_FIELD 1u
// Operation of `evaluate`: both of two conditions hold. A condition is 1 or 0.
#define OPERATION_AND 2u
// Operation of `evaluate`: one of two conditions holds, or both.
#define OPERATION_OR 3u
// Operation of `evaluate`: a condition does not hold.
#define OPERATION_NOT 4u
// Operation of `evaluate`: the first number if a condition holds, else the second one.
#define OPERATION_SELECT 5u
// Operations of `evaluate` from here on are functions and comparisons, whose cases are in `cl/lib/operations.h`.
#define OPERATION_FUNCTIONS 8u
// Floats of a block of `derive` in local memory: 11^3 samples, and what the last lanes read behind them.
#define DERIVE_BLOCK 1360u
// Floats of the tables of `cl/lib/steps.h`, with uneven axes.
#define STEP_TABLES 188u
// Sample type of a feature's field: 8-bit unsigned.
#define TYPE_U8 0u
// Sample type of a feature's field: 8-bit signed.
#define TYPE_I8 1u
// Sample type of a feature's field: 16-bit unsigned.
#define TYPE_U16 2u
// Sample type of a feature's field: 16-bit signed.
#define TYPE_I16 3u
// Sample type of a feature's field: 32-bit float.
#define TYPE_F32 4u
// Steps of a stored vertex position per cell.
#define VERTEX_LATTICE 2048.0f
// Columns of `construct`'s array of cubes: at most 64 + 8 + 1 cubes of levels 1 to 3 in a brick, padded.
#define CUBES 80u
// Rows of `construct`'s array of cubes.
#define CUBE_ROWS 26u
// Rounds of merges in which a block of the vertex tree is built at most.
#define TREE_ROUNDS 64u
// Level of the vertex tree's nodes of larger cubes, too.
#define MAX_CUBE_LEVEL 5u
// Flag of a node that is on the surface's border on the volume's faces.
#define NODE_BORDER 8u
// The same of a cluster.
#define CLUSTER_BORDER 8u
// Flag beside a node's error or key, in its sign bit: the merge removes one triangle instead of two.
#define KEY_SINGLE 2147483648u
// Bins of `fit`, with one for what lies before them and one for what lies behind.
#define FIT_BINS 2562u
// Words of a region's bit mask over its halo of cells: 34^3 - 32^3 cells, four sheets each, 32 bits a word.
#define HALO_WORDS 817u

#endif
