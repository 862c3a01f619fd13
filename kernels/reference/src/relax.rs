//! Relaxation: one Jacobi step that moves vertices of cells by half of the weighted mean offset from the polygons between them to
//! the crossings in the polygons' middle (docs/algorithm.md#64-vertex-relaxation).

use crate::quadric::{Vector, dot, unit};
use crate::vertices::{DualVertex, DualVertices, MARGIN};
use crate::{Field, Leaf, trilinear};
use isopeel_kernels::BRICK_CELLS;
use isopeel_kernels::tables::cube;

/// Part of the mean offset by which a vertex is moved.
const RELAXATION: f64 = 0.5;

/// Weight of an offset of 0; that of others is as many cells more as they are long.
const OFFSET_WEIGHT: f64 = 0.1;

/// Parts of a cell in which the device sums offsets.
const OFFSET_LATTICE: f64 = 2048.0;

/// The four vertices around an edge inside a brick and the crossing on the edge, world units. `None`: the edge lies on the
/// side of its brick, or samples are missing.
struct EdgePolygon {
    corners: [Vector; 4],
    crossing: Vector,
    /// How far the corners may be off.
    uncertainty: f64,
}

impl EdgePolygon {
    fn around(field: &Field, iso: f32, vertices: &DualVertices, cell: [u32; 3], edge: usize) -> Option<Self> {
        let (spacing, axis) = (field.grid.spacing.map(f64::from), cube::edge_axis(edge));
        let (b, c) = ((axis + 1) % 3, (axis + 2) % 3);
        let mut low = cell;
        low[b] += edge as u32 & 1;
        low[c] += edge as u32 >> 1 & 1;
        let brick = low.map(|x| x / BRICK_CELLS);
        let is_on_side = low[b].is_multiple_of(BRICK_CELLS) || low[c].is_multiple_of(BRICK_CELLS);
        if brick != cell.map(|x| x / BRICK_CELLS) || is_on_side {
            return None;
        }
        let (mut corners, mut uncertainty) = ([[0.0; 3]; 4], 0.0f64);
        for (k, corner) in corners.iter_mut().enumerate() {
            let mut of = low;
            of[b] -= k as u32 & 1;
            of[c] -= k as u32 >> 1;
            let sheet = vertices.sheets.get(&of)?.of_edge[4 * axis + k];
            let vertex = &vertices.vertices[&(Leaf { level: 0, cube: of }, sheet)];
            *corner = std::array::from_fn(|i| vertex.position[i] * spacing[i]);
            uncertainty = uncertainty.max(vertex.uncertainty);
        }
        let at = trilinear::crossing(trilinear::corners(field, low), iso, 4 * axis);
        Some(Self {
            corners,
            crossing: std::array::from_fn(|i| (f64::from(low[i]) + at[i]) * spacing[i]),
            uncertainty,
        })
    }

    /// From the polygon's plane through its centroid to the crossing, along the polygon's normal.
    fn offset(&self) -> Vector {
        let between =
            |from: usize, to: usize| -> Vector { std::array::from_fn(|i| self.corners[to][i] - self.corners[from][i]) };
        let ([ax, ay, az], [bx, by, bz]) = (between(0, 3), between(1, 2));
        let normal = unit([ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx]);
        let from_centroid =
            std::array::from_fn(|i| self.crossing[i] - self.corners.iter().map(|x| x[i]).sum::<f64>() / 4.0);
        let height = dot(normal, from_centroid);
        normal.map(|n| n * height)
    }
}

/// Moves the vertices of cells with one sheet, all from the same positions.
pub(crate) fn relax(field: &Field, iso: f32, vertices: &mut DualVertices) {
    let moved: Vec<_> = vertices
        .sheets
        .iter()
        .filter(|(_, sheets)| sheets.count == 1)
        .map(|(&cell, sheets)| {
            let crossed: Vec<usize> = (0..12).filter(|&e| sheets.of_edge[e] == 0).collect();
            (cell, relaxed(field, iso, vertices, cell, &crossed))
        })
        .collect();
    for (cube, vertex) in moved {
        vertices.vertices.insert((Leaf { level: 0, cube }, 0), vertex);
    }
}

/// The vertex of a cell after the step.
fn relaxed(field: &Field, iso: f32, vertices: &DualVertices, cell: [u32; 3], crossed: &[usize]) -> DualVertex {
    let spacing = field.grid.spacing.map(f64::from);
    // Crossings without a polygon count as offsets of 0.
    let (mut sum, mut weights, mut uncertainty) = ([0.0; 3], OFFSET_WEIGHT * crossed.len() as f64, 0.0f64);
    for &edge in crossed {
        if let Some(polygon) = EdgePolygon::around(field, iso, vertices, cell, edge) {
            let world = polygon.offset();
            let offset: Vector = std::array::from_fn(|i| world[i] / spacing[i]);
            let length = dot(offset, offset).sqrt();
            let limited = length.min(1.0);
            (0..3).for_each(|i| sum[i] += (OFFSET_WEIGHT + limited) * offset[i] / length.max(1.0));
            weights += limited;
            uncertainty = uncertainty.max(polygon.uncertainty);
        }
    }
    let mut vertex = vertices.vertices[&(Leaf { level: 0, cube: cell }, 0)];
    vertex.position = std::array::from_fn(|i| {
        let step = RELAXATION * sum[i] / weights;
        let low = f64::from(cell[i]);
        (vertex.position[i] + step).clamp(low + MARGIN, low + 1.0 - MARGIN)
    });
    // The device rounds what it adds up to the offset lattice.
    let rounded = crossed.len() as f64 * 0.5 / OFFSET_LATTICE;
    vertex.uncertainty += 2.0 * uncertainty + 2.0 * RELAXATION * rounded / weights;
    vertex
}
