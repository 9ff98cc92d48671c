//! Lists of values by photograph names: exposures, parameters of depth maps; and names of weights.

use super::assert_linear;
use super::colmap::write_model;
use crate::dataset::{Dataset, DatasetOptions};
use crate::depth_fit::{DEPTH_PARAMS_FILE, DepthFit};
use crate::exposure_json;
use crate::host_memory::HostMemory;
use crate::images::{DepthMap, Photo, PhotoFileFormat};
use crate::lens_json::LensFile;
use crate::lpips_weights;
use crate::photogrammetry;
use crate::progress::Progress;
use ashsplat::scene::{Exposure, LensEffects};
use image::{ImageBuffer, Luma};
use serde_json::{Map, Value, json};
use std::collections::BTreeMap;
use std::path::Path;

/// Exposures and parameters of depth maps by name, and lenses of photographs with a camera each.
#[test]
fn values_of_many_photographs() {
    let exposures = |folder: &Path, size: usize| {
        let names: Vec<String> = (0..size).map(|index| format!("photo {index}.jpg")).collect();
        let exposure = Exposure::default();
        let all = names.iter().map(|name| (&**name, &exposure));
        exposure_json::write(folder.join("exposure.json"), all).unwrap();
    };
    assert_linear(2000, exposures, |folder| {
        assert!(exposure_json::read(folder.join("exposure.json")).unwrap().len() >= 2000);
    });
    let lenses = |folder: &Path, size: usize| {
        let size = size as u32;
        let cameras = (0..size).map(|id| (id, LensEffects::default())).collect();
        let photos = (0..size).map(|id| (format!("photo {id}.jpg"), id)).collect();
        LensFile { cameras, photos }.write(folder.join("lens.json")).unwrap();
    };
    assert_linear(2000, lenses, |folder| {
        assert!(LensFile::read(folder.join("lens.json")).unwrap().photos.len() >= 2000);
    });
    let depths = |folder: &Path, size: usize| {
        let fit = json!({"scale": 1.5, "offset": 0.1});
        let all: BTreeMap<String, Value> =
            (0..size).map(|index| (format!("photo {index}"), fit.clone())).collect();
        std::fs::write(folder.join(DEPTH_PARAMS_FILE), serde_json::to_vec(&all).unwrap()).unwrap();
    };
    assert_linear(2000, depths, |folder| {
        assert!(DepthFit::read_all(folder.join(DEPTH_PARAMS_FILE)).unwrap().len() >= 2000);
    });
}

/// Cameras of many photographs in the files of Metashape and RealityScan.
#[test]
fn cameras_of_photogrammetry_programs() {
    let xml = |index: usize| {
        format!(
            "<camera sensor_id='0' label='{index}'><transform>1 0 0 {index} 0 1 0 0 0 0 1 0 0 0 0 1</transform></camera>"
        )
    };
    let csv = |index: usize| format!("{index}.png,{index},2,3,0,0,0,36\n");
    let write = |folder: &Path, size: usize| {
        let cameras: String = (0..size).map(xml).collect();
        let text = format!(
            "<document><chunk><sensors><sensor id='0'><resolution width='4' height='3'/><calibration><f>4</f></calibration></sensor>\
             </sensors><cameras>{cameras}</cameras></chunk></document>"
        );
        std::fs::write(folder.join("cameras.xml"), text).unwrap();
        let rows: String = (0..size).map(csv).collect();
        std::fs::write(folder.join("cameras.csv"), format!("#name,x,y,alt,heading,pitch,roll,f\n{rows}"))
            .unwrap();
    };
    assert_linear(2000, write, |folder| {
        let sources = photogrammetry::find(folder, "images");
        assert_eq!(sources.len(), 2);
        for source in sources {
            let model = photogrammetry::read(&source, folder, &mut |_| Ok((4, 3))).unwrap();
            assert!(model.images.len() >= 2000);
        }
    });
}

/// Photographs with sparse points and a map that is fitted to them.
#[test]
fn depth_maps_of_many_photographs_with_many_points() {
    let write = |folder: &Path, size: usize| {
        ["images", "depth"].iter().for_each(|name| std::fs::create_dir_all(folder.join(name)).unwrap());
        let (mut images, mut points) = (String::new(), String::new());
        for id in 1..=size {
            let seen: String = (0..20).map(|k| format!("{} 1.5 {} ", f64::from(k) * 0.35, k + 1)).collect();
            images += &format!("{id} 1 0 0 0 {id} 0 0 1 {id}.png\n{seen}\n");
            Photo { width: 8, height: 4, rgb: vec![9; 96] }
                .write_png(folder.join(format!("images/{id}.png")))
                .unwrap();
            let map = ImageBuffer::from_fn(8, 4, |x, _| Luma([1000 * x as u16]));
            map.save(folder.join(format!("depth/{id}.png"))).unwrap();
        }
        for id in 1..=20 {
            points += &format!("{id} 0 0 {} 1 2 3 0.5 1 0\n", 2 + id);
        }
        write_model(&folder.join("sparse/0"), "1 PINHOLE 8 4 8 8 4 2\n", &images, &points);
    };
    assert_linear(20, write, |folder| {
        let options = DatasetOptions { depths: Some("depth".into()), ..DatasetOptions::default() };
        let dataset = Dataset::load(folder, &options, Progress::NONE).unwrap();
        assert!(dataset.train.iter().all(|view| view.inverse_depth.is_some()), "{:?}", dataset.warnings);
    });
}

/// One map with more and more pixels, as large as its photograph and smaller.
#[test]
fn depth_maps_of_many_pixels() {
    let write = |folder: &Path, size: usize| {
        let map = ImageBuffer::from_fn(320, size as u32, |x, y| Luma([((x * y * 40_503) >> 3) as u16]));
        map.save(folder.join("depth.png")).unwrap();
    };
    for scale in [1, 3] {
        assert_linear(60, write, |folder| {
            let map = DepthMap::read(folder.join("depth.png"), &HostMemory::default()).unwrap();
            let photo = map.resized(scale * map.width, scale * map.height);
            assert_eq!(photo.values.len(), (scale * scale * map.width * map.height) as usize);
        });
    }
}

/// A file of many unwanted tensors. The weights of a network would dominate it.
#[test]
fn weights_among_many_tensors() {
    let write = |folder: &Path, size: usize| {
        let mut header = Map::new();
        let mut tensor = |name: String, shape: &[usize], place: [usize; 2]| {
            header.insert(name, json!({"dtype": "F32", "shape": shape, "data_offsets": place}));
        };
        let bytes = 4 * 64 * 3 * 11 * 11;
        tensor("net.0.weight".into(), &[64, 3, 11, 11], [0, bytes]);
        (0..size).for_each(|index| tensor(format!("net.slice1.{index}.other"), &[0], [bytes, bytes]));
        let header = Value::Object(header).to_string().into_bytes();
        let mut file = (header.len() as u64).to_le_bytes().to_vec();
        file.extend(header);
        // Weights that are all zero are refused.
        file.resize(file.len() + bytes, 0x3c);
        std::fs::write(folder.join("weights.safetensors"), file).unwrap();
    };
    assert_linear(2000, write, |folder| {
        let read = lpips_weights::read(folder.join("weights.safetensors"), &HostMemory::default());
        assert!(read.err().unwrap().to_string().contains("'net.0.bias'"));
    });
}
