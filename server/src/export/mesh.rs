//! From the regions of a surface to one mesh in world units.

use std::collections::{HashMap, HashSet};

use isopeel_kernels::{REGION_CELLS, Region, Surface, Vertex};

use super::transform::Transform;
use super::{ExportError, fits_u32};
use crate::math::UnevenAxes;
use crate::view::TransferFunctionJson;
use crate::view::quality::MesherName;
use crate::volumes::{Frame, Geometry, LengthUnit};

/// Lattice units per region.
const REGION_LATTICE: i32 = REGION_CELLS as i32 * Vertex::LATTICE;

/// All fields of a vertex, the position on the lattice of the whole volume. Vertices with equal keys are joined.
type Key = ([i64; 3], [i16; 2], u16, u16);

/// A surface in world units. Vertices that regions share are joined, triangles ordered by level, finest first.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Mesh {
    /// World position to which `positions` are relative.
    pub origin: [f64; 3],
    /// Positions, relative to `origin` and along the world's axes.
    pub positions: Vec<[f32; 3]>,
    /// Unit normals towards lower values, in the world.
    pub normals: Vec<[f32; 3]>,
    /// Smoothness feature `s` of a vertex, 0 to 1.
    pub smoothness: Vec<f32>,
    /// Normalised user feature `f̂` of a vertex, 0 to 1.
    pub feature: Vec<f32>,
    /// Positions in index space, until values of fields are taken there.
    pub(crate) index: Vec<[f32; 3]>,
    /// Values of fields at the vertices.
    pub fields: Vec<FieldValues>,
    /// Linear RGB of a vertex, 0 to 65535; empty without a transfer function.
    pub colors: Vec<[u16; 3]>,
    /// Triangles, counter-clockwise seen from the side of lower values, finest level first.
    pub triangles: Vec<[u32; 3]>,
    /// Triangles of each level, 0 (finest) first.
    pub level_triangles: [u64; 6],
    /// What the axes of the positions are.
    pub frame: Frame,
    /// Unit of the positions, where it is known.
    pub unit: Option<LengthUnit>,
    /// Smallest distance between samples along an axis.
    pub smallest_spacing: f64,
    /// What is to be known of the volume, a line each.
    pub notices: Vec<String>,
    /// What the surface is, for people: `head: t1 = 517`.
    pub name: String,
    /// Where the surface comes from: names and texts, for formats that hold some.
    pub provenance: Vec<(&'static str, String)>,
}

/// Values of a field at the vertices of a mesh.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct FieldValues {
    /// Name of the field.
    pub name: String,
    /// Unit of the values, if the volume declares one.
    pub unit: Option<String>,
    /// A value for each vertex; NaN where it is missing.
    pub values: Vec<f32>,
}

impl Mesh {
    /// Joins the regions of a surface. Vertices of different regions that are equal in every field become one. Triangles are kept,
    /// degenerate ones too; their winding is flipped where `direction` mirrors.
    ///
    /// # Errors
    /// More vertices than 32-bit indices reach, coordinates beyond 32-bit floats, or a region whose indices or
    /// levels do not fit its vertices and triangles.
    pub fn new(surface: &Surface, geometry: &Geometry) -> Result<Self, ExportError> {
        Self::new_unless(surface, geometry, None, &|| false)
    }

    /// As [`Mesh::new`]; asks now and then whether it is cancelled. `uneven`: the axes whose samples are not where `geometry` has them, and
    /// which mesher made the surface.
    ///
    /// # Errors
    /// Those of [`Mesh::new`], and [`ExportError::Cancelled`].
    pub fn new_unless(
        surface: &Surface,
        geometry: &Geometry,
        uneven: Option<(&UnevenAxes, MesherName)>,
        is_cancelled: &dyn Fn() -> bool,
    ) -> Result<Self, ExportError> {
        let transform = Transform::new(geometry, uneven);
        let mut mesh = Self {
            origin: transform.origin.to_array(),
            smallest_spacing: geometry.spacing.into_iter().fold(f64::INFINITY, f64::min),
            frame: geometry.frame,
            unit: geometry.unit,
            ..Self::default()
        };
        for region in &surface.regions {
            check(region)?;
            for (sum, n) in mesh.level_triangles.iter_mut().zip(region.level_triangles) {
                *sum += u64::from(n);
            }
        }
        let held: u64 = surface.regions.iter().map(|r| r.vertices.len() as u64).sum();
        fits_u32("vertices", held, "a 32-bit index")?;
        mesh.reserve(held as usize);

        // Where the next triangle of each level goes.
        let mut next = [0usize; 6];
        for level in 1..6 {
            next[level] = next[level - 1] + mesh.level_triangles[level - 1] as usize;
        }
        // Most vertices are inside their region and belong to no other. Only those on a region's faces, and those outside of the region
        // that has them, are looked up.
        let outside: HashSet<Key> = (surface.regions.iter())
            .flat_map(|region| region.vertices.iter().map(move |v| (region, v)))
            .filter(|(_, v)| v.position.iter().any(|p| !(0..=REGION_LATTICE).contains(p)))
            .map(|(region, v)| key(region, v))
            .collect();
        let mut shared = HashMap::new();
        let mut copies = HashMap::new();
        let mut joined = Vec::new();
        for region in &surface.regions {
            if is_cancelled() {
                return Err(ExportError::Cancelled);
            }
            joined.clear();
            copies.clear();
            for vertex in &region.vertices {
                let key = key(region, vertex);
                let new = mesh.positions.len() as u32;
                let inside = vertex.position.iter().all(|p| (1..REGION_LATTICE).contains(p));
                let index = if inside && !outside.contains(&key) {
                    new
                } else {
                    // Equal vertices of one region are not joined: they are crossings on several edges of a sample that the surface
                    // goes through. The first copy is joined with the first copies of other regions.
                    let copy = copies.entry(key).and_modify(|n| *n += 1).or_insert(0u32);
                    *shared.entry((key, *copy)).or_insert(new)
                };
                if index == new {
                    mesh.push(vertex, key.0, &transform)?;
                }
                joined.push(index);
            }
            let mut corners = region.indices.chunks_exact(3);
            for (level, &count) in region.level_triangles.iter().enumerate() {
                for corner in corners.by_ref().take(count as usize) {
                    let [a, b, c] = [0, 1, 2].map(|i| joined[corner[i] as usize]);
                    mesh.triangles[next[level]] = if transform.mirrors { [a, c, b] } else { [a, b, c] };
                    next[level] += 1;
                }
            }
        }
        Ok(mesh)
    }

    /// Adds a copy of a vertex, and returns its number.
    pub(super) fn copy_vertex(&mut self, vertex: usize) -> u32 {
        self.positions.push(self.positions[vertex]);
        self.normals.push(self.normals[vertex]);
        self.smoothness.push(self.smoothness[vertex]);
        self.feature.push(self.feature[vertex]);
        for field in &mut self.fields {
            field.values.push(field.values[vertex]);
        }
        if !self.colors.is_empty() {
            self.colors.push(self.colors[vertex]);
        }
        self.positions.len() as u32 - 1
    }

    /// Turns the mesh inside out: the other side of each triangle is seen, and normals point the other way.
    pub(super) fn flip(&mut self) {
        self.triangles.iter_mut().for_each(|[_, b, c]| std::mem::swap(b, c));
        for component in self.normals.as_flattened_mut() {
            *component = -*component;
        }
    }

    /// World position of a vertex.
    pub fn world(&self, vertex: usize) -> [f64; 3] {
        let position = self.positions[vertex];
        [0, 1, 2].map(|axis| self.origin[axis] + f64::from(position[axis]))
    }

    /// Gives every vertex the colour that `transfer` has at its blended feature `(1 − alpha)·s + alpha·f̂`, linear
    /// in sRGB between points as in the viewer. Points whose colour is not `#rrggbb` are ignored.
    pub fn colorize(&mut self, transfer: &TransferFunctionJson, alpha: f32) {
        let mut points: Vec<(f32, [f32; 3])> = transfer
            .points
            .iter()
            .filter_map(|p| Some((p.x, srgb(&p.color)?)))
            .collect();
        points.sort_by(|a, b| a.0.total_cmp(&b.0));
        if points.is_empty() {
            return;
        }
        self.colors = (self.smoothness.iter().zip(&self.feature))
            .map(|(s, f)| {
                color_at(&points, (1.0 - alpha) * s + alpha * f).map(|c| (linear(c) * 65535.0).round() as u16)
            })
            .collect();
    }

    fn reserve(&mut self, vertices: usize) {
        let triangles: u64 = self.level_triangles.iter().sum();
        self.positions.reserve(vertices);
        self.index.reserve(vertices);
        self.normals.reserve(vertices);
        self.smoothness.reserve(vertices);
        self.feature.reserve(vertices);
        self.triangles.resize(triangles as usize, [0; 3]);
    }

    fn push(&mut self, vertex: &Vertex, lattice: [i64; 3], transform: &Transform<'_>) -> Result<(), ExportError> {
        self.positions.push(transform.position(lattice)?);
        self.index
            .push(lattice.map(|at| (at as f64 / f64::from(Vertex::LATTICE)) as f32));
        self.normals.push(transform.normal(lattice, vertex.unit_normal()));
        self.smoothness.push(f32::from(vertex.smoothness) / 65535.0);
        self.feature.push(f32::from(vertex.feature) / 65535.0);
        Ok(())
    }
}

fn key(region: &Region, vertex: &Vertex) -> Key {
    let position = [0, 1, 2]
        .map(|axis| i64::from(region.coords[axis]) * i64::from(REGION_LATTICE) + i64::from(vertex.position[axis]));
    (position, vertex.normal, vertex.smoothness, vertex.feature)
}

/// Refuses a region whose indices would be out of bounds.
fn check(region: &Region) -> Result<(), ExportError> {
    let bad = |why| {
        Err(ExportError::BadRegion {
            region: region.coords,
            why,
        })
    };
    let levels: u64 = region.level_triangles.iter().map(|&n| u64::from(n)).sum();
    if region.indices.len() as u64 != 3 * levels {
        return bad(format!(
            "{} indices, expected 3 for each of {levels} triangles",
            region.indices.len()
        ));
    }
    let vertices = region.vertices.len();
    if let Some(index) = region.indices.iter().find(|&&i| i as usize >= vertices) {
        return bad(format!("index {index}, expected less than {vertices}, its vertices"));
    }
    Ok(())
}

/// `#rrggbb` as three numbers in 0 to 1.
fn srgb(color: &str) -> Option<[f32; 3]> {
    let digits = color.strip_prefix('#').filter(|d| d.len() == 6 && d.is_ascii())?;
    let rgb = u32::from_str_radix(digits, 16).ok()?;
    Some([16, 8, 0].map(|shift| (rgb >> shift & 0xff) as f32 / 255.0))
}

/// Piecewise linear between points sorted by `x`, constant beyond the ends.
fn color_at(points: &[(f32, [f32; 3])], x: f32) -> [f32; 3] {
    let right = points.partition_point(|p| p.0 <= x);
    match right {
        0 => points[0].1,
        n if n == points.len() => points[n - 1].1,
        _ => {
            let (a, b) = (points[right - 1], points[right]);
            let t = (x - a.0) / (b.0 - a.0);
            [0, 1, 2].map(|i| a.1[i] + (b.1[i] - a.1[i]) * t)
        }
    }
}

/// Names of attributes for the fields of a mesh: their own, with anything but ASCII letters and digits as `_`, behind a prefix; with a number
/// if another one has that name.
pub(super) fn attribute_names(mesh: &Mesh, prefix: &str, taken: &[&str]) -> Vec<String> {
    let mut names: Vec<String> = taken.iter().map(|&name| name.to_owned()).collect();
    for field in &mesh.fields {
        let plain = |c: char| if c.is_ascii_alphanumeric() { c } else { '_' };
        let name = format!("{prefix}{}", field.name.chars().map(plain).collect::<String>());
        let free = |name: &String| !names.iter().any(|other| other.eq_ignore_ascii_case(name));
        let numbered = (2..).map(|n| format!("{name}_{n}"));
        let found = std::iter::once(name.clone()).chain(numbered).find(free);
        names.push(found.unwrap_or(name));
    }
    names.split_off(taken.len())
}

/// A linear colour as bytes of sRGB, as PLY and VTP have colours.
pub(super) fn srgb_bytes(color: [u16; 3]) -> [u8; 3] {
    color.map(|component| {
        let linear = f32::from(component) / 65535.0;
        let srgb = if linear <= 0.003_130_8 {
            12.92 * linear
        } else {
            1.055 * linear.powf(1.0 / 2.4) - 0.055
        };
        (255.0 * srgb).round() as u8
    })
}

/// From sRGB to linear (IEC 61966-2-1), as glTF defines vertex colours.
fn linear(srgb: f32) -> f32 {
    if srgb <= 0.040_45 {
        srgb / 12.92
    } else {
        ((srgb + 0.055) / 1.055).powf(2.4)
    }
}

#[cfg(test)]
pub(super) mod tests {
    use isopeel_kernels::{Level, SurfaceStatistics};

    use super::*;
    use crate::math::{DVec3, triangle_normal};
    use crate::view::PointJson;

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
            vertices: [[x[0], 1.0], [x[1], 1.0], [x[1], 2.0], [x[0], 2.0]]
                .map(|[x, y]| vertex([x, y, 0.5]))
                .to_vec()
                .into(),
            indices: vec![0, 1, 2, 0, 2, 3].into(),
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
    fn a_vertex_outside_its_region_is_the_one_inside_its_neighbour() {
        let mut surface = two_quads();
        // The first quad ends 3.25 cells into the second region, where the second ends too.
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
        let made_by = |surface: &Surface, mesher| {
            Mesh::new_unless(surface, &geometry(), Some((&uneven, mesher)), &|| false).unwrap()
        };
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
            Err(ExportError::BadRegion { .. })
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
}
