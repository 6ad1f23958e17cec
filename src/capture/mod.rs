//! Where frames come from: one trait, one file a kind of source. Uses geometry, imaging, recording and simulation.
