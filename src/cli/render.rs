//! `trgs render`: projections of a model, and the gradient of a function of them.

use super::arguments::{choice, cutoff, list};
use super::cost::{Steps, announce};
use super::explain::{self, Written};
use super::views::{ViewArgs, Views};
use super::{Global, Output, interrupt};
use clap::Args;
use ndarray::{Array3, Ix3};
use serde_json::json;
use std::path::{Path, PathBuf};
use trgs::config::Precision;
use trgs::duration::seconds_to_project;
use trgs::numeric::Real;
use trgs::primitives::{Parameters, Primitives};
use trgs::projector::{Field, Kernels, Projection, forward_seen, vjp};
use trgs::scan::npy::Element;
use trgs::scan::{model, npy};
use trgs::words::counted;
use trgs::{Error, Result, limit, words};
use trgs_core::in_precision;

/// The cutoff that makes sampling fast.
pub(super) const FAST_CUTOFF: f64 = 1e-3;

/// Compute projections of a model, and the gradient of a function of the projections
#[derive(Args)]
#[command(
    allow_negative_numbers = true,
    after_help = "Examples:
  trgs render out/torso/model.npz --scanner data/torso --split test --out views.npy
  trgs render model.npz --scanner meta_data.json --angles 0,1.5708 --out views.npy \\
      --vjp cotangent.npy --grad-out grad.npz
  trgs render out/torso/model.npz --scanner data/torso --explain 0,31,40"
)]
pub(super) struct Render {
    /// Model file
    #[arg(value_name = "MODEL.npz")]
    model: PathBuf,
    #[command(flatten)]
    views: ViewArgs,
    /// Projection of primitives: exact, or affine as in the paper
    #[arg(long, default_value = "exact", value_parser = choice(&Projection::ALL))]
    projection: Projection,
    /// File to write: projections [view, v, u]
    #[arg(long, value_name = "FILE.npy", required_unless_present = "explain")]
    out: Option<PathBuf>,
    /// List the contribution of each primitive to one pixel, largest first; indices start at 0
    #[arg(long, value_name = "VIEW,ROW,COLUMN", value_parser = list::<usize, 3>)]
    explain: Option<[usize; 3]>,
    #[command(flatten)]
    kernel: KernelArgs,
}

/// Flags shared by `render` and `voxelize`.
#[derive(Args)]
pub(super) struct KernelArgs {
    /// Arithmetic, and number type of the output
    #[arg(long, default_value = "f64", value_parser = choice(&Precision::ALL))]
    pub(super) precision: Precision,
    /// Truncate each primitive where its projection falls below this fraction of its peak; 0: no truncation
    #[arg(long, value_name = "EPS", default_value_t = 0.0, value_parser = cutoff)]
    pub(super) cutoff: f64,
    /// Cotangent of the output, with the output's shape
    #[arg(long, value_name = "COTANGENT.npy", requires_all = ["grad_out", "out"])]
    pub(super) vjp: Option<PathBuf>,
    /// Gradient of Σ cotangent·output to write, with the keys and shapes of the model
    #[arg(long, value_name = "GRAD.npz", requires = "vjp")]
    pub(super) grad_out: Option<PathBuf>,
}

impl Render {
    pub(super) fn run(&self, global: &Global) -> Result<Output> {
        in_precision!(self.kernel.precision, R => self.render::<R>(global))
    }

    fn render<R: Kernels + Element>(&self, global: &Global) -> Result<Output> {
        let primitives = model::read(&self.model)?;
        let views = self.views.read()?;
        let Views { scanner, angles, .. } = &views;
        let shape = [angles.len(), scanner.detector.rows, scanner.detector.columns];
        if let Some(pixel) = self.explain {
            explain::check_index(pixel, shape, ["view", "row", "column"])?;
        }
        let out = self.out.as_deref();
        let written = out.map(|out| self.write::<R>(out, &primitives, &views, global)).transpose()?;
        let Some([view, row, column]) = self.explain else { return Ok(Output::list(&written)) };
        let field = Field::<R>::new(&primitives, self.kernel.cutoff);
        let contributions = field.seen_in(&views.trajectory().view(scanner, view), self.projection);
        let contributions = contributions.contributions(row, column);
        let pixel = json!({ "view": view, "angle": angles[view], "row": row, "column": column });
        Ok(explain::answer(pixel, &primitives, &contributions, written))
    }

    fn write<'a, R: Kernels + Element>(
        &'a self,
        out: &'a Path,
        primitives: &Primitives,
        views: &Views,
        global: &Global,
    ) -> Result<Written<'a>> {
        let (projection, cutoff, scanner) = (self.projection, self.kernel.cutoff, &views.scanner);
        let bytes = self.kernel.bytes::<R>();
        let shape = [views.angles.len(), scanner.detector.rows, scanner.detector.columns];
        limit::allow_array("projections", &shape, bytes).map_err(|error| error.or_instead("fewer views or pixels"))?;
        let fast = || seconds_to_project::<f32>(primitives, scanner, views.trajectory(), projection, FAST_CUTOFF);
        let seconds = seconds_to_project::<R>(primitives, scanner, views.trajectory(), projection, cutoff);
        let pixels = counted(scanner.detector.pixels() * views.angles.len(), "pixel");
        let what = format!("{} in {pixels}", counted(primitives.len(), "primitive"));
        announce(&what, seconds, || (!self.kernel.is_fast()).then(fast));
        let mut steps = Steps::new("views", global);
        let mut see = |done, all| steps.see(done, all);
        let images = forward_seen::<R>(primitives, scanner, views.trajectory(), projection, cutoff, &mut see);
        drop(steps);
        let vjp_of = |d: &Array3<R>| vjp(primitives, scanner, views.trajectory(), projection, cutoff, d.view());
        self.kernel.write(out, &images, vjp_of)?;
        Ok(Written {
            out,
            shape: images.shape().to_vec(),
            precision: self.kernel.precision,
            projection: Some(projection),
            cutoff,
            truncation_bound: (cutoff > 0.0).then(|| self.truncation_bound::<R>(primitives, views)),
            grad_out: self.kernel.grad_out.as_ref().map(words::name),
        })
    }

    fn truncation_bound<R: Kernels>(&self, primitives: &Primitives, views: &Views) -> f64 {
        let field = Field::<R>::new(primitives, self.kernel.cutoff);
        let views = views.trajectory().views(&views.scanner);
        let bounds = views.iter().map(|view| field.seen_in(view, self.projection).truncation_bound());
        bounds.fold(0.0, |largest, bounds| bounds.into_iter().fold(largest, f64::max))
    }
}

impl KernelArgs {
    /// Bytes for a number of the output: itself, once more as it is computed, and the cotangent as read and in this arithmetic.
    pub(super) fn bytes<R>(&self) -> usize {
        let real = size_of::<R>();
        2 * real + if self.grad_out.is_some() { size_of::<f64>() + real } else { 0 }
    }

    /// Whether sampling is fast already.
    pub(super) fn is_fast(&self) -> bool {
        self.precision == Precision::F32 && self.cutoff >= FAST_CUTOFF
    }

    /// Writes the output and, if requested, the gradient that `vjp_of` computes from the cotangent.
    ///
    /// Both are computed before either is written.
    pub(super) fn write<R: Kernels + Element>(
        &self,
        out: &Path,
        output: &Array3<R>,
        vjp_of: impl FnOnce(&Array3<R>) -> Parameters,
    ) -> Result<()> {
        let gradient = match &self.vjp {
            None => None,
            Some(path) => {
                let gradient = vjp_of(&read_cotangent(path, output.shape())?);
                gradient.check_finite("gradient of the model", 0)?;
                Some(gradient)
            }
        };
        interrupt::shielded(|| {
            npy::write(out, output.view())?;
            match (&self.grad_out, gradient) {
                (Some(path), Some(gradient)) => model::write(path, &gradient),
                _ => Ok(()),
            }
        })
    }
}

fn read_cotangent<R: Real>(path: &Path, shape: &[usize]) -> Result<Array3<R>> {
    let cotangent = npy::read_f64::<Ix3>(path, "of the output")?;
    if cotangent.shape() != shape {
        let got = format!("shape {:?}", cotangent.shape());
        return Err(Error::format(
            path,
            "cotangent",
            got,
            format!("{shape:?}, the output's"),
            "give a cotangent of that shape",
        ));
    }
    if let Some((index, value)) = cotangent.indexed_iter().find(|(_, value)| !value.is_finite()) {
        let got = format!("{value} at index {index:?}");
        return Err(Error::format(path, "cotangent", got, "finite numbers only", "remove NaN and infinity from it"));
    }
    Ok(cotangent.mapv(R::from_f64))
}
