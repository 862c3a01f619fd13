//! Frames that wait until the writer takes them, and the bytes that they hold.

use std::collections::VecDeque;

use super::Outgoing;

/// Kinds of messages of which only the newest is sent. At most one message of each kind waits, even if the client does not read.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Newest {
    Opening,
    Group,
    Led,
    Posed,
}

/// A waiting frame. When a generation ends, its frames are dropped: all but [`Frame::Control`], [`Frame::Newest`] and [`Frame::Ping`].
pub(super) enum Frame {
    /// Belongs to no generation.
    Control(String),
    /// A message that replaces a waiting one of its kind.
    Newest(Newest, String),
    /// `prefix` or a chunk, of the surface of this number.
    Prefix(u8, Outgoing),
    /// `committed`: from here on the client holds this prefix.
    Commit(u8, String),
    /// Follows `committed`: the pong confirms that the client has received the whole step.
    Ping(u32),
    /// `done`: ends the generation.
    Done(u8, String),
    /// `annotated` or a chunk of an annotation, of the surface of this number: an edit drops it.
    Annotation(u8, Outgoing),
}

impl Frame {
    /// Returns the surface whose generation the frame belongs to.
    fn surface(&self) -> Option<u8> {
        match self {
            Self::Prefix(surface, _)
            | Self::Commit(surface, _)
            | Self::Done(surface, _)
            | Self::Annotation(surface, _) => Some(*surface),
            Self::Control(_) | Self::Newest(..) | Self::Ping(_) => None,
        }
    }

    fn is_newest(&self, kind: Newest) -> bool {
        matches!(self, Self::Newest(own_kind, _) if *own_kind == kind)
    }

    /// Whether the frame outlives a generation that ends.
    fn outlives_generation(&self) -> bool {
        self.surface().is_none()
    }

    /// Returns the bytes that the frame holds in memory.
    fn bytes(&self) -> usize {
        let payload = match self {
            Self::Control(text) | Self::Newest(_, text) | Self::Commit(_, text) | Self::Done(_, text) => text.len(),
            Self::Prefix(_, frame) | Self::Annotation(_, frame) => match frame {
                Outgoing::Text(text) => text.len(),
                Outgoing::Binary(chunk) => chunk.len(),
                Outgoing::Ping(_) | Outgoing::Close(_) => 0,
            },
            Self::Ping(_) => 0,
        };
        payload + size_of::<Self>()
    }
}

/// The queue of frames between the session and the writer.
#[derive(Default)]
pub(super) struct Outbox {
    frames: VecDeque<Frame>,
    /// Bytes of the frames that outlive a generation.
    kept_bytes: usize,
    /// Bytes of the other frames.
    surface_bytes: usize,
}

impl Outbox {
    /// Returns the bytes of frames that outlive a generation. Their number can grow if a client sends but does not read.
    pub(super) fn kept_bytes(&self) -> usize {
        self.kept_bytes
    }

    /// Returns the bytes of all generations' frames.
    pub(super) fn surface_bytes(&self) -> usize {
        self.surface_bytes
    }

    /// Returns the bytes of the next frame; `None` if no frame waits.
    pub(super) fn next_bytes(&self) -> Option<usize> {
        self.frames.front().map(Frame::bytes)
    }

    /// Returns the sum of bytes to which this frame counts.
    fn bytes_like(&mut self, frame: &Frame) -> &mut usize {
        if frame.outlives_generation() {
            &mut self.kept_bytes
        } else {
            &mut self.surface_bytes
        }
    }

    pub(super) fn push_back(&mut self, frame: Frame) {
        *self.bytes_like(&frame) += frame.bytes();
        self.frames.push_back(frame);
    }

    pub(super) fn push_front(&mut self, frame: Frame) {
        *self.bytes_like(&frame) += frame.bytes();
        self.frames.push_front(frame);
    }

    pub(super) fn pop_front(&mut self) -> Option<Frame> {
        let frame = self.frames.pop_front()?;
        *self.bytes_like(&frame) -= frame.bytes();
        Some(frame)
    }

    /// Replaces the waiting message of this kind, at the same place in the queue, because frames behind it may depend on it, as `opened`
    /// does on `led`. If no message of this kind waits, appends this one.
    pub(super) fn push_newest(&mut self, kind: Newest, text: String) {
        let frame = Frame::Newest(kind, text);
        let Some(index) = self.frames.iter().position(|waiting| waiting.is_newest(kind)) else {
            return self.push_back(frame);
        };
        self.kept_bytes += frame.bytes();
        let before = std::mem::replace(&mut self.frames[index], frame);
        self.kept_bytes -= before.bytes();
    }

    /// Drops the waiting message of this kind.
    pub(super) fn drop_newest(&mut self, kind: Newest) {
        if self.frames.iter().any(|frame| frame.is_newest(kind)) {
            self.retain(|frame| !frame.is_newest(kind));
        }
    }

    /// Drops annotations, of all surfaces.
    pub(super) fn drop_annotations(&mut self) {
        self.retain(|frame| !matches!(frame, Frame::Annotation(..)));
    }

    /// Drops the frames of a surface's generation.
    pub(super) fn drop_surface(&mut self, surface: u8) {
        self.retain(|frame| frame.surface() != Some(surface));
    }

    fn retain(&mut self, keep: impl Fn(&Frame) -> bool) {
        self.frames.retain(keep);
        let bytes = |outlives_generation| {
            self.frames
                .iter()
                .filter(|frame| frame.outlives_generation() == outlives_generation)
                .map(Frame::bytes)
                .sum()
        };
        (self.kept_bytes, self.surface_bytes) = (bytes(true), bytes(false));
    }
}

impl Extend<Frame> for Outbox {
    fn extend<T: IntoIterator<Item = Frame>>(&mut self, frames: T) {
        frames.into_iter().for_each(|frame| self.push_back(frame));
    }
}

#[cfg(test)]
mod tests {
    use super::{Frame, Newest, Outbox, Outgoing};

    #[test]
    fn the_newest_waits_where_the_one_before_did() {
        let mut outbox = Outbox::default();
        outbox.push_newest(Newest::Led, "1".into());
        outbox.push_back(Frame::Control("opened".into()));
        outbox.push_newest(Newest::Led, "23".into());
        assert!(matches!(outbox.pop_front(), Some(Frame::Newest(Newest::Led, text)) if text == "23"));
        assert!(matches!(outbox.pop_front(), Some(Frame::Control(_))));
        assert!(outbox.next_bytes().is_none() && outbox.kept_bytes() == 0);
    }

    #[test]
    fn bytes_are_those_of_the_frames_that_wait() {
        let mut outbox = Outbox::default();
        outbox.extend([
            Frame::Commit(0, "12345".into()),
            Frame::Control("123".into()),
            Frame::Newest(Newest::Opening, "1234".into()),
        ]);
        let of_frame = size_of::<Frame>();
        assert_eq!(
            (outbox.kept_bytes(), outbox.surface_bytes()),
            (2 * of_frame + 7, of_frame + 5)
        );
        outbox.push_newest(Newest::Led, "123".into());
        outbox.push_newest(Newest::Led, "12345".into());
        assert_eq!(outbox.kept_bytes(), 3 * of_frame + 12, "the newer one alone");
        outbox.drop_newest(Newest::Led);
        outbox.drop_newest(Newest::Opening);
        outbox.push_front(Frame::Done(2, "1".into()));
        assert_eq!(
            (outbox.kept_bytes(), outbox.surface_bytes()),
            (of_frame + 3, 2 * of_frame + 6)
        );
        outbox.drop_surface(2);
        assert_eq!(
            (outbox.kept_bytes(), outbox.surface_bytes()),
            (of_frame + 3, of_frame + 5),
            "of another surface"
        );
        outbox.push_back(Frame::Annotation(0, Outgoing::Text("12".into())));
        assert_eq!(outbox.surface_bytes(), 2 * of_frame + 7);
        outbox.drop_annotations();
        assert_eq!(
            (outbox.kept_bytes(), outbox.surface_bytes()),
            (of_frame + 3, of_frame + 5),
            "annotations alone"
        );
        outbox.drop_surface(0);
        assert_eq!((outbox.kept_bytes(), outbox.surface_bytes()), (of_frame + 3, 0));
        while outbox.pop_front().is_some() {}
        assert_eq!((outbox.kept_bytes(), outbox.next_bytes().is_none()), (0, true));
    }
}
