//! Settings besides the configuration that errors name.

use std::fmt;

macro_rules! settings {
    ($($(#[$docs:meta])* $variant:ident = $name:literal,)*) => {
        /// A setting that is no key of a configuration: an argument of a function or of a command.
        ///
        /// Errors print its name between backticks, as in `` `max_memory` ``. A front end can replace that by its own word:
        /// the program puts the flag there.
        #[derive(Clone, Copy, Debug, PartialEq, Eq)]
        pub enum Setting { $($(#[$docs])* $variant,)* }

        impl Setting {
            /// All settings.
            pub const ALL: &'static [Self] = &[$(Self::$variant),*];

            /// Its name: letters and underscores.
            pub fn name(self) -> &'static str {
                match self { $(Self::$variant => $name,)* }
            }
        }
    };
}

settings! {
    /// The air to subtract from line integrals, or `auto`.
    Air = "air",
    /// The file of the angles of a stack.
    Angles = "angles",
    /// Voxels along each side of the middle of a larger volume, which an experiment is about.
    Crop = "crop",
    /// The dark field of a stack: frames without X-rays.
    Dark = "dark",
    /// The folder whose scans and volumes are the cases of an experiment.
    Data = "data",
    /// Whether the file of the angles is in degrees.
    Degrees = "degrees",
    /// The flat field of a stack: frames without an object.
    Flat = "flat",
    /// The highest level of the conformance vectors that is asked of a backend.
    Level = "level",
    /// Whether the data are line integrals already.
    LineIntegrals = "line_integrals",
    /// The pixels to interpolate: `auto`, or those of a mask.
    MaskPixels = "mask_pixels",
    /// The limit on the memory of a run, and of what a reader allocates.
    MaxMemory = "max_memory",
    /// The attenuation of water, which turns Hounsfield units into attenuation.
    MuWater = "mu_water",
    /// Whether other content of an output folder is deleted.
    Overwrite = "overwrite",
    /// Primitives at the start: the key `model.points`.
    Points = "points",
    /// Whether the angles of a stack are radians, however large.
    Radians = "radians",
    /// Whether a model is written with the keys of R²-Gaussian.
    R2 = "r2",
    /// The file of a conformance report.
    Report = "report",
    /// Whether a run starts from its checkpoint.
    Resume = "resume",
    /// The description of beam, detector and volume of a stack.
    Scanner = "scanner",
    /// Voxels along each side of an experiment's volumes.
    Size = "size",
    /// Stages of the conformance vectors.
    Stage = "stage",
    /// The number of test views.
    TestViews = "test_views",
    /// Worker threads.
    Threads = "threads",
    /// The number of training views.
    Views = "views",
    /// The reading of a pixel without an object, instead of a flat field.
    White = "white",
}

impl fmt::Display for Setting {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "`{}`", self.name())
    }
}
