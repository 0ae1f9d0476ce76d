//! The lab: what a mark costs and what it survives, on any mesh.
//!
//! It stands beside the service and uses only the modules for files, geometry and the method. In
//! reading order: [`grid`] (which marks
//! and attacks), [`trial`] (one mark, all its attacks), [`run`] (all trials on all cores, by
//! `queue`; with [`known`] rows of earlier runs), [`row`] and [`summary`] (what comes out),
//! [`report`] (how it is shown).
//!
//! Must not open files, read the clock or know of the service: names and bytes come in, rows and
//! texts go out.

pub mod grid;
pub mod known;
pub mod measures;
pub mod perceived;
mod queue;
pub mod report;
pub mod row;
pub mod run;
pub mod sequential;
pub mod summary;
pub mod trial;

#[cfg(test)]
mod tests;
