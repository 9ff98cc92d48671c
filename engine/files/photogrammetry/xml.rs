//! XML files within bounds.

use std::path::Path;

use roxmltree::{Document, Node};

use crate::host_memory;
use ashsplat::{Error, Result};

/// Memory of an element with its text, and of an attribute, bytes.
const NODE_BYTES: u64 = 400;
const ATTRIBUTE_BYTES: u64 = 160;
/// Most attributes of an element. Parsing takes the square of their number.
const ATTRIBUTES: usize = 256;
/// Most namespaces. Each element may hold a list of them.
const NAMESPACES: usize = 64;

/// Parses an XML file, if the machine has free memory for its contents.
pub(super) fn parse<'t>(path: &Path, text: &'t str) -> Result<Document<'t>> {
    let error = |problem: String| Error::input(path, problem, "export it again");
    let count = |byte: u8| text.bytes().filter(|own| *own == byte).count() as u64;
    let bytes = NODE_BYTES * count(b'<') + ATTRIBUTE_BYTES * count(b'=');
    host_memory::check_free(path, bytes + text.len() as u64)?;
    if text.split('<').any(|tag| tag.matches('=').nth(ATTRIBUTES).is_some()) {
        return Err(error(format!("has an element of more than {ATTRIBUTES} attributes")));
    }
    if text.matches("xmlns").nth(NAMESPACES).is_some() {
        return Err(error(format!("has more than {NAMESPACES} namespaces")));
    }
    Document::parse(text).map_err(|e| error(format!("is not XML: {e}")))
}

/// The elements of this name directly in `node`, in any namespace.
pub(super) fn named<'a, 't>(node: Node<'a, 't>, name: &'static str) -> impl Iterator<Item = Node<'a, 't>> {
    node.children().filter(move |child| child.tag_name().name() == name)
}

/// The first element of this name directly in `node`.
pub(super) fn first<'a, 't>(node: Node<'a, 't>, name: &'static str) -> Option<Node<'a, 't>> {
    named(node, name).next()
}
