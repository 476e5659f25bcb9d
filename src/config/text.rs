//! Reading and writing configurations.

use super::keys::{Key, Keys, dotted};
use super::{
    AlgebraicConfig, AsdPocsConfig, ConfidenceConfig, Config, DensityControlConfig, FdkConfig, InitialisationConfig,
    LossConfig, Method, ModelConfig, NeuralConfig, OptimiserConfig, SghmcConfig, TvConfig, WaveletConfig,
};
use crate::error::{Error, Result};
use crate::setting::Text;
use crate::words::utf8;
use std::collections::BTreeMap;
use std::path::Path;
use toml::{Table, Value};

/// A key of former versions: the smallest scale as a fraction of the volume's side.
const FORMER_SCALE: &str = "model.scale_min";

/// The tables: name, what it is for, its keys.
const TABLES: [(&str, &str, &[Key]); 14] = [
    table::<Config>(""),
    table::<ModelConfig>("model"),
    table::<InitialisationConfig>("initialisation"),
    table::<LossConfig>("loss"),
    table::<ConfidenceConfig>("confidence"),
    table::<WaveletConfig>("wavelet"),
    table::<OptimiserConfig>("optimiser"),
    table::<SghmcConfig>("sghmc"),
    table::<DensityControlConfig>("density_control"),
    table::<FdkConfig>("fdk"),
    table::<AlgebraicConfig>("algebraic"),
    table::<AsdPocsConfig>("asd_pocs"),
    table::<TvConfig>("tv"),
    table::<NeuralConfig>("neural"),
];

const fn table<T: Keys>(name: &'static str) -> (&'static str, &'static str, &'static [Key]) {
    (name, T::DOCS, T::KEYS)
}

impl Config {
    /// Reads a file; keys that it does not name keep the defaults of its method, or of `otherwise` if it names none.
    /// Ranges are not checked yet: see [`Self::validate`].
    ///
    /// # Errors
    /// [`Error::Read`], or [`Error::Format`] for the first line that is no TOML, unknown key or value of a wrong type.
    pub fn read(path: impl AsRef<Path>, otherwise: Method) -> Result<Self> {
        let path = path.as_ref();
        let text = std::fs::read(path).map_err(|source| Error::read(path, source))?;
        let text = String::from_utf8_lossy(&utf8(&text)).into_owned();
        let table: Table = text.parse().map_err(|error: toml::de::Error| {
            let line = error.span().map_or(1, |span| text[..span.start].lines().count().max(1));
            let remedy = "correct the line; the config.toml of any run is an example";
            Error::format(path, format!("line {line}"), error.message(), "TOML", remedy)
        })?;
        let mut first = Self::default();
        if let Some(method) = table.get("method") {
            first.put("method", method.clone()).map_err(|error| error.in_file(path))?;
        } else {
            first.method = otherwise;
        }
        let mut config = Self::of(first.method);
        for (key, value) in flatten(&table) {
            config.put(&key, value).map_err(|error| error.in_file(path))?;
        }
        Ok(config)
    }

    /// Reads what [`Self::to_toml`] gave.
    ///
    /// # Errors
    /// A sentence on the first thing that does not fit.
    pub fn from_toml(text: &str) -> std::result::Result<Self, String> {
        // By way of a table, as in `read`: one deserialiser of a configuration is compiled.
        text.parse::<Table>().and_then(Table::try_into).map_err(|error| error.message().into())
    }

    /// The first key that has another value in `other`, with both values.
    pub fn difference(&self, other: &Self) -> Option<(String, String, String)> {
        let pairs = self.entries().into_iter().zip(other.entries());
        pairs.into_iter().find(|(a, b)| a != b).map(|((key, a), (_, b))| (key, a.to_string(), b.to_string()))
    }

    /// Sets one key from `table.key=value`. The value is TOML; strings may go without quotes.
    ///
    /// # Errors
    /// [`Error::Invalid`] for an unknown key (the message names the nearest) or a value of a wrong type.
    pub fn set(&mut self, assignment: &str) -> Result<()> {
        let (key, text) = assignment.split_once('=').ok_or_else(|| {
            Error::invalid("setting", format!("{assignment:?}"), "key=value", "write for example model.points=20000")
        })?;
        let text = text.trim();
        let value = format!("value = {text}").parse::<Table>().ok().and_then(|mut table| table.remove("value"));
        self.put(key.trim(), value.unwrap_or_else(|| text.into()))
    }

    /// The whole configuration, every key below its documentation. [`Self::read`] gives back the same.
    ///
    /// # Panics
    /// When the seed is out of range.
    pub fn to_toml(&self) -> String {
        let mut text = String::new();
        let values: BTreeMap<String, Value> = self.entries().into_iter().collect();
        for (name, docs, keys) in TABLES {
            text += &comment(docs);
            if !name.is_empty() {
                text += &format!("[{name}]\n");
            }
            for Key { name: key, docs } in keys {
                // A key without a value is a table and has its own turn.
                let names = if dotted(name, key) == "method" { methods() } else { String::new() };
                if let Some(value) = values.get(&dotted(name, key)) {
                    text += &format!("{}{key} = {value}\n", comment(&format!("{}{names}", docs.trim())));
                }
            }
            text += "\n";
        }
        text.truncate(text.trim_end().len() + 1);
        text
    }

    /// All keys, dotted, with their values, in the order of the structs.
    pub fn entries(&self) -> Vec<(String, Value)> {
        flatten(&self.to_table())
    }

    fn to_table(&self) -> Table {
        // Only a number that is no integer of TOML can fail, and those are out of the range of every key.
        Table::try_from(self).expect("a configuration consists of tables, numbers and names")
    }

    /// Sets one key after checking that it exists and that the value has its type.
    fn put(&mut self, key: &str, value: Value) -> Result<()> {
        if key == FORMER_SCALE {
            let remedy = "model.smallest_scale is stated in voxels: multiply by the voxels along the longest side";
            return Err(Error::invalid("configuration key", key, "model.smallest_scale", remedy));
        }
        let entries = self.entries();
        let Some((_, old)) = entries.iter().find(|(name, _)| name == key) else {
            let nearest = nearest(key, entries.iter().map(|(name, _)| name.as_str()));
            return Err(Error::invalid("configuration key", key, "a known key", format!("did you mean {nearest}?")));
        };
        let mut table = self.to_table();
        let mut place = &mut table;
        let (parents, last) = key.rsplit_once('.').map_or((None, key), |(parents, last)| (Some(parents), last));
        for parent in parents.into_iter().flat_map(|parents| parents.split('.')) {
            place = place.get_mut(parent).and_then(Value::as_table_mut).expect("the key exists");
        }
        place.insert(last.into(), value.clone());
        *self = table.try_into().map_err(|error: toml::de::Error| {
            let remedy = "give " + Text::set(key, old) + ", for example";
            Error::invalid(key, format!("{value}: {}", error.message()), format!("a value like {old}"), remedy)
        })?;
        Ok(())
    }
}

/// All values of a table that are no tables themselves, with dotted keys.
fn flatten(table: &Table) -> Vec<(String, Value)> {
    let entries = table.iter().flat_map(|(key, value)| match value {
        Value::Table(inner) => flatten(inner).into_iter().map(|(rest, value)| (dotted(key, &rest), value)).collect(),
        value => vec![(key.clone(), value.clone())],
    });
    entries.collect()
}

/// The candidate that was probably meant. Whoever forgets the table means the key.
fn nearest<'a>(key: &str, candidates: impl Iterator<Item = &'a str>) -> &'a str {
    let distance = |candidate: &str| {
        let last = candidate.rsplit('.').next().unwrap_or(candidate);
        strsim::damerau_levenshtein(key, candidate).min(strsim::damerau_levenshtein(key, last))
    };
    candidates.min_by_key(|candidate| distance(candidate)).unwrap_or_default()
}

/// The names of all methods, in a sentence.
fn methods() -> String {
    let names = Method::ALL.map(|method| Value::try_from(method).expect("a method is a name"));
    let names: Vec<&str> = names.iter().filter_map(Value::as_str).collect();
    format!(" One of {}.", names.join(", "))
}

fn comment(docs: &str) -> String {
    docs.lines().map(|line| format!("# {}\n", line.trim())).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::{Auto, Start};

    /// What reading a file with the given text says.
    fn read(text: &str) -> Result<Config> {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.toml");
        std::fs::write(&path, text).unwrap();
        Config::read(&path, Method::TrGs)
    }

    #[test]
    fn what_is_written_is_read_back() {
        let mut config = Config::default();
        for setting in ["method=fdk", "cutoff=1e-7", "model.points=123", "optimiser.nu=[0, 0.125]", "seed=9"] {
            config.set(setting).unwrap();
        }
        assert_eq!(read(&config.to_toml()).unwrap(), config);
        assert_eq!(read("").unwrap(), Config::default());
        let text = config.to_toml();
        let line = text.lines().find(|line| line.starts_with("# Reconstruction method.")).unwrap();
        assert!(
            line.ends_with(
                "One of tr-gs, r2-gaussian, fdk, sart, os-sart, asd-pocs, cgls, tv, naf, sax-nerf, intratomo."
            )
        );
    }

    #[test]
    fn a_file_without_a_method_has_the_defaults_of_the_one_that_is_asked_for() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.toml");
        std::fs::write(&path, "seed = 4").unwrap();
        let r2 = Config { seed: 4, ..Config::of(Method::R2Gaussian) };
        assert_eq!(Config::read(&path, Method::R2Gaussian).unwrap(), r2);
        std::fs::write(&path, "seed = 4\nmethod = \"r2-gaussian\"").unwrap();
        assert_eq!(Config::read(&path, Method::TrGs).unwrap(), r2);
        assert_eq!(Config::from_toml(&r2.to_toml()).unwrap(), r2);
    }

    #[test]
    fn the_first_difference_is_named_with_both_values() {
        let (a, mut b) = (Config::default(), Config::default());
        assert_eq!(a.difference(&b), None);
        b.loss.d_ssim = 0.5;
        b.wavelet.levels = 2;
        assert_eq!(a.difference(&b), Some(("loss.d_ssim".into(), "0.25".into(), "0.5".into())));
    }

    #[test]
    fn every_key_and_table_is_written_below_its_documentation() {
        let text = Config::default().to_toml();
        let lines: Vec<&str> = text.lines().collect();
        for (key, value) in Config::default().entries() {
            let line = format!("{} = {value}", key.rsplit('.').next().unwrap());
            let at = lines.iter().position(|l| *l == line).unwrap_or_else(|| panic!("{line} is missing: TABLES?"));
            assert!(lines[at - 1].starts_with("# ") && lines[at - 1].len() > 10, "{line} has no documentation");
        }
        for (i, line) in lines.iter().enumerate().filter(|(_, line)| line.starts_with('[')) {
            assert!(lines[i - 1].starts_with("# "), "{line} has no documentation");
        }
    }

    #[test]
    fn values_are_toml_and_strings_may_go_without_quotes() {
        let mut config = Config::default();
        for setting in ["initialisation.from = random", "method=\"fdk\"", "loss.tv=0", "optimiser.mean=[1e-3, 0.0]"] {
            config.set(setting).unwrap();
        }
        assert_eq!((config.initialisation.from, config.method), (Start::Random, Method::Fdk));
        assert_eq!((config.loss.tv, config.optimiser.mean), (Auto::Fixed(0.0), [1e-3, 0.0]));
    }

    #[test]
    fn an_unknown_key_names_the_nearest() {
        for (key, meant) in [
            ("loss.d_sim", "loss.d_ssim"),
            ("iteration", "iterations"),
            ("points", "model.points"),
            ("model.nu_maximum", "model.nu_max"),
        ] {
            let set = Config::default().set(&format!("{key}=1")).unwrap_err().to_string();
            let file = read(&format!("{key} = 1")).unwrap_err().to_string();
            for message in [set, file] {
                assert!(message.contains(key) && message.contains(&format!("did you mean {meant}?")), "{message}");
            }
        }
    }

    #[test]
    fn values_of_a_wrong_type_are_refused_with_an_example() {
        for setting in ["iterations=many", "iterations=1.5", "optimiser.nu=0.1", "method=fbp", "loss.tv=[1]", "model=1"]
        {
            let mut config = Config::default();
            let message = config.set(setting).unwrap_err().to_string();
            assert!(message.contains(setting.split('=').next().unwrap()) && !message.contains('\n'), "{message}");
            assert_eq!(config, Config::default());
        }
        let message = Config::default().set("method=fbp").unwrap_err().to_string();
        assert!(message.contains("tr-gs") && message.contains("fdk"), "{message}");
    }

    #[test]
    fn a_file_that_is_no_toml_is_refused_with_its_line() {
        let message = read("seed = 1\n\niterations = = 3\n").unwrap_err().to_string();
        assert!(message.contains("a.toml: line 3") && !message.contains('\n'), "{message}");
        assert!(Config::default().set("iterations").is_err());
    }
}
