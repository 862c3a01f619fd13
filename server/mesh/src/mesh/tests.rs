use isopeel_extraction::JoinError;
use isopeel_geometry::{DVec3, triangle_normal};
use isopeel_kernels::{Level, Region, SurfaceStatistics, Vertex};
use isopeel_view::PointJson;

use super::*;

/// Identity placement of a grid that is large enough for three regions along x.
pub fn geometry() -> Geometry {
    Geometry::of_index([97, 33, 33])
}

/// A vertex at `cells` from its region's low corner, normal along +z (octahedral 0, 0).
pub fn vertex(cells: [f64; 3]) -> Vertex {
    Vertex {
        position: cells.map(|c| (c * f64::from(Vertex::LATTICE)) as i32),
        normal: [0, 0],
        smoothness: 0,
        feature: 65535,
    }
}

pub fn surface(regions: Vec<Region>) -> Surface {
    Surface {
        remade: None,
        regions,
        prefix: Level::FINEST,
        statistics: SurfaceStatistics::default(),
    }
}

/// Two regions with a quad each: they share the two vertices of the edge at x = 32. The first quad has a
/// triangle of level 0 and one of level 2, the second two of level 0.
pub fn two_quads() -> Surface {
    let quad = |a: u32, x: [f64; 2], level_triangles| Region {
        coords: [a, 0, 0],
        size: 0,
        vertices: [[x[0], 1.0], [x[1], 1.0], [x[1], 2.0], [x[0], 2.0]]
            .map(|[x, y]| vertex([x, y, 0.5]))
            .to_vec()
            .into(),
        indices: vec![0, 1, 2, 0, 2, 3].into(),
        values: Vec::new().into(),
        level_triangles,
        error: None,
    };
    surface(vec![
        quad(0, [30.0, 32.0], [1, 0, 1, 0, 0, 0]),
        quad(1, [0.0, 3.25], [2, 0, 0, 0, 0, 0]),
    ])
}

fn normal_of(mesh: &Mesh, triangle: usize) -> DVec3 {
    triangle_normal(mesh.triangles[triangle].map(|i| DVec3::from(mesh.positions[i as usize].map(f64::from))))
}

#[test]
fn what_regions_share_is_there_once_and_triangles_are_ordered_by_level() {
    let mesh = Mesh::new(&two_quads(), &geometry()).unwrap();
    assert_eq!(mesh.positions.len(), 6);
    assert_eq!(mesh.level_triangles, [3, 0, 1, 0, 0, 0]);
    assert_eq!(mesh.triangles, [[0, 1, 2], [1, 4, 5], [1, 5, 2], [0, 2, 3]]);
    assert_eq!(mesh.world(1), [32.0, 1.0, 0.5]);
    assert_eq!(mesh.world(4), [35.25, 1.0, 0.5]);
    assert_eq!(mesh.feature, [1.0; 6]);
}

#[test]
fn regions_of_different_sizes_share_their_vertices() {
    // The first quad ends at x = 64, the face of a region of 64³ cells; the second one begins there.
    let mut surface = two_quads();
    surface.regions[0].size = 1;
    for vertex in &mut *surface.regions[0].vertices.to_mut() {
        vertex.position[0] += 32 * Vertex::LATTICE;
    }
    surface.regions[1].coords = [2, 0, 0];
    for size in [0, 1] {
        surface.regions[1].size = size;
        let mesh = Mesh::new(&surface, &geometry()).unwrap();
        assert_eq!(mesh.positions.len(), 6);
        let mut x: Vec<_> = (0..6).map(|vertex| mesh.world(vertex)[0]).collect();
        x.sort_unstable_by(f64::total_cmp);
        assert_eq!(x, [62.0, 62.0, 64.0, 64.0, 67.25, 67.25]);
    }
}

#[test]
fn a_vertex_outside_its_region_is_the_one_inside_its_neighbour() {
    let mut surface = two_quads();
    // The first quad ends 3.25 cells into the second region, at the end of the second quad.
    for (v, y) in [(1, 1.0), (2, 2.0)] {
        surface.regions[0].vertices.to_mut()[v] = vertex([35.25, y, 0.5]);
    }
    let mesh = Mesh::new(&surface, &geometry()).unwrap();
    assert_eq!(mesh.positions.len(), 6);
    assert_eq!(mesh.triangles[0], [0, 1, 2]);
    assert_eq!(mesh.triangles[1], [4, 1, 2]);
}

#[test]
fn equal_vertices_of_one_region_stay_apart_and_find_their_copies() {
    let mut surface = two_quads();
    // Both ends of the shared edge at one place: two vertices in the first region, the same two in the second.
    let second = surface.regions[0].vertices[1];
    surface.regions[0].vertices.to_mut()[2] = second;
    let first = surface.regions[1].vertices[0];
    surface.regions[1].vertices.to_mut()[3] = first;
    let mesh = Mesh::new(&surface, &geometry()).unwrap();
    assert_eq!(mesh.positions.len(), 6);
    assert_eq!(mesh.triangles[1], [1, 4, 5]);
    assert_eq!(mesh.triangles[2], [1, 5, 2]);
}

#[test]
fn vertices_that_differ_in_one_field_stay_apart() {
    for change in [
        |v: &mut Vertex| v.normal = [1, 0],
        |v: &mut Vertex| v.smoothness = 1,
        |v: &mut Vertex| v.feature = 1,
    ] {
        let mut surface = two_quads();
        change(&mut surface.regions[1].vertices.to_mut()[0]);
        assert_eq!(Mesh::new(&surface, &geometry()).unwrap().positions.len(), 7);
    }
}

#[test]
fn positions_follow_origin_direction_and_spacing() {
    let turned = Geometry {
        spacing: [0.5, 2.0, 3.0],
        origin: [-100.0, 10.0, 1000.0],
        // x goes to world y, y to world −x, z stays.
        direction: [[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]],
        ..geometry()
    };
    let mesh = Mesh::new(&two_quads(), &turned).unwrap();
    assert_eq!(mesh.world(4), [-100.0 - 2.0, 10.0 + 35.25 * 0.5, 1001.5]);
    assert!(normal_of(&mesh, 0)[2] > 0.0);
}

#[test]
fn a_mirror_turns_the_triangles_and_a_shear_keeps_normals_perpendicular() {
    let mirrored = Geometry {
        direction: [[-1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]],
        ..geometry()
    };
    let root = 0.5f64.sqrt();
    let sheared = Geometry {
        direction: [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [root, 0.0, root]],
        ..geometry()
    };
    let upside_down = Geometry {
        direction: [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, -1.0]],
        ..geometry()
    };
    for (geometry, expected) in [(mirrored, 1.0), (sheared, 1.0), (upside_down, -1.0)] {
        let mesh = Mesh::new(&two_quads(), &geometry).unwrap();
        assert_eq!(mesh.normals[0], [0.0, 0.0, expected]);
        for triangle in 0..4 {
            assert!(
                normal_of(&mesh, triangle)[2] * f64::from(expected) > 0.0,
                "{geometry:?}"
            );
        }
    }
}

#[test]
fn uneven_axes_move_positions_and_turn_normals() {
    // The cell behind x = 30 has 3 times the length of an even one, others share the rest.
    let mut x: Vec<f64> = (0..97).map(|i| f64::from(i) * 94.0 / 95.0).collect();
    x[31..].iter_mut().for_each(|x| *x += 2.0);
    let uneven = UnevenAxes::new([Some(&x), None, None]).expect("uneven");
    let mut surface = two_quads();
    // Towards +x and +z alike, in the lengths of the largest cells.
    let slanted = [16384, 0];
    surface.regions[0].vertices.to_mut()[0].normal = slanted;
    let made_by =
        |surface: &Surface, mesher| Mesh::new_unless(surface, &geometry(), Some((&uneven, mesher)), &|| false).unwrap();
    let mesh = made_by(&surface, MesherName::Dual);
    let scale = 96.0 / x[96];
    let is_near = |vertex, expected: [f64; 3]| {
        let apart = DVec3::from(mesh.world(vertex)) - DVec3::from(expected);
        assert!(apart.length() < 1e-5, "{:?}, expected {expected:?}", mesh.world(vertex));
    };
    is_near(0, [x[30] * scale, 1.0, 0.5]);
    is_near(4, [(x[35] + 0.25 * (x[36] - x[35])) * scale, 1.0, 0.5]);
    let [nx, _, nz] = mesh.normals[0];
    assert!(
        (nx / nz - 1.0).abs() < 1e-3,
        "{:?}: in the largest cell nothing changes",
        mesh.normals[0]
    );
    // Marching cubes' differences are of the sample's two neighbours.
    let mesh = made_by(&surface, MesherName::MarchingCubes);
    let ([nx, _, nz], ratio) = (mesh.normals[0], (x[31] - x[30]) / (0.5 * (x[31] - x[29])));
    assert!(
        (f64::from(nx / nz) - ratio).abs() < 1e-3,
        "{:?}, expected a slope of {ratio}",
        mesh.normals[0]
    );
    surface.regions[0].vertices.to_mut()[0].position[0] -= Vertex::LATTICE;
    let mesh = made_by(&surface, MesherName::Dual);
    let ([nx, _, nz], ratio) = (mesh.normals[0], (x[31] - x[30]) / (x[30] - x[29]));
    assert!(
        (f64::from(nx / nz) - ratio).abs() < 1e-2,
        "{:?}, expected a slope of {ratio}",
        mesh.normals[0]
    );
    assert_eq!(mesh.normals[1], [0.0, 0.0, 1.0]);
}

#[test]
fn far_regions_keep_their_place() {
    let mut surface = two_quads();
    surface.regions[1].coords = [1 << 20, 0, 0];
    let mesh = Mesh::new(&surface, &geometry()).unwrap();
    assert_eq!(mesh.positions.len(), 8);
    assert_eq!(mesh.world(4)[0], f64::from(32u32 << 20));
}

#[test]
fn positions_far_from_the_origin_are_as_exact_as_near_it() {
    let near = Mesh::new(&two_quads(), &geometry()).unwrap();
    let far_away = Geometry {
        spacing: [0.05; 3],
        origin: [500_000.0, 4.6e6, 120.0],
        ..geometry()
    };
    let far = Mesh::new(&two_quads(), &far_away).unwrap();
    for vertex in 0..near.positions.len() {
        let expected = DVec3::from(near.world(vertex)) * 0.05 + DVec3::from(far_away.origin);
        let apart = (DVec3::from(far.world(vertex)) - expected).length();
        assert!(apart < 1e-6, "vertex {vertex} is {apart} off");
    }
}

#[test]
fn broken_regions_and_places_are_refused() {
    let mut surface = two_quads();
    surface.regions[0].indices.to_mut()[5] = 4;
    let error = Mesh::new(&surface, &geometry()).unwrap_err().to_string();
    assert_eq!(error, "region [0, 0, 0]: index 4, expected less than 4, its vertices");

    let mut surface = two_quads();
    surface.regions[0].level_triangles = [1, 0, 2, 0, 0, 0];
    assert!(matches!(
        Mesh::new(&surface, &geometry()),
        Err(ExportError::Join(JoinError::BadRegion { .. }))
    ));

    let far = Geometry {
        spacing: [1e38; 3],
        ..geometry()
    };
    assert!(matches!(Mesh::new(&two_quads(), &far), Err(ExportError::OutOfRange(_))));
}

#[test]
fn colours_follow_the_blended_feature() {
    let point = |x, color: &str| PointJson {
        x,
        importance: 0.0,
        color: color.into(),
    };
    let transfer = TransferFunctionJson {
        points: vec![point(1.0, "#ff0000"), point(0.0, "#0000ff")],
    };
    let mut mesh = Mesh::new(&two_quads(), &geometry()).unwrap();
    mesh.colorize(&transfer, 1.0);
    assert_eq!(mesh.colors, [[65535, 0, 0]; 6]);
    for byte in 0..=255u8 {
        let linear = (linear(f32::from(byte) / 255.0) * 65535.0).round() as u16;
        assert_eq!(srgb_bytes([linear, 0, 65535]), [byte, 0, 255]);
    }
    mesh.colorize(&transfer, 0.0);
    assert_eq!(mesh.colors, [[0, 0, 65535]; 6]);
    mesh.colorize(&transfer, 0.5);
    // Half of sRGB is 21.4 % of the light.
    assert_eq!(
        mesh.colors[0].map(|c| (f32::from(c) / 655.35).round()),
        [21.0, 0.0, 21.0]
    );
}
