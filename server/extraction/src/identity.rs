//! Identity of full surfaces and of views. These are the keys of everything that is stored about a surface: cached pyramids and trees,
//! counts, steps that viewers share, and the surface that a client holds. Keys are compared and hashed by value; clones are cheap.

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

use isopeel_kernels::Isovalue;
use isopeel_view::quality::{
    Budget, Distance, ErrorLimit, Fitted, MaxError, MesherName, ShareBudget, TopologyName, TriangleBudget,
};
use isopeel_view::{CameraJson, ChosenPartsJson, FeatureName, InterestJson, TransferFunctionJson, View};
use isopeel_volumes::VolumeStep;
use serde::{Deserialize, Serialize};

use super::keys::{VolumeKey, color_key};

/// Number of the last engine.
pub(crate) static LAST_ENGINE: AtomicU64 = AtomicU64::new(0);

/// Identity of an opened device: a device that was lost and reopened is another engine.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct EngineId(u64);

impl EngineId {
    /// Returns the id of a device that is opened now, which is unique in the process.
    pub(crate) fn new() -> Self {
        Self(LAST_ENGINE.fetch_add(1, Ordering::Relaxed) + 1)
    }

    /// Returns the id as a number, which threads can share in an atomic.
    pub fn number(self) -> u64 {
        self.0
    }

    /// Returns the id with this number.
    pub fn of_number(number: u64) -> Self {
        Self(number)
    }
}

/// Returns bits that are equal if the numbers are equal: 0 and −0 have the same bits.
fn bits(number: f32) -> u32 {
    (number + 0.0).to_bits()
}

/// As [`bits`], for 64-bit numbers.
fn long_bits(number: f64) -> u64 {
    (number + 0.0).to_bits()
}

/// All that the cells and the triangles of a full surface depend on.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
struct CrossingKey {
    samples: VolumeKey,
    /// `None` if the field has no finite sample to choose an isovalue from.
    iso: Option<u32>,
}

/// All that a pyramid and its vertex tree depend on.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub(crate) struct PyramidKey {
    crossing: CrossingKey,
    feature: FeatureName,
}

impl PyramidKey {
    pub(crate) fn new(volume: &VolumeStep, view: &View) -> Self {
        Self {
            crossing: CrossingKey {
                samples: VolumeKey::shown(volume, view, view.cap),
                iso: view.iso.map(|iso| bits(Isovalue::get(iso))),
            },
            feature: view.feature.clone(),
        }
    }

    /// Returns the key of the samples of the shown field.
    pub(crate) fn samples(&self) -> &VolumeKey {
        &self.crossing.samples
    }
}

/// Rules by which parts of a full surface are left out.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
struct PartRules {
    /// Bits of the minimum area.
    min_area: u64,
    /// Bits of the positions that select parts. True: these parts are hidden; false: only these parts are kept.
    chosen: Option<(bool, Vec<[u64; 3]>)>,
}

impl PartRules {
    fn new(view: &View) -> Self {
        let bits_of = |positions: &[[f64; 3]]| positions.iter().map(|position| position.map(long_bits)).collect();
        Self {
            min_area: long_bits(view.min_part),
            chosen: view.parts.as_ref().map(|parts| match parts {
                ChosenPartsJson::Hide(positions) => (true, bits_of(positions)),
                ChosenPartsJson::Keep(positions) => (false, bits_of(positions)),
            }),
        }
    }
}

/// Identity of the full surface of a resolved view: samples and their revision, engine, time step, field, mask, isovalue, feature and its
/// range, the field for colours, and the parts that are left out.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub struct SurfaceKey(Arc<SurfaceParts>);

#[derive(Debug, PartialEq, Eq, Hash)]
struct SurfaceParts {
    engine: EngineId,
    pyramid: PyramidKey,
    feature_range: Option<[u32; 2]>,
    /// The field whose values accompany the vertices.
    colors: Option<VolumeKey>,
    parts: PartRules,
}

impl SurfaceKey {
    /// Returns the key of the full surface of a view of a time step, made by this engine.
    pub fn new(engine: EngineId, volume: &VolumeStep, view: &View) -> Self {
        Self(Arc::new(SurfaceParts {
            engine,
            pyramid: PyramidKey::new(volume, view),
            feature_range: view.feature_range.map(|range| range.map(bits)),
            colors: color_key(volume, view),
            parts: PartRules::new(view),
        }))
    }

    /// Whether the full surfaces have the same cells and triangles, small parts included.
    pub fn has_triangles_of(&self, other: &Self) -> bool {
        self.0.pyramid.crossing == other.0.pyramid.crossing
    }

    /// Whether the full surfaces also have the same vertices, including the values of the feature and those for colours.
    pub fn has_vertices_of(&self, other: &Self) -> bool {
        let vertices = |key: &Self| (key.0.engine, key.0.feature_range);
        self.0.pyramid == other.0.pyramid && vertices(self) == vertices(other) && self.0.colors == other.0.colors
    }
}

/// The criterion that decides how fine a surface is.
#[derive(Debug, PartialEq, Eq, Hash)]
enum CriterionKey {
    /// Importance up to which cubes are merged.
    Beta(u32),
    Error {
        error: Option<ErrorKey>,
        budget: Option<BudgetKey>,
    },
}

#[derive(Debug, PartialEq, Eq, Hash)]
enum DistanceKey {
    World(u32),
    Spacings(u32),
}

#[derive(Debug, PartialEq, Eq, Hash)]
enum ErrorKey {
    Distance(DistanceKey),
    Pixels(u32),
}

#[derive(Debug, PartialEq, Eq, Hash)]
enum BudgetKey {
    Triangles(u64),
    Share { share: u64, max: Option<u64> },
    Bytes(u64),
}

#[derive(Debug, PartialEq, Eq, Hash)]
enum GuardKey {
    Auto,
    None,
    At(DistanceKey),
}

/// A region of interest, with its numbers as bits.
#[derive(Debug, PartialEq, Eq, Hash)]
struct InterestKey {
    sphere: Option<[u64; 4]>,
    cuboid: Option<[[u64; 3]; 2]>,
    importance: u32,
}

/// A camera, with its numbers as bits. `None` of a pair: the other one of field of view and height is given.
#[derive(Debug, PartialEq, Eq, Hash)]
struct CameraKey {
    vectors: [[u64; 3]; 3],
    projection: [Option<u64>; 2],
    viewport: [u32; 2],
}

/// Identity of a resolved view: its full surface, and everything that decides how much each part of that surface is decimated. Colours
/// are not part of the key, because they belong to clients.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub struct ViewKey(Arc<ViewParts>);

#[derive(Debug, PartialEq, Eq, Hash)]
struct ViewParts {
    surface: SurfaceKey,
    criterion: CriterionKey,
    max_error: GuardKey,
    topology: TopologyName,
    mesher: MesherName,
    max_level: u8,
    alpha: u32,
    /// Position and importance of each control point.
    transfer: Vec<[u32; 2]>,
    interest: Vec<InterestKey>,
    /// The camera in force.
    camera: Option<CameraKey>,
}

impl ViewKey {
    /// Returns the key of a view whose full surface has the key `surface`.
    pub fn new(surface: SurfaceKey, view: &View) -> Self {
        Self(Arc::new(ViewParts {
            surface,
            criterion: CriterionKey::of(view),
            max_error: match view.max_error {
                MaxError::Auto => GuardKey::Auto,
                MaxError::None => GuardKey::None,
                MaxError::At(distance) => GuardKey::At(distance.into()),
            },
            topology: view.topology,
            mesher: view.mesher,
            max_level: view.max_level.get(),
            alpha: bits(view.alpha),
            transfer: transfer_key(&view.transfer_function),
            interest: view.interest.iter().map(InterestKey::of).collect(),
            camera: view.camera_in_force().map(CameraKey::of),
        }))
    }

    /// Returns the key of the view's full surface.
    pub fn surface(&self) -> &SurfaceKey {
        &self.0.surface
    }

    /// Estimates the bytes that this key takes.
    pub fn bytes(&self) -> usize {
        let ViewParts {
            surface,
            transfer,
            interest,
            ..
        } = &*self.0;
        let positions = surface
            .0
            .parts
            .chosen
            .as_ref()
            .map_or(0, |(_, positions)| positions.len());
        size_of::<ViewParts>()
            + size_of::<SurfaceParts>()
            + size_of_val(&transfer[..])
            + size_of_val(&interest[..])
            + positions * size_of::<[u64; 3]>()
    }
}

impl CriterionKey {
    fn of(view: &View) -> Self {
        if view.error.is_none() && view.budget.is_none() {
            return Self::Beta(bits(view.beta));
        }
        Self::Error {
            error: view.error.map(|error| match error {
                ErrorLimit::Distance(distance) => ErrorKey::Distance(distance.into()),
                ErrorLimit::Pixels(pixels) => ErrorKey::Pixels(bits(pixels)),
            }),
            budget: view.budget.map(BudgetKey::from),
        }
    }
}

impl From<Distance> for DistanceKey {
    fn from(distance: Distance) -> Self {
        match distance {
            Distance::World(distance) => Self::World(bits(distance)),
            Distance::Spacings(count) => Self::Spacings(bits(count)),
        }
    }
}

impl From<Budget> for BudgetKey {
    fn from(budget: Budget) -> Self {
        match budget {
            Budget::Triangles(TriangleBudget::AtMost(triangles)) => Self::Triangles(triangles),
            Budget::Triangles(TriangleBudget::Share(ShareBudget { share, max })) => Self::Share {
                share: long_bits(share),
                max,
            },
            Budget::Bytes(bytes) => Self::Bytes(bytes),
        }
    }
}

impl CameraKey {
    fn of(camera: &CameraJson) -> Self {
        Self {
            vectors: [camera.position, camera.target, camera.up].map(|vector| vector.map(long_bits)),
            projection: [camera.fov, camera.height].map(|number| number.map(long_bits)),
            viewport: camera.viewport,
        }
    }
}

impl InterestKey {
    fn of(interest: &InterestJson) -> Self {
        Self {
            sphere: interest.sphere.map(|sphere| {
                let [x, y, z] = sphere.center;
                [x, y, z, sphere.radius].map(long_bits)
            }),
            cuboid: interest
                .cuboid
                .map(|cuboid| [cuboid.min, cuboid.max].map(|corner| corner.map(long_bits))),
            importance: bits(interest.importance),
        }
    }
}

fn transfer_key(transfer: &TransferFunctionJson) -> Vec<[u32; 2]> {
    let points = transfer.points.iter();
    points.map(|point| [point.x, point.importance].map(bits)).collect()
}

/// The threshold and the topology that keep a budget, as part of a key.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct FittedKey {
    threshold: u32,
    keeps_topology: bool,
    triangles: u64,
    is_tree_cut: bool,
}

impl From<Fitted> for FittedKey {
    fn from(fitted: Fitted) -> Self {
        Self {
            threshold: bits(fitted.threshold),
            keeps_topology: fitted.topology == isopeel_kernels::Topology::Preserve,
            triangles: fitted.triangles,
            is_tree_cut: fitted.is_tree_cut,
        }
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use isopeel_view::{CameraJson, Edit, View};
    use isopeel_volumes::{Dataset, VolumeStep, testing};

    use super::{EngineId, SurfaceKey, ViewKey};

    fn dataset() -> Dataset {
        Dataset {
            steps: 3,
            ..testing::dataset("head", [9; 3], &["density", "labels"])
        }
    }

    fn volume(dataset: Dataset, step: u32) -> VolumeStep {
        VolumeStep::new(Arc::new(dataset), step).expect("a step")
    }

    fn view(edit: &str) -> View {
        let edit: Edit = serde_json::from_str(edit).expect("an edit");
        let fields = ["density", "labels"];
        let plain = View::plain(&fields).apply(&edit, &fields).expect("a good edit");
        View {
            feature_range: Some(plain.feature_range.unwrap_or([0.0, 1.0])),
            ..plain
        }
    }

    fn key(edit: &str) -> ViewKey {
        let view = view(edit);
        ViewKey::new(
            SurfaceKey::new(EngineId::default(), &volume(dataset(), 0), &view),
            &view,
        )
    }

    #[test]
    fn every_value_of_a_view_is_in_its_key_but_colours() {
        let edits = [
            r#"{"iso":1}"#,
            r#"{"iso":2}"#,
            r#"{"iso":1,"field":"labels"}"#,
            r#"{"iso":1,"mask":"labels==1"}"#,
            r#"{"iso":1,"mask":"labels==2"}"#,
            r#"{"iso":1,"feature":"gradient-magnitude"}"#,
            r#"{"iso":1,"featureRange":[0,2]}"#,
            r#"{"iso":1,"colorField":"labels"}"#,
            r#"{"iso":1,"colorField":"density"}"#,
            r#"{"iso":1,"colorField":"density+labels"}"#,
            r#"{"iso":1,"alpha":0.5}"#,
            r#"{"iso":1,"beta":0.5}"#,
            r#"{"iso":1,"error":0.5}"#,
            r#"{"iso":1,"error":"0.5vx"}"#,
            r#"{"iso":1,"error":0.5,"triangles":9}"#,
            r#"{"iso":1,"triangles":9}"#,
            r#"{"iso":1,"bytes":9}"#,
            r#"{"iso":1,"triangles":{"share":0.5}}"#,
            r#"{"iso":1,"triangles":{"share":0.5,"max":9}}"#,
            r#"{"iso":1,"error":0.5,"minPart":2}"#,
            r#"{"iso":1,"error":0.5,"parts":{"hide":[[1,2,3]]}}"#,
            r#"{"iso":1,"error":0.5,"parts":{"keep":[[1,2,3]]}}"#,
            r#"{"iso":1,"maxError":0.5}"#,
            r#"{"iso":1,"maxError":null}"#,
            r#"{"iso":1,"topology":"free"}"#,
            r#"{"iso":1,"mesher":"marching-cubes"}"#,
            r#"{"iso":1,"cap":true}"#,
            r#"{"iso":1,"maxLevel":2}"#,
            r##"{"iso":1,"transferFunction":{"points":[{"x":0,"importance":1,"color":"#000000"}]}}"##,
            r#"{"iso":1,"interest":[{"sphere":{"center":[1,2,3],"radius":4},"importance":1}]}"#,
            r#"{"iso":1,"interest":[{"sphere":{"center":[1,2,3],"radius":5},"importance":1}]}"#,
            r#"{"iso":1,"interest":[{"box":{"min":[1,2,3],"max":[4,5,6]},"importance":1}]}"#,
            r#"{"iso":1,"error":"0.5px"}"#,
            r#"{"iso":1,"error":0.5,"camera":{"position":[1,2,3],"target":[4,5,6],"fov":30,"viewport":[7,8]}}"#,
            r#"{"iso":1,"error":0.5,"camera":{"position":[1,2,4],"target":[4,5,6],"fov":30,"viewport":[7,8]}}"#,
            r#"{"iso":1,"error":0.5,"camera":{"position":[1,2,3],"target":[4,5,7],"fov":30,"viewport":[7,8]}}"#,
            r#"{"iso":1,"error":0.5,"camera":{"position":[1,2,3],"target":[4,5,6],"up":[0,1,0],"fov":30,"viewport":[7,8]}}"#,
            r#"{"iso":1,"error":0.5,"camera":{"position":[1,2,3],"target":[4,5,6],"fov":31,"viewport":[7,8]}}"#,
            r#"{"iso":1,"error":0.5,"camera":{"position":[1,2,3],"target":[4,5,6],"height":30,"viewport":[7,8]}}"#,
            r#"{"iso":1,"error":0.5,"camera":{"position":[1,2,3],"target":[4,5,6],"fov":30,"viewport":[7,9]}}"#,
        ];
        for (i, one) in edits.iter().enumerate() {
            assert_eq!(key(one), key(one));
            for other in &edits[..i] {
                assert_ne!(key(one), key(other), "{one} {other}");
            }
        }
        let coloured = |color| {
            format!(r##"{{"iso":1,"transferFunction":{{"points":[{{"x":0,"importance":1,"color":"{color}"}}]}}}}"##)
        };
        assert_eq!(key(&coloured("#000000")), key(&coloured("#123456")));
        assert_eq!(key(r#"{"iso":0}"#), key(r#"{"iso":-0.0}"#), "zero has one sign");
        // Values without influence are not part of the key.
        let seen = |edit: &str| {
            let camera = r#"{"position":[1,2,3],"target":[4,5,6],"fov":30,"viewport":[7,8]}"#;
            let camera: CameraJson = serde_json::from_str(camera).expect("a camera");
            ViewKey::new(
                key(edit).surface().clone(),
                &View {
                    camera: Some(Box::new(camera)),
                    ..view(edit)
                },
            )
        };
        for edit in [r#"{"iso":1,"beta":0.5}"#, r#"{"iso":1,"error":0.5,"detail":"uniform"}"#] {
            assert_eq!(key(edit), seen(edit), "{edit}");
        }
        assert_eq!(
            key(r#"{"iso":1,"error":0.5}"#),
            ViewKey::new(
                key(r#"{"iso":1}"#).surface().clone(),
                &View {
                    beta: 0.75,
                    ..view(r#"{"iso":1,"error":0.5}"#)
                }
            )
        );
    }

    #[test]
    fn samples_engine_and_step_are_in_the_key_of_a_surface() {
        let view = view(r#"{"iso":1}"#);
        let of = |engine, dataset, step| SurfaceKey::new(engine, &volume(dataset, step), &view);
        let first = of(EngineId::default(), dataset(), 0);
        let another_revision = Dataset {
            revision: 1,
            ..dataset()
        };
        let rewritten = Dataset {
            rewrites: vec![1],
            ..dataset()
        };
        for other in [
            of(EngineId::default(), dataset(), 1),
            of(EngineId::default(), another_revision, 0),
            of(EngineId::default(), rewritten.clone(), 0),
        ] {
            assert!(!first.has_triangles_of(&other), "{other:?}");
        }
        let step = |dataset| of(EngineId::default(), dataset, 1);
        assert_eq!(step(rewritten), step(dataset()), "another step was rewritten");
        let elsewhere = of(EngineId::new(), dataset(), 0);
        assert!(first.has_triangles_of(&elsewhere) && !first.has_vertices_of(&elsewhere));
    }

    #[test]
    fn a_feature_changes_vertices_but_no_triangles() {
        let plain = key(r#"{"iso":1}"#);
        for edit in [
            r#"{"iso":1,"feature":"labels"}"#,
            r#"{"iso":1,"featureRange":[0,2]}"#,
            r#"{"iso":1,"colorField":"labels"}"#,
        ] {
            let other = key(edit);
            assert!(plain.surface().has_triangles_of(other.surface()), "{edit}");
            assert!(!plain.surface().has_vertices_of(other.surface()), "{edit}");
        }
        let masked = key(r#"{"iso":1,"mask":"labels==1"}"#);
        assert!(!plain.surface().has_triangles_of(masked.surface()));
    }
}
