//! Small files that claim much: what is refused, and that it is refused before memory is reserved.

use std::path::Path;
use std::sync::PoisonError;

use ashsplat::Error;
use ashsplat::scene::Gaussians;
use image::codecs::jpeg::JpegEncoder;

use super::{Cost, TURN};
use crate::HostMemory;
use crate::dataset::{Dataset, DatasetOptions};
use crate::images::{Photo, PhotoFileFormat};
use crate::progress::Progress;
use crate::splats::{self, ReadOptions, WriteOptions};

/// A picture with much detail, as a baseline JPEG.
fn jpeg(width: u32, height: u32) -> Vec<u8> {
    let value = |index: u32| (index.wrapping_mul(2_654_435_761) >> 24) as u8;
    let pixels: Vec<u8> = (0..3 * width * height).map(value).collect();
    let mut bytes = Vec::new();
    JpegEncoder::new_with_quality(&mut bytes, 90)
        .encode(&pixels, width, height, image::ExtendedColorType::Rgb8)
        .unwrap();
    bytes
}

/// Writes another size into the header of a JPEG.
fn claim(bytes: &mut [u8], width: u16, height: u16) {
    let frame = bytes.windows(2).position(|w| w == [0xff, 0xc0]).unwrap();
    bytes[frame + 5..frame + 7].copy_from_slice(&height.to_be_bytes());
    bytes[frame + 7..frame + 9].copy_from_slice(&width.to_be_bytes());
}

fn read(path: &Path, bytes: &[u8]) -> Result<Photo, String> {
    std::fs::write(path, bytes).unwrap();
    Photo::read(path, [0.0; 3]).map_err(|error| error.to_string())
}

#[test]
fn a_jpeg_of_a_few_bytes_is_no_large_picture() {
    let _turn = TURN.lock().unwrap_or_else(PoisonError::into_inner);
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.jpg");
    let mut bytes = jpeg(16, 16);
    assert!(read(&path, &bytes).is_ok());
    claim(&mut bytes, 20_000, 20_000);
    let (cost, result) = Cost::of(|| read(&path, &bytes));
    assert!(result.unwrap_err().contains("claims 20000x20000 pixels in "));
    assert!(cost.bytes < 4 << 20, "{cost:?}");
}

/// What cameras leave behind the end does no harm; what is in the middle of the data does.
#[test]
fn damaged_jpegs_are_found() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.jpg");
    let whole = jpeg(160, 120);
    assert!(read(&path, &[&whole[..], b"\0\0\0 a preview"].concat()).is_ok());
    let mut damaged = whole.clone();
    let middle = whole.len() / 2;
    // A table of the quantisation where pictures have none.
    damaged[middle..middle + 4].copy_from_slice(&[0xff, 0xdb, 0, 2]);
    assert!(read(&path, &damaged).is_err_and(|message| message.contains("cannot be decoded")));
    for part in 1..10 {
        assert!(read(&path, &whole[..whole.len() * part / 10]).is_err());
    }
}

#[test]
fn photos_beyond_the_bound_are_refused_before_they_are_decoded() {
    let _turn = TURN.lock().unwrap_or_else(PoisonError::into_inner);
    let folder = tempfile::tempdir().unwrap();
    std::fs::create_dir(folder.path().join("images")).unwrap();
    let photo = Photo { width: 4000, height: 3000, rgb: vec![9; 36_000_000] };
    photo.write_png(folder.path().join("images/a.png")).unwrap();
    let pose = "[[1,0,0,0],[0,1,0,0],[0,0,1,0]]";
    let frames = format!("[{{\"file_path\": \"images/a.png\", \"transform_matrix\": {pose}}}]");
    let text = format!("{{\"fl_x\": 3000, \"frames\": {frames}}}");
    std::fs::write(folder.path().join("transforms.json"), text).unwrap();
    let load = |bytes: u64| {
        let options = DatasetOptions { host_memory: HostMemory::new(bytes), ..Default::default() };
        Dataset::load(folder.path(), &options, Progress::NONE)
    };
    let (cost, refused) = Cost::of(|| load(30 << 20));
    let message = refused.unwrap_err().to_string();
    assert!(
        message.contains("images/a.png: reading it needs ") && message.contains("--max-host-memory"),
        "{message}"
    );
    assert!(cost.bytes < 4 << 20, "{cost:?}");
    assert_eq!(load(60 << 20).unwrap().train.len(), 1);
}

#[test]
fn scenes_beyond_the_bound_are_refused_before_they_are_read() {
    let _turn = TURN.lock().unwrap_or_else(PoisonError::into_inner);
    let folder = tempfile::tempdir().unwrap();
    let count = 200_000;
    let gaussians = Gaussians {
        sh_degree: 3,
        means: (0..count as u32).map(|i| [i.wrapping_mul(2_654_435_761) as f32 * 1e-7, 0.0, 1.0]).collect(),
        quats: vec![[1.0, 0.0, 0.0, 0.0]; count],
        log_scales: vec![[-3.0; 3]; count],
        opacity_logits: vec![0.5; count],
        sh: vec![[0.1; 3]; 16 * count],
    };
    for name in ["a.spz", "a.ply", "a.glb"] {
        let path = folder.path().join(name);
        splats::write(&path, &gaussians, &WriteOptions::default()).unwrap();
        let options = ReadOptions { max_host_memory: Some(10 << 20), ..Default::default() };
        let (cost, refused) = Cost::of(|| splats::read(&path, &options));
        assert!(matches!(refused, Err(Error::TooLarge { limit: 10_485_760, .. })), "{refused:?}");
        assert!(cost.bytes < 8 << 20, "{name}: {cost:?}");
        let options = ReadOptions { max_host_memory: Some(100 << 20), ..Default::default() };
        assert_eq!(splats::read(&path, &options).unwrap().gaussians.len(), count);
    }
}

/// One encoder is open at a time, and the packed Gaussians are not in memory.
#[test]
fn writing_spz_takes_little_memory() {
    let _turn = TURN.lock().unwrap_or_else(PoisonError::into_inner);
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.spz");
    let gaussians = Gaussians {
        sh_degree: 3,
        means: (0..100_000).map(|i| [i as f32 * 1e-3, 0.0, 1.0]).collect(),
        quats: vec![[1.0, 0.0, 0.0, 0.0]; 100_000],
        log_scales: vec![[-3.0; 3]; 100_000],
        opacity_logits: vec![0.5; 100_000],
        sh: vec![[0.1; 3]; 1_600_000],
    };
    let resident = || {
        let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
        let line = status.lines().find_map(|line| line.strip_prefix("VmHWM:")).unwrap_or_default();
        line.trim().trim_end_matches(" kB").parse::<u64>().unwrap_or_default() >> 10
    };
    // The encoders' memory is that of a library in C: the system counts it. Its peak begins anew here.
    if std::fs::write("/proc/self/clear_refs", "5").is_err() {
        return;
    }
    let before = resident();
    splats::write(&path, &gaussians, &WriteOptions::default()).unwrap();
    let peak = resident() - before.min(resident());
    assert!(peak < 100, "{peak} MiB");
}
