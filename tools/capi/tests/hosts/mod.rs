//! Compiles and runs programs in C.

use std::path::{Path, PathBuf};
use std::process::{Command, Output};

pub fn folder() -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR"))
}

/// The newest library with this ending that cargo has built.
pub fn library(ending: &str) -> PathBuf {
    let executable = std::env::current_exe().expect("a path");
    let deps = executable.parent().expect("deps");
    let places = [deps.parent().expect("the profile"), deps];
    let files = places.iter().flat_map(|place| std::fs::read_dir(place).expect("a folder").flatten());
    let ours = files.filter(|file| {
        let name = file.file_name().to_string_lossy().into_owned();
        name.starts_with("libashsplat_c") && name.ends_with(ending)
    });
    let newest = ours.max_by_key(|file| file.metadata().and_then(|m| m.modified()).expect("a time"));
    newest.expect("a library: cargo build --release -p ashsplat-capi").path()
}

/// A path as an argument of the compiler.
pub fn argument(path: &Path) -> String {
    path.to_str().expect("UTF-8").to_owned()
}

pub fn compile(source: &Path, program: &Path, link: &[String]) {
    let mut cc = Command::new(std::env::var_os("CC").unwrap_or_else(|| "cc".into()));
    cc.args(["-std=c11", "-Wall", "-Wextra", "-Wredundant-decls", "-Werror", "-pedantic"]);
    cc.arg("-I").arg(folder()).arg(source).arg("-o").arg(program).args(link);
    let output = cc.output().expect("a C compiler");
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
}

pub fn run(program: &Path, arguments: &[&Path]) -> Output {
    Command::new(program).args(arguments).output().expect("a program")
}

/// Compiles a program in C and runs one of its trials. Returns its output, which must be free of validation messages.
pub fn host_in_c(name: &str, trial: &str, arguments: &[&Path]) -> String {
    host_with(name, "", &[&[Path::new(trial)][..], arguments].concat())
}

/// Compiles and runs a program in C that includes `included.c` with this text, under validation if the layer is installed.
pub fn host_output(name: &str, included: &str, arguments: &[&Path]) -> String {
    let folder = tempfile::tempdir().expect("a folder");
    let program = folder.path().join(name);
    std::fs::write(folder.path().join("included.c"), included).expect("written");
    let link = [argument(&library(".so")), "-ldl".into(), "-I".into(), argument(folder.path())];
    compile(&self::folder().join(format!("tests/{name}.c")), &program, &link);
    let mut command = Command::new(&program);
    // The layer prints messages into the program's output.
    command
        .env("VK_INSTANCE_LAYERS", "VK_LAYER_KHRONOS_validation")
        .env("VK_LAYER_ENABLES", "VK_VALIDATION_FEATURE_ENABLE_SYNCHRONIZATION_VALIDATION_EXT")
        .env("VK_VALIDATION_VALIDATE_SYNC", "1");
    let output = command.args(arguments).output().expect("a program");
    let (said, failed) = (String::from_utf8_lossy(&output.stdout), String::from_utf8_lossy(&output.stderr));
    assert!(output.status.success(), "{:?}: {said}{failed}", output.status);
    said.into_owned()
}

/// The validation layer's names of its messages.
pub const MESSAGES: [&str; 2] = ["Validation Error", "Validation Warning"];

/// Returns the output of a host in C, which must be free of validation messages.
pub fn host_with(name: &str, included: &str, arguments: &[&Path]) -> String {
    let said = host_output(name, included, arguments);
    assert!(!MESSAGES.iter().any(|message| said.contains(message)), "{said}");
    said
}
