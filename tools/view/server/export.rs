//! The scene as a file: written on a thread of its own, sent while it is read. Also counts how many Gaussians a cut leaves.

use super::access::query_value;
use super::open_connections::OpenConnection;
use super::{Site, busy, files, json_answer, refusal};
use crate::cut::CutMessage;
use crate::edits::Part;
use crate::hub::CurrentScene;
use crate::openings;
use ashsplat::scene::{Cut, Similarity};
use ashsplat::{Error, Result};
use ashsplat_files::splats::{self, Format, WriteOptions};
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
pub(super) const MOST_EXPORTS: usize = 2;
/// Longest wait for the rendering thread.
const PATIENCE: Duration = Duration::from_secs(120);
/// Largest number of a place: files hold no positions that lie farther away.
const FARTHEST: f64 = 1e18;

/// The part, cut, SH degree and place that a page wants.
#[derive(Clone, Copy)]
struct Export {
    part: Part,
    cut: CutMessage,
    sh_degree: u32,
    /// In the coordinates of the scene's file.
    place: Similarity,
}

/// `/export/NAME.ply?min_opacity=X&min_density=X&low=X,X,X&high=X,X,X&sh_degree=N&part=selection&rotate=X,Y,Z&scale=X&translate=X,Y,Z`:
/// all is optional, and the last three are those of `ashsplat convert`.
pub async fn export(
    State(site): State<Arc<Site>>,
    Extension(connection): Extension<Arc<OpenConnection>>,
    UrlPath(name): UrlPath<String>,
    uri: Uri,
) -> response::Result<Response> {
    let format = openings::format_of(&name).filter(|format| Format::WRITTEN.contains(format));
    let format = format.ok_or(StatusCode::NOT_FOUND)?;
    let wanted =
        Export::of_query(&uri).map_err(|error| refusal(StatusCode::BAD_REQUEST, &error.to_string()))?;
    let (scene, turn) = scene_of(&site, &connection, wanted.part).await?;
    // The turn lasts until the file is written, even if the page has gone.
    let work = move || wanted.write(scene, format).map(|(folder, path)| (path, (folder, turn)));
    let written = connection.waits_for(tokio::task::spawn_blocking(work)).await;
    let (path, kept) = written
        .map_err(|_| StatusCode::INTERNAL_SERVER_ERROR)?
        .map_err(|error| refusal(StatusCode::UNPROCESSABLE_ENTITY, &error.to_string()))?;
    let body = files::body_of(&path, kept).ok_or(StatusCode::NOT_FOUND)?;
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
    State(site): State<Arc<Site>>,
    Extension(connection): Extension<Arc<OpenConnection>>,
    uri: Uri,
) -> response::Result<Response> {
    let wanted =
        Export::of_query(&uri).map_err(|error| refusal(StatusCode::BAD_REQUEST, &error.to_string()))?;
    let format =
        query_value(&uri, "format").and_then(|ending| openings::format_of(&format!("scene.{ending}")));
    let (scene, turn) = scene_of(&site, &connection, wanted.part).await?;
    let work = move || {
        let _turn = turn;
        wanted.count(scene, format)
    };
    let counts = connection.waits_for(tokio::task::spawn_blocking(work)).await;
    let counts = counts
        .map_err(|_| StatusCode::INTERNAL_SERVER_ERROR)?
        .map_err(|error| refusal(StatusCode::UNPROCESSABLE_ENTITY, &error.to_string()))?
        .to_string();
    Ok(json_answer(counts))
}

/// Returns the current scene and its turn, held until it is dropped; or the answer that refuses the page.
async fn scene_of(
    site: &Site,
    connection: &OpenConnection,
    part: Part,
) -> response::Result<(CurrentScene, OwnedSemaphorePermit)> {
    let busy = || busy("other exports are being made: ask again in a while");
    let turn = site.exports.clone().try_acquire_owned().map_err(|_| busy())?;
    let (answer, scene) = oneshot::channel();
    if !site.hub.ask_for_scene(part, answer) {
        return Err(busy().into());
    }
    match connection.waits_for(tokio::time::timeout(PATIENCE, scene)).await {
        Ok(Ok(Ok(scene))) => Ok((scene, turn)),
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
            None => Part::Seen,
            Some("selection") => Part::Selection,
            Some(_) => return Err(bad("part")),
        };
        let numbers = |name: &str| -> Result<Option<[f64; 3]>> {
            let Some(text) = query_value(uri, name) else { return Ok(None) };
            let numbers: Option<Vec<f64>> = text.split(',').map(|part| part.parse().ok()).collect();
            let numbers = numbers.and_then(|numbers| numbers.try_into().ok());
            numbers
                .filter(|all: &[f64; 3]| all.iter().all(|v| v.abs() <= FARTHEST))
                .ok_or_else(|| bad(name))
                .map(Some)
        };
        let scale = query_value(uri, "scale").unwrap_or("1".into()).parse::<f64>().ok();
        let scale = scale.filter(|scale| (1e-6..=1e6).contains(scale)).ok_or_else(|| bad("scale"))?;
        let [rotate, translate] = ["rotate", "translate"].map(numbers);
        let [rotate, translate] = [rotate?, translate?].map(|v| DVec3::from_array(v.unwrap_or_default()));
        let place = Similarity::of_angles(rotate, scale, translate);
        Ok(Export { part, cut, sh_degree, place })
    }

    /// Moves the scene to its place. Returns the cut that is still to be made.
    fn place(&self, scene: &mut CurrentScene) -> Cut {
        if self.place == Similarity::default() {
            return self.cut.cut();
        }
        // The cut is in the old axes.
        let limits = self.cut.cut().limits();
        scene.gaussians.retain(|all, index| limits.keeps(all, index));
        splats::place(&mut scene.gaussians, &mut scene.marks.frame, &self.place);
        Cut::default()
    }

    fn count(&self, mut scene: CurrentScene, format: Option<Format>) -> Result<Value> {
        let (limits, of) = (self.cut.cut().limits(), scene.gaussians.len());
        let kept = (0..of).filter(|&index| limits.keeps(&scene.gaussians, index)).count();
        let mut losses = Vec::new();
        if let Some(format) = format {
            let cut = self.place(&mut scene);
            losses = splats::cut_losses(format, &scene.gaussians, &cut, self.sh_degree, &scene.marks)?;
            let DVec3 { x, y, z } = scene.marks.frame.origin;
            if [x, y, z] != [0.0; 3] {
                losses.push(format!("positions are relative to {x}, {y}, {z}"));
            }
        }
        Ok(json!({ "kept": kept, "of": of, "losses": losses }))
    }

    /// Writes a file into a new temporary folder.
    fn write(&self, mut scene: CurrentScene, format: Format) -> Result<(TempDir, PathBuf)> {
        let room = std::env::temp_dir();
        let folder = tempfile::tempdir().map_err(|e| Error::io(&room, "write a temporary file", e))?;
        let path = folder.path().join(format!("scene{}", format.extension()));
        let cut = self.place(&mut scene);
        let options = WriteOptions { format: Some(format), ..scene.marks };
        splats::write_cut(&path, &scene.gaussians, &cut, self.sh_degree, &options)?;
        Ok((folder, path))
    }
}
