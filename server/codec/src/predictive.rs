//! The coding `predictive` of chunks, for slow lines: about 60 % of the bytes of meshoptimizer's codecs, in about ten times the time.
//! Normative: `PROTOCOL.md`, section 4.1.
//!
//! A traversal covers the mesh triangle after triangle, as Edgebreaker does (J. Rossignac, 1999). For each edge of the boundary of the
//! covered part, the traversal codes whether there is a triangle behind the edge, and which third vertex that triangle has. A new vertex is
//! predicted: the position from a parallelogram and the normals so far, the features from those of the edge's ends, and at the end the
//! normal from those of the triangles. A range coder codes the differences from the predictions.
//!
//! The encoder takes a chunk of the coding `meshopt`, which is cached for all viewers. [`Walk`] is both encoder and decoder: it codes a
//! [`Known`] mesh, or builds the mesh from the values that it reads.

mod boundary;
mod mesh;

use bytes::Bytes;

use self::boundary::{Boundary, EdgeId, Third};
use self::mesh::{DIFFERENCE_CONTEXTS, Mesh, SIZE_CONTEXTS, VertexPrediction, feature_from_step, feature_step};
use super::chunk::{ChunkError, ChunkHeader, Coding, DecodedChunk, HEADER_BYTES, WireVertex, decode_meshopt};
use super::order::{Traversal, after, before};
use super::range_coder::{BitModel, Coder, Decoder, Encoder, NumberModel, length};

/// Recodes a chunk of the coding `meshopt`. Returns a chunk without vertices unchanged.
///
/// # Errors
/// The fault of the frame.
pub fn encode(frame: &Bytes) -> Result<Bytes, ChunkError> {
    let decoded = decode_meshopt(frame)?;
    if decoded.vertices.is_empty() {
        return Ok(frame.clone());
    }
    let (payload, order) = encode_payload(&decoded)?;
    let header = ChunkHeader {
        coding: Coding::Predictive,
        vertex_count: order.len() as u32,
        vertex_bytes: payload.len() as u32,
        index_bytes: 0,
        ..decoded.header
    };
    let values = match decoded.header.values(frame)? {
        Some(values) => values.in_order(&order).to_bytes().map_err(ChunkError::new)?,
        None => Vec::new(),
    };
    let mut encoded = Vec::with_capacity(HEADER_BYTES + payload.len() + values.len());
    encoded.extend_from_slice(&header.to_bytes());
    encoded.extend_from_slice(&payload);
    encoded.extend_from_slice(&values);
    Ok(encoded.into())
}

/// Returns, for each vertex of the chunk that [`encode`] returns, its number in the given chunk.
///
/// # Errors
/// The fault of the frame.
pub fn order(frame: &[u8]) -> Result<Vec<u32>, ChunkError> {
    let decoded = decode_meshopt(frame)?;
    Ok(encode_payload(&decoded)?.1)
}

/// Encodes a mesh. Returns the payload, and the numbers of the given vertices in the order of the payload.
fn encode_payload(decoded: &DecodedChunk) -> Result<(Vec<u8>, Vec<u32>), ChunkError> {
    let mut traversal = Traversal::default();
    let mut walk = Walk::new(Encoder::new(), &decoded.header);
    walk.known = Some(Known::new(decoded, &mut traversal));
    walk.run().map_err(ChunkError::new)?;
    let order = walk.known.map(|known| known.order).unwrap_or_default();
    Ok((walk.coder.finish(), order))
}

/// Decodes the payload of a chunk whose header was checked. Safe on any bytes.
pub(super) fn decode(header: &ChunkHeader, payload: &[u8]) -> Result<(Vec<WireVertex>, Vec<u32>), ChunkError> {
    let mut walk = Walk::new(Decoder::new(payload), header);
    walk.run().map_err(ChunkError::new)?;
    if !walk.coder.is_at_end() || walk.mesh.vertices.len() != header.vertex_count as usize {
        return Err(ChunkError::new(format!(
            "payload of {} bytes has {} vertices and does not end with its mesh, expected {} vertices",
            payload.len(),
            walk.mesh.vertices.len(),
            header.vertex_count
        )));
    }
    let indices = by_level(&walk.mesh, header.level_triangles)
        .ok_or_else(|| ChunkError::new("numbers of triangles by level differ from those of the header".into()))?;
    Ok((walk.mesh.vertices, indices))
}

/// Returns the indices sorted by level, finest first. Each level is in the order in which it was coded. `None` if a level has more
/// triangles than `level_triangles` states.
fn by_level(mesh: &Mesh, level_triangles: [u32; 6]) -> Option<Vec<u32>> {
    let mut indices = vec![0; 3 * mesh.triangles.len()];
    let mut ends = [0; 6];
    let mut cursors = [0; 6];
    let mut sum = 0;
    for (level, count) in level_triangles.into_iter().enumerate() {
        cursors[level] = sum;
        sum += count as usize;
        ends[level] = sum;
    }
    for (triangle, &level) in mesh.triangles.iter().zip(&mesh.levels) {
        let level = usize::from(level);
        if cursors[level] == ends[level] {
            return None;
        }
        indices[3 * cursors[level]..][..3].copy_from_slice(triangle);
        cursors[level] += 1;
    }
    Some(indices)
}

/// The mesh to encode.
struct Known<'a> {
    vertices: &'a [WireVertex],
    triangles: &'a [[u32; 3]],
    levels: Vec<u8>,
    /// As [`Traversal::twins`] returns them.
    twins: &'a [[u32; 4]],
    is_covered: Vec<bool>,
    /// Index of a triangle before which all triangles are covered.
    seed: usize,
    /// Number of each vertex in the coded mesh; `None` until the vertex was coded.
    numbers: Vec<Option<u32>>,
    /// Vertices by their numbers in the coded mesh.
    order: Vec<u32>,
    /// For each edge of the boundary, the half-edge behind it: four times the triangle, counted from 1, plus the corner at which the
    /// edge starts. 0: none.
    behind: Vec<u32>,
}

impl<'a> Known<'a> {
    fn new(decoded: &'a DecodedChunk, traversal: &'a mut Traversal) -> Self {
        let triangles = decoded.indices.as_chunks::<3>().0;
        let levels = (0..6).zip(decoded.header.level_triangles);
        Self {
            vertices: &decoded.vertices,
            triangles,
            levels: levels
                .flat_map(|(level, count)| std::iter::repeat_n(level, count as usize))
                .collect(),
            twins: traversal.twins(&decoded.indices, decoded.vertices.len()),
            is_covered: vec![false; triangles.len()],
            seed: 0,
            numbers: vec![None; decoded.vertices.len()],
            order: Vec::with_capacity(decoded.vertices.len()),
            behind: Vec::new(),
        }
    }

    /// Covers the first uncovered triangle, and returns it.
    fn start(&mut self) -> usize {
        while self.is_covered[self.seed] {
            self.seed += 1;
        }
        self.is_covered[self.seed] = true;
        // The order is that in which `Boundary::start` numbers the edges.
        let [ab, bc, ca, _] = self.twins[self.seed + 1];
        self.behind.extend([ca, bc, ab]);
        self.seed
    }

    /// Covers the triangle behind an edge, if it is uncovered, and returns it with its third vertex.
    fn follow(&mut self, edge: EdgeId) -> Option<(usize, u32)> {
        let half_edge = self.behind[edge];
        let (triangle, corner) = ((half_edge as usize / 4).checked_sub(1)?, half_edge % 4);
        if std::mem::replace(&mut self.is_covered[triangle], true) {
            return None;
        }
        let twins = self.twins[triangle + 1];
        // The order is that in which `Boundary::cover` numbers the edges.
        self.behind
            .extend([before(corner), after(corner)].map(|corner| twins[corner as usize]));
        Some((triangle, self.triangles[triangle][before(corner) as usize]))
    }

    /// Assigns the next number to a vertex.
    fn assign_number(&mut self, vertex: u32) {
        self.numbers[vertex as usize] = Some(self.order.len() as u32);
        self.order.push(vertex);
    }
}

/// Models of all coded values. Array indices are contexts.
struct Models {
    is_triangle: [BitModel; 4],
    is_new: [BitModel; 64],
    is_right: [BitModel; 64],
    is_left: [BitModel; 64],
    is_corner_new: [BitModel; 3],
    /// Age of a vertex that is used again: the number of vertices that were coded after it.
    age: NumberModel,
    is_same_level: [BitModel; 4],
    /// Bits of a level, by the previous level: three bits, the highest first, each given those before it.
    level: [[BitModel; 7]; 6],
    /// Corners of a triangle to which no edge leads. Contexts: positions of the first corner, positions of the others, and features.
    corner: NumberModel,
    /// Coordinates of a new vertex across the axis [`VertexPrediction::depth`].
    across: NumberModel,
    /// Coordinate of a new vertex along that axis.
    depth: NumberModel,
    smoothness: NumberModel,
    feature: NumberModel,
    /// Normals. Contexts: inside of the mesh, and at its border.
    normal: NumberModel,
}

impl Models {
    fn new() -> Self {
        Self {
            is_triangle: Default::default(),
            is_new: [BitModel::default(); 64],
            is_right: [BitModel::default(); 64],
            is_left: [BitModel::default(); 64],
            is_corner_new: Default::default(),
            age: NumberModel::new(1),
            is_same_level: Default::default(),
            level: Default::default(),
            corner: NumberModel::new(3),
            across: NumberModel::new(SIZE_CONTEXTS),
            depth: NumberModel::new(SIZE_CONTEXTS),
            smoothness: NumberModel::new(DIFFERENCE_CONTEXTS),
            feature: NumberModel::new(DIFFERENCE_CONTEXTS),
            normal: NumberModel::new(2),
        }
    }
}

/// Encoder or decoder of one chunk.
struct Walk<'a, C> {
    coder: C,
    models: Models,
    boundary: Boundary,
    mesh: Mesh,
    /// The mesh to encode; `None` in a decoder.
    known: Option<Known<'a>>,
    /// Number of triangles in the header.
    triangle_count: usize,
    /// Number of vertices in the header.
    vertex_count: usize,
    /// Level of the last triangle to which no edge led.
    start_level: u8,
    /// Edges to follow next, from the last one on.
    stack: Vec<EdgeId>,
}

impl<C: Coder> Walk<'_, C> {
    fn new(coder: C, header: &ChunkHeader) -> Self {
        Self {
            coder,
            models: Models::new(),
            boundary: Boundary::default(),
            mesh: Mesh::default(),
            known: None,
            triangle_count: header.index_count as usize / 3,
            vertex_count: header.vertex_count as usize,
            start_level: 0,
            stack: Vec::new(),
        }
    }

    /// Codes the whole mesh.
    fn run(&mut self) -> Result<(), String> {
        while self.mesh.triangles.len() < self.triangle_count {
            self.start()?;
            while let Some(edge) = self.stack.pop() {
                if self.boundary.is_open(edge) {
                    self.follow(edge)?;
                }
            }
        }
        self.code_normals();
        Ok(())
    }

    /// Codes a triangle to which no edge leads.
    fn start(&mut self) -> Result<(), String> {
        if self.coder.is_exhausted() {
            return Err(format!("payload ends after {} triangles", self.mesh.triangles.len()));
        }
        let seed = self.known.as_mut().map(Known::start);
        let (known_level, known_corners) = match (&self.known, seed) {
            (Some(known), Some(seed)) => (known.levels[seed], known.triangles[seed]),
            _ => (0, [0; 3]),
        };
        let level = self.code_level(self.start_level, known_level)?;
        self.start_level = level;
        let mut corners = [0; 3];
        for (index, known_corner) in known_corners.into_iter().enumerate() {
            let number = self
                .known
                .as_ref()
                .and_then(|known| known.numbers[known_corner as usize]);
            let is_new = self.coder.bit(&mut self.models.is_corner_new[index], number.is_none());
            corners[index] = if is_new {
                self.add_corner(index, known_corner)?
            } else {
                self.code_old_vertex(number)?
            };
        }
        self.mesh.add_triangle(corners, level);
        self.stack.extend(self.boundary.start(corners, level));
        Ok(())
    }

    /// Codes the triangle behind an edge, if there is one.
    fn follow(&mut self, id: EdgeId) -> Result<(), String> {
        let (edge, previous, next) = (
            self.boundary.edge(id),
            self.boundary.previous(id),
            self.boundary.next(id),
        );
        let uncovered = self.known.as_mut().and_then(|known| known.follow(id));
        let context = usize::from(previous.is_border) + 2 * usize::from(next.is_border);
        if !self
            .coder
            .bit(&mut self.models.is_triangle[context], uncovered.is_some())
        {
            self.boundary.set_border(id);
            return Ok(());
        }
        if self.mesh.triangles.len() == self.triangle_count || self.coder.is_exhausted() {
            return Err(format!(
                "payload has more than the {} triangles of the header, or ends early",
                self.triangle_count
            ));
        }
        let known = self.known.as_ref().zip(uncovered);
        let known_level = known.map_or(0, |(known, (triangle, _))| known.levels[triangle]);
        let context = usize::from(previous.level != edge.level) + 2 * usize::from(next.level != edge.level);
        let is_same = self
            .coder
            .bit(&mut self.models.is_same_level[context], known_level == edge.level);
        let level = if is_same {
            edge.level
        } else {
            self.code_level(edge.level, known_level)?
        };
        let vertex = uncovered.map_or(0, |(_, vertex)| vertex);
        let number = self.known.as_ref().and_then(|known| known.numbers[vertex as usize]);
        let third = self.code_third(id, number);
        let number = match third {
            Third::New => self.add_vertex(id, vertex)?,
            Third::Right => next.to,
            Third::Left => previous.from,
            Third::Other => self.code_old_vertex(number)?,
        };
        self.mesh.add_triangle([edge.from, edge.to, number], level);
        let edges = self.boundary.cover(id, number, third, level);
        self.stack
            .extend(edges.into_iter().filter(|&edge| self.boundary.is_open(edge)));
        Ok(())
    }

    /// Codes which third vertex the triangle behind an edge has. `number`: number of the vertex, if the mesh is known and the vertex was
    /// coded.
    fn code_third(&mut self, id: EdgeId, number: Option<u32>) -> Third {
        let edge = self.boundary.edge(id);
        let is_right = number == Some(self.boundary.next(id).to);
        let is_left = number == Some(self.boundary.previous(id).from);
        let (coder, models, context) = (
            &mut self.coder,
            &mut self.models,
            self.mesh.edge_context(edge.from, edge.to),
        );
        if coder.bit(&mut models.is_new[context], number.is_none()) {
            Third::New
        } else if coder.bit(&mut models.is_right[context], is_right) {
            Third::Right
        } else if coder.bit(&mut models.is_left[context], is_left) {
            Third::Left
        } else {
            Third::Other
        }
    }

    /// Codes a level. `before`: an earlier level, which serves as context.
    fn code_level(&mut self, before: u8, known: u8) -> Result<u8, String> {
        let models = &mut self.models.level[usize::from(before)];
        let mut node = 1;
        for bit in (0..3).rev() {
            let bit = self.coder.bit(&mut models[node - 1], known >> bit & 1 == 1);
            node = 2 * node + usize::from(bit);
        }
        let level = node as u8 - 8;
        if level > 5 {
            return Err(format!("level {level}, expected 0 to 5"));
        }
        Ok(level)
    }

    /// Codes the number of a vertex that was coded before.
    fn code_old_vertex(&mut self, number: Option<u32>) -> Result<u32, String> {
        let last = self.mesh.vertices.len() as i32 - 1;
        let age = last - number.unwrap_or_default() as i32;
        let age = self.models.age.code(&mut self.coder, 0, age);
        match u32::try_from(last - age) {
            Ok(number) if age >= 0 => Ok(number),
            _ => Err(format!("vertex {} of {} that were coded", last - age, last + 1)),
        }
    }

    /// Begins a vertex. If the mesh is known, numbers the known vertex and returns it.
    fn begin_vertex(&mut self, vertex: u32) -> Result<WireVertex, String> {
        if self.mesh.vertices.len() == self.vertex_count {
            return Err(format!(
                "payload has more than the {} vertices of the header",
                self.vertex_count
            ));
        }
        self.boundary.add_vertex();
        let Some(known) = &mut self.known else {
            return Ok(WireVertex::default());
        };
        known.assign_number(vertex);
        Ok(known.vertices[vertex as usize])
    }

    /// Codes a new vertex that is a corner of a triangle to which no edge leads. It is predicted from the previous vertex.
    fn add_corner(&mut self, index: usize, vertex: u32) -> Result<u32, String> {
        let known = self.begin_vertex(vertex)?;
        let number = self.mesh.vertices.len() as u32;
        let before = self.mesh.vertices.last().copied().unwrap_or(WireVertex {
            position: [1024; 3],
            smoothness: 1 << 15,
            feature: 1 << 15,
            ..WireVertex::default()
        });
        let (coder, model) = (&mut self.coder, &mut self.models.corner);
        let mut coded = WireVertex::default();
        for axis in 0..3 {
            let (known, before) = (i32::from(known.position[axis]), i32::from(before.position[axis]));
            coded.position[axis] = (before + model.code(coder, usize::from(index > 0), known - before)) as i16;
        }
        let mut feature = |known, before| {
            let before = feature_step(before);
            checked_feature(before + model.code(coder, 2, feature_step(known) - before))
        };
        coded.smoothness = feature(known.smoothness, before.smoothness)?;
        coded.feature = feature(known.feature, before.feature)?;
        self.mesh.add_vertex(coded);
        Ok(number)
    }

    /// Codes a new vertex that is the third one of a triangle behind an edge.
    fn add_vertex(&mut self, id: EdgeId, vertex: u32) -> Result<u32, String> {
        let known = self.begin_vertex(vertex)?;
        let number = self.mesh.vertices.len() as u32;
        let edge = self.boundary.edge(id);
        let prediction = VertexPrediction::new(&self.mesh, edge.from, edge.to, edge.opposite);
        let (coder, models) = (&mut self.coder, &mut self.models);
        let known_position = known.position.map(i32::from);
        let mut position = [0; 3];
        for axis in [(prediction.depth + 1) % 3, (prediction.depth + 2) % 3] {
            let predicted = prediction.parallelogram[axis];
            let coordinate = predicted
                + models
                    .across
                    .code(coder, prediction.size, known_position[axis] - predicted);
            position[axis] = i32::from(coordinate as i16);
        }
        let (depth, predicted) = (prediction.depth, prediction.in_plane(position));
        position[depth] = predicted
            + models
                .depth
                .code(coder, prediction.size, known_position[depth] - predicted);
        let [a, b] = [edge.from, edge.to].map(|end| self.mesh.vertices[end as usize]);
        let mut feature = |model: &mut NumberModel, [known, a, b]: [u16; 3]| {
            let [known, a, b] = [known, a, b].map(feature_step);
            let (predicted, context) = ((a + b) >> 1, length(a - b).min(DIFFERENCE_CONTEXTS - 1));
            checked_feature(predicted + model.code(coder, context, known - predicted))
        };
        let smoothness = feature(&mut models.smoothness, [known.smoothness, a.smoothness, b.smoothness])?;
        let feature = feature(&mut models.feature, [known.feature, a.feature, b.feature])?;
        self.mesh.add_vertex(WireVertex {
            position: position.map(|coordinate| coordinate as i16),
            normal: [0; 2],
            smoothness,
            feature,
        });
        Ok(number)
    }

    /// Codes all normals. They come last, when all triangles are known.
    fn code_normals(&mut self) {
        let known: Option<Vec<WireVertex>> =
            (self.known.as_ref()).map(|known| known.order.iter().map(|&old| known.vertices[old as usize]).collect());
        let known_weights = known.as_ref().map_or([0; 3], |known| self.mesh.normal_weights(known));
        let weights = known_weights.map(|weight| self.coder.raw(16, u32::from(weight)) as u16);
        let is_on_boundary = self.boundary.boundary_vertices();
        for (vertex, &is_on_boundary) in is_on_boundary.iter().enumerate() {
            let predicted = self.mesh.predicted_normal(vertex, weights);
            for (axis, predicted) in predicted.into_iter().enumerate() {
                let known = known.as_ref().map_or(0, |known| i32::from(known[vertex].normal[axis]));
                let change = self
                    .models
                    .normal
                    .code(&mut self.coder, usize::from(is_on_boundary), known - predicted);
                self.mesh.vertices[vertex].normal[axis] = (predicted + change) as i8;
            }
        }
    }
}

/// Converts a coded step to a feature.
///
/// # Errors
/// The step is out of range.
fn checked_feature(step: i32) -> Result<u16, String> {
    feature_from_step(step).ok_or_else(|| format!("feature {step}, expected 0 to 256"))
}

#[cfg(test)]
mod tests;
