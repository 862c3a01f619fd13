//! Vertices that are locked so that small parts of a surface do not vanish.

use crate::math::DVec3;

/// Four vertices of every connected part that span it. The quadric error of a collapse is the distance to the planes around it,
/// which for a part of a few triangles stays small until nothing of it is left. With these four locked, a tetrahedron remains.
pub(super) fn spanning_vertices(positions: &[[f32; 3]], indices: &[u32]) -> Vec<u32> {
    let mut root: Vec<u32> = (0..positions.len() as u32).collect();
    let find = |root: &mut [u32], mut v: u32| {
        while root[v as usize] != v {
            root[v as usize] = root[root[v as usize] as usize];
            v = root[v as usize];
        }
        v
    };
    for t in indices.chunks_exact(3) {
        for (a, b) in [(t[0], t[1]), (t[1], t[2])] {
            let (a, b) = (find(&mut root, a), find(&mut root, b));
            root[a.max(b) as usize] = a.min(b);
        }
    }
    for v in 0..root.len() as u32 {
        root[v as usize] = find(&mut root, v);
    }
    let at = |v: u32| DVec3::from(positions[v as usize].map(f64::from));
    let from = |v: u32, to: u32| at(to) - at(v);
    // Of every part the vertex that is furthest from those chosen so far: from a point, a line, a plane.
    let furthest = |distance: &dyn Fn(u32, u32) -> f64| {
        let mut best: Vec<(f64, u32)> = (0..root.len() as u32).map(|v| (0.0, v)).collect();
        for (v, &part) in (0u32..).zip(&root) {
            let distance = distance(part, v);
            if distance > best[part as usize].0 {
                best[part as usize] = (distance, v);
            }
        }
        best.into_iter().map(|(_, v)| v).collect::<Vec<u32>>()
    };
    let first = furthest(&|part, v| from(part, v).length_squared());
    let second = furthest(&|part, v| from(first[part as usize], v).length_squared());
    let line = |part: u32| from(first[part as usize], second[part as usize]);
    let third = furthest(&|part, v| line(part).cross(from(first[part as usize], v)).length_squared());
    let plane = |part: u32| line(part).cross(from(first[part as usize], third[part as usize]));
    let fourth = furthest(&|part, v| plane(part).dot(from(first[part as usize], v)).abs());
    let is_part = |part: &usize| root[*part] == *part as u32;
    (0..root.len())
        .filter(is_part)
        .flat_map(|part| [first[part], second[part], third[part], fourth[part]])
        .collect()
}
