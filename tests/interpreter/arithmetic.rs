//! Operations on words: once for constants, once for all lanes of a subgroup.
//!
//! Floats are f32 as Rust computes them, without contraction; functions are those of the standard library.

use std::cell::Cell;

/// Value of undefined results (a quotient by 0, a shift too far) and of unwritten words. As a float it is NaN.
pub(crate) const POISON: u32 = 0x7FC5_A5A5;

/// Codes besides SPIR-V's opcodes: the upper half of a product; and from EXTENDED on, the instructions of
/// GLSL.std.450.
pub(crate) const MULTIPLY_HIGH: u16 = 1000;
pub(crate) const EXTENDED: u16 = 2000;

fn f(bits: u32) -> f32 {
    f32::from_bits(bits)
}

fn float(op: impl Fn(f32, f32) -> f32) -> impl Fn([u32; 2]) -> u32 {
    move |[a, b]| op(f(a), f(b)).to_bits()
}

fn compare(op: impl Fn(f32, f32) -> bool) -> impl Fn([u32; 2]) -> u32 {
    move |[a, b]| u32::from(op(f(a), f(b)))
}

fn signed(op: impl Fn(i32, i32) -> bool) -> impl Fn([u32; 2]) -> u32 {
    move |[a, b]| u32::from(op(a as i32, b as i32))
}

fn one(op: impl Fn(f32) -> f32) -> impl Fn([u32; 1]) -> u32 {
    move |[a]| op(f(a)).to_bits()
}

/// Generates a table of operations with `$count` operands: one function for single words, one for the words of all
/// lanes.
macro_rules! operations {
    ($single:ident, $lanes:ident, $count:literal, { $($code:pat => $op:expr,)* }) => {
        /// The operation on single words; None for an unknown code.
        pub(crate) fn $single(code: u16, operands: [u32; $count]) -> Option<u32> {
            match code {
                $($code => Some(($op)(operands)),)*
                _ => None,
            }
        }

        /// The operation on the words of all lanes. Unknown codes were refused when the program was built.
        pub(crate) fn $lanes(code: u16, target: &[Cell<u32>], operands: [&[Cell<u32>]; $count]) {
            let operands = operands.map(|row| &row[..target.len()]);
            match code {
                $($code => {
                    let op = $op;
                    for lane in 0..target.len() {
                        target[lane].set(op(operands.map(|row| row[lane].get())));
                    }
                })*
                _ => {}
            }
        }
    };
}

operations!(unary, unary_lanes, 1, {
    // ConvertFToU, ConvertFToS, ConvertSToF, ConvertUToF; Rust saturates.
    109 => |[a]: [u32; 1]| f(a) as u32,
    110 => |[a]: [u32; 1]| (f(a) as i32) as u32,
    111 => |[a]: [u32; 1]| (a as i32 as f32).to_bits(),
    112 => |[a]: [u32; 1]| (a as f32).to_bits(),
    // Bitcast, CopyObject
    124 | 83 => |[a]: [u32; 1]| a,
    // SNegate, FNegate
    126 => |[a]: [u32; 1]| a.wrapping_neg(),
    127 => |[a]: [u32; 1]| a ^ 0x8000_0000,
    // IsNan, IsInf
    156 => |[a]: [u32; 1]| u32::from(f(a).is_nan()),
    157 => |[a]: [u32; 1]| u32::from(f(a).is_infinite()),
    // LogicalNot, Not, BitReverse, BitCount
    168 => |[a]: [u32; 1]| a ^ 1,
    200 => |[a]: [u32; 1]| !a,
    204 => |[a]: [u32; 1]| a.reverse_bits(),
    205 => |[a]: [u32; 1]| a.count_ones(),
    // Round, RoundEven, Trunc, FAbs, SAbs, FSign, SSign, Floor, Ceil, Fract
    2001 => one(f32::round),
    2002 => one(f32::round_ties_even),
    2003 => one(f32::trunc),
    2004 => |[a]: [u32; 1]| a & 0x7FFF_FFFF,
    2005 => |[a]: [u32; 1]| (a as i32).wrapping_abs() as u32,
    2006 => one(|x| if x > 0.0 { 1.0 } else if x < 0.0 { -1.0 } else { x }),
    2007 => |[a]: [u32; 1]| (a as i32).signum() as u32,
    2008 => one(f32::floor),
    2009 => one(f32::ceil),
    2010 => one(|x| x - x.floor()),
    // Sin, Cos, Exp, Log, Exp2, Log2, Sqrt, InverseSqrt
    2013 => one(f32::sin),
    2014 => one(f32::cos),
    2027 => one(f32::exp),
    2028 => one(f32::ln),
    2029 => one(f32::exp2),
    2030 => one(f32::log2),
    2031 => one(f32::sqrt),
    2032 => one(|x| 1.0 / x.sqrt()),
    // FindILsb, FindUMsb: -1 without a bit
    2073 => |[a]: [u32; 1]| if a == 0 { u32::MAX } else { a.trailing_zeros() },
    2075 => |[a]: [u32; 1]| if a == 0 { u32::MAX } else { 31 - a.leading_zeros() },
});

operations!(binary, binary_lanes, 2, {
    128 => |[a, b]: [u32; 2]| a.wrapping_add(b),
    129 => float(|a, b| a + b),
    130 => |[a, b]: [u32; 2]| a.wrapping_sub(b),
    131 => float(|a, b| a - b),
    132 => |[a, b]: [u32; 2]| a.wrapping_mul(b),
    133 => float(|a, b| a * b),
    134 => |[a, b]: [u32; 2]| a.checked_div(b).unwrap_or(POISON),
    135 => |[a, b]: [u32; 2]| (a as i32).checked_div(b as i32).map_or(POISON, |x| x as u32),
    136 => float(|a, b| a / b),
    137 => |[a, b]: [u32; 2]| a.checked_rem(b).unwrap_or(POISON),
    138 => |[a, b]: [u32; 2]| (a as i32).checked_rem(b as i32).map_or(POISON, |x| x as u32),
    139 => |[a, b]: [u32; 2]| modulo(a as i32, b as i32),
    140 => float(|a, b| a % b),
    141 => float(|a, b| a - b * (a / b).floor()),
    MULTIPLY_HIGH => |[a, b]: [u32; 2]| ((u64::from(a) * u64::from(b)) >> 32) as u32,
    // LogicalEqual, LogicalNotEqual, LogicalOr, LogicalAnd; IEqual, INotEqual
    164 | 170 => |[a, b]: [u32; 2]| u32::from(a == b),
    165 | 171 => |[a, b]: [u32; 2]| u32::from(a != b),
    166 | 197 => |[a, b]: [u32; 2]| a | b,
    167 | 199 => |[a, b]: [u32; 2]| a & b,
    198 => |[a, b]: [u32; 2]| a ^ b,
    172 => |[a, b]: [u32; 2]| u32::from(a > b),
    173 => signed(|a, b| a > b),
    174 => |[a, b]: [u32; 2]| u32::from(a >= b),
    175 => signed(|a, b| a >= b),
    176 => |[a, b]: [u32; 2]| u32::from(a < b),
    177 => signed(|a, b| a < b),
    178 => |[a, b]: [u32; 2]| u32::from(a <= b),
    179 => signed(|a, b| a <= b),
    // Ordered comparisons, and unordered ones, which negate ordered ones
    180 => compare(|a, b| a == b),
    182 => compare(|a, b| a != b && !a.is_nan() && !b.is_nan()),
    183 => compare(|a, b| a != b),
    184 => compare(|a, b| a < b),
    186 => compare(|a, b| a > b),
    188 => compare(|a, b| a <= b),
    190 => compare(|a, b| a >= b),
    194 => |[a, b]: [u32; 2]| if b < 32 { a >> (b & 31) } else { POISON },
    195 => |[a, b]: [u32; 2]| if b < 32 { ((a as i32) >> (b & 31)) as u32 } else { POISON },
    196 => |[a, b]: [u32; 2]| if b < 32 { a << (b & 31) } else { POISON },
    // Pow, FMin, UMin, SMin, FMax, UMax, SMax, Step
    2026 => float(f32::powf),
    2037 | 2079 => float(f32::min),
    2038 => |[a, b]: [u32; 2]| a.min(b),
    2039 => |[a, b]: [u32; 2]| (a as i32).min(b as i32) as u32,
    2040 | 2080 => float(f32::max),
    2041 => |[a, b]: [u32; 2]| a.max(b),
    2042 => |[a, b]: [u32; 2]| (a as i32).max(b as i32) as u32,
    2048 => float(|edge, x| if x < edge { 0.0 } else { 1.0 }),
});

operations!(ternary, ternary_lanes, 3, {
    // Select, BitFieldUExtract
    169 => |[a, b, c]: [u32; 3]| if a != 0 { b } else { c },
    203 => bit_field,
    // FClamp, UClamp, SClamp, FMix, Fma
    2043 | 2081 => |[a, b, c]: [u32; 3]| f(a).max(f(b)).min(f(c)).to_bits(),
    2044 => |[a, b, c]: [u32; 3]| a.max(b).min(c),
    2045 => |[a, b, c]: [u32; 3]| (a as i32).max(b as i32).min(c as i32) as u32,
    2046 => |[a, b, c]: [u32; 3]| (f(a) * (1.0 - f(c)) + f(b) * f(c)).to_bits(),
    2050 => |[a, b, c]: [u32; 3]| f(a).mul_add(f(b), f(c)).to_bits(),
});

/// An operation on one to three words; None for an unknown code.
pub(crate) fn evaluate(code: u16, operands: &[u32]) -> Option<u32> {
    match *operands {
        [a] => unary(code, [a]),
        [a, b] => binary(code, [a, b]),
        [a, b, c] => ternary(code, [a, b, c]),
        _ => None,
    }
}

/// The remainder with the sign of the divisor.
fn modulo(a: i32, b: i32) -> u32 {
    a.checked_rem(b).map_or(POISON, |rest| {
        if rest != 0 && (rest < 0) != (b < 0) { rest + b } else { rest }.cast_unsigned()
    })
}

fn bit_field([base, offset, count]: [u32; 3]) -> u32 {
    match (offset.checked_add(count), count) {
        (_, 0) => 0,
        (Some(end), _) if end <= 32 => (base >> offset) & (u32::MAX >> (32 - count)),
        _ => POISON,
    }
}
