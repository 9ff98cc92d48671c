//! What the data sheets of GPUs say that are not at hand.

use clap::ValueEnum;
use serde::Serialize;

/// GPUs with public data sheets.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum Gpu {
    /// NVIDIA H200 (Hopper)
    H200,
    /// NVIDIA GeForce RTX 4090 (Ada)
    #[value(name = "rtx4090")]
    Rtx4090,
    /// AMD Radeon RX 7900 XTX (RDNA3)
    #[value(name = "rx7900xtx")]
    Rx7900Xtx,
    /// Intel Arc A770 (DG2)
    A770,
}

/// What a data sheet says.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Sheet {
    pub name: &'static str,
    /// Float lanes that take an instruction each per cycle. RDNA3's second issue is not counted.
    pub lanes: f64,
    /// Boost clock.
    pub gigahertz: f64,
    /// Bandwidth of device memory.
    pub gigabytes_per_second: f64,
    /// SMs, compute units, Xe cores: what has a load/store unit and a first cache.
    pub cores: f64,
    /// Invocations of a subgroup that the kernels run there (`Tuning`).
    pub subgroup_size: u32,
    /// Line of the first cache: what a subgroup's access takes a cycle for.
    pub line_bytes: u32,
    /// Instructions of blending for a Gaussian at a pixel, forward and backward, counted in the machine code of the loops
    /// (tools/gpu_static.md): for NVIDIA's in NVK's for Ampere, the newest that Mesa compiles for.
    pub blend_instructions: [f64; 2],
    /// What the names of the drivers begin with whose compilers know the GPU's instructions, or ones like them.
    #[serde(skip)]
    pub drivers: &'static [&'static str],
}

impl Gpu {
    pub fn sheet(self) -> Sheet {
        let (name, cores, subgroup_size, line_bytes) = match self {
            Self::H200 => ("NVIDIA H200", 132.0, 32, 128),
            Self::Rtx4090 => ("NVIDIA GeForce RTX 4090", 128.0, 32, 128),
            Self::Rx7900Xtx => ("AMD Radeon RX 7900 XTX", 96.0, 64, 128),
            Self::A770 => ("Intel Arc A770", 32.0, 16, 64),
        };
        let (lanes, gigahertz, gigabytes_per_second) = match self {
            Self::H200 => (16_896.0, 1.98, 4800.0),
            Self::Rtx4090 => (16_384.0, 2.52, 1008.0),
            Self::Rx7900Xtx => (6144.0, 2.5, 960.0),
            Self::A770 => (4096.0, 2.1, 560.0),
        };
        let (blend_instructions, drivers): (_, &[&str]) = match self {
            Self::H200 | Self::Rtx4090 => ([51.0, 95.0], &["NVK", "NVIDIA"]),
            Self::Rx7900Xtx => ([45.0, 61.0], &["radv", "AMD"]),
            Self::A770 => ([57.0, 77.0], &["Intel"]),
        };
        Sheet {
            name,
            lanes,
            gigahertz,
            gigabytes_per_second,
            cores,
            subgroup_size,
            line_bytes,
            blend_instructions,
            drivers,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn data_sheets_are_in_the_order_of_their_generations() {
        let sheets: Vec<Sheet> = Gpu::value_variants().iter().map(|gpu| gpu.sheet()).collect();
        assert!(sheets.iter().all(|sheet| (1.0..3.0).contains(&sheet.gigahertz)));
        assert!(sheets.iter().all(|sheet| (500.0..5000.0).contains(&sheet.gigabytes_per_second)));
        assert!(
            sheets.iter().all(|sheet| [64.0, 128.0].contains(&(sheet.lanes / sheet.cores))),
            "{sheets:?}"
        );
        assert_eq!(sheets.len(), 4);
    }
}
