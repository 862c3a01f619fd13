//! Edges of triangles: tests from its triangles alone whether a surface is closed.

/// A directed edge, by its ends' positions on a lattice.
pub type Edge = [[i64; 3]; 2];

/// Returns the edges that have different numbers of triangles in their two directions, each once, its lower end first.
///
/// `edges`: those of all triangles, three per triangle in its order; ends at the same position are the same. Edges of length 0
/// are left out, as they do not change whether the surface is closed.
pub fn open(mut edges: Vec<Edge>) -> Vec<Edge> {
    let undirected = |&[p, q]: &Edge| if p < q { [p, q] } else { [q, p] };
    edges.retain(|[p, q]| p != q);
    edges.sort_unstable_by_key(undirected);
    let alike = edges.chunk_by(|a, b| undirected(a) == undirected(b));
    alike
        .filter(|edges| edges.iter().filter(|[p, q]| p < q).count() * 2 != edges.len())
        .map(|edges| undirected(&edges[0]))
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn edges(triangles: &[[usize; 3]]) -> Vec<Edge> {
        let place = [[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]];
        let of = |&[a, b, c]: &[usize; 3]| [[a, b], [b, c], [c, a]];
        triangles
            .iter()
            .flat_map(of)
            .map(|edge| edge.map(|i| place[i]))
            .collect()
    }

    #[test]
    fn a_closed_surface_has_none() {
        assert_eq!(
            open(edges(&[[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])),
            Vec::<Edge>::new()
        );
    }

    #[test]
    fn a_hole_has_its_edges_and_a_turned_triangle_too() {
        let hole = vec![[[0, 0, 1], [0, 1, 0]], [[0, 0, 1], [1, 0, 0]], [[0, 1, 0], [1, 0, 0]]];
        assert_eq!(open(edges(&[[0, 2, 1], [0, 1, 3], [0, 3, 2]])), hole);
        assert_eq!(open(edges(&[[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 3, 2]])), hole);
    }

    #[test]
    fn a_triangle_that_shrank_to_a_line_opens_nothing() {
        assert_eq!(open(edges(&[[0, 1, 1]])), Vec::<Edge>::new());
    }
}
