//! Checkpoint files: safetensors, written whole or not at all.

use std::collections::BTreeMap;
use std::path::Path;

use bytemuck::Pod;
use glam::DVec3;
use safetensors::tensor::TensorView;
use safetensors::{Dtype, SafeTensors};
use serde_json::{Map, Value, json};

use crate::host_memory::HostMemory;
use crate::splats::Format;
use crate::{atomic, regular_file, text};
use ashsplat::scene::gaussians::sh_coefficients;
use ashsplat::scene::{Fingerprint, Gaussians, WorldFrame};
use ashsplat::train::checkpoint::{
    Capacities, Checkpoint, ExposureState, MomentState, PoseState, StrategyState, Tensor, packed_planes,
};
use ashsplat::train::strategy::Actions;
use ashsplat::train::{BlockState, LENS_STATE_VALUES, LensState, MomentsType, TrainSettings, ZoomState};
use ashsplat::{Error, Result};

/// Changes when older files can no longer be read.
const FORMAT: &str = "ashsplat-checkpoint/3";
/// The metadata entry with the hash of all other metadata.
const FINGERPRINT: &str = "metadata_fingerprint";
/// Present only if memory was bounded.
const MAX_MEMORY: &str = "room_max_memory";
/// Key of [`Checkpoint::skipped`]. The oldest files lack it.
const SKIPPED: &str = "left_out";
/// Actions of [`Checkpoint::due`] that have a metadata entry of their own.
const DUE: [(&str, Actions); 2] =
    [("densification_due", Actions::DENSIFY), ("opacity_reset_due", Actions::RESET_OPACITY)];
/// All other due actions, as bits. Present only if there are any.
const OTHERS_DUE: &str = "strategy_due";
/// Keys of the strategy's name, and of the comma-separated names of the loss's terms. Older files lack both.
const STRATEGY_NAME: &str = "strategy";
/// [`Checkpoint::kernels`]. Older files lack it.
const KERNELS: &str = "kernels";
/// See [`STRATEGY_NAME`].
const TERMS: &str = "loss_terms";
/// [`Checkpoint::block`]: bits of the core's corners, comma-separated; number of frozen Gaussians; their hash.
/// Present only with a block.
const BLOCK: [&str; 3] = ["block_core_bits", "block_frozen", "block_fingerprint"];
/// [`Checkpoint::frame`]: origin x, y, z and unit, comma-separated. Absent for the identity.
const FRAME: &str = "frame";
const ALIGNMENT: usize = 8;

/// Reads and writes a [`Checkpoint`] as a file.
pub trait CheckpointFile: Sized {
    /// Writes the checkpoint under a temporary name and renames it when it is complete.
    fn write(&self, path: impl AsRef<Path>) -> Result<()>;

    /// Reads a checkpoint and checks that it is whole.
    fn read(path: impl AsRef<Path>) -> Result<Self> {
        Self::read_within(path, &HostMemory::default())
    }

    /// Same as [`CheckpointFile::read`], within a memory budget.
    fn read_within(path: impl AsRef<Path>, memory: &HostMemory) -> Result<Self>;
}

impl CheckpointFile for Checkpoint {
    fn write(&self, path: impl AsRef<Path>) -> Result<()> {
        let tensors = self.tensors();
        let mut header = Map::new();
        let mut metadata = metadata(self, self.fingerprint())?;
        metadata.insert(FINGERPRINT.into(), format!("{:016x}", fingerprint_of(&metadata)));
        header.insert("__metadata__".into(), json!(metadata));
        let mut end = 0;
        for Tensor { name, shape, bytes, dtype } in &tensors {
            let begin = end;
            end += bytes.len();
            let entry = json!({"dtype": dtype, "shape": shape, "data_offsets": [begin, end]});
            header.insert(name.clone(), entry);
        }
        let mut header = Value::Object(header).to_string().into_bytes();
        header.resize(header.len().next_multiple_of(ALIGNMENT), b' ');
        atomic::write(path, |out| {
            out.write_all(&(header.len() as u64).to_le_bytes())?;
            out.write_all(&header)?;
            tensors.iter().try_for_each(|tensor| out.write_all(tensor.bytes))
        })
    }

    fn read_within(path: impl AsRef<Path>, memory: &HostMemory) -> Result<Self> {
        let path = path.as_ref();
        // Twice the file: its bytes, and the checkpoint made of them.
        let (bytes, _lease) = regular_file::read_within(path, 2, memory)?;
        parse(&bytes).map_err(|problem| match other_file(path, &bytes) {
            Some((problem, remedy)) => Error::input(path, problem, remedy),
            None => Error::input(path, problem, "start from another checkpoint, or anew"),
        })
    }
}

/// Names a file that is commonly mistaken for a checkpoint, with the remedy.
fn other_file(path: &Path, bytes: &[u8]) -> Option<(String, &'static str)> {
    if bytes.is_empty() || SafeTensors::read_metadata(bytes).is_ok() {
        return None;
    }
    if path.extension().is_some_and(|ending| ["pth", "pt", "ckpt"].iter().any(|of| ending == *of)) {
        let remedy = "train on with its program, or start from its scene: `--init point_cloud.ply`";
        return Some(("is a checkpoint of PyTorch, not one of ashsplat".into(), remedy));
    }
    if let Ok(format) = Format::of_file(path) {
        let remedy = "start a new training from it: `--init FILE` in place of `--start-checkpoint FILE`";
        return Some((format!("is a scene ({format}), which has no state of a training"), remedy));
    }
    regular_file::recognise(bytes.get(..512).unwrap_or(bytes)).map(|(what, remedy)| (what.into(), remedy))
}

/// Metadata entries, all as text: safetensors allows nothing else.
fn metadata(checkpoint: &Checkpoint, data_fingerprint: u64) -> Result<BTreeMap<String, String>> {
    let settings = serde_json::to_string(&checkpoint.settings)
        .map_err(|e| Error::argument("settings", format!("cannot be written: {e}")))?;
    let views = checkpoint.views.max(1);
    let mut capacities = checkpoint.capacities;
    let mut entries: BTreeMap<String, String> = [
        ("format", FORMAT.to_owned()),
        ("version", checkpoint.version.clone()),
        ("device", checkpoint.device.clone()),
        ("driver", checkpoint.driver.clone()),
        ("settings", settings),
        ("views", checkpoint.views.to_string()),
        ("views_fingerprint", format!("{:016x}", checkpoint.views_fingerprint)),
        ("data_fingerprint", format!("{data_fingerprint:016x}")),
        ("scene_extent_bits", format!("{:08x}", checkpoint.scene_extent.to_bits())),
        ("scene_extent", checkpoint.scene_extent.to_string()),
        ("iteration", checkpoint.iteration.to_string()),
        ("optimizer_steps", checkpoint.optimizer_steps.to_string()),
        ("opacity_steps", checkpoint.opacity_steps.to_string()),
        (KERNELS, checkpoint.kernels.clone()),
        (STRATEGY_NAME, checkpoint.strategy.name.clone()),
        (TERMS, checkpoint.strategy.terms.join(",")),
        (SKIPPED, checkpoint.skipped.to_string()),
        // For readers of the file: both follow from seed and iteration, which key all random numbers.
        ("view_order_epoch", (u64::from(checkpoint.iteration) / views).to_string()),
        ("view_order_position", (u64::from(checkpoint.iteration) % views).to_string()),
    ]
    .map(|(name, value)| (name.to_owned(), value))
    .into();
    let mut put = |name: &str, value: String| drop(entries.insert(name.to_owned(), value));
    for (name, number) in capacity_numbers(&mut capacities) {
        put(name, number.to_string());
    }
    if let Some(bytes) = capacities.max_memory {
        put(MAX_MEMORY, bytes.to_string());
    }
    let mut others = checkpoint.due;
    for (name, action) in DUE {
        put(name, checkpoint.due.contains(action).to_string());
        others = others.without(action);
    }
    if !others.is_empty() {
        put(OTHERS_DUE, others.0.to_string());
    }
    if !checkpoint.frame.is_identity() {
        let WorldFrame { origin, unit } = checkpoint.frame;
        put(FRAME, [origin.x, origin.y, origin.z, unit].map(|value| value.to_string()).join(","));
    }
    if let Some(BlockState { core, frozen, fingerprint }) = &checkpoint.block {
        let core: Vec<String> = core.as_flattened().iter().map(|x| format!("{:08x}", x.to_bits())).collect();
        let values = [core.join(","), frozen.to_string(), format!("{fingerprint:016x}")];
        BLOCK.into_iter().zip(values).for_each(|(name, value)| put(name, value));
    }
    for (name, value) in &checkpoint.strategy.values {
        put(&format!("{}{name}", Checkpoint::STRATEGY), value.clone());
    }
    Ok(entries)
}

/// The capacities, with the names of their entries.
fn capacity_numbers(capacities: &mut Capacities) -> [(&'static str, &mut u32); 7] {
    [
        ("room_gaussians", &mut capacities.gaussians),
        ("room_frame_gaussians", &mut capacities.frame_gaussians),
        ("room_frame_visible", &mut capacities.frame_visible),
        ("room_frame_instances", &mut capacities.frame_instances),
        ("room_blend_passes", &mut capacities.blend_passes),
        ("most_visible", &mut capacities.most_visible),
        ("most_instances", &mut capacities.most_instances),
    ]
}

/// Hash of the metadata without the hash's own entry.
fn fingerprint_of(metadata: &BTreeMap<String, String>) -> u64 {
    let mut fingerprint = Fingerprint::new();
    for (name, value) in metadata.iter().filter(|(name, _)| *name != FINGERPRINT) {
        fingerprint.add(name.as_bytes());
        fingerprint.add(value.as_bytes());
    }
    fingerprint.finish()
}

/// Parses a checkpoint. Fuzzing skips the fingerprint of the metadata, which random bytes would never pass.
fn parse(bytes: &[u8]) -> Result<Checkpoint, String> {
    let broken = |e: safetensors::SafeTensorError| {
        format!("is truncated or no safetensors file ({} bytes): {e}", bytes.len())
    };
    let tensors = SafeTensors::deserialize(bytes).map_err(broken)?;
    let (_, header) = SafeTensors::read_metadata(bytes).map_err(broken)?;
    let metadata =
        Metadata(header.metadata().iter().flatten().map(|(k, v)| (k.clone(), v.clone())).collect());
    let format = metadata.text("format").map_err(|_| "is no checkpoint of ashsplat".to_owned())?;
    if format != FORMAT {
        return Err(format!("has the format '{format}', this version reads '{FORMAT}'"));
    }
    if !cfg!(fuzzing) && fingerprint_of(&metadata.0) != metadata.hexadecimal(FINGERPRINT)? {
        return Err("is damaged: its metadata do not have the fingerprint that they were written with".into());
    }
    let (settings, gaussians) = (metadata.settings()?, gaussians_of(&tensors, Checkpoint::SETS[0])?);
    let checkpoint = Checkpoint {
        version: metadata.text("version")?.to_owned(),
        device: metadata.text("device")?.to_owned(),
        driver: metadata.text("driver")?.to_owned(),
        kernels: metadata.text(KERNELS)?.to_owned(),
        views: metadata.parsed("views")?,
        views_fingerprint: metadata.hexadecimal("views_fingerprint")?,
        scene_extent: f32::from_bits(metadata.hexadecimal("scene_extent_bits")? as u32),
        frame: metadata.frame()?,
        iteration: metadata.parsed("iteration")?,
        optimizer_steps: metadata.parsed("optimizer_steps")?,
        opacity_steps: metadata.parsed("opacity_steps")?,
        due: metadata.due()?,
        moments: match settings.moments {
            MomentsType::F32 => {
                let [_, first, second] = Checkpoint::SETS;
                MomentState::F32([gaussians_of(&tensors, first)?, gaussians_of(&tensors, second)?])
            }
            MomentsType::Packed => MomentState::Packed(packed_moments(&tensors, gaussians.sh_degree)?),
        },
        settings,
        gaussians,
        statistics: values(&tensors, "statistics", &[2])?,
        filters: optional_values(&tensors, Checkpoint::FILTERS, &[])?,
        strategy: StrategyState {
            name: metadata.text(STRATEGY_NAME)?.to_owned(),
            terms: metadata.terms(),
            values: metadata.strategy(),
        },
        exposures: appearance_state(&tensors, Checkpoint::EXPOSURES)?,
        lens_effects: appearance_state(&tensors, Checkpoint::LENS_EFFECTS)?,
        poses: poses(&tensors)?,
        lens_opt: LensState {
            lenses: optional_values(&tensors, Checkpoint::LENS_OPT, &[LENS_STATE_VALUES])?,
            zoom: optional_values(&tensors, Checkpoint::LENS_ZOOM, &[size_of::<ZoomState>() / 4])?.pop(),
        },
        skipped: metadata.parsed(SKIPPED)?,
        block: metadata.block()?,
        capacities: metadata.capacities()?,
    };
    if !cfg!(fuzzing) && checkpoint.fingerprint() != metadata.hexadecimal("data_fingerprint")? {
        return Err("is damaged: its contents do not have the fingerprint that they were written with".into());
    }
    checkpoint.check().map_err(|e| e.to_string())?;
    Ok(checkpoint)
}

struct Metadata(BTreeMap<String, String>);

impl Metadata {
    fn text(&self, name: &str) -> Result<&str, String> {
        self.0.get(name).map(String::as_str).ok_or_else(|| format!("lacks the metadata '{name}'"))
    }

    fn parsed<T: std::str::FromStr>(&self, name: &str) -> Result<T, String> {
        let text = self.text(name)?;
        text.parse().map_err(|_| format!("has '{text}' as the metadata '{name}'"))
    }

    /// Returns `None` if the entry is missing.
    fn optional<T: std::str::FromStr>(&self, name: &str) -> Result<Option<T>, String> {
        self.0.contains_key(name).then(|| self.parsed(name)).transpose()
    }

    fn settings(&self) -> Result<TrainSettings, String> {
        let unknown = |e: serde_json::Error| format!("has settings that this version does not know: {e}");
        serde_json::from_str(self.text("settings")?).map_err(unknown)
    }

    /// The identity is not stored.
    fn frame(&self) -> Result<WorldFrame, String> {
        let Some(text) = self.0.get(FRAME) else { return Ok(WorldFrame::default()) };
        match text::numbers(text) {
            Some([x, y, z, unit]) if DVec3::new(x, y, z).is_finite() && unit > 0.0 && unit.is_finite() => {
                Ok(WorldFrame { origin: DVec3::new(x, y, z), unit })
            }
            _ => Err(format!("has '{text}' as the metadata '{FRAME}'")),
        }
    }

    /// Returns `None` for a whole scene.
    fn block(&self) -> Result<Option<BlockState>, String> {
        let [core, frozen, fingerprint] = BLOCK;
        let Some(text) = self.0.get(core) else { return Ok(None) };
        let side = |bits| u32::from_str_radix(bits, 16).ok().map(f32::from_bits);
        let sides: Option<Vec<f32>> = text.split(',').map(side).collect();
        let Some(&[a, b, c, x, y, z]) = sides.as_deref() else {
            return Err(format!("has '{text}' as the metadata '{core}'"));
        };
        let core = [[a, b, c], [x, y, z]];
        let fingerprint = self.hexadecimal(fingerprint)?;
        Ok(Some(BlockState { core, frozen: self.parsed(frozen)?, fingerprint }))
    }

    fn capacities(&self) -> Result<Capacities, String> {
        let mut capacities = Capacities { max_memory: self.optional(MAX_MEMORY)?, ..Capacities::default() };
        for (name, number) in capacity_numbers(&mut capacities) {
            *number = self.parsed(name)?;
        }
        Ok(capacities)
    }

    fn due(&self) -> Result<Actions, String> {
        let mut due = Actions(self.optional(OTHERS_DUE)?.unwrap_or(0));
        for (name, action) in DUE {
            due = due.and(action.when(self.parsed(name)?));
        }
        Ok(due)
    }

    fn terms(&self) -> Vec<String> {
        let all = self.0.get(TERMS).map_or("", String::as_str);
        all.split(',').filter(|term| !term.is_empty()).map(str::to_owned).collect()
    }

    fn strategy(&self) -> Vec<(String, String)> {
        let own = |(name, value): (&String, &String)| {
            Some((name.strip_prefix(Checkpoint::STRATEGY)?.to_owned(), value.clone()))
        };
        self.0.iter().filter_map(own).collect()
    }

    fn hexadecimal(&self, name: &str) -> Result<u64, String> {
        let text = self.text(name)?;
        u64::from_str_radix(text, 16).map_err(|_| format!("has '{text}' as the metadata '{name}'"))
    }
}

/// Rows of an f32 tensor of shape [any, row...].
fn values<T: Pod>(tensors: &SafeTensors, name: &str, row: &[usize]) -> Result<Vec<T>, String> {
    let tensor = tensors.tensor(name).map_err(|_| format!("lacks the tensor '{name}'"))?;
    let fits = tensor.dtype() == Dtype::F32 && tensor.shape().get(1..) == Some(row);
    if !fits || row.iter().product::<usize>() * 4 != size_of::<T>() {
        return Err(odd(name, &tensor));
    }
    Ok(bytemuck::pod_collect_to_vec(tensor.data()))
}

/// Same as [`values`]; empty if the tensor is missing, because the values were not learned.
fn optional_values<T: Pod>(tensors: &SafeTensors, name: &str, row: &[usize]) -> Result<Vec<T>, String> {
    if tensors.tensor(name).is_err() { Ok(Vec::new()) } else { values(tensors, name, row) }
}

fn odd(name: &str, tensor: &TensorView<'_>) -> String {
    format!("has a tensor '{name}' of {:?} {:?}", tensor.dtype(), tensor.shape())
}

/// Returns `None` if poses were not optimised.
fn poses(tensors: &SafeTensors) -> Result<Option<PoseState>, String> {
    let [parameters, first, second] = Checkpoint::POSES;
    if tensors.tensor(parameters).is_err() {
        return Ok(None);
    }
    Ok(Some(PoseState {
        parameters: values(tensors, parameters, &[6])?,
        first_moments: values(tensors, first, &[6])?,
        second_moments: values(tensors, second, &[6])?,
        depths: values(tensors, Checkpoint::POSE_DEPTHS, &[])?,
    }))
}

fn appearance_state(tensors: &SafeTensors, own: &str) -> Result<ExposureState, String> {
    let [values, first_moments, second_moments] = Checkpoint::SETS;
    Ok(ExposureState {
        values: matrices(tensors, values, own)?,
        first_moments: matrices(tensors, first_moments, own)?,
        second_moments: matrices(tensors, second_moments, own)?,
    })
}

fn matrices(tensors: &SafeTensors, prefix: &str, own: &str) -> Result<Vec<[[f32; 4]; 3]>, String> {
    optional_values(tensors, &[prefix, own].concat(), &[3, 4])
}

fn packed_moments(tensors: &SafeTensors, sh_degree: u32) -> Result<Vec<[u32; 4]>, String> {
    let name = Checkpoint::PACKED_MOMENTS;
    let tensor = tensors.tensor(name).map_err(|_| format!("lacks the tensor '{name}'"))?;
    let fits = tensor.shape().get(1..) == Some(&[packed_planes(sh_degree), 4]);
    if fits && tensor.dtype() == Dtype::U32 {
        Ok(bytemuck::pod_collect_to_vec(tensor.data()))
    } else {
        Err(odd(name, &tensor))
    }
}

fn gaussians_of(tensors: &SafeTensors, prefix: &str) -> Result<Gaussians, String> {
    let named = |name: &str| format!("{prefix}{name}");
    let sh_name = named("sh");
    let sh = tensors.tensor(&sh_name).map_err(|_| format!("lacks the tensor '{sh_name}'"))?;
    let degree = (0..=3).find(|&d| sh.shape().get(1..) == Some(&[sh_coefficients(d), 3]));
    let Some(sh_degree) = degree.filter(|_| sh.dtype() == Dtype::F32) else {
        return Err(odd(&sh_name, &sh));
    };
    Ok(Gaussians {
        sh_degree,
        means: values(tensors, &named("means"), &[3])?,
        quats: values(tensors, &named("quats"), &[4])?,
        log_scales: values(tensors, &named("log_scales"), &[3])?,
        opacity_logits: values(tensors, &named("opacity_logits"), &[])?,
        sh: bytemuck::pod_collect_to_vec(sh.data()),
    })
}
