//! Runs SPIR-V compute modules on the host, with subgroups of any size from 1 to 128, and strict checks.
//!
//! The lanes of a subgroup run in lockstep. They diverge at branches and reconverge at merge blocks, as
//! SPV_KHR_maximal_reconvergence defines it. Subgroups of a workgroup run one after another from barrier to barrier,
//! and workgroups one after another. The caller chooses the order ([`Order`]).
//!
//! Behaviour that no result may depend on is a [`Fault`]: an access outside a buffer, an array or a vector; a read
//! of unwritten shared memory; a barrier that not all invocations reach; a data race between two invocations without
//! a barrier, if one writes another value; a subgroup operation that reads an inactive lane. Undefined results of
//! arithmetic and unwritten variables are NaN.
//!
//! Not supported: images; 8, 16 and 64 bits; cooperative matrices; clustered subgroups; memory scopes beyond the
//! workgroup.

mod arithmetic;
mod builder;
mod execute;
mod lockstep;
mod memory;
mod module;
mod program;
mod values;

pub use execute::{Dispatch, Fault, Order};
pub use program::Program;
