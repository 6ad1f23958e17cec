//! A rendered world with exact truth: board, camera, motion, blur, noise. Pure; uses geometry and imaging.
