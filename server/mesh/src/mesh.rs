//! Joins the regions of a surface to one mesh in world units.

use isopeel_extraction::Joined;
use isopeel_geometry::UnevenAxes;
use isopeel_kernels::{Region, Surface};
use isopeel_view::TransferFunctionJson;
use isopeel_view::quality::MesherName;
use isopeel_volumes::{Frame, Geometry, LengthUnit};
use rayon::prelude::*;

use super::ExportError;
use super::caps::ToCaps;
use super::transform::{Transform, index_of};

/// A surface in world units. Vertices that several regions share are joined. Triangles are ordered by level, finest first.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Mesh {
    /// World position to which `positions` are relative.
    pub origin: [f64; 3],
    /// Positions of the vertices relative to `origin`, along the axes of the world.
    pub positions: Vec<[f32; 3]>,
    /// Unit normals of the vertices in the world, towards lower values.
    pub normals: Vec<[f32; 3]>,
    /// Smoothness feature `s` of the vertices, 0 to 1.
    pub smoothness: Vec<f32>,
    /// Normalised user feature `f̂` of the vertices, 0 to 1.
    pub feature: Vec<f32>,
    /// Positions of the vertices in index space. Needed to sample fields and to find caps, and empty afterwards.
    pub index: Vec<[f32; 3]>,
    /// Position of each vertex relative to the caps; empty without caps.
    pub caps: Vec<ToCaps>,
    /// Values of fields at the vertices.
    pub fields: Vec<FieldValues>,
    /// Linear RGB of the vertices, 0 to 65535; empty without a transfer function.
    pub colors: Vec<[u16; 3]>,
    /// Triangles, counter-clockwise as seen from the side of lower values, finest level first.
    pub triangles: Vec<[u32; 3]>,
    /// Number of triangles of each level, 0 (finest) first.
    pub level_triangles: [u64; 6],
    /// Directions of the axes of the positions.
    pub frame: Frame,
    /// Unit of the positions, if it is known.
    pub unit: Option<LengthUnit>,
    /// Smallest distance between samples along an axis.
    pub smallest_spacing: f64,
    /// Notices about the volume.
    pub notices: Vec<String>,
    /// Name of the surface for users, such as `head: t1 = 517`.
    pub name: String,
    /// Provenance of the surface as pairs of name and text, for formats with metadata.
    pub provenance: Vec<(&'static str, String)>,
    /// Whether each edge has two triangles.
    pub is_closed: bool,
    /// Colour and opacity of the whole surface.
    pub material: Material,
}

/// Colour and opacity of a whole surface.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Material {
    /// Colour in sRGB, if the surface has one.
    pub color: Option<[u8; 3]>,
    /// Opacity from 0, invisible, to 1, opaque.
    pub opacity: f32,
}

impl Default for Material {
    fn default() -> Self {
        Self {
            color: None,
            opacity: 1.0,
        }
    }
}

/// Values of a field at the vertices of a mesh.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct FieldValues {
    /// Name of the field.
    pub name: String,
    /// Unit of the values, if the volume declares one.
    pub unit: Option<String>,
    /// Value at each vertex; NaN if it is missing.
    pub values: Vec<f32>,
}

impl Mesh {
    /// Joins the regions of a surface. Vertices of different regions are joined if all their attributes are equal. Keeps all triangles,
    /// including degenerate ones. Flips the triangles if the axes of the geometry include a reflection.
    ///
    /// # Errors
    /// The surface has too many vertices for 32-bit indices, a coordinate exceeds 32-bit floats, or the indices or levels of a region are
    /// inconsistent with its vertices and triangles.
    pub fn new(surface: &Surface, geometry: &Geometry) -> Result<Self, ExportError> {
        Self::new_unless(surface, geometry, None, &|| false)
    }

    /// Joins the regions of a surface as [`Mesh::new`] does, but can be cancelled. `uneven` are the axes of a volume whose samples are not
    /// evenly spaced, although they are in `geometry`, and the mesher that has made the surface.
    ///
    /// # Errors
    /// As [`Mesh::new`], and [`ExportError::Cancelled`] if `is_cancelled` returns true.
    pub fn new_unless(
        surface: &Surface,
        geometry: &Geometry,
        uneven: Option<(&UnevenAxes, MesherName)>,
        is_cancelled: &dyn Fn() -> bool,
    ) -> Result<Self, ExportError> {
        let transform = Transform::new(geometry, uneven);
        let joined = Joined::new(&surface.regions, is_cancelled)?;
        let mut mesh = Self {
            origin: transform.origin.to_array(),
            triangles: joined.triangles,
            level_triangles: joined.level_triangles,
            smallest_spacing: geometry.spacing.into_iter().fold(f64::INFINITY, f64::min),
            frame: geometry.frame,
            unit: geometry.unit,
            ..Self::default()
        };
        mesh.set_vertices(&surface.regions, &joined.vertices, &transform)?;
        if transform.mirrors {
            mesh.triangles.iter_mut().for_each(|[_, b, c]| std::mem::swap(b, c));
        }
        Ok(mesh)
    }

    /// Sets the attributes of all vertices, in parallel. `vertices`: region and number in the region of each vertex.
    fn set_vertices(
        &mut self,
        regions: &[Region],
        vertices: &[[u32; 2]],
        transform: &Transform<'_>,
    ) -> Result<(), ExportError> {
        self.positions = vec![[0.0; 3]; vertices.len()];
        self.normals = vec![[0.0; 3]; vertices.len()];
        self.smoothness = vec![0.0; vertices.len()];
        self.feature = vec![0.0; vertices.len()];
        self.index = vec![[0.0; 3]; vertices.len()];
        let attributes = (
            vertices,
            &mut self.positions,
            &mut self.normals,
            &mut self.smoothness,
            &mut self.feature,
            &mut self.index,
        );
        attributes
            .into_par_iter()
            .try_for_each(|(&[region, vertex], position, normal, smoothness, feature, index)| {
                let region = &regions[region as usize];
                let vertex = &region.vertices[vertex as usize];
                let lattice = region.position_of(vertex);
                *position = transform.position(lattice)?;
                *normal = transform.normal(lattice, vertex.unit_normal());
                *smoothness = f32::from(vertex.smoothness) / 65535.0;
                *feature = f32::from(vertex.feature) / 65535.0;
                *index = index_of(lattice).to_array().map(|component| component as f32);
                Ok(())
            })
    }

    /// Adds a copy of a vertex, and returns the number of the copy.
    pub(crate) fn copy_vertex(&mut self, vertex: usize) -> u32 {
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
        if !self.caps.is_empty() {
            self.caps.push(self.caps[vertex]);
        }
        self.positions.len() as u32 - 1
    }

    /// Turns the mesh inside out: flips the triangles and the normals.
    pub fn flip(&mut self) {
        self.triangles.iter_mut().for_each(|[_, b, c]| std::mem::swap(b, c));
        for component in self.normals.as_flattened_mut() {
            *component = -*component;
        }
    }

    /// Returns the world position of a vertex.
    pub fn world(&self, vertex: usize) -> [f64; 3] {
        let position = self.positions[vertex];
        [0, 1, 2].map(|axis| self.origin[axis] + f64::from(position[axis]))
    }

    /// Returns the world position of a vertex in 32 bits.
    ///
    /// # Errors
    /// [`ExportError::OutOfRange`].
    pub fn world_f32(&self, vertex: usize) -> Result<[f32; 3], ExportError> {
        let world = self.world(vertex);
        let rounded = world.map(|component| component as f32);
        if rounded.iter().all(|component| component.is_finite()) {
            Ok(rounded)
        } else {
            Err(ExportError::OutOfRange(world))
        }
    }

    /// Sets the colour of each vertex: the value of `transfer` at the blended feature `(1 − alpha)·s + alpha·f̂`. Interpolates linearly in
    /// sRGB between points, as the viewer does. Ignores points whose colour is not `#rrggbb`.
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
}

/// Parses `#rrggbb` as three bytes.
pub fn rgb(color: &str) -> Option<[u8; 3]> {
    let digits = color.strip_prefix('#').filter(|d| d.len() == 6 && d.is_ascii())?;
    let [_, bytes @ ..] = u32::from_str_radix(digits, 16).ok()?.to_be_bytes();
    Some(bytes)
}

/// Parses `#rrggbb` as three numbers from 0 to 1.
fn srgb(color: &str) -> Option<[f32; 3]> {
    Some(rgb(color)?.map(|byte| f32::from(byte) / 255.0))
}

/// Returns the colour at `x`. Interpolates linearly between `points`, which are sorted by their `x`, and is constant beyond the ends.
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

/// Returns distinct attribute names for the fields of a mesh: the prefix, and the name of the field as by [`plain`]. Appends a number to a
/// name that another attribute already has. `taken` are the names of other attributes.
pub(crate) fn attribute_names(mesh: &Mesh, prefix: &str, taken: &[&str]) -> Vec<String> {
    let names = mesh
        .fields
        .iter()
        .map(|field| format!("{prefix}{}", plain(&field.name)));
    distinct_names(names, taken)
}

/// Replaces all characters except ASCII letters and digits by `_`.
pub(crate) fn plain(text: &str) -> String {
    let plain = |c: char| if c.is_ascii_alphanumeric() { c } else { '_' };
    text.chars().map(plain).collect()
}

/// Makes names distinct from each other and from `taken`, by appending numbers.
pub(crate) fn distinct_names(wanted: impl Iterator<Item = String>, taken: &[&str]) -> Vec<String> {
    let mut names: Vec<String> = taken.iter().map(|&name| name.to_owned()).collect();
    for name in wanted {
        names.push(distinct_name(name, &names));
    }
    names.split_off(taken.len())
}

/// Returns the name, with a number appended if the name is taken. Ignores case.
fn distinct_name(name: String, taken: &[String]) -> String {
    let is_free = |name: &String| !taken.iter().any(|other| other.eq_ignore_ascii_case(name));
    let numbered = (2..).map(|n| format!("{name}_{n}"));
    let distinct = std::iter::once(name.clone()).chain(numbered).find(is_free);
    distinct.unwrap_or(name)
}

/// Converts a text to one line of printable ASCII. Escapes other characters as in Rust.
pub fn ascii(text: &str) -> String {
    let escaped = |c: char| match c {
        ' '..='~' => c.to_string(),
        _ => c.escape_default().to_string(),
    };
    text.chars().map(escaped).collect()
}

/// Converts a linear colour to bytes in sRGB.
pub(crate) fn srgb_bytes(color: [u16; 3]) -> [u8; 3] {
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

/// Converts a component from sRGB to linear (IEC 61966-2-1). Vertex colours of glTF are linear.
pub(crate) fn linear(srgb: f32) -> f32 {
    if srgb <= 0.040_45 {
        srgb / 12.92
    } else {
        ((srgb + 0.055) / 1.055).powf(2.4)
    }
}

#[cfg(test)]
pub(crate) mod tests;
