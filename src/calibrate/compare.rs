//! What changed from one instrument to another, in units that a person understands.
