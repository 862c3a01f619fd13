//! The stated error of any cut's dual mesh, region by region.

use super::recipes::{recipes, surfaces};
use super::*;
use isopeel_kernels::SurfaceError;
use isopeel_reference::error::{MeasuredMesh, Sheet, Stated, Triangle, errors};
use isopeel_reference::{Feature as TwinFeature, construct, sheets};
use std::collections::BTreeMap;

fn is_near(got: SurfaceError, [minimum, maximum]: Stated, spacing: f32) -> bool {
    let near = |got: f32, minimum: f32, maximum: f32| {
        let slack = |of: f32| 2e-3 * of + 2e-3 * spacing;
        got >= minimum - slack(minimum) && got <= maximum + slack(maximum)
    };
    near(got.rms, minimum.rms, maximum.rms) && near(got.max, minimum.max, maximum.max)
}

#[test]
fn any_cut_states_the_twins_errors() {
    let Some(engine) = device() else { return };
    proptest!(config(12), |(recipe in recipes(surfaces()), seed in any::<u64>(), preserve in any::<bool>())| {
        let loaded = load(&engine, &recipe);
        let pyramid = build(&engine, &loaded, Feature::None);
        let host = HostPyramid::read(&engine, &pyramid);
        let topology = if preserve { Topology::Preserve } else { Topology::Free };
        let state = host.random_state(seed, topology);
        let by_leaf = host.by_leaf(&state);
        let (field, iso) = (&loaded.field, loaded.iso);
        let params = CutParams { state_error: true, ..dual_params() };
        let Surface { regions, statistics, .. } = mesh(&engine, &loaded, &pyramid, &params, &state);
        let whole = statistics.error.expect("asked for");

        let twin = construct::construct(field, TwinFeature::None, iso);
        let of_cell = |(&c, cell): (&[u32; 3], &construct::Cell)| (c, sheets::cell_sheets(field, iso, c, cell.signs));
        let sheets: BTreeMap<_, _> = twin.cells.iter().map(of_cell).collect();
        let world = |p: [i64; 3]| -> [f64; 3] {
            std::array::from_fn(|i| p[i] as f64 / f64::from(Vertex::LATTICE) * f64::from(field.grid.spacing[i]))
        };
        let sheet = |slot: usize| -> Sheet { let (leaf, sheet, _) = host.corner(slot); (leaf, sheet) };
        let vertices: BTreeMap<Sheet, [f64; 3]> =
            host.vertices(&state).map(|slot| (sheet(slot), world(host.position(slot)))).collect();
        let mut at: HashMap<[i64; 3], Sheet> =
            host.vertices(&state).map(|slot| (host.position(slot), sheet(slot))).collect();
        let mut triangles = Vec::new();
        for region in &regions {
            for corners in welded(std::slice::from_ref(region)) {
                for p in corners {
                    if let std::collections::hash_map::Entry::Vacant(entry) = at.entry(p) {
                        let (leaf, sheet, _) = host.border_corner(&by_leaf, p)?;
                        entry.insert((leaf, sheet));
                    }
                }
                triangles.push(Triangle {
                    region: region.coords,
                    sheets: corners.map(|p| at[&p]),
                    corners: corners.map(world),
                });
            }
        }
        let mesh = MeasuredMesh { cut: &host.cut(&twin, &state), sheets: &sheets, vertices: &vertices, triangles: &triangles };
        let (want, want_whole) = errors(field, iso, &mesh);
        let spacing = field.grid.spacing.iter().fold(0.0f32, |m, &s| m.max(s));
        for region in &regions {
            let (got, want) = (region.error.expect("asked for"), want[&region.coords]);
            prop_assert!(is_near(got, want, spacing), "region {:?}: {:?}, expected {:?}", region.coords, got, want);
        }
        if !triangles.is_empty() {
            prop_assert!(is_near(whole, want_whole, spacing), "the whole: {:?}, expected {:?}", whole, want_whole);
        }
    });
}
