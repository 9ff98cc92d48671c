//! Splits the frames of a nerfstudio file into training and held-out ones.

use std::cell::RefCell;
use std::collections::HashMap;
use std::path::Path;

use serde_json::Value;

use crate::names::plain;
use ashsplat::{Error, Result};

/// Keys of the name lists. The first held-out list that exists is used; they come last.
const LISTS: [&str; 3] = ["train_filenames", "test_filenames", "val_filenames"];

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Part {
    Train,
    HeldOut,
    None,
}

/// The names of each list, with true for each name that a frame has. `None` if the list is missing or empty.
pub(super) struct Split {
    lists: [Option<RefCell<HashMap<String, bool>>>; 3],
}

impl Split {
    /// Reads the lists of a file.
    pub(super) fn of(path: &Path, document: &Value) -> Result<Self> {
        let mut lists = [const { None }; 3];
        for (list, key) in lists.iter_mut().zip(LISTS) {
            let names: Option<Vec<&str>> = match &document[key] {
                Value::Null => Some(Vec::new()),
                Value::Array(names) => names.iter().map(Value::as_str).collect(),
                _ => None,
            };
            let wrong = || Error::input(path, format!("{key} is not a list of names"), "correct the file");
            let names = names.ok_or_else(wrong)?;
            *list = (!names.is_empty())
                .then(|| RefCell::new(names.into_iter().map(|name| (plain(name), false)).collect()));
        }
        Ok(Self { lists })
    }

    /// The use of the frame with this path or name. Without a training list, frames in no list are training frames.
    pub(super) fn part_of(&self, path: &str, name: &str) -> Part {
        let path = plain(path);
        let lists = |at: usize| {
            let Some(list) = &self.lists[at] else { return false };
            [path.as_str(), name]
                .into_iter()
                .any(|key| list.borrow_mut().get_mut(key).map(|met| *met = true).is_some())
        };
        let [train, test, val] = [0, 1, 2].map(lists);
        match if self.lists[1].is_some() { test } else { val } {
            true => Part::HeldOut,
            false if train || self.lists[0].is_none() && !val => Part::Train,
            false => Part::None,
        }
    }

    /// Refuses a list with a name that no frame has.
    pub(super) fn check(&self, path: &Path) -> Result<()> {
        for (list, key) in self.lists.iter().zip(LISTS) {
            let unknown = list.iter().flat_map(|list| {
                let missed = |(name, met): (&String, &bool)| (!met).then(|| name.clone());
                list.borrow().iter().filter_map(missed).collect::<Vec<_>>()
            });
            if let Some(name) = unknown.min() {
                let problem = format!("{key} names {name:?}, which no frame has as its file_path");
                return Err(Error::input(path, problem, "correct the list or add the frame"));
            }
        }
        Ok(())
    }

    /// Names of the lists that are used.
    pub(super) fn used_lists(&self) -> String {
        let held_out = if self.lists[1].is_some() { 1 } else { 2 };
        let used = [0, held_out].into_iter().filter(|&at| self.lists[at].is_some());
        used.map(|at| LISTS[at]).collect::<Vec<_>>().join(" and ")
    }
}
