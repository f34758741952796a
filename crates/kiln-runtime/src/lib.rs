//! For engines: map a container, choose a level for a view, lend slices.
