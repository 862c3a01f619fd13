//! Distances of points to a surface: its triangles in the cells of a grid, searched outwards from a point. By hand,
//! because this is the only such query: a geometry library would replace the grid alone. On rayon's pool.

use rayon::prelude::*;

use crate::math::{DVec3, triangle_normal};

/// Squared distance of a point to a triangle: to its plane where the projection lies inside, else to its nearest edge.
fn triangle_distance2(p: DVec3, [a, b, c]: [DVec3; 3]) -> f64 {
    let n = triangle_normal([a, b, c]);
    let length2 = n.length_squared();
    let inside = |a: DVec3, b: DVec3| triangle_normal([a, b, p]).dot(n) >= 0.0;
    if length2 > 0.0 && inside(a, b) && inside(b, c) && inside(c, a) {
        let d = n.dot(p - a);
        return d * d / length2;
    }
    let edge = |a: DVec3, b: DVec3| {
        let (along, to) = (b - a, p - a);
        let whole = along.length_squared();
        let t = if whole > 0.0 {
            (to.dot(along) / whole).clamp(0.0, 1.0)
        } else {
            0.0
        };
        (to - t * along).length_squared()
    };
    edge(a, b).min(edge(b, c)).min(edge(c, a))
}

/// Triangles by the cells of a grid that their bounding boxes touch.
pub(super) struct Triangles<'a> {
    positions: &'a [DVec3],
    triangles: &'a [[u32; 3]],
    low: DVec3,
    cell: f64,
    cells: [usize; 3],
    /// Where each cell's triangles begin in `list`.
    starts: Vec<u32>,
    list: Vec<u32>,
}

impl<'a> Triangles<'a> {
    /// With four cells a triangle, most of which are empty.
    pub(super) fn new(positions: &'a [DVec3], triangles: &'a [[u32; 3]]) -> Self {
        let corners = || triangles.iter().flatten().map(|&v| positions[v as usize]);
        let low = corners().fold(DVec3::INFINITY, DVec3::min);
        let high = corners().fold(DVec3::NEG_INFINITY, DVec3::max);
        let size = (high - low).max(DVec3::splat(f64::MIN_POSITIVE));
        // A flat surface has no volume to divide.
        let volume = size.max(DVec3::splat(size.max_element() / 64.0)).element_product();
        let cell = (volume / (4 * triangles.len().max(1)) as f64)
            .cbrt()
            .max(f64::MIN_POSITIVE);
        let mut grid = Self {
            positions,
            triangles,
            low,
            cell,
            cells: size.to_array().map(|s| (s / cell) as usize + 1),
            starts: Vec::new(),
            list: Vec::new(),
        };
        // Counting sort: the number in each cell, then where each cell ends, then filled from there backwards.
        grid.starts = vec![0; grid.cells.iter().product::<usize>() + 1];
        for t in 0..triangles.len() as u32 {
            grid.touched(t, |grid, at| grid.starts[at] += 1);
        }
        let mut end = 0;
        for start in &mut grid.starts {
            end += *start;
            *start = end;
        }
        grid.list = vec![0; end as usize];
        for t in 0..triangles.len() as u32 {
            grid.touched(t, |grid, at| {
                grid.starts[at] -= 1;
                grid.list[grid.starts[at] as usize] = t;
            });
        }
        grid
    }

    fn cell_of(&self, p: DVec3) -> [usize; 3] {
        [0, 1, 2].map(|i| (((p[i] - self.low[i]) / self.cell) as usize).min(self.cells[i] - 1))
    }

    fn touched(&mut self, triangle: u32, mut with: impl FnMut(&mut Self, usize)) {
        let [a, b, c] = self.corners(triangle).map(|p| self.cell_of(p));
        let low = [0, 1, 2].map(|i| a[i].min(b[i]).min(c[i]));
        let high = [0, 1, 2].map(|i| a[i].max(b[i]).max(c[i]));
        for z in low[2]..=high[2] {
            for y in low[1]..=high[1] {
                for x in low[0]..=high[0] {
                    with(self, (z * self.cells[1] + y) * self.cells[0] + x);
                }
            }
        }
    }

    fn corners(&self, triangle: u32) -> [DVec3; 3] {
        self.triangles[triangle as usize].map(|v| self.positions[v as usize])
    }

    /// Distance of each point to the nearest triangle; infinite where there is none.
    pub(super) fn distances(&self, points: &[DVec3]) -> Vec<f64> {
        points
            .par_iter()
            .with_min_len(1024)
            .map(|&p| self.distance(p))
            .collect()
    }

    fn distance(&self, p: DVec3) -> f64 {
        let mut best = f64::INFINITY;
        if self.list.is_empty() {
            return best;
        }
        let at = self.cell_of(p);
        let max_radius = self.cells.into_iter().max().unwrap_or(0);
        for radius in 0..=max_radius {
            let low = at.map(|c| c.saturating_sub(radius));
            let high = [0, 1, 2].map(|i| (at[i] + radius).min(self.cells[i] - 1));
            for z in low[2]..=high[2] {
                for y in low[1]..=high[1] {
                    let on_surface = z.abs_diff(at[2]) == radius || y.abs_diff(at[1]) == radius;
                    let mut x = low[0];
                    while x <= high[0] {
                        if on_surface || x.abs_diff(at[0]) == radius {
                            let cell = (z * self.cells[1] + y) * self.cells[0] + x;
                            for &t in &self.list[self.starts[cell] as usize..self.starts[cell + 1] as usize] {
                                best = best.min(triangle_distance2(p, self.corners(t)));
                            }
                        }
                        // The inside of the box was searched before: on to the opposite face.
                        x = if on_surface || x >= at[0] + radius {
                            x + 1
                        } else {
                            (at[0] + radius).max(x + 1)
                        };
                    }
                }
            }
            // Triangles not yet seen are beyond a face of this box, where the grid goes on.
            let beyond = (0..3).flat_map(|i| {
                let face = |at: usize| p[i] - (self.low[i] + at as f64 * self.cell);
                let below = if low[i] > 0 { face(low[i]) } else { f64::INFINITY };
                let above = if high[i] + 1 < self.cells[i] {
                    -face(high[i] + 1)
                } else {
                    f64::INFINITY
                };
                [below, above]
            });
            if best.sqrt() <= beyond.fold(f64::INFINITY, f64::min) {
                break;
            }
        }
        best.sqrt()
    }
}
