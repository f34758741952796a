//! The part of the chores that tests use, too: the generator of fixtures.

pub mod fixtures;
