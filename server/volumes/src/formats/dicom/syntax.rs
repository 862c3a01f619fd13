//! Transfer syntaxes: encoding of a file's elements, and packing of its samples.

use super::data_set::{Fault, tag};
use super::elements::Writing;

/// A transfer syntax.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Syntax {
    pub writing: Writing,
    pub packing: Packing,
}

/// Packing of samples.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Packing {
    Plain,
    /// Compressed with the whole data set.
    Deflated,
    Encoded(Codec),
    /// An unsupported packing, by its name.
    Other(&'static str),
}

/// Compression of images.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Codec {
    RunLength,
    /// Baseline, extended and lossless JPEG.
    Jpeg,
    JpegLs,
    Jpeg2000,
}

impl Syntax {
    /// Returns the syntax with a unique identifier.
    pub fn of(identifier: Option<&str>) -> Result<Self, Fault> {
        let of = |packing, implicit, big| Self {
            writing: Writing { implicit, big },
            packing,
        };
        let other = |name| of(Packing::Other(name), false, false);
        let Some(identifier) = identifier else {
            return Err(Fault::of(
                tag::TRANSFER_SYNTAX,
                "missing, expected the identifier of a transfer syntax",
            ));
        };
        let Some(number) = identifier.strip_prefix("1.2.840.10008.1.2") else {
            return Err(Fault::of(
                tag::TRANSFER_SYNTAX,
                "a private one, expected one of the standard",
            ));
        };
        Ok(match number {
            "" => of(Packing::Plain, true, false),
            ".1" => of(Packing::Plain, false, false),
            ".1.99" => of(Packing::Deflated, false, false),
            ".2" => of(Packing::Plain, false, true),
            ".5" => of(Packing::Encoded(Codec::RunLength), false, false),
            ".4.50" | ".4.51" | ".4.57" | ".4.70" => of(Packing::Encoded(Codec::Jpeg), false, false),
            ".4.80" | ".4.81" => of(Packing::Encoded(Codec::JpegLs), false, false),
            ".4.90" | ".4.91" => of(Packing::Encoded(Codec::Jpeg2000), false, false),
            ".4.201" | ".4.202" | ".4.203" => other("high-throughput JPEG 2000"),
            ".4.110" | ".4.111" | ".4.112" => other("JPEG XL"),
            _ => other("a film or a retired compression"),
        })
    }
}
