//! Reads numpy archives.

use std::collections::HashMap;
use std::fs::File;
use std::io::{BufReader, Read};
use std::path::Path;
use zip::ZipArchive;

/// An array, flattened row-major, as f64 (exact for f4, i4 and u1).
#[derive(Clone, Debug)]
pub struct Array {
    pub shape: Vec<usize>,
    pub values: Vec<f64>,
}

#[derive(Clone, Debug, Default)]
pub struct Npz {
    arrays: HashMap<String, Array>,
}

impl Npz {
    /// Lists an archive's arrays without reading them.
    pub fn names(path: &Path) -> Vec<String> {
        let archive = open(path);
        let names = archive.file_names().map(|name| name.expect("a name in UTF-8"));
        names.filter_map(|name| Some(name.strip_suffix(".npy")?.to_owned())).collect()
    }

    pub fn read(path: &Path) -> Npz {
        let mut archive = open(path);
        let mut arrays = HashMap::new();
        for name in Npz::names(path) {
            let mut bytes = Vec::new();
            let entry =
                archive.by_name(&format!("{name}.npy")).and_then(|mut e| Ok(e.read_to_end(&mut bytes)?));
            entry.unwrap_or_else(|e| panic!("{}: {name}: {e}", path.display()));
            let array =
                parse(&bytes).unwrap_or_else(|| panic!("{}: {name}: no such array is read", path.display()));
            arrays.insert(name, array);
        }
        Npz { arrays }
    }

    /// Same archive, but the arrays with this prefix replace those without it.
    pub fn with_prefix(&self, prefix: &str) -> Npz {
        let mut arrays = self.arrays.clone();
        for (name, array) in &self.arrays {
            if let Some(plain) = name.strip_prefix(prefix) {
                arrays.insert(plain.to_owned(), array.clone());
            }
        }
        Npz { arrays }
    }

    pub fn has(&self, name: &str) -> bool {
        self.arrays.contains_key(name)
    }

    pub fn array(&self, name: &str) -> &Array {
        self.arrays.get(name).unwrap_or_else(|| panic!("no array {name}"))
    }

    pub fn values(&self, name: &str) -> &[f64] {
        &self.array(name).values
    }

    pub fn scalar(&self, name: &str) -> f64 {
        self.values(name)[0]
    }

    /// Values of an array in rows of `N`.
    pub fn rows<const N: usize>(&self, name: &str) -> Vec<[f64; N]> {
        rows(self.values(name))
    }

    pub fn flags(&self, name: &str) -> Vec<bool> {
        self.values(name).iter().map(|&x| x != 0.0).collect()
    }
}

pub fn rows<const N: usize>(values: &[f64]) -> Vec<[f64; N]> {
    let (rows, rest) = values.as_chunks::<N>();
    assert!(rest.is_empty(), "{} values do not make rows of {N}", values.len());
    rows.to_vec()
}

fn open(path: &Path) -> ZipArchive<BufReader<File>> {
    let archive = File::open(path).map_err(Into::into).and_then(|file| ZipArchive::new(BufReader::new(file)));
    archive.unwrap_or_else(|e| panic!("{}: {e}", path.display()))
}

/// An array of NumPy's format 1.0: magic, length of the header, a Python dictionary as the header, the values.
fn parse(bytes: &[u8]) -> Option<Array> {
    let (length, rest) = bytes.strip_prefix(b"\x93NUMPY\x01\x00")?.split_first_chunk()?;
    let (header, data) = rest.split_at_checked(u16::from_le_bytes(*length).into())?;
    let header = std::str::from_utf8(header).ok()?;
    let after = |key: &str| Some(header.split_once(key)?.1);
    // Only row-major arrays.
    after("'fortran_order': False")?;
    let sizes = after("'shape': (")?.split_once(')')?.0;
    let sizes = sizes.split(',').map(str::trim).filter(|size| !size.is_empty());
    let shape: Vec<usize> = sizes.map(|size| size.parse().ok()).collect::<Option<_>>()?;
    let values: Vec<f64> = match after("'descr': '")?.split_once('\'')?.0 {
        "<f4" => words(data)?.iter().map(|&word| f32::from_le_bytes(word).into()).collect(),
        "<i4" => words(data)?.iter().map(|&word| i32::from_le_bytes(word).into()).collect(),
        "|u1" => data.iter().map(|&byte| byte.into()).collect(),
        _ => return None,
    };
    (values.len() == shape.iter().product::<usize>()).then_some(Array { shape, values })
}

fn words(bytes: &[u8]) -> Option<&[[u8; 4]]> {
    let (words, rest) = bytes.as_chunks();
    rest.is_empty().then_some(words)
}
