//! Runs SPIR-V compute modules on the host, with subgroups of any size from 1 to 128, and is strict about what they do.
//!
//! The lanes of a subgroup run in lockstep. They part at branches and are together again at merge blocks, as
//! SPV_KHR_maximal_reconvergence has it. The subgroups of a workgroup run one after the other from barrier to barrier, the
//! workgroups one after the other, both in an order that the caller chooses ([`Order`]).
//!
//! What no result may hang on is a [`Fault`]: an access outside of a buffer, an array or a vector; shared memory that is read
//! before it is written; a barrier that not all invocations reach; a word that two invocations touch without a barrier
//! between, one of them writing something else than it holds; a subgroup operation that reads an inactive lane. Undefined
//! results of arithmetic and variables that nobody has written are NaN.
//!
//! Not here: images, 8, 16 and 64 bits, cooperative matrices, clusters of subgroups, memory scopes beyond the workgroup.

mod arithmetic;
mod builder;
mod execute;
mod lockstep;
mod memory;
mod module;
mod outline;
mod program;
mod subgroup;
mod values;

pub use execute::{Dispatch, Fault, Order};
pub use program::Program;

#[cfg(test)]
mod tests;
