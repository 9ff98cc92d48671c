//! Sizes on the command line.

use super::workload::MAX_GAUSSIANS;

/// A synthetic frame on the command line: "1140000@1280x720".
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct FrameSize {
    pub gaussians: u32,
    pub width: u32,
    pub height: u32,
}

impl FrameSize {
    /// More Gaussians than one binding of 128 MiB holds.
    pub const LARGE: Self = Self { gaussians: 1_140_000, width: 1280, height: 720 };
}

impl std::fmt::Display for FrameSize {
    fn fmt(&self, f: &mut std::fmt::Formatter) -> std::fmt::Result {
        write!(f, "{}@{}x{}", self.gaussians, self.width, self.height)
    }
}

impl std::str::FromStr for FrameSize {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let parsed = text
            .split_once('@')
            .and_then(|(gaussians, size)| Some((gaussians.parse().ok()?, parse_size(size).ok()?)));
        match parsed {
            Some((gaussians, _)) if i64::from(gaussians) > MAX_GAUSSIANS => {
                Err(format!("{gaussians} Gaussians are more than {MAX_GAUSSIANS}"))
            }
            Some((gaussians @ 1.., (width, height))) => Ok(Self { gaussians, width, height }),
            _ => Err("give Gaussians and size, as in 1140000@1280x720".to_owned()),
        }
    }
}

/// The size of a picture on the command line: "1280x720".
pub fn parse_size(text: &str) -> Result<(u32, u32), String> {
    let parsed = text.split_once('x').and_then(|(w, h)| Some((w.parse().ok()?, h.parse().ok()?)));
    match parsed {
        Some(size @ (1.., 1..)) => Ok(size),
        _ => Err("give width and height, as in 1280x720".to_owned()),
    }
}
