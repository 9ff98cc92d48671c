//! Deeply nested input cannot overflow a reader's stack, as the machine code shows. It contains all calls, across
//! files and from generic code. Calls through vtables are not seen.

use std::collections::{HashMap, HashSet};
use std::io::{BufRead, BufReader};
use std::process::{Command, Stdio};

/// Functions that each function calls, jumps to or takes the address of.
type Graph = HashMap<String, HashSet<String>>;

/// Symbol at the end of a line, without an offset: `call 1b20 <name>`, `lea 0x3d2(%rip),%rax # 1f40 <name>`.
fn target(line: &str) -> Option<&str> {
    let name = line.strip_suffix('>')?.rsplit_once('<')?.1;
    Some(name.rsplit_once("+0x").map_or(name, |(function, _)| function))
}

fn graph(disassembly: impl Iterator<Item = String>) -> Graph {
    let (mut graph, mut current) = (Graph::new(), String::new());
    for line in disassembly {
        if let Some((_, name)) = line.strip_suffix(">:").and_then(|line| line.split_once(" <")) {
            current = name.to_owned();
            graph.entry(current.clone()).or_default();
            continue;
        }
        let Some(called) = target(line.trim_end()) else { continue };
        // A jump within a function is a loop, and an address is a table, unless it is the function's own.
        let own_address = line.contains("lea ") && !line.contains("+0x");
        if called != current || line.contains("call ") || own_address {
            graph.entry(current.clone()).or_default().insert(called.to_owned());
        }
    }
    graph
}

/// Keeps only functions that may lie in a cycle: removes those without callers or callees until none is left.
fn without_ends(mut graph: Graph) -> Graph {
    loop {
        let called: HashSet<String> = graph.values().flatten().cloned().collect();
        let before = graph.len();
        graph.retain(|name, calls| !calls.is_empty() && called.contains(name));
        if graph.len() == before {
            return graph;
        }
        let left: HashSet<String> = graph.keys().cloned().collect();
        graph.values_mut().for_each(|calls| calls.retain(|name| left.contains(name)));
    }
}

/// Functions with `part` in their names that can reach themselves.
fn in_circles(graph: Graph, part: &str) -> Vec<String> {
    let graph = without_ends(graph);
    let reaches_itself = |start: &String| {
        let (mut seen, mut open) = (HashSet::new(), vec![start]);
        while let Some(name) = open.pop() {
            for next in &graph[name] {
                if next == start {
                    return true;
                }
                if seen.insert(next) {
                    open.push(next);
                }
            }
        }
        false
    };
    let mut circles: Vec<String> =
        graph.keys().filter(|name| name.contains(part) && reaches_itself(name)).cloned().collect();
    circles.sort();
    circles
}

#[cfg(all(target_os = "linux", target_arch = "x86_64"))]
#[test]
fn call_graph_of_the_readers_has_no_circles() {
    let mut objdump = Command::new("objdump");
    let objdump = objdump.args(["-d", "--no-show-raw-insn", env!("CARGO_BIN_EXE_ashsplat")]);
    let mut child = match objdump.stdout(Stdio::piped()).spawn() {
        Ok(child) => child,
        Err(error) => {
            // It belongs to the linker that built this.
            eprintln!("skipped: objdump: {error}");
            return;
        }
    };
    let lines = BufReader::new(child.stdout.take().expect("its output")).lines();
    let graph = graph(lines.map(|line| line.expect("text")));
    assert!(child.wait().expect("it ends").success());
    let readers = graph.keys().filter(|name| name.contains("ashsplat_files")).count();
    assert!(readers > 300, "{readers} functions of the readers are in the program");
    // A function that recurses over three levels of folders proves that cycles are found.
    let all = in_circles(graph, "ashsplat");
    assert!(all.iter().any(|name| name.contains("remove_leftovers_named")), "{all:#?}");
    // serde_json refuses more than 128 levels before these recurse.
    let is_bounded = |name: &str| name.contains("TileJson") || name.contains("transforms..Pruned");
    let readers = all.iter().filter(|name| name.contains("ashsplat_files") && !is_bounded(name));
    let readers: Vec<_> = readers.collect();
    assert!(readers.is_empty(), "{readers:#?}");
}
