//! Folders in which tests run the program.

use super::*;

/// A folder. In command lines, `@NAME` is the path of a file or folder in it.
pub(crate) struct TestFolder {
    path: PathBuf,
    /// Removes a temporary folder at the end.
    _temporary: Option<TempDir>,
}

impl TestFolder {
    pub(crate) fn empty() -> TestFolder {
        let folder = tempfile::tempdir().expect("a temporary folder");
        TestFolder { path: folder.path().to_owned(), _temporary: Some(folder) }
    }

    /// An empty folder below `target`, which stays.
    pub(crate) fn lasting(name: &str) -> TestFolder {
        let path = Path::new(env!("CARGO_TARGET_TMPDIR")).join(name);
        std::fs::remove_dir_all(&path).ok();
        TestFolder { path, _temporary: None }
    }

    /// A folder with the data set of [`write_dataset`] as `data`.
    pub(crate) fn new() -> TestFolder {
        let place = TestFolder::empty();
        write_dataset(&place.at("data"));
        place
    }

    pub(crate) fn at(&self, name: impl AsRef<Path>) -> PathBuf {
        self.path.join(name)
    }

    pub(crate) fn has(&self, name: impl AsRef<Path>) -> bool {
        self.at(name).exists()
    }

    pub(crate) fn words(&self, line: impl AsRef<str>) -> Vec<String> {
        let path = |name: &str| text(&self.at(name)).to_owned();
        let word = |word: &str| word.strip_prefix('@').map_or_else(|| word.to_owned(), path);
        line.as_ref().split_whitespace().map(word).collect()
    }

    /// The program with a command line, not yet started.
    pub(crate) fn command(&self, line: impl AsRef<str>) -> Command {
        let mut command = program();
        command.args(self.words(line));
        command
    }

    pub(crate) fn run(&self, line: impl AsRef<str>) -> Finished {
        finish(&mut self.command(line))
    }

    pub(crate) fn json_of(&self, line: impl AsRef<str>) -> Value {
        serde_json::from_str(&self.run(line).ok().stdout).expect("JSON")
    }

    /// Starts the program and hears its stderr.
    pub(crate) fn start(&self, line: impl AsRef<str>) -> BackgroundRun {
        let mut command = self.command(line);
        let mut child = Running::start(command.stdout(Stdio::null()).stderr(Stdio::piped()));
        let lines = BufReader::new(child.stderr.take().expect("its stderr")).lines().map_while(Result::ok);
        BackgroundRun { child, lines: Box::new(lines.map(|line| with_slashes(&line))) }
    }

    pub(crate) fn read(&self, name: impl AsRef<Path>) -> Vec<u8> {
        let path = self.at(name);
        std::fs::read(&path).unwrap_or_else(|error| panic!("{}: {error}", path.display()))
    }

    pub(crate) fn read_text(&self, name: impl AsRef<Path>) -> String {
        String::from_utf8(self.read(name)).expect("UTF-8")
    }

    pub(crate) fn read_json(&self, name: impl AsRef<Path>) -> Value {
        let path = name.as_ref();
        serde_json::from_slice(&self.read(path)).unwrap_or_else(|error| panic!("{}: {error}", path.display()))
    }

    /// Writes a file, in new folders if need be.
    pub(crate) fn write(&self, name: impl AsRef<Path>, contents: impl AsRef<[u8]>) {
        let path = self.at(name);
        std::fs::create_dir_all(path.parent().expect("a folder")).expect("created");
        std::fs::write(path, contents).expect("written");
    }

    pub(crate) fn create_folder(&self, name: impl AsRef<Path>) {
        std::fs::create_dir_all(self.at(name)).expect("created");
    }

    pub(crate) fn remove(&self, name: impl AsRef<Path>) {
        let path = self.at(name);
        if path.is_dir() { std::fs::remove_dir_all(path) } else { std::fs::remove_file(path) }
            .expect("removed");
    }

    pub(crate) fn rename(&self, from: impl AsRef<Path>, to: impl AsRef<Path>) {
        std::fs::rename(self.at(from), self.at(to)).expect("moved");
    }

    pub(crate) fn files(&self, name: impl AsRef<Path>) -> Vec<PathBuf> {
        crate::common::files_below(&self.at(name))
    }

    pub(crate) fn ply(&self, model: &str, iteration: u32) -> Vec<u8> {
        self.read(point_cloud(model, iteration))
    }

    pub(crate) fn gaussians(&self, name: impl AsRef<Path>) -> Gaussians {
        splats::read(self.at(name), &ReadOptions::default()).expect("Gaussians").gaussians
    }

    pub(crate) fn write_scene(&self, name: impl AsRef<Path>, gaussians: &Gaussians) {
        let path = self.at(name);
        std::fs::create_dir_all(path.parent().expect("a folder")).expect("created");
        splats::write(path, gaussians, &WriteOptions::default()).expect("written");
    }

    pub(crate) fn picture(&self, name: impl AsRef<Path>) -> image::RgbImage {
        image::open(self.at(name)).expect("a picture").to_rgb8()
    }
}

pub(crate) fn point_cloud(model: &str, iteration: u32) -> String {
    format!("{model}/point_cloud/iteration_{iteration}/point_cloud.ply")
}

pub(crate) struct BackgroundRun {
    pub(crate) child: Running,
    /// The lines of its stderr.
    pub(crate) lines: Box<dyn Iterator<Item = String>>,
}

impl BackgroundRun {
    #[track_caller]
    pub(crate) fn wait_for(&mut self, beginning: &str) -> String {
        self.lines.find(|line| line.starts_with(beginning)).unwrap_or_else(|| panic!("no line '{beginning}'"))
    }

    /// Waits for its end. Returns the exit code and the rest of its stderr.
    pub(crate) fn end(mut self) -> (Option<i32>, Vec<String>) {
        let rest = self.lines.collect();
        (self.child.wait().expect("it ends").code(), rest)
    }

    /// Interrupts a training, which saves and exits with the code of an interrupted program. Returns the rest of its
    /// stderr.
    #[track_caller]
    pub(crate) fn interrupt(self) -> Vec<String> {
        self.child.interrupt();
        let (code, rest) = self.end();
        assert_eq!(code, Some(130), "{rest:?}");
        rest
    }
}

#[track_caller]
pub(crate) fn wait_until(what: &str, mut holds: impl FnMut() -> bool) {
    let start = Instant::now();
    while !holds() {
        assert!(start.elapsed() < Duration::from_secs(120), "{what}");
        std::thread::sleep(Duration::from_millis(10));
    }
}
