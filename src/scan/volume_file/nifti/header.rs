//! The headers of NIfTI-1 (348 bytes) and NIfTI-2 (540 bytes).
//!
//! Only the fields that bear on numbers and positions are read.

/// The fields of either version.
#[derive(Debug, PartialEq)]
pub(super) struct Header {
    pub(super) is_second: bool,
    pub(super) big_endian: bool,
    /// Whether the numbers follow in the same file.
    pub(super) is_single: bool,
    /// The number of axes, then their lengths.
    pub(super) dim: [i64; 8],
    pub(super) datatype: i64,
    pub(super) intent: i64,
    /// The handedness of the quaternion, then the spacing.
    pub(super) pixdim: [f64; 8],
    pub(super) vox_offset: f64,
    pub(super) slope: f64,
    pub(super) intercept: f64,
    pub(super) units: i64,
    pub(super) qform_code: i64,
    pub(super) sform_code: i64,
    pub(super) quaternion: [f64; 3],
    pub(super) q_offset: [f64; 3],
    pub(super) srow: [[f64; 4]; 3],
}

/// Bytes of the header of each version, extension flag included: the smallest position of the numbers.
pub(super) const SMALLEST_OFFSET: [usize; 2] = [352, 544];

/// Numbers of a header.
struct Bytes<'a> {
    content: &'a [u8],
    big_endian: bool,
}

impl Bytes<'_> {
    fn chunk<const N: usize>(&self, at: usize) -> [u8; N] {
        let mut bytes: [u8; N] = self.content[at..at + N].try_into().expect("the length was checked");
        if self.big_endian {
            bytes.reverse();
        }
        bytes
    }

    fn short(&self, at: usize) -> i64 {
        i16::from_le_bytes(self.chunk(at)).into()
    }

    fn int(&self, at: usize) -> i64 {
        i32::from_le_bytes(self.chunk(at)).into()
    }

    fn long(&self, at: usize) -> i64 {
        i64::from_le_bytes(self.chunk(at))
    }

    fn singles<const N: usize>(&self, at: usize) -> [f64; N] {
        std::array::from_fn(|i| f32::from_le_bytes(self.chunk(at + 4 * i)).into())
    }

    fn doubles<const N: usize>(&self, at: usize) -> [f64; N] {
        std::array::from_fn(|i| f64::from_le_bytes(self.chunk(at + 8 * i)))
    }
}

impl Header {
    /// Parses the beginning of a file, or returns what it begins with instead.
    pub(super) fn parse(content: &[u8]) -> Result<Self, String> {
        let size = content.get(..4).map(|bytes| [bytes[0], bytes[1], bytes[2], bytes[3]]);
        let size = size.ok_or_else(|| format!("{} bytes", content.len()))?;
        let (is_second, big_endian) = match (i32::from_le_bytes(size), i32::from_be_bytes(size)) {
            (348, _) => (false, false),
            (_, 348) => (false, true),
            (540, _) => (true, false),
            (_, 540) => (true, true),
            (little, _) => return Err(format!("a header of {little} bytes instead of 348 or 540")),
        };
        let needed = if is_second { 540 } else { 348 };
        if content.len() < needed {
            return Err(format!("{} bytes of a header of {needed}", content.len()));
        }
        let bytes = Bytes { content, big_endian };
        Ok(if is_second { Self::second(&bytes) } else { Self::first(&bytes) })
    }

    fn first(bytes: &Bytes<'_>) -> Self {
        let [vox_offset, slope, intercept] = bytes.singles(108);
        Self {
            is_second: false,
            big_endian: bytes.big_endian,
            is_single: &bytes.content[344..347] == b"n+1",
            dim: std::array::from_fn(|i| bytes.short(40 + 2 * i)),
            datatype: bytes.short(70),
            intent: bytes.short(68),
            pixdim: bytes.singles(76),
            vox_offset,
            slope,
            intercept,
            units: bytes.content[123].into(),
            qform_code: bytes.short(252),
            sform_code: bytes.short(254),
            quaternion: bytes.singles(256),
            q_offset: bytes.singles(268),
            srow: [280, 296, 312].map(|at| bytes.singles(at)),
        }
    }

    fn second(bytes: &Bytes<'_>) -> Self {
        let [slope, intercept] = bytes.doubles(176);
        Self {
            is_second: true,
            big_endian: bytes.big_endian,
            is_single: &bytes.content[4..7] == b"n+2",
            dim: std::array::from_fn(|i| bytes.long(16 + 8 * i)),
            datatype: bytes.short(12),
            intent: bytes.int(504),
            pixdim: bytes.doubles(104),
            vox_offset: bytes.long(168) as f64,
            slope,
            intercept,
            units: bytes.int(500),
            qform_code: bytes.int(344),
            sform_code: bytes.int(348),
            quaternion: bytes.doubles(352),
            q_offset: bytes.doubles(376),
            srow: [400, 432, 464].map(|at| bytes.doubles(at)),
        }
    }
}
