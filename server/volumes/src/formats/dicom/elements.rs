//! Data elements: tag, length and value, nested in sequences (DICOM part 5, chapter 7).
//!
//! Only the values of the tags in [`tag`] are kept. All others, such as the patient's name and numbers, are skipped unread: data
//! that is not in memory cannot be shown. Reading is bounded by the file: lengths are compared with the remaining bytes before anything is
//! allocated, and nesting has a limit. The crates that read whole objects allocate what a length claims, and recurse for every level of nesting.

use std::io::{self, BufReader, Read};

use flate2::bufread::DeflateDecoder;

use super::super::super::location::BlobReader;
use super::data_set::{DataSet, Fault, Tag, is_kept, is_sequence, tag};

const ITEM: Tag = 0xfffe_e000;
const ITEM_END: Tag = 0xfffe_e00d;
const SEQUENCE_END: Tag = 0xfffe_e0dd;
/// Length of a value that ends with a delimiter.
const UNDEFINED: u32 = u32::MAX;
/// Maximum nesting of sequences; real files have about five levels.
const MAX_DEPTH: u32 = 16;
/// Maximum bytes of a value that is kept; the longest is a list of offsets, of some thousand frames.
const MAX_VALUE_BYTES: u32 = 1 << 17;

/// Encoding of elements.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Writing {
    /// Whether value representations are left out.
    pub implicit: bool,
    /// Whether numbers are big-endian.
    pub big: bool,
}

/// The pixel data element, whose value is not read with the others.
#[derive(Clone, Copy, Debug)]
pub struct PixelElement {
    pub tag: Tag,
    /// Whether the samples were written in 16-bit words, whose bytes are swapped in big-endian files.
    pub words: bool,
    /// Offset of the value in the stream.
    pub at: u64,
    /// Bytes of the value. `None`: fragments up to a delimiter.
    pub bytes: Option<u32>,
}

/// A stream that can skip bytes.
pub trait Stream: Read {
    fn pass(&mut self, bytes: u64) -> io::Result<()>;
}

impl Stream for BufReader<BlobReader<'_>> {
    fn pass(&mut self, bytes: u64) -> io::Result<()> {
        self.seek_relative(i64::try_from(bytes).map_err(|_| io::ErrorKind::UnexpectedEof)?)
    }
}

impl Stream for DeflateDecoder<BufReader<BlobReader<'_>>> {
    fn pass(&mut self, bytes: u64) -> io::Result<()> {
        if io::copy(&mut self.take(bytes), &mut io::sink())? < bytes {
            return Err(io::ErrorKind::UnexpectedEof.into());
        }
        Ok(())
    }
}

/// Header of an element: tag, value representation and length.
struct Head {
    tag: Tag,
    representation: Option<[u8; 2]>,
    bytes: u32,
}

impl Head {
    fn is_sequence(&self) -> bool {
        match self.representation {
            Some([b'S', b'Q']) => true,
            Some([b'U', b'N']) | None => self.bytes == UNDEFINED || is_sequence(self.tag),
            Some(_) => self.bytes == UNDEFINED,
        }
    }
}

/// Reads elements from a stream.
pub struct Elements<S> {
    stream: S,
    writing: Writing,
    /// Bytes that were read or skipped.
    at: u64,
    /// Largest possible value of `at`.
    end: u64,
}

impl<S: Stream> Elements<S> {
    /// `end`: length of the stream in bytes, or an upper bound of it if only reading tells (a deflated stream).
    pub fn new(stream: S, writing: Writing, at: u64, end: u64) -> Self {
        Self {
            stream,
            writing,
            at,
            end,
        }
    }

    fn take<const N: usize>(&mut self) -> io::Result<[u8; N]> {
        let mut bytes = [0; N];
        self.stream.read_exact(&mut bytes)?;
        self.at += N as u64;
        Ok(bytes)
    }

    fn u16(&mut self) -> io::Result<u16> {
        let bytes = self.take()?;
        Ok(if self.writing.big {
            u16::from_be_bytes(bytes)
        } else {
            u16::from_le_bytes(bytes)
        })
    }

    fn u32(&mut self) -> io::Result<u32> {
        let bytes = self.take()?;
        Ok(if self.writing.big {
            u32::from_be_bytes(bytes)
        } else {
            u32::from_le_bytes(bytes)
        })
    }

    fn pass(&mut self, tag: Tag, bytes: u32) -> Result<(), Fault> {
        self.check(tag, bytes)?;
        self.stream.pass(bytes.into())?;
        self.at += u64::from(bytes);
        Ok(())
    }

    /// Checks that a length does not exceed the remaining bytes.
    fn check(&self, tag: Tag, bytes: u32) -> Result<(), Fault> {
        let left = self.end.saturating_sub(self.at);
        if u64::from(bytes) > left {
            return Err(Fault::of(tag, format!("{bytes} bytes, the file has {left} there")));
        }
        Ok(())
    }

    /// Reads the next head; `None` if the stream ends before it.
    fn head(&mut self) -> Result<Option<Head>, Fault> {
        let mut first = [0];
        if self.stream.read(&mut first)? == 0 {
            return Ok(None);
        }
        let [second, low, high] = self.take()?;
        self.at += 1;
        let (group, element) = ([first[0], second], [low, high]);
        let tag = if self.writing.big {
            u32::from(u16::from_be_bytes(group)) << 16 | u32::from(u16::from_be_bytes(element))
        } else {
            u32::from(u16::from_le_bytes(group)) << 16 | u32::from(u16::from_le_bytes(element))
        };
        if self.writing.implicit || matches!(tag, ITEM | ITEM_END | SEQUENCE_END) {
            let bytes = self.u32()?;
            let representation = None;
            return Ok(Some(Head {
                tag,
                representation,
                bytes,
            }));
        }
        let representation = self.take()?;
        if !representation.iter().all(u8::is_ascii_uppercase) {
            let why = "no value representation, expected two letters as in AE, or another transfer syntax";
            return Err(Fault::of(tag, why));
        }
        let is_long = matches!(
            &representation,
            b"OB" | b"OD" | b"OF" | b"OL" | b"OV" | b"OW" | b"SQ" | b"SV" | b"UC" | b"UN" | b"UR" | b"UT" | b"UV"
        );
        let bytes = if is_long {
            let [_, _] = self.take()?;
            self.u32()?
        } else {
            self.u16()?.into()
        };
        let representation = Some(representation);
        Ok(Some(Head {
            tag,
            representation,
            bytes,
        }))
    }

    /// Reads the group of file meta elements at the beginning of a file. Also returns the offset of what follows it.
    pub fn meta(mut self) -> Result<(DataSet, u64), Fault> {
        let mut meta = DataSet::default();
        loop {
            let at = self.at;
            match self.head() {
                Ok(Some(head)) if head.tag >> 16 == 2 => self.element(&head, Some(&mut meta), 0)?,
                // The data set that follows may have another encoding.
                Ok(_) => return Ok((meta, at)),
                Err(_) if self.at > at => return Ok((meta, at)),
                Err(fault) => return Err(fault),
            }
        }
    }

    /// Reads the data set up to its pixel data. The second value is `None` if it has no pixel data.
    pub fn data_set(mut self) -> Result<(DataSet, Option<PixelElement>), Fault> {
        let mut set = DataSet {
            big: self.writing.big,
            ..DataSet::default()
        };
        while let Some(head) = self.head()? {
            if matches!(head.tag, tag::PIXELS | tag::FLOAT_PIXELS | tag::DOUBLE_PIXELS) {
                let bytes = (head.bytes != UNDEFINED).then_some(head.bytes);
                self.check(head.tag, bytes.unwrap_or(0))?;
                let pixels = PixelElement {
                    tag: head.tag,
                    words: head.representation.is_none_or(|r| &r == b"OW"),
                    at: self.at,
                    bytes,
                };
                return Ok((set, Some(pixels)));
            }
            self.element(&head, Some(&mut set), 0)?;
        }
        Ok((set, None))
    }

    /// Reads or skips the value behind a head. Keeps it in `set` if `set` is given and the tag is one that is kept.
    fn element(&mut self, head: &Head, set: Option<&mut DataSet>, depth: u32) -> Result<(), Fault> {
        let set = set.filter(|_| is_kept(head.tag));
        if head.is_sequence() {
            if set.is_none() && head.bytes != UNDEFINED {
                return self.pass(head.tag, head.bytes);
            }
            // An unknown representation and length: the encoding inside is implicit, whatever that of the file (part 5, 6.2.2).
            let outside = self.writing;
            self.writing.implicit |= head.representation == Some(*b"UN");
            let items = self.sequence(head, set.is_some(), depth + 1)?;
            self.writing = outside;
            if let Some(set) = set {
                set.sequences.insert(head.tag, items);
            }
            return Ok(());
        }
        let Some(set) = set else {
            return self.pass(head.tag, head.bytes);
        };
        if head.bytes > MAX_VALUE_BYTES {
            let why = format!("{} bytes, expected at most {MAX_VALUE_BYTES}", head.bytes);
            return Err(Fault::of(head.tag, why));
        }
        self.check(head.tag, head.bytes)?;
        let mut value = vec![0; head.bytes as usize];
        self.stream.read_exact(&mut value)?;
        self.at += u64::from(head.bytes);
        set.values.insert(head.tag, value);
        Ok(())
    }

    /// Reads the items of a sequence. Returns none if `keep` is false.
    fn sequence(&mut self, head: &Head, keep: bool, depth: u32) -> Result<Vec<DataSet>, Fault> {
        if depth > MAX_DEPTH {
            return Err(Fault::of(
                head.tag,
                format!("more than {MAX_DEPTH} sequences in each other"),
            ));
        }
        let end = self.end_of(head)?;
        let mut items = Vec::new();
        while end.is_none_or(|end| self.at < end) {
            let item = self.head()?.ok_or(io::Error::from(io::ErrorKind::UnexpectedEof))?;
            match item.tag {
                SEQUENCE_END if end.is_none() => break,
                // Fragments contain only bytes.
                ITEM if matches!(head.tag, tag::PIXELS) && item.bytes != UNDEFINED => {
                    self.pass(head.tag, item.bytes)?
                }
                ITEM if !keep && item.bytes != UNDEFINED => self.pass(head.tag, item.bytes)?,
                ITEM => {
                    let set = self.item(&item, keep, depth)?;
                    items.extend(keep.then_some(set));
                }
                _ => {
                    return Err(Fault::of(
                        head.tag,
                        "holds what is no item, expected items and their end",
                    ));
                }
            }
        }
        Ok(items)
    }

    fn item(&mut self, item: &Head, keep: bool, depth: u32) -> Result<DataSet, Fault> {
        let end = self.end_of(item)?;
        let mut set = DataSet {
            big: self.writing.big,
            ..DataSet::default()
        };
        while end.is_none_or(|end| self.at < end) {
            let head = self.head()?.ok_or(io::Error::from(io::ErrorKind::UnexpectedEof))?;
            if head.tag == ITEM_END && end.is_none() {
                break;
            }
            self.element(&head, keep.then_some(&mut set), depth)?;
        }
        Ok(set)
    }

    /// Returns the offset at which a sequence or an item ends, if its head states the length.
    fn end_of(&self, head: &Head) -> Result<Option<u64>, Fault> {
        if head.bytes == UNDEFINED {
            return Ok(None);
        }
        self.check(head.tag, head.bytes)?;
        Ok(Some(self.at + u64::from(head.bytes)))
    }

    /// Returns offset and length of the fragments of encapsulated pixel data. The first one is a table of offsets.
    pub fn fragments(mut self) -> Result<Vec<(u64, u32)>, Fault> {
        let mut found = Vec::new();
        loop {
            let head = self.head()?;
            match head {
                Some(Head { tag: ITEM, bytes, .. }) if bytes != UNDEFINED => {
                    found.push((self.at, bytes));
                    self.pass(tag::PIXELS, bytes)?;
                }
                Some(Head { tag: SEQUENCE_END, .. }) => return Ok(found),
                _ => {
                    return Err(Fault::of(
                        tag::PIXELS,
                        "no end of the fragments, expected items and their end",
                    ));
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::super::super::FileLocation;
    use super::*;

    const EXPLICIT: Writing = Writing {
        implicit: false,
        big: false,
    };

    fn read(writing: Writing, bytes: Vec<u8>) -> Result<DataSet, Fault> {
        let location = FileLocation::bytes("a", bytes);
        let blob = location.open().unwrap();
        let stream = BufReader::new(blob.reader(0));
        Elements::new(stream, writing, 0, blob.len())
            .data_set()
            .map(|(set, _)| set)
    }

    /// An element with a value representation of the short kind.
    fn short(tag: Tag, representation: &[u8], value: &[u8]) -> Vec<u8> {
        let [group, element] = [(tag >> 16) as u16, tag as u16].map(u16::to_le_bytes);
        let length = (value.len() as u16).to_le_bytes();
        [&group, &element, representation, &length, value].concat()
    }

    /// A sequence whose head has this length, which may be the mark of an unknown one.
    fn sequence(tag: Tag, representation: &[u8], length: u32, content: &[u8]) -> Vec<u8> {
        let mut head = short(tag, representation, &[]);
        head.truncate(6);
        [&head[..], &[0, 0], &length.to_le_bytes(), content].concat()
    }

    fn bare(tag: Tag, value: &[u8]) -> Vec<u8> {
        let [group, element] = [(tag >> 16) as u16, tag as u16].map(u16::to_le_bytes);
        [&group, &element, &(value.len() as u32).to_le_bytes()[..], value].concat()
    }

    const END: [u8; 8] = [0xfe, 0xff, 0xdd, 0xe0, 0, 0, 0, 0];
    const ITEM_END_BYTES: [u8; 8] = [0xfe, 0xff, 0x0d, 0xe0, 0, 0, 0, 0];
    const OPEN_ITEM: [u8; 8] = [0xfe, 0xff, 0x00, 0xe0, 0xff, 0xff, 0xff, 0xff];

    #[test]
    fn sequences_end_by_length_or_delimiter() {
        let inside = short(tag::PIXEL_SPACING, b"DS", b"1\\2 ");
        let open = [&OPEN_ITEM[..], &inside, &ITEM_END_BYTES, &END].concat();
        let closed = bare(ITEM, &inside);
        // The encoding inside of an unknown representation is implicit.
        let unknown = [
            &OPEN_ITEM[..],
            &bare(tag::PIXEL_SPACING, b"1\\2 "),
            &ITEM_END_BYTES,
            &END,
        ]
        .concat();
        for (what, bytes) in [
            ("open", sequence(tag::PIXEL_MEASURES, b"SQ", UNDEFINED, &open)),
            (
                "closed",
                sequence(tag::PIXEL_MEASURES, b"SQ", closed.len() as u32, &closed),
            ),
            ("unknown", sequence(tag::PIXEL_MEASURES, b"UN", UNDEFINED, &unknown)),
        ] {
            let after = short(tag::ROWS, b"US", &[7, 0]);
            let set = read(EXPLICIT, [bytes, after].concat()).unwrap();
            let items = set.items(tag::PIXEL_MEASURES);
            assert_eq!(items.len(), 1, "{what}");
            assert_eq!(items[0].array(tag::PIXEL_SPACING).unwrap(), Some([1.0, 2.0]), "{what}");
            assert_eq!(set.short(tag::ROWS).unwrap(), Some(7), "{what}");
        }
    }

    #[test]
    fn what_names_a_patient_is_not_kept() {
        const NAME: Tag = 0x0010_0010;
        let set = read(EXPLICIT, short(NAME, b"PN", b"A^B ")).unwrap();
        assert!(set.values.is_empty() && set.text(NAME).is_none());
    }

    #[test]
    fn words_follow_the_byte_order() {
        let big = Writing {
            implicit: false,
            big: true,
        };
        let set = read(big, vec![0, 0x28, 0, 0x10, b'U', b'S', 0, 2, 1, 2]).unwrap();
        assert_eq!(set.short(tag::ROWS).unwrap(), Some(0x102));
    }

    #[test]
    fn lengths_are_compared_with_the_file() {
        let long = sequence(tag::FRAME_OFFSETS, b"UT", 100_000, b"1");
        assert!(
            read(EXPLICIT, long)
                .unwrap_err()
                .why
                .contains("100000 bytes, the file has 1 there")
        );
        let longer = sequence(tag::FRAME_OFFSETS, b"UT", 0x7fff_ffff, b"1");
        assert!(read(EXPLICIT, longer).unwrap_err().why.contains("expected at most"));
        let passed = sequence(0x0008_1111, b"SQ", 0x7fff_ffff, b"1");
        assert!(read(EXPLICIT, passed).unwrap_err().why.contains("the file has 1 there"));
    }

    #[test]
    fn nesting_has_a_limit() {
        let mut bytes = Vec::new();
        for _ in 0..100_000 {
            bytes.extend(sequence(0x0008_1111, b"SQ", UNDEFINED, &OPEN_ITEM));
        }
        assert!(
            read(EXPLICIT, bytes)
                .unwrap_err()
                .why
                .contains("more than 16 sequences")
        );
    }
}
