//! The paper's tables as data: rows, what each row runs, and which figures of the paper belong to it.

use super::conditions::{Conditions, Damage, Rays};
use crate::config::{Auto, Config, Method, Preset};
use crate::error::{Error, Result};
use crate::scan::Noise;
use serde::Deserialize;
use std::collections::BTreeMap;

macro_rules! tables {
    ($($name:literal),*) => {
        /// The tables in the order of the paper.
        pub const NAMES: [&str; TABLES.len()] = [$($name),*];

        /// Name, definition and printed figures of each.
        const TABLES: &[(&str, &str, &str)] = &[$((
            $name,
            include_str!(concat!("tables/", $name, ".toml")),
            include_str!(concat!("../../reference/paper/", $name, ".csv")),
        )),*];
    };
}

tables!("volume", "projection", "noise", "ablation", "temperature", "optimiser", "threshold", "enhancement");

/// A table: every row for every number of views and every level of noise.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Table {
    /// Name on the command line, or that of the file.
    #[serde(skip)]
    pub name: String,
    /// Number in the paper; `None` for a table of a file.
    #[serde(default)]
    pub number: Option<u8>,
    /// Title for display.
    pub title: String,
    /// Columns, from [`super::METRICS`].
    pub metrics: Vec<String>,
    /// Numbers of training views.
    pub views: Vec<usize>,
    /// Levels of noise, from [`Noise::NAMED`].
    pub noise: Vec<String>,
    /// Selects the part of the paper's table, in addition to the rows' own selection: column → value.
    #[serde(default)]
    pub paper: BTreeMap<String, String>,
    /// The row that the others are compared with.
    pub full: String,
    /// The x axis of the plot: views, noise, or a column that numbers the rows in the paper.
    pub against: Option<String>,
    /// What the settings of rows that fit primitives start from.
    #[serde(default)]
    pub basis: Basis,
    /// Its cases, if not all of a folder or the fifteen stand-ins: names of phantoms, or of volumes and scans of the folder.
    #[serde(default)]
    pub cases: Vec<String>,
    /// Pixels along each side of the detector, if not those of the [`Scale`](super::Scale): a ray through each pixel's centre.
    #[serde(default)]
    pub detector: Option<usize>,
    /// The model of the rays.
    #[serde(default)]
    pub rays: Rays,
    /// Whether training views go through a measuring chain.
    #[serde(default)]
    pub realistic: bool,
    /// What is wrong in the training views.
    #[serde(default)]
    pub damage: Damage,
    /// Rows from top to bottom.
    pub rows: Vec<TableRow>,
    /// Settings of all rows that fit primitives, in the form that [`Config::set`] takes. A
    /// row's own settings apply after them.
    #[serde(default)]
    pub set: Vec<String>,
    /// The paper's figures.
    #[serde(skip)]
    printed: Vec<BTreeMap<String, String>>,
}

/// What settings start from.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Basis {
    /// The preset `paper`.
    #[default]
    Paper,
    /// The defaults of the program.
    Trgs,
}

/// A row in each block of a table.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TableRow {
    /// Name for display.
    pub name: String,
    /// Selects the row in the paper's table: column → value. Empty if the paper does not have it.
    #[serde(default)]
    pub paper: BTreeMap<String, String>,
    /// The method to run. `None` if only the paper has the row.
    pub method: Option<Method>,
    /// Settings, in the form that [`Config::set`] takes.
    #[serde(default)]
    pub set: Vec<String>,
}

impl Table {
    /// The table with a name.
    ///
    /// # Errors
    /// For an unknown name.
    pub fn by_name(name: &str) -> Result<Self> {
        let known = TABLES.iter().find(|(known, ..)| *known == name);
        known.map(Self::load).ok_or_else(|| {
            Error::invalid(
                "table",
                format!("{name:?}"),
                format!("all, list, {}", NAMES.join(", ")),
                "give one of these names",
            )
        })
    }

    /// The table with the paper's figures on measured scans; `None` if the paper has none.
    pub fn measured(mut self) -> Option<Self> {
        let data = self.paper.get_mut("data")?;
        "real".clone_into(data);
        self.title += ", measured scans";
        Some(self)
    }

    /// Whether the paper's figures are those on measured scans.
    pub fn is_measured(&self) -> bool {
        self.paper.get("data").is_some_and(|data| data == "real")
    }

    /// The table with other settings in all rows that fit primitives.
    ///
    /// # Errors
    /// For a setting that is invalid.
    pub fn with(mut self, settings: &[String]) -> Result<Self> {
        let mut config = Config::of(Method::TrGs);
        settings.iter().try_for_each(|setting| config.set(setting))?;
        config.validate()?;
        let all = [&self.set, settings].concat();
        self.rows.iter().try_for_each(|row| row.checked(self.basis, &all).map(drop))?;
        self.set.extend_from_slice(settings);
        Ok(self)
    }

    /// The table in which of the networks these run. The others have only the paper's figures, and no row where there are none.
    #[must_use]
    pub fn with_networks(mut self, run: &[Method]) -> Self {
        let runs = |method: &Method| !method.is_network() || run.contains(method);
        for row in &mut self.rows {
            row.method = row.method.filter(runs);
        }
        self.rows.retain(|row| row.method.is_some() || !row.paper.is_empty());
        self
    }

    /// How objects are scanned.
    pub(super) fn conditions(&self) -> Conditions {
        Conditions { rays: self.rays, realistic: self.realistic, damage: self.damage }
    }

    /// All tables.
    pub fn all() -> Vec<Self> {
        TABLES.iter().map(Self::load).collect()
    }

    fn load(&(name, definition, printed): &(&str, &str, &str)) -> Self {
        let mut table = Self::parsed(name, definition).unwrap_or_else(|error| panic!("table {name}: {error}"));
        let mut reader = csv::Reader::from_reader(printed.as_bytes());
        table.printed = reader.deserialize().collect::<csv::Result<_>>().expect("the paper's tables are rectangular");
        table
    }

    /// A table in the form of `src/experiments/tables`, without figures of the paper.
    ///
    /// # Errors
    /// For a text in another form, and for the first row whose settings are invalid.
    pub fn parsed(name: &str, definition: &str) -> Result<Self> {
        let wrong = |what: &str, got: String, expected: &str| {
            Error::invalid(
                format!("table {name:?}: {what}"),
                got,
                expected,
                "correct it; src/experiments/tables has examples",
            )
        };
        let mut table: Self = toml::from_str(definition)
            .map_err(|error| wrong("its definition", error.message().into(), "the keys of a table"))?;
        table.name = name.into();
        let names: Vec<_> = table.rows.iter().map(|row| row.name.as_str()).collect();
        if names.iter().enumerate().any(|(k, name)| names[..k].contains(name)) || !names.contains(&table.full.as_str())
        {
            return Err(wrong(
                "full",
                format!("{:?}", table.full),
                &format!("one of different rows: {}", names.join(", ")),
            ));
        }
        if let Some(metric) = table.metrics.iter().find(|metric| !super::METRICS.contains(&metric.as_str())) {
            return Err(wrong("metrics", format!("{metric:?}"), &super::METRICS.join(", ")));
        }
        let known = Noise::NAMED.map(|(name, _)| name);
        if let Some(level) = table.noise.iter().find(|level| !known.contains(&level.as_str())) {
            return Err(wrong("noise", format!("{level:?}"), &known.join(", ")));
        }
        if table.detector.is_some_and(|pixels| !(1..=8192).contains(&pixels)) {
            return Err(wrong("detector", format!("{:?}", table.detector), "1 to 8192 pixels"));
        }
        if table.views.is_empty() || table.views.contains(&0) {
            return Err(wrong("views", format!("{:?}", table.views), "numbers of at least 1"));
        }
        for row in &table.rows {
            let invalid =
                |error: Error| wrong(&format!("row {:?}", row.name), error.to_string(), "settings that are valid");
            row.checked(table.basis, &table.set).map_err(invalid)?;
        }
        Ok(table)
    }

    /// The figure that the paper prints for a row, if any.
    pub fn printed(&self, row: &TableRow, views: usize, noise: &str, metric: &str) -> Option<f64> {
        if row.paper.is_empty() {
            return None;
        }
        let views = views.to_string();
        let line = self.printed.iter().find(|line| {
            let is = |column: &str, value: &str| line.get(column).is_none_or(|printed| printed == value);
            let selected = self.paper.iter().chain(&row.paper).all(|(column, value)| line.get(column) == Some(value));
            selected && is("views", &views) && is("noise", noise)
        })?;
        line.get(metric)?.parse().ok()
    }

    /// The position of a row on the x axis of a plot.
    pub fn place(&self, row: &TableRow, views: usize, noise: &str) -> Option<f64> {
        match self.against.as_deref()? {
            "views" => Some(views as f64),
            "noise" => self.noise.iter().position(|known| known == noise).map(|place| place as f64),
            column => row.paper.get(column)?.parse().ok(),
        }
    }
}

impl TableRow {
    /// Its configuration; `None` for a row that only the paper has. `settings` apply to what fits primitives, and the row's own
    /// after them.
    ///
    /// # Panics
    /// When a setting is invalid.
    pub fn config(&self, basis: Basis, settings: &[String]) -> Option<Config> {
        self.checked(basis, settings).unwrap_or_else(|error| panic!("row {}: {error}", self.name))
    }

    fn checked(&self, basis: Basis, settings: &[String]) -> Result<Option<Config>> {
        let Some(method) = self.method else { return Ok(None) };
        let mut config = Config::of(method);
        if basis == Basis::Paper {
            config.apply(Preset::Paper);
            // Densities of the cases are from 0 to about 1.
            config.density_unit = Auto::Fixed(1.0);
        }
        let settings = settings.iter().filter(|_| method.fits_primitives());
        settings.chain(&self.set).try_for_each(|setting| config.set(setting))?;
        config.validate()?;
        Ok(Some(config))
    }
}

/// The level of noise with a name.
///
/// # Panics
/// For an unknown name.
pub(super) fn noise(name: &str) -> Noise {
    let known = Noise::NAMED.into_iter().find(|(known, _)| *known == name);
    known.unwrap_or_else(|| panic!("noise {name}")).1
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::experiments::METRICS;
    use std::collections::BTreeSet;

    #[test]
    fn every_figure_of_the_paper_has_its_place() {
        let measured: Vec<_> = Table::all().into_iter().filter_map(Table::measured).collect();
        assert_eq!(measured.iter().map(|table| &*table.name).collect::<Vec<_>>(), ["volume", "projection"]);
        for table in Table::all().into_iter().chain(measured) {
            let part = table.paper.get("data");
            let mut found = BTreeSet::new();
            for &views in &table.views {
                for level in &table.noise {
                    for row in &table.rows {
                        for metric in &table.metrics {
                            assert!(METRICS.contains(&metric.as_str()), "{}: {metric}", table.name);
                            let printed = table.printed(row, views, level, metric);
                            assert_eq!(printed.is_some(), !row.paper.is_empty(), "{}: {}", table.name, row.name);
                            if printed.is_some() {
                                assert!(found.insert((views, level, &row.name, metric)));
                            }
                        }
                    }
                }
            }
            let ours = table.printed.iter().filter(|line| line.get("data") == part);
            assert_eq!(found.len(), ours.count() * table.metrics.len(), "{}", table.name);
        }
    }

    #[test]
    fn rows_have_one_name_each_and_settings_that_are_valid() {
        for table in Table::all() {
            let names: BTreeSet<_> = table.rows.iter().map(|row| &row.name).collect();
            assert_eq!(names.len(), table.rows.len(), "{}", table.name);
            assert!(names.contains(&table.full), "{}", table.name);
            for row in &table.rows {
                row.checked(table.basis, &table.set).unwrap();
            }
            assert!(table.noise.iter().all(|level| noise(level) != Noise::NAMED[0].1));
            let placed = table.rows.iter().all(|row| table.place(row, table.views[0], &table.noise[0]).is_some());
            assert_eq!(placed, table.against.is_some(), "{}", table.name);
        }
    }

    #[test]
    fn networks_run_where_they_are_asked_for() {
        let of = |run: &[Method]| {
            let table = Table::by_name("volume").unwrap().with_networks(run);
            let rows = table.rows.into_iter().filter(|row| ["NAF", "SAX-NeRF"].contains(&row.name.as_str()));
            rows.map(|row| (row.name, row.method)).collect::<Vec<_>>()
        };
        assert_eq!(of(&[]), [("SAX-NeRF".into(), None)]);
        assert_eq!(of(&[Method::Naf]), [("NAF".into(), Some(Method::Naf)), ("SAX-NeRF".into(), None)]);
        assert_eq!(of(&[Method::SaxNerf]), [("SAX-NeRF".into(), Some(Method::SaxNerf))]);
    }

    #[test]
    fn rows_of_the_paper_are_the_preset() {
        for table in Table::all() {
            for row in table.rows.iter().filter(|row| row.set.is_empty()) {
                let Some(method) = row.method else { continue };
                let mut preset = Config::of(method);
                preset.apply(Preset::Paper);
                preset.density_unit = Auto::Fixed(1.0);
                assert_eq!(row.config(table.basis, &[]), Some(preset), "{}: {}", table.name, row.name);
            }
        }
    }

    #[test]
    fn a_table_of_a_file_is_checked_as_a_whole() {
        let good = "title = 'ν'\nmetrics = ['psnr_3d']\nviews = [12]\nnoise = ['low']\nfull = 'a'\nbasis = 'trgs'\n\
                    rows = [{ name = 'a', method = 'tr-gs', set = ['optimiser.nu=[0,0]'] }, { name = 'b', method = 'sart' }]";
        let table = Table::parsed("nu", good).unwrap();
        let config = table.rows[0].config(table.basis, &[]).unwrap();
        assert_eq!((config.optimiser.nu, config.rules), ([0.0, 0.0], crate::config::Rules::Trgs));
        for (from, to, what) in [
            ("'psnr_3d'", "'psnr'", "metrics"),
            ("'low'", "'loud'", "noise"),
            ("[12]", "[0]", "views"),
            ("full = 'a'", "full = 'c'", "full"),
            ("'b'", "'a'", "full"),
            ("optimiser.nu", "optimiser.mu", "row \"a\""),
            ("views", "vues", "definition"),
        ] {
            let error = Table::parsed("nu", &good.replace(from, to)).unwrap_err().to_string();
            assert!(error.contains(what), "{error}");
        }
    }

    #[test]
    fn tables_of_the_reference_are_valid() {
        let root = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("reference");
        let in_folder = |name| std::fs::read_dir(root.join(name)).unwrap().map(|entry| entry.unwrap().path());
        let files = ["verdict", "experiments"].into_iter().flat_map(in_folder);
        let files: Vec<_> = files.filter(|path| path.extension().is_some_and(|e| e == "toml")).collect();
        assert!(!files.is_empty());
        for path in files {
            Table::parsed("own", &std::fs::read_to_string(&path).unwrap()).unwrap_or_else(|e| panic!("{path:?}: {e}"));
        }
    }

    #[test]
    fn figures_are_those_of_the_row_the_views_and_the_noise() {
        let table = Table::by_name("noise").unwrap();
        let row = |name| table.rows.iter().find(|row| row.name == name).unwrap();
        assert_eq!(table.printed(row("TR-GS"), 25, "high", "ssim_3d"), Some(0.889));
        let table = Table::by_name("volume").unwrap();
        let row = |name| table.rows.iter().find(|row| row.name == name).unwrap();
        assert_eq!(table.printed(row("SAX-NeRF"), 18, "low", "psnr_3d"), Some(32.18));
        let measured = table.clone().measured().unwrap();
        assert_eq!(measured.printed(row("TR-GS"), 12, "low", "psnr_3d"), Some(34.84));
        assert!(Table::by_name("tables").is_err());
    }
}
