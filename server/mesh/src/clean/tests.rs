use isopeel_volumes::Geometry;

use super::*;
use crate::caps::ToCaps;

/// A closed surface of 2·n² triangles over a square, one side of which is pushed through the other by `push`.
fn pillow(n: usize, push: f32) -> Mesh {
    let at = |i: usize, j: usize, top: bool| {
        let is_boundary = i == 0 || j == 0 || i == n || j == n;
        let side = match (is_boundary, top) {
            (true, _) => 0.0,
            (false, true) => 1.0,
            (false, false) => -1.0,
        };
        let z = if i == n / 2 && j == n / 2 && top {
            side - push
        } else {
            side
        };
        [i as f32, j as f32, z]
    };
    let mut mesh = Mesh::default();
    let mut boundary = std::collections::HashMap::new();
    for (top, i, j) in [true, false]
        .into_iter()
        .flat_map(|top| (0..n).flat_map(move |i| (0..n).map(move |j| (top, i, j))))
    {
        let mut vertex = |i: usize, j: usize| {
            let position = at(i, j, top);
            *boundary
                .entry((i, j, position[2] != 0.0, top && position[2] != 0.0))
                .or_insert_with(|| {
                    mesh.positions.push(position);
                    mesh.positions.len() as u32 - 1
                })
        };
        let [a, b, c, d] = [vertex(i, j), vertex(i + 1, j), vertex(i + 1, j + 1), vertex(i, j + 1)];
        // No triangle has all corners on the boundary, which both sides share.
        let pair = match (i == n - 1 && j == 0) || (i == 0 && j == n - 1) {
            true => [[a, b, d], [b, c, d]],
            false => [[a, b, c], [a, c, d]],
        };
        let pair = pair.map(|[a, b, c]| if top { [a, b, c] } else { [a, c, b] });
        mesh.triangles.extend(pair);
    }
    mesh
}

fn faces() -> Faces {
    Faces::new(&Geometry::of_index([2; 3]), &[], &[])
}

#[test]
fn sheets_that_cross_are_pulled_apart() {
    let mut mesh = pillow(9, 2.5);
    let before = count(&mesh, Format::Ply, None, &|| false).unwrap();
    assert!(before > 0);
    let triangles = mesh.triangles.clone();
    let Repaired { cleaned, .. } = repair(&mut mesh, Format::Ply, Scope::All, faces(), &|| false).unwrap();
    assert_eq!(cleaned.intersections, before);
    assert!(cleaned.moved_vertices > 0 && cleaned.largest_move > 0.0 && cleaned.largest_move < 4.0);
    assert_eq!(count(&mesh, Format::Ply, None, &|| false), Some(0));
    // Beside moved vertices, edges are flipped.
    let changed = mesh.triangles.iter().zip(&triangles).filter(|(new, old)| new != old);
    assert!(changed.count() as u64 <= 2 * cleaned.flipped_edges && cleaned.flipped_edges < 9);
    assert_eq!(mesh.triangles.len(), triangles.len());
}

#[test]
fn at_caps_vertices_stay_on_the_faces_and_others_are_left_alone() {
    // The vertex that is pushed through lies on a face across z, or nothing is near a cap.
    for (is_at_cap, left) in [(true, 0), (false, 1)] {
        let mut mesh = pillow(9, 2.5);
        let pushed = mesh.positions.iter().position(|at| at[2] == -1.5).unwrap();
        mesh.smallest_spacing = 1.0;
        mesh.caps = vec![ToCaps::of([3.0; 3], [7; 3], 1.0); mesh.positions.len()];
        if is_at_cap {
            mesh.caps[pushed] = ToCaps::of([3.0, 3.0, 1.0], [7; 3], 1.0);
        }
        let before = mesh.clone();
        let repaired = repair(&mut mesh, Format::Ply, Scope::AtCaps { cells: 1.0 }, faces(), &|| false).unwrap();
        assert_eq!(repaired.intersections > 0, left > 0, "{repaired:?}");
        assert_eq!(mesh.positions[pushed][2], -1.5);
        assert_eq!(mesh == before, left > 0);
    }
}

#[test]
fn a_clean_mesh_stays_as_it_is() {
    let mut mesh = pillow(9, 0.5);
    let before = mesh.clone();
    let repaired = repair(&mut mesh, Format::Stl, Scope::All, faces(), &|| false).unwrap();
    assert_eq!((repaired.cleaned, repaired.intersections), (Cleaned::default(), 0));
    assert_eq!(mesh, before);
}

#[test]
fn what_cannot_be_repaired_is_an_error() {
    // One triangle through another. Others hang on their corners, where several borders meet.
    let crossing = [
        [[0.0, 0.0, 0.0], [4.0, 0.0, 0.0], [0.0, 4.0, 0.0]],
        [[1.0, 1.0, -1.0], [1.0, 1.0, 1.0], [9.0, 9.0, 1.0]],
    ];
    let mut mesh = Mesh {
        positions: crossing.concat(),
        triangles: vec![[0, 1, 2], [3, 4, 5]],
        ..Mesh::default()
    };
    for corner in 0..6 {
        let at = |position: [f32; 3]| DVec3::from(position.map(f64::from));
        let centre = crossing[corner / 3].map(at).iter().sum::<DVec3>() / 3.0;
        let outside = at(mesh.positions[corner]).lerp(centre, -0.3);
        let across = [DVec3::Z, DVec3::new(1.0, -1.0, 0.0)][corner / 3] * 0.2;
        let next = mesh.positions.len() as u32;
        let added = [outside + across, outside - across].map(|at| at.to_array().map(|component| component as f32));
        mesh.positions.extend(added);
        mesh.triangles.push([corner as u32, next, next + 1]);
    }
    let error = repair(&mut mesh, Format::Ply, Scope::All, faces(), &|| false)
        .unwrap_err()
        .to_string();
    assert!(error.starts_with("1 pair of triangles still intersects"), "{error}");
    assert_eq!(count(&mesh, Format::Ply, Some(Duration::ZERO), &|| false), None);
}

#[test]
fn vertices_on_a_border_move_along_it() {
    // A flat strip, and a sheet whose border on the same face of the volume crosses it.
    let mut mesh = Mesh {
        positions: vec![
            [0.0, 0.0, 0.0],
            [4.0, 0.0, 0.0],
            [0.0, 0.0, 4.0],
            [4.0, 0.0, 4.0],
            [1.5, -0.2, 0.0],
            [2.0, 3.0, 0.0],
            [2.5, 3.0, 3.0],
        ],
        triangles: vec![[0, 1, 2], [1, 3, 2], [4, 5, 6]],
        ..Mesh::default()
    };
    let Repaired { cleaned, .. } = repair(&mut mesh, Format::Ply, Scope::All, faces(), &|| false).unwrap();
    assert!(cleaned.intersections > 0 && cleaned.moved_vertices > 0, "{cleaned:?}");
    assert_eq!(count(&mesh, Format::Ply, None, &|| false), Some(0));
    // Nothing has left the volume.
    assert!(
        mesh.positions.iter().all(|[_, _, z]| (0.0..=4.0).contains(z)),
        "{mesh:?}"
    );
}

/// A flat tetrahedron. The edge from 0 to 1 is nearly flat and the longer one, and the edge to which it would be flipped exists.
fn flat_tetrahedron() -> Mesh {
    Mesh {
        positions: vec![[-3.0, 0.0, 0.0], [3.0, 0.0, 0.0], [0.0, 1.0, -0.03], [0.0, -1.0, -0.03]],
        triangles: vec![[0, 1, 2], [1, 0, 3], [2, 1, 3], [0, 2, 3]],
        ..Mesh::default()
    }
}

#[test]
fn an_edge_that_cannot_be_flipped_is_made_sharp_or_delaunay() {
    let blocked = |mesh: &Mesh| {
        let positions = Numbers::new(mesh, Format::Ply).all(mesh);
        flat::flip_flat_edges(&positions, &mut mesh.triangles.clone()).blocked
    };
    let mut mesh = flat_tetrahedron();
    let triangles = mesh.triangles.clone();
    assert_eq!(blocked(&mesh), [[0, 1]]);
    let Repaired { cleaned, .. } = repair(&mut mesh, Format::Ply, Scope::All, faces(), &|| false).unwrap();
    assert!(cleaned.moved_vertices > 0 && cleaned.largest_move < 3.0, "{cleaned:?}");
    assert_eq!(blocked(&mesh), [[0; 2]; 0]);
    assert_eq!((mesh.triangles, cleaned.flipped_edges), (triangles, 0));
}

#[test]
fn flat_edges_are_flipped_where_all_is_repaired() {
    // Sheared, the squares of both sides have the longer diagonal as edge.
    let pushed = |mesh: &mut Mesh| mesh.positions.iter_mut().for_each(|at| at[0] += 0.4 * at[1]);
    let mut mesh = pillow(9, 0.0);
    pushed(&mut mesh);
    let before = mesh.clone();
    let caps = repair(&mut mesh, Format::Ply, Scope::AtCaps { cells: 1.0 }, faces(), &|| false);
    assert_eq!((caps.unwrap().cleaned, &mesh), (Cleaned::default(), &before));
    let Repaired { cleaned, .. } = repair(&mut mesh, Format::Ply, Scope::All, faces(), &|| false).unwrap();
    assert!(cleaned.flipped_edges > 90, "{cleaned:?}");
    assert_eq!(
        (cleaned.moved_vertices, mesh.triangles.len()),
        (0, before.triangles.len())
    );
    assert_eq!(mesh.positions, before.positions);
    assert_eq!(count(&mesh, Format::Ply, None, &|| false), Some(0));
}
