//! The parts of the window that need no display, with their own tests: the program has them only with its feature
//! `window`. The window's keys must have the page's names and meanings, or a reason for the difference.

#[path = "../../tools/view/window/present/choice.rs"]
mod choice;
#[path = "../../tools/view/window/comparison.rs"]
mod comparison;
#[path = "../../tools/view/window/controls.rs"]
mod controls;
#[path = "../../tools/view/window/keys.rs"]
mod keys;
#[path = "../../tools/view/window/navigation.rs"]
mod navigation;
#[path = "../../tools/view/window/pace.rs"]
mod pace;
#[path = "../../tools/view/window/text.rs"]
mod text;
#[path = "../../tools/view/window/words.rs"]
mod words;

use keys::{Action, KEYS, ONLY_PAGE};

fn page(file: &str) -> String {
    let path = crate::common::root().join("tools/view/web").join(file);
    std::fs::read_to_string(path).expect("a file of the page")
}

/// Text between the first occurrences of two marks.
fn between<'a>(text: &'a str, from: &str, to: &str) -> &'a str {
    let rest = text.split_once(from).unwrap_or_else(|| panic!("no '{from}'")).1;
    rest.split_once(to).unwrap_or_else(|| panic!("no '{to}' after '{from}'")).0
}

/// Entries `Name: value` of a constant in controls.js.
fn entries<'a>(text: &'a str, constant: &str) -> Vec<(&'a str, Vec<f64>)> {
    let mut found = Vec::new();
    let mut rest = between(text, &format!("const {constant} = {{"), "};");
    while let Some((name, behind)) = rest.split_once(':') {
        let name = name.trim_start_matches([' ', ',']);
        let end = if behind.trim_start().starts_with('[') { "]" } else { "," };
        let (value, behind) = behind.split_once(end).unwrap_or((behind, ""));
        let numbers = value.trim_matches(['[', ']', ' ']).split(',').map(str::trim);
        let numbers = numbers.map(|number| number.trim_matches(['[', ']']).parse().expect("a number"));
        found.push((name, numbers.collect()));
        rest = behind;
    }
    found
}

#[test]
fn window_has_the_keys_of_the_page() {
    let (controls, main) = (page("controls.js"), page("main.js"));
    let action = |code: &str| KEYS.iter().find(|(name, _)| *name == code).map(|(_, action)| *action);
    let mut known = Vec::new();
    type Expected = fn(&[f64]) -> Action;
    let kinds: [(&str, Expected); 3] = [
        ("FLY_KEYS", |v| Action::Fly([v[0], v[1], v[2]])),
        ("TURN_KEYS", |v| Action::Turn([v[0], v[1]])),
        ("ZOOM_KEYS", |v| Action::Zoom(v[0])),
    ];
    for (constant, expected) in kinds {
        for (code, numbers) in entries(&controls, constant) {
            assert_eq!(action(code), Some(expected(&numbers)), "{code}");
            known.push(code.to_owned());
        }
    }
    assert_eq!(known.len(), 14, "{known:?}");
    let handler = between(&main, "function key(code, event) {", "\n}");
    assert!(handler.contains("/^(?:Digit|Numpad)([1-5])$/"), "{handler}");
    for place in 0..5 {
        for kind in ["Digit", "Numpad"] {
            let code = format!("{kind}{}", place + 1);
            assert_eq!(action(&code), Some(Action::Mode(place)), "{code}");
            known.push(code);
        }
    }
    for part in handler.split("code === '").skip(1) {
        let code = part.split('\'').next().expect("a name");
        let only_page = ONLY_PAGE.iter().any(|(key, _)| *key == code);
        assert!(action(code).is_some() != only_page, "{code} is neither in the window nor left out of it");
        // F has two meanings, with and without Shift.
        if !known.iter().any(|k| k == code) {
            known.push(code.to_owned());
        }
    }
    let window: Vec<_> = KEYS.iter().map(|(code, _)| *code).chain(ONLY_PAGE.map(|(code, _)| code)).collect();
    let unknown: Vec<_> = window.iter().filter(|code| !known.iter().any(|k| k == *code)).collect();
    assert!(unknown.is_empty() && known.len() == window.len(), "not keys of the page: {unknown:?}");
}
