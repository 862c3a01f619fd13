// Structs of kernels' arguments, from the launchers in kernels/src/stages. Generated: `make generated`.
#ifndef ISOPEEL_ARGS_H
#define ISOPEEL_ARGS_H

#include "lib/layout.h"

// Arguments of `generate`.
typedef struct {
    Grid grid; // Extent of the volume.
    uint z0; // First plane of the slab.
    uint first; // First plane of this launch.
    uint planes; // Planes of this launch.
    uint shape; // Formula, as `Shape::numbers`.
    float period; // Samples after which the formula repeats.
    uint count; // Balls along each axis.
    uint closed; // 1: the outermost samples are below every surface.
    float factor; // Stored is value * factor + offset.
    float offset; // See `factor`.
} GenerateArgs;

// Arguments of `minmax`.
typedef struct {
    Grid grid; // Extent of the volume.
    uint z0; // First plane of the slab.
    uint first_run; // First row of bricks' regions of this launch, counted in runs along x, then y, then z.
} MinmaxArgs;

// Arguments of `histogram_range`.
typedef struct {
    Grid grid; // Extent of the volume.
    uint z0; // First plane of the slab.
    uint kind; // `FEATURE_NONE` for the samples themselves, `FEATURE_GRADIENT`, or `FEATURE_STORED` for values of `derive`.
    uint first_plane; // First plane of this launch.
    uint first_row; // First row of this launch, in that plane.
    uint count; // Samples of this launch.
} HistogramRangeArgs;

// Arguments of `histogram_bins`.
typedef struct {
    Grid grid; // Extent of the volume.
    uint z0; // First plane of the slab.
    uint kind; // `FEATURE_NONE` for the samples themselves, `FEATURE_GRADIENT`, or `FEATURE_STORED` for values of `derive`.
    uint first_plane; // First plane of this launch.
    uint first_row; // First row of this launch, in that plane.
    uint count; // Samples of this launch.
    float lo; // Minimum of the range.
    float hi; // Maximum of the range.
} HistogramBinsArgs;

// Arguments of `classify`.
typedef struct {
    Grid grid; // Extent of the volume.
    uint z0; // First plane of the slab.
    float iso; // Isovalue in the field's units.
    uint first_brick; // Compact index of the first brick of this launch.
} ClassifyArgs;

// Arguments of `derive` and `derive_samples`.
typedef struct {
    Grid grid; // Extent of the volume.
    uint z0; // First plane of the slab.
    uint kind; // Number of the feature.
    uint components; // Fields that it is computed from, 1 or 3.
    uint type_x; // Sample type of the first field, `TYPE_U8` to `TYPE_F32`.
    uint type_y; // Of the second one.
    uint type_z; // Of the third one.
    float missing_x; // Samples of the first field equal to this count as NaN.
    float missing_y; // Of the second one.
    float missing_z; // Of the third one.
    uint first; // Compact index of the first brick of this launch; of `derive_samples` its first plane.
    uint planes; // Planes of this launch of `derive_samples`.
} DeriveArgs;

// Arguments of `construct`.
typedef struct {
    Grid grid; // Extent of the volume.
    uint z0; // First plane of the slab.
    float iso; // Isovalue in the field's units.
    uint feature_kind; // `FEATURE_NONE`, `FEATURE_FIELD`, `FEATURE_GRADIENT` or `FEATURE_STORED`.
    uint feature_type; // Sample type of the feature's field, `TYPE_U8` to `TYPE_F32`.
    float feature_missing; // Samples of the feature's field equal to this count as NaN.
    uint first_brick; // Compact index of the first brick of this launch.
    uint whole; // 1: nodes of all levels; 0: cells alone.
} ConstructArgs;

// Arguments of `construct_top`.
typedef struct {
    Grid grid; // Extent of the volume.
    uint z0; // First plane of the slab.
    float iso; // Isovalue in the field's units.
    uint whole_pyramid; // 1: nodes of all levels; 0: cells alone.
    uint first_region; // Compact index of the first region of this launch.
    uint region_count; // Active regions.
} ConstructTopArgs;

// Arguments of `link`.
typedef struct {
    Grid grid; // Extent of the volume.
    uint brick_count; // Active bricks.
} LinkArgs;

// Arguments of `cut`.
typedef struct {
    Grid grid; // Extent of the volume.
    CutParams params; // What the cut depends on.
    uint whole_pyramid; // 1: nodes of all levels exist; 0: those of level 0 alone, which all are leaves.
} CutArgs;

// Arguments of `fit`.
typedef struct {
    Grid grid; // Extent of the volume.
    CutParams params; // What the cut depends on; its β is not read.
    uint first_key; // First key of bin 1.
    uint shift; // A bin holds 2^shift keys.
} FitArgs;

// Arguments of `march_mark` and `march_vertices`.
typedef struct {
    Grid grid; // Extent of the volume.
    uint z0; // First plane of the slab.
    float iso; // Isovalue in the field's units.
    uint first_region; // Compact index of the first region of this launch.
} MarchArgs;

// Arguments of `patch`.
typedef struct {
    Grid grid; // Extent of the volume.
    uint level; // Level whose segments the vertices are moved onto.
} PatchArgs;

// Arguments of `pack`.
typedef struct {
    Grid grid; // Extent of the volume.
    uint z0; // First plane of the slab.
    float iso; // Isovalue in the field's units.
    CutParams params; // What the cut depends on.
    uint first_region; // Compact index of the first region of this launch.
} PackArgs;

// Arguments of `dual_count`.
typedef struct {
    Grid grid; // Extent of the volume.
    uint brick_count; // Active bricks.
    uint has_missing; // 1: samples are missing somewhere.
} DualCountArgs;

// Arguments of `dual_emit`.
typedef struct {
    Grid grid; // Extent of the volume.
    CutParams params; // What the cut depends on.
    uint brick_count; // Active bricks.
    uint has_missing; // 1: samples are missing somewhere.
    uint corners; // What is written for corners: `CORNERS_INDICES` and its like.
} DualEmitArgs;

// Arguments of `error_positions`.
typedef struct {
    Grid grid; // Extent of the volume.
    CutParams params; // What the cut depends on.
    uint first_region; // Compact index of the first region of this launch.
} ErrorPositionsArgs;

// Arguments of `error_leaves` and `error_corners`.
typedef struct {
    Grid grid; // Extent of the volume.
    uint slots; // Slots of the pyramid.
    uint cell_points; // Points of cells and sheets.
    uint points; // Points of the surface.
    uint cap; // 1: the volume was padded by one sample on every side.
    uint regions; // Number of regions, which are the first blocks of the tree.
} ErrorLeavesArgs;

// Arguments of `error_seeds`, `error_regions` and `error_far`.
typedef struct {
    Grid grid; // Extent of the volume.
    uint region_count; // Active regions.
    uint brick_count; // Active bricks.
    uint has_stand_ins; // 1: other vertices stand for those of slots.
} ErrorSeedsArgs;

// Arguments of `error_spread`.
typedef struct {
    Grid grid; // Extent of the volume.
    uint step; // Distance of the regions that are looked at, in regions.
} ErrorSpreadArgs;

// Arguments of `error_crossings`.
typedef struct {
    Grid grid; // Extent of the volume.
    uint z0; // First plane of the slab.
    float iso; // Isovalue in the field's units.
    uint cap; // 1: the volume was padded by one sample on every side.
    uint has_missing; // 1: samples are missing somewhere.
    uint first_task; // The first task of this launch.
    uint region_count; // Active regions.
    uint has_stand_ins; // 1: other vertices stand for those of slots.
} ErrorCrossingsArgs;

// Arguments of `error_samples`.
typedef struct {
    Grid grid; // Extent of the volume.
    uint z0; // First plane of the slab.
    float iso; // Isovalue in the field's units.
    uint cap; // 1: the volume was padded by one sample on every side.
    uint first_task; // The first task of this launch.
    uint first_layer; // First layer of regions of the slab, counted in regions along z.
    uint end_layer; // Layer of regions after the last.
    uint region_count; // Active regions.
} ErrorSamplesArgs;

// Arguments of `tree_points`.
typedef struct {
    Grid grid; // Extent of the volume.
    CutParams params; // What positions depend on: whether the volume is capped.
} TreePointsArgs;

// Arguments of `tree_gather`.
typedef struct {
    Grid grid; // Extent of the volume, in blocks of the level instead of regions.
    uint first_region; // First block of this launch.
    uint fill; // 0: the triangles are counted; 1: they are written, and the numbers of those of other blocks; 2: without these.
} TreeGatherArgs;

// Arguments of `tree_build`.
typedef struct {
    Grid grid; // Extent of the volume, in blocks of the level instead of regions.
    CutParams params; // What positions depend on: whether the volume is capped.
    uint first_region; // First block of this launch.
    uint cell_points; // Points of cells and sheets of all regions.
    uint level; // Level of the blocks.
    uint is_last; // 1: there is no level above.
    uint is_soft; // 1: merges that turn or fold the surface are not forbidden but cost more.
    uint rounds; // Maximum number of rounds of this launch.
} TreeBuildArgs;

// Arguments of `tree_commit`, `tree_rise` and `tree_risen`.
typedef struct {
    Grid grid; // Extent of the volume, in blocks of the level instead of regions.
    uint first_region; // First block of this launch.
    uint level; // Level of the blocks.
    uint points; // Points of the surface.
} TreeRiseArgs;

// Arguments of `tree_part_add`.
typedef struct {
    Grid grid; // Extent of the volume.
    float quantum; // Unit of areas, world units.
} TreePartAddArgs;

// Arguments of `tree_part_remove`.
typedef struct {
    uint points; // Points of the surface.
    float min_area; // Parts of a smaller area are removed, world units.
    uint chosen; // Parts that were chosen.
    uint keep; // 1: all but the chosen ones are removed; 0: the chosen ones are.
} TreePartRemoveArgs;

// Arguments of `tree_weigh`.
typedef struct {
    CutParams params; // What the importance depends on.
    uint first_block; // First block of this launch.
    uint regions; // Number of regions, which are the first blocks.
    uint vanishing; // Number of the block of nodes at which parts vanish, or `NONE`.
} TreeWeighArgs;

// Arguments of `tree_lower`.
typedef struct {
    uint first_block; // First block of this launch.
    uint regions; // Number of regions, which are the first blocks.
    uint first_above; // First node above the regions.
    uint vanishing; // Number of the block of nodes at which parts vanish, or `NONE`.
} TreeLowerArgs;

// Arguments of `tree_keys`.
typedef struct {
    uint has_importances; // 1: nodes have importances; 0: these are 0.
    uint has_weights; // 1: regions have weights; 0: these are 1.
    uint in_steps; // 1: with weights of regions, errors count as the next power of four.
    float guard; // With weights of regions: nodes whose error over weight, without those, is above this one are never merged.
    uint first_block; // First block of this launch.
    uint regions; // Number of regions, which are the first blocks.
    uint first_above; // First node above the regions.
} TreeKeysArgs;

// Arguments of `tree_histogram`.
typedef struct {
    uint first_key; // First key of bin 1.
    uint shift; // A bin holds 2^shift keys.
    uint nodes; // Number of keys, including those of slots without a node.
} TreeHistogramArgs;

// Arguments of `tree_leaves`.
typedef struct {
    float tolerance; // Nodes with keys up to this one are merged.
    uint points; // Points of the surface.
    uint first; // 1: there was no cut of the same tolerance before this one.
    uint removes; // 1: parts are left out; 0: none are.
    uint first_block; // First block of this launch.
    uint regions; // Number of regions, which are the first blocks.
} TreeLeavesArgs;

// Arguments of `tree_test`.
typedef struct {
    Grid grid; // Extent of the volume.
    uint cell_points; // Points of cells and sheets.
    uint points; // Points of the surface.
    float tolerance; // Nodes with keys up to this one are merged.
    uint removes; // 1: parts are left out; 0: none are.
    uint first_above; // Leaves before those that are nodes of levels above the regions.
} TreeTestArgs;

// Arguments of `tree_vertices`.
typedef struct {
    Grid grid; // Extent of the volume.
    CutParams params; // What vertices depend on: the feature's range.
    uint cap; // 1: the volume was padded by one sample on every side.
    uint points; // Points of the surface.
} TreeVerticesArgs;

// Arguments of `tree_offsets`.
typedef struct {
    Grid grid; // Extent of the volume.
    uint points; // Points of the surface.
    uint first_above; // Leaves before those that are nodes of levels above the regions.
} TreeOffsetsArgs;

// Arguments of `slice`.
typedef struct {
    Grid grid; // Extent of the volume.
    uint z0; // First plane of the slab.
    uint axis; // Axis across the plane.
    uint index; // Of the plane along it.
    uint width; // Samples of a row.
    uint first_row; // The first row of this launch.
    uint count; // Samples of this launch.
} SliceArgs;

// Arguments of `overview`.
typedef struct {
    Grid grid; // Extent of the volume.
    uint z0; // First plane of the slab.
    uint factor_x; // Samples of a block along x.
    uint factor_y; // Samples of a block along y.
    uint factor_z; // Samples of a block along z.
    uint width; // Blocks of a row.
    uint height; // Rows of blocks of a plane.
    uint first_row; // The first row of blocks of this launch.
    uint count; // Blocks of this launch.
    uint first_plane; // The first plane of samples that this launch reads.
    uint end_plane; // The plane of samples after its last one.
    float scale; // What values are multiplied by before they are added.
    uint is_maximum; // Whether maxima are wanted, not sums.
} OverviewArgs;

// Arguments of `probe`.
typedef struct {
    Grid grid; // Extent of the volume.
    CutParams params; // What the importance depends on.
    uint positions; // How many there are.
} ProbeArgs;

// Arguments of `distribution_cut` and `distribution_tree`.
typedef struct {
    CutParams params; // What the feature depends on.
    uint bins; // Bins from 0 to 1.
    uint points; // Points of the vertex tree.
} DistributionArgs;

// Arguments of `curve_cut` and `curve_tree`.
typedef struct {
    Grid grid; // Extent of the volume.
    CutParams params; // What the cut depends on; its threshold is not read.
    uint first_key; // First key of bin 1.
    uint shift; // A bin holds 2^shift keys.
    uint regions; // Active regions, or blocks of the vertex tree.
} CurveArgs;

// Arguments of `distance_points`.
typedef struct {
    Grid grid; // Extent of the volume.
    uint z0; // First plane of the slab.
    float iso; // Isovalue in the field's units.
    uint first_layer; // First layer of regions of the slab, counted in regions along z.
    uint end_layer; // Layer of regions after the last.
    uint first; // The first point of this launch.
    uint end; // The point after the last.
} DistanceArgs;

// Arguments of `interpolate`.
typedef struct {
    Grid grid; // Extent of the volume.
    uint z0; // First plane of the slab.
    uint first_layer; // First layer of regions of the slab, counted in regions along z.
    uint end_layer; // Layer of regions after the last.
    uint first; // The first point of this launch.
    uint end; // The point after the last.
} InterpolateArgs;

// Arguments of `evaluate`.
typedef struct {
    uint first; // First sample of this launch, in blocks of LAUNCH_BLOCK.
    uint count; // Samples of this launch.
    uint operations; // Operations of the expression.
    uint fields; // Fields of the expression.
    uint type_0; // Sample type of the first field, `TYPE_U8` to `TYPE_F32`.
    uint type_1; // Of the second one.
    uint type_2; // Of the third one.
    uint type_3; // Of the fourth one.
    uint type_4; // Of the fifth one.
    uint type_5; // Of the sixth one.
    uint type_6; // Of the seventh one.
    uint type_7; // Of the eighth one.
    float missing_0; // Samples of the first field equal to this count as NaN.
    float missing_1; // Of the second one.
    float missing_2; // Of the third one.
    float missing_3; // Of the fourth one.
    float missing_4; // Of the fifth one.
    float missing_5; // Of the sixth one.
    float missing_6; // Of the seventh one.
    float missing_7; // Of the eighth one.
} EvaluateArgs;

// Arguments of `mask`.
typedef struct {
    uint first; // First sample of this launch, in blocks of LAUNCH_BLOCK.
    uint count; // Samples of this launch.
    uint samples_type; // Sample type of the field, `TYPE_U8` to `TYPE_F32`.
    uint labels_type; // Of the labels.
    uint out_type; // Of the result.
    uint ranges; // Ranges of labels.
    uint is_complement; // Whether labels in no range are inside, 1 or 0.
    float missing_label; // Labels equal to this are missing.
    float missing; // Value of the samples outside.
} MaskArgs;

// Arguments of `distance_field_before` and `distance_field_after`.
typedef struct {
    Grid grid; // Extent of the volume.
    uint z0; // First plane of the slab.
    uint planes; // Planes of the slab.
    uint keep; // The plane at which the neighbouring slab goes on.
    uint first; // First column of this launch.
    uint columns; // Columns of this launch.
    float scale; // Units of one step between positions.
} DistanceColumnsArgs;

// Arguments of `distance_field_envelope`.
typedef struct {
    Grid grid; // Extent of the volume.
    uint axis; // Axis of the lines: 0 or 1.
    uint first; // First line of this launch.
    uint lines; // Lines of this launch.
    uint is_even; // 1: positions are the numbers of the samples.
    uint is_last; // 1: distances are written; 0: their squares.
    float scale; // Units of one step between positions.
    float unit; // World units of a unit of length.
} DistanceLinesArgs;

#endif
