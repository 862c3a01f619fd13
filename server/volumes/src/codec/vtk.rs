//! Arrays of VTK's XML formats: a header with lengths, then blocks, perhaps compressed, perhaps all in base64
//! (<https://docs.vtk.org/en/latest/vtk_file_formats/vtkxml_file_format.html>).

use std::io::{self, BufRead, BufReader, Read};

use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use flate2::bufread::ZlibDecoder;

use super::{DEFLATE_RATIO, Endian, VtkCoding, VtkCompressor, invalid};

pub(super) fn decoder<'a>(
    coding: VtkCoding,
    stored: impl BufRead + Send + 'a,
) -> io::Result<Box<dyn Read + Send + 'a>> {
    let stored: Box<dyn Read + Send + 'a> = if coding.base64 {
        Box::new(BufReader::new(Base64::new(stored)))
    } else {
        Box::new(stored)
    };
    let mut blocks = Blocks {
        coding,
        stored,
        sizes: Vec::new().into_iter(),
        block: io::Cursor::default(),
        block_bytes: 0,
        last_bytes: 0,
    };
    if coding.compressor.is_none() {
        let bytes = blocks.number()?;
        return Ok(Box::new(blocks.stored.take(bytes)));
    }
    blocks.read_header()?;
    Ok(Box::new(blocks))
}

/// Compressed blocks.
struct Blocks<'a> {
    coding: VtkCoding,
    stored: Box<dyn Read + Send + 'a>,
    /// Compressed sizes of the blocks that were not read yet.
    sizes: std::vec::IntoIter<u64>,
    /// The current block, decoded.
    block: io::Cursor<Vec<u8>>,
    /// Decoded bytes of a block.
    block_bytes: u64,
    /// Decoded bytes of the last block.
    last_bytes: u64,
}

impl Blocks<'_> {
    fn number(&mut self) -> io::Result<u64> {
        let mut bytes = [0; 8];
        let used = &mut bytes[..self.coding.header_bytes];
        self.stored.read_exact(used)?;
        if self.coding.endian == Endian::Big {
            used.reverse();
        }
        Ok(u64::from_le_bytes(bytes))
    }

    /// Reads the number of blocks, the bytes of a block, the bytes of a shorter last block or 0, then the compressed bytes of each block.
    fn read_header(&mut self) -> io::Result<()> {
        let [count, block_bytes, last] = [self.number()?, self.number()?, self.number()?];
        (self.block_bytes, self.last_bytes) = (block_bytes, if last == 0 { block_bytes } else { last });
        let mut sizes = Vec::new();
        for _ in 0..count {
            sizes.push(self.number()?);
        }
        self.sizes = sizes.into_iter();
        Ok(())
    }

    fn next_block(&mut self, size: u64) -> io::Result<()> {
        let bytes = if self.sizes.len() == 0 {
            self.last_bytes
        } else {
            self.block_bytes
        };
        let mut packed = Vec::new();
        (&mut self.stored).take(size).read_to_end(&mut packed)?;
        if (packed.len() as u64) < size {
            return Err(io::ErrorKind::UnexpectedEof.into());
        }
        // The maximum ratio of zlib, which is above that of LZ4.
        if bytes > size.saturating_mul(DEFLATE_RATIO) {
            return Err(invalid(format!("a block of {size} bytes cannot hold {bytes}")));
        }
        let block = match self.coding.compressor {
            Some(VtkCompressor::Lz4) => {
                lz4_flex::block::decompress(&packed, bytes as usize).map_err(|e| invalid(e.to_string()))?
            }
            _ => {
                let mut block = Vec::new();
                ZlibDecoder::new(packed.as_slice())
                    .take(bytes + 1)
                    .read_to_end(&mut block)?;
                block
            }
        };
        if block.len() as u64 != bytes {
            return Err(invalid(format!(
                "a block has {} bytes or more, expected {bytes}",
                block.len()
            )));
        }
        self.block = io::Cursor::new(block);
        Ok(())
    }
}

impl Read for Blocks<'_> {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        loop {
            let n = self.block.read(buffer)?;
            if n > 0 || buffer.is_empty() {
                return Ok(n);
            }
            match self.sizes.next() {
                Some(size) => self.next_block(size)?,
                None => return Ok(0),
            }
        }
    }
}

/// Decodes base64 between white space. Padding ends a section, not the stream: VTK encodes header and blocks separately.
struct Base64<R> {
    letters: R,
    /// Groups of four letters.
    groups: Vec<u8>,
    decoded: io::Cursor<Vec<u8>>,
}

/// Letters that are decoded at once.
const LETTERS: usize = 1 << 14;

impl<R: BufRead> Base64<R> {
    fn new(letters: R) -> Self {
        Self {
            letters,
            groups: Vec::new(),
            decoded: io::Cursor::default(),
        }
    }

    /// Fills `groups` up to padding, markup, the end, or as many letters as are decoded at once.
    fn gather(&mut self) -> io::Result<()> {
        self.groups.clear();
        loop {
            let stored = self.letters.fill_buf()?;
            let (mut used, mut full) = (0, stored.is_empty());
            for &byte in stored {
                let complete = self.groups.len().is_multiple_of(4) && !self.groups.is_empty();
                // Markup follows the last array.
                if byte == b'<' || complete && (self.groups.len() == LETTERS || self.groups.last() == Some(&b'=')) {
                    full = true;
                    break;
                }
                used += 1;
                if !byte.is_ascii_whitespace() {
                    self.groups.push(byte);
                }
            }
            self.letters.consume(used);
            if full {
                return Ok(());
            }
        }
    }
}

impl<R: BufRead> Read for Base64<R> {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        let mut n = self.decoded.read(buffer)?;
        if n == 0 && !buffer.is_empty() {
            self.gather()?;
            let decoded = STANDARD
                .decode(&self.groups)
                .map_err(|e| invalid(format!("base64: {e}")))?;
            self.decoded = io::Cursor::new(decoded);
            n = self.decoded.read(buffer)?;
        }
        Ok(n)
    }
}
