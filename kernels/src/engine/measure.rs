//! Measures the error of a simplified surface against the full one without reading the mesh back. Viewers request it when the
//! camera is at rest.

use super::peel::Mesh;
use super::tree_cut::TreeMesh;
use crate::cancel::check_cancelled;
use crate::mesh_regions::MeshRegions;
use crate::mesh_regions::triangles;
use crate::{
    Cancel, CutParams, Engine, Error, Level, MeasuredError, Mesher, Pyramid, Result, TreeGoal, VertexTree, Volume,
};

impl Engine {
    /// Error of the final surface that [`Engine::peel`] would make, which is meshed on the device but not read back. Measuring ends
    /// soon after a cancellation. Stage times are this call's.
    ///
    /// # Errors
    /// [`Error::Cancelled`], or an error of the device; [`Error::Invalid`] for another mesher than the dual one.
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
        self.cx.take_times()?;
        let params = CutParams {
            state_error: true,
            ..params.clone()
        };
        let cut = self.cut(volume, pyramid, &params, Level::FINEST)?;
        check_cancelled(cancel)?;
        let mesh = self.mesh(volume, pyramid, &params, &cut, cancel)?;
        self.measured(mesh)
    }

    /// As [`Engine::measure_error`], of the surface that [`Engine::tree_surface`] would make.
    ///
    /// # Errors
    /// [`Error::Cancelled`], or an error of the device.
    pub fn measure_tree_error(
        &self,
        volume: &Volume,
        pyramid: &Pyramid,
        tree: &VertexTree,
        params: &CutParams,
        goal: &TreeGoal,
        cancel: &dyn Cancel,
    ) -> Result<MeasuredError> {
        self.cx.take_times()?;
        let params = CutParams {
            state_error: true,
            ..params.clone()
        };
        let cutter = self.cutter_for(volume, pyramid, tree, &params, goal, cancel)?;
        let (work, _) = self.cut_tree(&cutter, &params, goal, cancel)?;
        let (meshes, offset_sums) = (cutter.meshes(&work)?, cutter.offsets(&work)?);
        let all = MeshRegions::all(pyramid);
        let TreeMesh { mesh, .. } = self.mesh_tree_cut(&cutter, &params, &work, &meshes, &all, offset_sums, cancel)?;
        self.measured(mesh)
    }

    /// Collects the measured errors of a mesh, for the regions that have triangles.
    fn measured(&self, mesh: Mesh) -> Result<MeasuredError> {
        let (errors, whole) = mesh.errors.unwrap_or_default();
        let filled = mesh.keys.iter().zip(&mesh.regions).zip(errors);
        Ok(MeasuredError {
            whole,
            regions: filled
                .filter(|((_, mesh), _)| triangles(mesh) > 0)
                .map(|((key, _), error)| (key.coords, error))
                .collect(),
            stages: self.cx.take_times()?,
        })
    }
}
