use isopeel_kernels::{Region, RegionKey, Vertex};
use proptest::prelude::*;

use super::super::chunk::{
    ChunkHeader, ChunkKind, Coding, HEADER_BYTES, PrefixId, WireVertex, decode_errors, without_values,
};
use super::super::decode::decode;
use super::super::predictive;
use super::{MeshHash, encode, encode_errors, encode_gone};

fn vertex(position: [i32; 3]) -> Vertex {
    Vertex {
        position,
        normal: [16384, -32767],
        smoothness: 1000,
        feature: 65535,
    }
}

/// Two triangles of different levels over four vertices.
fn small_region() -> Region {
    Region {
        coords: [1, 0, 2],
        size: 0,
        vertices: [[0, 0, 0], [65536, 0, 0], [0, 32768, 0], [65536, 65536, -65536]]
            .map(vertex)
            .to_vec()
            .into(),
        indices: vec![0, 1, 2, 2, 1, 3].into(),
        values: Vec::new().into(),
        level_triangles: [1, 0, 0, 1, 0, 0],
        error: None,
    }
}

fn small_chunk() -> Vec<u8> {
    encode(&small_region(), PrefixId::cut(2, 7, 4))
        .expect("valid region")
        .to_vec()
}

fn hex(bytes: &[u8]) -> String {
    bytes.iter().map(|b| format!("{b:02x}")).collect()
}

#[test]
fn header_bytes_are_golden() {
    let frame = small_chunk();
    let expected = concat!(
        "49534f50", "0300", "6000", "07000000", "04", "00", "02", "00", "4000", "0000", "01000000", "00000000",
        "02000000", "00000042", "00000000", "00007c42", "00000442", "0000803f", "00008042", "04000000", "06000000",
        "VVVVVVVV", "IIIIIIII", "01000000", "00000000", "00000000", "01000000", "00000000", "00000000",
    );
    let header = ChunkHeader::parse(&frame).expect("valid");
    let expected = expected
        .replace("VVVVVVVV", &hex(&header.vertex_bytes.to_le_bytes()))
        .replace("IIIIIIII", &hex(&header.index_bytes.to_le_bytes()));
    assert_eq!(hex(&frame[..HEADER_BYTES]), expected);
}

#[test]
fn payload_starts_are_those_of_the_codecs() {
    let frame = small_chunk();
    let header = ChunkHeader::parse(&frame).expect("valid");
    let vertex_payload = &frame[HEADER_BYTES..];
    let index_payload = &vertex_payload[header.vertex_bytes as usize..];
    assert_eq!(vertex_payload[0], 0xa1, "vertex codec, version 1");
    assert_eq!(index_payload[0], 0xe1, "index codec, version 1");
}

#[test]
fn a_chunk_comes_back_as_it_went() {
    let chunk = decode(&small_chunk()).expect("decodes");
    assert_eq!(chunk.header.prefix, PrefixId::cut(2, 7, 4));
    assert_eq!(chunk.header.level_triangles, [1, 0, 0, 1, 0, 0]);
    let expected = WireVertex {
        position: [64, 64, -64],
        normal: [64, -127],
        smoothness: 1024,
        feature: 65535,
    };
    assert_eq!(chunk.vertices[3], expected);
    assert_eq!(turned(&chunk.indices), turned(&[0, 1, 2, 2, 1, 3]));
}

#[test]
fn every_prefix_of_a_chunk_fails_and_one_byte_more_too() {
    let frame = small_chunk();
    for length in 0..frame.len() {
        assert!(decode(&frame[..length]).is_err(), "{length} bytes");
    }
    let mut longer = frame;
    longer.push(0);
    assert!(decode(&longer).is_err());
}

#[test]
fn a_bad_header_fails_with_its_field() {
    for (at, value, names) in [
        (0, 0x4a, "magic"),
        (4, 1, "version 1, expected 3"),
        (6, 100, "header length"),
        (12, 6, "prefix level 6"),
        (13, 1, "expected 4 a vertex"),
        (13, 2, "kind 2"),
        (14, 4, "surface 4"),
        (15, 1, "bytes"),
        (15, 2, "bytes, the frame has"),
        (15, 4, "flags 4"),
        (16, 1, "lattice"),
        (18, 1, "region [1, 0, 2] of size 1, expected multiples of 2"),
        (18, 3, "region size 3, expected 0 to 2"),
        (19, 1, "region size 256, expected 0 to 2"),
        (56, 5, "bytes"),
        (57, 255, "vertices"),
        (60, 7, "7 indices, expected a multiple of 3"),
        (63, 255, "indices"),
        (64, 255, "bytes"),
        (71, 255, "bytes"),
        (72, 2, "levels add up to 3 triangles"),
    ] {
        let mut frame = small_chunk();
        frame[at] = value;
        let error = decode(&frame).expect_err(names).to_string();
        // A vertex count of 5 is valid in the header; the codec reports it.
        assert!(error.contains(names) || at == 56, "{at}: {error}");
    }
}

#[test]
fn a_region_without_vertices_is_a_bare_header() {
    let empty = Region {
        coords: [3, 4, 5],
        ..Region::default()
    };
    let frame = encode(&empty, PrefixId::cut(0, 1, 0)).expect("valid region");
    assert_eq!(frame.len(), HEADER_BYTES);
    let chunk = decode(&frame).expect("decodes");
    let region = RegionKey::smallest([3, 4, 5]);
    assert_eq!((chunk.header.region, chunk.header.vertex_count), (region, 0));
    assert_eq!(encode_gone(region, PrefixId::cut(0, 1, 0)), Ok(frame));
}

/// A region of 128³ cells with vertices at its corners, and half a unit short of the last position that can be sent.
fn large_region() -> Region {
    let end = 128 * Vertex::LATTICE;
    let last = 512 * Vertex::LATTICE - super::LATTICE_RATIO / 2 - 1;
    Region {
        coords: [4, 0, 8],
        size: 2,
        vertices: [[0; 3], [end, 0, 0], [0, end, end], [-512 * Vertex::LATTICE, last, 0]]
            .map(vertex)
            .to_vec()
            .into(),
        ..small_region()
    }
}

#[test]
fn a_region_of_several_comes_back_with_its_size() {
    let (region, prefix) = (large_region(), PrefixId::cut(1, 2, 0));
    let frame = encode(&region, prefix).expect("a valid region");
    assert_eq!(hex(&frame[18..32]), "0200040000000000000008000000");
    let coded = predictive::encode(&frame).expect("a valid chunk");
    for frame in [&frame, &coded] {
        let chunk = decode(frame).expect("decodes");
        assert_eq!(chunk.header.region, region.key());
        let mut found: Vec<_> = chunk.vertices.iter().map(|vertex| vertex.position).collect();
        found.sort_unstable();
        assert_eq!(found, [[-32768, 32767, 0], [0, 0, 0], [0, 8192, 8192], [8192, 0, 0]]);
        assert_eq!(
            (chunk.header.min, chunk.header.max),
            ([-384.0, 0.0, 256.0], [256.0, 511.98438, 384.0])
        );
    }
    let gone = encode_gone(region.key(), prefix).expect("a valid region");
    assert_eq!(decode(&gone).expect("decodes").header.region, region.key());
}

#[test]
fn a_region_of_a_wrong_size_or_place_is_refused() {
    let refused = |region: Region| {
        encode(&region, PrefixId::cut(0, 0, 0))
            .expect_err("refused")
            .to_string()
    };
    let error = refused(Region {
        size: 3,
        ..large_region()
    });
    assert_eq!(error, "region [4, 0, 8] of size 3: region size 3, expected 0 to 2");
    let error = refused(Region {
        coords: [4, 2, 8],
        ..large_region()
    });
    assert!(
        error.ends_with("region [4, 2, 8] of size 2, expected multiples of 4"),
        "{error}"
    );
}

#[test]
fn a_position_that_does_not_fit_is_refused() {
    let below = -512 * Vertex::LATTICE - super::LATTICE_RATIO / 2 - 1;
    let above = 512 * Vertex::LATTICE - super::LATTICE_RATIO / 2;
    for (axis, coordinate) in [
        (0, below),
        (1, above),
        (2, i32::MIN),
        (0, i32::MAX),
        (1, i32::MAX - 600),
    ] {
        let mut region = large_region();
        region.vertices.to_mut()[1].position[axis] = coordinate;
        let error = encode(&region, PrefixId::cut(0, 0, 0))
            .expect_err("refused")
            .to_string();
        let is_named = error.starts_with("region [4, 0, 8] of size 2: vertex 1 is [");
        assert!(
            is_named && error.ends_with("expected at most 511 along each axis"),
            "{error}"
        );
        let distances = vec![0.0; region.vertices.len()];
        let errors = encode_errors(&region, &distances, (PrefixId::cut(0, 0, 0), Coding::Meshopt));
        assert!(errors.is_err());
    }
    // A vertex without triangles is not sent.
    let mut region = large_region();
    region.vertices.to_mut().push(vertex([i32::MAX, 0, 0]));
    assert!(encode(&region, PrefixId::cut(0, 0, 0)).is_ok());
}

#[test]
fn what_does_not_fit_together_is_refused() {
    let mut region = small_region();
    region.indices.to_mut()[4] = 4;
    let error = encode(&region, PrefixId::cut(0, 0, 0)).expect_err("index past the end");
    assert_eq!(error.to_string(), "region [1, 0, 2] of size 0: index 4 of 4 vertices");
    let mut region = small_region();
    region.level_triangles[0] = 2;
    assert!(encode(&region, PrefixId::cut(0, 0, 0)).is_err());
}

#[test]
fn the_hash_sees_everything_that_is_sent_but_generation_and_prefix() {
    let base = small_region();
    let hash = MeshHash::of(&base);
    assert_eq!(MeshHash::of(&base.clone()), hash);
    let mut other = base.clone();
    other.vertices.to_mut()[0].feature -= 256;
    assert_ne!(MeshHash::of(&other).unordered, hash.unordered);
    let mut other = base.clone();
    other.vertices.to_mut()[0].position[0] += super::LATTICE_RATIO;
    assert_ne!(MeshHash::of(&other).unordered, hash.unordered);
    // Less than is sent.
    let mut other = base.clone();
    other.vertices.to_mut()[0].position[0] += 1;
    assert_eq!(MeshHash::of(&other), hash);
    let mut other = base.clone();
    other.indices.to_mut().swap(0, 1);
    assert_ne!(MeshHash::of(&other).unordered, hash.unordered, "turned over");
    let mut other = base.clone();
    other.level_triangles = [0, 1, 0, 1, 0, 0];
    assert_ne!(MeshHash::of(&other).unordered, hash.unordered);
    // The same mesh, whose vertices have other numbers.
    let mut other = base.clone();
    other.vertices.to_mut().swap(0, 3);
    let renumbered = |index: &u32| [3, 1, 2, 0][*index as usize];
    other.indices = other.indices.iter().map(renumbered).collect::<Vec<_>>().into();
    assert_eq!(MeshHash::of(&other), hash);
    let prefix = PrefixId::cut(0, 0, 0);
    assert_eq!(encode(&other, prefix), encode(&small_region(), prefix));
    // The same triangles from another corner on.
    let mut other = base;
    other.indices.to_mut()[..3].rotate_left(1);
    let turned = MeshHash::of(&other);
    assert_eq!(turned.unordered, hash.unordered);
    assert_ne!(turned.ordered, hash.ordered);
}

#[test]
fn every_normal_is_rounded_to_the_nearest() {
    for n in i16::MIN..=i16::MAX {
        let normal = [n, 0];
        let sent = WireVertex::quantise(&Vertex {
            normal,
            ..vertex([0; 3])
        })
        .normal[0];
        let nearest = (f64::from(n) * 127.0 / 32767.0).round() as i8;
        assert_eq!(sent, nearest, "{n}");
    }
}

/// The index codec may rotate a triangle, never reorder or flip it.
fn turned(indices: &[u32]) -> Vec<[u32; 3]> {
    let rotated = |t: &[u32]| {
        [[t[0], t[1], t[2]], [t[1], t[2], t[0]], [t[2], t[0], t[1]]]
            .into_iter()
            .min()
    };
    indices.chunks_exact(3).filter_map(rotated).collect()
}

/// Triangles with the vertices of their corners, each rotated to start at its minimum corner, sorted.
fn sorted(corners: Vec<WireVertex>) -> Vec<[[i32; 7]; 3]> {
    let key = |v: &WireVertex| -> [i32; 7] {
        let [x, y, z] = v.position.map(i32::from);
        let [a, b] = v.normal.map(i32::from);
        [x, y, z, a, b, v.smoothness.into(), v.feature.into()]
    };
    let turn = |t: &[WireVertex]| {
        let [a, b, c] = [key(&t[0]), key(&t[1]), key(&t[2])];
        [[a, b, c], [b, c, a], [c, a, b]].into_iter().min()
    };
    let mut triangles: Vec<_> = corners.chunks_exact(3).filter_map(turn).collect();
    triangles.sort_unstable();
    triangles
}

fn any_vertex() -> impl Strategy<Value = Vertex> {
    let coordinate = -64 * 65536..=64 * 65536_i32;
    (
        [coordinate.clone(), coordinate.clone(), coordinate],
        any::<[i16; 2]>(),
        any::<u16>(),
        any::<u16>(),
    )
        .prop_map(|(position, normal, smoothness, feature)| Vertex {
            position,
            normal,
            smoothness,
            feature,
        })
}

prop_compose! {
    fn any_region()(vertices in prop::collection::vec(any_vertex(), 1..300))(
        triangles in prop::collection::vec([0..vertices.len() as u32, 0..vertices.len() as u32, 0..vertices.len() as u32], 1..400),
        coords in any::<[u16; 3]>(),
        size in 0..=2_u8,
        split in 0.0..1.0,
        vertices in Just(vertices),
    ) -> Region {
        let fine = (triangles.len() as f64 * split) as u32;
        Region {
            coords: coords.map(|c| u32::from(c) << size),
            size,
            vertices: vertices.into(),
            values: Vec::new().into(),
            level_triangles: [fine, 0, triangles.len() as u32 - fine, 0, 0, 0],
            indices: triangles.into_iter().flatten().collect::<Vec<_>>().into(),
            error: None,
        }
    }
}

/// A wavy sheet of `n`² squares.
fn sheet(n: u32) -> Region {
    let unit = Vertex::LATTICE;
    let at = |i: u32| [i % (n + 1), i / (n + 1), i * i % 5].map(|x| x as i32 * unit);
    let squares = (0..n * n).map(|i| i % n + (n + 1) * (i / n));
    let indices = squares.flat_map(|i| [i, i + 1, i + n + 1, i + n + 1, i + 1, i + n + 2]);
    Region {
        vertices: (0..(n + 1) * (n + 1)).map(|i| vertex(at(i))).collect::<Vec<_>>().into(),
        indices: indices.collect::<Vec<_>>().into(),
        level_triangles: [2 * n * n, 0, 0, 0, 0, 0],
        ..Region::default()
    }
}

/// Bits of position and value of each vertex, sorted.
fn placed(positions: impl Iterator<Item = [i16; 3]>, values: &[f32]) -> Vec<([i16; 3], u32)> {
    let mut placed: Vec<_> = positions.zip(values.iter().map(|value| value.to_bits())).collect();
    placed.sort_unstable();
    placed
}

#[test]
fn values_follow_their_vertices_in_both_codings() {
    let plain = sheet(20);
    let count = plain.vertices.len();
    // Whole numbers are exact.
    let mut values: Vec<f32> = (0..count).map(|i| (i * 7 % 60_000) as f32 - 500.0).collect();
    values[count / 2] = f32::NAN;
    let region = Region {
        values: values.clone().into(),
        ..plain.clone()
    };
    let (id, key) = (PrefixId::cut(1, 2, 3), region.key());
    let (with, without) = (
        encode(&region, id).expect("valid region"),
        encode(&plain, id).expect("valid region"),
    );
    let decoded = decode(&with).expect("decodes");
    let bare = decode(&without).expect("decodes");
    assert_eq!((&decoded.vertices, &decoded.indices), (&bare.vertices, &bare.indices));
    assert_eq!((decoded.header.region, bare.values.len()), (key, 0));
    let positions = |vertices: &[WireVertex]| vertices.iter().map(|vertex| vertex.position).collect::<Vec<_>>();
    let used: std::collections::BTreeSet<u32> = region.indices.iter().copied().collect();
    let own = used
        .iter()
        .map(|&index| WireVertex::quantise(&region.vertices[index as usize]).position);
    let own_values: Vec<f32> = used.iter().map(|&index| values[index as usize]).collect();
    let expected = placed(own, &own_values);
    assert_eq!(
        placed(positions(&decoded.vertices).into_iter(), &decoded.values),
        expected
    );

    let predictive = predictive::encode(&with).expect("encodes");
    let coded = decode(&predictive).expect("decodes");
    assert_eq!(coded.header.coding, Coding::Predictive);
    assert_eq!(placed(positions(&coded.vertices).into_iter(), &coded.values), expected);

    assert_eq!(without_values(&with), without);
    assert_eq!(without_values(&without), without);
    let bare_predictive = predictive::encode(&without).expect("encodes");
    assert_eq!(without_values(&predictive), bare_predictive);
    assert_ne!(MeshHash::of(&region), MeshHash::of(&plain));
    for length in HEADER_BYTES..with.len() {
        assert!(decode(&with[..length]).is_err(), "{length} bytes");
    }
}

#[test]
fn values_that_do_not_fit_the_vertices_are_refused() {
    let region = Region {
        values: vec![1.0; 3].into(),
        ..small_region()
    };
    let error = encode(&region, PrefixId::cut(0, 0, 0)).expect_err("refused");
    assert_eq!(error.why, "3 values of 4 vertices");
}

proptest! {
    #[test]
    fn any_region_makes_the_round_trip(region in any_region()) {
        let frame = encode(&region, PrefixId::cut(3, u32::MAX, 5)).expect("valid region");
        let chunk = decode(&frame).expect("decodes");
        prop_assert_eq!(chunk.header.region, region.key());
        prop_assert_eq!(chunk.header.level_triangles, region.level_triangles);
        // The same triangles of each level, in any order, no vertex twice and none unused.
        let mut first = 0;
        for triangles in region.level_triangles {
            let end = first + 3 * triangles as usize;
            let sent = |i: &u32| WireVertex::quantise(&region.vertices[*i as usize]);
            let came = |i: &u32| chunk.vertices[*i as usize];
            prop_assert_eq!(
                sorted(region.indices[first..end].iter().map(sent).collect()),
                sorted(chunk.indices[first..end].iter().map(came).collect())
            );
            first = end;
        }
        let mut used = region.indices.to_vec();
        used.sort_unstable();
        used.dedup();
        prop_assert_eq!(chunk.vertices.len(), used.len());
    }

    #[test]
    fn attributes_keep_their_ends_and_a_byte(value: u16) {
        let sent = super::leading_byte(value);
        prop_assert!(sent.abs_diff(value) <= 128);
        prop_assert_eq!(super::leading_byte(0), 0);
        prop_assert_eq!(super::leading_byte(u16::MAX), u16::MAX);
        prop_assert_eq!(super::leading_byte(sent), sent);
    }

    #[test]
    fn a_shared_vertex_stays_shared(position in prop::array::uniform3(-32 * 65536..=32 * 65536_i32)) {
        let here = WireVertex::quantise(&vertex(position));
        let there = WireVertex::quantise(&vertex(position.map(|p| p - 32 * 65536)));
        prop_assert_eq!(here.position, there.position.map(|p| p + 32 * 64));
    }

    #[test]
    fn noise_never_panics(mut bytes in prop::collection::vec(any::<u8>(), 0..300), magic: bool) {
        if magic && bytes.len() >= 8 {
            bytes[..8].copy_from_slice(&[b'I', b'S', b'O', b'P', 3, 0, 96, 0]);
        }
        let _ = decode(&bytes);
    }

    #[test]
    fn a_flipped_byte_never_panics(at: prop::sample::Index, flip in 1..=255_u8) {
        let mut frame = small_chunk();
        let at = at.index(frame.len());
        frame[at] ^= flip;
        let _ = decode(&frame);
    }
}

/// Errors come in the order of the chunk's vertices, which is not the device's.
#[test]
fn errors_of_vertices_have_the_order_of_their_chunk() {
    let mut region = small_region();
    region.indices = vec![3, 1, 2, 2, 1, 0].into();
    let errors: Vec<f32> = region
        .vertices
        .iter()
        .map(|vertex| vertex.position[0] as f32 + 7.0 * vertex.position[1] as f32)
        .collect();
    let prefix = PrefixId {
        kind: ChunkKind::Error,
        ..PrefixId::cut(0, 3, 0)
    };
    let plain = encode(&region, PrefixId::cut(0, 3, 0)).expect("a chunk");
    let predictive = predictive::encode(&plain).expect("a chunk");
    for (coding, chunk) in [(Coding::Predictive, &predictive), (Coding::Meshopt, &plain)] {
        let frame = encode_errors(&region, &errors, (prefix, coding)).expect("errors");
        let (header, found) = decode_errors(&frame).expect("a chunk of errors");
        let chunk = decode(chunk).expect("a chunk");
        assert_eq!(
            (header.region, header.vertex_count),
            (chunk.header.region, chunk.header.vertex_count)
        );
        let vertices = chunk.vertices.iter();
        let expected = vertices.map(|v| 1024.0 * (f32::from(v.position[0]) + 7.0 * f32::from(v.position[1])));
        assert_eq!(found, expected.collect::<Vec<f32>>());
    }
    let frame = encode_errors(&region, &errors, (prefix, Coding::Meshopt)).expect("errors");
    assert!(decode(&frame).is_err(), "it is no mesh");
    assert!(decode_errors(&encode(&region, PrefixId::cut(0, 3, 0)).expect("a chunk")).is_err());
    for length in 0..frame.len() {
        assert!(decode_errors(&frame[..length]).is_err(), "{length} bytes");
    }
    assert!(encode_errors(&region, &errors[1..], (prefix, Coding::Meshopt)).is_err());
}
