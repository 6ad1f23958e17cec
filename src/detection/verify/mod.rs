//! Verification compares what was found with the image and with the rest of the board. It is the
//! only place that rejects, and it can only reject: "may miss, never mislabels".
//!
//! | what | file | rejects |
//! | --- | --- | --- |
//! | a grid | `consistency` | corners whose edges fail, or that lie off their neighbors' prediction; a grid of too many of these |
//! | its ends | `ends` | placements against a visible end of the board |
//! | its placement | `placement` | grids in which the board cannot lie |
//! | corners beyond a whole board | `spurious` | those of something else, so that the board is left |
//! | refined corners | `corners` | those that moved, that an occluder may pull, or that lie off the others |

pub(in crate::detection) mod consistency;
pub(in crate::detection) mod corners;
pub(in crate::detection) mod ends;
pub(in crate::detection) mod placement;
pub(in crate::detection) mod spurious;
