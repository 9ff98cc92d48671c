//! The page's files, compiled into the program: the page loads nothing from elsewhere.

macro_rules! files {
    ($($name:literal),* $(,)?) => {
        &[$((concat!("/", $name), include_str!(concat!("web/", $name)))),*]
    };
}

const HTML: &str = "/index.html";

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
        let alphanumeric = |c: char| c.is_ascii_alphanumeric();
        let mut named = BTreeSet::new();
        for (_, file) in FILES.iter().filter(|(name, _)| *name != "/texts.js") {
            for start in ["data-text=\"", "texts."] {
                let names =
                    file.split(start).skip(1).filter_map(|rest| rest.split(|c| !alphanumeric(c)).next());
                named.extend(names);
            }
        }
        // Imports name the file.
        named.remove("js");
        let (_, file) = find("/texts.js").expect("texts");
        let (_, texts) = file.split_once("export const texts").expect("texts");
        let words: Vec<&str> = texts.split_whitespace().collect();
        let mut entries = BTreeSet::new();
        for pair in words.windows(2).filter(|pair| pair[1].starts_with(['\'', '"', '(', '{', '['])) {
            let name =
                pair[0].strip_suffix(':').filter(|name| name.chars().all(alphanumeric)).unwrap_or_default();
            let part = ["", "text", "title", "placeholder", "rows"].contains(&name);
            assert!(part || entries.insert(name), "{name} twice");
        }
        let different: Vec<_> = entries.symmetric_difference(&named).collect();
        assert!(different.is_empty(), "{different:?}");

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
