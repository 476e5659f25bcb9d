//! `trgs voxelize`: a model sampled at voxel centres, and the gradient of a function of them.

use super::arguments::list;
use super::cost::{Steps, announce};
use super::explain::{self, Written};
use super::render::{FAST_CUTOFF, KernelArgs};
use super::{Global, Output};
use clap::Args;
use glam::DVec3;
use ndarray::Array3;
use serde_json::json;
use std::io;
use std::path::{Path, PathBuf};
use trgs::duration::seconds_to_voxelize;
use trgs::geometry::Grid;
use trgs::primitives::Primitives;
use trgs::projector::{Field, Kernels, voxelize_vjp};
use trgs::scan::dataset::read_scanner;
use trgs::scan::model;
use trgs::scan::npy::{self, Element};
use trgs::words::counted;
use trgs::{Result, limit, words};
use trgs_core::in_precision;

/// Sample a model on a grid, and compute the gradient of a function of the volume
#[derive(Args)]
#[command(
    allow_negative_numbers = true,
    after_help = "Examples:
  trgs voxelize out/torso/model.npz --scanner data/torso --out volume.npy
  trgs voxelize out/torso/model.npz --scanner data/torso --precision f32 --cutoff 1e-3 --out volume.npy
  trgs voxelize model.npz --grid 128,128,64 --box=-1,-1,-0.5,1,1,0.5 --out volume.npy
  trgs voxelize model.npz --grid 64,64,64 --out volume.npy \\
      --vjp cotangent.npy --grad-out grad.npz
  trgs voxelize out/torso/model.npz --scanner data/torso --explain 20,32,17"
)]
pub(super) struct Voxelize {
    /// Model file
    #[arg(value_name = "MODEL.npz")]
    model: PathBuf,
    #[command(flatten)]
    place: PlaceArgs,
    /// Corners of the grid's box [default: the cube from -1 to 1]
    #[arg(long = "box", value_name = "x0,y0,z0,x1,y1,z1", requires = "grid", allow_hyphen_values = true,
        value_parser = list::<f64, 6>)]
    corners: Option<[f64; 6]>,
    /// File to write: volume [x, y, z]
    #[arg(long, value_name = "FILE.npy", required_unless_present = "explain")]
    out: Option<PathBuf>,
    /// List the contribution of each primitive to one voxel, largest first; indices start at 0
    #[arg(long, value_name = "X,Y,Z", value_parser = list::<usize, 3>)]
    explain: Option<[usize; 3]>,
    #[command(flatten)]
    kernel: KernelArgs,
}

#[derive(Args)]
#[group(required = true, multiple = false)]
struct PlaceArgs {
    /// Dataset, or its meta_data.json, whose grid is used
    #[arg(long, value_name = "DATASET|meta_data.json")]
    scanner: Option<PathBuf>,
    /// Number of voxels along x, y and z
    #[arg(long, value_name = "X,Y,Z", value_parser = list::<usize, 3>)]
    grid: Option<[usize; 3]>,
}

impl Voxelize {
    pub(super) fn run(&self, global: &Global) -> Result<Output> {
        in_precision!(self.kernel.precision, R => self.voxelize::<R>(global))
    }

    fn voxelize<R: Kernels + Element>(&self, global: &Global) -> Result<Output> {
        let primitives = model::read(&self.model)?;
        let grid = self.grid()?;
        if let Some(voxel) = self.explain {
            explain::check_index(voxel, grid.shape, ["x", "y", "z"])?;
        }
        let out = self.out.as_deref();
        let written = out.map(|out| self.write::<R>(out, &primitives, &grid, global)).transpose()?;
        let Some(voxel) = self.explain else { return Ok(Output::list(&written)) };
        let contributions = Field::<R>::new(&primitives, self.kernel.cutoff).voxel_contributions(&grid, voxel);
        let place = json!({ "voxel": voxel, "position": grid.centre(voxel).to_array() });
        Ok(explain::answer(place, &primitives, &contributions, written))
    }

    fn write<'a, R: Kernels + Element>(
        &'a self,
        out: &'a Path,
        primitives: &Primitives,
        grid: &Grid,
        global: &Global,
    ) -> Result<Written<'a>> {
        let cutoff = self.kernel.cutoff;
        let ([nx, ny, nz], field) = (grid.shape, Field::<R>::new(primitives, cutoff));
        let on_grid = field.on(grid);
        let slices = on_grid.slices_together();
        let allowed = match &self.kernel.vjp {
            Some(_) => limit::allow_array("volume", &grid.shape, self.kernel.bytes::<R>()),
            None => limit::allow_array("slices", &[slices, ny, nz], size_of::<R>()),
        };
        allowed.map_err(|error| error.or_instead("fewer voxels"))?;
        let fast = || seconds_to_voxelize::<f32>(primitives, grid, FAST_CUTOFF);
        let seconds = seconds_to_voxelize::<R>(primitives, grid, cutoff);
        let what = format!("{} in {}", counted(primitives.len(), "primitive"), counted(grid.voxels(), "voxel"));
        announce(&what, seconds, || (!self.kernel.is_fast()).then(fast));
        let mut steps = Steps::new("slices", global);
        let mut by_slabs = |write: &mut dyn FnMut(&[R]) -> io::Result<()>| {
            on_grid.by_slabs(|values, done| {
                steps.see(done, nx);
                write(values)
            })
        };
        if self.kernel.vjp.is_some() {
            let mut values = Vec::with_capacity(grid.voxels());
            let gather = &mut |slab: &[R]| {
                values.extend_from_slice(slab);
                Ok(())
            };
            by_slabs(gather).expect("memory takes every slab");
            let volume = Array3::from_shape_vec((nx, ny, nz), values).expect("as many values as voxels");
            let vjp_of = |d: &Array3<R>| voxelize_vjp(primitives, grid, cutoff, d.view());
            self.kernel.write(out, &volume, vjp_of)?;
        } else {
            npy::write_parts(out, &grid.shape, by_slabs)?;
        }
        drop(steps);
        Ok(Written {
            out,
            shape: grid.shape.to_vec(),
            precision: self.kernel.precision,
            projection: None,
            cutoff,
            truncation_bound: None,
            grad_out: self.kernel.grad_out.as_ref().map(words::name),
        })
    }

    fn grid(&self) -> Result<Grid> {
        match (&self.place.scanner, self.place.grid) {
            (Some(path), _) => Ok(read_scanner(path)?.grid),
            (None, shape) => {
                let [x0, y0, z0, x1, y1, z1] = self.corners.unwrap_or([-1.0, -1.0, -1.0, 1.0, 1.0, 1.0]);
                let shape = shape.expect("one of the two is required");
                Grid::new(shape, DVec3::new(x0, y0, z0), DVec3::new(x1, y1, z1))
            }
        }
    }
}
