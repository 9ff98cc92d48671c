//! Files are written whole or not at all.

use super::files::{Folder, assert_says, names, refusal};
use ashsplat::scene::Gaussians;
use ashsplat_files::atomic;
use ashsplat_files::splats::{self, Format, WriteOptions};
use std::io::Error;

#[test]
fn a_failing_writer_leaves_the_old_file_and_nothing_else() {
    let (folder, path) = Folder::with("scene.ply");
    atomic::write(&path, |w| w.write_all(b"old")).unwrap();
    let error = atomic::write(&path, |w| {
        w.write_all(&[0; 3 << 20])?;
        Err(Error::other("disk full"))
    });
    let message = error.unwrap_err().to_string();
    assert_eq!(message, format!("{}: cannot write: disk full", path.display()));
    assert_eq!(names(&folder), ["scene.ply"]);
    assert_eq!(std::fs::read(&path).unwrap(), b"old");
}

#[test]
fn a_panicking_writer_leaves_nothing() {
    let (folder, path) = Folder::with("scene.ply");
    let result = std::panic::catch_unwind(|| atomic::write(&path, |_| panic!("on purpose")));
    assert!(result.is_err());
    assert_eq!(names(&folder), [""; 0]);
}

fn write_scene(path: &std::path::Path) -> ashsplat::Result<Option<String>> {
    let options = WriteOptions { format: Some(Format::Ply), ..Default::default() };
    splats::write(path, &Gaussians::default(), &options)
}

#[test]
fn missing_folders_and_folders_in_the_way_are_named() {
    let (folder, path) = Folder::with("no/such/scene.ply");
    let message = refusal(&path, write_scene(&path));
    assert_says(&message, &["scene.ply: cannot write: "]);
    assert!(!message.contains(".tmp\""), "{message}");
    refusal(&folder, write_scene(&folder));
    assert_eq!(names(&folder), [""; 0]);
    assert!(write_scene("".as_ref()).is_err());
}

#[test]
fn a_new_file_replaces_a_longer_one() {
    let (folder, path) = Folder::with("a");
    for text in ["a long text", "short"] {
        atomic::write(&path, |w| w.write_all(text.as_bytes())).unwrap();
        assert_eq!(std::fs::read_to_string(&path).unwrap(), text);
    }
    atomic::create_folder(folder.join("b/c")).unwrap();
    atomic::create_folder(folder.join("b/c")).unwrap();
    let below = path.join("below a file");
    assert_says(refusal(&below, atomic::create_folder(&below)), &["cannot create: "]);
}

#[cfg(target_os = "linux")]
#[test]
fn a_full_disk_is_named() {
    let full = std::path::Path::new("/dev/full");
    if !full.exists() {
        return eprintln!("skipped: no /dev/full");
    }
    let message = write_scene(full).unwrap_err().to_string();
    assert!(message.starts_with("/dev/full: cannot write: No space left"), "{message}");
    assert!(std::fs::metadata(full).is_ok_and(|m| !m.is_file()));
}

#[cfg(unix)]
#[test]
fn permissions_are_usual_and_links_are_followed() {
    use std::os::unix::fs::{PermissionsExt, symlink};
    let folder = Folder::new();
    let [plain, written, link] = ["plain", "written", "link"].map(|name| folder.join(name));
    std::fs::write(&plain, "x").unwrap();
    atomic::write(&written, |w| w.write_all(b"x")).unwrap();
    let mode = |path: &std::path::Path| std::fs::metadata(path).unwrap().permissions().mode();
    assert_eq!(mode(&plain), mode(&written));
    symlink("written", &link).unwrap();
    atomic::write(&link, |w| w.write_all(b"through the link")).unwrap();
    assert!(std::fs::symlink_metadata(&link).unwrap().is_symlink());
    assert_eq!(std::fs::read(&written).unwrap(), b"through the link");
}
