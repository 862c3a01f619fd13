//! What depends on the cut: leaves, meshes, counts and budgets.

use crate::buffer::Buffer;
use crate::cancel::check;
use crate::layout::{self, Counters, RegionMesh};
use crate::stages::{self, cut, dual, error, march, pack, patch};
use crate::{
    Cancel, Count, CutParams, Engine, Error, Level, Mesher, Pyramid, Region, Result, Surface, SurfaceError,
    SurfaceStatistics, Volume,
};
use std::ops::Range;

/// Share of a triangle budget from which [`Engine::fit`] counts it as used and stops searching.
pub const BUDGET_FIT: f64 = 0.97;

/// A cut on the device.
pub(crate) struct Cut {
    pub params: layout::CutParams,
    pub state: Buffer<u8>,
    pub counters: Buffer<Counters>,
}

/// A mesh on the device.
pub(crate) struct Mesh {
    pub regions: Vec<RegionMesh>,
    pub vertices: Buffer<layout::Vertex>,
    pub indices: Buffer<u32>,
    /// Of each active region, and of all together.
    pub errors: Option<(Vec<SurfaceError>, SurfaceError)>,
}

impl Engine {
    /// Cuts the pyramid and meshes the cut. With `prefix` above 0, undecided cubes of that level count as leaves
    /// (`docs/algorithm.md#7-progressive-stream`). `volume` is the one the pyramid was built from. Stage times are the pyramid's and this call's.
    ///
    /// # Errors
    /// [`Error::Cancelled`], or what the device says.
    pub fn peel(
        &self,
        volume: &Volume,
        pyramid: &Pyramid,
        params: &CutParams,
        prefix: Level,
        cancel: &dyn Cancel,
    ) -> Result<Surface> {
        check_request(volume, pyramid, params, prefix)?;
        let cx = &self.cx;
        cx.take_times()?;
        let before = cx.pool.restart();
        let cut = self.cut(volume, pyramid, params, prefix)?;
        check(cancel)?;
        let mesh = self.mesh(volume, pyramid, params, prefix, &cut, cancel)?;
        let triangles = mesh.indices.len() as u64 / 3;
        let error = mesh.errors.as_ref().map(|(_, whole)| *whole);
        let regions = self.read_back(pyramid, mesh)?;
        let counters = cx.read("read back", &cut.counters, 1)?[0];
        let mut times = pyramid.stages.clone();
        times.extend(cx.take_times()?);
        Ok(Surface {
            statistics: SurfaceStatistics {
                full_triangles: pyramid.full_triangles,
                active_cells: pyramid.active_cells,
                leaves: counters.leaves.map(u64::from),
                triangles,
                vertices: counters.vertices.into(),
                lost_cubes: counters.lost_cubes.into(),
                unpatched_vertices: counters.unpatched_vertices.into(),
                error,
                stages: times,
                device_bytes: volume.table_bytes()
                    + pyramid.peak_bytes.max(pyramid.device_bytes() + cx.pool.peak() - before),
                volume_bytes: volume.sample_bytes() + pyramid.feature_bytes,
            },
            regions,
            prefix,
        })
    }

    /// Counts of the surface that [`Engine::peel`] would make, by the counting passes alone.
    ///
    /// # Errors
    /// As [`Engine::peel`].
    pub fn count(
        &self,
        volume: &Volume,
        pyramid: &Pyramid,
        params: &CutParams,
        prefix: Level,
        cancel: &dyn Cancel,
    ) -> Result<Count> {
        check_request(volume, pyramid, params, prefix)?;
        let cut = self.cut(volume, pyramid, params, prefix)?;
        check(cancel)?;
        let regions = match params.mesher {
            Mesher::Dual => dual::count(&self.cx, volume, pyramid, &cut.state, &cut.counters)?.1,
            Mesher::MarchingCubes => {
                let slabs = stages::slab_work(volume, &pyramid.host_regions, pyramid.bricks.len());
                march::gather(&self.cx, volume, pyramid, &slabs, &cut.state, &self.cases)?.1
            }
        };
        let counters = self.cx.read(cut::STAGE, &cut.counters, 1)?[0];
        Ok(Count {
            triangles: regions.iter().flat_map(|r| r.triangles).map(u64::from).sum(),
            vertices: regions.iter().map(|r| u64::from(r.vertices)).sum(),
            leaves: counters.leaves.map(u64::from),
        })
    }

    /// Parameters with the β whose surface has at most `max_triangles` and nearly as many, and its counts; the guards of
    /// `params` stay in force. Where even the coarsest cut has more triangles, that one.
    ///
    /// # Errors
    /// As [`Engine::peel`].
    pub fn fit(
        &self,
        volume: &Volume,
        pyramid: &Pyramid,
        params: &CutParams,
        max_triangles: u64,
        cancel: &dyn Cancel,
    ) -> Result<(CutParams, Count)> {
        let at = |beta: f32| {
            let params = CutParams { beta, ..params.clone() };
            let count = self.count(volume, pyramid, &params, Level::FINEST, cancel)?;
            Ok::<_, Error>((params, count))
        };
        let full = at(-1.0)?;
        if full.1.triangles <= max_triangles {
            return Ok(full);
        }
        let mut best = at(1.0)?;
        if best.1.triangles > max_triangles {
            return Ok(best);
        }
        // Positive floats are ordered like their bits, so halving the bits halves β's exponent first, then its mantissa.
        // Importance below 2^-20 is rounding.
        let (mut low, mut high) = (f32::EPSILON.to_bits(), 1f32.to_bits());
        while high - low > 1 && (best.1.triangles as f64) < BUDGET_FIT * max_triangles as f64 {
            let middle = low + (high - low) / 2;
            let tried = at(f32::from_bits(middle))?;
            if tried.1.triangles > max_triangles {
                low = middle;
            } else {
                high = middle;
                best = tried;
            }
        }
        Ok(best)
    }

    pub(crate) fn cut(&self, volume: &Volume, pyramid: &Pyramid, params: &CutParams, prefix: Level) -> Result<Cut> {
        let cx = &self.cx;
        let points: Vec<[f32; 2]> = params.transfer.points().iter().map(|p| [p.x, p.importance]).collect();
        let points = cx.upload(cut::STAGE, &points)?;
        let cut = Cut {
            params: cut::layout(params, prefix),
            state: cx.buffer(cut::STAGE, pyramid.nodes.len())?,
            counters: cx.zeroed(cut::STAGE, 1)?,
        };
        cut::run(cx, volume, pyramid, &cut.params, &points, &cut.state, &cut.counters)?;
        Ok(cut)
    }

    /// Meshes any cut.
    pub(crate) fn mesh(
        &self,
        volume: &Volume,
        pyramid: &Pyramid,
        params: &CutParams,
        prefix: Level,
        cut: &Cut,
        cancel: &dyn Cancel,
    ) -> Result<Mesh> {
        match params.mesher {
            Mesher::Dual => self.dual(volume, pyramid, params, cut, cancel),
            Mesher::MarchingCubes => self.marching_cubes(volume, pyramid, params, prefix, cut, cancel),
        }
    }

    fn dual(
        &self,
        volume: &Volume,
        pyramid: &Pyramid,
        params: &CutParams,
        cut: &Cut,
        cancel: &dyn Cancel,
    ) -> Result<Mesh> {
        let cx = &self.cx;
        let (counted, mut regions) = dual::count(cx, volume, pyramid, &cut.state, &cut.counters)?;
        check(cancel)?;
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
            corner_slots: corner_slots.as_ref(),
        };
        dual::emit(cx, volume, pyramid, &input, &vertices, &indices)?;
        check(cancel)?;
        let errors = match &corner_slots {
            Some(corner_slots) => {
                let slabs = stages::slab_work(volume, &pyramid.host_regions, pyramid.bricks.len());
                let input = error::Input {
                    params: &cut.params,
                    state: &cut.state,
                    regions: &regions,
                    meshes: &meshes,
                    corner_slots,
                    indices: &indices,
                    vertices: &vertices,
                };
                Some(error::run(cx, volume, pyramid, &slabs, &input, cancel)?)
            }
            None => None,
        };
        Ok(Mesh {
            regions,
            vertices,
            indices,
            errors,
        })
    }

    fn marching_cubes(
        &self,
        volume: &Volume,
        pyramid: &Pyramid,
        params: &CutParams,
        prefix: Level,
        cut: &Cut,
        cancel: &dyn Cancel,
    ) -> Result<Mesh> {
        let cx = &self.cx;
        let slabs = stages::slab_work(volume, &pyramid.host_regions, pyramid.bricks.len());
        let (marks, mut regions) = march::gather(cx, volume, pyramid, &slabs, &cut.state, &self.cases)?;
        check(cancel)?;
        let (meshes, vertices, indices) = self.allocate_mesh(march::STAGE, &mut regions)?;
        let work = cx.buffer(march::STAGE, vertices.len())?;
        let gathered = march::Gathered {
            state: &cut.state,
            cases: &self.cases,
            marks: &marks,
            meshes: &meshes,
        };
        march::assemble(cx, volume, pyramid, &slabs, &gathered, &work, &indices)?;
        let deepest = u32::from(params.max_level.get().max(prefix.get()));
        patch::run(cx, volume, pyramid, &gathered, deepest, &work, &cut.counters)?;
        check(cancel)?;
        let input = pack::Input {
            params: &cut.params,
            state: &cut.state,
            owners: &marks.owners,
            meshes: &meshes,
            work: &work,
        };
        pack::run(cx, volume, pyramid, &slabs, &input, &vertices, &cut.counters)?;
        Ok(Mesh {
            regions,
            vertices,
            indices,
            errors: None,
        })
    }

    /// Regions that have triangles.
    pub(crate) fn read_back(&self, pyramid: &Pyramid, mesh: Mesh) -> Result<Vec<Region>> {
        const STAGE: &str = "read back";
        let triangles = |part: &RegionMesh| part.triangles.iter().sum::<u32>() as usize;
        let filled: Vec<usize> = (0..mesh.regions.len())
            .filter(|&i| triangles(&mesh.regions[i]) > 0)
            .collect();
        let of = |range: fn(&RegionMesh, usize) -> Range<usize>| -> Vec<Range<usize>> {
            let parts = filled.iter().map(|&i| &mesh.regions[i]);
            parts.map(|part| range(part, triangles(part))).collect()
        };
        let vertices = of(|part, _| part.vertex_base as usize..(part.vertex_base + part.vertices) as usize);
        let indices = of(|part, n| part.triangle_base as usize * 3..(part.triangle_base as usize + n) * 3);
        let vertices = self.cx.read_parts(STAGE, mesh.vertices, &vertices)?;
        let indices = self.cx.read_parts(STAGE, mesh.indices, &indices)?;
        let [rx, ry, _] = pyramid.grid.regions();
        let parts = filled.iter().zip(vertices).zip(indices);
        Ok(parts
            .map(|((&i, vertices), indices)| {
                let region = pyramid.host_regions[i].region;
                Region {
                    coords: [region % rx, region / rx % ry, region / rx / ry],
                    vertices: vertices.cast(),
                    indices,
                    level_triangles: mesh.regions[i].triangles,
                    error: mesh.errors.as_ref().map(|(regions, _)| regions[i]),
                }
            })
            .collect())
    }

    /// Assigns every region its range of one vertex and one index buffer, and allocates both.
    pub(crate) fn allocate_mesh(
        &self,
        stage: &'static str,
        meshes: &mut [RegionMesh],
    ) -> Result<(Buffer<RegionMesh>, Buffer<layout::Vertex>, Buffer<u32>)> {
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
                limit_bytes: limit * 4,
            });
        }
        Ok((
            self.cx.upload(stage, meshes)?,
            self.cx.buffer(stage, vertices as usize)?,
            self.cx.buffer(stage, triangles as usize * 3)?,
        ))
    }
}

pub(super) fn check_request(volume: &Volume, pyramid: &Pyramid, params: &CutParams, prefix: Level) -> Result<()> {
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
