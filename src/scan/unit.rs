//! Units of length.

use std::fmt;
use std::str::FromStr;
use trgs_core::error::{Error, Result};

/// A unit of length.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Unit {
    /// Nanometre.
    Nanometre,
    /// Micrometre.
    Micrometre,
    /// Millimetre.
    Millimetre,
    /// Centimetre.
    Centimetre,
    /// Metre.
    Metre,
    /// Inch.
    Inch,
}

/// A unit, its symbol, its millimetres, and other names in lower case.
pub(super) type Row = (Unit, &'static str, f64, &'static [&'static str]);

impl Unit {
    /// All units, with their symbols, millimetres, and other names in lower case.
    pub(super) const ALL: [Row; 6] = [
        (Self::Nanometre, "nm", 1e-6, &["nanometer", "nanometre", "nanometers", "nanometres"]),
        (
            Self::Micrometre,
            "um",
            1e-3,
            &["µm", "μm", "\\u00b5m", "micron", "microns", "micrometer", "micrometre", "micrometers", "micrometres"],
        ),
        (Self::Millimetre, "mm", 1.0, &["millimeter", "millimetre", "millimeters", "millimetres"]),
        (Self::Centimetre, "cm", 10.0, &["centimeter", "centimetre", "centimeters", "centimetres"]),
        (Self::Metre, "m", 1000.0, &["meter", "metre", "meters", "metres"]),
        (Self::Inch, "in", 25.4, &["inch", "inches"]),
    ];

    fn row(self) -> &'static Row {
        Self::ALL.iter().find(|(unit, ..)| *unit == self).expect("every unit has a row")
    }

    /// Its symbol in ASCII, such as `mm` or `um`.
    pub fn symbol(self) -> &'static str {
        self.row().1
    }

    /// Its length in millimetres.
    pub fn millimetres(self) -> f64 {
        self.row().2
    }

    /// The unit of a symbol or name, in any case.
    pub fn named(name: &str) -> Option<Self> {
        let name = name.trim().trim_matches('"').to_lowercase();
        let is_named = |symbol: &str, others: &[&str]| name == symbol || others.contains(&name.as_str());
        Self::ALL.iter().find(|(_, symbol, _, others)| is_named(symbol, others)).map(|(unit, ..)| *unit)
    }
}

impl fmt::Display for Unit {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.symbol())
    }
}

impl FromStr for Unit {
    type Err = Error;

    fn from_str(name: &str) -> Result<Self> {
        Self::named(name).ok_or_else(|| {
            let expected = "nm, um, mm, cm, m or in";
            Error::invalid("unit of length", format!("{name:?}"), expected, "write \"mm\" for millimetres, for example")
        })
    }
}
