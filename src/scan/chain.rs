//! The measuring chain of a real scanner, for simulated scans: an intensity is not the exponential of a line integral.
//!
//! In this order, each part with a number of [`Chain`], and each absent where the number is 0:
//!
//! ```text
//! q, b     line integrals of the object and of its dense part at 60 keV, from source and detector off their stated place
//! T        Σ_k w_k exp(-(μ_w(E_k)/μ_w(60) (q - b) + μ_b(E_k)/μ_b(60) b))     polychromatic transmission
//! I        G_blur ⊛ (T + scatter · G_spread ⊛ (-T ln T))                      scatter, blur of the detector
//! N        (1 + flat·normal(pixel)) Poisson(I0 I) + sigma·normal              photons, error of the flat field, electronics
//! p        -ln(round(N)/I0)                                                   digits of the reading, measured flat field I0
//! ```
//!
//! The source of scatter is the intensity times the line integral, as in `[Ohnesorge99]`: there is none without an object.
//! The photons of a pixel are independent of each other: blur acts on their mean. Readings brighter than the flat field
//! stay negative line integrals. Not in the paper, which adds photons and electronic noise to monochromatic views.
//!
//! The two materials are water and cortical bone, which replaces it from a density on; their mass attenuation
//! coefficients are those of `[NIST]`. The shares w_k of the photons are ours, in the shape of a filtered 120 kV tube.
//!
//! `[NIST]`: J. H. Hubbell, S. M. Seltzer, *Tables of X-Ray Mass Attenuation Coefficients*, NISTIR 5632, table 4.
//! `[Ohnesorge99]`: B. Ohnesorge, T. Flohr, K. Klingenbeck-Regn, *Efficient object scatter correction algorithm for third
//! and fourth generation CT scanners*, Eur. Radiol. 9 (1999) 563.

#[cfg(test)]
mod tests;

use crate::noise::{Attenuation, FLOOR, Noise};
use ndarray::Array3;
use rand_distr::{Distribution, Poisson, StandardNormal};
use std::fmt;
use std::str::FromStr;
use trgs_core::error::{Error, Result};
use trgs_core::geometry::{Detector, Projections, Scanner, Volume};
use trgs_core::numeric::elementary::{exp, exp2, log};
use trgs_core::numeric::rng::{Purpose, stream};
use trgs_core::numeric::threads;

/// Photons of one energy: their share, and the mass attenuation coefficients of water and cortical bone, cm²/g.
struct Bin {
    share: f64,
    water: f64,
    bone: f64,
}

/// 40, 50, 60, 80 and 100 keV.
const SPECTRUM: [Bin; 5] = [
    Bin { share: 0.20, water: 0.2683, bone: 0.6655 },
    Bin { share: 0.25, water: 0.2269, bone: 0.4242 },
    EFFECTIVE,
    Bin { share: 0.20, water: 0.1837, bone: 0.2229 },
    Bin { share: 0.10, water: 0.1707, bone: 0.1855 },
];
/// 60 keV: the energy of the true volume.
const EFFECTIVE: Bin = Bin { share: 0.25, water: 0.2059, bone: 0.3148 };
/// Largest reading, as a multiple of the flat field.
const FULL_SCALE: f64 = 1.25;
/// Radius of a kernel, standard deviations.
const RADIUS: f64 = 4.0;

/// The numbers of a measuring chain; 0 leaves a part out. What each means is in [`PARTS`].
#[derive(Clone, Copy, Debug, PartialEq)]
#[expect(missing_docs, reason = "PARTS documents them")]
pub struct Chain {
    pub depth: f64,
    pub spectrum: f64,
    pub bone: f64,
    pub scatter: f64,
    pub spread: f64,
    pub blur: f64,
    pub flat: f64,
    pub bits: f64,
    pub axis: f64,
}

/// A number of a chain.
pub struct Part {
    /// Its name.
    pub name: &'static str,
    /// A sentence.
    pub docs: &'static str,
    most: f64,
    of: fn(&mut Chain) -> &mut f64,
}

/// All numbers of a chain, in the order of their effect.
pub const PARTS: [Part; 9] = {
    const fn part(name: &'static str, docs: &'static str, most: f64, of: fn(&mut Chain) -> &mut f64) -> Part {
        Part { name, docs, most, of }
    }
    [
        part("axis", "shift of source and detector that the files do not state, pixels", 100.0, |c| &mut c.axis),
        part("depth", "largest line integral, which attenuation is scaled to; 0: as it is", 20.0, |c| &mut c.depth),
        part("spectrum", "share of the photons that are not of 60 keV, the energy of the volume", 1.0, |c| {
            &mut c.spectrum
        }),
        part("bone", "density from which a voxel is bone-like, as a fraction of the largest", 1.0, |c| &mut c.bone),
        part("scatter", "scattered part of (intensity × line integral)", 1.0, |c| &mut c.scatter),
        part("spread", "standard deviation of the kernel of scatter, widths of the detector", 1.0, |c| &mut c.spread),
        part("blur", "standard deviation of the point spread of the detector, pixels", 100.0, |c| &mut c.blur),
        part("flat", "standard deviation of the flat field's error, the same in all views", 0.5, |c| &mut c.flat),
        part("bits", "digits of a reading: 1.25 times the flat field has 2^bits steps", 32.0, |c| &mut c.bits),
    ]
};

impl Default for Chain {
    fn default() -> Self {
        let (depth, spectrum, bone) = (4.0, 1.0, 0.5);
        Self { depth, spectrum, bone, scatter: 0.1, spread: 0.2, blur: 0.7, flat: 0.005, bits: 14.0, axis: 0.3 }
    }
}

impl Chain {
    /// The shift of source and detector along u that moves the axis in the image by [`Self::axis`] pixels, scene units.
    pub(super) fn axis_shift(&self, scanner: &Scanner) -> f64 {
        self.axis * scanner.detector.pitch_u / scanner.beam.magnification()
    }

    /// The bone-like part of a volume; `None` if it is attenuated as water is.
    pub(super) fn dense_part(&self, volume: &Volume) -> Option<Volume> {
        let least = self.bone as f32 * volume.values.iter().fold(0.0, |most: f32, &density| most.max(density));
        let dense = |&density: &f32| if density >= least && density > 0.0 { density } else { 0.0 };
        (self.spectrum > 0.0).then(|| Volume { values: volume.values.map(dense), ..*volume })
    }

    /// What a detector states for ideal line integrals: of the object, and of its bone-like part.
    ///
    /// The random numbers of a pixel depend only on `seed`, its view and its position.
    ///
    /// # Errors
    /// For noise with another law of attenuation, or more than 10¹⁸ photons in a pixel.
    ///
    /// Tests: each part alone, against a formula.
    pub fn measure(
        &self,
        detector: &Detector,
        object: &Projections,
        dense: Option<&Projections>,
        noise: Noise,
        seed: u64,
    ) -> Result<Array3<f32>> {
        let counter = Counter::new(self, detector, noise, seed)?;
        let peak = object.images.iter().fold(0.0, |peak: f64, &p| peak.max(p.into()));
        let scale = if self.depth > 0.0 && peak > 0.0 { self.depth / peak } else { 1.0 };
        let mut images = object.images.clone();
        let pixels = detector.pixels();
        let results = images.as_slice_mut().expect("projections are stored in C order");
        threads::for_each_chunk(results, pixels, |view, image| {
            let dense = dense.map(|dense| dense.image(view));
            let dense = dense.iter().flatten().copied().chain(std::iter::repeat(0.0));
            let primary: Vec<f64> = image
                .iter()
                .zip(dense)
                .map(|(&p, dense)| {
                    // Voxels may state more of a dense part than there is of a phantom.
                    let [p, dense] = [p, dense.min(p)].map(|p| scale * f64::from(p));
                    transmission(self.spectrum, p - dense, dense)
                })
                .collect();
            let intensities = self.on_detector(detector, primary);
            for (pixel, (p, intensity)) in image.iter_mut().zip(intensities).enumerate() {
                *p = (counter.line_integral(view, pixel, intensity) / scale) as f32;
            }
        });
        Ok(images)
    }

    /// Scatter and blur.
    fn on_detector(&self, detector: &Detector, mut intensities: Vec<f64>) -> Vec<f64> {
        let shape = [detector.rows, detector.columns];
        if self.scatter > 0.0 {
            let width = self.spread * detector.columns as f64;
            let source = intensities.iter().map(|&t| if t < 1.0 && t > 0.0 { -t * log(t) } else { 0.0 }).collect();
            let scattered = blurred(source, shape, [width * detector.pitch_u / detector.pitch_v, width]);
            intensities.iter_mut().zip(scattered).for_each(|(all, scattered)| *all += self.scatter * scattered);
        }
        blurred(intensities, shape, [self.blur; 2])
    }
}

/// The part of the photons that passes line integrals of water and of bone at 60 keV; `share` of them have the spectrum.
fn transmission(share: f64, water: f64, bone: f64) -> f64 {
    let at = |bin: &Bin| exp(-(bin.water / EFFECTIVE.water * water + bin.bone / EFFECTIVE.bone * bone));
    let spectral = if share > 0.0 { SPECTRUM.iter().map(|bin| bin.share * at(bin)).sum() } else { 0.0 };
    (1.0 - share) * at(&EFFECTIVE) + share * spectral
}

/// An image `[v, u]` after convolution with a Gaussian; it goes on beyond its borders as its mirror image, so its sum stays.
fn blurred(mut image: Vec<f64>, [rows, columns]: [usize; 2], sigmas: [f64; 2]) -> Vec<f64> {
    for (length, stride, sigma) in [(rows, columns, sigmas[0]), (columns, 1, sigmas[1])] {
        if sigma == 0.0 {
            continue;
        }
        let kernel: Vec<f64> = (0..=(RADIUS * sigma).ceil() as usize)
            .map(|i| exp(-0.5 * (i as f64 / sigma) * (i as f64 / sigma)))
            .collect();
        let total = 2.0 * kernel[1..].iter().sum::<f64>() + kernel[0];
        // Reflected about the borders of the outermost pixels.
        let period = 2 * length;
        let at = |i: usize| if i % period < length { i % period } else { period - 1 - i % period };
        let mut line = vec![0.0; length];
        for first in (0..rows * columns).filter(|i| i / stride % length == 0) {
            line.iter_mut().enumerate().for_each(|(i, value)| *value = image[first + i * stride]);
            for i in 0..length {
                let far = kernel.len() / period * period + period + i;
                let sides = (1..kernel.len()).map(|k| kernel[k] * (line[at(i + k)] + line[at(far - k)]));
                image[first + i * stride] = (kernel[0] * line[i] + sides.sum::<f64>()) / total;
            }
        }
    }
    image
}

/// The part of a detector that counts photons.
struct Counter {
    /// Of the flat field; 1 without noise.
    photons: f64,
    /// Standard deviation of the electronic noise, counts; `None` without noise.
    sigma: Option<f64>,
    /// Gain of each pixel relative to the one of the flat field.
    gains: Vec<f64>,
    /// Counts in a step of the reading; 0: none.
    step: f64,
    seed: u64,
}

impl Counter {
    fn new(chain: &Chain, detector: &Detector, noise: Noise, seed: u64) -> Result<Self> {
        let (photons, sigma) = match noise {
            Noise::None => (1.0, None),
            Noise::Counts { photons, sigma, attenuation: Attenuation::Relative } => (photons, Some(sigma)),
            Noise::Counts { attenuation: Attenuation::Physical, .. } => {
                let expected = "photons and electronic noise: `depth` says how a measuring chain attenuates them";
                return Err(Error::invalid(
                    "noise",
                    noise,
                    expected,
                    "omit `,physical`; depth=0 is the law with line integrals as they are",
                ));
            }
        };
        if photons > 1e17 {
            return Err(Error::invalid("noise", format!("{photons} photons"), "at most 1e17", "give fewer photons"));
        }
        let gain = |pixel: usize| {
            let normal: f64 = StandardNormal.sample(&mut stream(seed, Purpose::FlatField, 0, pixel as u64));
            (1.0 + chain.flat * normal).max(0.0)
        };
        let step = if chain.bits > 0.0 { FULL_SCALE * photons / exp2(chain.bits) } else { 0.0 };
        Ok(Self { photons, sigma, gains: (0..detector.pixels()).map(gain).collect(), step, seed })
    }

    /// The line integral that a pixel states.
    fn line_integral(&self, view: usize, pixel: usize, intensity: f64) -> f64 {
        let expected = self.photons * intensity;
        let counts = match self.sigma {
            None => self.gains[pixel] * expected,
            Some(sigma) => {
                let mut draws = stream(self.seed, Purpose::Noise, view as u64, pixel as u64);
                // Intensities are at most a little above 1, as photons were checked.
                let model = Poisson::new(expected.clamp(f64::MIN_POSITIVE, 1e18)).expect("a mean in its range");
                let photons: f64 = model.sample(&mut draws);
                let normal: f64 = StandardNormal.sample(&mut draws);
                self.gains[pixel] * photons + sigma * normal
            }
        };
        let reading = if self.step > 0.0 { self.digital(counts) } else { counts };
        let least = if self.sigma.is_some() { FLOOR } else { f64::MIN_POSITIVE };
        -log(reading.max(least).max(self.step / 2.0) / self.photons)
    }

    /// The nearest step of the reading.
    fn digital(&self, counts: f64) -> f64 {
        (counts / self.step).round().min(FULL_SCALE * self.photons / self.step) * self.step
    }
}

impl fmt::Display for Chain {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let mut values = *self;
        let parts = PARTS.map(|part| format!("{}={}", part.name, (part.of)(&mut values)));
        f.write_str(&parts.join(","))
    }
}

impl FromStr for Chain {
    type Err = Error;

    /// Parses `part=value,part=value`; other parts have their defaults.
    fn from_str(text: &str) -> Result<Self> {
        let mut chain = Self::default();
        for assignment in text.split(',').filter(|assignment| !assignment.trim().is_empty()) {
            let (name, value) = assignment.split_once('=').unwrap_or((assignment, ""));
            let names = || PARTS.map(|part| part.name).join(", ");
            let Some(part) = PARTS.iter().find(|part| part.name == name.trim()) else {
                let remedy = "give for example scatter=0.1,blur=0";
                return Err(Error::invalid("part of the measuring chain", name, names(), remedy));
            };
            let is_whole = part.name == "bits";
            let number = value.trim().parse().ok().filter(|number: &f64| (0.0..=part.most).contains(number));
            let Some(number) = number.filter(|number| !is_whole || number.fract() == 0.0) else {
                let kind = if is_whole { "a whole number" } else { "a number" };
                let (expected, usual) =
                    (format!("{kind} from 0 to {}: {}", part.most, part.docs), Self::default().to_string());
                let usual = usual.split(',').find(|usual| usual.starts_with(part.name)).expect("all parts are shown");
                return Err(Error::invalid(part.name, value, expected, format!("give {usual}, for example")));
            };
            *(part.of)(&mut chain) = number;
        }
        Ok(chain)
    }
}
