//! USDZ (<https://openusd.org/release/spec_usdz.html>): a layer of Universal Scene Description in a ZIP, stored at a multiple of 64 bytes.
//!
//! The ZIP is written by hand. Readers of USDZ go from one local header to the next, so the size and checksum must stand before the
//! content. No library writes them there unless the output can seek.

use std::io::{self, Write};

use flate2::Crc;

use super::{ExportError, Mesh, fits_u32, usda};

const LAYER: &str = "surfaces.usda";
/// Multiple of bytes at which content begins.
const ALIGNMENT: usize = 64;
/// Bytes of a local header without the name.
const HEADER_BYTES: usize = 30;
/// Extra field that moves the content, with the id that OpenUSD's writer uses.
const PADDING_ID: u16 = 0x1986;
/// Bytes of that field's id and length.
const PADDING_HEAD: usize = 4;
/// Bytes of the extra field.
const PADDING: usize = ALIGNMENT - HEADER_BYTES - LAYER.len();
const _: () = assert!(PADDING >= PADDING_HEAD);
/// Version of ZIP that a reader needs.
const VERSION: u16 = 10;
/// The first day that a ZIP can state. It is fixed, so that equal requests have equal files.
const DATE: u16 = 1 << 5 | 1;

/// Writes `meshes` as a stage. The text is generated twice, because its length and checksum come first.
///
/// # Errors
/// More than 4 GiB, or the errors of `out`.
pub fn write(meshes: &[Mesh], out: &mut impl Write) -> Result<(), ExportError> {
    let mut measure = Measure::default();
    usda::write(meshes, &mut measure)?;
    let about = about(measure.crc.sum(), fits_u32("bytes of text", measure.bytes, "USDZ")?);
    fits_u32("file size in bytes", file_bytes(measure.bytes), "USDZ")?;

    out.write_all(b"PK\x03\x04")?;
    out.write_all(&about)?;
    out.write_all(&(PADDING as u16).to_le_bytes())?;
    out.write_all(LAYER.as_bytes())?;
    out.write_all(&PADDING_ID.to_le_bytes())?;
    out.write_all(&((PADDING - PADDING_HEAD) as u16).to_le_bytes())?;
    out.write_all(&[0; PADDING - PADDING_HEAD])?;
    usda::write(meshes, out)?;
    out.write_all(&directory(&about, measure.bytes))?;
    Ok(())
}

/// Counts bytes, computes their checksum, and discards them.
#[derive(Default)]
struct Measure {
    bytes: u64,
    crc: Crc,
}

impl Write for Measure {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.bytes += bytes.len() as u64;
        self.crc.update(bytes);
        Ok(bytes.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

/// Returns what the local header and the directory both state about the layer: from the version to the length of the name.
fn about(crc: u32, bytes: u32) -> Vec<u8> {
    // No flags, and no method: the content is stored.
    let shorts = [VERSION, 0, 0, 0, DATE].map(u16::to_le_bytes).concat();
    let words = [crc, bytes, bytes].map(u32::to_le_bytes).concat();
    [shorts, words, (LAYER.len() as u16).to_le_bytes().to_vec()].concat()
}

/// Bytes of the directory's entry without the name, and bytes of the end of the directory.
const ENTRY_BYTES: usize = 46;
const END_BYTES: usize = 22;

fn file_bytes(text: u64) -> u64 {
    (ALIGNMENT + ENTRY_BYTES + LAYER.len() + END_BYTES) as u64 + text
}

/// Returns the central directory of an archive whose layer has `text` bytes.
fn directory(about: &[u8], text: u64) -> Vec<u8> {
    let mut entry = b"PK\x01\x02".to_vec();
    entry.extend(VERSION.to_le_bytes());
    entry.extend(about);
    // No extra field, comment, disk or attributes; the local header is at 0.
    entry.extend([0; 16]);
    entry.extend(LAYER.bytes());
    let mut directory = entry.clone();
    directory.extend(b"PK\x05\x06");
    directory.extend([0, 0, 1, 1].map(u16::to_le_bytes).concat());
    // Both fit, because the size of the file does.
    let place = [entry.len() as u32, ALIGNMENT as u32 + text as u32];
    directory.extend(place.map(u32::to_le_bytes).concat());
    directory.extend([0; 2]);
    directory
}

#[cfg(test)]
mod tests {
    use zip::{CompressionMethod, ZipArchive};

    use super::super::mesh::tests::{geometry, two_quads};
    use super::*;

    #[test]
    fn the_layer_is_stored_where_readers_map_it() {
        let meshes = [Mesh::new(&two_quads(), &geometry()).unwrap()];
        let (mut file, mut text) = (Vec::new(), Vec::new());
        write(&meshes, &mut file).unwrap();
        usda::write(&meshes, &mut text).unwrap();
        assert_eq!(file.len() as u64, file_bytes(text.len() as u64));
        let mut package = ZipArchive::new(io::Cursor::new(&file)).unwrap();
        assert_eq!(package.len(), 1);
        let mut layer = package.by_index(0).unwrap();
        assert_eq!(layer.name().unwrap(), LAYER);
        assert_eq!(layer.compression(), CompressionMethod::Stored);
        assert_eq!(layer.data_start(), Some(ALIGNMENT as u64));
        // The reader compares the checksum.
        let mut read = Vec::new();
        io::Read::read_to_end(&mut layer, &mut read).unwrap();
        assert!(read == text && file[ALIGNMENT..].starts_with(&text));
        // Sizes and checksum stand in the local header too, and no flag says that they follow.
        let word = |at: usize| u32::from_le_bytes(std::array::from_fn(|i| file[at + i]));
        let mut crc = Crc::new();
        crc.update(&text);
        assert_eq!(
            [word(14), word(18), word(22)],
            [crc.sum(), text.len() as u32, text.len() as u32]
        );
        assert_eq!(&file[6..10], [0; 4]);
    }
}
