use isopeel_kernels::{Region, Vertex};
use proptest::prelude::*;

use super::super::chunk::{Coding, DecodedChunk, HEADER_BYTES, PrefixId, WireVertex};
use super::super::decode::decode;
use super::super::encode::encode as encode_meshopt;
use super::{encode, order};

/// A triangle's level and corners, the lowest corner first.
type Corners = (usize, [WireVertex; 3]);

/// All triangles of a chunk, sorted.
fn triangles(chunk: &DecodedChunk) -> Vec<Corners> {
    let levels = chunk.header.level_triangles.iter().enumerate();
    let levels = levels.flat_map(|(level, &count)| std::iter::repeat_n(level, count as usize));
    let corner = |index: u32| chunk.vertices[index as usize];
    let key = |of: &WireVertex| (of.position, of.normal, of.smoothness, of.feature);
    let mut all: Vec<_> = (chunk.indices.as_chunks::<3>().0.iter().zip(levels))
        .map(|(&[a, b, c], level)| {
            let turned = [[a, b, c], [b, c, a], [c, a, b]].map(|turned| turned.map(corner));
            (
                level,
                turned
                    .into_iter()
                    .min_by_key(|corners| corners.map(|corner| key(&corner)))
                    .expect("three"),
            )
        })
        .collect();
    all.sort_by_key(|(level, corners)| (*level, corners.map(|corner| key(&corner))));
    all
}

/// Asserts that recoding keeps a chunk's triangles. Returns its bytes before and after.
fn comes_back(region: &Region) -> (usize, usize) {
    let plain = encode_meshopt(region, PrefixId::cut(1, 9, 2)).expect("a valid region");
    let coded = encode(&plain).expect("encodes");
    let (before, after) = (decode(&plain).expect("decodes"), decode(&coded).expect("decodes"));
    assert_eq!(after.header.coding, Coding::Predictive);
    assert_eq!(
        (after.header.prefix, after.header.region),
        (before.header.prefix, before.header.region)
    );
    assert_eq!(triangles(&before), triangles(&after));
    let order = order(&plain).expect("encodes");
    let reordered: Vec<_> = order.iter().map(|&old| before.vertices[old as usize]).collect();
    assert_eq!(reordered, after.vertices);
    (plain.len(), coded.len())
}

fn region(vertices: Vec<Vertex>, levels: &[Vec<u32>]) -> Region {
    let mut level_triangles = [0; 6];
    for (count, indices) in level_triangles.iter_mut().zip(levels) {
        *count = indices.len() as u32 / 3;
    }
    Region {
        coords: [3, 0, 1],
        size: 0,
        vertices: vertices.into(),
        indices: levels.concat().into(),
        values: Vec::new().into(),
        level_triangles,
        error: None,
    }
}

/// A wavy sheet with `n` quads along each side, whose finer levels are in spots.
fn sheet(n: u32) -> Region {
    let mut vertices = Vec::new();
    for y in 0..=n {
        for x in 0..=n {
            let [u, v] = [x, y].map(|i| f64::from(i) / f64::from(n) * 4.0);
            let (height, slope_x, slope_y) = ((u.sin() + v.cos()) * 0.5, u.cos() * 0.5, -v.sin() * 0.5);
            let length = slope_x.abs() + slope_y.abs() + 1.0;
            let jitter = f64::from((x * 7919 + y * 104_729) % 13) * 9.0;
            let units = 65536.0 * 7.0;
            vertices.push(Vertex {
                position: [u * units + jitter * 60.0, v * units, (height + 1.0) * units].map(|p| p as i32),
                normal: [-slope_x, -slope_y].map(|slope| (slope / length * 32767.0) as i16),
                smoothness: (20000.0 + 15000.0 * u.sin()) as u16,
                feature: if x == 0 {
                    u16::MAX
                } else {
                    (30000.0 + 9000.0 * v.cos()) as u16
                },
            });
        }
    }
    let mut levels = vec![Vec::new(); 3];
    for y in 0..n {
        for x in 0..n {
            let (a, level) = (y * (n + 1) + x, (x / 5 + y / 7) % 3);
            levels[level as usize].extend([a, a + 1, a + n + 2, a, a + n + 2, a + n + 1]);
        }
    }
    region(vertices, &levels)
}

#[test]
fn a_surface_takes_two_thirds_of_the_bytes() {
    for n in [1, 2, 12, 40] {
        let (before, after) = comes_back(&sheet(n));
        if n == 40 {
            assert!(after * 3 < before * 2, "{after} bytes of {before}");
        }
    }
}

/// A chunk of the demo in both codings, which the viewer's tests read too.
#[test]
fn bytes_are_golden() {
    let folder = concat!(env!("CARGO_MANIFEST_DIR"), "/../../tests/fixtures/chunks/");
    let [plain, golden] =
        ["meshopt.bin", "predictive.bin"].map(|name| std::fs::read(format!("{folder}{name}")).expect(name));
    let coded = encode(&plain.clone().into()).expect("encodes");
    assert!(coded == golden, "{} bytes, {} are golden", coded.len(), golden.len());
    assert_eq!(
        triangles(&decode(&plain).expect("decodes")),
        triangles(&decode(&golden).expect("decodes"))
    );
}

#[test]
fn what_has_no_surface_stays() {
    let gone = encode_meshopt(&Region::default(), PrefixId::cut(0, 1, 0)).expect("encodes");
    assert_eq!(encode(&gone).expect("stays"), gone);
}

#[test]
fn no_prefix_of_a_chunk_is_one() {
    let plain = encode_meshopt(&sheet(3), PrefixId::cut(0, 1, 0)).expect("encodes");
    let coded = encode(&plain).expect("encodes");
    for length in 0..coded.len() {
        assert!(decode(&coded[..length]).is_err(), "{length} bytes");
        // The header of a shorter payload.
        if let Some(bytes) = length.checked_sub(HEADER_BYTES) {
            let mut shorter = coded[..length].to_vec();
            shorter[64..68].copy_from_slice(&(bytes as u32).to_le_bytes());
            assert!(decode(&shorter).is_err(), "{length} bytes with their header");
        }
    }
    assert!(encode(&coded).is_err(), "it has this coding already");
}

proptest! {
    #[test]
    fn any_triangles_come_back(
        positions in prop::collection::vec(any::<[i32; 3]>(), 12),
        shift in 6..22_i32,
        corners in prop::collection::vec([0..12_u32, 0..12_u32, 0..12_u32], 1..60),
        split in 0.0..1.0,
    ) {
        let vertices = positions.iter().enumerate().map(|(number, position)| Vertex {
            // As far as 16 bits reach.
            position: position.map(|p| (p >> shift).min((1 << 25) - 1024)),
            normal: [(position[0] >> 16) as i16, number as i16],
            smoothness: position[1] as u16,
            feature: position[2] as u16,
        });
        let middle = (corners.len() as f64 * split) as usize;
        comes_back(&region(vertices.collect(), &[corners[..middle].concat(), Vec::new(), corners[middle..].concat()]));
    }

    #[test]
    fn damaged_chunks_do_no_harm(at in HEADER_BYTES..400, value in any::<u8>(), counts in any::<Option<[u8; 2]>>()) {
        let plain = encode_meshopt(&sheet(6), PrefixId::cut(0, 1, 0)).expect("encodes");
        let mut coded = encode(&plain).expect("encodes").to_vec();
        if let Some(byte) = coded.get_mut(at) {
            *byte = value;
        }
        if let Some([vertices, triangles]) = counts {
            coded[56] = vertices;
            coded[60..64].copy_from_slice(&(3 * u32::from(triangles)).to_le_bytes());
            coded[72..84].fill(0);
            coded[72] = triangles;
        }
        if let Ok(decoded) = decode(&coded) {
            let vertices = decoded.vertices.len() as u32;
            prop_assert!(decoded.indices.iter().all(|&index| index < vertices));
        }
    }
}
