//! Writes small valid files of every format. The fuzz targets take their seeds from here too.

use std::io::Write;

use bzip2::write::BzEncoder;
use flate2::Compression;
use flate2::write::{DeflateEncoder, GzEncoder, ZlibEncoder};

/// Type of a stored sample: kind `u`, `i` or `f`, and bytes.
pub type Kind = (char, usize);

pub const KINDS: [Kind; 10] = [
    ('u', 1),
    ('i', 1),
    ('u', 2),
    ('i', 2),
    ('u', 4),
    ('i', 4),
    ('u', 8),
    ('i', 8),
    ('f', 4),
    ('f', 8),
];

/// A volume to write: every value is whole, small enough for its type and for f32.
#[derive(Clone, Debug)]
pub struct Volume {
    pub dims: [u32; 3],
    pub steps: u32,
    pub kind: Kind,
    pub big: bool,
    pub spacing: [f64; 3],
    pub origin: [f64; 3],
    /// x fastest, then y, z, step.
    pub values: Vec<i64>,
}

impl Volume {
    pub fn new(dims: [u32; 3], steps: u32, kind: Kind, big: bool) -> Self {
        let count = dims.iter().product::<u32>() * steps;
        // Alternates between the ends of the type and values between them, so that wrong signs and byte orders show.
        let values = (0..i64::from(count))
            .map(|i| match kind {
                ('u', 1) => i * 37 % 256,
                ('i', 1) => i * 37 % 256 - 128,
                ('u', _) => i * 7919 % 65536,
                _ => i * 7919 % 65536 - 32768,
            })
            .collect();
        Self {
            dims,
            steps,
            kind,
            big,
            spacing: [0.5, 1.25, 2.0],
            origin: [-3.0, 4.5, 10.0],
            values,
        }
    }

    pub fn bytes(&self) -> Vec<u8> {
        self.values.iter().flat_map(|&v| self.sample(v)).collect()
    }

    fn sample(&self, v: i64) -> Vec<u8> {
        let mut bytes = match self.kind {
            ('f', 4) => (v as f32).to_le_bytes().to_vec(),
            ('f', _) => (v as f64).to_le_bytes().to_vec(),
            (_, n) => v.to_le_bytes()[..n].to_vec(),
        };
        if self.big {
            bytes.reverse();
        }
        bytes
    }

    pub fn list<T: ToString>(&self, values: &[T], step: &str) -> String {
        let mut words: Vec<String> = values.iter().map(ToString::to_string).collect();
        if self.steps > 1 {
            words.push(step.to_owned());
        }
        words.join(" ")
    }

    fn dimension(&self) -> usize {
        if self.steps > 1 { 4 } else { 3 }
    }
}

pub fn gzip(bytes: &[u8]) -> Vec<u8> {
    let mut out = GzEncoder::new(Vec::new(), Compression::fast());
    out.write_all(bytes).unwrap();
    out.finish().unwrap()
}

pub fn zlib(bytes: &[u8]) -> Vec<u8> {
    let mut out = ZlibEncoder::new(Vec::new(), Compression::fast());
    out.write_all(bytes).unwrap();
    out.finish().unwrap()
}

pub fn bzip2(bytes: &[u8]) -> Vec<u8> {
    let mut out = BzEncoder::new(Vec::new(), bzip2::Compression::fast());
    out.write_all(bytes).unwrap();
    out.finish().unwrap()
}

pub fn zstd(bytes: &[u8]) -> Vec<u8> {
    ruzstd::encoding::compress_to_vec(bytes, ruzstd::encoding::CompressionLevel::Fastest)
}

fn hex(bytes: &[u8]) -> Vec<u8> {
    let lines = bytes
        .chunks(35)
        .map(|line| line.iter().map(|b| format!("{b:02X}")).collect::<String>() + "\n");
    lines.collect::<String>().into_bytes()
}

/// Numbers, one a line.
pub fn text(v: &Volume) -> Vec<u8> {
    v.values.iter().flat_map(|v| format!("{v}\n").into_bytes()).collect()
}

/// NRRD header without its last, empty line.
pub fn nrrd_header(v: &Volume, encoding: &str) -> String {
    let kind = match v.kind {
        ('f', 4) => "float".to_owned(),
        ('f', _) => "double".to_owned(),
        ('u', n) => format!("uint{}", n * 8),
        (_, n) => format!("int{}", n * 8),
    };
    let [ox, oy, oz] = v.origin;
    let directions: Vec<String> = (0..3)
        .map(|a| {
            let mut axis = [0.0; 3];
            axis[a] = v.spacing[a];
            format!("({},{},{})", axis[0], axis[1], axis[2])
        })
        .collect();
    format!(
        "NRRD0005\n# a comment\ntype: {kind}\ndimension: {}\nspace dimension: 3\nsizes: {}\nspace directions: {}\n\
         space origin: ({ox},{oy},{oz})\nkinds: {}\nendian: {}\nencoding: {encoding}\n",
        v.dimension(),
        v.list(&v.dims, &v.steps.to_string()),
        v.list(&directions, "none"),
        v.list(&["domain"; 3], "time"),
        if v.big { "big" } else { "little" },
    )
}

pub fn nrrd(v: &Volume, encoding: &str) -> Vec<u8> {
    let mut out = nrrd_header(v, encoding).into_bytes();
    out.push(b'\n');
    out.extend(match encoding {
        "raw" => v.bytes(),
        "gzip" => gzip(&v.bytes()),
        "bzip2" => bzip2(&v.bytes()),
        "hex" => hex(&v.bytes()),
        "text" => text(v),
        other => panic!("no encoding {other}"),
    });
    out
}

/// MetaImage header up to and with `ElementDataFile`.
pub fn meta_header(v: &Volume, compressed: bool, file: &str) -> String {
    let kind = match v.kind {
        ('u', 1) => "MET_UCHAR",
        ('i', 1) => "MET_CHAR",
        ('u', 2) => "MET_USHORT",
        ('i', 2) => "MET_SHORT",
        ('u', 4) => "MET_UINT",
        ('i', 4) => "MET_INT",
        ('u', _) => "MET_ULONG_LONG",
        ('i', _) => "MET_LONG_LONG",
        (_, 4) => "MET_FLOAT",
        _ => "MET_DOUBLE",
    };
    format!(
        "ObjectType = Image\nNDims = {}\nBinaryData = True\nBinaryDataByteOrderMSB = {}\nCompressedData = {}\n\
         Offset = {}\nElementSpacing = {}\nDimSize = {}\nElementType = {kind}\nElementDataFile = {file}\n",
        v.dimension(),
        if v.big { "True" } else { "False" },
        if compressed { "True" } else { "False" },
        v.list(&v.origin, "0"),
        v.list(&v.spacing, "1"),
        v.list(&v.dims, &v.steps.to_string()),
    )
}

pub fn mha(v: &Volume, compressed: bool) -> Vec<u8> {
    let mut out = meta_header(v, compressed, "LOCAL").into_bytes();
    out.extend(if compressed { zlib(&v.bytes()) } else { v.bytes() });
    out
}

/// NIfTI-1 by the byte map of its standard; `edit` may change the header, numbers already in the file's order.
pub fn nifti(v: &Volume, edit: impl FnOnce(&mut Nifti)) -> Vec<u8> {
    let mut h = Nifti {
        bytes: vec![0; 352],
        big: v.big,
    };
    let code: i16 = match v.kind {
        ('u', 1) => 2,
        ('i', 1) => 256,
        ('u', 2) => 512,
        ('i', 2) => 4,
        ('u', 4) => 768,
        ('i', 4) => 8,
        ('u', _) => 1280,
        ('i', _) => 1024,
        (_, 4) => 16,
        _ => 64,
    };
    h.i32(0, 348);
    h.i16(40, v.dimension() as i16);
    (0..7).for_each(|i| h.i16(42 + 2 * i, 1));
    (0..3).for_each(|i| h.i16(42 + 2 * i, v.dims[i] as i16));
    h.i16(48, v.steps as i16);
    h.i16(70, code);
    h.i16(72, v.kind.1 as i16 * 8);
    (0..8).for_each(|i| h.f32(76 + 4 * i, 1.0));
    (0..3).for_each(|i| h.f32(80 + 4 * i, v.spacing[i] as f32));
    h.f32(108, 352.0);
    h.f32(112, 1.0);
    h.i16(254, 1);
    for row in 0..3 {
        h.f32(280 + 16 * row + 4 * row, v.spacing[row] as f32);
        h.f32(280 + 16 * row + 12, v.origin[row] as f32);
    }
    h.bytes[344..348].copy_from_slice(b"n+1\0");
    edit(&mut h);
    h.bytes.extend(v.bytes());
    h.bytes
}

pub struct Nifti {
    pub bytes: Vec<u8>,
    big: bool,
}

impl Nifti {
    fn put(&mut self, at: usize, mut bytes: Vec<u8>) {
        if self.big {
            bytes.reverse();
        }
        self.bytes[at..at + bytes.len()].copy_from_slice(&bytes);
    }

    pub fn i16(&mut self, at: usize, value: i16) {
        self.put(at, value.to_le_bytes().to_vec());
    }

    pub fn i32(&mut self, at: usize, value: i32) {
        self.put(at, value.to_le_bytes().to_vec());
    }

    pub fn i64(&mut self, at: usize, value: i64) {
        self.put(at, value.to_le_bytes().to_vec());
    }

    pub fn f64(&mut self, at: usize, value: f64) {
        self.put(at, value.to_le_bytes().to_vec());
    }

    pub fn f32(&mut self, at: usize, value: f32) {
        self.put(at, value.to_le_bytes().to_vec());
    }
}

/// NIfTI-2 by the byte map of its standard, of one file. Its world is RAS.
pub fn nifti2(v: &Volume) -> Vec<u8> {
    let mut first = Vec::new();
    nifti(v, |h| first.clone_from(&h.bytes));
    let mut h = Nifti {
        bytes: vec![0; 544],
        big: v.big,
    };
    h.i32(0, 540);
    h.bytes[4..12].copy_from_slice(b"n+2\0\r\n\x1a\n");
    // Type and bits.
    h.bytes[12..16].copy_from_slice(&first[70..74]);
    h.i64(16, v.dimension() as i64);
    (0..7).for_each(|i| h.i64(24 + 8 * i, 1));
    (0..3).for_each(|i| h.i64(24 + 8 * i, i64::from(v.dims[i])));
    h.i64(48, i64::from(v.steps));
    (0..8).for_each(|i| h.f64(104 + 8 * i, 1.0));
    (0..3).for_each(|i| h.f64(112 + 8 * i, v.spacing[i]));
    h.i64(168, 544);
    h.f64(176, 1.0);
    h.i32(348, 1);
    for row in 0..3 {
        h.f64(400 + 32 * row + 8 * row, v.spacing[row]);
        h.f64(400 + 32 * row + 24, v.origin[row]);
    }
    h.bytes.extend(v.bytes());
    h.bytes
}

/// `.npy`, version 1.
pub fn npy(v: &Volume, fortran: bool) -> Vec<u8> {
    let [x, y, z] = v.dims;
    let shape = if v.steps > 1 {
        format!("{}, {z}, {y}, {x}", v.steps)
    } else {
        format!("{z}, {y}, {x}")
    };
    let order = match (v.kind.1, v.big) {
        (1, _) => '|',
        (_, true) => '>',
        _ => '<',
    };
    let (kind, bytes) = v.kind;
    let mut header = format!(
        "{{'descr': '{order}{kind}{bytes}', 'fortran_order': {}, 'shape': ({shape}), }}",
        if fortran { "True" } else { "False" }
    );
    while (10 + header.len() + 1) % 64 != 0 {
        header.push(' ');
    }
    header.push('\n');
    let mut out = b"\x93NUMPY\x01\x00".to_vec();
    out.extend((header.len() as u16).to_le_bytes());
    out.extend(header.bytes());
    if !fortran {
        out.extend(v.bytes());
        return out;
    }
    let t = v.steps;
    for (x, y, z, t) in
        (0..x).flat_map(|x| (0..y).flat_map(move |y| (0..z).flat_map(move |z| (0..t).map(move |t| (x, y, z, t)))))
    {
        let i = x + v.dims[0] * (y + v.dims[1] * (z + v.dims[2] * t));
        out.extend(v.sample(v.values[i as usize]));
    }
    out
}

/// `.npz` of one array, `a`, stored or deflated.
pub fn npz(v: &Volume, deflated: bool) -> Vec<u8> {
    let (name, plain) = ("a.npy", npy(v, false));
    let mut crc = flate2::Crc::new();
    crc.update(&plain);
    let data = if deflated {
        let mut out = DeflateEncoder::new(Vec::new(), Compression::fast());
        out.write_all(&plain).unwrap();
        out.finish().unwrap()
    } else {
        plain.clone()
    };
    let mut shared = Vec::new();
    for half in [20u16, 0, if deflated { 8 } else { 0 }, 0, 0x21] {
        shared.extend(half.to_le_bytes());
    }
    for word in [crc.sum(), data.len() as u32, plain.len() as u32] {
        shared.extend(word.to_le_bytes());
    }
    shared.extend((name.len() as u16).to_le_bytes());
    shared.extend([0; 2]);
    let mut out = [b"PK\x03\x04".as_slice(), &shared, name.as_bytes(), &data].concat();
    let directory = out.len();
    out.extend([b"PK\x01\x02\x14\x00".as_slice(), &shared, &[0; 14], name.as_bytes()].concat());
    let size = (out.len() - directory) as u32;
    out.extend(b"PK\x05\x06\0\0\0\0\x01\0\x01\0");
    out.extend(size.to_le_bytes());
    out.extend((directory as u32).to_le_bytes());
    out.extend([0; 2]);
    out
}

/// The sidecar of raw samples in `file`.
pub fn sidecar(v: &Volume, file: &str, encoding: &str) -> Vec<u8> {
    let (kind, bytes) = v.kind;
    format!(
        r#"{{"file":"{file}","type":"{kind}{}","dims":{:?},"endian":"{}","steps":{},"spacing":{:?},"origin":{:?},"encoding":"{encoding}"}}"#,
        bytes * 8,
        v.dims,
        if v.big { "big" } else { "little" },
        v.steps,
        v.spacing,
        v.origin,
    )
    .into_bytes()
}

/// The header of Analyze 7.5, beside which stand the samples.
pub fn analyze(v: &Volume) -> Vec<u8> {
    let mut header = nifti(v, |h| h.f32(108, 0.0))[..348].to_vec();
    // The following fields have another meaning than in NIfTI.
    header[252..].fill(0);
    header
}

/// MGH of signed 16-bit samples, which are big-endian.
pub fn mgh(v: &Volume) -> Vec<u8> {
    assert!(v.kind == ('i', 2) && v.big, "shorts, big-endian");
    let [x, y, z] = v.dims;
    let words = [1, x, y, z, v.steps, 4, 0];
    let mut file: Vec<u8> = words.into_iter().flat_map(u32::to_be_bytes).collect();
    file.extend(1u16.to_be_bytes());
    let spacing = v.spacing.map(|s| s as f32);
    let axes = [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0];
    let centre = [5.0, 6.0, 7.0];
    let floats = spacing.into_iter().chain(axes).chain(centre);
    file.extend(floats.flat_map(f32::to_be_bytes));
    file.resize(284, 0);
    file.extend(v.bytes());
    file
}
