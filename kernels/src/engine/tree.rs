//! Builds the vertex tree.

use super::peel::all;
use crate::buffer::Buffer;
use crate::cancel::check_cancelled;
use crate::layout::{self, NONE, TreeRegion};
use crate::stages::dual::{self, Corners};
use crate::stages::tree;
use crate::stages::tree_cut::LEAF_NUMBER;
use crate::tree::TreeLevels;
use crate::{Cancel, Cut, CutParams, Engine, Error, Level, Pyramid, Result, VertexTree, Volume};
use std::sync::atomic::{AtomicU64, Ordering};

/// Id of the next tree, as with pyramids.
static TREES: AtomicU64 = AtomicU64::new(0);

/// Points and nodes that a leaf's number can name.
const MAX_LEAVES: usize = LEAF_NUMBER as usize + 1;

impl Engine {
    /// Builds the vertex tree of a pyramid. `params`: whether the volume is capped.
    ///
    /// # Errors
    /// [`Error::Cancelled`], or an error of the device.
    pub fn build_tree(
        &self,
        volume: &Volume,
        pyramid: &Pyramid,
        params: &CutParams,
        cancel: &dyn Cancel,
    ) -> Result<VertexTree> {
        let cx = &self.cx;
        let full = self.full_cut(volume, pyramid, params)?;
        let (params, state) = (full.params, full.state);
        let regions = pyramid.host_regions.len();
        let (counted, mut meshes) = dual::count(cx, volume, pyramid, &state, &all(pyramid))?;
        check_cancelled(cancel)?;
        let border_base = cx.buffer(tree::STAGE, regions * tree::HALO_WORDS)?;
        let borders = tree::borders(cx, volume, regions, &counted.borders, &border_base)?;
        let cell_points: u32 = pyramid.host_regions.iter().map(layout::Region::cell_points).sum();
        let host_regions = numbered(pyramid, cell_points, &borders);
        let point_count = cell_points as usize + borders.iter().map(|&n| n as usize).sum::<usize>();
        // Points without triangles lie beside missing samples and on the volume's faces.
        let used: u64 = meshes.iter().map(|mesh| u64::from(mesh.distinct_vertices)).sum();
        let isolated_points = (point_count as u64).saturating_sub(used);

        if 2 * point_count > MAX_LEAVES {
            return Err(Error::Invalid {
                what: "vertex tree",
                why: format!("{point_count} vertices, above {}", MAX_LEAVES / 2),
            });
        }
        let (device_meshes, _, triangle_count) = self.with_bases(tree::STAGE, &mut meshes)?;
        let corners: Buffer<u32> = cx.buffer(tree::STAGE, 3 * triangle_count)?;
        let points = cx.buffer(tree::STAGE, point_count)?;
        let tree_regions = cx.upload(tree::STAGE, &host_regions)?;
        tree::points(cx, volume, pyramid, &params, &points)?;
        let input = dual::Input {
            params: &params,
            state: &state,
            counted: &counted,
            meshes: &device_meshes,
            corners: Corners::Points {
                border_base: &border_base,
                tree_regions: &tree_regions,
                points: &points,
            },
        };
        let no_vertices = cx.buffer(tree::STAGE, 0)?;
        dual::emit(cx, volume, pyramid, &input, &no_vertices, &corners)?;
        drop((counted, state, border_base, tree_regions));
        cx.pause(tree::STAGE, cancel)?;

        let first_level = tree::Level {
            number: 0,
            is_last: volume.grid.regions() == [1; 3],
            grid: volume.layout(),
            params: &params,
            regions: &pyramid.regions,
            region_index: &pyramid.region_index,
            meshes: &device_meshes,
            corners: &corners,
            points: &points,
            cell_points,
            risen: tree::Risen {
                clusters: &cx.buffer(tree::STAGE, 0)?,
                members: &cx.buffer(tree::STAGE, 0)?,
            },
        };
        let (levels, beside) = self.build_levels(volume, pyramid, &first_level, host_regions, cancel)?;
        let TreeLevels {
            built,
            blocks,
            block_levels,
            vanishing,
        } = levels;
        let collapsed_by = tree::collapses(cx, volume, &first_level, &built)?;
        let (point_corners, corner_ends) = tree::point_corners(cx, volume, pyramid, &first_level, &built, &beside)?;
        let lives = tree::lives(cx, volume, pyramid, point_count, &built)?;
        cx.pause(tree::STAGE, cancel)?;
        Ok(VertexTree {
            id: TREES.fetch_add(1, Ordering::Relaxed),
            pyramid: pyramid.id,
            cap: params.cap != 0,
            blocks,
            block_levels,
            vanishing,
            built,
            points,
            cell_points,
            corners,
            meshes: device_meshes,
            collapsed_by,
            point_corners,
            corner_ends,
            lives,
            beside,
            full_triangles: triangle_count as u64,
            isolated_points,
            parts: Default::default(),
            uniform_curve: Default::default(),
            left_out: Default::default(),
            last_cut: Default::default(),
            importances: Default::default(),
        })
    }

    /// The full surface as a cut of cubes.
    pub(super) fn full_cut(&self, volume: &Volume, pyramid: &Pyramid, params: &CutParams) -> Result<Cut> {
        let full = CutParams {
            beta: -1.0,
            tolerance: None,
            ..params.clone()
        };
        self.cut(volume, pyramid, &full, Level::FINEST)
    }
}

/// Assigns each region its range of border points (points on the volume's faces). `borders`: border points per region.
fn numbered(pyramid: &Pyramid, cell_points: u32, borders: &[u32]) -> Vec<TreeRegion> {
    let mut border_base = cell_points;
    let regions = pyramid.host_regions.iter().zip(borders).enumerate();
    regions
        .map(|(i, (region, &border_points))| {
            let numbered = TreeRegion {
                border_base,
                border_points,
                points: region.cell_points() + border_points,
                region: i as u32,
                above: NONE,
                ..Default::default()
            };
            border_base += border_points;
            numbered
        })
        .collect()
}
