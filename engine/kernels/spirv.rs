//! Translates SPIR-V operations to Rust, and reads SPIR-V strings. Used by `reflect`.

/// Returns the Rust expression of a SPIR-V opcode over its operands' expressions.
pub fn operation(opcode: u32, v: &[String]) -> Result<String, String> {
    let binary = |op: &str| Ok(format!("(({}) {op} ({}))", v[0], v[1]));
    let compare = |op: &str| Ok(format!("((({}) {op} ({})) as u32)", v[0], v[1]));
    match opcode {
        124 => Ok(v[0].clone()),
        128 => binary("+"),
        130 => binary("-"),
        132 => binary("*"),
        134 | 135 => binary("/"),
        137..=139 => binary("%"),
        194 | 195 => binary(">>"),
        196 => binary("<<"),
        166 | 197 => binary("|"),
        198 => binary("^"),
        167 | 199 => binary("&"),
        169 => Ok(format!("(if ({}) != 0 {{ {} }} else {{ {} }})", v[0], v[1], v[2])),
        164 | 170 => compare("=="),
        165 | 171 => compare("!="),
        172 | 173 => compare(">"),
        174 | 175 => compare(">="),
        176 | 177 => compare("<"),
        178 | 179 => compare("<="),
        168 => Ok(format!("(1 - ({}))", v[0])),
        other => Err(format!("operation {other} in an array length is not supported")),
    }
}

/// Returns the string stored in words.
pub fn text(words: &[u32]) -> String {
    let bytes: Vec<u8> = words.iter().flat_map(|w| w.to_le_bytes()).take_while(|&b| b != 0).collect();
    String::from_utf8_lossy(&bytes).into_owned()
}
