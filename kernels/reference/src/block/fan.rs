//! The triangles around a vertex.

/// The triangles around a vertex: of each the next corner and the one before, counter-clockwise.
pub(super) type Fan = Vec<[usize; 2]>;

/// How the triangles around a vertex lie.
pub(super) enum Ends {
    /// One fan, closed.
    Closed,
    /// One fan from a first to a last triangle, by index.
    Open { first: usize, last: usize },
    /// None, or several fans.
    Other,
}

/// Follows a fan from triangle to triangle.
pub(super) fn fan_ends(fan: &Fan) -> Ends {
    let before_none = (0..fan.len()).rfind(|&i| !fan.iter().any(|t| t[1] == fan[i][0]));
    let first = before_none.unwrap_or(0);
    let mut at = first;
    for steps in 1..=fan.len() {
        let next = fan.iter().position(|t| t[0] == fan[at][1]);
        match next {
            Some(next) if next != first => at = next,
            _ if steps < fan.len() => return Ends::Other,
            Some(_) if before_none.is_none() => return Ends::Closed,
            None if before_none.is_some() => return Ends::Open { first, last: at },
            _ => return Ends::Other,
        }
    }
    Ends::Other
}
