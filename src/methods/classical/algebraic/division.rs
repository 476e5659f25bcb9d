//! Whether the volumes of total variation are whole or in slabs.

use super::slabs::Slabs;
use super::space::{Space, Whole};
use crate::classical::VoxelProjector;
use std::path::PathBuf;
use trgs_core::error::Result;
use trgs_core::geometry::View;
use trgs_core::numeric::Real;

/// Whether volumes are whole or in slabs.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Division {
    /// Number of slabs, one in memory at a time; 1: whole volumes in memory.
    pub slabs: usize,
    /// Where the files of slabs are, which have no name and end with the process.
    pub folder: PathBuf,
}

impl Division {
    /// Whole volumes in memory.
    pub fn whole() -> Self {
        Self { slabs: 1, folder: PathBuf::new() }
    }

    /// The volumes of total variation for some views.
    pub(super) fn space<'a, R: Real>(
        &self,
        projector: &'a VoxelProjector,
        views: Vec<View>,
    ) -> Result<Box<dyn Space<R> + 'a>> {
        Ok(match self.slabs {
            1 => Box::new(Whole::new(projector, views, true)),
            slabs => Box::new(Slabs::<R>::new(projector, views, slabs, &self.folder)?),
        })
    }
}
