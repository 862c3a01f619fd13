//! Cuts: made from parameters, compared and mixed.

use crate::stages::cut::{self, Criterion};
use crate::stages::dual::Work;
use crate::{Cut, CutParams, Engine, Error, Level, Mesher, Pyramid, Result, Volume};

/// Bit of the region itself among those of its neighbours, x + 3 y + 9 z.
const ITSELF: u32 = 13;

/// The regions of a pyramid in which two cuts differ, by their index among its active regions.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Differences {
    /// Regions some of whose leaves differ.
    pub leaves: Vec<bool>,
    /// Regions whose meshes may differ: these, and those that a differing leaf touches from outside.
    pub meshes: Vec<bool>,
    /// For each region, one bit per neighbour that a differing leaf touches (`stages::cut::compare`).
    touched: Vec<u32>,
}

impl Differences {
    fn new(pyramid: &Pyramid, touched: Vec<u32>) -> Self {
        Self {
            leaves: touched.iter().map(|bits| bits >> ITSELF & 1 == 1).collect(),
            meshes: spread(pyramid, &touched),
            touched,
        }
    }

    /// Differences between the first cut and the mix that takes the leaves of the second cut in the regions of `take` ([`Engine::mix`]).
    pub fn to_mix(&self, pyramid: &Pyramid, take: &[bool]) -> Self {
        let both = self.touched.iter().zip(take);
        Self::new(
            pyramid,
            both.map(|(&bits, &take)| if take { bits } else { 0 }).collect(),
        )
    }
}

/// The shown surface. Meshing another cut reuses its meshes in all regions that do not differ.
#[derive(Clone, Copy)]
pub struct Kept<'a> {
    /// Cut of the shown surface; it was meshed.
    pub shown: &'a Cut,
    /// Differences between `shown` and the cut to be meshed.
    pub differences: &'a Differences,
}

impl Engine {
    /// Cuts a pyramid. With `prefix` above 0, undecided cubes of that level count as leaves
    /// (`docs/algorithm.md#9-progressive-stream`). `volume` is the one the pyramid was built from.
    ///
    /// # Errors
    /// Parameters that are out of range or do not fit the pyramid, or an error of the device.
    pub fn cut(&self, volume: &Volume, pyramid: &Pyramid, params: &CutParams, prefix: Level) -> Result<Cut> {
        check_request(volume, pyramid, params, prefix)?;
        let criterion = Criterion::upload(&self.cx, params, prefix)?;
        let state = self.cx.buffer(cut::STAGE, pyramid.nodes.len())?;
        let regions = cut::run(&self.cx, volume, pyramid, &criterion, &state)?;
        Ok(Cut {
            pyramid: pyramid.id,
            params: criterion.params,
            mesher: params.mesher,
            prefix,
            state,
            regions,
            counted: Default::default(),
            meshes: Default::default(),
            unpatched_vertices: Default::default(),
        })
    }

    /// Returns the regions in which two cuts differ; `None` if no mesh can be reused because the cuts have different pyramids,
    /// meshers or feature ranges.
    ///
    /// # Errors
    /// An error of the device.
    pub fn differences(
        &self,
        volume: &Volume,
        pyramid: &Pyramid,
        before: &Cut,
        after: &Cut,
    ) -> Result<Option<Differences>> {
        if !after.has_vertices_of(before) || after.pyramid != pyramid.id {
            return Ok(None);
        }
        let touched = cut::compare(&self.cx, volume, pyramid, &before.state, &after.state)?;
        Ok(Some(Differences::new(pyramid, touched)))
    }

    /// Returns the cut that has the leaves of `after` in the regions that `take` marks and the leaves of `before` in all others. The
    /// coarsest cube is a region, so every choice of regions gives a cut.
    ///
    /// # Errors
    /// An error of the device.
    pub fn mix(&self, volume: &Volume, pyramid: &Pyramid, before: &Cut, after: &Cut, take: &[bool]) -> Result<Cut> {
        let takes_after: Vec<u8> = take.iter().map(|&take| take.into()).collect();
        let state = self.cx.buffer(cut::STAGE, pyramid.nodes.len())?;
        cut::mix(
            &self.cx,
            volume,
            pyramid,
            &takes_after,
            &before.state,
            &after.state,
            &state,
        )?;
        let both = before.regions.iter().zip(&after.regions).zip(take);
        Ok(Cut {
            pyramid: pyramid.id,
            params: after.params,
            mesher: after.mesher,
            prefix: after.prefix,
            state,
            regions: both
                .map(|((before, after), &take)| if take { *after } else { *before })
                .collect(),
            counted: Default::default(),
            meshes: Default::default(),
            unpatched_vertices: Default::default(),
        })
    }
}

/// Returns the dual mesher's work in each region if only the regions of `remake` are meshed again. Their neighbours only count the
/// vertices that they share with them.
pub(super) fn work(pyramid: &Pyramid, remake: &[bool]) -> Vec<Work> {
    let bits: Vec<u32> = remake
        .iter()
        .map(|&remake| if remake { (1 << 27) - 1 } else { 0 })
        .collect();
    let counted = spread(pyramid, &bits);
    let both = remake.iter().zip(counted);
    both.map(|(&remake, counted)| match (remake, counted) {
        (true, _) => Work::Mesh,
        (false, true) => Work::Count,
        (false, false) => Work::None,
    })
    .collect()
}

/// The regions that bits of [`cut::compare`] touch.
fn spread(pyramid: &Pyramid, bits: &[u32]) -> Vec<bool> {
    let [rx, ry, rz] = pyramid.grid.regions().map(i64::from);
    // From a region to each of its neighbours: along each axis, and in the linear order.
    let steps: [([i64; 3], i64); 27] = std::array::from_fn(|bit| {
        let bit = bit as i64;
        let [x, y, z] = [bit % 3 - 1, bit / 3 % 3 - 1, bit / 9 - 1];
        ([x, y, z], (z * ry + y) * rx + x)
    });
    let is_inside = |at: i64, by: i64, count: i64| (0..count).contains(&(at + by));
    let mut touched = vec![false; bits.len()];
    for (region, &bits) in pyramid.host_regions.iter().zip(bits) {
        let linear = i64::from(region.region);
        let [x, y, z] = [linear % rx, linear / rx % ry, linear / rx / ry];
        let mut left = bits;
        while left != 0 {
            let ([dx, dy, dz], by) = steps[left.trailing_zeros() as usize];
            left &= left - 1;
            if is_inside(x, dx, rx) && is_inside(y, dy, ry) && is_inside(z, dz, rz) {
                let neighbour = pyramid.host_index[(linear + by) as usize];
                if neighbour != crate::layout::NONE {
                    touched[neighbour as usize] = true;
                }
            }
        }
    }
    touched
}

fn check_request(volume: &Volume, pyramid: &Pyramid, params: &CutParams, prefix: Level) -> Result<()> {
    params.check()?;
    if volume.grid != pyramid.grid {
        return Err(Error::Invalid {
            what: "pyramid",
            why: format!(
                "built from {:?} samples, expected {:?}",
                pyramid.grid.dims, volume.grid.dims
            ),
        });
    }
    if !pyramid.is_whole() && !params.is_full(prefix) {
        return Err(Error::Invalid {
            what: "pyramid",
            why: "built of cells alone, expected a whole one for this cut".to_owned(),
        });
    }
    if params.state_error && params.mesher != Mesher::Dual {
        return Err(Error::Invalid {
            what: "stated error",
            why: "asked for with the marching-cubes mesher, expected the dual mesher".to_owned(),
        });
    }
    Ok(())
}
