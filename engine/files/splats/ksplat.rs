//! Reads `.ksplat` files, compression levels 0, 1 and 2: a header, a header for each section, then the sections. A section
//! has the lengths of its last buckets, the centres of all buckets, and rows. At levels 1 and 2 positions are relative to
//! the centre of their bucket.
//!
//! Format: github.com/mkkellogg/GaussianSplats3D, `src/loaders/SplatBuffer.js`.

use std::fs::File;
use std::io::{BufReader, Read, Take};
use std::path::Path;

use super::dot_splat::opacity_logit;
use super::{Blocks, Format, Header, Opened, Sink};
use crate::cost;
use crate::regular_file::{self, OnFile, damaged, u32_at};
use ashsplat::scene::Gaussians;
use ashsplat::scene::gaussians::sh_coefficients;
use ashsplat::scene::sh::rgb_to_sh_dc;
use ashsplat::{Error, Result};
use half::f16;

const HEADER_BYTES: u64 = 4096;
const SECTION_HEADER_BYTES: u64 = 1024;
const CENTER_BYTES: u64 = 12;
/// The stored position that means the centre of a bucket, where a section names none.
const MIDDLE: u32 = 32_767;
/// Largest SH value of level 2, where the header names none.
const MAX_SH: f32 = 1.5;

/// How the numbers of a row are stored.
#[derive(Clone, Copy)]
struct Packing {
    /// 0: all in single precision. 1: in half precision. 2: higher SH as bytes.
    level: usize,
    /// SH values of the bytes 0 and 255.
    sh_range: [f32; 2],
}

struct Section {
    count: u64,
    sh_degree: u32,
    /// Gaussians in each of the full buckets, which come first.
    bucket_rows: u64,
    full_buckets: u64,
    /// Places of the bytes in the file: the lengths of the other buckets, the centres, the rows.
    lengths_at: u64,
    centers_at: u64,
    rows_at: u64,
    middle: f32,
    /// Size of a step of the stored positions.
    step: f32,
}

impl Packing {
    fn row_bytes(self, sh_degree: u32) -> u64 {
        let [number, sh] = [[4, 4], [2, 2], [2, 1]][self.level];
        10 * number + 4 + sh * 3 * (sh_coefficients(sh_degree) as u64 - 1)
    }

    /// Appends the Gaussian of a row. `center` is that of its bucket.
    fn unpack(self, row: &[u8], section: &Section, center: [f32; 3], block: &mut Gaussians) {
        let short = |index: usize| u16::from_le_bytes([row[2 * index], row[2 * index + 1]]);
        let number = |index: usize| match self.level {
            0 => f32::from_bits(u32_at(row, 4 * index)),
            _ => f16::from_bits(short(index)).to_f32(),
        };
        block.means.push(std::array::from_fn(|axis| match self.level {
            0 => number(axis),
            _ => (f32::from(short(axis)) - section.middle) * section.step + center[axis],
        }));
        // The logarithm of a negative size is NaN, which is unusable.
        block.log_scales.push([3, 4, 5].map(|index| libm::logf(number(index))));
        block.quats.push([6, 7, 8, 9].map(number));
        let (color, higher) = row[if self.level == 0 { 40 } else { 20 }..].split_at(4);
        block.sh.push([0, 1, 2].map(|channel| rgb_to_sh_dc(f32::from(color[channel]) / 255.0)));
        block.opacity_logits.push(opacity_logit(color[3]));
        let [low, high] = self.sh_range;
        let sh = |index: usize| match self.level {
            0 => f32::from_bits(u32_at(higher, 4 * index)),
            1 => f16::from_le_bytes([higher[2 * index], higher[2 * index + 1]]).to_f32(),
            _ => low + f32::from(higher[index]) / 255.0 * (high - low),
        };
        // Each degree has the values of red, then green, then blue.
        for degree in 1..=section.sh_degree as usize {
            let (first, width) = (3 * (degree * degree - 1), 2 * degree + 1);
            block.sh.extend((0..width).map(|k| [0, 1, 2].map(|channel| sh(first + channel * width + k))));
        }
    }
}

pub(super) fn open(path: &Path) -> Result<Opened<'_>> {
    let (file, bytes) = regular_file::open(path)?;
    let mut reader = BufReader::new(file);
    let mut head = [0; HEADER_BYTES as usize];
    if bytes < HEADER_BYTES {
        return Err(damaged(path, format!("ends after {bytes} of the header's {HEADER_BYTES} bytes")));
    }
    reader.read_exact(&mut head).reading(path)?;
    let (major, minor) = (head[0], head[1]);
    let level = usize::from(u16::from_le_bytes([head[20], head[21]]));
    if major != 0 || minor == 0 || level > 2 {
        let problem =
            format!("is .ksplat version {major}.{minor}, level {level}; 0.1 with levels 0, 1, 2 is known");
        return Err(Error::input(path, problem, "write it again with GaussianSplats3D 0.4"));
    }
    let named = |at: usize, usual: f32| match f32::from_bits(u32_at(&head, at)) {
        0.0 => usual,
        value => value,
    };
    let packing = Packing { level, sh_range: [named(36, -MAX_SH), named(40, MAX_SH)] };
    let section_count = u64::from(u32_at(&head, 4));
    let mut at = HEADER_BYTES + SECTION_HEADER_BYTES * section_count;
    if at > bytes {
        return Err(damaged(path, format!("the header says {section_count} sections, more than it has")));
    }
    let mut sections = Vec::new();
    for number in 0..section_count {
        let mut head = [0; SECTION_HEADER_BYTES as usize];
        reader.read_exact(&mut head).reading(path)?;
        cost::step();
        let [count, max, bucket_rows, buckets, full_buckets, others] =
            [0, 4, 8, 12, 32, 36].map(|at| u64::from(u32_at(&head, at)));
        let [bucket_bytes, sh_degree] = [20, 40].map(|at| u16::from_le_bytes([head[at], head[at + 1]]));
        let sh_degree = u32::from(sh_degree);
        if sh_degree > 3 || count > max || (buckets > 0 && u64::from(bucket_bytes) != CENTER_BYTES) {
            return Err(damaged(path, format!("the header of section {number} makes no sense")));
        }
        let middle = Some(u32_at(&head, 24)).filter(|middle| *middle != 0).unwrap_or(MIDDLE) as f32;
        let centers_at = at + 4 * others;
        let rows_at = centers_at + CENTER_BYTES * buckets;
        sections.push(Section {
            count,
            sh_degree,
            bucket_rows,
            full_buckets,
            lengths_at: at,
            centers_at,
            rows_at,
            middle,
            step: f32::from_bits(u32_at(&head, 16)) / 2.0 / middle,
        });
        at = rows_at + packing.row_bytes(sh_degree) * max;
        if at > bytes {
            return Err(damaged(path, format!("section {number} ends at byte {at} of {bytes}")));
        }
    }
    let count = u64::from(u32_at(&head, 16));
    let found = sections.iter().map(|section| section.count).sum::<u64>();
    if count != found {
        return Err(damaged(path, format!("the header says {count} Gaussians, the sections have {found}")));
    }
    let sh_degree = sections.iter().map(|section| section.sh_degree).max().unwrap_or(0);
    let mut header = Header::new(Format::Ksplat, count, sh_degree);
    if at < bytes {
        let rest = bytes - at;
        header.warnings.push(format!("{}: {rest} bytes after the last section are not read", path.display()));
    }
    Ok((header, Box::new(move |sink| sections.iter().try_for_each(|own| own.read(path, packing, sink)))))
}

impl Section {
    fn read(&self, path: &Path, packing: Packing, sink: &mut Sink<'_>) -> Result<()> {
        let row_bytes = packing.row_bytes(self.sh_degree);
        let mut reader = regular_file::part(path, self.rows_at, row_bytes * self.count)?;
        let mut buckets = Buckets::of(self, packing.level, path)?;
        let mut blocks = Blocks::new(self.sh_degree, self.count, sink);
        regular_file::rows(path, &mut reader, (self.count, row_bytes as usize), |row| {
            let too_few = "a section's buckets hold fewer Gaussians than its header says";
            let center = buckets.center_of_next_row().map_err(|_| damaged(path, too_few))?;
            packing.unpack(row, self, center, blocks.next()?);
            Ok(())
        })?;
        blocks.finish()
    }
}

/// The buckets of a section, in the order of its rows.
struct Buckets {
    centers: BufReader<Take<File>>,
    lengths: BufReader<Take<File>>,
    full: u64,
    full_rows: u64,
    center: [f32; 3],
    rows_left: u64,
}

impl Buckets {
    /// Level 0 has one without an end, around zero.
    fn of(section: &Section, level: usize, path: &Path) -> Result<Self> {
        let Section { lengths_at, centers_at, rows_at, .. } = *section;
        Ok(Self {
            centers: regular_file::part(path, centers_at, rows_at - centers_at)?,
            lengths: regular_file::part(path, lengths_at, centers_at - lengths_at)?,
            full: section.full_buckets,
            full_rows: section.bucket_rows,
            center: [0.0; 3],
            rows_left: if level == 0 { u64::MAX } else { 0 },
        })
    }

    /// Fails after the last bucket.
    fn center_of_next_row(&mut self) -> std::io::Result<[f32; 3]> {
        while self.rows_left == 0 {
            let mut center = [0; CENTER_BYTES as usize];
            self.centers.read_exact(&mut center)?;
            self.center = [0, 4, 8].map(|at| f32::from_bits(u32_at(&center, at)));
            self.rows_left = match self.full.checked_sub(1) {
                Some(left) => {
                    self.full = left;
                    self.full_rows
                }
                None => {
                    let mut length = [0; 4];
                    self.lengths.read_exact(&mut length)?;
                    u32::from_le_bytes(length).into()
                }
            };
        }
        self.rows_left -= 1;
        Ok(self.center)
    }
}
