//! The scene as a file: written on a thread of its own, sent while it is read. Also counts how many Gaussians a cut leaves.

use super::access::query_value;
use super::open_connections::OpenConnection;
use super::{AppState, busy, files, json_answer, refusal};
use crate::cut::CutMessage;
use crate::edits::GaussianSet;
use crate::hub::CurrentScene;
use crate::openings;
use ashsplat::scene::{Cut, Similarity};
use ashsplat::{Error, Result};
use ashsplat_files::splats::{self, Format, WriteOptions};
use ashsplat_files::text;
use axum::Extension;
use axum::extract::{Path as UrlPath, State};
use axum::http::{StatusCode, Uri, header};
use axum::response::{self, IntoResponse, Response};
use glam::DVec3;
use serde_json::{Value, json};
use std::path::PathBuf;
use std::sync::Arc;
use std::time::Duration;
use tempfile::TempDir;
use tokio::sync::{OwnedSemaphorePermit, oneshot};

/// Most exports that are written or sent at once: each takes the scene's memory, then its file's disk space.
pub(super) const MAX_EXPORTS: usize = 2;
const PATIENCE: Duration = Duration::from_secs(120);
/// Largest number in a place, because files hold no positions farther away.
const FARTHEST: f64 = 1e18;

/// The part, cut, SH degree and place that a page wants.
#[derive(Clone, Copy)]
struct Export {
    part: GaussianSet,
    cut: CutMessage,
    sh_degree: u32,
    /// In the coordinates of the scene's file.
    place: Similarity,
}

/// `/export/NAME.ply?min_opacity=X&min_density=X&low=X,X,X&high=X,X,X&sh_degree=N&part=selection&rotate=X,Y,Z&scale=X&translate=X,Y,Z`:
/// all is optional, and the last three are those of `ashsplat convert`.
pub async fn export(
    State(state): State<Arc<AppState>>,
    Extension(connection): Extension<Arc<OpenConnection>>,
    UrlPath(name): UrlPath<String>,
    uri: Uri,
) -> response::Result<Response> {
    let format = openings::format_of(&name).filter(|format| Format::WRITTEN.contains(format));
    let format = format.ok_or(StatusCode::NOT_FOUND)?;
    let ((folder, path), permit) =
        made(&state, &connection, &uri, move |options, scene| options.write(scene, format)).await?;
    // Both last until the file is sent.
    let body = files::body(&path, (folder, permit)).ok_or(StatusCode::NOT_FOUND)?;
    let kind = [
        (header::CONTENT_TYPE, "application/octet-stream"),
        (header::CONTENT_DISPOSITION, "attachment"),
        (header::CACHE_CONTROL, "no-store"),
    ];
    Ok((kind, body).into_response())
}

/// `/count?min_opacity=X&…`, same as for an export: counts the Gaussians that remain, `{"kept":N,"of":N,"losses":[]}`. With
/// `format=spz`, `losses` says in words what that format cannot hold, and what the positions are relative to.
pub async fn count(
    State(state): State<Arc<AppState>>,
    Extension(connection): Extension<Arc<OpenConnection>>,
    uri: Uri,
) -> response::Result<Response> {
    let format =
        query_value(&uri, "format").and_then(|ending| openings::format_of(&format!("scene.{ending}")));
    let (counts, _) =
        made(&state, &connection, &uri, move |options, scene| options.count(scene, format)).await?;
    Ok(json_answer(counts.to_string()))
}

/// Works on the scene that an address wants, on a thread of its own. Returns the result and the permit, which lasts until the work is
/// done, even if the page has gone; or the answer that refuses the page.
async fn made<T: Send + 'static>(
    state: &AppState,
    connection: &OpenConnection,
    uri: &Uri,
    work: impl FnOnce(Export, CurrentScene) -> Result<T> + Send + 'static,
) -> response::Result<(T, OwnedSemaphorePermit)> {
    let refused = |code: StatusCode| move |error: Error| refusal(code, &error.to_string());
    let options = Export::of_query(uri).map_err(refused(StatusCode::BAD_REQUEST))?;
    let (scene, permit) = scene_of(state, connection, options.part).await?;
    let work = tokio::task::spawn_blocking(move || work(options, scene).map(|done| (done, permit)));
    let done = connection.waits_for(work).await.map_err(|_| StatusCode::INTERNAL_SERVER_ERROR)?;
    Ok(done.map_err(refused(StatusCode::UNPROCESSABLE_ENTITY))?)
}

/// Returns the current scene and its permit, held until it is dropped; or the answer that refuses the page.
async fn scene_of(
    state: &AppState,
    connection: &OpenConnection,
    part: GaussianSet,
) -> response::Result<(CurrentScene, OwnedSemaphorePermit)> {
    let busy = || busy("other exports are being made: ask again in a while");
    let permit = state.exports.clone().try_acquire_owned().map_err(|_| busy())?;
    let (answer, scene) = oneshot::channel();
    if !state.hub.request_scene(part, answer) {
        return Err(busy().into());
    }
    match connection.waits_for(tokio::time::timeout(PATIENCE, scene)).await {
        Ok(Ok(Ok(scene))) => Ok((scene, permit)),
        Ok(Ok(Err(problem))) => Err(refusal(StatusCode::UNPROCESSABLE_ENTITY, &problem).into()),
        _ => Err(busy().into()),
    }
}

impl Export {
    fn of_query(uri: &Uri) -> Result<Export> {
        let bad = |name: &str| Error::argument("export", format!("'{name}' is not understood"));
        let number = |name: &str, text: &str| match text {
            "" => Ok(None),
            text => match text.parse::<f32>() {
                Ok(number) if number.is_finite() => Ok(Some(number)),
                _ => Err(bad(name)),
            },
        };
        let one = |name: &str| number(name, &query_value(uri, name).unwrap_or_default());
        let three = |name: &str| -> Result<[Option<f32>; 3]> {
            let text = query_value(uri, name).unwrap_or(",,".into());
            let sides = text.split(',').map(|side| number(name, side)).collect::<Result<Vec<_>>>()?;
            sides.try_into().map_err(|_| bad(name))
        };
        let cut = CutMessage {
            min_opacity: one("min_opacity")?,
            min_density: one("min_density")?,
            low: three("low")?,
            high: three("high")?,
        };
        cut.cut().check()?;
        let degree = query_value(uri, "sh_degree").unwrap_or("3".into()).parse::<u32>();
        let sh_degree = degree.ok().filter(|degree| *degree <= 3).ok_or_else(|| bad("sh_degree"))?;
        let part = match query_value(uri, "part").as_deref() {
            None => GaussianSet::Visible,
            Some("selection") => GaussianSet::Selection,
            Some(_) => return Err(bad("part")),
        };
        let vector = |name: &str| -> Result<DVec3> {
            let near = |all: &[f64; 3]| all.iter().all(|v| v.abs() <= FARTHEST);
            let text = query_value(uri, name).unwrap_or("0,0,0".into());
            text::numbers(&text).filter(near).map(DVec3::from_array).ok_or_else(|| bad(name))
        };
        let scale = query_value(uri, "scale").unwrap_or("1".into()).parse::<f64>().ok();
        let scale = scale.filter(|scale| (1e-6..=1e6).contains(scale)).ok_or_else(|| bad("scale"))?;
        let place = Similarity::of_angles(vector("rotate")?, scale, vector("translate")?);
        Ok(Export { part, cut, sh_degree, place })
    }

    /// Makes the cut, then moves the scene to its place: the cut is in the old axes.
    fn apply(&self, scene: &mut CurrentScene) {
        let cut = self.cut.cut();
        if cut != Cut::default() {
            let limits = cut.limits();
            scene.gaussians.retain(|all, index| limits.keeps(all, index));
        }
        if self.place != Similarity::default() {
            splats::place(&mut scene.gaussians, &mut scene.marks.frame, &self.place);
        }
        if self.sh_degree < scene.gaussians.sh_degree {
            scene.gaussians = scene.gaussians.with_sh_degree(self.sh_degree);
        }
    }

    fn count(&self, mut scene: CurrentScene, format: Option<Format>) -> Result<Value> {
        let of = scene.gaussians.len();
        self.apply(&mut scene);
        let CurrentScene { gaussians, marks } = scene;
        let mut losses = Vec::new();
        if let Some(format) = format {
            losses = splats::losses(format, &gaussians, &marks)?;
            let DVec3 { x, y, z } = marks.frame.origin;
            if [x, y, z] != [0.0; 3] {
                losses.push(format!("positions are relative to {x}, {y}, {z}"));
            }
        }
        Ok(json!({ "kept": gaussians.len(), "of": of, "losses": losses }))
    }

    /// Writes a file into a new temporary folder.
    fn write(&self, mut scene: CurrentScene, format: Format) -> Result<(TempDir, PathBuf)> {
        let parent = std::env::temp_dir();
        let folder = tempfile::tempdir().map_err(|e| Error::io(&parent, "write a temporary file", e))?;
        let path = folder.path().join(format!("scene{}", format.extension()));
        self.apply(&mut scene);
        let options = WriteOptions { format: Some(format), ..scene.marks };
        splats::write_changed(&path, &scene.gaussians, &options)?;
        Ok((folder, path))
    }
}
