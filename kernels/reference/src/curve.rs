//! Estimated error of a cut of the vertex tree as a function of its tolerance.

use crate::tree_cut::{Cutter, OfNodes};

/// Sum of the squared errors of a cut's nodes, weighted by area and divided by the squared smallest spacing.
pub fn squared_error(cutter: &Cutter<'_>, keys: &OfNodes, tolerance: f32) -> f64 {
    let mut sum = 0.0;
    for (id, block) in &cutter.tree.blocks {
        for (node, &key) in block.nodes.iter().zip(&keys[id]) {
            let is_topmost = node
                .parent
                .is_none_or(|parent| keys[&parent.block][parent.index] > tolerance);
            if key <= tolerance && is_topmost {
                sum += f64::from(node.error).powi(2);
            }
        }
    }
    sum
}
