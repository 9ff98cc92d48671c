//! Circles of imports: files that, over some others, import themselves.
//!
//! A file imports the file that defines a name which it uses, also where another one hands the name on. A file and the
//! modules nested in it belong together: what these take from it is not counted.

use std::collections::{BTreeMap, BTreeSet};

use super::{Source, assert_none, code_lines, sources};

/// Files of a circle at most.
const LARGEST: usize = 3;

/// The crates by their names in paths and their roots; programs have no name that others could use.
const CRATES: [(&str, &str); 8] = [
    ("ashsplat", "engine/lib.rs"),
    ("ashsplat_files", "engine/files/lib.rs"),
    ("ashsplat_c", "tools/capi/lib.rs"),
    ("ashsplat_demo_scene", "tools/demo_scene/lib.rs"),
    ("-cli", "tools/ashsplat/main.rs"),
    ("-embed", "tools/embed/main.rs"),
    ("-siege", "tools/siege/main.rs"),
    ("ashsplat_interpreter", "tests/interpreter/lib.rs"),
];

/// The name of a crate, then those of modules, then that of an item.
type Path = Vec<String>;

#[derive(Default)]
struct File {
    module: Path,
    /// What its `use` declarations bring in, and under which names.
    uses: Vec<(Path, String)>,
    /// Other paths in it.
    paths: Vec<Path>,
}

/// All files that the crates' `mod` declarations reach.
struct House {
    files: BTreeMap<String, File>,
    of_module: BTreeMap<Path, String>,
}

impl House {
    fn new(sources: &[Source]) -> Self {
        let texts: BTreeMap<&str, &str> =
            sources.iter().map(|s| (s.path.as_str(), s.text.as_str())).collect();
        let mut house = Self { files: BTreeMap::new(), of_module: BTreeMap::new() };
        for (name, root) in CRATES {
            house.add(&texts, vec![name.to_owned()], root);
        }
        house
    }

    fn add(&mut self, texts: &BTreeMap<&str, &str>, module: Path, file: &str) {
        let Some(text) = texts.get(file) else { return };
        let code: String = code_lines(text).map(|(_, line)| line.to_owned() + "\n").collect();
        let (declared, read) = File::read(&code, module.clone());
        self.files.insert(file.to_owned(), read);
        self.of_module.insert(module.clone(), file.to_owned());
        let (folder, name) = file.rsplit_once('/').unwrap_or(("", file));
        let is_head = module.len() == 1 || name == "mod.rs";
        let folder =
            if is_head { folder.to_owned() } else { format!("{folder}/{}", name.trim_end_matches(".rs")) };
        for child in declared {
            let path = [module.as_slice(), std::slice::from_ref(&child)].concat();
            for file in [format!("{folder}/{child}.rs"), format!("{folder}/{child}/mod.rs")] {
                self.add(texts, path.clone(), &file);
            }
        }
    }

    /// The file that defines what a path in a module names.
    fn resolve(&self, module: &[String], path: &[String], depth: u32) -> Option<&String> {
        let first = path.first().filter(|_| depth < 10)?;
        let (mut at, mut rest) = match first.as_str() {
            "crate" => (module[..1].to_vec(), &path[1..]),
            "self" => (module.to_vec(), &path[1..]),
            "super" => (module[..module.len() - 1].to_vec(), &path[1..]),
            name if CRATES.iter().any(|(krate, _)| *krate == name) => (vec![name.to_owned()], &path[1..]),
            name => {
                let child = [module, &[name.to_owned()]].concat();
                (self.of_module.contains_key(&child).then(|| module.to_vec())?, path)
            }
        };
        while let Some((name, behind)) = rest.split_first() {
            if name == "super" {
                at.pop();
            } else {
                let child = [at.as_slice(), std::slice::from_ref(name)].concat();
                if !self.of_module.contains_key(&child) {
                    let file = self.of_module.get(&at)?;
                    let handed_on = self.files[file].uses.iter().find(|(_, known)| known == name);
                    let origin = handed_on.map(|(origin, _)| [origin, behind].concat());
                    return origin.and_then(|path| self.resolve(&at, &path, depth + 1)).or(Some(file));
                }
                at = child;
            }
            rest = behind;
        }
        self.of_module.get(&at)
    }

    /// The files that a file imports.
    fn imports(&self, name: &str, file: &File) -> BTreeSet<&String> {
        let known = |first: &String| file.uses.iter().find(|(_, name)| name == first);
        let elsewhere = file.paths.iter().map(|path| match known(&path[0]) {
            Some((origin, _)) => [origin, &path[1..]].concat(),
            None => path.clone(),
        });
        let all = file.uses.iter().map(|(path, _)| path.clone()).chain(elsewhere);
        all.filter_map(|path| self.resolve(&file.module, &path, 0))
            .filter(|other| *other != name && !file.module.starts_with(&self.files[*other].module))
            .collect()
    }

    /// Each circle, its files in order.
    fn circles(&self) -> BTreeSet<Vec<&String>> {
        let imports: BTreeMap<&String, _> =
            self.files.iter().map(|(name, file)| (name, self.imports(name, file))).collect();
        let mut reached: BTreeMap<&String, BTreeSet<&String>> = BTreeMap::new();
        for start in self.files.keys() {
            let (mut found, mut open) = (BTreeSet::new(), vec![start]);
            while let Some(next) = open.pop() {
                open.extend(imports[next].iter().filter(|other| found.insert(**other)));
            }
            reached.insert(start, found);
        }
        let circle =
            |file| reached[file].iter().copied().filter(|other| reached[other].contains(file)).collect();
        self.files.keys().map(circle).filter(|circle: &Vec<_>| !circle.is_empty()).collect()
    }

    fn too_large(&self) -> Vec<String> {
        let circles = self.circles().into_iter().filter(|circle| circle.len() > LARGEST);
        circles
            .map(|circle| {
                format!("{}: {}", circle.len(), circle.into_iter().cloned().collect::<Vec<_>>().join(" "))
            })
            .collect()
    }
}

impl File {
    /// The modules that the code declares, and what it imports.
    fn read(code: &str, module: Path) -> (Vec<String>, Self) {
        let (mut declared, mut file) = (Vec::new(), Self { module, ..Self::default() });
        for statement in code.split_inclusive([';', '{', '}']) {
            let words: Vec<&str> = statement.split_whitespace().collect();
            if let [.., "mod", name] = words.as_slice()
                && let Some(name) = name.strip_suffix(';')
            {
                declared.push(name.to_owned());
            }
        }
        let mut rest = code;
        while let Some(at) = rest.find("use ") {
            let begins = rest[..at].trim_end_matches([' ', '\n']);
            let (before, behind) = (&rest[..at], &rest[at + 4..]);
            file.add_paths(before);
            let declares = begins.is_empty() || begins.ends_with([';', '}', '{', ']', ')', 'b']);
            rest =
                match behind.split_once(';').filter(|_| declares && !before.ends_with(char::is_alphanumeric))
                {
                    Some((tree, behind)) => {
                        expand(&[], tree, &mut file.uses);
                        behind
                    }
                    None => behind,
                };
        }
        file.add_paths(rest);
        (declared, file)
    }

    /// Adds all `a::b` of a piece of code.
    fn add_paths(&mut self, code: &str) {
        let words = code.split(|c: char| !(c.is_alphanumeric() || "_:$".contains(c)));
        let paths = words.map(|word| word.split("::").map(str::to_owned).collect::<Path>());
        self.paths.extend(paths.filter(|path| path.len() > 1 && !path.iter().any(String::is_empty)));
    }
}

/// The paths of a tree of imports, with the name that each brings in.
fn expand(before: &[String], tree: &str, found: &mut Vec<(Path, String)>) {
    let tree = tree.trim();
    if let Some((head, group)) = tree.split_once('{') {
        let head = head.trim().trim_end_matches("::").split("::").filter(|name| !name.is_empty());
        let before: Path = before.iter().cloned().chain(head.map(str::to_owned)).collect();
        let (mut depth, mut start) = (0, 0);
        for (at, c) in group.char_indices() {
            match c {
                '{' => depth += 1,
                '}' if depth > 0 => depth -= 1,
                ',' | '}' if depth == 0 => {
                    expand(&before, &group[start..at], found);
                    start = at + 1;
                }
                _ => {}
            }
        }
    } else if !tree.is_empty() {
        let (path, name) = tree.split_once(" as ").unwrap_or((tree, ""));
        let path: Path = before.iter().cloned().chain(path.trim().split("::").map(str::to_owned)).collect();
        let path: Path = path.into_iter().filter(|name| name != "*").collect();
        let path = if path.len() > 1 && path.ends_with(&["self".to_owned()]) {
            path[..path.len() - 1].to_vec()
        } else {
            path
        };
        let name =
            if name.is_empty() { path.last().cloned().unwrap_or_default() } else { name.trim().to_owned() };
        found.push((path, name));
    }
}

fn example(files: &[(&str, &str)]) -> Vec<Source> {
    files.iter().map(|(path, text)| Source { path: (*path).into(), text: (*text).into() }).collect()
}

#[test]
fn architecture_circles_are_found() {
    let lib = ("engine/lib.rs", "pub mod a;\nmod b;\nmod c;\nmod d;\npub use d::D;");
    let b = ("engine/b.rs", "use crate::{Error, c::{self, C as Other}};");
    let d = ("engine/d.rs", "pub struct D;\nfn f() { super::a::f() }");
    // Through a name that lib.rs hands on, a path within code, and a group.
    let four = example(&[lib, ("engine/a.rs", "use super::b;"), b, ("engine/c.rs", "use crate::D;"), d]);
    assert_eq!(House::new(&four).too_large(), ["4: engine/a.rs engine/b.rs engine/c.rs engine/d.rs"]);
    let three = example(&[lib, ("engine/a.rs", "use super::c;"), b, ("engine/c.rs", "use crate::D;"), d]);
    assert_eq!(House::new(&three).circles().first().map(Vec::len), Some(3));
    assert!(House::new(&three).too_large().is_empty());
    // Unit tests and comments do not count.
    let tests = "// crate::D\n#[cfg(test)]\nmod tests { use crate::D; }";
    let none = example(&[lib, ("engine/a.rs", "use super::b;"), b, ("engine/c.rs", tests), d]);
    assert!(House::new(&none).circles().is_empty());
    // A module and those nested in it.
    let nested = [
        ("engine/lib.rs", "mod a;"),
        ("engine/a.rs", "mod x;\nuse x::X;"),
        ("engine/a/x.rs", "use super::A;"),
    ];
    assert!(House::new(&example(&nested)).circles().is_empty());
}

#[test]
fn architecture_no_large_circles_of_imports() {
    let house = House::new(&sources(&["engine", "tools", "tests/interpreter"], &["rs"]));
    // Few enough are reached in other ways, by the build script or as tests.
    assert!(house.files.len() > 200, "{} files", house.files.len());
    let arrows: usize = house.files.iter().map(|(name, file)| house.imports(name, file).len()).sum();
    assert!(arrows > 500, "{arrows} arrows");
    assert_none("circles of imports", house.too_large());
}
