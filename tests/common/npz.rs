//! Reading of numpy archives.

use std::collections::HashMap;
use std::fs::File;
use std::io::{BufReader, Read};
use std::path::Path;

/// An array, flattened row-major, as f64 (exact for f4, i4 and u1).
#[derive(Clone, Debug)]
pub struct Array {
    /// Sizes.
    pub shape: Vec<usize>,
    /// Values.
    pub values: Vec<f64>,
}

/// All the arrays of an archive.
#[derive(Clone, Debug, Default)]
pub struct Npz {
    arrays: HashMap<String, Array>,
}

impl Npz {
    /// The names of the arrays of an archive, without reading them.
    pub fn names(path: &Path) -> Vec<String> {
        let file = File::open(path).unwrap_or_else(|e| panic!("{}: {e}", path.display()));
        let archive = npyz::npz::NpzArchive::new(BufReader::new(file))
            .unwrap_or_else(|e| panic!("{}: {e}", path.display()));
        archive.array_names().map(str::to_owned).collect()
    }

    /// Reads an archive.
    pub fn read(path: &Path) -> Npz {
        let names = Npz::names(path);
        let file = File::open(path).unwrap_or_else(|e| panic!("{}: {e}", path.display()));
        let mut archive = npyz::npz::NpzArchive::new(BufReader::new(file)).expect("opened just before");
        let mut arrays = HashMap::new();
        for name in names {
            let array = archive.by_name(&name).expect("listed").expect("listed");
            arrays.insert(name, read_array(array));
        }
        Npz { arrays }
    }

    /// Whether there is an array of this name.
    pub fn has(&self, name: &str) -> bool {
        self.arrays.contains_key(name)
    }

    /// The array of this name.
    pub fn array(&self, name: &str) -> &Array {
        self.arrays.get(name).unwrap_or_else(|| panic!("no array {name}"))
    }

    /// The values of the array of this name.
    pub fn values(&self, name: &str) -> &[f64] {
        &self.array(name).values
    }

    /// The one value of an array.
    pub fn scalar(&self, name: &str) -> f64 {
        self.values(name)[0]
    }

    /// Rows of `N` values.
    pub fn rows<const N: usize>(&self, name: &str) -> Vec<[f64; N]> {
        rows(self.values(name))
    }

    /// An array of flags.
    pub fn flags(&self, name: &str) -> Vec<bool> {
        self.values(name).iter().map(|&x| x != 0.0).collect()
    }
}

/// Groups values into rows.
pub fn rows<const N: usize>(values: &[f64]) -> Vec<[f64; N]> {
    let (rows, rest) = values.as_chunks::<N>();
    assert!(rest.is_empty(), "{} values do not make rows of {N}", values.len());
    rows.to_vec()
}

fn read_array<R: Read>(array: npyz::NpyFile<R>) -> Array {
    let shape = array.shape().iter().map(|&n| n as usize).collect();
    assert!(array.order() == npyz::Order::C, "row-major arrays only");
    let kind = array.dtype().descr();
    let values = match kind.trim_matches('\'') {
        "<f4" => array.into_vec::<f32>().map(widen),
        "<i4" => array.into_vec::<i32>().map(widen),
        "|u1" => array.into_vec::<u8>().map(widen),
        other => panic!("array of type {other}"),
    };
    Array { shape, values: values.expect("a complete array") }
}

fn widen<T: Into<f64>>(values: Vec<T>) -> Vec<f64> {
    values.into_iter().map(Into::into).collect()
}
