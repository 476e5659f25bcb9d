//! The extension module of the Python package `trgs`: arguments and results of the library as NumPy arrays.
//!
//! Every function checks its arguments, releases the GIL, calls the library, and hands the result over. No arithmetic is
//! done here. Documentation strings have the format of NumPy, and `trgs/_core.pyi` the types.

mod arrays;
mod classical;
mod conformance;
mod geometry;
mod losses;
mod model;
mod networks;
mod optim;
mod pages;
mod projector;
mod scan;
mod slabs;
mod views;
mod work;

use pyo3::prelude::*;

/// Functions and classes that the modules of the package re-export.
#[pymodule]
mod _core {
    #[pymodule_export]
    use crate::classical::{
        asd_pocs, back_project, cgls, fdk, fdk_backproject, fdk_filter, forward_project, os_sart, sart, tv,
    };
    #[pymodule_export]
    use crate::conformance::{
        conformance_cases, conformance_check, conformance_export, conformance_hunt, conformance_input,
        conformance_make, conformance_open, conformance_truth, conformance_waivers,
    };
    #[pymodule_export]
    use crate::geometry::{Grid, Scanner};
    #[pymodule_export]
    use crate::losses::{
        haar_inverse, haar_transform, image_loss, l1, psnr_2d, psnr_3d, ssim, ssim_2d, ssim_3d, total_variation,
        wavelet_loss, wavelet_routing,
    };
    #[pymodule_export]
    use crate::model::{Activation, Model, integral_factor, kernel, nu_loss, nu_target, ray_confidence};
    #[pymodule_export]
    use crate::networks::network_steps;
    #[pymodule_export]
    use crate::optim::{Adam, Sghmc, adaptive_control, add_and_recycle, gate, learning_rate};
    #[pymodule_export]
    use crate::pages::{Page, save_page, show};
    #[pymodule_export]
    use crate::projector::{
        footprint_gradient, project, project_vjp, support, truncation_bound, voxelize, voxelize_part, voxelize_vjp,
    };
    #[pymodule_export]
    use crate::scan::{
        Reconstruction, Scan, load_scan, load_volume, phantoms, reconstruct, restored_scan, save_volume, simulate_scan,
    };
    #[pymodule_export]
    use crate::slabs::{Part, fdk_part, iterate_in};
    #[pymodule_export]
    use crate::views::{geometry_of, motion_vjp};
    #[pymodule_export]
    use crate::work::{build, command_line, cpu_level, is_fast, set_max_memory, set_threads, threads};
}
