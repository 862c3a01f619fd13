//! A viewer: it decodes each frame, checks it against the protocol, and holds the surfaces.

use std::ops::Deref;

use serde_json::Value;
use tokio::io::{AsyncRead, AsyncWrite};
use tokio::net::TcpStream;

use crate::chunk::{Chunk, HEADER, Header};
use crate::connection::{Connection, RawFrame};
use crate::error::{Error, ensure};
use crate::frame::Frame;
use crate::surface::{Meshes, Pending, Surface};

/// A viewer of one volume.
pub struct Viewer<S = TcpStream> {
    /// Its connection.
    pub connection: Connection<S>,
    /// Surfaces by number.
    pub surfaces: [Surface; 4],
    /// Whether regions that have not changed may be sent again.
    pub may_repeat: bool,
    /// At most one at a time over all surfaces.
    pending: Option<Pending>,
    /// Bytes that the last `opening` stated since `open` was sent.
    read_bytes: u64,
    /// Whether the last `open` or `join` requested other codings of chunks.
    requests_codings: bool,
    /// Whether that request named values.
    requests_values: bool,
}

/// Surface 0.
impl<S> Deref for Viewer<S> {
    type Target = Surface;

    fn deref(&self) -> &Surface {
        &self.surfaces[0]
    }
}

impl<S: AsyncRead + AsyncWrite + Unpin> Viewer<S> {
    /// Returns a viewer that has opened no volume.
    pub fn new(connection: Connection<S>) -> Self {
        Self {
            connection,
            surfaces: Default::default(),
            may_repeat: false,
            pending: None,
            read_bytes: 0,
            requests_codings: false,
            requests_values: false,
        }
    }

    /// Sends a message. `open` and `join` must be sent with this function.
    pub async fn send(&mut self, message: &Value) -> Result<(), Error> {
        if message["type"] == "open" || message["type"] == "join" {
            self.requests_codings = message["codings"].is_array();
            let codings = message["codings"].as_array();
            self.requests_values = codings.is_some_and(|codings| codings.iter().any(|coding| coding == "values"));
            self.read_bytes = 0;
        }
        self.connection.send(message).await
    }

    /// Returns the next frame, checked. Cancel-safe.
    pub async fn next(&mut self) -> Result<Frame, Error> {
        match self.connection.next().await {
            Ok(RawFrame::Text(text)) => {
                let frame = Frame::read(&text)?;
                self.on_message(&frame)?;
                Ok(frame)
            }
            Ok(RawFrame::Chunk(bytes)) => {
                let header = Header::new(&bytes)?;
                match header.kind() {
                    1 => self.on_errors(header, &bytes[HEADER..]),
                    _ => self.on_chunk(Chunk::decode(&bytes)?),
                }
            }
            Err(Error::Closed(code)) => Ok(Frame::Closed { code }),
            Err(error) => Err(error),
        }
    }

    fn surface(&mut self, number: u8) -> &mut Surface {
        &mut self.surfaces[usize::from(number)]
    }

    fn on_message(&mut self, frame: &Frame) -> Result<(), Error> {
        match *frame {
            Frame::Opening { bytes, total_bytes, .. } => {
                let before = std::mem::replace(&mut self.read_bytes, bytes);
                let is_ascending = before <= bytes && bytes <= total_bytes;
                ensure(is_ascending, || format!("{frame:?} after {before} bytes"))
            }
            Frame::Opened { .. } => {
                self.surfaces.iter_mut().for_each(Surface::on_opened);
                self.pending = None;
                Ok(())
            }
            Frame::Prefix(ref announced) => {
                ensure(self.pending.is_none(), || format!("inside another prefix: {frame:?}"))?;
                self.pending = Some(Pending {
                    announced: announced.clone(),
                    chunks: Meshes::new(),
                });
                self.surface(announced.surface).on_prefix(announced)
            }
            Frame::Committed {
                surface,
                generation,
                level,
                is_final,
            } => {
                let outside = || Error::Violation(format!("outside a prefix: {frame:?}"));
                let pending = self.pending.take().ok_or_else(outside)?;
                self.surface(surface)
                    .on_committed((surface, generation, level, is_final), pending)
            }
            Frame::Done {
                surface,
                generation,
                ref statistics,
                ..
            } => {
                self.check_outside(surface, frame)?;
                self.surface(surface).on_done(generation, statistics)
            }
            Frame::Measured {
                surface,
                generation,
                ref regions,
                ..
            } => self.surface(surface).on_measured(generation, regions),
            Frame::Superseded { surface, generation } => {
                self.pending.take_if(|pending| pending.announced.surface == surface);
                self.surface(surface).on_superseded(generation)
            }
            Frame::Removed { surface } => {
                self.check_outside(surface, frame)?;
                self.surface(surface).on_removed()
            }
            Frame::Answer { generation, .. } => {
                let newest = self.surfaces.iter().map(Surface::generation).max();
                ensure(Some(generation) <= newest, || {
                    format!("of a generation to come: {frame:?}")
                })
            }
            _ => Ok(()),
        }
    }

    /// Checks that a frame does not come inside a prefix of its surface.
    fn check_outside(&self, surface: u8, frame: &Frame) -> Result<(), Error> {
        let is_outside = self
            .pending
            .as_ref()
            .is_none_or(|pending| pending.announced.surface != surface);
        ensure(is_outside, || format!("inside a prefix: {frame:?}"))
    }

    /// Checks a chunk of kind `error`.
    fn on_errors(&mut self, header: Header<'_>, payload: &[u8]) -> Result<Frame, Error> {
        let (number, region) = (header.surface(), header.region());
        let surface = self.surface(number);
        ensure(header.generation() <= surface.generation(), || {
            "distances of a generation to come".into()
        })?;
        ensure(surface.may_annotate(), || "distances before rest".into())?;
        let held = surface
            .shown
            .get(&region)
            .map(|mesh| (mesh.vertices.len(), 3 * mesh.triangles.len()));
        let counts = (header.vertex_count(), header.index_count());
        ensure(held == Some(counts), || {
            format!("distances of {region:?}: counts {counts:?}, held {held:?}")
        })?;
        let bytes = 4 * counts.0;
        let stated = (header.u32(64) as usize, header.u32(68));
        ensure(stated == (bytes, 0) && payload.len() == bytes, || {
            format!("distances of {region:?}: payloads of {stated:?} bytes")
        })?;
        let distances = payload.as_chunks().0.iter().map(|bytes| f32::from_le_bytes(*bytes));
        Ok(Frame::Errors {
            surface: number,
            generation: header.generation(),
            region,
            distances: distances.collect(),
        })
    }

    /// Checks a chunk of kind `cut` and holds it until `committed`.
    fn on_chunk(&mut self, chunk: Chunk) -> Result<Frame, Error> {
        let frame = Frame::Chunk {
            surface: chunk.surface,
            generation: chunk.generation,
            level: chunk.prefix_level,
            region: chunk.region,
            bytes: chunk.frame_bytes,
            triangles: chunk.triangles.len(),
        };
        let is_requested =
            (self.requests_codings || !chunk.is_predictive) && (self.requests_values || chunk.values.is_none());
        ensure(is_requested, || format!("a coding that was not requested: {frame:?}"))?;
        let held = self.surfaces[usize::from(chunk.surface)].shown.get(&chunk.region);
        let is_change = held.map_or(!chunk.vertices.is_empty(), |held| {
            self.may_repeat || !held.same_mesh(&chunk)
        });
        ensure(is_change, || format!("no change of what the client holds: {frame:?}"))?;
        let outside = || Error::Violation(format!("outside a prefix: {frame:?}"));
        let pending = self.pending.as_mut().ok_or_else(outside)?;
        let announced = &pending.announced;
        let is_of_prefix = (chunk.surface, chunk.generation, chunk.prefix_level)
            == (announced.surface, announced.generation, announced.level);
        let names_values = chunk.values.is_none() || announced.color_field.is_some();
        ensure(is_of_prefix && names_values, || format!("{frame:?} in {announced:?}"))?;
        let before = pending.chunks.insert(chunk.region, chunk);
        ensure(before.is_none(), || format!("a region twice in one prefix: {frame:?}"))?;
        Ok(frame)
    }
}
