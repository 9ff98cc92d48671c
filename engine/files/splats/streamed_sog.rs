//! PlayCanvas' streamed SOG: regions with several levels of detail, whose Gaussians are runs of rows in SOG files.
//!
//! Format: `lod-meta.json`, version 1, as splat-transform 2.7 writes it. Level 0 is the finest. An environment, if there is one,
//! is drawn with every level.

use std::collections::BTreeMap;
use std::ops::Range;
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};

use super::{Format, Header, Opened, ReadOptions, Sink, sog};
use crate::names::stays_inside;
use crate::regular_file::{self, damaged};
use ashsplat::{Error, Result};

/// `lod-meta.json`.
#[derive(Deserialize, Serialize)]
#[serde(rename_all = "camelCase")]
pub(crate) struct LodMeta {
    pub(crate) version: u32,
    #[serde(default)]
    pub(crate) asset: Asset,
    /// Number of Gaussians of all levels, and of each.
    #[serde(default)]
    pub(crate) count: u64,
    #[serde(default)]
    pub(crate) counts: Vec<u64>,
    pub(crate) lod_levels: u32,
    /// A SOG beside the levels.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub(crate) environment: Option<String>,
    /// Descriptions of SOGs, relative to this file.
    pub(crate) filenames: Vec<String>,
    pub(crate) tree: Region,
}

#[derive(Default, Deserialize, Serialize)]
pub(crate) struct Asset {
    #[serde(default)]
    pub(crate) generator: String,
}

/// A node of the tree: it has children, or levels.
#[derive(Default, Deserialize, Serialize)]
pub(crate) struct Region {
    #[serde(default)]
    pub(crate) bound: Bound,
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub(crate) children: Vec<Region>,
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub(crate) lods: BTreeMap<u32, Run>,
}

/// Box around the Gaussians of all levels.
#[derive(Clone, Copy, Default, Deserialize, Serialize)]
pub(crate) struct Bound {
    pub(crate) min: [f32; 3],
    pub(crate) max: [f32; 3],
}

/// Consecutive Gaussians of a file.
#[derive(Clone, Copy, Deserialize, Serialize)]
pub(crate) struct Run {
    pub(crate) file: usize,
    pub(crate) offset: u64,
    pub(crate) count: u64,
}

impl LodMeta {
    pub(crate) const VERSION: u32 = 1;

    /// Rows of the finest level of each region, by file.
    fn finest(&self) -> BTreeMap<usize, Vec<Range<u64>>> {
        let mut rows = BTreeMap::<usize, Vec<Range<u64>>>::new();
        let mut open = vec![&self.tree];
        while let Some(region) = open.pop() {
            open.extend(&region.children);
            if let Some(run) = region.lods.values().find(|run| run.count > 0) {
                rows.entry(run.file).or_default().push(run.offset..run.offset.saturating_add(run.count));
            }
        }
        rows
    }
}

/// Opens a streamed SOG, of which the finest level is read.
pub(super) fn open(path: &Path, options: &ReadOptions) -> Result<Opened<'static>> {
    let text = regular_file::read(path, 1)?;
    regular_file::check_json(path, &text, options.max_host_memory)?;
    let meta: LodMeta = serde_json::from_slice(&text).map_err(|e| damaged(path, e.to_string()))?;
    if meta.version != LodMeta::VERSION {
        let problem = format!("is version {} of a streamed SOG; 1 is known", meta.version);
        return Err(Error::input(path, problem, "write it again as version 1"));
    }
    let mut header = Header::new(Format::Sog, 0, 0);
    if meta.lod_levels > 1 {
        header.warnings.push(format!("the finest of {} levels of detail is used", meta.lod_levels));
    }
    // Files, with the rows that are read; `None` for all.
    let mut parts = Vec::<(PathBuf, Option<Vec<Range<u64>>>)>::new();
    let whole = meta.environment.iter().map(|name| (name, None));
    let levels = meta.finest().into_iter().map(|(file, rows)| match meta.filenames.get(file) {
        Some(name) => Ok((name, Some(joined(rows)))),
        None => Err(damaged(path, format!("a region is in file {file}, which filenames do not list"))),
    });
    for part in levels.chain(whole.map(Ok)) {
        let (name, rows) = part?;
        if !stays_inside(name) || name.contains([':', '\\']) {
            return Err(damaged(path, format!("{name:?} does not lie in its folder")));
        }
        let file = path.with_file_name(name);
        if parts.iter().any(|part| part.0 == file) {
            return Err(damaged(path, format!("names {name} twice")));
        }
        let Header { count, sh_degree, antialiased, .. } = sog::open(&file, options)?.0;
        let taken = rows.iter().flatten();
        if taken.clone().any(|rows| rows.end > count) {
            return Err(damaged(path, format!("a region ends behind the end of {name}")));
        }
        header.count += rows.as_ref().map_or(count, |_| taken.map(|rows| rows.end - rows.start).sum());
        header.sh_degree = header.sh_degree.max(sh_degree);
        if antialiased != header.antialiased && !parts.is_empty() {
            return Err(damaged(path, "only some of its files want antialiasing"));
        }
        header.antialiased = antialiased;
        parts.push((file, rows));
    }
    let options = *options;
    let read = move |sink: &mut Sink<'_>| {
        for (file, rows) in &parts {
            let mut first = 0;
            sog::open(file, &options)?.1(&mut |mut block| {
                let begin = first;
                first += block.len() as u64;
                if let Some(rows) = rows {
                    block.retain(|_, index| {
                        let row = begin + index as u64;
                        let range = rows.get(rows.partition_point(|range| range.end <= row));
                        range.is_some_and(|range| range.start <= row)
                    });
                }
                sink(block)
            })?;
        }
        Ok(())
    };
    Ok((header, Box::new(read)))
}

/// Sorts rows and joins those that touch or overlap.
fn joined(mut all: Vec<Range<u64>>) -> Vec<Range<u64>> {
    all.sort_by_key(|rows| rows.start);
    let mut joined = Vec::<Range<u64>>::new();
    for Range { start, end } in all {
        match joined.last_mut().filter(|last| start <= last.end) {
            Some(last) => last.end = last.end.max(end),
            None => joined.push(start..end),
        }
    }
    joined
}
