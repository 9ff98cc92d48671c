//! Selects a device's form of blending from a table of measurements.

use crate::tuning::Backend;
use crate::vk::Limits;

/// How a tile is blended: the same picture, at a cost that depends on the device. The pictures agree to the
/// bit if the driver's compiler fuses sums of products alike in both kernels, as llvmpipe's does. `precise`
/// arithmetic decides which Gaussians count.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Blending {
    /// Each subgroup culls against its own region of the tile and hands Gaussians over by shuffles or broadcasts.
    Regions,
    /// The paper's form: batches in shared memory, and every invocation loops over the whole batch.
    SharedMemory,
}

/// One measurement of both forms on a device.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BlendMeasurement {
    /// The class of the device.
    pub backend: Backend,
    /// Lanes of a subgroup.
    pub subgroup_size: u32,
    /// Time of [`Blending::SharedMemory`] over that of [`Blending::Regions`], blending only: `ashsplat bench
    /// blending`.
    pub shared_over_regions: f32,
}

impl Blending {
    /// Both forms.
    pub const ALL: [Self; 2] = [Self::Regions, Self::SharedMemory];

    /// The measurements, each by `ashsplat bench blending` with its default scene (300,000 Gaussians at
    /// 1920×1080; of GPUs 1,100,000). The guide's chapter `measuring`, "Two forms of blending", names the machines. Add a row for each
    /// device that is measured.
    pub const MEASURED: &[BlendMeasurement] = &[
        BlendMeasurement { backend: Backend::Processor, subgroup_size: 4, shared_over_regions: 2.54 },
        BlendMeasurement { backend: Backend::Processor, subgroup_size: 8, shared_over_regions: 3.91 },
        BlendMeasurement { backend: Backend::Processor, subgroup_size: 16, shared_over_regions: 1.74 },
        BlendMeasurement { backend: Backend::Gpu, subgroup_size: 32, shared_over_regions: 2.06 },
    ];

    /// The form for a device: the faster one in [`Blending::MEASURED`], see [`Blending::by`].
    pub fn of_device(limits: &Limits) -> Self {
        Self::by(Self::MEASURED, limits.tuning.backend, limits.subgroup_size)
    }

    /// The form that is faster in the geometric mean over the measured devices of the same class with the nearest
    /// subgroup size, the smaller one of two equally near. [`Blending::Regions`], which computes fewer samples, if
    /// no device of that class was measured or both forms took equally long.
    pub fn by(measured: &[BlendMeasurement], backend: Backend, subgroup_size: u32) -> Self {
        let steps = |size: u32| size.max(1).ilog2().abs_diff(subgroup_size.max(1).ilog2());
        let of_kind = || measured.iter().filter(|m| m.backend == backend);
        let nearest = of_kind().map(|m| m.subgroup_size).min_by_key(|&size| (steps(size), size));
        let of_size = of_kind().filter(|m| Some(m.subgroup_size) == nearest);
        let product: f32 = of_size.map(|m| m.shared_over_regions).product();
        if product < 1.0 { Self::SharedMemory } else { Self::Regions }
    }
}

#[cfg(test)]
mod tests {
    use super::{BlendMeasurement, Blending};
    use crate::tuning::Backend::{self, Gpu, Processor};

    fn row(backend: Backend, subgroup_size: u32, shared_over_regions: f32) -> BlendMeasurement {
        BlendMeasurement { backend, subgroup_size, shared_over_regions }
    }

    #[test]
    fn blending_follows_the_nearest_measurement_of_the_same_kind() {
        let measured = [
            row(Processor, 8, 2.0),
            row(Processor, 16, 0.5),
            row(Gpu, 32, 0.9),
            row(Gpu, 64, 1.3),
            row(Gpu, 16, 1.0),
        ];
        let form = |backend, size| Blending::by(&measured, backend, size);
        let sizes = [4, 8, 16, 32, 64, 128];
        use Blending::{Regions, SharedMemory};
        assert_eq!(
            sizes.map(|size| form(Processor, size)),
            [Regions, Regions, SharedMemory, SharedMemory, SharedMemory, SharedMemory]
        );
        assert_eq!(
            sizes.map(|size| form(Gpu, size)),
            [Regions, Regions, Regions, SharedMemory, Regions, Regions]
        );
        // Between two rows: the smaller subgroups.
        let gap = [row(Gpu, 64, 1.3), row(Gpu, 16, 0.5)];
        assert_eq!(Blending::by(&gap, Gpu, 32), SharedMemory);
    }

    #[test]
    fn blending_without_a_measurement_is_by_regions() {
        assert_eq!(Blending::by(&[], Gpu, 32), Blending::Regions);
        assert_eq!(Blending::by(&[row(Processor, 32, 0.1)], Gpu, 32), Blending::Regions);
        assert_eq!(Blending::by(&[row(Gpu, 32, f32::NAN)], Gpu, 32), Blending::Regions);
    }

    /// "| processor ... | 8 | 3.91 (...) |": a row of the guide's table for each row here, in the same order.
    #[test]
    fn blending_measurements_are_those_of_the_guide() {
        let chapter = include_str!("../guide/measuring.md");
        let section = chapter.split("# Two forms of blending").nth(1).expect("its section");
        let section = section.split("\n# ").next().expect("its end");
        let rows = section.lines().filter(|line| line.starts_with('|')).skip(2);
        let mut backend = Gpu;
        let rows = rows.filter_map(|row| {
            let cells: Vec<&str> = row.split('|').map(str::trim).collect();
            if cells[1] != "the same" {
                backend = if cells[1].starts_with("processor") { Processor } else { Gpu };
            }
            let ratio = cells[3].split(' ').next()?.parse().ok()?;
            Some((
                super::BlendMeasurement {
                    backend,
                    subgroup_size: cells[2].parse().ok()?,
                    shared_over_regions: ratio,
                },
                cells[6],
            ))
        });
        let rows: Vec<_> = rows.collect();
        assert_eq!(rows.iter().map(|row| row.0).collect::<Vec<_>>(), Blending::MEASURED);
        for (row, form) in rows {
            let chosen = Blending::by(Blending::MEASURED, row.backend, row.subgroup_size);
            assert_eq!(
                form,
                if chosen == Blending::Regions { "regions" } else { "shared memory" },
                "{row:?}"
            );
        }
    }

    #[test]
    fn blending_measurements_of_a_size_count_together() {
        let by = |ratios: &[f32]| {
            let rows: Vec<_> = ratios.iter().map(|&ratio| row(Gpu, 32, ratio)).collect();
            Blending::by(&rows, Gpu, 32)
        };
        assert_eq!(by(&[1.3, 0.7]), Blending::SharedMemory);
        assert_eq!(by(&[0.7, 1.5]), Blending::Regions);
        assert_eq!(by(&[0.9, f32::NAN]), Blending::Regions);
        for m in Blending::MEASURED {
            assert!(m.subgroup_size.is_power_of_two() && m.shared_over_regions > 0.0, "{m:?}");
        }
    }
}
