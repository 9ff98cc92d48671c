//! What the project stands on: licences, versions beside each other, sources, and versions that their authors have
//! taken back. What `cargo deny` looks at, as far as the files say that cargo has already.

use std::collections::{BTreeMap, BTreeSet};
use std::path::PathBuf;
use std::process::Command;

use serde_json::Value;
use spdx::{Expression, ParseMode};

use super::{assert_none, root};

/// Licences of which one must suffice: those that ask for no more than their own text.
const LICENCES: [&str; 10] = [
    "0BSD",
    "Apache-2.0",
    "BSD-2-Clause",
    "BSD-3-Clause",
    "ISC",
    "MIT",
    "MIT-0",
    "Unicode-3.0",
    "Unlicense",
    "Zlib",
];

/// Crates under another licence, and why that is no matter.
const OTHER_LICENCES: [(&str, &str, &str); 2] = [
    ("cbindgen", "MPL-2.0", "makes the C header in a test, and is in nothing that is built for users"),
    (
        "jpeg-encoder",
        "(MIT OR Apache-2.0) AND IJG",
        "makes JPEGs in tests, and is in nothing that is built for users",
    ),
];

/// Older versions of crates, and who needs them: one entry for each.
const OLDER_VERSIONS: [(&str, &str); 24] = [
    ("base64", "axum, for WebSockets"),
    ("bitflags", "ash-window, on macOS only"),
    ("block2", "winit, on macOS only"),
    ("cpufeatures", "sha1, for axum's WebSockets"),
    ("getrandom", "rand 0.9"),
    ("hashbrown", "safetensors"),
    ("jni-sys", "winit, on Android only"),
    ("linux-raw-sys", "rustix 0.38"),
    ("miniz_oxide", "png and exr"),
    ("objc2", "winit, on macOS only"),
    ("r-efi", "getrandom 0.3, on UEFI only"),
    ("rand", "tungstenite: tests and axum's WebSockets"),
    ("rand_chacha", "rand 0.9"),
    ("rand_core", "rand 0.9"),
    ("redox_syscall", "winit, on Redox only"),
    ("rustix", "winit"),
    ("syn", "cbindgen and zerocopy's macros"),
    ("thiserror", "winit"),
    ("thiserror-impl", "thiserror 1"),
    ("toml", "cbindgen"),
    ("toml_datetime", "cbindgen's toml"),
    ("windows-sys", "winit, on Windows only"),
    ("windows-sys", "rustix 0.38, on Windows only"),
    ("winnow", "cbindgen's toml"),
];

const CRATES_IO: &str = "registry+https://github.com/rust-lang/crates.io-index";

/// A locked package.
#[derive(Clone, Debug)]
struct Package {
    name: String,
    version: String,
    licence: String,
    /// None: the project's own.
    source: Option<String>,
}

impl Package {
    fn of(value: &Value) -> Package {
        let text = |key: &str| value[key].as_str().map(str::to_owned);
        Package {
            name: text("name").expect("a name"),
            version: text("version").expect("a version"),
            licence: text("license").unwrap_or_default(),
            source: text("source"),
        }
    }

    /// As a crate of crates.io.
    fn example(name: &str, version: &str, licence: &str) -> Package {
        let source = Some(CRATES_IO.to_owned());
        Package { name: name.into(), version: version.into(), licence: licence.into(), source }
    }
}

/// All packages of Cargo.lock, those of all features. Where the machine can neither download nor find the crates of other systems, those of
/// this one.
fn packages() -> Vec<Package> {
    let metadata = |more: &[&str]| {
        let mut cargo = Command::new(env!("CARGO"));
        cargo
            .current_dir(root())
            .args(["metadata", "--locked", "--format-version", "1", "--all-features"])
            .args(more);
        let output = cargo.output().expect("cargo");
        output.status.success().then(|| serde_json::from_slice::<Value>(&output.stdout).expect("JSON"))
    };
    let here = format!("{}-unknown-linux-gnu", std::env::consts::ARCH);
    let found = metadata(&["--offline"])
        .or_else(|| metadata(&[]))
        .or_else(|| metadata(&["--offline", "--filter-platform", &here]))
        .expect("cargo metadata --locked");
    found["packages"].as_array().expect("packages").iter().map(Package::of).collect()
}

fn bad_licences(packages: &[Package]) -> Vec<String> {
    let bad = |p: &Package| {
        if OTHER_LICENCES.iter().any(|(name, licence, _)| *name == p.name && *licence == p.licence) {
            return None;
        }
        // "MIT/Apache-2.0", as crates of old say it, is taken for "MIT OR Apache-2.0".
        let problem = match Expression::parse_mode(&p.licence, ParseMode::LAX) {
            Err(error) => error.reason.to_string(),
            Ok(all) => {
                let allowed = |id: &str| LICENCES.contains(&id);
                let suffices = all.evaluate(|r| r.license.id().is_some_and(|id| allowed(id.name)));
                if suffices {
                    return None;
                }
                "not on the list".to_owned()
            }
        };
        Some(format!("{} {}: licence '{}': {problem}", p.name, p.version, p.licence))
    };
    packages.iter().filter_map(bad).collect()
}

fn bad_sources(packages: &[Package]) -> Vec<String> {
    let known = |p: &&Package| p.source.as_deref().is_none_or(|source| source == CRATES_IO);
    let bad = packages.iter().filter(|p| !known(p));
    bad.map(|p| format!("{} {} comes from {:?}", p.name, p.version, p.source)).collect()
}

/// More versions of a crate than are explained, and explanations that nothing needs any more.
fn bad_versions(packages: &[Package]) -> Vec<String> {
    let mut versions: BTreeMap<&str, BTreeSet<&str>> = BTreeMap::new();
    for package in packages {
        versions.entry(&package.name).or_default().insert(&package.version);
    }
    let older = |name: &str| OLDER_VERSIONS.iter().filter(|(known, _)| *known == name).count();
    let many = versions.iter().filter(|(name, versions)| versions.len() > 1 + older(name));
    let many = many.map(|(name, versions)| format!("{name} has the versions {versions:?}"));
    let there = |name: &str| versions.get(name).map_or(0, BTreeSet::len);
    let idle = OLDER_VERSIONS.iter().filter(|(name, _)| there(name) < 1 + older(name));
    many.chain(idle.map(|(name, who)| format!("{name} has fewer versions: strike '{who}' off the list")))
        .collect()
}

/// Whether a version was taken back, by an entry of cargo's cache of the index: JSON between zeros. None: not there.
fn is_yanked(entry: &[u8], version: &str) -> Option<bool> {
    let records =
        entry.split(|&byte| byte == 0).filter_map(|part| serde_json::from_slice::<Value>(part).ok());
    let mut of_version = records.filter(|record| record["vers"].as_str() == Some(version));
    of_version.next()?["yanked"].as_bool()
}

/// Where the index keeps a crate.
fn index_path(name: &str) -> String {
    let name = name.to_lowercase();
    match name.len() {
        0..=2 => format!("{}/{name}", name.len()),
        3 => format!("3/{}/{name}", &name[..1]),
        _ => format!("{}/{}/{name}", &name[..2], &name[2..4]),
    }
}

/// Cargo's caches of indices.
fn index_caches() -> Vec<PathBuf> {
    let home = std::env::var_os("CARGO_HOME").map(PathBuf::from);
    let home = home.or_else(|| Some(PathBuf::from(std::env::var_os("HOME")?).join(".cargo")));
    let Some(Ok(folders)) = home.map(|home| std::fs::read_dir(home.join("registry/index"))) else {
        return Vec::new();
    };
    let caches = folders.filter_map(|folder| Some(folder.ok()?.path().join(".cache")));
    caches.filter(|cache| cache.is_dir()).collect()
}

#[test]
fn architecture_licences_of_dependencies_are_known() {
    let example = |licence: &str| bad_licences(&[Package::example("a", "1.0.0", licence)]).len();
    assert_eq!(["GPL-3.0-only", "MIT AND MPL-2.0", "", "nonsense", "MPL-2.0"].map(example), [1; 5]);
    assert_eq!(
        ["MIT/Apache-2.0", "GPL-3.0-only OR Zlib", "(MIT OR ISC) AND Unicode-3.0"].map(example),
        [0; 3]
    );
    let packages = packages();
    assert!(packages.len() > 100, "{}", packages.len());
    assert_none("a licence needs a reason", bad_licences(&packages));
    for (name, licence, _) in OTHER_LICENCES {
        let there = packages.iter().any(|p| p.name == name && p.licence == licence);
        assert!(there, "{name} is not under {licence}: strike it off the list");
    }
}

#[test]
fn architecture_dependencies_come_from_crates_io_in_one_version_each() {
    let mut examples =
        vec![Package::example("serde", "1.0.0", "MIT"), Package::example("serde", "2.0.0", "MIT")];
    assert!(bad_versions(&examples).iter().any(|problem| problem.starts_with("serde has the versions")));
    assert!(bad_versions(&examples).iter().any(|problem| problem.starts_with("syn has fewer versions")));
    assert_eq!(bad_sources(&examples), Vec::<String>::new());
    examples[0].source = Some("git+https://example.org/serde".into());
    assert_eq!(bad_sources(&examples).len(), 1);
    let packages = packages();
    assert_none("only crates.io", bad_sources(&packages));
    assert_none("a second version needs a reason", bad_versions(&packages));
}

/// As of the last time when cargo looked at the index.
#[test]
fn architecture_no_dependency_was_taken_back() {
    let entry = b"\x03\x02\0\0\0etag\x001.0.0\0{\"vers\": \"1.0.0\", \"yanked\": true}\x001.0.1\0{\"vers\": \"1.0.1\", \"yanked\": false}\0";
    assert_eq!(["1.0.0", "1.0.1", "1.0.2"].map(|v| is_yanked(entry, v)), [Some(true), Some(false), None]);
    assert_eq!(["ab", "mio", "Serde"].map(index_path), ["2/ab", "3/m/mio", "se/rd/serde"]);
    let caches = index_caches();
    let entry =
        |p: &Package| caches.iter().find_map(|cache| std::fs::read(cache.join(index_path(&p.name))).ok());
    let (mut known, mut yanked) = (0, Vec::new());
    for package in packages().iter().filter(|package| package.source.is_some()) {
        match entry(package).and_then(|entry| is_yanked(&entry, &package.version)) {
            Some(true) => yanked.push(format!("{} {}", package.name, package.version)),
            Some(false) => known += 1,
            None => {}
        }
    }
    eprintln!("{known} crates are known to the index cache");
    assert_none("taken back by their authors", yanked);
    // Where crates come from a folder beside the project, there is no index.
    assert!(known > 100 || caches.is_empty(), "{known} crates in {caches:?}");
}
