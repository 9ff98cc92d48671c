//! Small handwritten modules whose faults must be found. The kernels' tests judge the results (tests/interpreted.rs).

use crate::{Dispatch, Fault, Order, Program};

fn i(opcode: u32, operands: &[u32]) -> Vec<u32> {
    [&[(operands.len() as u32 + 1) << 16 | opcode], operands].concat()
}

// Ids of every module below.
const VOID: u32 = 1;
const FUNCTION: u32 = 2;
const UINT: u32 = 3;
const BOOL: u32 = 4;
const ZERO: u32 = 5;
const ONE: u32 = 6;
const TWO: u32 = 7;
const BARRIER_OF_SHARED: u32 = 8;
const SUBGROUP: u32 = 9;
const LANE: u32 = 10;
const OUTPUT: u32 = 11;
const TO_WORD: u32 = 12;
const MAIN: u32 = 13;
const INDEX: u32 = 14;

/// A module with workgroups of 16 invocations, a buffer of words, and this body of its entry point.
fn module(body: &[Vec<u32>]) -> Vec<u32> {
    let header = vec![0x0723_0203, 0x0001_0600, 0, 100, 0];
    let (input, shader_words) = (20, 21);
    let declared = [
        i(15, &[5, MAIN, 0x6E69_616D, 0, SUBGROUP, LANE, OUTPUT, INDEX]),
        i(16, &[MAIN, 17, 16, 1, 1]),
        i(6, &[shader_words, 0, 0x0064_726F]),
        i(71, &[SUBGROUP, 11, 40]),
        i(71, &[LANE, 11, 41]),
        i(71, &[INDEX, 11, 29]),
        i(71, &[22, 6, 4]),
        i(72, &[shader_words, 0, 35, 0]),
        i(71, &[OUTPUT, 33, 0]),
        i(19, &[VOID]),
        i(33, &[FUNCTION, VOID]),
        i(21, &[UINT, 32, 0]),
        i(20, &[BOOL]),
        i(43, &[UINT, ZERO, 0]),
        i(43, &[UINT, ONE, 1]),
        i(43, &[UINT, TWO, 2]),
        i(43, &[UINT, BARRIER_OF_SHARED, 0x108]),
        i(32, &[input, 1, UINT]),
        i(29, &[22, UINT]),
        i(30, &[shader_words, 22]),
        i(32, &[23, 12, shader_words]),
        i(32, &[TO_WORD, 12, UINT]),
        i(59, &[input, SUBGROUP, 1]),
        i(59, &[input, LANE, 1]),
        i(59, &[input, INDEX, 1]),
        i(59, &[23, OUTPUT, 12]),
        i(54, &[VOID, MAIN, 0, FUNCTION]),
    ];
    [header, declared.concat(), body.concat(), i(56, &[])].concat()
}

fn run(body: &[Vec<u32>], words: usize) -> Result<Vec<u32>, Fault> {
    let program = Program::new("small", &module(body), &[], 8).expect("a program");
    let mut buffers = vec![(0, vec![0; words])];
    let order = Order::Reverse;
    let dispatch = Dispatch { workgroups: [1; 3], push: &[], order, accepts_unwritten_shared: false };
    program.run(&dispatch, &mut buffers)?;
    Ok(buffers.remove(0).1)
}

/// Executes a barrier if an input is 0.
fn barrier_if(input: u32) -> Vec<Vec<u32>> {
    vec![
        i(248, &[30]),
        i(61, &[UINT, 31, input]),
        i(170, &[BOOL, 32, 31, ZERO]),
        i(247, &[34, 0]),
        i(250, &[32, 33, 34]),
        i(248, &[33]),
        i(224, &[TWO, TWO, BARRIER_OF_SHARED]),
        i(249, &[34]),
        i(248, &[34]),
        i(253, &[]),
    ]
}

#[test]
fn barriers_that_not_all_reach_are_faults() {
    let fault = run(&barrier_if(LANE), 1).expect_err("one lane of eight");
    assert_eq!(fault.problem, "a barrier that lane 1 does not reach");
    let fault = run(&barrier_if(SUBGROUP), 1).expect_err("one subgroup of two");
    assert_eq!((fault.problem.as_str(), fault.opcode), ("a barrier that not all subgroups reach", 224));
    let said = "small: a barrier that not all subgroups reach; opcode 224 at word";
    assert!(fault.to_string().starts_with(said), "{fault}");
}

#[test]
fn accesses_that_no_barrier_orders_are_faults() {
    let to = |index, value| {
        let body = [
            i(248, &[30]),
            i(61, &[UINT, 31, LANE]),
            i(61, &[UINT, 32, INDEX]),
            i(65, &[TO_WORD, 33, OUTPUT, ZERO, index]),
            i(62, &[33, value]),
            i(253, &[]),
        ];
        run(&body, 16)
    };
    // Each invocation writes its own word; lanes of two subgroups write the same value to the same word; all write
    // the same word.
    assert_eq!(to(32, 31).map(|words| words[9]), Ok(1));
    assert_eq!(to(31, 31).map(|words| words[7]), Ok(7));
    let fault = to(31, 32).expect_err("lane 0 of both subgroups");
    assert!(fault.problem.contains("writes word 0 of 'ord', which lane 0 of subgroup 1"), "{fault}");
    let fault = to(ONE, 31).expect_err("all lanes of a subgroup");
    assert_eq!((fault.subgroup, fault.lane), (1, Some(1)), "{fault}");
}
