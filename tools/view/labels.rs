//! Short names of photos, without what all names share.

use std::collections::HashSet;

/// Letters that fit under a thumbnail.
const FIT: usize = 9;
const DOTS: char = '…';

/// A label for each name, in the same order: labels differ wherever the names do.
pub fn labels(names: &[&str]) -> Vec<String> {
    let last = |name: &&str| name.rsplit('/').next().unwrap_or_default().to_owned();
    let files: Vec<String> = names.iter().map(last).collect();
    // Drops folders if the file names differ without them.
    let whole = if differ(&files) { files } else { names.iter().map(|name| (*name).to_owned()).collect() };
    let whole = without_ending(whole);
    let letters: Vec<Vec<char>> = whole.iter().map(|name| name.chars().collect()).collect();
    let shared = shared_beginning(&letters);
    let rest: Vec<&[char]> = letters.iter().map(|name| &name[shared..]).collect();
    if rest.iter().all(|rest| rest.len() <= FIT) {
        return rest.iter().map(|rest| rest.iter().collect()).collect();
    }
    let ways: [fn(&[char]) -> String; 3] = [
        |rest| std::iter::once(&DOTS).chain(&rest[rest.len() + 1 - FIT..]).collect(),
        |rest| rest[..FIT - 1].iter().chain([&DOTS]).collect(),
        |rest| rest[..FIT / 2].iter().chain([&DOTS]).chain(&rest[rest.len() - FIT / 2..]).collect(),
    ];
    let shortened = |way: fn(&[char]) -> String| -> Vec<String> {
        rest.iter().map(|rest| if rest.len() <= FIT { rest.iter().collect() } else { way(rest) }).collect()
    };
    ways.into_iter().map(shortened).find(|labels| differ(labels)).unwrap_or(whole)
}

fn differ(names: &[String]) -> bool {
    names.iter().collect::<HashSet<_>>().len() == names.len()
}

/// Removes the ending (`.jpg`) if all names have the same one.
fn without_ending(names: Vec<String>) -> Vec<String> {
    let ending = |name: &String| name.rsplit_once('.').map(|(stem, ending)| (stem.len(), ending.to_owned()));
    let Some((_, first)) = names.first().and_then(ending) else { return names };
    let same = |name: &String| ending(name).is_some_and(|(stem, ending)| stem > 0 && ending == first);
    if !names.iter().all(same) {
        return names;
    }
    names.iter().map(|name| name[..name.len() - first.len() - 1].to_owned()).collect()
}

/// Number of letters that begin all names; splits no word or number.
fn shared_beginning(names: &[Vec<char>]) -> usize {
    let Some((first, others)) = names.split_first().filter(|(_, others)| !others.is_empty()) else {
        return 0;
    };
    let alike = |at: &usize| others.iter().all(|name| name.get(*at) == first.get(*at));
    let mut shared = (0..first.len()).take_while(alike).count();
    let kind = |c: char| if c.is_ascii_digit() { 1 } else { u8::from(c.is_alphabetic()) * 2 };
    let splits = |shared: usize| {
        let before = kind(first[shared - 1]);
        // A name that ends here would have no label.
        names.iter().any(|name| name.get(shared).is_none_or(|&c| before != 0 && kind(c) == before))
    };
    while shared > 0 && splits(shared) {
        shared -= 1;
    }
    shared
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_differs_is_shown() {
        for (names, expected) in [
            (&["images/00001.png", "images/00012.png"][..], &["00001", "00012"][..]),
            (&["IMG_20231122_100001.jpg", "IMG_20231122_100359.jpg"], &["100001", "100359"]),
            (&["DSC08115.JPG", "DSC08116.JPG"], &["08115", "08116"]),
            (&["left/01.png", "right/01.png"], &["left/01", "right/01"]),
            (&["cam", "cam.png"], &["cam", "cam.png"]),
            (&["only.png"], &["only"]),
            (&["a_very_long_name_1.png", "b_very_long_name_2.png"], &["…g_name_1", "…g_name_2"]),
            (&["garden_front_x.png", "kitchen_front_x.png"], &["garden_f…", "kitchen_…"]),
            (&["a", "a"], &["a", "a"]),
            (&[".hidden", ".png"], &["hidden", "png"]),
            (&[], &[]),
        ] {
            assert_eq!(labels(names), expected, "{names:?}");
        }
        let many: Vec<String> = (0..2000).map(|n| format!("scan/frame_extracted_{n}.jpeg")).collect();
        let many = labels(&many.iter().map(String::as_str).collect::<Vec<_>>());
        assert!(differ(&many) && many[7] == "7" && many[1999] == "1999");
    }
}
