//! MikkTSpace tangents.
