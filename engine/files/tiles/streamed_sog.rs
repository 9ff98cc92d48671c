//! Writes a scene as PlayCanvas' streamed SOG.

use std::path::Path;

use glam::{DMat3, DQuat, DVec3};

use super::{MERGED, PartLosses, Spill, Tiling, box_around, enclosing, in_new_folder, of_input};
use crate::atomic;
use crate::decimate::decimate;
use crate::host_memory;
use crate::ply::morton_order;
use crate::progress::Progress;
use crate::splats::{
    self, Asset, Bound, Format, LOD_META, LodMeta, ReadOptions, Region, Run, WriteOptions, row_bytes,
    write_origin, write_sog_folder,
};
use ashsplat::Result;
use ashsplat::scene::{Bounds, Gaussians};

/// Number of Gaussians at which a file ends. It holds several regions of one level.
const FULL_FILE: usize = 1 << 19;
/// Smallest number of Gaussians of a level, unless the scene has fewer.
const MIN_IN_LEVEL: usize = 4096;

/// Writes a scene as a streamed SOG into a new folder: `lod-meta.json`, and SOGs in folders beside it. The same scene gives the
/// same bytes.
///
/// A k-d tree ([`Cells`](ashsplat::scene::Cells)) divides the scene into regions of at most `max_gaussians` Gaussians. Each level of a region
/// has a quarter of the Gaussians of the finer one, merged by [`decimate`].
///
/// # Errors
/// Those of [`super::write`].
pub fn write_streamed_sog(
    input: &Path,
    folder: &Path,
    max_gaussians: usize,
    read: &ReadOptions,
    progress: &Progress<'_>,
) -> Result<Tiling> {
    in_new_folder(folder, |folder| {
        let spill = Spill::of(input, folder, max_gaussians, read, progress)?;
        let gaussians = spill.means.len();
        let fewer = |count: &usize| Some(count / MERGED).filter(|count| *count >= MIN_IN_LEVEL);
        let sizes: Vec<usize> = std::iter::successors(Some(gaussians), fewer).collect();
        let levels = sizes.len();
        let pending = sizes.iter().map(|size| (*size).min(FULL_FILE + max_gaussians) as u64).sum::<u64>();
        // Beside the Gaussians: the pictures, sorted values, SH vectors.
        host_memory::check_writing(input, pending * (row_bytes(spill.sh_degree) + 64))?;
        let mut writer = LevelWriter {
            input,
            folder,
            options: spill.marks,
            format_losses: Format::Sog.losses(spill.sh_degree, &spill.marks),
            levels: (0..levels).map(|_| Level::default()).collect(),
            files: Vec::new(),
            losses: PartLosses::default(),
        };
        let mut tree = Region::default();
        let regions = spill.cells.bounds().len();
        for cell in 0..regions {
            progress.check()?;
            tree.children.push(writer.region(spill.take(cell)?)?);
            progress.step(cell + 1, regions + levels);
        }
        for level in 0..levels {
            progress.check()?;
            writer.finish_file(level)?;
            progress.step(regions + level + 1, regions + levels);
        }
        let bounds = tree.children.iter().map(|region| Bounds::from(region.bound));
        tree.bound = bounds.reduce(enclosing).map(Bound::from).unwrap_or_default();
        let counts: Vec<u64> = writer.levels.iter().map(|level| level.count).collect();
        let meta = LodMeta {
            version: LodMeta::VERSION,
            asset: Asset { generator: concat!("ashsplat ", env!("CARGO_PKG_VERSION")).into() },
            count: counts.iter().sum(),
            counts,
            lod_levels: levels as u32,
            environment: None,
            filenames: writer.files.iter().map(|file| format!("{file}/meta.json")).collect(),
            tree,
        };
        let path = folder.join(LOD_META);
        atomic::write(&path, |out| Ok(serde_json::to_writer(out, &meta)?))?;
        write_origin(&path, spill.origin)?;
        let mut warnings = spill.warnings;
        warnings.extend(Format::Sog.origin_note(Path::new(LOD_META), spill.origin));
        warnings.extend(writer.format_losses);
        warnings.extend(writer.losses.line("files"));
        let (tiles, written) = (levels * regions, meta.count);
        Ok(Tiling { gaussians: gaussians as u64, tiles, leaves: regions, levels, written, warnings })
    })
}

/// The file of a level that is being filled.
#[derive(Default)]
struct Level {
    file: Gaussians,
    /// Order of the Gaussians within the file, region by region.
    order: Vec<usize>,
    /// Number of the level's files that are written.
    written: usize,
    /// Index of the file among those of all levels, if it has Gaussians.
    index: Option<usize>,
    /// Number of the level's Gaussians.
    count: u64,
}

struct LevelWriter<'a> {
    input: &'a Path,
    folder: &'a Path,
    options: WriteOptions,
    /// Losses of any scene with these marks.
    format_losses: Vec<String>,
    levels: Vec<Level>,
    /// Folders of the files of all levels.
    files: Vec<String>,
    losses: PartLosses,
}

impl LevelWriter<'_> {
    /// Adds all levels of a region.
    fn region(&mut self, mut gaussians: Gaussians) -> Result<Region> {
        let mut bounds = one_deviation(&gaussians);
        let mut region = Region::default();
        for index in 0..self.levels.len() {
            if index > 0 {
                let fewer = (gaussians.len() / MERGED).max(1);
                decimate(&mut gaussians, fewer);
                bounds = enclosing(bounds, one_deviation(&gaussians));
            }
            let level = &mut self.levels[index];
            let file = *level.index.get_or_insert_with(|| {
                self.files.push(format!("{index}_{}", level.written));
                self.files.len() - 1
            });
            let first = level.file.len();
            level.file.sh_degree = gaussians.sh_degree;
            level.file.append(&gaussians);
            level.order.extend(morton_order(&gaussians.means).into_iter().map(|own| first + own));
            level.count += gaussians.len() as u64;
            region
                .lods
                .insert(index as u32, Run { file, offset: first as u64, count: gaussians.len() as u64 });
            if level.file.len() >= FULL_FILE {
                self.finish_file(index)?;
            }
        }
        region.bound = bounds.into();
        Ok(region)
    }

    /// Writes the file of a level, if it has Gaussians.
    fn finish_file(&mut self, level: usize) -> Result<()> {
        let Some(index) = self.levels[level].index else { return Ok(()) };
        let Level { file, order, written, count, .. } = std::mem::take(&mut self.levels[level]);
        let name = &self.files[index];
        let losses = splats::losses(Format::Sog, &file, &self.options)?;
        for line in losses.into_iter().filter(|line| !self.format_losses.contains(line)) {
            self.losses.add(name, line);
        }
        write_sog_folder(&self.folder.join(name), &file, &order, &self.options)
            .map_err(|e| of_input(self.input, name, e))?;
        self.levels[level] = Level { written: written + 1, count, ..Level::default() };
        Ok(())
    }
}

/// The box around all Gaussians, to one standard deviation, as other writers of the format have it: viewers choose levels by it.
fn one_deviation(all: &Gaussians) -> Bounds {
    box_around(all, |index| {
        let [w, x, y, z] = all.quats[index].map(f64::from);
        let turned = DMat3::from_quat(DQuat::from_xyzw(x, y, z, w).normalize());
        let sizes = DVec3::from_array(all.log_scales[index].map(f64::from)).exp();
        turned.x_axis.abs() * sizes.x + turned.y_axis.abs() * sizes.y + turned.z_axis.abs() * sizes.z
    })
}

impl From<Bounds> for Bound {
    fn from(Bounds { min, max }: Bounds) -> Self {
        Self { min: min.into(), max: max.into() }
    }
}

impl From<Bound> for Bounds {
    fn from(Bound { min, max }: Bound) -> Self {
        Self { min: min.into(), max: max.into() }
    }
}
