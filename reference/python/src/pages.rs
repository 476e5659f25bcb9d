//! Pages that show volumes: the viewer of `trgs view`, in a notebook or a file.

use crate::arrays::read;
use crate::scan::place_of;
use crate::work::{raise, try_run};
use ndarray::Ix3;
use pyo3::prelude::*;
use pyo3::types::PyDict;
use std::io::Write;
use std::path::{Path, PathBuf};
use trgs::report::viewer::{Depth, Scene, page};
use trgs::{Grid, Volume, output};

/// Height of the viewer in a notebook, pixels.
const HEIGHT: usize = 720;

/// A page that shows volumes; a notebook displays it.
#[pyclass(frozen, module = "trgs")]
pub(crate) struct Page {
    /// The page: complete, without access to a network.
    #[pyo3(get)]
    html: String,
}

#[pymethods]
impl Page {
    fn _repr_html_(&self) -> String {
        // A frame of its own: the page's style and script must not meet those of the notebook.
        let page = self.html.replace('&', "&amp;").replace('"', "&quot;");
        format!(
            "<iframe srcdoc=\"{page}\" title=\"volumes\" style=\"width: 100%; height: {HEIGHT}px; border: 0\"></iframe>"
        )
    }

    /// Writes the page, as a whole or not at all.
    ///
    /// Parameters
    /// ----------
    /// path : str or os.PathLike
    ///
    /// Raises
    /// ------
    /// OSError
    ///     For a file that cannot be written.
    fn save(&self, py: Python<'_>, path: PathBuf) -> PyResult<()> {
        try_run(py, || write(&path, &self.html))
    }
}

fn write(path: &Path, html: &str) -> trgs::Result<()> {
    output::check_file(path)?;
    output::write_atomically(path, |file| file.write_all(html.as_bytes()))
}

/// One to four volumes on one grid to scroll through, with window, profile, projections and comparison.
///
/// Parameters
/// ----------
/// volumes : ndarray [x, y, z], float32, or dict
///     A volume, or up to four by name.
/// grid : Scan, Grid or Scanner, optional
///     Size and place of the voxels; without it, voxels have sides of 1.
/// title : str, default "volume"
///     Of the page, and of a volume without a name.
/// full : bool, default False
///     Show all voxels of volumes of more than 128³; otherwise the means of blocks.
/// mu_water : float, optional
///     Attenuation of water: Hounsfield units are shown as well.
///
/// Returns
/// -------
/// Page
///     A notebook displays it; `save` writes it to a file, `html` is its text.
///
/// Raises
/// ------
/// TypeError
///     For arrays of another type or number of axes.
/// ValueError
///     For more than four volumes, different shapes, and numbers that are not finite.
#[pyfunction]
#[pyo3(signature = (volumes, grid = None, *, title = "volume", full = false, mu_water = None))]
pub(crate) fn show(
    py: Python<'_>,
    volumes: &Bound<'_, PyAny>,
    grid: Option<&Bound<'_, PyAny>>,
    title: &str,
    full: bool,
    mu_water: Option<f64>,
) -> PyResult<Page> {
    let given = match volumes.cast::<PyDict>() {
        Ok(named) => named.iter().map(|(name, values)| Ok((name.extract()?, values))).collect::<PyResult<Vec<_>>>()?,
        Err(_) => vec![(title.to_owned(), volumes.clone())],
    };
    let placed = grid.map(place_of).transpose()?;
    let of = |(name, values): (String, Bound<'_, PyAny>)| {
        let values = read::<f32, Ix3>(&values, &format!("volume of {name}"), "[x, y, z]")?.as_array().to_owned();
        let shape: [usize; 3] = values.dim().into();
        let sides = glam::DVec3::from_array(shape.map(|count| count as f64));
        let grid = match placed {
            Some((grid, _)) => grid,
            None => Grid::new(shape, glam::DVec3::ZERO, sides).map_err(raise)?,
        };
        Ok((name, Volume::new(grid, values).map_err(raise)?))
    };
    let volumes = given.into_iter().map(of).collect::<PyResult<Vec<_>>>()?;
    let frame = placed.map_or_else(Default::default, |(_, frame)| frame);
    let html = try_run(py, || {
        let named = volumes.iter().map(|(name, volume)| (name.as_str(), volume)).collect();
        let scene = Scene::of_volumes(title, named, &frame)?.with_water(mu_water);
        let scene = if full { scene } else { scene.reduced() };
        let depth = if scene.count() == 1 { Depth::Sixteen } else { Depth::Eight };
        Ok(page(title, &scene.summary(), &[scene], depth))
    })?;
    Ok(Page { html })
}

/// Writes the page of `show` to a file, as a whole or not at all.
///
/// Parameters
/// ----------
/// path : str or os.PathLike
/// volumes : ndarray [x, y, z], float32, or dict
/// grid : Scan, Grid or Scanner, optional
/// title : str, default "volume"
/// full : bool, default False
/// mu_water : float, optional
///
/// Raises
/// ------
/// OSError
///     For a file that cannot be written.
/// TypeError, ValueError
///     Those of `show`.
#[pyfunction]
#[pyo3(signature = (path, volumes, grid = None, *, title = "volume", full = false, mu_water = None))]
pub(crate) fn save_page(
    py: Python<'_>,
    path: PathBuf,
    volumes: &Bound<'_, PyAny>,
    grid: Option<&Bound<'_, PyAny>>,
    title: &str,
    full: bool,
    mu_water: Option<f64>,
) -> PyResult<()> {
    show(py, volumes, grid, title, full, mu_water)?.save(py, path)
}
