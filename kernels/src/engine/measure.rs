//! How far a surface is from the one it stands for, without the surface: what a viewer at rest asks for.

use super::peel::check_request;
use crate::cancel::check;
use crate::stages::{self, dual, error};
use crate::{Cancel, CutParams, Engine, Error, Level, MeasuredError, Mesher, Pyramid, Result, Volume};

impl Engine {
    /// Error of the final surface that [`Engine::peel`] would make, which is meshed on the device but not read back. Measuring ends
    /// soon after a cancellation. Stage times are this call's.
    ///
    /// # Errors
    /// [`Error::Cancelled`], or what the device says; [`Error::Invalid`] for another mesher than the dual one.
    pub fn measure_error(
        &self,
        volume: &Volume,
        pyramid: &Pyramid,
        params: &CutParams,
        cancel: &dyn Cancel,
    ) -> Result<MeasuredError> {
        if params.mesher != Mesher::Dual {
            return Err(Error::Invalid {
                what: "measured error",
                why: "asked for with the marching-cubes mesher, expected the dual mesher".to_owned(),
            });
        }
        check_request(volume, pyramid, params, Level::FINEST)?;
        let cx = &self.cx;
        cx.take_times()?;
        let cut = self.cut(volume, pyramid, params, Level::FINEST)?;
        check(cancel)?;
        let (counted, mut regions) = dual::count(cx, volume, pyramid, &cut.state, &cut.counters)?;
        check(cancel)?;
        let (meshes, vertices, indices) = self.allocate_mesh(dual::STAGE, &mut regions)?;
        let corner_slots = cx.buffer(error::STAGE, indices.len())?;
        let input = dual::Input {
            params: &cut.params,
            state: &cut.state,
            counted: &counted,
            meshes: &meshes,
            corner_slots: Some(&corner_slots),
        };
        dual::emit(cx, volume, pyramid, &input, &vertices, &indices)?;
        cx.finish(dual::STAGE)?;
        check(cancel)?;
        let slabs = stages::slab_work(volume, &pyramid.host_regions, pyramid.bricks.len());
        let input = error::Input {
            params: &cut.params,
            state: &cut.state,
            regions: &regions,
            meshes: &meshes,
            corner_slots: &corner_slots,
            indices: &indices,
            vertices: &vertices,
        };
        let (errors, whole) = error::run(cx, volume, pyramid, &slabs, &input, cancel)?;
        let [rx, ry, _] = pyramid.grid.regions();
        let coords = |region: u32| [region % rx, region / rx % ry, region / rx / ry];
        let filled = pyramid.host_regions.iter().zip(&regions).zip(errors);
        Ok(MeasuredError {
            whole,
            regions: filled
                .filter(|((_, mesh), _)| mesh.triangles.iter().any(|&n| n > 0))
                .map(|((region, _), error)| (coords(region.region), error))
                .collect(),
            stages: cx.take_times()?,
        })
    }
}
