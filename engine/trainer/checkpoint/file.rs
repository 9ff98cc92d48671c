//! The checkpoint's file: safetensors, written whole or not at all.

use super::{Checkpoint, Room};
use crate::error::{Error, Result};
use crate::fingerprint::Fingerprint;
use crate::io::atomic;
use crate::scene::Gaussians;
use crate::scene::gaussians::sh_coefficients;
use bytemuck::Pod;
use safetensors::{Dtype, SafeTensors};
use serde_json::{Map, Value, json};
use std::collections::BTreeMap;
use std::path::Path;

/// Changes when older files cannot be read any more.
const FORMAT: &str = "ashsplat-checkpoint/2";
/// The metadata that tells all other metadata from others.
const FINGERPRINT: &str = "metadata_fingerprint";
/// Only where memory was bounded.
const MAX_MEMORY: &str = "room_max_memory";
/// Older files lack it.
const SKIPPED: &str = "skipped";
/// Prefixes of the tensors' names.
const SETS: [&str; 3] = ["", "first_moment.", "second_moment."];
/// The data begin at a multiple of this.
const ALIGNMENT: usize = 8;

struct Tensor<'a> {
    name: String,
    shape: Vec<usize>,
    bytes: &'a [u8],
}

impl Checkpoint {
    /// Writes the checkpoint under a temporary name and renames it when it is complete.
    ///
    /// # Errors
    /// [`Error::Io`]; an older file of that name stays as it was.
    pub fn write(&self, path: impl AsRef<Path>) -> Result<()> {
        let tensors = self.tensors();
        let mut header = Map::new();
        let mut metadata = self.metadata(self.fingerprint())?;
        metadata.insert(FINGERPRINT.into(), format!("{:016x}", fingerprint_of(&metadata)));
        header.insert("__metadata__".into(), json!(metadata));
        let mut end = 0;
        for Tensor { name, shape, bytes } in &tensors {
            let begin = end;
            end += bytes.len();
            let entry = json!({"dtype": "F32", "shape": shape, "data_offsets": [begin, end]});
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

    /// Reads a checkpoint and checks that it is whole.
    ///
    /// # Errors
    /// [`Error::Io`], or [`Error::Input`] with what is wrong with the file.
    pub fn read(path: impl AsRef<Path>) -> Result<Self> {
        let path = path.as_ref();
        let bytes = std::fs::read(path).map_err(|e| Error::io(path, "read", e))?;
        parse(&bytes).map_err(|problem| {
            let remedy = "start from another checkpoint, or anew";
            Error::input(path, problem, remedy)
        })
    }

    /// A hash of all tensors: two states of a run are the same to the bit where these are.
    pub fn fingerprint(&self) -> u64 {
        let mut fingerprint = Fingerprint::new();
        self.tensors().iter().for_each(|tensor| fingerprint.add(tensor.bytes));
        fingerprint.finish()
    }

    fn tensors(&self) -> Vec<Tensor<'_>> {
        let mut tensors = Vec::new();
        for (prefix, set) in SETS.iter().zip([&self.gaussians, &self.first_moments, &self.second_moments]) {
            let (n, k) = (set.len(), sh_coefficients(set.sh_degree));
            let mut add = |name: &str, shape: &[usize], bytes| {
                tensors.push(Tensor { name: format!("{prefix}{name}"), shape: shape.to_vec(), bytes });
            };
            add("means", &[n, 3], bytemuck::cast_slice(&set.means));
            add("quats", &[n, 4], bytemuck::cast_slice(&set.quats));
            add("log_scales", &[n, 3], bytemuck::cast_slice(&set.log_scales));
            add("opacity_logits", &[n], bytemuck::cast_slice(&set.opacity_logits));
            add("sh", &[n, k, 3], bytemuck::cast_slice(&set.sh));
        }
        let shape = vec![self.statistics.len(), 2];
        let bytes = bytemuck::cast_slice(&self.statistics);
        tensors.push(Tensor { name: "statistics".into(), shape, bytes });
        tensors
    }

    /// The format knows text only.
    fn metadata(&self, data_fingerprint: u64) -> Result<BTreeMap<String, String>> {
        let settings = serde_json::to_string(&self.settings)
            .map_err(|e| Error::argument("settings", format!("cannot be written: {e}")))?;
        let views = self.views.max(1);
        let Room { gaussians, frame_gaussians, frame_instances, frame_width, frame_height, .. } = self.room;
        let Room { blend_passes, backward, most_instances, max_memory, .. } = self.room;
        let pairs = [
            ("format", FORMAT.to_owned()),
            ("version", self.version.clone()),
            ("device", self.device.clone()),
            ("driver", self.driver.clone()),
            ("settings", settings),
            ("views", self.views.to_string()),
            ("views_fingerprint", format!("{:016x}", self.views_fingerprint)),
            ("data_fingerprint", format!("{data_fingerprint:016x}")),
            ("scene_extent_bits", format!("{:08x}", self.scene_extent.to_bits())),
            ("scene_extent", self.scene_extent.to_string()),
            ("iteration", self.iteration.to_string()),
            ("optimizer_steps", self.optimizer_steps.to_string()),
            ("opacity_steps", self.opacity_steps.to_string()),
            ("densification_due", self.densification_due.to_string()),
            ("opacity_reset_due", self.opacity_reset_due.to_string()),
            (SKIPPED, self.skipped.to_string()),
            ("room_gaussians", gaussians.to_string()),
            ("room_frame_gaussians", frame_gaussians.to_string()),
            ("room_frame_instances", frame_instances.to_string()),
            ("room_frame_width", frame_width.to_string()),
            ("room_frame_height", frame_height.to_string()),
            ("room_blend_passes", blend_passes.to_string()),
            ("room_backward", backward.to_string()),
            ("most_instances", most_instances.to_string()),
            // For readers of the file: both follow from seed and iteration, which key all random numbers.
            ("view_order_epoch", (u64::from(self.iteration) / views).to_string()),
            ("view_order_position", (u64::from(self.iteration) % views).to_string()),
        ];
        let max_memory = max_memory.map(|bytes| (MAX_MEMORY, bytes.to_string()));
        Ok(pairs.into_iter().chain(max_memory).map(|(name, value)| (name.to_owned(), value)).collect())
    }
}

/// Of the metadata but for this one itself.
fn fingerprint_of(metadata: &BTreeMap<String, String>) -> u64 {
    let mut fingerprint = Fingerprint::new();
    for (name, value) in metadata.iter().filter(|(name, _)| *name != FINGERPRINT) {
        fingerprint.add(name.as_bytes());
        fingerprint.add(value.as_bytes());
    }
    fingerprint.finish()
}

/// A fuzzer would not come past the fingerprints.
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
    let settings = serde_json::from_str(metadata.text("settings")?)
        .map_err(|e| format!("has settings that this version does not know: {e}"))?;
    let checkpoint = Checkpoint {
        version: metadata.text("version")?.to_owned(),
        device: metadata.text("device")?.to_owned(),
        driver: metadata.text("driver")?.to_owned(),
        settings,
        views: metadata.parsed("views")?,
        views_fingerprint: metadata.hexadecimal("views_fingerprint")?,
        scene_extent: f32::from_bits(metadata.hexadecimal("scene_extent_bits")? as u32),
        iteration: metadata.parsed("iteration")?,
        optimizer_steps: metadata.parsed("optimizer_steps")?,
        opacity_steps: metadata.parsed("opacity_steps")?,
        densification_due: metadata.parsed("densification_due")?,
        opacity_reset_due: metadata.parsed("opacity_reset_due")?,
        gaussians: gaussians(&tensors, SETS[0])?,
        first_moments: gaussians(&tensors, SETS[1])?,
        second_moments: gaussians(&tensors, SETS[2])?,
        statistics: values(&tensors, "statistics", &[2])?,
        skipped: metadata.optional(SKIPPED)?.unwrap_or(0),
        room: Room {
            gaussians: metadata.parsed("room_gaussians")?,
            frame_gaussians: metadata.parsed("room_frame_gaussians")?,
            frame_instances: metadata.parsed("room_frame_instances")?,
            frame_width: metadata.parsed("room_frame_width")?,
            frame_height: metadata.parsed("room_frame_height")?,
            blend_passes: metadata.parsed("room_blend_passes")?,
            backward: metadata.parsed("room_backward")?,
            most_instances: metadata.parsed("most_instances")?,
            max_memory: metadata.optional(MAX_MEMORY)?,
        },
    };
    if !cfg!(fuzzing) && checkpoint.fingerprint() != metadata.hexadecimal("data_fingerprint")? {
        return Err("is damaged: its contents do not have the fingerprint that they were written with".into());
    }
    checkpoint.check_shapes().map_err(|e| e.to_string())?;
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

    /// None where there is none.
    fn optional<T: std::str::FromStr>(&self, name: &str) -> Result<Option<T>, String> {
        self.0.contains_key(name).then(|| self.parsed(name)).transpose()
    }

    fn hexadecimal(&self, name: &str) -> Result<u64, String> {
        let text = self.text(name)?;
        u64::from_str_radix(text, 16).map_err(|_| format!("has '{text}' as the metadata '{name}'"))
    }
}

/// The rows of a tensor of f32 with the shape [any, row...].
fn values<T: Pod>(tensors: &SafeTensors, name: &str, row: &[usize]) -> Result<Vec<T>, String> {
    let tensor = tensors.tensor(name).map_err(|_| format!("lacks the tensor '{name}'"))?;
    let fits = tensor.dtype() == Dtype::F32 && tensor.shape().get(1..) == Some(row);
    if !fits || row.iter().product::<usize>() * 4 != size_of::<T>() {
        return Err(format!("has a tensor '{name}' of {:?} {:?}", tensor.dtype(), tensor.shape()));
    }
    Ok(bytemuck::pod_collect_to_vec(tensor.data()))
}

fn gaussians(tensors: &SafeTensors, prefix: &str) -> Result<Gaussians, String> {
    let named = |name: &str| format!("{prefix}{name}");
    let sh_name = named("sh");
    let sh = tensors.tensor(&sh_name).map_err(|_| format!("lacks the tensor '{sh_name}'"))?;
    let degree = (0..=3).find(|&d| sh.shape().get(1..) == Some(&[sh_coefficients(d), 3]));
    let Some(sh_degree) = degree.filter(|_| sh.dtype() == Dtype::F32) else {
        return Err(format!("has a tensor '{sh_name}' of {:?} {:?}", sh.dtype(), sh.shape()));
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
