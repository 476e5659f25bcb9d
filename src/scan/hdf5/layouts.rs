//! Scans in HDF5: frames, fields and angles in one file.
//!
//! | layout | frames | flat and dark fields | angles |
//! |---|---|---|---|
//! | Data Exchange | `/exchange/data` | `data_white`, `data_dark` beside it | `theta` beside it |
//! | NXtomo (NeXus) | `data` beside an `image_key`, where the key is 0 | keys 1 and 2 | any `rotation_angle` |
//!
//! Angles without a unit are degrees, as both layouts say; a remark has the arc, and that of radians where it is possible. Frames with other keys are left out. Nothing else is read:
//! the arrays that are not are named in a remark.

use super::{Entry, Hdf5, list, shorter};
use crate::plausibility::{self, AnglesFrom};
use crate::stack::ScanFile;
use ndarray::{Array3, Axis};
use trgs_core::error::{Error, Result};
use trgs_core::setting::{Setting, Text};
use trgs_core::words::{counted, verb};

const DATA_EXCHANGE: &str = "/exchange/data";
const NX_TOMO_KEY: &str = "/image_key";
const NX_TOMO_ANGLES: &str = "/rotation_angle";
/// Values of the image key.
const VIEW: f64 = 0.0;
const FLAT: f64 = 1.0;
const DARK: f64 = 2.0;

impl Hdf5 {
    /// The scan of a file in one of the layouts; none for other files.
    ///
    /// # Errors
    /// [`Error::Format`] for the first array that does not fit.
    pub fn scan(&self) -> Result<Option<ScanFile>> {
        let named = |name: &str| self.entries.iter().find(|entry| entry.name == name);
        if let Some(frames) = named(DATA_EXCHANGE).filter(|entry| entry.shape.len() == 3) {
            let beside = |name: &str| named(&format!("/exchange/{name}"));
            return self.data_exchange(frames, [beside("data_white"), beside("data_dark")], beside("theta")).map(Some);
        }
        // Links may lead to the same arrays under several names.
        let keys = self.entries.iter().filter_map(|key| Some((key, key.name.strip_suffix(NX_TOMO_KEY)?)));
        let frames = keys.filter_map(|(key, group)| Some((key, named(&format!("{group}/data"))?)));
        match frames.min_by_key(|(key, _)| key.name.len()) {
            Some((key, frames)) => self.nx_tomo(frames, key).map(Some),
            None => Ok(None),
        }
    }

    fn data_exchange(&self, frames: &Entry, fields: [Option<&Entry>; 2], angles: Option<&Entry>) -> Result<ScanFile> {
        let [flat, dark] = fields.map(|field| field.map(|field| self.slices(field)).transpose());
        let mut scan = ScanFile { frames: self.slices(frames)?, flat: flat?, dark: dark?, ..ScanFile::default() };
        self.read_angles(angles, None, &mut scan)?;
        let read: Vec<&Entry> = [Some(frames), fields[0], fields[1], angles].into_iter().flatten().collect();
        self.remark("Data Exchange", &read, &mut scan);
        Ok(scan)
    }

    fn nx_tomo(&self, frames: &Entry, key: &Entry) -> Result<ScanFile> {
        let all = self.slices(frames)?;
        let keys: Vec<f64> = self.numbers(key)?.into_f64().into_iter().collect();
        if keys.len() != all.dim().0 {
            let expected = format!("one for each of {}", counted(all.dim().0, "frame"));
            let remedy = "write the image key again: 0 view, 1 flat field, 2 dark field, 3 no image";
            return Err(Error::format(&self.path, shorter(&key.name), counted(keys.len(), "key"), expected, remedy));
        }
        let with = |wanted: f64| -> Vec<usize> { (0..keys.len()).filter(|&i| keys[i] == wanted).collect() };
        let some = |frames: Vec<usize>| (!frames.is_empty()).then(|| all.select(Axis(0), &frames));
        let views = with(VIEW);
        let mut scan = ScanFile {
            frames: all.select(Axis(0), &views),
            flat: some(with(FLAT)),
            dark: some(with(DARK)),
            ..ScanFile::default()
        };
        let others = keys.iter().filter(|key| ![VIEW, FLAT, DARK].contains(key)).count();
        if others > 0 {
            let (frames, are) = (counted(others, "frame"), verb(others, "is", "are"));
            scan.remarks.push(format!("{frames} {are} left out: the image key is not 0, 1 or 2").into());
        }
        let angles = self.entries.iter().filter(|entry| entry.name.ends_with(NX_TOMO_ANGLES) && entry.shape.len() == 1);
        let angles = angles.min_by_key(|entry| entry.name.len());
        self.read_angles(angles, Some((&views, keys.len())), &mut scan)?;
        let read: Vec<&Entry> = [Some(frames), Some(key), angles].into_iter().flatten().collect();
        self.remark("NXtomo", &read, &mut scan);
        Ok(scan)
    }

    /// Angles in radians; of the `views` alone where there is one for each of so many frames.
    fn read_angles(&self, entry: Option<&Entry>, views: Option<(&[usize], usize)>, scan: &mut ScanFile) -> Result<()> {
        let Some(entry) = entry else { return Ok(()) };
        let unit = Self::text(entry, "units").or_else(|| Self::text(entry, "unit"));
        let to_radians = match unit.as_deref().map(str::trim).map(str::to_lowercase) {
            None => {
                scan.is_unit_assumed = true;
                f64::to_radians
            }
            Some(unit) if unit.starts_with("deg") || unit == "°" => f64::to_radians,
            Some(unit) if unit.starts_with("rad") => |angle| angle,
            Some(unit) => {
                let remedy = "correct the attribute units of the array, or give the angles in a file of their own";
                let what = format!("unit of {}", shorter(&entry.name));
                return Err(Error::format(&self.path, what, shorter(&unit), "degree or rad", remedy));
            }
        };
        let stated: Vec<f64> = self.numbers(entry)?.into_f64().into_iter().collect();
        let finite = || stated.iter().copied().filter(|angle| angle.is_finite());
        if let (true, Some(low), Some(high)) =
            (scan.is_unit_assumed, finite().reduce(f64::min), finite().reduce(f64::max))
        {
            let (angles, span) = (shorter(&entry.name), high - low);
            let mut remark = Text::from(format!("{angles} states no unit: degrees are read, which span {span:.1}°"));
            if plausibility::check_radians(&stated, AnglesFrom::Stack).is_ok() {
                remark = remark + format!("; as radians they span {:.1}°: give ", span.to_degrees());
                remark = remark + Setting::Radians + " if they are";
            }
            scan.remarks.push(remark);
        }
        let mut angles: Vec<f64> = stated.into_iter().map(to_radians).collect();
        if let Some((views, all)) = views
            && angles.len() == all
        {
            angles = views.iter().map(|&view| angles[view]).collect();
        }
        scan.angles = Some(angles);
        Ok(())
    }

    /// What was read, and what was not.
    fn remark(&self, layout: &str, read: &[&Entry], scan: &mut ScanFile) {
        let count = |frames: &Option<Array3<f32>>| frames.as_ref().map_or(0, |frames| frames.dim().0);
        let angles = scan.angles.as_ref().map_or("no angles".to_owned(), |angles| counted(angles.len(), "angle"));
        let (views, flats, darks) = (scan.frames.dim().0, count(&scan.flat), count(&scan.dark));
        let (views, flats) = (counted(views, "view"), counted(flats, "frame"));
        let found = format!("{layout}: {views}, {flats} of flat field, {darks} of dark field, {angles}");
        scan.remarks.push(found.into());
        let others: Vec<&Entry> =
            self.distinct().into_iter().filter(|entry| !read.iter().any(|read| read.is_same(entry))).collect();
        if !others.is_empty() {
            scan.remarks.push(format!("arrays that are not read: {}", list(&others)).into());
        }
        scan.remarks.extend(self.limit().map(Text::from));
    }
}
