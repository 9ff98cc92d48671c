//! COLMAP's stages: features, matches, mapping.

use super::colmap::{Colmap, Job};
use super::source::{PhotoInfo, by_camera};
use super::workspace::{LOG_FILE, Workspace};
use super::{Arguments, MIN_PHOTOS, PhotoFiles, StageBar, time};
use ashsplat::{Error, Result};
use ashsplat_files::{DatasetOptions, Gallery, Progress};
use ashsplat_program::child::LoggedOutput;
use std::collections::HashSet;
use std::ffi::OsString;
use std::hash::{DefaultHasher, Hash, Hasher};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Instant, UNIX_EPOCH};

/// Largest number of cameras whose features are extracted in separate runs. Beyond it, every photograph has its own
/// camera.
const MAX_CAMERAS: usize = 16;
/// COLMAP's messages if photographs have nothing in common.
const UNCONNECTED: [&str; 4] =
    ["No good initial image pair", "No images with matches", "failed to create", "Failed to create"];
/// Number of COLMAP's lines in a message.
const QUOTED_LINES: usize = 3;
const ADVICE: &str = "take more photographs: each overlapping the next by two thirds, from places some steps apart (not turning \
                      on the spot), sharp, of a scene that has texture and does not move";

pub struct Cameras<'a> {
    pub arguments: &'a Arguments,
    pub colmap: &'a Colmap,
    pub stop: &'a AtomicBool,
    pub photos: &'a PhotoFiles,
    pub infos: &'a [PhotoInfo],
    pub gpu: bool,
}

pub struct Reconstruction {
    /// The folder of the largest model.
    pub model: PathBuf,
    pub registered: HashSet<String>,
    pub points: usize,
    pub models: usize,
}

impl Cameras<'_> {
    /// Runs all unfinished stages.
    ///
    /// # Errors
    /// [`Error::Argument`] and [`Error::Input`] if COLMAP fails or connects too few photographs, with the path of its
    /// log; [`Error::Io`]; [`Error::Interrupted`].
    pub fn find(mut self, workspace: &mut Workspace) -> Result<Reconstruction> {
        self.features(workspace)?;
        let log = workspace.path(LOG_FILE);
        self.matches(workspace, &log)?;
        let job = self.job(workspace)?;
        let models = workspace.fresh_folder("sparse")?;
        let begin = Instant::now();
        let bar = StageBar::new("cameras", "photographs", self.photos.names.len(), self.arguments.quiet);
        let ended = self.run(bar, self.colmap.mapping(&job, &models), &log)?;
        let count = std::fs::read_dir(&models).map_err(|e| Error::io(&models, "read", e))?.count();
        if count == 0 {
            let is_unconnected = |line: &String| UNCONNECTED.iter().any(|words| line.contains(words));
            if ended.status.success() || ended.tail.iter().any(is_unconnected) {
                return Err(self.unconnected(0, &log));
            }
        }
        // Checked even if a first model exists: a larger one might have followed.
        self.success("mapping", &ended, &log)?;
        let found = self.largest(workspace, count, &log)?;
        self.arguments.note(&format!("mapping     {}", time(begin.elapsed().as_secs_f64())));
        Ok(found)
    }

    /// Compares photographs; on the processor if the GPU fails.
    fn matches(&mut self, workspace: &Workspace, log: &Path) -> Result<()> {
        let photographs = self.photos.names.len();
        loop {
            let job = self.job(workspace)?;
            let (matcher, summary) = self.arguments.matcher(photographs, self.gpu);
            let begin = Instant::now();
            let bar = StageBar::new("matches", matcher.unit(), 1, self.arguments.quiet);
            let ended = self.run(bar, self.colmap.matches(&job, matcher, photographs), log)?;
            if self.gpu && !ended.status.success() {
                self.use_processor("matching");
                continue;
            }
            self.success("matching", &ended, log)?;
            self.note_stage("matches", begin, &summary);
            return Ok(());
        }
    }

    fn use_processor(&mut self, what: &str) {
        self.arguments
            .note(&format!("COLMAP's {what} failed on the GPU: once more, on the processor (--no-gpu)"));
        self.gpu = false;
    }

    fn job(&self, workspace: &Workspace) -> Result<Job> {
        let absolute = |path: &Path| std::path::absolute(path).map_err(|e| Error::io(path, "find", e));
        Ok(Job {
            database: absolute(&workspace.path("database.db"))?,
            photos: absolute(&self.photos.folder)?,
            camera_model: self.arguments.camera_model.clone(),
            max_features: self.arguments.max_features.unwrap_or(if self.gpu { 8192 } else { 4096 }),
            gpu: self.gpu,
            video: self.photos.video,
        })
    }

    /// Groups of photographs that share a camera.
    fn groups(&self) -> Result<(Vec<Vec<String>>, bool)> {
        let names = &self.photos.names;
        if self.arguments.cameras == "one" {
            let mut sizes: Vec<(u32, u32)> = self.infos.iter().map(|info| info.size).collect();
            sizes.sort_unstable();
            sizes.dedup();
            if let [(w, h), (other_w, other_h), ..] = sizes[..] {
                let problem =
                    format!("one: there are photographs of {w}x{h} and of {other_w}x{other_h} pixels");
                return Err(Error::argument("--cameras", problem + "; leave it out"));
            }
            return Ok((vec![names.clone()], true));
        }
        let groups = by_camera(names, self.infos);
        match self.arguments.cameras == "each" || groups.len() > MAX_CAMERAS {
            true => Ok((vec![names.clone()], false)),
            false => Ok((groups, true)),
        }
    }

    /// Extracts features; on the processor if the GPU fails.
    fn features(&mut self, workspace: &mut Workspace) -> Result<()> {
        let (groups, shared) = self.groups()?;
        let cameras = if shared { groups.len() } else { self.photos.names.len() };
        let cameras = if cameras == 1 { "1 camera".into() } else { format!("{cameras} cameras") };
        let log = workspace.path(LOG_FILE);
        let requested = self.gpu;
        // Also accepts features from the processor: an earlier run may have found that the GPU fails.
        for gpu in [false, requested] {
            self.gpu = gpu;
            if workspace.has_features(&self.key(workspace)?) {
                self.arguments.note("features    there already");
                return Ok(());
            }
        }
        loop {
            let key = self.key(workspace)?;
            workspace.note_features(None)?;
            // The log begins with these photographs.
            for name in ["database.db", "database.db-wal", "database.db-shm", "database.db-journal", LOG_FILE]
            {
                workspace.remove(name)?;
            }
            let job = self.job(workspace)?;
            let device = if self.gpu { "on a GPU" } else { "on the processor" };
            let summary = format!("{cameras} ({}); {} {device}", job.camera_model, self.colmap.version);
            let list = workspace.path("list.txt");
            let begin = Instant::now();
            let run = || {
                let bar =
                    StageBar::new("features", "photographs", self.photos.names.len(), self.arguments.quiet);
                for group in &groups {
                    std::fs::write(&list, group.join("\n") + "\n")
                        .map_err(|e| Error::io(&list, "write", e))?;
                    let list = std::path::absolute(&list).map_err(|e| Error::io(&list, "find", e))?;
                    let args = self.colmap.features(&job, &list, shared);
                    let ended = self.colmap.run(&args, &log, self.stop, &|progress| bar.update(progress))?;
                    if !ended.status.success() {
                        return Ok(Some(ended));
                    }
                    bar.before.fetch_add(group.len() as u64, Ordering::Relaxed);
                }
                Ok(None)
            };
            match run()? {
                None => {
                    self.note_stage("features", begin, &summary);
                    return workspace.note_features(Some(key));
                }
                Some(_) if self.gpu => self.use_processor("search for features"),
                Some(ended) => return self.success("the search for features", &ended, &log),
            }
        }
    }

    /// Key of everything that the features in the database depend on.
    fn key(&self, workspace: &Workspace) -> Result<String> {
        let mut hasher = DefaultHasher::new();
        let Job { photos, camera_model, max_features, gpu, .. } = self.job(workspace)?;
        (&photos, camera_model, max_features, gpu).hash(&mut hasher);
        (&self.colmap.version, &self.arguments.cameras).hash(&mut hasher);
        for name in &self.photos.names {
            (name, fingerprint(&photos.join(name))?).hash(&mut hasher);
        }
        Ok(format!("{:016x}", hasher.finish()))
    }

    fn note_stage(&self, name: &str, begin: Instant, about: &str) {
        let took = time(begin.elapsed().as_secs_f64());
        self.arguments.note(&format!("{name:<11} {took}: {about}"));
    }

    fn run(&self, bar: StageBar, args: Vec<OsString>, log: &Path) -> Result<LoggedOutput> {
        self.colmap.run(&args, log, self.stop, &|progress| bar.update(progress))
    }

    fn success(&self, what: &str, ended: &LoggedOutput, log: &Path) -> Result<()> {
        if ended.status.success() {
            return Ok(());
        }
        let last = ended.tail[ended.tail.len().saturating_sub(QUOTED_LINES)..].join(" / ");
        let problem =
            format!("{what} failed ({}): {last}; all that it said: {}", ended.status, log.display());
        Err(Error::argument("COLMAP", problem))
    }

    fn unconnected(&self, connected: usize, log: &Path) -> Error {
        let all = self.photos.names.len();
        let some = if connected > 0 { format!("only {connected}") } else { "none".to_owned() };
        let problem =
            format!("{some} of the {all} photographs could be connected (COLMAP's words: {})", log.display());
        Error::input(&self.photos.folder, problem, ADVICE)
    }

    /// The model with the most photographs, read in the same way as by training.
    fn largest(&self, workspace: &Workspace, models: usize, log: &Path) -> Result<Reconstruction> {
        let images = std::path::absolute(&self.photos.folder);
        let images = images.map_err(|e| Error::io(&self.photos.folder, "find", e))?;
        let options = DatasetOptions { images: images.to_string_lossy().into_owned(), ..Default::default() };
        let progress = Progress { report: None, interrupted: Some(self.stop) };
        let gallery = Gallery::open(&workspace.folder, &options, progress)?;
        let registered: HashSet<String> = gallery.cameras().into_iter().map(|camera| camera.name).collect();
        if registered.len() < MIN_PHOTOS {
            return Err(self.unconnected(registered.len(), log));
        }
        let model = ashsplat_files::colmap::find(&workspace.folder)?.folder;
        Ok(Reconstruction { model, registered, points: gallery.points().len(), models })
    }
}

/// Length and modification time of a file, which show if it has changed.
pub fn fingerprint(path: &Path) -> Result<String> {
    let metadata = path.metadata().map_err(|e| Error::io(path, "read", e))?;
    let changed = metadata.modified().ok().and_then(|time| time.duration_since(UNIX_EPOCH).ok());
    Ok(format!("{} {:?}", metadata.len(), changed.unwrap_or_default()))
}
