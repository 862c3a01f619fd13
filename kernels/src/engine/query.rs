//! Queries on the current surface: slices, probes, distributions and error curves. No mesh is made.

use super::fit::{ERROR_KEYS, IMPORTANCE_KEYS};
use crate::buffer::Buffer;
use crate::layout::ProbedCell;
use crate::lock::lock;
use crate::stages::cut::{self, Criterion};
use crate::stages::fit::{self, INNER_BINS, Keys};
use crate::stages::tree_cut::{Cutter, LEAF_LEVEL_SHIFT, LEAF_NUMBER};
use crate::stages::{curve, distribution, probe, slice};
use crate::tree::{TreeCut, max_move};
use crate::{
    Cancel, CurvePoint, Cut, CutParams, Engine, Error, Level, Pyramid, REGION_CELLS, Result, SampleType, TreeGoal,
    VertexTree, Volume,
};
use std::sync::Arc;

/// Stage name of the reads in this module.
const STAGE: &str = "query";

/// Maximum bins of a distribution: those that a work-group has local memory for.
pub const MAX_BINS: u32 = 256;

/// Points of a curve.
pub const CURVE_POINTS: usize = 32;

/// The cut of the queried surface.
#[derive(Clone)]
pub enum ShownCut<'a> {
    /// Cubes.
    Cubes(&'a Cut),
    /// Leaves of the vertex tree.
    Tree(&'a VertexTree, Arc<TreeCut>),
}

/// The leaf that represents the surface at a probed position.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ProbedLeaf {
    /// Its level.
    pub level: u8,
    /// Root mean square distance to the full surface that the leaf represents, in world units, as estimated by its quadric.
    pub error: f32,
}

/// A part of the full surface.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ProbedPart {
    /// Identifies the part: all of its points have this number and no other part has it. Valid for the lifetime of the tree.
    pub number: u32,
    /// Its area, world units.
    pub area: f32,
}

/// The surface next to a position.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Probed {
    /// From the position to the nearest vertex of the full surface, world units.
    pub distance: f32,
    /// Smoothness feature of its cell.
    pub smoothness: f32,
    /// User feature of its cell, in the feature's own units.
    pub feature: f32,
    /// Blend of both, which the transfer function maps to importance.
    pub blended: f32,
    /// Importance that the transfer function gives it, raised if the vertex is in a region of interest.
    pub importance: f32,
    /// Leaf that represents it; `None` if its part was removed.
    pub leaf: Option<ProbedLeaf>,
    /// Its part. `None` if it belongs to none, or if parts are not known: for cubes, and for a large surface before the first removal.
    pub part: Option<ProbedPart>,
}

/// Histogram of the blended feature over a surface. Each vertex of the full surface counts once, with the leaf that represents it.
#[derive(Clone, Debug, PartialEq)]
pub struct DistributionCounts {
    /// Vertices in equal bins from 0 to 1.
    pub all: Vec<u32>,
    /// Those of `all` whose leaf represents other vertices too.
    pub coarse: Vec<u32>,
}

impl Engine {
    /// Returns the cut of the last surface that [`Engine::tree_surface`] made; makes it again if that surface had another cut.
    ///
    /// # Errors
    /// As [`Engine::tree_surface`].
    pub fn shown_tree_cut<'a>(
        &self,
        volume: &Volume,
        pyramid: &Pyramid,
        tree: &'a VertexTree,
        params: &CutParams,
        goal: &TreeGoal,
        cancel: &dyn Cancel,
    ) -> Result<ShownCut<'a>> {
        let cutter = self.cutter_for(volume, pyramid, tree, params, goal, cancel)?;
        Ok(ShownCut::Tree(tree, self.tree_cut(&cutter, params, goal, cancel)?))
    }

    /// The samples of a plane across an axis (0 to 2), as they are on the device, the lower of the other axes fastest.
    ///
    /// # Errors
    /// [`Error::Invalid`] if there is no such plane, or an error of the device.
    pub fn slice(&self, volume: &Volume, axis: usize, index: u32) -> Result<Vec<u8>> {
        let Some(&planes) = volume.grid.dims.get(axis) else {
            return Err(Error::Invalid {
                what: "axis",
                why: format!("{axis}, expected 0 to 2"),
            });
        };
        if index >= planes {
            let why = format!("{index}, expected 0 to {}", planes - 1);
            return Err(Error::Invalid { what: "index", why });
        }
        slice::run(&self.cx, volume, axis, index)
    }

    /// Value of the trilinear interpolant at a position inside the volume, in cells; `None` if a sample with a non-zero weight is missing.
    ///
    /// # Errors
    /// An error of the device.
    pub fn value_at(&self, volume: &Volume, position: [f32; 3]) -> Result<Option<f32>> {
        let dims = volume.grid.dims;
        let low: [u32; 3] = std::array::from_fn(|i| (position[i].max(0.0) as u32).min(dims[i] - 2));
        let mut value = 0.0;
        for corner in 0..8u32 {
            let bit = |i: usize| corner >> i & 1;
            let weight: f32 = (0..3)
                .map(|i| {
                    let t = (position[i] - low[i] as f32).clamp(0.0, 1.0);
                    if bit(i) == 1 { t } else { 1.0 - t }
                })
                .product();
            if weight == 0.0 {
                continue;
            }
            let sample = self.sample(volume, [low[0] + bit(0), low[1] + bit(1), low[2] + bit(2)])?;
            if sample.is_nan() || sample == volume.missing {
                return Ok(None);
            }
            value += weight * sample;
        }
        Ok(Some(value))
    }

    fn sample(&self, volume: &Volume, [x, y, z]: [u32; 3]) -> Result<f32> {
        let [nx, ny, _] = volume.grid.dims.map(|n| n as usize);
        let layer = (z / REGION_CELLS).min(volume.grid.regions()[2] - 1);
        let slab = volume.slabs.iter().find(|slab| slab.layers.contains(&layer));
        let slab = slab.expect("slabs hold every layer");
        let bytes = volume.sample_type.bytes();
        let at = (((z - slab.z0) as usize * ny + y as usize) * nx + x as usize) * bytes;
        let read = self.cx.read_at(STAGE, &slab.samples, at, bytes)?;
        Ok(match volume.sample_type {
            SampleType::U8 => f32::from(read[0]),
            SampleType::I8 => f32::from(read[0].cast_signed()),
            SampleType::U16 => f32::from(bytemuck::pod_read_unaligned::<u16>(&read)),
            SampleType::I16 => f32::from(bytemuck::pod_read_unaligned::<i16>(&read)),
            SampleType::F32 => bytemuck::pod_read_unaligned(&read),
        })
    }

    /// Probes the surface next to a position inside the volume, in cells: at the nearest vertex of the full surface among those of the
    /// 5³ cells around the position. `None` if none of these cells is active.
    ///
    /// # Errors
    /// An error of the device.
    pub fn probe(
        &self,
        volume: &Volume,
        pyramid: &Pyramid,
        params: &CutParams,
        position: [f32; 3],
        cut: Option<&ShownCut<'_>>,
    ) -> Result<Option<Probed>> {
        let criterion = Criterion::upload(&self.cx, params, Level::FINEST)?;
        let Some(cell) = probe::run(&self.cx, volume, pyramid, &criterion, &[position])?[0] else {
            return Ok(None);
        };
        let (leaf, part) = match cut {
            None => (None, None),
            Some(ShownCut::Cubes(cut)) => (self.cube_of(pyramid, cut, &cell)?, None),
            Some(ShownCut::Tree(tree, cut)) => (
                self.leaf_of(volume, pyramid, tree, cut, &cell)?,
                self.part_of(&self.cutter(volume, pyramid, tree, params), cell.point)?,
            ),
        };
        Ok(Some(Probed {
            distance: cell.distance,
            smoothness: cell.s,
            feature: cell.f,
            blended: cell.blended,
            importance: cell.importance,
            leaf,
            part,
        }))
    }

    /// Returns the leaf cube that represents a cell.
    fn cube_of(&self, pyramid: &Pyramid, cut: &Cut, cell: &ProbedCell) -> Result<Option<ProbedLeaf>> {
        let level = self.cx.read_at(STAGE, &cut.state, cell.slots[0] as usize, 1)?[0];
        let Some(&slot) = cell.slots.get(usize::from(level)) else {
            return Ok(None);
        };
        let record = self.cx.read_at(STAGE, &pyramid.vertex_records, slot as usize, 1)?[0];
        Ok(Some(ProbedLeaf {
            level,
            error: record.error,
        }))
    }

    /// Returns the leaf of the vertex tree that represents a cell. A node stores the sum of its squared distances, weighted by area. Its
    /// area is estimated from its number of points, as if all points of the region had the same area.
    fn leaf_of(
        &self,
        volume: &Volume,
        pyramid: &Pyramid,
        tree: &VertexTree,
        cut: &TreeCut,
        cell: &ProbedCell,
    ) -> Result<Option<ProbedLeaf>> {
        let points = tree.point_count();
        let packed = self.cx.read_at(STAGE, &cut.leaves, cell.point as usize, 1)?[0];
        let (number, level) = (packed & LEAF_NUMBER, (packed >> LEAF_LEVEL_SHIFT & 7) as u8);
        // The point is in a removed part.
        if number == LEAF_NUMBER {
            return Ok(None);
        }
        if number < points {
            return Ok(Some(ProbedLeaf { level: 0, error: 0.0 }));
        }
        // The sign bit is a flag (the merge removes one triangle instead of two), not part of the error.
        let error = self
            .cx
            .read_at(STAGE, &tree.built.node_errors, (number - points) as usize, 1)?[0];
        let error = f32::from_bits(error).abs();
        // A leaf of several regions' points knows its error itself. Parts that vanish are small.
        let node = (number - points) as usize;
        if number >= tree.first_above() && !tree.vanishing_nodes().contains(&node) {
            let node = self.cx.read_at(STAGE, &tree.built.nodes, node, 1)?[0];
            let error = volume.grid.smallest_spacing() * 2.0 * max_move(&node);
            return Ok(Some(ProbedLeaf { level, error }));
        }
        let region = cell.region as usize;
        let (of_pyramid, of_tree) = (&pyramid.host_regions[region], &tree.blocks[region]);
        let parts = [
            (of_pyramid.point_base, of_pyramid.cell_points()),
            (of_tree.border_base, of_tree.border_points),
        ];
        let (mut own, mut all) = (0usize, 0);
        for (first, count) in parts {
            let leaves = self.cx.read_at(STAGE, &cut.leaves, first as usize, count as usize)?;
            own += leaves.iter().filter(|&&leaf| leaf & LEAF_NUMBER == number).count();
            all += leaves.len();
        }
        let area = f64::from(of_tree.area) * own as f64 / all.max(1) as f64;
        Ok(Some(ProbedLeaf {
            level,
            error: if area > 0.0 {
                volume.grid.smallest_spacing() * error / area.sqrt() as f32
            } else {
                0.0
            },
        }))
    }

    /// How the blended feature of a cut's leaves is distributed, in 1 to [`MAX_BINS`] bins.
    ///
    /// # Errors
    /// [`Error::Invalid`] for another number of bins, or an error of the device.
    pub fn distribution(
        &self,
        volume: &Volume,
        pyramid: &Pyramid,
        params: &CutParams,
        cut: &ShownCut<'_>,
        bins: u32,
    ) -> Result<DistributionCounts> {
        if !(1..=MAX_BINS).contains(&bins) {
            let why = format!("{bins}, expected 1 to {MAX_BINS}");
            return Err(Error::Invalid { what: "bins", why });
        }
        let (cx, params) = (&self.cx, cut::layout(params, Level::FINEST));
        let mut all = match cut {
            ShownCut::Cubes(cut) => distribution::of_cut(cx, volume, pyramid, params, &cut.state, bins)?,
            ShownCut::Tree(tree, cut) => distribution::of_tree(cx, volume, pyramid, params, tree, &cut.leaves, bins)?,
        };
        let coarse = all.split_off(bins as usize);
        Ok(DistributionCounts { all, coarse })
    }

    /// Returns estimated error and triangles of the cuts that a view's importance allows, from the full surface to the coarsest: at most
    /// [`CURVE_POINTS`], whose triangles fall by equal factors if there are such cuts. For the vertex tree, the repairs of this cut are
    /// included, but not those that other cuts would need.
    ///
    /// # Errors
    /// [`Error::Cancelled`], or an error of the device.
    pub fn error_curve(
        &self,
        volume: &Volume,
        pyramid: &Pyramid,
        params: &CutParams,
        cut: &ShownCut<'_>,
        cancel: &dyn Cancel,
    ) -> Result<Vec<CurvePoint>> {
        let cuts = match cut {
            ShownCut::Cubes(cut) => self.cube_cuts(volume, pyramid, params, cut, cancel)?,
            ShownCut::Tree(tree, cut) => {
                let cutter = Cutter {
                    left_out: cut.left_out.clone(),
                    ..self.cutter(volume, pyramid, tree, params)
                };
                self.tree_cuts(&cutter, params, &cut.keys)?
            }
        };
        Ok(thinned(&cuts))
    }

    /// Returns how the estimated error of cuts of a tree grows with the tolerance, if all weights are 1. Computed once a tree.
    ///
    /// # Errors
    /// An error of the device.
    pub fn uniform_curve<'a>(
        &self,
        volume: &Volume,
        pyramid: &Pyramid,
        tree: &'a VertexTree,
        params: &CutParams,
    ) -> Result<&'a [CurvePoint]> {
        if let Some(curve) = tree.uniform_curve.get() {
            return Ok(curve);
        }
        let cutter = self.cutter(volume, pyramid, tree, params);
        let work = cutter.begin()?;
        cutter.keys(None, &work)?;
        let curve = self.tree_cuts(&cutter, params, &work.keys)?;
        Ok(tree.uniform_curve.get_or_init(|| thinned(&curve)))
    }

    /// The cuts at the end of each bin of keys, the full surface first.
    fn tree_cuts(&self, cutter: &Cutter<'_>, params: &CutParams, keys: &Buffer<u32>) -> Result<Vec<CurvePoint>> {
        let Cutter {
            volume, pyramid, tree, ..
        } = *cutter;
        let layout = cut::layout(params, Level::FINEST);
        let removed = cutter.histogram(keys, ERROR_KEYS)?;
        let changes = curve::of_tree(&self.cx, volume, pyramid, layout, tree, ERROR_KEYS, keys)?;
        let full = cutter.full_triangles();
        let (mut triangles, mut error2) = (full, 0.0);
        let bins = removed.iter().zip(&changes).take(INNER_BINS + 1).enumerate();
        let at_ends = bins.map(|(bin, (&removed, change))| {
            triangles -= u64::from(removed);
            error2 += change;
            CurvePoint {
                threshold: end_of(ERROR_KEYS, bin),
                triangles,
                rms: cutter.rms(error2),
            }
        });
        let first = CurvePoint {
            threshold: -1.0,
            triangles: full,
            rms: 0.0,
        };
        Ok(std::iter::once(first).chain(at_ends).collect())
    }

    /// As [`Engine::tree_cuts`], for cuts of cubes. The triangles are estimated from the leaves: the triangles per leaf are interpolated
    /// between those of the full surface and of this cut.
    fn cube_cuts(
        &self,
        volume: &Volume,
        pyramid: &Pyramid,
        params: &CutParams,
        cut: &Cut,
        cancel: &dyn Cancel,
    ) -> Result<Vec<CurvePoint>> {
        let range = match params.tolerance {
            Some(_) => ERROR_KEYS,
            None => IMPORTANCE_KEYS,
        };
        let criterion = Criterion::upload(&self.cx, params, Level::FINEST)?;
        let (leaf_changes, keys) = fit::run(&self.cx, volume, pyramid, &criterion, range)?;
        let changes = curve::of_cut(&self.cx, volume, pyramid, &criterion, range, &keys)?;
        let cells = pyramid.active_cells as f64;
        let full = pyramid.full_triangles.max(1) as f64;
        let counted = self.triangles_of(volume, pyramid, cut, cancel)? as f64;
        let own_leaves = cut.leaves().iter().sum::<u64>() as f64;
        // A leaf has about two triangles; how many exactly changes with the logarithm of the leaves.
        let (of_full, of_own) = (full / cells.max(1.0), counted / own_leaves.max(1.0));
        let per_leaf = |leaves: f64| {
            let share = (cells / leaves.max(1.0)).ln() / (cells / own_leaves.max(1.0)).ln();
            let share = if share.is_finite() { share.clamp(0.0, 1.0) } else { 0.0 };
            of_full + share * (of_own - of_full)
        };
        let (mut leaves, mut error2) = (cells, 0.0);
        let bins = leaf_changes.iter().zip(&changes).take(INNER_BINS + 1).enumerate();
        let at_ends = bins.map(|(bin, (&change, error_change))| {
            leaves += f64::from(change);
            error2 += error_change;
            CurvePoint {
                threshold: end_of(range, bin),
                triangles: (leaves * per_leaf(leaves)).round() as u64,
                rms: (error2.max(0.0) / full).sqrt() as f32,
            }
        });
        Ok(at_ends.collect())
    }

    /// Returns the number of triangles of a cut; counts them on the device if its mesh is not known.
    fn triangles_of(&self, volume: &Volume, pyramid: &Pyramid, cut: &Cut, cancel: &dyn Cancel) -> Result<u64> {
        if let Some(meshes) = &*lock(&cut.meshes) {
            let triangles = meshes
                .counts
                .iter()
                .map(|mesh| crate::mesh_regions::triangles(mesh) as u64);
            return Ok(triangles.sum());
        }
        Ok(self.count(volume, pyramid, cut, cancel)?.triangles)
    }
}

/// The last key of a bin.
fn end_of(range: Keys, bin: usize) -> f32 {
    f32::from_bits(range.first + ((bin as u32) << range.shift) - 1)
}

/// Thins cuts with falling triangle counts to at most [`CURVE_POINTS`]: keeps the first and the last, and between them the cuts
/// nearest to equal factors.
fn thinned(cuts: &[CurvePoint]) -> Vec<CurvePoint> {
    let (Some(first), Some(last)) = (cuts.first(), cuts.last()) else {
        return Vec::new();
    };
    let [full, smallest] = [first, last].map(|point| (point.triangles.max(1) as f64).ln());
    let mut points: Vec<CurvePoint> = Vec::with_capacity(CURVE_POINTS);
    for i in 0..CURVE_POINTS {
        let share = i as f64 / (CURVE_POINTS - 1) as f64;
        let wanted = (full + share * (smallest - full)).exp();
        let at = cuts.partition_point(|point| point.triangles as f64 > wanted * (1.0 + 1e-9));
        let point = cuts[at.min(cuts.len() - 1)];
        if points.last().is_none_or(|before| point.triangles < before.triangles) {
            points.push(point);
        }
    }
    points
}

#[cfg(test)]
mod tests {
    use super::{CURVE_POINTS, CurvePoint, thinned};

    #[test]
    fn points_fall_by_equal_factors_and_end_where_the_cuts_do() {
        let cuts: Vec<CurvePoint> = (0..1000)
            .map(|i| CurvePoint {
                threshold: i as f32,
                triangles: 100_000 - 99 * i,
                rms: i as f32,
            })
            .collect();
        let points = thinned(&cuts);
        assert_eq!(points.len(), CURVE_POINTS);
        assert_eq!(points.first(), cuts.first());
        assert_eq!(points.last(), cuts.last());
        let ratio = points[10].triangles as f64 / points[11].triangles as f64;
        let expected = (100_000f64 / cuts[999].triangles as f64).powf(1.0 / 31.0);
        assert!((ratio / expected - 1.0).abs() < 0.02, "{ratio}, expected {expected}");
        assert!(points.windows(2).all(|two| two[0].triangles > two[1].triangles));
    }

    #[test]
    fn few_cuts_are_all_there() {
        let cuts = [9, 9, 4, 4, 0].map(|triangles| CurvePoint {
            threshold: 0.0,
            triangles,
            rms: 0.0,
        });
        let triangles: Vec<u64> = thinned(&cuts).iter().map(|point| point.triangles).collect();
        assert_eq!(triangles, [9, 4, 0]);
        assert!(thinned(&[]).is_empty());
    }
}
