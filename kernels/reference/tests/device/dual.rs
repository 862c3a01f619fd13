//! The dual mesher's polygons on any cut, corner for corner. Which way a polygon is split is the device's own choice.

use super::recipes::{recipes, surfaces};
use super::*;
use isopeel_reference::dual::{Corner, polygons};
use isopeel_reference::vertices::DualVertices;
use isopeel_reference::{Feature as TwinFeature, construct, sheets};

/// A triangle's corners, the smallest first.
fn rotated(mut t: [Corner; 3]) -> [Corner; 3] {
    let first = (0..3).min_by_key(|&i| t[i]).unwrap_or(0);
    t.rotate_left(first);
    t
}

#[test]
fn any_cut_has_the_twins_polygons() {
    let Some(engine) = device() else { return };
    proptest!(config(12), |(recipe in recipes(surfaces()), seed in any::<u64>(), preserve in any::<bool>())| {
        let loaded = load(&engine, &recipe);
        let pyramid = build(&engine, &loaded, Feature::None);
        let host = HostPyramid::read(&engine, &pyramid);
        let topology = if preserve { Topology::Preserve } else { Topology::Free };
        let state = host.random_state(seed, topology);
        let by_leaf = host.by_leaf(&state);
        let regions = mesh(&engine, &loaded, &pyramid, &dual_params(), &state).regions;

        let twin = construct::construct(&loaded.field, TwinFeature::None, loaded.iso);
        let of_cell = |(&c, cell): (&[u32; 3], &construct::Cell)| {
            (c, sheets::cell_sheets(&loaded.field, loaded.iso, c, cell.signs))
        };
        let vertices = DualVertices { sheets: twin.cells.iter().map(of_cell).collect(), ..DualVertices::default() };
        let want = polygons(&loaded.field, &twin, &vertices, loaded.iso, &host.cut(&twin, &state));

        let own: HashMap<[i64; 3], Corner> = host.vertices(&state).map(|slot| (host.position(slot), host.corner(slot))).collect();
        let mut corners = own;
        let mut got: HashMap<[Corner; 3], u32> = HashMap::default();
        for t in welded(&regions) {
            for p in t {
                if let std::collections::hash_map::Entry::Vacant(entry) = corners.entry(p) {
                    entry.insert(host.border_corner(&by_leaf, p)?);
                }
            }
            *got.entry(rotated(t.map(|p| corners[&p]))).or_default() += 1;
        }
        let mut take = |triangles: &[[usize; 3]], polygon: &[Corner]| {
            let of: Vec<_> = triangles.iter().map(|t| rotated(t.map(|i| polygon[i]))).collect();
            let there = of.iter().all(|t| got.get(t).is_some_and(|n| *n > 0));
            if there {
                of.iter().for_each(|t| *got.get_mut(t).expect("it is there") -= 1);
            }
            there
        };
        let mut by_level = [0u32; 6];
        for ((level, low, axis), polygon) in &want {
            by_level[usize::from(*level)] += polygon.len() as u32 - 2;
            let found = match polygon.len() {
                3 => take(&[[0, 1, 2]], polygon),
                4 => take(&[[0, 1, 2], [0, 2, 3]], polygon) || take(&[[1, 2, 3], [1, 3, 0]], polygon),
                n => return Err(TestCaseError::fail(format!("a polygon of {n} corners"))),
            };
            prop_assert!(found, "the polygon around the edge of level {} at {:?} along {}: {:?}", level, low, axis, polygon);
        }
        let left: Vec<_> = got.iter().filter(|(_, n)| **n > 0).collect();
        prop_assert!(left.is_empty(), "triangles of no polygon: {:?}", left);
        let triangles: Vec<u32> = (0..6).map(|l| regions.iter().map(|r| r.level_triangles[l]).sum()).collect();
        prop_assert_eq!(triangles, by_level.to_vec(), "triangles by level");
    });
}
