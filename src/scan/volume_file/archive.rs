//! A volume in an archive of NumPy, `.npz`.

use super::VolumeFile;
use crate::npy;
use crate::npz::Npz;
use ndarray::Ix3;
use std::path::Path;
use trgs_core::error::{Error, Result};

pub(super) fn parse(content: &[u8], path: &Path) -> Result<VolumeFile> {
    let npz = Npz::parse(content, path)?;
    let shape = |key: &str| npz.entry(key).map(|array| array.numbers.shape().to_vec()).unwrap_or_default();
    let volumes: Vec<&str> = npz.keys().filter(|key| shape(key).len() == 3).collect();
    let &[key] = volumes.as_slice() else {
        let all: Vec<String> = npz.keys().map(|key| format!("{key} {:?}", shape(key))).collect();
        let got = format!("arrays [{}]", all.join(", "));
        let remedy = "save one volume to a file of its own, with numpy.save";
        return Err(Error::format(path, "archive", got, "one array with axes [x, y, z]", remedy));
    };
    let array = npz.entry(key).expect("it is among the keys").numbers.clone().into_f32();
    let mut volume = npy::with_axes::<f32, Ix3>(array, path, key, "[x, y, z]").map(VolumeFile::bare)?;
    if npz.keys().count() > 1 {
        volume.oddities.push(format!("{key} is read, the only array of the archive with three axes"));
    }
    Ok(volume)
}
