//! Arbitrary bytes as the cameras of Metashape (XML) or RealityScan (CSV, XMP).
#![no_main]

use ashsplat_files::{Dataset, DatasetOptions, HostMemory, Photo, PhotoFileFormat, Progress};
use ashsplat_fuzz::{folder, in_one_line, leave_seed, within};
use libfuzzer_sys::fuzz_target;
use std::path::PathBuf;
use std::sync::LazyLock;

static FOLDER: LazyLock<PathBuf> = LazyLock::new(|| folder("photogrammetry"));

const FILES: [(&str, &str); 3] = [
    (
        "cameras.xml",
        "<document><chunk><sensors><sensor id='0'><resolution width='4' height='3'/><calibration type='frame' class='adjusted'>\
         <f>9.5</f><cx>0.5</cx><k1>0.01</k1></calibration></sensor></sensors><components><component id='0'><transform>\
         <rotation>1 0 0 0 1 0 0 0 1</rotation><translation>1 2 3</translation><scale>2</scale></transform></component></components>\
         <cameras><camera id='0' sensor_id='0' component_id='0' label='a'><transform>1 0 0 0 0 1 0 0 0 0 1 0 0 0 0 1</transform>\
         </camera></cameras></chunk></document>",
    ),
    (
        "cameras.csv",
        "#name,x,y,alt,heading,pitch,roll,f,px,py,k1,k2,k3,k4,t1,t2\na.png,1,2,3,90,45,0,36,0.01,0,0.01,0,0,0.001,0,0\n",
    ),
    (
        "images/a.xmp",
        "<r xmlns:x='http://www.capturingreality.com/ns/xcr/1.1#'><Description x:DistortionModel='brown3' x:FocalLength35mm='36'>\
         <x:Rotation>1 0 0 0 1 0 0 0 1</x:Rotation><x:Position>1 2 3</x:Position></Description></r>",
    ),
];

fn seeds() {
    std::fs::create_dir_all(FOLDER.join("images")).expect("a folder");
    Photo { width: 4, height: 3, rgb: vec![9; 36] }.write_png(FOLDER.join("images/a.png")).expect("a photo");
    for (index, (_, text)) in (0..).zip(FILES) {
        leave_seed(&format!("file {index}"), &[&[index], text.as_bytes()].concat());
    }
}

fuzz_target!(init: seeds(), |data: &[u8]| {
    let [kind, bytes @ ..] = data else { return };
    let path = FOLDER.join(FILES[usize::from(*kind) % FILES.len()].0);
    std::fs::write(&path, bytes).expect("written");
    within(bytes.len(), |bound| {
        let options = DatasetOptions { host_memory: HostMemory::new(bound), ..DatasetOptions::default() };
        in_one_line(Dataset::load(&*FOLDER, &options, Progress::default()));
    });
    std::fs::remove_file(path).expect("there");
});
