//! Small files with large claims are refused before memory is reserved.

use super::{Cost, alone, gaussians};
use crate::HostMemory;
use crate::dataset::{Dataset, DatasetOptions};
use crate::images::{Photo, PhotoFileFormat, PhotoMemory, Resolution};
use crate::progress::Progress;
use crate::splats::{self, ConvertOptions, ReadOptions, WriteOptions};
use crate::tiles::Tree;
use crate::transforms::Transforms;
use ashsplat::Error;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use std::io::Write;
use std::path::Path;

#[test]
fn photos_beyond_the_bound_are_refused_before_they_are_decoded() {
    let (_turn, folder, _) = alone("");
    std::fs::create_dir(folder.path().join("images")).unwrap();
    let photo = Photo { width: 4000, height: 3000, rgb: vec![9; 36_000_000] };
    photo.write_png(folder.path().join("images/a.png")).unwrap();
    let pose = "[[1,0,0,0],[0,1,0,0],[0,0,1,0]]";
    let frames = format!("[{{\"file_path\": \"images/a.png\", \"transform_matrix\": {pose}}}]");
    let text = format!("{{\"fl_x\": 3000, \"frames\": {frames}}}");
    std::fs::write(folder.path().join("transforms.json"), text).unwrap();
    let load = |bytes: u64, resolution: Resolution, photo_memory: Option<PhotoMemory>| {
        let host_memory = HostMemory::new(bytes);
        let options = DatasetOptions { host_memory, resolution, photo_memory, ..Default::default() };
        Dataset::load(folder.path(), &options, Progress::NONE)
    };
    let says = |refused: ashsplat::Result<Dataset>, words: &str| {
        let message = refused.unwrap_err().to_string();
        assert!(message.contains(words) && message.contains("--max-host-memory"), "{message}");
    };
    let whole = Resolution::Factor(1);
    // Four bytes per pixel stay in memory, or none if there is a file for them.
    let (cost, refused) = Cost::of(|| load(30 << 20, whole, None));
    says(
        refused,
        "transforms.json: keeping its 1 photos in memory (-r makes them smaller) needs 48000000 bytes",
    );
    assert!(cost.bytes < 4 << 20, "{cost:?}");
    says(load(60 << 20, whole, None), "what --max-host-memory leaves beside the photos kept");
    let in_a_file = || Some(PhotoMemory { bytes: u64::MAX, folder: folder.path().into() });
    let (cost, refused) = Cost::of(|| load(30 << 20, whole, in_a_file()));
    says(refused, "images/a.png: reading it needs ");
    assert!(cost.bytes < 4 << 20, "{cost:?}");
    let loaded = load(60 << 20, whole, in_a_file()).unwrap();
    assert!(loaded.train[0].photo.file().is_some());
    assert!(loaded.warnings.iter().any(|w| w.contains("kept in a file")));
    assert!(load(100 << 20, whole, None).unwrap().train[0].photo.file().is_none());
    // At a smaller size, the reader needs only rows.
    assert_eq!(load(12 << 20, Resolution::Width(400), None).unwrap().train[0].photo.width, 400);
}

#[test]
fn scenes_beyond_the_bound_are_refused_before_they_are_read() {
    let (_turn, folder, _) = alone("");
    let count = 200_000;
    let gaussians = gaussians(count, 3);
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

/// A file holds as many short values as fit: each would be 24 to 630 bytes of a `serde_json::Value`.
#[test]
fn json_takes_little_memory() {
    const BYTES: usize = 4 << 20;
    let (_turn, folder, _) = alone("");
    let path = |name: &str| folder.path().join(name);
    let write = |name: &str, head: &str, unit: &str, tail: &str| {
        let text = format!("{head}{}{tail}", unit.repeat(BYTES / unit.len()));
        std::fs::write(path(name), text).unwrap();
    };
    let pose = "[[1,0,0,0],[0,1,0,0],[0,0,1,0]]";
    let frame = format!("{{\"file_path\": \"a.png\", \"transform_matrix\": {pose}}}");
    Photo { width: 4, height: 2, rgb: vec![9; 24] }.write_png(path("a.png")).unwrap();
    let files = [path("transforms.json")];
    let tile = "{\"refine\":\"REPLACE\",\"geometricError\":1,\"content\":{\"uri\":\"a.spz\"},\"extras\":{\"gaussians\":1},\
                \"boundingVolume\":{\"box\":[0,0,0,1,0,0,0,1,0,0,0,1]}}";
    for unit in ["[],", "{\"\":{}},", "0,"] {
        write("transforms.json", "{\"fl_x\":9,\"x\":[", unit, &format!("0],\"frames\":[{frame}]}}"));
        let peak = peak_mib(|| assert_eq!(Transforms::read(&files).unwrap().frames.len(), 1));
        assert!(peak < 24, "a list of {unit} in the file: {peak} MiB");
        let frame = format!("{},\"x\":[", frame.trim_end_matches('}'));
        write("transforms.json", &format!("{{\"fl_x\":9,\"frames\":[{frame}"), unit, "0]}]}");
        let peak = peak_mib(|| assert_eq!(Transforms::read(&files).unwrap().frames.len(), 1));
        assert!(peak < 24, "a list of {unit} in a frame: {peak} MiB");
        write("tileset.json", "{\"x\":[", unit, &format!("0],\"root\":{tile}}}"));
        let peak = peak_mib(|| assert_eq!(Tree::open(folder.path()).unwrap().tiles().len(), 1));
        assert!(peak < 24, "a tree with {unit}: {peak} MiB");
    }
    let read = |options: &ReadOptions| splats::read(path("a.gltf"), options).map(drop).unwrap_err();
    for unit in ["{},", "{\"x\":[{}]},", "{\"children\":[]},"] {
        write("a.gltf", "{\"nodes\":[", unit, "{}]}");
        let peak = peak_mib(|| {
            let message = read(&ReadOptions::default()).to_string();
            assert!(message.contains("has no Gaussians"), "{message}");
        });
        assert!(peak < 64, "nodes {unit}: {peak} MiB");
        let (cost, refused) =
            Cost::of(|| read(&ReadOptions { max_host_memory: Some(20 << 20), ..Default::default() }));
        assert!(matches!(refused, Error::TooLarge { limit: 20_971_520, .. }), "{refused}");
        assert!(cost.bytes < 12 << 20, "{unit}: {cost:?}");
    }
}

/// Only one encoder is open at a time, and the packed Gaussians are not kept in memory.
#[test]
fn writing_spz_takes_little_memory() {
    let (_turn, _folder, path) = alone("a.spz");
    let scene = gaussians(100_000, 3);
    let peak = peak_mib(|| drop(splats::write(&path, &scene, &WriteOptions::default()).unwrap()));
    assert!(peak < 60, "{peak} MiB");
}

/// Peak memory of `work`, MiB, from the system, so that C libraries count. 0 if the system does not report it.
pub(super) fn peak_mib(work: impl FnOnce()) -> u64 {
    let kib = |name: &str| {
        let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
        let line = status.lines().find_map(|line| line.strip_prefix(name)).unwrap_or_default();
        line.trim().trim_end_matches(" kB").parse::<u64>().unwrap_or_default()
    };
    // Resets the peak.
    if std::fs::write("/proc/self/clear_refs", "5").is_err() {
        return 0;
    }
    let before = kib("VmRSS:");
    work();
    kib("VmHWM:").saturating_sub(before) >> 10
}

/// Writes an SPZ of version 2 in one gzip stream: random positions, all other values 0.
fn old_spz(path: &Path, count: u32, flags: u8, behind: &[u8]) {
    let file = std::fs::File::create(path).unwrap();
    let mut stream = flate2::write::GzEncoder::new(file, flate2::Compression::fast());
    for word in [0x5053_474e, 2, count] {
        stream.write_all(&u32::to_le_bytes(word)).unwrap();
    }
    stream.write_all(&[3, 12, flags, 0]).unwrap();
    let mut random = ChaCha8Rng::seed_from_u64(7);
    let means: Vec<u8> = (0..9 * count).map(|_| random.random()).collect();
    stream.write_all(&means).unwrap();
    let zeros = vec![0; count as usize];
    (9..64).for_each(|_| stream.write_all(&zeros).unwrap());
    stream.write_all(behind).unwrap();
    stream.finish().unwrap();
}

/// The reader unpacks one block of each plane at a time, whatever the unpacked size.
#[test]
fn reading_spz_takes_little_memory() {
    let (_turn, folder, _) = alone("");
    let [old, new, out] = ["old.spz", "new.spz", "out.splat"].map(|name| folder.path().join(name));
    let count = 1_500_000;
    old_spz(&old, count, 0, &[]);
    let convert = |from: &Path, to: &Path| {
        let done = splats::convert(from, to, &ConvertOptions::default()).unwrap();
        assert_eq!(done.written, u64::from(count));
    };
    // 96 MB of planes.
    let peaks = [(&old, &out), (&old, &new), (&new, &out)].map(|(from, to)| peak_mib(|| convert(from, to)));
    assert!(peaks.iter().all(|&mib| mib < 50), "{peaks:?} MiB");
}

#[test]
fn damaged_old_spz_are_found() {
    let (_turn, _folder, path) = alone("a.spz");
    let read = || splats::read(&path, &ReadOptions::default()).map_err(|error| error.to_string());
    for count in [1, 20_000] {
        old_spz(&path, count, 0, &[]);
        assert_eq!(read().unwrap().gaussians.len() as u32, count);
        let bytes = std::fs::read(&path).unwrap();
        for cut in [1, 4, 8, 9, 20] {
            std::fs::write(&path, &bytes[..bytes.len() - cut]).unwrap();
            let message = read().unwrap_err();
            assert!(message.contains("the compressed data are damaged") || count == 1, "{cut}: {message}");
        }
        old_spz(&path, count, 0, &[0]);
        assert!(read().unwrap_err().contains("holds more data than its"));
        // An extension after the planes, which says that the axes are left, up, back.
        let axes = [0xadbe_0003_u32, 4, 3].map(u32::to_le_bytes).concat();
        for (flags, extra) in [(2, &axes[..]), (2, &[])] {
            old_spz(&path, count, flags, extra);
            assert_eq!(read().unwrap().gaussians.len() as u32, count);
        }
        old_spz(&path, count, 2, &axes[..9]);
        assert!(read().unwrap_err().contains("an extension in its header is longer"));
    }
}
