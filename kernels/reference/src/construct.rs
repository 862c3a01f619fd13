//! The pyramid: active cells with their moments, and the nodes of levels 0 to 5 above them.

use std::collections::{BTreeMap, BTreeSet};

use crate::{Field, boxes, classify, derive, offset};
use isopeel_kernels::tables::{cases, cube};
use isopeel_kernels::{DerivedFeature, VectorFeature};

/// The feature that importance blends with smoothness.
#[derive(Clone, Copy)]
pub enum Feature<'a> {
    /// Nothing: `f` is zero.
    None,
    /// Another field on the same grid.
    Field(&'a Field),
    /// A feature that is computed from the field itself.
    Derived(DerivedFeature),
    /// A feature that is computed from the three components of a vector field.
    Vector(VectorFeature, [&'a Field; 3]),
}

/// An active cell (docs/algorithm.md#2-per-cell-quantities).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Cell {
    /// Corner signs.
    pub signs: u8,
    /// Triangles of its case.
    pub n: u32,
    /// Unit gradient at its centre in world units, or zero.
    pub g: [f32; 3],
    /// User feature: mean of the corners that are not missing, 0 when all are.
    pub f: f32,
}

/// A cube with active cells below it, or (level 0) an active cell (docs/algorithm.md#3-pyramid).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Node {
    /// Triangles of the undecimated surface below, `N`.
    pub count: u32,
    /// Smoothness feature, eq. 1. At level 0 that of the level-1 node above: for a single cell the equation always gives 0, so
    /// level 1 is the finest level at which it is meaningful.
    pub s: f32,
    /// User feature, eq. 2, not yet normalised.
    pub f: f32,
    /// Signs of the corners, clamped at the volume's last sample.
    pub signs: u8,
    /// Whether any of its cells touches a missing sample: such a cube is never decimated.
    pub missing: bool,
}

/// The pyramid, which depends on isovalue and feature alone.
#[derive(Clone, Debug)]
pub struct Pyramid {
    /// Samples of the volume along x, y, z.
    pub dims: [u32; 3],
    /// Active cells.
    pub cells: BTreeMap<[u32; 3], Cell>,
    /// Nodes of each level by cube coordinates; level 0 has the keys of `cells`.
    pub nodes: [BTreeMap<[u32; 3], Node>; 6],
}

impl Pyramid {
    /// Triangles of the undecimated surface.
    pub fn full_triangles(&self) -> u64 {
        self.cells.values().map(|c| u64::from(c.n)).sum()
    }
}

/// Sums over the active cells below a cube.
#[derive(Clone, Copy, Default)]
struct Moments {
    n: u32,
    g: [f32; 3],
    q: f32,
    f: f32,
}

impl Moments {
    fn of_cell(cell: &Cell) -> Self {
        let n = cell.n as f32;
        Self {
            n: cell.n,
            g: cell.g.map(|g| n * g),
            q: n * dot(cell.g, cell.g),
            f: n * cell.f,
        }
    }

    fn add(&mut self, other: &Self) {
        self.n += other.n;
        (0..3).for_each(|i| self.g[i] += other.g[i]);
        self.q += other.q;
        self.f += other.f;
    }

    /// `1 − 1/(1 + v)` as `v/(1 + v)`, which keeps its digits if the variance `v` is small.
    fn smoothness(&self) -> f32 {
        let n = self.n as f32;
        let mean = self.g.map(|g| g / n);
        let v = (self.q / n - dot(mean, mean)).max(0.0);
        v / (1.0 + v)
    }
}

fn dot(a: [f32; 3], b: [f32; 3]) -> f32 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

/// Scales to length 1; a zero vector and one that is not finite become zero. Scaled by the largest component first, so that
/// squares of huge or tiny values stay in range.
pub fn normalised(v: [f32; 3]) -> [f32; 3] {
    let largest = v.iter().fold(0.0f32, |m, x| m.max(x.abs()));
    if largest == 0.0 || v.iter().any(|x| !x.is_finite()) {
        return [0.0; 3];
    }
    let v = v.map(|x| x / largest);
    let length = dot(v, v).sqrt();
    v.map(|x| x / length)
}

/// Unit gradient of the trilinear interpolant at a cell's centre; if a corner is infinite, that of the signs alone.
fn centre_gradient(mut corners: [f32; 8], iso: f32, spacing: [f32; 3]) -> [f32; 3] {
    if corners.iter().any(|v| v.is_infinite()) {
        corners = corners.map(|v| if v >= iso { 1.0 } else { -1.0 });
    }
    normalised(std::array::from_fn(|axis| {
        let side = |high: usize| {
            (0..8)
                .filter(|b| b >> axis & 1 == high)
                .map(|b| corners[b])
                .sum::<f32>()
        };
        (side(1) - side(0)) * (0.25 / spacing[axis])
    }))
}

/// Mean of the corners that are not missing.
fn centre_feature(corners: [f32; 8]) -> f32 {
    let known = corners.iter().filter(|v| !v.is_nan());
    let count = known.clone().count();
    if count == 0 {
        0.0
    } else {
        known.sum::<f32>() / count as f32
    }
}

/// For each cube of the next coarser level, x fastest, whether one of its up to eight children is marked.
fn coarsen(marked: &[bool], extent: [u32; 3]) -> (Vec<bool>, [u32; 3]) {
    let coarse = extent.map(|n| n.div_ceil(2));
    let index = |[x, y, z]: [u32; 3], [nx, ny, _]: [u32; 3]| ((z * ny + y) * nx + x) as usize;
    let mut result = vec![false; coarse.iter().product::<u32>() as usize];
    for p in boxes([0; 3], extent) {
        result[index(p.map(|c| c / 2), coarse)] |= marked[index(p, extent)];
    }
    (result, coarse)
}

/// Active cells with their moments, and which cells touch a missing sample.
fn cells(field: &Field, feature: Option<&Field>, iso: f32) -> (BTreeMap<[u32; 3], Cell>, Vec<bool>) {
    let table = cases::case_triangles();
    let classes = classify::classify(field, iso);
    let cell = |at: [u32; 3], signs: u8| Cell {
        signs,
        n: u32::from(table[usize::from(signs)][0]),
        g: centre_gradient(field.cell_corners(at), iso, field.grid.spacing),
        f: feature.map_or(0.0, |f| centre_feature(f.cell_corners(at))),
    };
    let cells = classes.active.iter().map(|(&at, &signs)| (at, cell(at, signs)));
    (cells.collect(), classes.missing)
}

/// Corner signs of a cube.
fn cube_signs(field: &Field, iso: f32, level: usize, cube: [u32; 3]) -> u8 {
    let samples = field.cube_samples(level, cube);
    let corner = |b| {
        let up = cube::corner_offset(b);
        field.at(std::array::from_fn(|i| samples[up[i]][i]))
    };
    classify::signs(std::array::from_fn(corner), iso)
}

/// Builds the whole pyramid.
pub fn construct(field: &Field, feature: Feature<'_>, iso: f32) -> Pyramid {
    let derived;
    let feature = match feature {
        Feature::None => None,
        Feature::Field(other) => Some(other),
        Feature::Derived(feature) => {
            derived = derive::derived(field, feature);
            Some(&derived)
        }
        Feature::Vector(feature, components) => {
            derived = derive::of_vector(components, feature);
            Some(&derived)
        }
    };
    let (cells, missing) = cells(field, feature, iso);
    let mut nodes: [BTreeMap<[u32; 3], Node>; 6] = Default::default();
    let mut sums: BTreeMap<_, _> = cells.iter().map(|(&at, cell)| (at, Moments::of_cell(cell))).collect();
    let mut missing = (missing, field.grid.cells());
    for (level, nodes) in nodes.iter_mut().enumerate().skip(1) {
        missing = coarsen(&missing.0, missing.1);
        let [nx, ny, _] = missing.1;
        let cubes: BTreeSet<_> = sums.keys().map(|c: &[u32; 3]| c.map(|x| x / 2)).collect();
        let mut coarse = BTreeMap::new();
        for cube in cubes {
            let mut sum = Moments::default();
            for child in 0..8 {
                let at = offset(cube.map(|c| 2 * c), cube::corner_offset(child).map(|d| d as u32));
                if let Some(part) = sums.get(&at) {
                    sum.add(part);
                }
            }
            let node = Node {
                count: sum.n,
                s: sum.smoothness(),
                f: sum.f / sum.n as f32,
                signs: cube_signs(field, iso, level, cube),
                missing: missing.0[((cube[2] * ny + cube[1]) * nx + cube[0]) as usize],
            };
            nodes.insert(cube, node);
            coarse.insert(cube, sum);
        }
        sums = coarse;
    }
    for (&at, cell) in &cells {
        let node = Node {
            count: cell.n,
            s: nodes[1][&at.map(|c| c / 2)].s,
            f: cell.f,
            signs: cell.signs,
            missing: false,
        };
        nodes[0].insert(at, node);
    }
    Pyramid {
        dims: field.grid.dims,
        cells,
        nodes,
    }
}
