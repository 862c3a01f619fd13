//! Detects the beginning of a DICOM file: with a preamble and `DICM` (part 10, chapter 7), or without, as archives and old programs write.

use super::super::super::FileLocation;
use super::super::super::location::Blob;
use super::elements::Writing;

/// Bytes of the preamble with the magic number behind it.
const PREAMBLE_BYTES: usize = 132;
const MAGIC: &[u8] = b"DICM";
/// Bytes at the beginning of a file that are examined.
const HEAD_BYTES: usize = 256;
/// Group of the file meta elements, and of the first elements of a data set.
const META: u16 = 2;
const IDENTIFYING: u16 = 8;

/// What a file begins with.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Beginning {
    /// The file meta elements, at this offset.
    Meta { at: u64, has_preamble: bool },
    /// The data set itself, with an assumed encoding.
    DataSet(Writing),
}

/// Whether a file that begins so is DICOM.
pub fn is_dicom(head: &[u8]) -> bool {
    Beginning::of(head).is_some()
}

impl Beginning {
    pub fn of_file(location: &FileLocation) -> Option<Self> {
        Self::of_blob(&location.open().ok()?)
    }

    pub fn of_blob(blob: &Blob<'_>) -> Option<Self> {
        Self::of(&blob.head(HEAD_BYTES).ok()?)
    }

    fn of(head: &[u8]) -> Option<Self> {
        let meta = |at: usize, has_preamble| Self::Meta {
            at: at as u64,
            has_preamble,
        };
        if head.get(PREAMBLE_BYTES - MAGIC.len()..PREAMBLE_BYTES) == Some(MAGIC) {
            return Some(meta(PREAMBLE_BYTES, true));
        }
        let begins_meta = |at: usize| head.get(at..).is_some_and(|rest| next(rest, META, false).is_some());
        if head.starts_with(MAGIC) && begins_meta(MAGIC.len()) {
            return Some(meta(MAGIC.len(), false));
        }
        if begins_meta(0) {
            return Some(meta(0, false));
        }
        let writings = [false, true].map(|implicit| Writing { implicit, big: false });
        let begins_so = |writing: &Writing| next(head, IDENTIFYING, writing.implicit).is_some();
        writings.into_iter().find(begins_so).map(Self::DataSet)
    }

    /// Returns what was assumed because the file does not state it; `None` if nothing was.
    pub const fn repair(self) -> Option<&'static str> {
        match self {
            Self::Meta { has_preamble: true, .. } => None,
            Self::Meta { .. } => Some("the 128 bytes before the file meta elements are missing"),
            Self::DataSet(Writing { implicit: true, .. }) => {
                Some("the file meta elements are missing: implicit little endian was taken")
            }
            Self::DataSet(_) => Some("the file meta elements are missing: explicit little endian was taken"),
        }
    }
}

/// Returns what follows the first element, if that is one of `group` and another one of the group follows: two in ascending order are no
/// coincidence.
fn next(head: &[u8], group: u16, implicit: bool) -> Option<&[u8]> {
    let short = |at: usize| Some(u16::from_le_bytes([*head.get(at)?, *head.get(at + 1)?]));
    let (first_group, first, low, high) = (short(0)?, short(2)?, short(4)?, short(6)?);
    let value = match head.get(4..6)? {
        _ if implicit => 8 + (usize::from(high) << 16 | usize::from(low)),
        b"OB" => 12 + (usize::from(short(10)?) << 16 | usize::from(short(8)?)),
        letters if letters.iter().all(u8::is_ascii_uppercase) => 8 + usize::from(high),
        _ => return None,
    };
    let rest = head.get(value..)?;
    let second = |at: usize| Some(u16::from_le_bytes([*rest.get(at)?, *rest.get(at + 1)?]));
    (first_group == group && second(0)? == group && second(2)? > first).then_some(rest)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Two elements of a group, of two bytes each.
    fn elements(group: u8, implicit: bool) -> Vec<u8> {
        let element = |number: u8| match implicit {
            true => vec![group, 0, number, 0, 2, 0, 0, 0, b'1', b' '],
            false => vec![group, 0, number, 0, b'U', b'I', 2, 0, b'1', b' '],
        };
        [element(5), element(8)].concat()
    }

    #[test]
    fn files_begin_with_or_without_a_preamble() {
        let whole = [vec![0; 128], MAGIC.to_vec(), elements(2, false)].concat();
        let found = |head: &[u8]| Beginning::of(head);
        let meta = |at, has_preamble| Some(Beginning::Meta { at, has_preamble });
        assert_eq!(found(&whole), meta(132, true));
        assert_eq!(found(&whole[128..]), meta(4, false));
        assert_eq!(found(&whole[132..]), meta(0, false));
        for implicit in [false, true] {
            let writing = Writing { implicit, big: false };
            assert_eq!(found(&elements(8, implicit)), Some(Beginning::DataSet(writing)));
        }
    }

    #[test]
    fn other_files_are_none() {
        let one = &elements(8, false)[..10];
        let descending = [&elements(8, true)[10..], &elements(8, true)[..10]].concat();
        for head in [
            &b""[..],
            b"DICM",
            one,
            &descending,
            &[8; 64],
            &[0; 256],
            &elements(9, false),
        ] {
            assert_eq!(Beginning::of(head), None, "{head:?}");
        }
    }
}
