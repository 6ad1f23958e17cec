//! One luma image → the corners of a board with markers, each with its id, or the reason why not.
//!
//! A ChArUco board and an AprilGrid are both lattices of crossings, as a chessboard is: what the
//! markers add is which crossing is which. So crossings come first, however blurred the markers
//! are, and then all markers together say where in the board the lattice lies:
//!
//! | stage | file | what it does |
//! | --- | --- | --- |
//! | sheet | `sheet` | what a target prints: lines, cells, the codes of its markers |
//! | order | `order` | which crossings to start from |
//! | open square | `open_square` | a square of which three corners are candidates |
//! | lattice | `chart`, `lattice` | from one cell to the next crossing, where the nearest ones put
//! it |
//! | floor | `floor_limits`, `floor` | what is spent on lattices larger than the board |
//! | reading | `reading` | how well each marker cell agrees with each code |
//! | labels | `labels` | the place in the board that most cells agree on, far more than with any
//! other |
//! | ends | `ends` | which of two places it is, where only the board's ends distinguish them |
//! | print | `print`, `curved_chart` | what the markers add to the image near each crossing, for
//! the refinement |
//! | detector | `detector`, `finish` | levels, completion by the labeled board, refinement |
//! | meeting sides | `meeting_sides`, `edge_line` | corners that something small lies on, from the
//! sides that meet in them | | other scales | `other_scales` | two thirds of each level and twice
//! the image, where the levels show no target |
//! | tracking | `tracking`, `offset_search` | the board of the last image, a little farther on |
//! | recognition | `recognition` | which board it is, where none was asked for |
//!
//! **May miss, never mislabels**: a board is answered only if its markers agree with one place in
//! the target and no other, and none that is clearly read says otherwise.

pub mod answer;
mod chart;
mod code_columns;
mod compared_crossing;
mod curved_chart;
pub mod detector;
mod edge_line;
mod ends;
mod finish;
mod floor;
mod floor_limits;
mod homography_equations;
mod labeling;
mod labels;
mod last_target;
mod lattice;
mod meeting_sides;
pub mod no_target;
mod offset_search;
mod open_square;
mod order;
mod other_scales;
mod print;
mod print_integral;
mod reading;
pub mod recognition;
mod sheet;
pub mod tracking;
