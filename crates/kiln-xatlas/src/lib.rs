//! A worker program around xatlas, run as a killable child by the atlas stage.
