//! Contours of a plane of samples: the lines along which an isosurface crosses the plane.
//!
//! The rules are those of the meshers. A sample is inside if `value >= iso`. A contour crosses an edge at the linear interpolant. If only
//! two opposite corners of a face are inside, the contours separate them. A face that touches a missing sample has no contour.

use rustc_hash::{FxHashMap, FxHashSet};

/// A contour. The unit is the distance between samples; the origin is the plane's first sample.
#[derive(Clone, Debug, PartialEq)]
pub struct Contour {
    /// Points in order. A closed contour repeats its first point at the end.
    pub points: Vec<[f64; 2]>,
    /// Whether the contour is closed. An open contour ends at a border of the plane or at missing samples.
    pub is_closed: bool,
}

/// An edge between two neighbouring samples: `x` and `y` of the sample with the lower index, and the axis of the edge (0 or 1).
type Edge = (u32, u32, u8);

/// Corners of a face, in cyclic order.
const CORNERS: [[u32; 2]; 4] = [[0, 0], [1, 0], [1, 1], [0, 1]];

/// Returns the contours at `iso`. A contour has high values on its left if the second axis points up. `value` returns the sample at
/// (x, y), or `None` if that sample is missing.
pub fn contours([width, height]: [u32; 2], value: impl Fn(u32, u32) -> Option<f32>, iso: f32) -> Vec<Contour> {
    let mut next: FxHashMap<Edge, Edge> = FxHashMap::default();
    let mut has_previous: FxHashSet<Edge> = FxHashSet::default();
    let mut starts = Vec::new();
    for (x, y) in (0..height.saturating_sub(1)).flat_map(|y| (0..width.saturating_sub(1)).map(move |x| (x, y))) {
        let values = CORNERS.map(|[dx, dy]| value(x + dx, y + dy));
        let [Some(a), Some(b), Some(c), Some(d)] = values else {
            continue;
        };
        let inside = [a, b, c, d].map(|value| value >= iso);
        for (from, to) in segments(inside) {
            let [from, to] = [from, to].map(|side| edge(x, y, side));
            next.insert(from, to);
            has_previous.insert(to);
            starts.push(from);
        }
    }
    let point_on = |edge: &Edge| crossing(*edge, &value, iso);
    // Open contours are traced first, because only they must start at a certain edge: the one without a predecessor.
    let (open, closed): (Vec<Edge>, Vec<Edge>) = starts.into_iter().partition(|edge| !has_previous.contains(edge));
    let mut contours = Vec::new();
    for start in open.into_iter().chain(closed) {
        let mut edges = vec![start];
        while let Some(to) = next.remove(edges.last().unwrap_or(&start)) {
            edges.push(to);
        }
        if edges.len() > 1 {
            contours.push(Contour {
                points: edges.iter().map(point_on).collect(),
                is_closed: edges.first() == edges.last(),
            });
        }
    }
    contours
}

/// Returns the contour segments of a face, each as the side where it starts and the side where it ends. Side `i` is between the corners
/// `i` and `i + 1`.
///
/// A walk around the face enters the inside at some sides and leaves it at others. Each segment connects the side of an entry with the
/// next side of an exit, so it cuts off one run of inside corners.
fn segments(inside: [bool; 4]) -> Vec<(usize, usize)> {
    let mut segments = Vec::new();
    for entered in (0..4).filter(|&side| !inside[side] && inside[(side + 1) % 4]) {
        let exited = (1..4).map(|n| (entered + n) % 4).find(|&side| !inside[(side + 1) % 4]);
        if let Some(exited) = exited {
            // From exit to entry, the inside is on the left of the segment.
            segments.push((exited, entered));
        }
    }
    segments
}

/// Returns the edge at a side of the face whose first corner is the sample at (x, y).
fn edge(x: u32, y: u32, side: usize) -> Edge {
    match side {
        0 => (x, y, 0),
        1 => (x + 1, y, 1),
        2 => (x, y + 1, 0),
        _ => (x, y, 1),
    }
}

/// Returns the point at which the linear interpolant along an edge equals `iso`.
fn crossing((x, y, axis): Edge, value: &impl Fn(u32, u32) -> Option<f32>, iso: f32) -> [f64; 2] {
    let [dx, dy] = if axis == 0 { [1, 0] } else { [0, 1] };
    let [from, to] = [value(x, y), value(x + dx, y + dy)].map(|value| f64::from(value.unwrap_or(iso)));
    let fraction = if from == to {
        0.5
    } else {
        ((f64::from(iso) - from) / (to - from)).clamp(0.0, 1.0)
    };
    [
        f64::from(x) + fraction * f64::from(dx),
        f64::from(y) + fraction * f64::from(dy),
    ]
}

#[cfg(test)]
mod tests {
    use super::*;

    fn area(points: &[[f64; 2]]) -> f64 {
        points
            .windows(2)
            .map(|pair| (pair[0][0] * pair[1][1] - pair[1][0] * pair[0][1]) / 2.0)
            .sum()
    }

    #[test]
    fn a_circle_is_one_closed_contour_around_high_values() {
        let value = |x: u32, y: u32| {
            let [x, y] = [f64::from(x) - 15.3, f64::from(y) - 14.8];
            Some((10.0 - x.hypot(y)) as f32)
        };
        let found = contours([32, 30], value, 0.0);
        let [circle] = &found[..] else { panic!("{found:?}") };
        assert!(circle.is_closed && circle.points.first() == circle.points.last());
        assert!((area(&circle.points) / (std::f64::consts::PI * 100.0) - 1.0).abs() < 0.01);
        for [x, y] in &circle.points {
            assert!(((x - 15.3).hypot(y - 14.8) - 10.0).abs() < 0.02);
        }
    }

    #[test]
    fn contours_end_at_borders_and_missing_samples() {
        let plane = |x: u32, _: u32| Some(x as f32);
        let found = contours([4, 5], plane, 1.5);
        let [line] = &found[..] else { panic!("{found:?}") };
        assert!(!line.is_closed);
        assert_eq!(line.points.len(), 5);
        assert!(line.points.iter().all(|point| point[0] == 1.5));
        let with_hole = |x: u32, y: u32| (y != 2).then_some(x as f32);
        assert_eq!(contours([4, 5], with_hole, 1.5).len(), 2);
        assert_eq!(contours([4, 5], |_, _| Some(1.0), 1.5), []);
    }

    #[test]
    fn opposite_inside_corners_are_separated() {
        let saddle = |x: u32, y: u32| Some(if (x + y).is_multiple_of(2) { 1.0 } else { 0.0 });
        let found = contours([2, 2], saddle, 0.5);
        assert_eq!(found.len(), 2);
        for contour in &found {
            let [[ax, ay], [bx, by]] = contour.points[..] else {
                panic!("{contour:?}")
            };
            let near_corner = |x: f64, y: f64| (x - 0.5).abs() == 0.5 && (y - 0.5).abs() == 0.5;
            assert!(
                near_corner(ax + bx - 0.5, ay + by - 0.5),
                "{contour:?} cuts a corner off"
            );
            // It is around the corner at 0, 0 or that at 1, 1, which are inside.
            assert!(ax + bx + ay + by == 1.0 || ax + bx + ay + by == 3.0);
        }
        // A checkerboard: no contour passes between two samples that are inside, and each point is of one.
        let board = contours([6, 6], saddle, 0.5);
        assert_eq!(board.iter().filter(|contour| contour.is_closed).count(), 8);
    }
}
