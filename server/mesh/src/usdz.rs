//! USDZ (<https://openusd.org/release/spec_usdz.html>): a layer of Universal Scene Description in an uncompressed ZIP, at a multiple of 64
//! bytes.
//!
//! This module writes the ZIP itself. Readers of USDZ go from one local header to the next, so the local header must contain size and
//! checksum of the content. Libraries write them there only if the output can seek.

use std::io::{self, Write};

use flate2::Crc;

use super::{ExportError, Mesh, fits_u32, usda};

const LAYER: &str = "surfaces.usda";
/// Alignment of the content in bytes.
const ALIGNMENT: usize = 64;
/// Bytes of a local header without the name.
const HEADER_BYTES: usize = 30;
/// Id of the extra field that pads the header. OpenUSD's writer uses the same id.
const PADDING_ID: u16 = 0x1986;
/// Bytes of the id and the length of the extra field.
const PADDING_HEAD: usize = 4;
/// Bytes of the extra field, including its id and length.
const PADDING: usize = ALIGNMENT - HEADER_BYTES - LAYER.len();
const _: () = assert!(PADDING >= PADDING_HEAD);
/// Version of ZIP that a reader must support: 1.0.
const VERSION: u16 = 10;
/// Date of the layer: 1 January 1980, the first day that a ZIP can express. Fixed, so that equal requests give equal bytes.
const DATE: u16 = 1 << 5 | 1;

/// Writes `meshes` as a stage. Generates the text twice, because its length and checksum come first in the file.
///
/// # Errors
/// The file would exceed 4 GiB, or `out` fails.
pub fn write(meshes: &[Mesh], out: &mut dyn Write) -> Result<(), ExportError> {
    let mut measure = Measure::default();
    usda::write(meshes, &mut measure)?;
    let common = common_fields(measure.crc.sum(), fits_u32("bytes of text", measure.bytes, "USDZ")?);
    fits_u32("file size in bytes", file_bytes(measure.bytes), "USDZ")?;

    out.write_all(b"PK\x03\x04")?;
    out.write_all(&common)?;
    out.write_all(&(PADDING as u16).to_le_bytes())?;
    out.write_all(LAYER.as_bytes())?;
    out.write_all(&PADDING_ID.to_le_bytes())?;
    out.write_all(&((PADDING - PADDING_HEAD) as u16).to_le_bytes())?;
    out.write_all(&[0; PADDING - PADDING_HEAD])?;
    usda::write(meshes, out)?;
    out.write_all(&directory(&common, measure.bytes))?;
    Ok(())
}

/// Writer that counts its bytes, computes their checksum, and discards them.
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

/// Returns the fields that the local header and the directory entry have in common: from the version to the length of the name.
fn common_fields(crc: u32, bytes: u32) -> Vec<u8> {
    // Version, flags, compression method (0: stored), time and date.
    let shorts = [VERSION, 0, 0, 0, DATE].map(u16::to_le_bytes).concat();
    let words = [crc, bytes, bytes].map(u32::to_le_bytes).concat();
    [shorts, words, (LAYER.len() as u16).to_le_bytes().to_vec()].concat()
}

/// Bytes of a directory entry without the name.
const ENTRY_BYTES: usize = 46;
/// Bytes of the end record of the directory.
const END_BYTES: usize = 22;

/// Returns the size of a file whose layer has `text_bytes` bytes.
fn file_bytes(text_bytes: u64) -> u64 {
    (ALIGNMENT + ENTRY_BYTES + LAYER.len() + END_BYTES) as u64 + text_bytes
}

/// Returns the central directory of a file whose layer has `text_bytes` bytes, and the end record.
fn directory(common_fields: &[u8], text_bytes: u64) -> Vec<u8> {
    let mut entry = b"PK\x01\x02".to_vec();
    entry.extend(VERSION.to_le_bytes());
    entry.extend(common_fields);
    // Lengths of extra field and comment, disk, attributes, and offset of the local header: all 0.
    entry.extend([0; 16]);
    entry.extend(LAYER.bytes());
    let mut directory = entry.clone();
    directory.extend(b"PK\x05\x06");
    directory.extend([0, 0, 1, 1].map(u16::to_le_bytes).concat());
    // Both fit into 32 bits, because the size of the file does.
    let size_and_offset = [entry.len() as u32, ALIGNMENT as u32 + text_bytes as u32];
    directory.extend(size_and_offset.map(u32::to_le_bytes).concat());
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
