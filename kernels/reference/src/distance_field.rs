//! Distances to the nearest inside sample: axis by axis, the minimum over all samples of each line.

/// Squares of distances to the samples that are `inside`, infinite if there is none; x fastest. `positions`: of the samples along x, y, z.
pub fn squares(positions: &[Vec<f64>; 3], inside: &[bool]) -> Vec<f64> {
    let mut squares: Vec<f64> = inside.iter().map(|&is| if is { 0.0 } else { f64::INFINITY }).collect();
    let mut stride = 1;
    for along in positions {
        let before = squares.clone();
        for (i, square) in squares.iter_mut().enumerate() {
            let own = i / stride % along.len();
            let first = i - own * stride;
            let through = |(k, at): (usize, &f64)| before[first + k * stride] + (at - along[own]).powi(2);
            *square = along.iter().enumerate().map(through).fold(f64::INFINITY, f64::min);
        }
        stride *= along.len();
    }
    squares
}
