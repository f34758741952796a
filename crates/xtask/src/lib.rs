//! The part of the chores that tests use, too: the generator of fixtures, and servers for shared caches.

pub mod fixtures;
pub mod servers;
