//! Settings besides the configuration that errors name, and sentences that name settings.

use crate::words::visible;
use serde::{Serialize, Serializer};
use std::fmt;
use std::ops::Add;

macro_rules! settings {
    ($($(#[$docs:meta])* $variant:ident = $name:literal,)*) => {
        /// A setting that is no key of a configuration: an argument of a function or of a command.
        ///
        /// A sentence that names it is a [`Text`].
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

/// A sentence that may name settings and assignments to keys of the configuration.
///
/// It prints them between backticks, as in `` `max_memory` `` and `` `seed=1` ``. A front end puts its own words there with
/// [`Self::shown`]; no other text is taken for a setting, whatever it holds.
///
/// ```
/// use trgs_core::setting::{Setting, Text};
///
/// let text = "give " + Setting::MaxMemory + " 2GB, or lower " + Text::set("model.points", 500);
/// assert_eq!(text.to_string(), "give `max_memory` 2GB, or lower `model.points=500`");
/// let shouted = text.shown(|setting| setting.name().to_uppercase(), |assignment| format!("set({assignment})"));
/// assert_eq!(shouted, "give MAX_MEMORY 2GB, or lower set(model.points=500)");
/// ```
#[derive(Clone, Default, PartialEq, Eq)]
pub struct Text(Vec<Part>);

#[derive(Clone, PartialEq, Eq)]
enum Part {
    Words(String),
    Setting(Setting),
    /// `key=value`.
    Assignment(String),
}

impl Text {
    /// An assignment to a key of the configuration.
    pub fn set(key: &str, value: impl fmt::Display) -> Self {
        Self(vec![Part::Assignment(format!("{key}={value}"))])
    }

    /// The sentence on one line, with the words of a front end for settings and for assignments `key=value`.
    pub fn shown(&self, setting: impl Fn(Setting) -> String, assignment: impl Fn(&str) -> String) -> String {
        let word = |part: &Part| match part {
            Part::Words(words) => words.clone(),
            Part::Setting(name) => setting(*name),
            Part::Assignment(text) => assignment(text),
        };
        visible(self.0.iter().map(word).collect::<String>())
    }

    /// Whether it names a setting.
    pub fn names(&self, setting: Setting) -> bool {
        self.0.contains(&Part::Setting(setting))
    }

    /// Whether it has no part.
    pub fn is_empty(&self) -> bool {
        self.0.is_empty()
    }
}

impl fmt::Display for Text {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.shown(|setting| format!("`{}`", setting.name()), |assignment| format!("`{assignment}`")))
    }
}

/// The sentence as a literal.
impl fmt::Debug for Text {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.to_string().fmt(f)
    }
}

impl Serialize for Text {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_str(self)
    }
}

impl From<String> for Text {
    fn from(words: String) -> Self {
        if words.is_empty() { Self::default() } else { Self(vec![Part::Words(words)]) }
    }
}

impl From<&String> for Text {
    fn from(words: &String) -> Self {
        words.clone().into()
    }
}

impl From<&str> for Text {
    fn from(words: &str) -> Self {
        words.to_owned().into()
    }
}

impl From<Setting> for Text {
    fn from(setting: Setting) -> Self {
        Self(vec![Part::Setting(setting)])
    }
}

impl From<&Self> for Text {
    fn from(text: &Self) -> Self {
        text.clone()
    }
}

impl<T: Into<Self>> Add<T> for Text {
    type Output = Self;

    fn add(mut self, more: T) -> Self {
        self.0.extend(more.into().0);
        self
    }
}

impl Add<Setting> for &str {
    type Output = Text;

    fn add(self, setting: Setting) -> Text {
        Text::from(self) + setting
    }
}

impl Add<Text> for &str {
    type Output = Text;

    fn add(self, text: Text) -> Text {
        Text::from(self) + text
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_settings_become_words_of_a_front_end() {
        let foreign = "a file `seed=1` without `scanner`";
        let text = Text::from(foreign) + ": give " + Setting::Scanner + ", or " + Text::set("seed", 2);
        assert_eq!(text.to_string(), format!("{foreign}: give `scanner`, or `seed=2`"));
        let shown = text.shown(|setting| setting.name().to_uppercase(), |assignment| format!("set({assignment})"));
        assert_eq!(shown, format!("{foreign}: give SCANNER, or set(seed=2)"));
        assert!(text.names(Setting::Scanner) && !Text::from(foreign).names(Setting::Scanner));
        assert_eq!(Text::from("a\nb\u{1b}").to_string(), "a\\nb\\u{1b}");
    }
}
