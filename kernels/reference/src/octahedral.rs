//! Unit vectors as two numbers: the octahedron |x| + |y| + |z| = 1 unfolded onto a square, the lower half outwards.

/// Octahedral coordinates of a unit vector, each in [-1, 1].
pub fn encode([x, y, z]: [f32; 3]) -> [f32; 2] {
    let sum = x.abs() + y.abs() + z.abs();
    let (x, y) = (x / sum, y / sum);
    if z >= 0.0 {
        [x, y]
    } else {
        [(1.0 - y.abs()).copysign(x), (1.0 - x.abs()).copysign(y)]
    }
}

/// The unit vector of octahedral coordinates, each in [-1, 1].
pub fn decode([x, y]: [f32; 2]) -> [f32; 3] {
    let z = 1.0 - x.abs() - y.abs();
    let folded = if z >= 0.0 {
        [x, y]
    } else {
        [(1.0 - y.abs()).copysign(x), (1.0 - x.abs()).copysign(y)]
    };
    crate::construct::normalised([folded[0], folded[1], z])
}
