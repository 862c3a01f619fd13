//! Queries on the current surface of a viewer: the probe of a position, the distribution of a feature over the leaves, the curve of the
//! error over the number of triangles, and the errors of vertices. Only the last one makes the surface again.

mod answers;

use std::sync::Arc;

use isopeel_geometry::IndexSpace;
use isopeel_kernels::{
    CURVE_POINTS, Cancel, Cut, CutParams, DistanceOf, DistributionCounts, Level, MAX_BINS, ShownCut, lock,
};
use isopeel_view::View;
use isopeel_volumes::VolumeStep;
use serde::{Deserialize, Serialize};

use super::context::JobContext;
use super::decisions::{TreeCut, TreeMaking};
use super::job_error::JobError;
use super::keys::VolumeKey;
use super::on_device::{Nodes, OnDevice};
use super::statistics::in_world;
use super::workspace::Workspace;
use super::{CutId, WorkError};
pub use answers::{
    Answer, Curve, CurvePoint, Distribution, FieldValue, LeafKind, NearestLeaf, NearestSurface, NoValue, Probe,
    VertexErrors,
};

const _: () = assert!(CURVE_POINTS == 32 && MAX_BINS == 256, "PROTOCOL.md says so");

/// Maximum distance in cells at which a position outside the volume counts as on its face, to allow for rounding.
const FACE_CELLS: f64 = 1e-3;

/// A question about a surface.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub enum Question {
    /// Which values and which surface are at this position of the world?
    Probe([f64; 3]),
    /// How are values distributed, in this number of bins?
    Distribution(u32),
    /// How does the error depend on the number of triangles?
    Curve,
    /// How far from the isosurface is each vertex? Or, by [`DistanceOf`]: how far is the farthest point of the mesh around it?
    VertexErrors(DistanceOf),
}

/// The surface that a question is about.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct ShownSurface {
    /// The view.
    pub view: View,
    /// The cut.
    pub cut: CutId,
}

impl Question {
    /// Checks the question's parameters.
    ///
    /// # Errors
    /// A sentence that names the invalid parameter.
    pub fn check(&self) -> Result<(), String> {
        match self {
            Self::Probe(position) if !position.iter().all(|x| x.is_finite()) => {
                Err(format!("position: {position:?}, expected finite numbers"))
            }
            Self::Distribution(bins) if !(1..=MAX_BINS).contains(bins) => {
                Err(format!("bins: {bins}, expected 1 to {MAX_BINS}"))
            }
            _ => Ok(()),
        }
    }
}

impl Workspace {
    /// Answers a question about the surface that is shown. If no surface is shown, a probe is answered for the volume alone.
    ///
    /// # Errors
    /// [`WorkError::NothingShown`], and those of [`Workspace::refine`].
    pub fn answer(
        &mut self,
        volume: &VolumeStep,
        shown: Option<&ShownSurface>,
        question: Question,
        context: &mut JobContext<'_, Self>,
    ) -> Result<Answer, JobError> {
        match (question, shown) {
            (Question::Probe(position), shown) => Ok(Answer::Probe(self.probe(volume, shown, position, context)?)),
            (_, None) => Err(WorkError::NothingShown.into()),
            (Question::Distribution(bins), Some(shown)) => {
                let counts = self.with_shown_cut(volume, shown, context, |job, params, cut, _| {
                    let counts = job.engine.distribution(job.volume, job.pyramid, params, cut, bins)?;
                    Ok((kind_of(cut), counts))
                })?;
                Ok(Answer::Distribution(distribution(counts)))
            }
            (Question::VertexErrors(distance_of), Some(shown)) => Ok(Answer::VertexErrors(self.vertex_errors(
                volume,
                shown,
                distance_of,
                context,
            )?)),
            (Question::Curve, Some(shown)) => {
                let by_error = shown.view.is_by_error();
                let curve = self.with_shown_cut(volume, shown, context, |job, params, cut, cancel| {
                    // There is no tolerance if the full surface is within the budget: nothing has been merged then, so it is 0.
                    let tolerance = by_error.then(|| params.tolerance.unwrap_or(0.0));
                    let params = CutParams {
                        tolerance,
                        ..params.clone()
                    };
                    let points = job.engine.error_curve(job.volume, job.pyramid, &params, cut, cancel)?;
                    Ok((kind_of(cut), points))
                })?;
                let (kind, points) = curve;
                let smallest = volume.dataset().smallest_length();
                let in_world = |point| CurvePoint::in_world(point, by_error, smallest);
                Ok(Answer::Curve(Curve {
                    kind,
                    by_error,
                    points: points.into_iter().map(in_world).collect(),
                }))
            }
        }
    }

    /// Returns the values of all fields at a position of the world, and the vertex of the surface that is nearest to it.
    fn probe(
        &mut self,
        volume: &VolumeStep,
        shown: Option<&ShownSurface>,
        position: [f64; 3],
        context: &mut JobContext<'_, Self>,
    ) -> Result<Probe, JobError> {
        let Some(index) = index_of(volume, position) else {
            return Ok(Probe {
                position,
                inside: false,
                values: Vec::new(),
                nearest: None,
            });
        };
        let nearest = match shown {
            None => None,
            Some(shown) => self.with_shown_cut(volume, shown, context, |job, params, cut, _| {
                let view = &shown.view;
                // With `cap`, the volume of the surface is padded.
                let Some(index) = index_inside(&job.index_space, job.volume.grid().dims, position) else {
                    return Ok(None);
                };
                let nearest = job.engine.probe(job.volume, job.pyramid, params, index, Some(cut))?;
                Ok(nearest.map(|nearest| NearestSurface {
                    distance: in_world(nearest.distance, job.smallest),
                    smoothness: nearest.smoothness,
                    feature: view.feature.range_in_world([nearest.feature; 2], job.smallest)[0],
                    blended: nearest.blended,
                    importance: nearest.importance,
                    leaf: nearest.leaf.map(|leaf| NearestLeaf {
                        kind: kind_of(cut),
                        level: leaf.level,
                        error: in_world(leaf.error, job.smallest),
                    }),
                    part: nearest.part.map(|part| part.number),
                    part_area: nearest
                        .part
                        .map(|part| in_world(part.area, job.smallest * job.smallest)),
                }))
            })?,
        };
        Ok(Probe {
            position,
            inside: true,
            values: self.values_at(volume, shown, index)?,
            nearest,
        })
    }

    /// Makes the shown surface again, and measures the distances of its vertices.
    fn vertex_errors(
        &mut self,
        volume: &VolumeStep,
        shown: &ShownSurface,
        distance_of: DistanceOf,
        context: &mut JobContext<'_, Self>,
    ) -> Result<Vec<VertexErrors>, JobError> {
        let mut view = shown.view.clone();
        self.with_pyramid(volume, &mut view, Nodes::All, context, |job, view, cancel| {
            let is_tree_cut = view.is_by_error() && view.fitted.is_some_and(|fitted| fitted.is_tree_cut);
            let tree_cut = match is_tree_cut {
                true => job.tree_surface(&mut view.clone(), TreeMaking::whole(u64::MAX), cancel)?,
                false => TreeCut::NoTree,
            };
            let surface = match tree_cut {
                TreeCut::Made(made) => made.surface,
                TreeCut::Refused(_) | TreeCut::NoTree => {
                    let (params, cut) = (job.params_of(view), job.cut_of(shown.cut, view)?);
                    let mut surface = job
                        .engine
                        .surface(job.volume, job.pyramid, &params, &cut, None, cancel)?;
                    job.set_values(&mut surface.regions, cancel)?;
                    surface
                }
            };
            let regions = surface.regions;
            let distances = job
                .engine
                .vertex_distances(job.volume, job.pyramid, &regions, distance_of, cancel)?;
            let pairs = regions.into_iter().zip(distances);
            let in_world = |length| in_world(length, job.smallest);
            Ok(pairs
                .map(|(region, distances)| VertexErrors {
                    region,
                    distances: distances.into_iter().map(in_world).collect(),
                })
                .collect())
        })
    }

    /// Returns the value of every field at a position of index space, and that of the expression for colours, if the surface has one. Does
    /// not load fields that are not resident.
    fn values_at(
        &self,
        volume: &VolumeStep,
        shown: Option<&ShownSurface>,
        index: [f32; 3],
    ) -> Result<Vec<FieldValue>, JobError> {
        let names = volume.dataset().fields.iter().map(|field| &field.name);
        let expression = shown.and_then(|shown| shown.view.color_field.as_ref());
        let expression = expression.filter(|name| volume.dataset().field(name).is_none());
        let fields = names.chain(expression).map(|name| {
            let value = match self.resident(&VolumeKey::new(volume, name, false)) {
                None => Err(NoValue::NotResident),
                Some(resident) => {
                    let value = self.engine().value_at(resident, index)?;
                    value.filter(|value| value.is_finite()).ok_or(NoValue::Missing)
                }
            };
            Ok(FieldValue {
                field: name.clone(),
                value: value.ok(),
                why: value.err(),
            })
        });
        fields.collect()
    }

    /// Runs `work` with the cut of a surface that is shown, and the parameters of the surface's view. If the cut was evicted, makes it
    /// again.
    fn with_shown_cut<T>(
        &mut self,
        volume: &VolumeStep,
        shown: &ShownSurface,
        context: &mut JobContext<'_, Self>,
        work: impl Fn(&OnDevice<'_>, &CutParams, &ShownCut<'_>, &dyn Cancel) -> Result<T, JobError>,
    ) -> Result<T, JobError> {
        let mut view = shown.view.clone();
        self.with_pyramid(volume, &mut view, Nodes::All, context, |job, view, cancel| {
            let params = job.params_of(view);
            if view.is_by_error()
                && view.fitted.is_some_and(|fitted| fitted.is_tree_cut)
                && let Some(tree) = job.tree(view, &params, cancel)?
            {
                let goal = job.tree_goal(view, &tree, &params, cancel)?;
                let (engine, volume, pyramid) = (job.engine, job.volume, job.pyramid);
                let cut = engine.shown_tree_cut(volume, pyramid, &tree, &params, &goal, cancel)?;
                let answer = work(job, &params, &cut, cancel)?;
                job.cache_tree(&tree);
                return Ok(answer);
            }
            work(job, &params, &ShownCut::Cubes(&*job.cut_of(shown.cut, view)?), cancel)
        })
    }
}

impl OnDevice<'_> {
    /// Returns the cut of cubes that is shown. If the cut was evicted, makes it again from its view.
    fn cut_of(&self, id: CutId, view: &View) -> Result<Arc<Cut>, JobError> {
        let cached = lock(self.cuts).get(id).filter(|cut| cut.is_of(self.pyramid));
        match cached {
            Some(cut) => Ok(cut),
            None => {
                let params = self.params_of(view);
                Ok(Arc::new(self.engine.cut(
                    self.volume,
                    self.pyramid,
                    &params,
                    Level::FINEST,
                )?))
            }
        }
    }
}

/// Converts a position from the world to index space; `None` outside the volume.
fn index_of(volume: &VolumeStep, position: [f64; 3]) -> Option<[f32; 3]> {
    let dataset = volume.dataset();
    index_inside(&dataset.sample_space(), dataset.geometry.dims, position)
}

/// Converts a position from the world to index space; `None` outside a volume of these dimensions.
pub(crate) fn index_inside(index_space: &IndexSpace, dims: [u32; 3], position: [f64; 3]) -> Option<[f32; 3]> {
    let index = index_space.index(position.into());
    let ends = dims.map(|n| f64::from(n - 1));
    let is_inside = index
        .to_array()
        .iter()
        .zip(ends)
        .all(|(&x, end)| (-FACE_CELLS..=end + FACE_CELLS).contains(&x));
    let clamped = || std::array::from_fn(|i| index[i].clamp(0.0, ends[i]) as f32);
    is_inside.then(clamped)
}

fn kind_of(cut: &ShownCut<'_>) -> LeafKind {
    match cut {
        ShownCut::Cubes(_) => LeafKind::Cubes,
        ShownCut::Tree(..) => LeafKind::Tree,
    }
}

fn distribution((kind, counts): (LeafKind, DistributionCounts)) -> Distribution {
    let total = |bins: &[u32]| bins.iter().map(|&n| u64::from(n)).sum::<u64>();
    let (all, coarse) = (total(&counts.all), total(&counts.coarse));
    Distribution {
        kind,
        bins: counts.all,
        coarse: counts.coarse,
        coarse_share: if all > 0 { coarse as f64 / all as f64 } else { 0.0 },
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use isopeel_volumes::{VolumeStep, testing};

    use super::{Question, index_of};

    #[test]
    fn positions_outside_the_volume_have_no_index() {
        let dataset = Arc::new(testing::dataset("head", [5, 6, 7], &["density"]));
        let volume = VolumeStep::new(dataset, 0).expect("a step");
        let world = volume.dataset().geometry.world_from_index();
        let at = |index: [f64; 3]| index_of(&volume, world.transform_point3(index.into()).to_array());
        assert_eq!(at([0.0; 3]), Some([0.0; 3]));
        assert_eq!(at([4.0, 5.0, 6.0]), Some([4.0, 5.0, 6.0]));
        assert_eq!(at([4.0005, 5.0, -0.0005]), Some([4.0, 5.0, 0.0]), "rounding");
        for outside in [
            [4.1, 1.0, 1.0],
            [1.0, -0.1, 1.0],
            [1.0, 1.0, 6.1],
            [1e300, 0.0, 0.0],
            [f64::NAN, 0.0, 0.0],
        ] {
            assert_eq!(at(outside), None, "{outside:?}");
        }
    }

    #[test]
    fn questions_say_what_is_wrong_with_them() {
        assert!(Question::Probe([0.0, 1e300, -1.0]).check().is_ok());
        assert!(Question::Distribution(1).check().is_ok() && Question::Distribution(256).check().is_ok());
        let refused = |question: Question| question.check().expect_err("refused");
        assert!(refused(Question::Probe([0.0, f64::INFINITY, 0.0])).starts_with("position: "));
        assert_eq!(refused(Question::Distribution(257)), "bins: 257, expected 1 to 256");
        assert_eq!(refused(Question::Distribution(0)), "bins: 0, expected 1 to 256");
    }
}
