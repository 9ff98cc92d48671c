//! Reads the JSON of a `transforms.json` with one frame in memory at a time. Limits bound the kept part of each object.

use std::fmt::Formatter;
use std::path::Path;

use serde::de::{DeserializeSeed, Deserializer, Error as _, IgnoredAny, MapAccess, SeqAccess, Visitor};
use serde_json::{Map, Number, Value};

use ashsplat::Result;

/// Largest number of keys in an object.
const MOST_KEYS: usize = 1000;

/// Number of kept elements per list, except the file's lists of names; a matrix has up to 4.
const MOST_ELEMENTS: usize = 8;

/// Largest depth of nested lists that are kept: a matrix.
const MOST_DEPTH: u32 = 2;

/// The top-level values of the file. Objects inside lists are empty, `frames` among them.
pub(super) fn document(path: &Path, text: &str) -> Result<Value> {
    read(path, text, Pruned { depth: 0, keeps_names: true })
}

/// Passes the frames of a file to `each`, one by one.
pub(super) fn each_frame(path: &Path, text: &str, each: &mut dyn FnMut(Value) -> Result<()>) -> Result<()> {
    let mut failed = None;
    let mut pass = |frame| each(frame).map_err(|error| failed = Some(error)).is_ok();
    let result = read(path, text, Document(&mut pass));
    failed.map_or(result, Err)
}

fn read<'de, S: DeserializeSeed<'de>>(path: &Path, text: &'de str, seed: S) -> Result<S::Value> {
    let mut json = serde_json::Deserializer::from_str(text);
    let value = seed.deserialize(&mut json).and_then(|value| json.end().map(|()| value));
    value.map_err(|e| super::not_json(path, text, &e))
}

/// Reads a value without the contents of nested objects, and with shortened lists.
#[derive(Clone, Copy)]
struct Pruned {
    depth: u32,
    /// True if lists of strings keep all elements.
    keeps_names: bool,
}

impl<'de> DeserializeSeed<'de> for Pruned {
    type Value = Value;

    fn deserialize<D: Deserializer<'de>>(self, deserializer: D) -> Result<Value, D::Error> {
        deserializer.deserialize_any(self)
    }
}

impl<'de> Visitor<'de> for Pruned {
    type Value = Value;

    fn expecting(&self, f: &mut Formatter<'_>) -> std::fmt::Result {
        f.write_str("a value")
    }

    fn visit_unit<E>(self) -> Result<Value, E> {
        Ok(Value::Null)
    }

    fn visit_bool<E>(self, value: bool) -> Result<Value, E> {
        Ok(value.into())
    }

    fn visit_i64<E>(self, value: i64) -> Result<Value, E> {
        Ok(value.into())
    }

    fn visit_u64<E>(self, value: u64) -> Result<Value, E> {
        Ok(value.into())
    }

    fn visit_f64<E>(self, value: f64) -> Result<Value, E> {
        Ok(Number::from_f64(value).into())
    }

    fn visit_str<E>(self, value: &str) -> Result<Value, E> {
        Ok(value.into())
    }

    fn visit_seq<A: SeqAccess<'de>>(self, mut list: A) -> Result<Value, A::Error> {
        let (mut kept, mut others) = (Vec::new(), 0);
        if self.depth > MOST_DEPTH {
            while list.next_element::<IgnoredAny>()?.is_some() {}
        }
        let inside = Self { depth: self.depth + 1, ..self };
        while let Some(value) = list.next_element_seed(inside)? {
            let is_name = self.keeps_names && self.depth == 1 && value.is_string();
            others += usize::from(!is_name);
            if is_name || others <= MOST_ELEMENTS {
                kept.push(value);
            }
        }
        Ok(Value::Array(kept))
    }

    fn visit_map<A: MapAccess<'de>>(self, mut object: A) -> Result<Value, A::Error> {
        let mut kept = Map::new();
        if self.depth > 0 {
            while object.next_entry::<IgnoredAny, IgnoredAny>()?.is_some() {}
        }
        while let Some(key) = object.next_key::<String>()? {
            kept.insert(key, object.next_value_seed(Self { depth: self.depth + 1, ..self })?);
            if kept.len() > MOST_KEYS {
                return Err(A::Error::custom(format!("an object has more than {MOST_KEYS} keys")));
            }
        }
        Ok(Value::Object(kept))
    }
}

/// Receives a frame; returns false to stop the reading.
type Pass<'a> = dyn FnMut(Value) -> bool + 'a;

/// Reads the object around the frames.
struct Document<'a>(&'a mut Pass<'a>);

/// Reads the list of frames.
struct Frames<'a, 'p>(&'a mut Pass<'p>);

impl<'de> DeserializeSeed<'de> for Document<'_> {
    type Value = ();

    fn deserialize<D: Deserializer<'de>>(self, deserializer: D) -> Result<(), D::Error> {
        deserializer.deserialize_map(self)
    }
}

impl<'de> Visitor<'de> for Document<'_> {
    type Value = ();

    fn expecting(&self, f: &mut Formatter<'_>) -> std::fmt::Result {
        f.write_str("an object")
    }

    fn visit_map<A: MapAccess<'de>>(self, mut object: A) -> Result<(), A::Error> {
        let mut is_read = false;
        while let Some(key) = object.next_key::<String>()? {
            if key != "frames" {
                object.next_value::<IgnoredAny>()?;
            } else if std::mem::replace(&mut is_read, true) {
                return Err(A::Error::custom("the key `frames` comes twice"));
            } else {
                object.next_value_seed(Frames(&mut *self.0))?;
            }
        }
        Ok(())
    }
}

impl<'de> DeserializeSeed<'de> for Frames<'_, '_> {
    type Value = ();

    fn deserialize<D: Deserializer<'de>>(self, deserializer: D) -> Result<(), D::Error> {
        deserializer.deserialize_seq(self)
    }
}

impl<'de> Visitor<'de> for Frames<'_, '_> {
    type Value = ();

    fn expecting(&self, f: &mut Formatter<'_>) -> std::fmt::Result {
        f.write_str("a list")
    }

    fn visit_seq<A: SeqAccess<'de>>(self, mut list: A) -> Result<(), A::Error> {
        while let Some(frame) = list.next_element_seed(Pruned { depth: 0, keeps_names: false })? {
            if !(self.0)(frame) {
                return Err(A::Error::custom("stopped"));
            }
        }
        Ok(())
    }
}
