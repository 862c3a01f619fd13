//! A request and a reply of each type.

use std::sync::Arc;
use std::time::Duration;

use isopeel_geometry::UnevenAxes;
use isopeel_kernels::{
    DerivedFeature, DistanceOf, ErrorEstimate, Grid, Isovalue, Level, OverviewMode, OverviewWork, RectilinearGrid,
    RefinementCost, Region, RegionKey, RemovedParts, SampleType, StageTime, Surface, SurfaceError, SurfaceStatistics,
    Topology, VectorFeature, Vertex,
};
use isopeel_view::quality::{
    Budget, Distance, ErrorLimit, Fitted, MaxError, PixelError, PixelLimit, ShareBudget, TriangleBudget,
};
use isopeel_view::{Edit, FeatureName, Mask, VectorName};
use isopeel_volumes::{AxisKind, AxisScale, Dataset, Frame, Label, LengthUnit, Notices, TimeAxis, testing};

use super::super::*;
use crate::MeasuredError;
use crate::keys::{HistogramKey, VolumeKey};
use crate::questions::{
    Curve, CurvePoint, Distribution, FieldValue, LeafKind, NearestLeaf, NearestSurface, NoValue, Probe, Question,
    ShownSurface, VertexErrors,
};
use crate::results::{CutId, Making, Refining, Shown, Step};

const FIELDS: &[&str] = &["density", "heat", "labels"];

fn volume() -> VolumeStep {
    let mut dataset: Dataset = testing::dataset("head", [3, 2, 2], FIELDS);
    dataset.geometry.spacing = [0.5, 1.0, 2.0];
    dataset.geometry.frame = Frame::Ras;
    dataset.geometry.unit = Some(LengthUnit::Millimetre);
    dataset.uneven = UnevenAxes::new([Some(&[0.0, 1.0, 5.0]), None, None]).map(Arc::new);
    let scale = AxisScale {
        name: "lon".into(),
        unit: Some("degrees_east".into()),
        kind: AxisKind::Longitude,
        positions: Some(vec![0.1, 0.2, 0.7]),
        points_down: false,
    };
    dataset.axes = Some(Arc::new([Some(scale), None, None]));
    dataset.times = TimeAxis::listed(vec![0.0, 31.5, 59.0], "days since 1850-01-01", None);
    dataset.steps = 3;
    dataset.rewrites = vec![0, 2];
    dataset.revision = 7;
    dataset.notices = Notices::of("CC0");
    let opening =
        r#"{"iso":0.1,"interest":[{"importance":1,"sphere":{"center":[-1,2e300,0.30000000000000004]}}],"x":null}"#;
    dataset.opening = serde_json::from_str(opening).ok();
    dataset.fields[1].missing = Some(-9999.0);
    dataset.fields[1].unit = Some("K".into());
    dataset.fields[2].labels = vec![Label::new(i64::MIN, "bone", Some([1, 2, 3]))];
    VolumeStep::new(Arc::new(dataset), 1).expect("a step")
}

fn view() -> View {
    let edit = r##"{"iso":1.5,"alpha":0.25,"maxError":"0.5vx","minPart":2.5,"maxLevel":4,
        "error":"1.5px","triangles":{"share":0.25},"mask":"labels==1,4..7",
        "parts":{"hide":[[1,2,3]]},"interest":[{"box":{"min":[0,0,0],"max":[1,2,3]},"importance":0.5}],
        "camera":{"position":[0,0,9],"target":[0,0,0],"up":[0,1,0],"fov":45,"viewport":[640,480]},
        "transferFunction":{"points":[{"x":0.1,"importance":1,"color":"#00ff00"}]}}"##;
    let edit: Edit = serde_json::from_str(edit).expect("an edit");
    let components = ["density", "heat", "density+heat"].map(str::to_owned);
    View {
        feature: FeatureName::Vector(Box::new(VectorName::new(VectorFeature::Lambda2, components))),
        feature_range: Some([-1.0, f32::MAX]),
        fitted: Some(Fitted {
            threshold: f32::NEG_INFINITY,
            topology: Topology::Free,
            triangles: 300,
            is_tree_cut: true,
            pixels: Some(PixelError {
                within: f32::INFINITY,
                limited_by: PixelLimit::Budget,
            }),
        }),
        ..View::plain(FIELDS).apply(&edit, FIELDS).expect("a good edit")
    }
}

/// Returns a view with other forms of the same values.
fn other_view() -> View {
    View {
        iso: Isovalue::new(-0.0).ok(),
        error: Some(ErrorLimit::Distance(Distance::World(0.5))),
        budget: Some(Budget::Triangles(TriangleBudget::Share(ShareBudget {
            share: 0.1,
            max: Some(9),
        }))),
        max_error: MaxError::None,
        feature: FeatureName::Derived(DerivedFeature::MeanCurvature),
        camera: None,
        ..view()
    }
}

pub fn key() -> VolumeKey {
    VolumeKey {
        mask: Mask::parse("labels!=3", FIELDS).ok(),
        ..VolumeKey::new(&volume(), "density", true)
    }
}

pub fn histogram_key() -> HistogramKey {
    HistogramKey {
        volume: key(),
        computed: FeatureName::Field("heat".into()),
    }
}

fn overview_part() -> isopeel_kernels::OverviewPart {
    let work = OverviewWork::new([100, 50, 20], OverviewMode::Maximum, 16);
    work.next().expect("a part").clone()
}

/// Returns values of an overview, which only a device makes.
fn overview_values() -> OverviewValues {
    let values: Vec<u8> = [1.0f32, f32::NEG_INFINITY, -2.0, 3.0].map(f32::to_ne_bytes).concat();
    let counts: Vec<u8> = [7u32, 0].map(u32::to_ne_bytes).concat();
    let form = ((2usize, 9u32), 5usize, values, counts, Some(overview_part()));
    let bytes = postcard::to_stdvec(&form).expect("serialized");
    postcard::from_bytes(&bytes).expect("values of an overview")
}

pub fn requests() -> Vec<DeviceRequest> {
    let (volume, view, key) = (volume(), view(), key());
    let step = Step {
        shown: Shown::AlikeCut(CutId::new(4)),
        target: Some(CutId::new(u64::MAX)),
        made_triangles: 1,
        fresh_triangles: 2,
        triangles: 3,
        bytes: 4,
        line_bytes: 5,
    };
    let making = Making {
        refining: Refining::AtCaps,
        ..Making::default()
    };
    let shown = ShownSurface {
        view: other_view(),
        cut: CutId::new(3),
    };
    let grid = Grid::new([3, 2, 2], [0.5, 1.0, 2.0]).expect("a grid");
    let lengths = [vec![0.25, 0.75], vec![1.0], vec![2.0]];
    let uneven = RectilinearGrid::uneven(grid, lengths).expect("a rectilinear grid");
    let work = HistogramWork::default();
    let part = overview_part();
    let samples = Samples::I16(vec![-1, 2]);
    macro_rules! list {
        ($($name:ident { $($field:ident $(: $value:expr)?),* $(,)? })*) => {
            vec![$($name { $($field: list!(@ $field $($value)?)),* }.into()),*]
        };
        (@ $field:ident) => { $field.clone() };
        (@ $field:ident $value:expr) => { $value };
    }
    list! {
        Resolve { volume, view }
        Prepare { volume, view: other_view() }
        Count { volume, view }
        Refine { volume, view, step: step, ceiling: 9 }
        Improve { volume, view, ceiling: u64::MAX }
        Measure { volume, view: View::plain(FIELDS) }
        Extract { volume, view, making: making }
        Ask { volume, shown: Some(shown), question: Question::Probe([0.5, -1e300, 2.0]) }
        Ask { volume, shown: None, question: Question::VertexErrors(DistanceOf::Around) }
        FindResident { keys: vec![key.clone(), VolumeKey::new(&volume, "heat", false)] }
        UseField { volume, key }
        Compute { volume, key, user: Some("me".into()) }
        BeginUpload {
            key, grid: Arc::new(uneven), sample_type: SampleType::I16, missing: Some(-1.0), ahead_budget: Some(8)
        }
        ContinueUpload { key, samples: samples }
        ContinueTable { key }
        FinishUpload { key, is_ahead: true }
        DropUpload { key }
        MakeSpaceAhead { volume, key, budget: 77 }
        MakeHostSpace { bytes: 1 << 40 }
        Release { step: volume.key() }
        UseHistogramFields { volume, key: histogram_key() }
        ContinueHistogram { volume, key: histogram_key(), work }
        ContinueOverview { volume, key, part }
        ReadSamples { volume, key, planes: 1..2 }
        ReadSlice { volume, key, axis: 2, index: 1 }
        CheckAnswers {}
    }
}

fn region() -> Region {
    let vertex = |x| Vertex {
        position: [x, -2, 3],
        normal: [-32767, 1],
        smoothness: 65535,
        feature: 9,
    };
    Region {
        coords: [1, 2, 4],
        size: 1,
        vertices: vec![vertex(-1), vertex(70_000), vertex(5)].into(),
        indices: vec![0, 1, 2, 2, 1, 0].into(),
        values: Vec::new().into(),
        level_triangles: [1, 0, 0, 1, 0, 0],
        error: Some(SurfaceError { rms: 0.5, max: 1.5 }),
    }
}

fn stages() -> Vec<StageTime> {
    let stage = |stage, milliseconds| StageTime { stage, milliseconds };
    vec![stage("minmax", 0.1), stage("construct", 1e-9)]
}

fn surface() -> Surface {
    Surface {
        regions: vec![region(), Region::default()],
        remade: Some(vec![RegionKey::smallest([1, 2, 3])]),
        prefix: Level::new(3).expect("a level"),
        statistics: SurfaceStatistics {
            full_triangles: 12,
            removed: Some(RemovedParts {
                parts: 1,
                full_triangles: 2,
                unmatched: 3,
            }),
            leaves: [1, 2, 3, 4, 5, 6],
            estimate: ErrorEstimate {
                rms: 0.25,
                worst_leaf: f32::INFINITY,
            },
            stages: stages(),
            ..SurfaceStatistics::default()
        },
    }
}

fn refinement() -> Refinement {
    Refinement {
        surface: surface(),
        view: view(),
        cut: CutId::new(8),
        target: Some(CutId::new(9)),
        is_final: true,
        can_improve: true,
        wall: Duration::new(3, 999_999_999),
        meshing: Duration::from_nanos(1),
    }
}

fn probe() -> Probe {
    let value = |field: &str, value, why| FieldValue {
        field: field.into(),
        value,
        why,
    };
    Probe {
        position: [1.0, 2.0, 3.0],
        inside: true,
        values: vec![
            value("a", Some(1.5), None),
            value("b", None, Some(NoValue::NotResident)),
        ],
        nearest: Some(NearestSurface {
            distance: 0.5,
            smoothness: 0.1,
            feature: 0.2,
            blended: 0.3,
            importance: 0.4,
            leaf: Some(NearestLeaf {
                kind: LeafKind::Tree,
                level: 2,
                error: 0.25,
            }),
            part: Some(1),
            part_area: None,
        }),
    }
}

fn answers() -> [Answer; 4] {
    [
        Answer::Probe(probe()),
        Answer::Distribution(Distribution {
            kind: LeafKind::Cubes,
            bins: vec![1, 300],
            coarse: vec![0, 7],
            coarse_share: 0.1,
        }),
        Answer::Curve(Curve {
            kind: LeafKind::Tree,
            by_error: true,
            points: vec![CurvePoint {
                triangles: 9,
                rms: 0.5,
                threshold: -1.0,
            }],
        }),
        Answer::VertexErrors(vec![VertexErrors {
            region: region(),
            distances: vec![0.5, f32::INFINITY, 2.0],
        }]),
    ]
}

pub fn replies() -> Vec<DeviceReply> {
    use DeviceReply as R;
    let whole = MeasuredError { rms: 0.5, max: 2.0 };
    let histogram = Histogram {
        range: [-1.0, 2.0],
        bins: vec![0, u64::MAX, 3],
    };
    let mut replies = vec![
        R::Resolve(view()),
        R::Prepare(other_view()),
        R::Count(FullCount {
            triangles: 3,
            stages: stages(),
            wall: Duration::from_millis(1500),
        }),
        R::Refine(refinement()),
        R::Improve(Some(refinement())),
        R::Improve(None),
        R::Measure(Some(Measurement {
            whole,
            regions: vec![([1, 2, 3], whole)],
        })),
        R::Extract(Extraction {
            surface: surface(),
            view: view(),
            wall: Duration::from_secs(7),
            measured: Some(whole),
            refined: Some(RefinementCost {
                triangles: 5,
                rounds: 2,
            }),
        }),
        R::FindResident(vec![true, false]),
        R::UseField(()),
        R::Compute(true),
        R::BeginUpload(false),
        R::ContinueUpload(()),
        R::ContinueTable(true),
        R::FinishUpload(()),
        R::DropUpload(()),
        R::MakeSpaceAhead(true),
        R::MakeHostSpace(()),
        R::Release(()),
        R::UseHistogramFields(()),
        R::ContinueHistogram((HistogramWork::default(), Some(histogram))),
        R::ContinueOverview(overview_values()),
        R::ReadSamples(Samples::U16(vec![1, 65535])),
        R::ReadSlice(Slice {
            sample_type: SampleType::F32,
            bytes: vec![1, 2, 3, 4],
        }),
        R::CheckAnswers(true),
    ];
    replies.extend(answers().map(R::Ask));
    replies
}
