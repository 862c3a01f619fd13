//! The boundary of the covered part of a mesh: directed edges that are linked to loops. The links are hints for the coding. On a mesh that
//! is not a manifold they may be wrong. Wrong links cost bits, but the result is correct, because encoder and decoder have the same links.

/// Number of an edge.
pub(super) type EdgeId = usize;

/// A directed edge between a covered triangle and the uncovered triangle on its other side ("behind" it). It has the direction that it has
/// in the uncovered triangle.
#[derive(Clone, Copy, Debug)]
pub(super) struct Edge {
    pub from: u32,
    pub to: u32,
    /// The third vertex of the covered triangle at the edge.
    pub opposite: u32,
    /// Level of the covered triangle at the edge.
    pub level: u8,
    previous: EdgeId,
    next: EdgeId,
    /// Whether the edge is still part of the boundary.
    is_open: bool,
    /// Whether there is no triangle behind the edge.
    pub is_border: bool,
}

/// Position of the third vertex of a triangle behind an edge.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Third {
    /// A vertex that was not used yet.
    New,
    /// The end of the next edge of the loop.
    Right,
    /// The start of the previous edge of the loop.
    Left,
    /// Any other vertex that was used.
    Other,
}

/// The boundary, with the edges that are no longer part of it.
#[derive(Default)]
pub(super) struct Boundary {
    edges: Vec<Edge>,
    /// For each vertex, the edge that was last recorded to end at the vertex. The edge may be closed by now.
    ending: Vec<Option<EdgeId>>,
}

impl Boundary {
    pub fn edge(&self, id: EdgeId) -> Edge {
        self.edges[id]
    }

    pub fn is_open(&self, id: EdgeId) -> bool {
        self.edges[id].is_open
    }

    pub fn previous(&self, id: EdgeId) -> Edge {
        self.edges[self.edges[id].previous]
    }

    pub fn next(&self, id: EdgeId) -> Edge {
        self.edges[self.edges[id].next]
    }

    pub fn set_border(&mut self, id: EdgeId) {
        self.edges[id].is_border = true;
    }

    /// Returns for each vertex whether it is on the boundary, that is, whether one of its edges is open.
    pub fn boundary_vertices(&self) -> Vec<bool> {
        let mut is_on_boundary = vec![false; self.ending.len()];
        for edge in self.edges.iter().filter(|edge| edge.is_open) {
            is_on_boundary[edge.from as usize] = true;
            is_on_boundary[edge.to as usize] = true;
        }
        is_on_boundary
    }

    /// Adds a vertex.
    pub fn add_vertex(&mut self) {
        self.ending.push(None);
    }

    /// Adds the loop around a first triangle. Returns the edges of the loop: those opposite to the corners b, a and c.
    pub fn start(&mut self, [a, b, c]: [u32; 3], level: u8) -> [EdgeId; 3] {
        let first = self.edges.len();
        let ids = [first, first + 1, first + 2];
        for (number, (from, to, opposite)) in [(a, c, b), (c, b, a), (b, a, c)].into_iter().enumerate() {
            self.edges.push(Edge {
                from,
                to,
                opposite,
                level,
                previous: ids[(number + 2) % 3],
                next: ids[(number + 1) % 3],
                is_open: true,
                is_border: false,
            });
            self.ending[to as usize] = Some(ids[number]);
        }
        ids
    }

    /// Covers the triangle behind an edge. `c`: third vertex of the triangle. Returns the triangle's other edges: first the one at the
    /// start of the given edge, then the one at its end.
    pub fn cover(&mut self, id: EdgeId, c: u32, third: Third, level: u8) -> [EdgeId; 2] {
        let Edge {
            from: a,
            to: b,
            previous,
            next,
            ..
        } = self.edges[id];
        // Whether the triangle also has the previous edge of the loop as a side.
        let closes_left = self.edges[previous].from == c;
        let incoming =
            self.ending[c as usize].filter(|&other| other != id && self.is_open(other) && self.edges[other].to == c);
        let [left, right] = self.replace(id, [a, b, c], level);
        match third {
            Third::Other => {
                if let Some(incoming) = incoming {
                    self.relink(incoming, left, right);
                }
            }
            Third::Right => self.close(right, next, c, left),
            Third::New | Third::Left => {}
        }
        if third == Third::Left || third == Third::Right && closes_left {
            let previous = self.edges[left].previous;
            let before = self.edges[previous].previous;
            self.close(previous, left, c, before);
        }
        [left, right]
    }

    /// Replaces an edge with the two other edges of a triangle.
    fn replace(&mut self, id: EdgeId, [a, b, c]: [u32; 3], level: u8) -> [EdgeId; 2] {
        let Edge { previous, next, .. } = self.edges[id];
        let left = self.edges.len();
        let right = left + 1;
        let edge = |from, to, opposite, previous, next| Edge {
            from,
            to,
            opposite,
            level,
            previous,
            next,
            is_open: true,
            is_border: false,
        };
        self.edges.push(edge(a, c, b, previous, right));
        self.edges.push(edge(c, b, a, left, next));
        self.edges[id].is_open = false;
        self.edges[previous].next = left;
        self.edges[next].previous = right;
        (self.ending[b as usize], self.ending[c as usize]) = (Some(right), Some(left));
        [left, right]
    }

    /// Relinks the edges at the vertex at which `incoming` ends. If the loop touches itself there, it becomes two loops; if it touches
    /// another loop, the two become one.
    fn relink(&mut self, incoming: EdgeId, left: EdgeId, right: EdgeId) {
        let after = self.edges[incoming].next;
        self.edges[left].next = after;
        self.edges[after].previous = left;
        self.edges[incoming].next = right;
        self.edges[right].previous = incoming;
    }

    /// Removes two consecutive edges that connect the same two vertices in both directions. Records `ending` as the edge that ends at `c`.
    fn close(&mut self, first: EdgeId, second: EdgeId, c: u32, ending: EdgeId) {
        let (before, after) = (self.edges[first].previous, self.edges[second].next);
        (self.edges[first].is_open, self.edges[second].is_open) = (false, false);
        self.edges[before].next = after;
        self.edges[after].previous = before;
        self.ending[c as usize] = Some(ending);
    }
}
