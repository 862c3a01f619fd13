//! From a cut to a surface: counts, meshes, and the mesh back on the host.

use super::cut::work;
use crate::buffer::Buffer;
use crate::cancel::check_cancelled;
use crate::cut::CutMeshes;
use crate::layout::{self, Counters, RegionMesh};
use crate::lock::lock;
use crate::mesh_regions::{Joining, MeshRegions, join_meshes, keys, triangles};
use crate::stages::dual::{Counted, Work};
use crate::stages::{self, dual, error, march, pack, patch};
use crate::{
    Cancel, Count, Cut, CutParams, DeviceKind, Engine, Error, Kept, Level, Mesher, Pyramid, Region, RegionKey, Result,
    Surface, SurfaceError, SurfaceStatistics, Volume,
};
use rayon::prelude::*;
use std::ops::Range;
use std::sync::Arc;
use std::sync::atomic::Ordering;

/// Stage that reads a mesh back.
const READ_BACK: &str = "read back";

/// Triangles that a GPU makes although they are not wanted, if that spares counting once more, which takes longer.
const MAX_SPARE_TRIANGLES: usize = 2_000_000;
/// Beside these, so many for each wanted triangle.
const EXCESSIVE: usize = 4;

/// A mesh on the device.
pub(crate) struct Mesh {
    pub keys: Vec<RegionKey>,
    /// One for each key.
    pub regions: Vec<RegionMesh>,
    pub vertices: Buffer<layout::Vertex>,
    pub indices: Buffer<u32>,
    /// Errors of each region, and of the whole surface.
    pub errors: Option<(Vec<SurfaceError>, SurfaceError)>,
}

/// A mesh of a cut, or of the regions in which it may differ from a shown one.
struct MadeMesh {
    mesh: Mesh,
    /// The regions that are made; `None`: all of the surface.
    made: Option<MeshRegions>,
    meshes: CutMeshes,
    /// As [`Surface::remade`].
    remade: Option<Vec<RegionKey>>,
}

impl Engine {
    /// Cuts the pyramid and meshes the cut. With `prefix` above 0, undecided cubes of that level count as leaves
    /// (`docs/algorithm.md#9-progressive-stream`). `volume` is the one the pyramid was built from. Stage times are the pyramid's and this call's.
    ///
    /// # Errors
    /// [`Error::Cancelled`], or an error of the device.
    pub fn peel(
        &self,
        volume: &Volume,
        pyramid: &Pyramid,
        params: &CutParams,
        prefix: Level,
        cancel: &dyn Cancel,
    ) -> Result<Surface> {
        self.cx.take_times()?;
        let cut = self.cut(volume, pyramid, params, prefix)?;
        check_cancelled(cancel)?;
        let mut surface = self.surface(volume, pyramid, params, &cut, None, cancel)?;
        surface.statistics.stages.splice(0..0, pyramid.stages.iter().cloned());
        Ok(surface)
    }

    /// Meshes a cut. With `kept`, a shown surface of the same pyramid, meshes only the regions in which the two may differ
    /// ([`Surface::remade`]). Stage times are those since the last pyramid or surface.
    ///
    /// # Errors
    /// As [`Engine::peel`].
    pub fn surface(
        &self,
        volume: &Volume,
        pyramid: &Pyramid,
        params: &CutParams,
        cut: &Cut,
        kept: Option<Kept<'_>>,
        cancel: &dyn Cancel,
    ) -> Result<Surface> {
        let before = self.cx.pool.restart();
        let kept = kept.and_then(|kept| Some((&*kept.differences.meshes, lock(&kept.shown.meshes).clone()?)));
        // The error is measured by active regions.
        let is_joined = params.mesher == Mesher::Dual && !params.state_error;
        let MadeMesh {
            mesh,
            made,
            meshes,
            remade,
        } = match kept.filter(|_| is_joined) {
            Some((differs, shown)) => self.mesh_again(volume, pyramid, params, cut, (differs, &shown), cancel)?,
            None => {
                let mesh = self.mesh(volume, pyramid, params, cut, cancel)?;
                let counts = mesh.regions.clone();
                let regions = match is_joined {
                    true => joined(pyramid, &counts),
                    false => MeshRegions::all(pyramid),
                };
                MadeMesh {
                    mesh,
                    made: None,
                    meshes: CutMeshes { counts, regions },
                    remade: None,
                }
            }
        };
        let error = mesh.errors.as_ref().map(|(_, whole)| *whole);
        let regions = self.read_back_joined(pyramid, mesh, made.as_ref().unwrap_or(&meshes.regions))?;
        let stages = self.cx.take_times()?;
        let sum = |of: fn(&RegionMesh) -> u64| meshes.counts.iter().map(of).sum();
        let (leaves, made) = (cut.leaves(), sum(|mesh| triangles(mesh) as u64));
        let statistics = SurfaceStatistics {
            full_triangles: pyramid.full_triangles,
            mesher_triangles: match params.mesher {
                Mesher::MarchingCubes => Some(pyramid.full_triangles),
                // Nothing is merged: this is all.
                Mesher::Dual if leaves[1..].iter().all(|&n| n == 0) => Some(made),
                Mesher::Dual => None,
            },
            removed: None,
            vanished_parts: 0,
            active_cells: pyramid.active_cells,
            leaves,
            triangles: made,
            vertices: sum(|mesh| mesh.distinct_vertices.into()),
            lost_cubes: cut.lost_cubes(),
            unpatched_vertices: cut.unpatched_vertices.load(Ordering::Relaxed),
            estimate: cut.estimate(),
            error,
            stages,
            device_bytes: volume.table_bytes()
                + pyramid
                    .peak_bytes
                    .max(pyramid.device_bytes() + self.cx.pool.peak().saturating_sub(before)),
            volume_bytes: volume.sample_bytes() + pyramid.feature_bytes,
        };
        *lock(&cut.meshes) = Some(Arc::new(meshes));
        Ok(Surface {
            regions,
            remade,
            prefix: cut.prefix,
            statistics,
        })
    }

    /// Counts of the surface of a cut, by the counting passes alone; [`Engine::surface`] uses them again.
    ///
    /// # Errors
    /// As [`Engine::peel`].
    pub fn count(&self, volume: &Volume, pyramid: &Pyramid, cut: &Cut, cancel: &dyn Cancel) -> Result<Count> {
        check_cancelled(cancel)?;
        let regions = match cut.mesher {
            Mesher::Dual => {
                let counted = dual::count(&self.cx, volume, pyramid, &cut.state, &all(pyramid))?;
                let regions = counted.1.clone();
                *lock(&cut.counted) = Some(counted);
                regions
            }
            Mesher::MarchingCubes => {
                let slabs = stages::slab_work(volume, &pyramid.host_regions, pyramid.bricks.len());
                march::gather(&self.cx, volume, pyramid, &slabs, &cut.state, &self.cases)?.1
            }
        };
        Ok(Count {
            triangles: regions.iter().map(|mesh| triangles(mesh) as u64).sum(),
            vertices: regions.iter().map(|r| u64::from(r.vertices)).sum(),
            leaves: cut.leaves(),
        })
    }

    /// Meshes any cut.
    pub(crate) fn mesh(
        &self,
        volume: &Volume,
        pyramid: &Pyramid,
        params: &CutParams,
        cut: &Cut,
        cancel: &dyn Cancel,
    ) -> Result<Mesh> {
        match cut.mesher {
            Mesher::Dual => {
                let counted = lock(&cut.counted).take();
                let counted = match counted {
                    Some(counted) => counted,
                    None => dual::count(&self.cx, volume, pyramid, &cut.state, &all(pyramid))?,
                };
                self.dual(volume, pyramid, params, cut, counted, cancel)
            }
            Mesher::MarchingCubes => self.marching_cubes(volume, pyramid, cut, cancel),
        }
    }

    /// Meshes the regions of a cut in which it may differ from a shown one. `differs`: the active regions in which it may; `shown`: the
    /// meshes of the shown one. The regions of a surface are those of its cut, whatever was shown before it.
    fn mesh_again(
        &self,
        volume: &Volume,
        pyramid: &Pyramid,
        params: &CutParams,
        cut: &Cut,
        (differs, shown): (&[bool], &CutMeshes),
        cancel: &dyn Cancel,
    ) -> Result<MadeMesh> {
        let count = |remade: &[bool]| dual::count(&self.cx, volume, pyramid, &cut.state, &work(pyramid, remade));
        let all_counted = lock(&cut.counted).take();
        let mut remade = differs.to_vec();
        let mut counted = match all_counted {
            Some(counted) => {
                remade.fill(true);
                counted
            }
            None => {
                shown.regions.complete(&mut remade);
                count(&remade)?
            }
        };
        let mut counts = shown.counts.clone();
        for (i, _) in remade.iter().enumerate().filter(|(_, remade)| **remade) {
            counts[i] = counted.1[i];
        }
        let regions = joined(pyramid, &counts);
        let (made, different) = regions.since(&shown.regions, differs);
        // Regions that are joined now and were not before need all of their members, and the mesh of a large surface is not made for a few
        // regions.
        let lacks_member = made.members().iter().any(|&member| !remade[member as usize]);
        if lacks_member || is_excessive(self.device().kind, &counted.1, &made) {
            drop(counted);
            remade = differs.to_vec();
            made.members().iter().for_each(|&member| remade[member as usize] = true);
            counted = count(&remade)?;
        }
        let mesh = self.dual(volume, pyramid, params, cut, counted, cancel)?;
        Ok(MadeMesh {
            mesh,
            made: Some(made),
            meshes: CutMeshes { counts, regions },
            remade: Some(different),
        })
    }

    fn dual(
        &self,
        volume: &Volume,
        pyramid: &Pyramid,
        params: &CutParams,
        cut: &Cut,
        (counted, mut regions): (Counted, Vec<RegionMesh>),
        cancel: &dyn Cancel,
    ) -> Result<Mesh> {
        let cx = &self.cx;
        check_cancelled(cancel)?;
        let (meshes, vertices, indices) = self.allocate_mesh(dual::STAGE, &mut regions)?;
        let corner_slots = params
            .state_error
            .then(|| cx.buffer(error::STAGE, indices.len()))
            .transpose()?;
        let input = dual::Input {
            params: &cut.params,
            state: &cut.state,
            counted: &counted,
            meshes: &meshes,
            corners: corner_slots
                .as_ref()
                .map_or(dual::Corners::Indices, dual::Corners::Slots),
        };
        dual::emit(cx, volume, pyramid, &input, &vertices, &indices)?;
        check_cancelled(cancel)?;
        let errors = match &corner_slots {
            Some(corner_slots) => {
                cx.pause(dual::STAGE, cancel)?;
                let input = error::Input {
                    params: &cut.params,
                    state: &cut.state,
                    regions: &regions,
                    meshes: &meshes,
                    corner_slots,
                    indices: &indices,
                    vertices: &vertices,
                    tree: None,
                };
                Some(error::run(cx, volume, pyramid, &input, cancel)?)
            }
            None => None,
        };
        Ok(Mesh {
            keys: keys(pyramid),
            regions,
            vertices,
            indices,
            errors,
        })
    }

    fn marching_cubes(&self, volume: &Volume, pyramid: &Pyramid, cut: &Cut, cancel: &dyn Cancel) -> Result<Mesh> {
        let cx = &self.cx;
        let counters = cx.zeroed::<Counters>(march::STAGE, 1)?;
        let slabs = stages::slab_work(volume, &pyramid.host_regions, pyramid.bricks.len());
        let (marks, mut regions) = march::gather(cx, volume, pyramid, &slabs, &cut.state, &self.cases)?;
        check_cancelled(cancel)?;
        let (meshes, vertices, indices) = self.allocate_mesh(march::STAGE, &mut regions)?;
        let work = cx.buffer(march::STAGE, vertices.len())?;
        let gathered = march::Gathered {
            state: &cut.state,
            cases: &self.cases,
            marks: &marks,
            meshes: &meshes,
        };
        march::assemble(cx, volume, pyramid, &slabs, &gathered, &work, &indices)?;
        let deepest = cut.params.max_level.max(cut.params.prefix);
        patch::run(cx, volume, pyramid, &gathered, deepest, &work, &counters)?;
        check_cancelled(cancel)?;
        let input = pack::Input {
            params: &cut.params,
            state: &cut.state,
            owners: &marks.owners,
            meshes: &meshes,
            work: &work,
        };
        pack::run(cx, volume, pyramid, &slabs, &input, &vertices, &counters)?;
        let counters = cx.read(READ_BACK, &counters, 1)?[0];
        let unpatched = counters.unpatched_vertices.into();
        cut.unpatched_vertices.store(unpatched, Ordering::Relaxed);
        // No region counts the vertices that it shares: the first stands for all.
        for (i, region) in regions.iter_mut().enumerate() {
            region.distinct_vertices = if i == 0 { counters.vertices } else { 0 };
        }
        Ok(Mesh {
            keys: keys(pyramid),
            regions,
            vertices,
            indices,
            errors: None,
        })
    }

    /// Returns the regions of a mesh that have triangles.
    pub(crate) fn read_back(&self, mesh: Mesh) -> Result<Vec<Region>> {
        let filled = (0..mesh.regions.len()).filter(|&i| triangles(&mesh.regions[i]) > 0);
        self.read_regions(&filled.collect::<Vec<_>>(), mesh)
    }

    /// Returns the regions of a mesh, joined. `mesh`: of the active regions.
    fn read_back_joined(&self, pyramid: &Pyramid, mesh: Mesh, joined: &MeshRegions) -> Result<Vec<Region>> {
        let mut numbers: Vec<usize> = joined.members().iter().map(|&member| member as usize).collect();
        numbers.retain(|&number| triangles(&mesh.regions[number]) > 0);
        numbers.sort_unstable();
        let regions = self.read_regions(&numbers, mesh)?;
        if joined.keys.len() == joined.members().len() {
            return Ok(regions);
        }
        let mut read_index = vec![0; pyramid.host_regions.len()];
        numbers
            .iter()
            .enumerate()
            .for_each(|(index, &number)| read_index[number] = index);
        let made = |joining: &mut Joining, region: usize| {
            let (key, members) = joined.get(region);
            let members: Vec<&Region> = members
                .iter()
                .map(|&member| &regions[read_index[member as usize]])
                .collect();
            match members[..] {
                [alone] => alone.clone(),
                _ => join_meshes(joining, key, &members),
            }
        };
        let regions = (0..joined.keys.len()).into_par_iter();
        Ok(regions.map_init(Joining::default, made).collect())
    }

    /// Returns these regions of a mesh, by their numbers in it, in ascending order.
    fn read_regions(&self, wanted: &[usize], mesh: Mesh) -> Result<Vec<Region>> {
        let of = |range: fn(&RegionMesh, usize) -> Range<usize>| -> Vec<Range<usize>> {
            let parts = wanted.iter().map(|&i| &mesh.regions[i]);
            parts.map(|part| range(part, triangles(part))).collect()
        };
        let vertices = of(|part, _| part.vertex_base as usize..(part.vertex_base + part.vertices) as usize);
        let indices = of(|part, n| part.triangle_base as usize * 3..(part.triangle_base as usize + n) * 3);
        let vertices = self.cx.read_parts(READ_BACK, mesh.vertices, &vertices)?;
        let indices = self.cx.read_parts(READ_BACK, mesh.indices, &indices)?;
        let parts = wanted.iter().zip(vertices).zip(indices);
        Ok(parts
            .map(|((&i, vertices), indices)| Region {
                coords: mesh.keys[i].coords,
                size: mesh.keys[i].size,
                vertices: vertices.cast(),
                indices,
                values: crate::SharedSlice::default(),
                level_triangles: mesh.regions[i].triangles,
                error: mesh.errors.as_ref().map(|(regions, _)| regions[i]),
            })
            .collect())
    }

    /// Assigns every region its range of one vertex and one index buffer, and allocates both.
    pub(crate) fn allocate_mesh(
        &self,
        stage: &'static str,
        meshes: &mut [RegionMesh],
    ) -> Result<(Buffer<RegionMesh>, Buffer<layout::Vertex>, Buffer<u32>)> {
        let (device_meshes, vertices, triangles) = self.with_bases(stage, meshes)?;
        Ok((
            device_meshes,
            self.cx.buffer(stage, vertices)?,
            self.cx.buffer(stage, triangles * 3)?,
        ))
    }

    /// Assigns every region its range of vertices and triangles. Returns how many there are of both.
    pub(super) fn with_bases(
        &self,
        stage: &'static str,
        meshes: &mut [RegionMesh],
    ) -> Result<(Buffer<RegionMesh>, usize, usize)> {
        let (mut vertices, mut triangles) = (0u64, 0u64);
        for mesh in meshes.iter_mut() {
            mesh.vertex_base = vertices as u32;
            mesh.triangle_base = triangles as u32;
            vertices += u64::from(mesh.vertices);
            triangles += mesh.triangles.iter().map(|&n| u64::from(n)).sum::<u64>();
        }
        // Offsets into the index buffer are 32-bit in the kernels.
        let limit = u64::from(u32::MAX);
        if triangles * 3 > limit {
            return Err(Error::OutOfDeviceMemory {
                stage,
                needed_bytes: triangles * 12,
                limit_bytes: Some(limit * 4),
            });
        }
        Ok((self.cx.upload(stage, meshes)?, vertices as usize, triangles as usize))
    }
}

/// As [`MeshRegions::joined`], of the active regions of a pyramid.
pub(super) fn joined(pyramid: &Pyramid, meshes: &[RegionMesh]) -> MeshRegions {
    MeshRegions::joined(pyramid.grid.regions(), &pyramid.coords, meshes)
}

/// Whether making all of these meshes takes longer than counting those that are wanted once more.
fn is_excessive(kind: DeviceKind, meshes: &[RegionMesh], wanted: &MeshRegions) -> bool {
    let all: usize = meshes.iter().map(triangles).sum();
    let needed: usize = wanted
        .members()
        .iter()
        .map(|&member| triangles(&meshes[member as usize]))
        .sum();
    match kind {
        DeviceKind::Cpu => all > 2 * needed,
        DeviceKind::Gpu | DeviceKind::Other => needed == 0 || all > MAX_SPARE_TRIANGLES + EXCESSIVE * needed,
    }
}

/// Meshes in all regions.
pub(super) fn all(pyramid: &Pyramid) -> Vec<Work> {
    vec![Work::Mesh; pyramid.host_regions.len()]
}
