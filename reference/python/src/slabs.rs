//! Slabs of the volumes of SART and of total variation, for `trgs.distributed`: the operations of a slab, and the methods on
//! volumes that an object of Python has.

use crate::arrays::{check_shape, give, read, slice, wrong_value};
use crate::classical::{pass_event, to_reconstruct, trial_event, window_and_turn};
use crate::geometry::Scanner;
use crate::views::Views;
use crate::work::{Watch, fits, raise, run, try_run};
use ndarray::{Array1, Array3, Ix1, Ix3};
use numpy::PyReadonlyArray3;
use pyo3::prelude::*;
use pyo3::types::PyTuple;
use std::iter;
use std::ops::Range;
use std::sync::Mutex;
use trgs::classical::algebraic::{
    self, Change, Measure, Name, SartRun, Space, Trial, TvRun, VoxelRun, choose_weight_in,
};
use trgs::classical::{RayModel, VoxelProjector};
use trgs::geometry::View;
use trgs::{Config, Error, Method};

/// What a slab's functions read.
const SLAB: &str = "[x, y, z]";
const IMAGES: &str = "[pixel]";
/// Nothing panics while it holds the lock.
const NEVER: &str = "no panic while locked";

type Array<'py> = Bound<'py, PyAny>;

/// Some slices of a grid along x, and what `trgs.distributed` does with them. Images are flat, in the order of the projector.
#[pyclass(frozen, module = "trgs._core")]
pub(crate) struct Part {
    projector: VoxelProjector,
    views: Vec<View>,
    x: Range<usize>,
}

impl Part {
    fn part(&self) -> algebraic::Part<'_> {
        algebraic::Part::new(&self.projector, self.x.clone()).expect("checked when it was made")
    }

    fn some(&self, views: &[usize]) -> PyResult<Vec<View>> {
        let view = |&number: &usize| self.views.get(number).copied();
        let found: Option<Vec<View>> = views.iter().map(view).collect();
        found.ok_or_else(|| wrong_value("views", format!("{views:?}"), "numbers of the views", "count from 0"))
    }

    /// A slab of some slices.
    fn slab<'py>(&self, what: &str, value: &Array<'py>, slices: Range<usize>) -> PyResult<PyReadonlyArray3<'py, f32>> {
        let slab = read::<f32, Ix3>(value, what, SLAB)?;
        let [_, ny, nz] = self.projector.scanner().grid.shape;
        let expected = [slices.len(), ny, nz];
        check_shape(what, slab.as_array().shape(), &expected, "give these slices")?;
        Ok(slab)
    }

    fn images(&self, what: &str, value: &Array<'_>, views: &[usize]) -> PyResult<Vec<f32>> {
        let images = slice(&read::<f32, Ix1>(value, what, IMAGES)?).to_vec();
        let expected = [views.len() * self.projector.scanner().detector.pixels()];
        check_shape(what, &[images.len()], &expected, "give the pixels of these views")?;
        Ok(images)
    }

    fn give<'py>(&self, py: Python<'py>, values: Vec<f32>) -> Array<'py> {
        let [_, ny, nz] = self.projector.scanner().grid.shape;
        let shape = (values.len() / (ny * nz), ny, nz);
        give(py, Array3::from_shape_vec(shape, values).expect("whole slices"))
    }
}

#[pymethods]
impl Part {
    #[new]
    fn new(scanner: &Scanner, angles: &Array<'_>, first: usize, last: usize) -> PyResult<Self> {
        let views = Views::of(angles, scanner)?;
        let projector = VoxelProjector::new(&scanner.0, RayModel::Joseph).map_err(raise)?;
        algebraic::Part::new(&projector, first..last).map_err(raise)?;
        let views = projector.views(views.trajectory()).map_err(raise)?;
        Ok(Self { projector, views, x: first..last })
    }

    /// The first and the last slice but one that a step of the dual reads; of 0 those that projections and sums read.
    fn reads(&self, steps: usize) -> (usize, usize) {
        let reads = self.part().reads(steps);
        (reads.start, reads.end)
    }

    /// Sums of the images with the share of this part; None as a slab is one of ones.
    fn project<'py>(
        &self,
        py: Python<'py>,
        views: Vec<usize>,
        slab: Option<&Array<'py>>,
        rising: bool,
        sums: &Array<'py>,
    ) -> PyResult<Array<'py>> {
        let (part, some) = (self.part(), self.some(&views)?);
        let mut sums = self.images("sums", sums, &views)?;
        let values = match slab {
            Some(slab) => slice(&self.slab("slab", slab, part.reads(0))?).to_vec(),
            None => {
                let [_, ny, nz] = self.projector.scanner().grid.shape;
                vec![1.0; part.reads(0).len() * ny * nz]
            }
        };
        run(py, || part.project(&some, &values, rising, &mut sums))?;
        Ok(give(py, Array1::from_vec(sums)))
    }

    /// Images from the sums of all parts.
    fn complete<'py>(&self, py: Python<'py>, views: Vec<usize>, sums: &Array<'py>) -> PyResult<Array<'py>> {
        let (some, mut sums) = (self.some(&views)?, self.images("sums", sums, &views)?);
        run(py, || self.part().complete(&some, &mut sums))?;
        Ok(give(py, Array1::from_vec(sums)))
    }

    /// The slab after an adjoint, set or subtracted.
    fn adjoin<'py>(
        &self,
        py: Python<'py>,
        views: Vec<usize>,
        images: &Array<'py>,
        slab: &Array<'py>,
        step: Option<f32>,
    ) -> PyResult<Array<'py>> {
        let (some, images) = (self.some(&views)?, self.images("images", images, &views)?);
        let mut values = slice(&self.slab("slab", slab, self.x.clone())?).to_vec();
        run(py, || self.part().adjoin(&some, &images, &mut values, step))?;
        Ok(self.give(py, values))
    }

    /// The slab after a correction of SART.
    #[allow(clippy::too_many_arguments)]
    fn correct<'py>(
        &self,
        py: Python<'py>,
        views: Vec<usize>,
        corrections: &Array<'py>,
        weights: &Array<'py>,
        slab: &Array<'py>,
        relaxation: f32,
        non_negative: bool,
    ) -> PyResult<Array<'py>> {
        let some = self.some(&views)?;
        let (corrections, weights) =
            (self.images("corrections", corrections, &views)?, self.images("weights", weights, &views)?);
        let mut values = slice(&self.slab("slab", slab, self.x.clone())?).to_vec();
        let images = [corrections.as_slice(), weights.as_slice()];
        run(py, || self.part().correct(&some, images, &mut values, relaxation, non_negative))?;
        Ok(self.give(py, values))
    }

    /// The terms of a sum, of every slice: `squares`, `largest` and `variation` of one volume, `step` of three.
    fn measure<'py>(
        &self,
        py: Python<'py>,
        what: &str,
        beta: f32,
        volumes: Vec<Array<'py>>,
    ) -> PyResult<Vec<[f64; 3]>> {
        let measure = match what {
            "squares" => Measure::Squares(Name::Volume),
            "largest" => Measure::Largest(Name::Volume),
            "variation" => Measure::Variation(Name::Volume),
            "step" => Measure::Step(beta),
            _ => return Err(wrong_value("sum", what, "squares, largest, variation or step", "give one of these")),
        };
        let part = self.part();
        let read = |volume: &Array<'py>| Ok(slice(&self.slab("volume", volume, part.reads(0))?).to_vec());
        let volumes: Vec<Vec<f32>> = volumes.iter().map(read).collect::<PyResult<_>>()?;
        if volumes.len() != measure.reads().len() {
            let expected = measure.reads().len().to_string();
            return Err(wrong_value("volumes", volumes.len(), &expected, "give those of the sum"));
        }
        let mut named: [&[f32]; 3] = [&[]; 3];
        measure.reads().iter().zip(&volumes).for_each(|(name, volume)| named[*name as usize] = volume);
        run(py, || part.measure(measure, named))
    }

    /// The next x and dual of this part, from y and the dual with the slices that a step reads.
    fn solve<'py>(
        &self,
        py: Python<'py>,
        y: &Array<'py>,
        dual: (Array<'py>, Array<'py>, Array<'py>),
        tau: f64,
        steps: usize,
    ) -> PyResult<(Array<'py>, [Array<'py>; 3])> {
        let part = self.part();
        let values = |what: &str, value: &Array<'py>| Ok(slice(&self.slab(what, value, part.reads(steps))?).to_vec());
        let arrays: PyResult<Vec<Vec<f32>>> =
            iter::once(values("y", y)).chain([&dual.0, &dual.1, &dual.2].map(|q| values("dual", q))).collect();
        let arrays = arrays?.try_into().expect("four arrays");
        let (found, own) = run(py, || part.solve(arrays, tau, steps))?;
        let [next, dual @ ..] = found.map(|values| self.give(py, values[own.clone()].to_vec()));
        Ok((next, dual))
    }
}

/// Some slices of filtered backprojection; arguments as of `fdk`.
#[pyfunction]
pub(crate) fn fdk_part<'py>(
    py: Python<'py>,
    projections: &Array<'py>,
    scanner: &Scanner,
    angles: &Array<'py>,
    window: &str,
    turn: &str,
    slices: (usize, usize),
) -> PyResult<Array<'py>> {
    let (window, turn) = window_and_turn(window, turn)?;
    let measured = to_reconstruct(projections, scanner, angles)?;
    let slices = slices.0..slices.1;
    Ok(give(py, try_run(py, || trgs::classical::fdk::part(&scanner.0, &measured, window, turn, slices))?))
}

/// Volumes that an object of Python has.
struct Elsewhere<'a> {
    object: &'a Py<PyAny>,
    /// The numbers that the object has for the views.
    views: Vec<usize>,
    /// What the object raised.
    raised: &'a Mutex<Option<PyErr>>,
}

impl Elsewhere<'_> {
    fn of(&self, views: &[usize]) -> Vec<usize> {
        views.iter().map(|&view| self.views[view]).collect()
    }

    fn call<T>(
        &self,
        method: &str,
        arguments: impl for<'py> FnOnce(Python<'py>) -> PyResult<Bound<'py, PyTuple>>,
        result: impl for<'py> FnOnce(Bound<'py, PyAny>) -> PyResult<T>,
    ) -> trgs::Result<T> {
        let called = Python::attach(|py| {
            py.check_signals()?;
            result(self.object.bind(py).call_method1(method, arguments(py)?)?)
        });
        called.map_err(|error| {
            *self.raised.lock().expect(NEVER) = Some(error);
            Error::Interrupted { step: 0, remedy: "".into() }
        })
    }
}

fn name(name: Name) -> &'static str {
    match name {
        Name::Volume => "volume",
        Name::Before => "before",
        Name::Next => "next",
    }
}

fn flat<'py>(py: Python<'py>, images: &[f32]) -> Bound<'py, PyAny> {
    give(py, Array1::from_vec(images.to_vec()))
}

fn nothing(_: Bound<'_, PyAny>) -> PyResult<()> {
    Ok(())
}

impl Space<f32> for Elsewhere<'_> {
    fn views(&self) -> usize {
        self.views.len()
    }

    fn project(&mut self, views: &[usize], of: Option<Name>) -> trgs::Result<Vec<f32>> {
        let read = |images: Bound<'_, PyAny>| Ok(slice(&read::<f32, Ix1>(&images, "images", IMAGES)?).to_vec());
        let views = self.of(views);
        self.call("project", |py| (views, of.map(name)).into_pyobject(py), read)
    }

    fn adjoin(&mut self, views: &[usize], images: &[f32], of: Name, step: Option<f32>) -> trgs::Result<()> {
        let views = self.of(views);
        self.call("adjoin", |py| (views, flat(py, images), name(of), step).into_pyobject(py), nothing)
    }

    fn correct(
        &mut self,
        views: &[usize],
        [corrections, weights]: [&[f32]; 2],
        relaxation: f32,
        non_negative: bool,
    ) -> trgs::Result<()> {
        let views = self.of(views);
        self.call(
            "correct",
            |py| {
                let (corrections, weights) = (flat(py, corrections), flat(py, weights));
                (views, corrections, weights, relaxation, non_negative).into_pyobject(py)
            },
            nothing,
        )
    }

    fn change(&mut self, change: Change<f32>) -> trgs::Result<()> {
        let (what, of, value) = match change {
            Change::Fill(of, value) => ("fill", name(of), value),
            Change::Scale(of, value) => ("scale", name(of), value),
            Change::Keep => ("keep", "before", 0.0),
            Change::Extrapolate(beta) => ("extrapolate", "next", beta),
            Change::Forget => ("forget", "dual", 0.0),
        };
        self.call("change", |py| (what, of, value).into_pyobject(py), nothing)
    }

    fn measure(&mut self, measure: Measure<f32>) -> trgs::Result<Vec<[f64; 3]>> {
        let (what, beta) = match measure {
            Measure::Squares(_) => ("squares", 0.0),
            Measure::Largest(_) => ("largest", 0.0),
            Measure::Variation(_) => ("variation", 0.0),
            Measure::Step(beta) => ("step", beta),
        };
        let names: Vec<&str> = measure.reads().iter().map(|&of| name(of)).collect();
        self.call("measure", |py| (what, beta, names).into_pyobject(py), |terms| terms.extract())
    }

    fn solve(&mut self, tau: f64, steps: usize) -> trgs::Result<()> {
        self.call("solve", |py| (tau, steps).into_pyobject(py), nothing)
    }

    fn start(&mut self, _: &[f32]) -> trgs::Result<()> {
        unreachable!("these runs begin at zeros")
    }

    fn swap(&mut self, a: Name, b: Name) {
        // What it raises is found by the next call.
        drop(self.call("swap", |py| (name(a), name(b)).into_pyobject(py), nothing));
    }

    fn volume(&mut self) -> trgs::Result<Vec<f32>> {
        Ok(Vec::new())
    }

    fn arrays(&self) -> Vec<&Vec<f32>> {
        Vec::new()
    }

    fn resume(&mut self, _: Vec<Vec<f32>>) -> trgs::Result<()> {
        unreachable!("these runs have no checkpoints")
    }
}

/// Runs `os-sart` or `tv` to its end on the volumes of an object, where the result stays; `settings` are `key=value`.
#[pyfunction]
#[pyo3(signature = (projections, scanner, angles, space, method, settings, callback = None))]
#[allow(clippy::too_many_arguments)]
pub(crate) fn iterate_in<'py>(
    py: Python<'py>,
    projections: &Array<'py>,
    scanner: &Scanner,
    angles: &Array<'py>,
    space: Py<PyAny>,
    method: &str,
    settings: Vec<String>,
    callback: Option<Py<PyAny>>,
) -> PyResult<()> {
    let method = if method == "tv" { Method::Tv } else { Method::OsSart };
    let mut config = Config::of(method);
    settings.iter().try_for_each(|assignment| config.set(assignment)).map_err(raise)?;
    config.validate().map_err(raise)?;
    let measured = to_reconstruct(projections, scanner, angles)?;
    let pixels = [measured.len(), scanner.0.detector.rows, scanner.0.detector.columns];
    fits("images of the method", &pixels, 6 * size_of::<f32>())?;
    let projector = VoxelProjector::new(&scanner.0, RayModel::Joseph).map_err(raise)?;
    let raised = Mutex::new(None);
    let elsewhere = |views: &[usize]| Box::new(Elsewhere { object: &space, views: views.to_vec(), raised: &raised });
    let (result, watch) = run(py, || {
        let mut watch = Watch::new(callback);
        let mut work = || -> trgs::Result<()> {
            let views: Vec<usize> = (0..measured.len()).collect();
            let mut run: Box<dyn VoxelRun + '_> = if method == Method::Tv {
                let settings = config.tv();
                let mut space = |views: &[usize]| -> trgs::Result<Box<dyn Space<f32>>> { Ok(elsewhere(views)) };
                let mut see = |key: &str, trial: Option<&Trial>| watch.see(trial.map(|trial| trial_event(key, trial)));
                let chosen = match config.tv.weight.fixed() {
                    Some(_) => None,
                    None => Some(choose_weight_in(&projector, &measured, &settings, &mut space, &mut see)?.value),
                };
                let mut run = TvRun::in_space(&projector, &measured, &settings, None, elsewhere(&views))?;
                if let Some(weight) = chosen {
                    // The volumes are those of the last choice.
                    run.restart(weight)?;
                }
                Box::new(run)
            } else {
                Box::new(SartRun::in_space(&projector, &measured, &config.sart(), elsewhere(&views))?)
            };
            while !run.is_finished() {
                let Some(pass) = run.step()? else { break };
                if watch.see(Some(pass_event(&pass))).is_break() {
                    return Err(Error::Interrupted { step: pass.iteration, remedy: "".into() });
                }
            }
            Ok(())
        };
        let result = work();
        (result, watch)
    })?;
    match raised.into_inner().expect(NEVER) {
        Some(raised) => Err(raised),
        None => watch.end(result),
    }
}
