//! What a method asks of memory: rows of arrays, which each algorithm states beside itself.

/// Bytes of a double-precision number.
pub const F64: usize = size_of::<f64>();
/// Bytes of a single-precision number.
pub const F32: usize = size_of::<f32>();

/// Arrays of one kind.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Allocation {
    /// Content of the arrays.
    pub what: &'static str,
    /// Number of elements: pixels, voxels or primitives.
    pub count: usize,
    /// Bytes per element.
    pub bytes: usize,
}

impl Allocation {
    /// Bytes of all elements.
    pub fn total(&self) -> u64 {
        (self.count as u64).saturating_mul(self.bytes as u64)
    }
}

/// A row: `count` elements of `bytes` bytes.
pub fn allocation(what: &'static str, count: usize, bytes: usize) -> Allocation {
    Allocation { what, count, bytes }
}

/// The sizes that all rows follow from.
#[derive(Clone, Copy, Debug)]
pub struct Sizes {
    /// Pixels of a view.
    pub detector: usize,
    /// Pixels of all views used.
    pub pixels: usize,
    /// Voxels of the volume.
    pub voxels: usize,
    /// Voxels of a slice across x.
    pub slice: usize,
    /// Slices across x.
    pub slices: usize,
    /// Voxels along z.
    pub column: usize,
    /// Bytes of a number in the precision of pixels and voxels.
    pub real: usize,
    /// Workers.
    pub threads: usize,
    /// Slabs of the volumes of SART and of total variation, one in memory at a time.
    pub slabs: usize,
}

impl Sizes {
    /// Bytes of a voxel as it is written: a volume in single precision is no copy.
    pub(crate) fn written(&self) -> usize {
        if self.real == F32 { 0 } else { F32 }
    }

    /// Voxels of a slab with so many slices beside it; all voxels of whole volumes.
    pub(crate) fn slab(&self, beside: usize) -> usize {
        if self.slabs == 1 {
            self.voxels
        } else {
            self.slice * (self.slices.div_ceil(self.slabs) + beside).min(self.slices)
        }
    }

    /// The partial sums of all workers, `numbers` for each voxel of their slices.
    pub(crate) fn at_work(&self, numbers: usize) -> Allocation {
        const SLICES: usize = 8;
        let bytes = SLICES * numbers * self.real * self.threads.min(self.slices.div_ceil(SLICES));
        allocation("sums of slices at work", self.slice, bytes)
    }
}
