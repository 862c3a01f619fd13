//! Streams of decoded bytes, one type for each encoding of samples.
//!
//! Every stream returns an error if its input continues behind the end that the stream itself states. No stream allocates memory for
//! what a header claims: a buffer grows with the decoded bytes, or has a size that the stored bytes can fill.

mod vtk;
mod zstd;

use std::io::{self, BufRead, BufReader, Read};

use bzip2::bufread::MultiBzDecoder;
use flate2::bufread::{DeflateDecoder, GzDecoder, ZlibDecoder};

/// Byte order of a file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[expect(missing_docs, reason = "the field's standard terms")]
pub enum Endian {
    Little,
    Big,
}

impl Endian {
    /// Byte order of this machine.
    pub(super) const NATIVE: Self = if cfg!(target_endian = "big") {
        Self::Big
    } else {
        Self::Little
    };

    pub(super) fn is_native(self) -> bool {
        self == Self::NATIVE
    }
}

/// Maximum ratio of deflate: 258 bytes from two bits, 1032 to 1.
pub(super) const DEFLATE_RATIO: u64 = 1032;

/// Encoding of samples.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Encoding {
    /// As bytes.
    Raw,
    /// gzip members or one zlib stream, recognised by the first two bytes.
    Deflate,
    /// One deflate stream without a container, as in a zip file.
    BareDeflate,
    /// bzip2 streams.
    Bzip2,
    /// Zstandard frames.
    Zstd,
    /// Hexadecimal digits, two a byte, between white space.
    Hex,
    /// An array of VTK's XML formats, which states its own length.
    Vtk(VtkCoding),
    /// Decimal numbers between white space or commas.
    Text,
}

impl Encoding {
    /// Returns the maximum number of bytes that one stored byte decodes to; `None` if bytes are not decoded.
    pub(super) const fn max_ratio(self) -> Option<u64> {
        match self {
            Self::Raw | Self::Text => None,
            Self::Hex => Some(1),
            // LZ4 gives less.
            Self::Deflate | Self::BareDeflate | Self::Vtk(_) => Some(DEFLATE_RATIO),
            // 128 KiB from a block of four bytes.
            Self::Zstd => Some(32768),
            // The format has no useful limit. This limit refuses volumes without content and decompression bombs.
            Self::Bzip2 => Some(32768),
        }
    }
}

/// How an array is written.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct VtkCoding {
    /// Whether its bytes are in base64.
    pub base64: bool,
    /// What its blocks are compressed with.
    pub compressor: Option<VtkCompressor>,
    /// Bytes of a number of its header: 4 or 8.
    pub header_bytes: usize,
    /// Byte order of the header.
    pub endian: Endian,
}

/// What blocks are compressed with.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum VtkCompressor {
    Zlib,
    Lz4,
}

/// Maximum ratio of bytes to those of a block of LZ4 that holds them.
const LZ4_RATIO: usize = 256;

/// Decodes bytes in memory to at most `limit` bytes.
pub(super) fn decoded(encoding: Encoding, stored: &[u8], limit: usize) -> Result<Vec<u8>, String> {
    let mut bytes = Vec::new();
    let stream = decoder(encoding, stored, stored.len() as u64);
    let read = stream.and_then(|stream| stream.take(limit as u64 + 1).read_to_end(&mut bytes));
    read.map_err(|e| e.to_string())?;
    if bytes.len() > limit {
        return Err(format!("more than {limit} bytes, which a chunk does not have"));
    }
    Ok(bytes)
}

/// Decodes a block of LZ4 of at most `size` bytes.
pub(super) fn lz4_block(packed: &[u8], size: usize) -> Result<Vec<u8>, String> {
    if size > packed.len().saturating_mul(LZ4_RATIO) {
        return Err(format!("{} bytes of LZ4 cannot hold {size}", packed.len()));
    }
    lz4_flex::block::decompress(packed, size).map_err(|e| e.to_string())
}

/// Returns a reader of the decoded bytes of `stored`, of which at most `stored_bytes` are read. Plain samples and text are passed through.
pub(super) fn decoder<'a>(
    encoding: Encoding,
    stored: impl Read + Send + 'a,
    stored_bytes: u64,
) -> io::Result<Box<dyn Read + Send + 'a>> {
    let mut stored = BufReader::with_capacity(1 << 16, stored.take(stored_bytes));
    Ok(match encoding {
        Encoding::Raw | Encoding::Text => Box::new(stored),
        Encoding::Deflate if stored.fill_buf()?.starts_with(&[0x1f, 0x8b]) => {
            Box::new(Members(Some(GzDecoder::new(stored))))
        }
        Encoding::Deflate => Box::new(ToEnd(ZlibDecoder::new(stored))),
        Encoding::BareDeflate => Box::new(ToEnd(DeflateDecoder::new(stored))),
        Encoding::Bzip2 => Box::new(MultiBzDecoder::new(stored)),
        Encoding::Zstd => Box::new(zstd::Frames::new(stored, stored_bytes)),
        Encoding::Hex => Box::new(Hex { digits: stored }),
        Encoding::Vtk(coding) => vtk::decoder(coding, stored)?,
    })
}

pub(super) fn invalid(why: impl Into<String>) -> io::Error {
    io::Error::new(io::ErrorKind::InvalidData, why.into())
}

/// Members of a gzip file, one after the other. Zeros and white space may follow the last one, as tapes and block devices leave them.
struct Members<R: BufRead>(Option<GzDecoder<R>>);

impl<R: BufRead> Read for Members<R> {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        while let Some(mut member) = self.0.take() {
            let n = member.read(buffer)?;
            if n > 0 || buffer.is_empty() {
                self.0 = Some(member);
                return Ok(n);
            }
            let mut rest = member.into_inner();
            if !is_padding(&mut rest)? {
                self.0 = Some(GzDecoder::new(rest));
            }
        }
        Ok(0)
    }
}

/// Skips zeros and white space. Returns `true` if the input ends with them; else the input is at the start of the next member.
fn is_padding(input: &mut impl BufRead) -> io::Result<bool> {
    loop {
        let stored = input.fill_buf()?;
        if stored.is_empty() {
            return Ok(true);
        }
        let is_pad = |byte: &u8| *byte == 0 || byte.is_ascii_whitespace();
        match stored.iter().position(|byte| !is_pad(byte)) {
            Some(at) => {
                input.consume(at);
                return Ok(false);
            }
            None => {
                let all = stored.len();
                input.consume(all);
            }
        }
    }
}

/// A decoder of one stream, which must end at the end of its input.
struct ToEnd<D>(D);

/// The input of a decoder.
trait Input {
    fn input(&mut self) -> &mut dyn BufRead;
}

impl<R: BufRead> Input for ZlibDecoder<R> {
    fn input(&mut self) -> &mut dyn BufRead {
        self.get_mut()
    }
}

impl<R: BufRead> Input for DeflateDecoder<R> {
    fn input(&mut self) -> &mut dyn BufRead {
        self.get_mut()
    }
}

impl<D: Read + Input> Read for ToEnd<D> {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        let n = self.0.read(buffer)?;
        if n == 0 && !buffer.is_empty() && !self.0.input().fill_buf()?.is_empty() {
            return Err(invalid("the file goes on after the end of the compressed stream"));
        }
        Ok(n)
    }
}

/// Decodes hexadecimal digits.
struct Hex<R> {
    digits: R,
}

impl<R: BufRead> Read for Hex<R> {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        let (mut done, mut high) = (0, None);
        while done < buffer.len() {
            let stored = self.digits.fill_buf()?;
            if stored.is_empty() {
                break;
            }
            let mut used = 0;
            for &byte in stored {
                if done == buffer.len() {
                    break;
                }
                used += 1;
                if byte.is_ascii_whitespace() {
                    continue;
                }
                let digit = char::from(byte)
                    .to_digit(16)
                    .ok_or_else(|| invalid(format!("{:?}, expected hexadecimal digits", char::from(byte))))?;
                match high.take() {
                    None => high = Some(digit as u8),
                    Some(high) => {
                        buffer[done] = high << 4 | digit as u8;
                        done += 1;
                    }
                }
            }
            self.digits.consume(used);
        }
        match high {
            Some(_) => Err(io::ErrorKind::UnexpectedEof.into()),
            None => Ok(done),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn decode(encoding: Encoding, stored: &[u8]) -> io::Result<Vec<u8>> {
        let mut out = Vec::new();
        decoder(encoding, stored, stored.len() as u64)?.read_to_end(&mut out)?;
        Ok(out)
    }

    #[test]
    fn hexadecimal_digits_are_bytes() {
        assert_eq!(decode(Encoding::Hex, b"00fF\n 1 0\n").unwrap(), [0, 255, 16]);
        assert!(decode(Encoding::Hex, b"00f").is_err());
        assert!(decode(Encoding::Hex, b"0g").is_err());
    }

    #[test]
    fn zeros_may_follow_the_members_of_a_gzip_file() {
        use std::io::Write;
        let member = |text: &[u8]| {
            let mut packed = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::fast());
            packed.write_all(text).unwrap();
            packed.finish().unwrap()
        };
        let [a, b] = [b"one ", b"two "].map(|text| member(text));
        assert_eq!(decode(Encoding::Deflate, &[&a[..], &b].concat()).unwrap(), b"one two ");
        assert_eq!(
            decode(Encoding::Deflate, &[&a[..], &b, &[0; 700], b"\n"].concat()).unwrap(),
            b"one two "
        );
        assert_eq!(
            decode(Encoding::Deflate, &[&a[..], &[0; 16], &b].concat()).unwrap(),
            b"one two "
        );
        assert!(decode(Encoding::Deflate, &[&a[..], b"more"].concat()).is_err());
        assert!(decode(Encoding::Deflate, &a[..a.len() - 1]).is_err());
    }

    #[test]
    fn what_follows_a_stream_is_an_error() {
        use std::io::Write;
        let mut packed = flate2::write::ZlibEncoder::new(Vec::new(), flate2::Compression::fast());
        packed.write_all(b"samples").unwrap();
        let mut packed = packed.finish().unwrap();
        assert_eq!(decode(Encoding::Deflate, &packed).unwrap(), b"samples");
        packed.push(0);
        assert!(decode(Encoding::Deflate, &packed).is_err());
    }
}
