//! The page's files, compiled into the program: the page loads nothing from elsewhere.

macro_rules! files {
    ($($name:literal),* $(,)?) => {
        &[$((concat!("/", $name), include_str!(concat!("web/", $name)))),*]
    };
}

const HTML: &str = "/index.html";

/// Path, contents.
const FILES: &[(&str, &str)] = files![
    "index.html",
    "style.css",
    "icon.svg",
    "main.js",
    "maths.js",
    "camera.js",
    "controls.js",
    "detail.js",
    "edit.js",
    "tape.js",
    "texts.js",
    "place.js",
    "link.js",
    "frames.js",
    "overlay.js",
    "filter.js",
    "stage.js",
    "panel.js",
    "photos.js",
    "pick.js",
    "film.js",
    "training.js",
];

/// Returns the MIME type and contents of the file at a path.
pub fn find(path: &str) -> Option<(&'static str, &'static str)> {
    let path = if path == "/" { HTML } else { path };
    let (name, text) = FILES.iter().find(|(name, _)| *name == path)?;
    let kind = match name.rsplit_once('.')?.1 {
        "html" => "text/html; charset=utf-8",
        "css" => "text/css; charset=utf-8",
        "svg" => "image/svg+xml",
        _ => "text/javascript; charset=utf-8",
    };
    Some((kind, text))
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::BTreeSet;

    /// Every file that a page names is an asset.
    #[test]
    fn nothing_is_loaded_from_elsewhere() {
        for (name, text) in FILES {
            for start in ["from './", "import './", "href=\"", "src=\""] {
                for rest in text.split(start).skip(1) {
                    let target = rest.split(['\'', '"']).next().unwrap_or_default();
                    assert!(find(&format!("/{target}")).is_some(), "{name} names {target}");
                }
            }
            // Behind a proxy that serves the viewer below a path, an address from the root leads elsewhere.
            for start in ["=\"/", "`/", "fetch('/", "'POST', '/"] {
                assert!(!text.contains(start), "{name}: {start}");
            }
            let foreign = text.replace("http://www.w3.org/", "");
            assert!(!foreign.contains("http://") && !foreign.contains("https://"), "{name}");
        }
        assert!(find("/").is_some() && find("/nothing").is_none());
    }

    /// The page names exactly the entries of texts.js, and has no text of its own but for one that needs no script.
    #[test]
    fn all_texts_stand_in_one_file() {
        let other = |c: char| !c.is_ascii_alphanumeric();
        let mut named = BTreeSet::new();
        for (_, text) in FILES.iter().filter(|(name, _)| *name != "/texts.js") {
            let text = text.replace("'./texts.js'", "");
            for start in ["data-text=\"", "texts."] {
                named.extend(
                    text.split(start).skip(1).filter_map(|rest| rest.split(other).next()).map(str::to_owned),
                );
            }
        }
        let (_, texts) =
            find("/texts.js").and_then(|(_, text)| text.split_once("export const texts")).expect("texts");
        let entries = texts.match_indices(": ").filter_map(|(at, colon)| {
            let name = texts[..at]
                .rsplit(other)
                .next()
                .filter(|name| !["", "text", "title", "placeholder"].contains(name));
            name.filter(|_| texts[at + colon.len()..].starts_with(['\'', '"', '(', '{', '[']))
        });
        let mut entries: Vec<&str> = entries.collect();
        entries.sort_unstable();
        assert_eq!(entries, named.iter().map(String::as_str).collect::<Vec<_>>());

        let html = find("/").expect("a page").1;
        for words in html.split('>').filter_map(|part| part.split('<').next()).map(str::trim) {
            let stays = words == "ashsplat" || words.starts_with("loading the page; ");
            assert!(stays || !words.contains(char::is_alphabetic), "{words}");
        }
        for attribute in [" title=", " aria-label=", " placeholder="] {
            assert!(!html.contains(attribute), "{attribute}");
        }
    }
}
